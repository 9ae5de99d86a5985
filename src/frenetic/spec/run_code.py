"""The code that a spec names: its signature, and the folders from which it is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Self

from msgspec import structs

from frenetic._support.option_text import part_word
from frenetic.parts.named_code import REGISTRIES, Parts, named_code
from frenetic.parts.signatures import sign
from frenetic.parts.trust import CodeClaim
from frenetic.spec.parts import PARTS, Part
from frenetic.spec.run_entries import Signed
from frenetic.spec.run_settings import RunSettings


class RunCode(RunSettings, frozen=True, kw_only=True):
    """The settings of a run with the code that they name.

    Raises:
        ValueError: an entry is out of range.
        FreneticError: no roads, criteria or conditions have this name.
    """

    @property
    def parts(self) -> dict[str, Part]:
        """Kind -> part, of all parts that the user names, and of the objective.

        A scheduler is a part, too: Dask lets it send objects, whose loading runs code.
        """
        parts = {kind: self.part(kind) for kind in PARTS if getattr(self, kind)}
        if isinstance(self.workers, str):
            parts["workers"] = Part(self.workers, {})
        return parts | {"objective": Part(self.named_objective, {})}

    def signed_in(
        self,
        folder: Path | str | None,
        sources: object = None,
        others: Parts = MappingProxyType({}),
    ) -> Self:
        """Return the spec with its user's signature of the named code, see `frenetic.parts.trust`.

        It is unsigned if it names no code, or if the user's key cannot be written.

        Args:
            folder: folder from which the code is loaded; None for the current folder.
            sources: name of a file -> its text, stored beside the spec.
            others: other parts that are named beside the spec, such as a bench's entrants.
        """
        code_folder = Path(folder or "").absolute()
        code = named_code({**self.parts, **others})
        signature = sign(code, code_folder, sources)
        signed = Signed(str(code_folder), signature) if signature else None
        return structs.replace(self, signed=signed)

    def code_claim(
        self, *, others: Parts = MappingProxyType({}), sources: object = None
    ) -> CodeClaim:
        """Return the named parts with the spec's signature.

        `frenetic.parts.trust.require_trusted` takes it.

        Args:
            others: other parts that are named beside the spec, such as a bench's entrants.
            sources: sources that are stored beside the spec, as for `signed_in`.
        """
        signed = self.signed or Signed("", "")
        parts = {**self.parts, **others}
        return CodeClaim(parts, signed.signature, signed.folder, sources)

    def with_files_in(self, folders: Mapping[str, Path]) -> Self:
        """Return the spec with absolute paths of the files of some parts.

        Args:
            folders: kind of a part -> folder to which its relative paths belong.

        Raises:
            FreneticError: a part is a module, which has no path.
        """
        values: dict[str, str] = {}
        for kind, folder in folders.items():
            name, options = REGISTRIES[kind].absolute(*self.parts[kind], folder)
            values[kind] = part_word(name, options) if kind in PARTS else name
        return structs.replace(self, **values)

    def with_roads_from(self, folder: Path) -> Self:
        """Return the spec with absolute paths of the campaigns and roads from which it starts.

        Args:
            folder: folder to which relative paths belong.
        """
        roads = None if self.from_roads is None else str(folder / self.from_roads)
        starts = tuple(str(folder / start) for start in self.start_from)
        return structs.replace(self, from_roads=roads, start_from=starts)
