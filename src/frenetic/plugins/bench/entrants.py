"""Entrants of a bench: generators of the official pipeline, and our strategies."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from frenetic._support.words import part_word, read_part
from frenetic.errors import FreneticError
from frenetic.parts.registry import STRATEGIES
from frenetic.parts.trust import Parts

PLACES = ("path", "copy", "pipeline", "python")
"""Options of a generator."""
_PIPELINE = ("code_pipeline/executors.py", "self_driving/simulation_data.py")
"""Files by which the pipeline is known."""
LONGEST_NAME = 60
"""Letters of an entrant's name."""


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A participant of a bench. Its paths may be texts, too; they become absolute."""

    name: str
    """Name in tables and folders."""
    spec: str
    """``package.module:Class`` or ``file.py:Class`` of a generator; a strategy also by its name."""
    is_strategy: bool = False
    """Whether it is a search strategy of ours rather than a generator of the pipeline."""
    path: Path | None = None
    """Folder of a generator that is put on its module path."""
    copy: Path | None = None
    """Folder of which every run of a generator gets a copy as its working directory. A path or file
    in it stands for its copy."""
    pipeline: Path | None = None
    """Folder with the pipeline's modules; by default the generator's folder or one around it."""
    python: Path | None = None
    """The interpreter of a generator; by default the current one."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of a strategy."""

    def __post_init__(self) -> None:
        if not self.name.strip() or len(self.name) > LONGEST_NAME or not self.name.isprintable():
            raise FreneticError(
                f"the name {self.name!r} cannot be used: 1 to {LONGEST_NAME} printable characters"
                " are needed"
            )
        if self.is_strategy:
            if any(getattr(self, name) is not None for name in PLACES):
                places = " and no ".join(PLACES)
                raise FreneticError(f"{self.name} is a strategy: it takes no {places}")
            return
        module, colon, kind = self.spec.rpartition(":")
        if not (module and colon and kind.isidentifier()):
            raise FreneticError(
                f"the generator {self.spec!r} is not package.module:Class or path/to/file.py:Class"
                + ("" if colon else ": add the class, such as file.py:Class")
            )
        if self.options:
            raise FreneticError(f"{self.name} is a generator: only strategies have options")
        for name in ("path", "copy", "pipeline"):
            if (folder := getattr(self, name)) is None:
                continue
            if not Path(folder).is_dir():
                raise FreneticError(f"{self.name}: there is no folder {str(folder)!r}")
            object.__setattr__(self, name, Path(folder).resolve())
        if self.python is not None:
            if not Path(self.python).is_file():
                raise FreneticError(f"{self.name}: there is no interpreter {str(self.python)!r}")
            # Not resolved: the interpreter of a virtual environment must stay a link.
            object.__setattr__(self, "python", Path(self.python).absolute())
        place = self.path or self.copy or Path.cwd()
        if module.endswith(".py"):
            file = Path(module).expanduser()
            file = (file if file.is_file() else place / file).resolve()
            object.__setattr__(self, "spec", f"{file}:{kind}")
        elif self.copy is None:
            object.__setattr__(self, "path", place)

    @property
    def module(self) -> str:
        """Module or file of a generator; a file as an absolute path."""
        return self.spec.rpartition(":")[0]

    @property
    def class_name(self) -> str:
        """Name of a generator's class."""
        return self.spec.rpartition(":")[2]

    @property
    def own_pipeline(self) -> Path | None:
        """Folder with a generator's modules of the pipeline; None if it has none of its own."""
        if self.pipeline is not None:
            return self.pipeline
        place = self.path or self.copy or Path(self.module).parent
        for folder in (place, *place.parents):
            if all((folder / module).is_file() for module in _PIPELINE):
                return folder
        return None

    def as_json(self) -> dict[str, Any]:
        """Return the entrant as a JSON object."""
        recorded: dict[str, Any] = msgspec.to_builtins(self, enc_hook=str)  # a path as a text
        return recorded | {"source": self.source()}

    @property
    def word(self) -> str:
        """The entrant as on the command line."""
        places = {name: getattr(self, name) for name in PLACES}
        options = {name: str(path) for name, path in places.items() if path is not None}
        return part_word(self.spec, {**options, **self.options, "name": self.name})

    def absolute(self, folder: Path) -> Entrant:
        """Return the same, for use elsewhere, of one whose files go from a folder.

        Raises:
            FreneticError: it is a module, which has no path.
        """
        if not (self.is_strategy and STRATEGIES.is_own(self.spec)):
            return self
        spec, options = STRATEGIES.absolute(self.spec, self.options, folder)
        return replace(self, spec=spec, options=options)

    def source(self) -> str | None:
        """A digest of a generator's own file, None if that cannot be read."""
        if self.is_strategy:
            return None
        place = Path(self.module)
        if not self.module.endswith(".py"):
            place = (self.path or self.copy or Path()).joinpath(*self.module.split("."))
            place = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
        try:
            return hashlib.sha256(place.read_bytes()).hexdigest()
        except OSError:
            return None


def entrant_parts(generator: Iterable[str], strategy: Iterable[str]) -> Parts:
    """Kind and number -> name and options of entrants, for `frenetic.parts.trust`.

    Args:
        generator: the generators as on the command line.
        strategy: texts of the strategies.

    Raises:
        ValueError: a text says no entrant.
    """
    parts = {}
    for kind, texts in (("generator", generator), ("strategy", strategy)):
        for number, text in enumerate(texts, 1):
            name, options = read_part(text)
            options.pop("name", None)  # in tables
            parts[f"{kind} {number}"] = name or "", options
    return parts


def folder_names(entrants: Sequence[Entrant]) -> dict[str, str]:
    """Name of each entrant -> name of its folder, valid on every file system.

    Raises:
        FreneticError: two have the same name.
    """
    folders: dict[str, str] = {}
    for entrant in entrants:
        if entrant.name in folders:
            raise FreneticError(f"two take part as {entrant.name!r}: give one of them another name")
        plain = re.sub(r"[^A-Za-z0-9_-]+", "-", entrant.name).strip("-").lower() or "entrant"
        folder, number = plain, 2
        while folder in folders.values():
            folder, number = f"{plain}-{number}", number + 1
        folders[entrant.name] = folder
    return folders
