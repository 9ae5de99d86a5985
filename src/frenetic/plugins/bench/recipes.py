"""Recipes: published generators of the competition, and how a bench runs them.

The recipes themselves are in recipes.toml.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from msgspec import Struct, convert, field

from frenetic.errors import FreneticError, UnknownNameError
from frenetic.parts.registry import hint
from frenetic.plugins.bench.entrants import Entrant


class Recipe(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A published generator, whose files the user has downloaded into a folder."""

    name: str
    """Name on the command line."""
    title: str
    """Name in tables."""
    source: str
    """GitHub repository, and branch or pull request, from which the files come."""
    spec: str
    """``package.module:Class`` of the generator."""
    path: str = "."
    """Folder on the module path, relative to the folder of the files."""
    copy: str | None = None
    """Folder of which each run gets a copy to work in, relative to the folder of the files."""
    packages: tuple[str, ...] = ()
    """Packages needed beside numpy, scipy, shapely and matplotlib, in versions that ran."""
    files: dict[str, str] = field(default_factory=dict)
    """Path of a file that the source lacks -> what the file is."""
    seconds_per_test: float = 0.0
    """Least virtual time of a drive with which the generator ends, in s."""
    note: str = ""
    """Note for people."""

    def entrant(
        self, folder: Path | str, *, python: Path | str | None = None, name: str | None = None
    ) -> Entrant:
        """Return the generator as an entrant of a bench.

        Args:
            folder: folder of the generator's files.
            python: interpreter of the generator; by default the current one.
            name: name in tables; by default the title.

        Raises:
            FreneticError: a file is missing.
        """
        folder = Path(folder)
        module = self.spec.partition(":")[0]
        module_file = (folder / self.path).joinpath(*module.split(".")).with_suffix(".py")
        if not module_file.is_file():
            raise FreneticError(
                f"{str(folder)!r} does not hold {self.title}: {module_file} is not"
                f" there; its path must be a folder with the files of {self.source}"
            )
        for file, content in self.files.items():
            if not (folder / file).exists():
                raise FreneticError(f"{self.title} needs {str(folder / file)!r}: {content}")
        return Entrant(
            name=self.title if name is None else name,
            spec=self.spec,
            path=folder / self.path,
            copy=None if self.copy is None else folder / self.copy,
            python=None if python is None else Path(python),
        )

    @property
    def needs(self) -> str:
        """Packages, files and settings that the generator needs, for people."""
        needs = [*self.packages, *(f"{file} ({content})" for file, content in self.files.items())]
        if self.seconds_per_test:
            needs.append(f"{self.seconds_per_test:g} s per test")
        return "; ".join(filter(None, (", ".join(needs), self.note)))

    def require_enough_seconds(self, seconds_per_test: float) -> None:
        """Check the virtual time that a drive costs, in s.

        Raises:
            FreneticError: a drive costs so little that the generator would wait for ever at the
                end of its budget.
        """
        if seconds_per_test < self.seconds_per_test:
            raise FreneticError(
                f"{self.title} asks for no test in its last {self.seconds_per_test:g} s, while the"
                f" virtual clock stands: make a test cost {self.seconds_per_test:g} s or more"
            )


_FILE: Final = Path(__file__).with_name("recipes.toml")
RECIPES: Final[Mapping[str, Recipe]] = {
    name: convert({"name": name, **entries}, Recipe)
    for name, entries in tomllib.loads(_FILE.read_text(encoding="utf-8")).items()
}
"""Name -> recipe, in the order of the years."""


def find_recipe(name: str) -> Recipe:
    """Return the recipe of this name.

    Raises:
        UnknownNameError: no recipe has this name.
    """
    if name not in RECIPES:
        raise UnknownNameError(
            f"there is no published generator {name!r}{hint(name, RECIPES)} There are"
            f" {', '.join(RECIPES)}; any other is package.module:Class or path/to/file.py:Class"
        )
    return RECIPES[name]
