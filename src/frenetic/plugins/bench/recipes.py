"""Recipes: published generators of the competition, with what a bench must know to run them.

They stand in recipes.toml.
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
    """A published generator."""

    name: str
    title: str
    """Name in tables."""
    source: str
    """GitHub repository and branch or pull request whose files the folder holds."""
    spec: str
    """``package.module:Class``."""
    path: str = "."
    """Folder on the module path, in that one."""
    copy: str | None = None
    """Folder of which each run works in a copy, relative to the generator's files."""
    packages: tuple[str, ...] = ()
    """What it needs beside numpy, scipy, shapely and matplotlib, in the versions that ran."""
    files: dict[str, str] = field(default_factory=dict)
    """File that has to be added -> what it is."""
    seconds_per_test: float = 0.0
    """Least virtual time of a drive with which it runs, in s."""
    note: str = ""

    def entrant(
        self, folder: Path | str, *, python: Path | str | None = None, name: str | None = None
    ) -> Entrant:
        """Return the entrant of a bench.

        Args:
            folder: with the files of the source.
            python: its interpreter; by default the current one.
            name: in tables; by default the title.

        Raises:
            FreneticError: the folder lacks something.
        """
        folder = Path(folder)
        place = (folder / self.path).joinpath(*self.spec.partition(":")[0].split("."))
        if not place.with_suffix(".py").is_file():
            raise FreneticError(
                f"{str(folder)!r} does not hold {self.title}: {place.with_suffix('.py')} is not"
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
        """What has to be there beside its files, for people."""
        needs = [*self.packages, *(f"{file} ({content})" for file, content in self.files.items())]
        if self.seconds_per_test:
            needs.append(f"{self.seconds_per_test:g} s per test")
        return "; ".join(filter(None, (", ".join(needs), self.note)))

    def check(self, seconds_per_test: float) -> None:
        """Check the cost of a drive.

        Raises:
            FreneticError: the generator would wait for ever at its end.
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
"""Name -> recipe, by year."""


def find_recipe(name: str) -> Recipe:
    """Return the recipe of a name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in RECIPES:
        raise UnknownNameError(
            f"there is no published generator {name!r}{hint(name, RECIPES)} There are"
            f" {', '.join(RECIPES)}; any other is package.module:Class or path/to/file.py:Class"
        )
    return RECIPES[name]
