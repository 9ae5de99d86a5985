"""Entrants of a bench: generators of the official pipeline, and our strategies."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from frenetic._support.option_text import part_word, read_part
from frenetic.errors import FreneticError
from frenetic.parts.named_code import Parts
from frenetic.parts.registry import STRATEGIES

PATH_OPTIONS = ("path", "copy", "pipeline", "python")
"""Options of a generator, all paths."""
MAX_NAME_LENGTH = 60
"""Largest number of letters of an entrant's name; our choice."""
_PIPELINE_FILES = ("code_pipeline/executors.py", "self_driving/simulation_data.py")
"""Files by which a clone of the pipeline is recognised."""


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A participant of a bench: a generator of the official pipeline, or a search strategy.

    A generator may have ``path``, ``copy``, ``pipeline`` and ``python``, a strategy ``options``.
    Paths may be given as texts; they become absolute.
    """

    name: str
    """Name in tables and folders."""
    spec: str
    """``package.module:Class`` or ``file.py:Class``; of a strategy also its registered name."""
    is_strategy: bool = False
    """Whether the entrant is a search strategy rather than a generator."""
    path: Path | None = None
    """Folder that is put on the generator's module path."""
    copy: Path | None = None
    """Folder of which each run gets a copy as the generator's working directory.

    ``path`` and ``spec`` within this folder are taken from the copy.
    """
    pipeline: Path | None = None
    """Folder with the pipeline's modules; by default the generator's folder or one around it."""
    python: Path | None = None
    """Interpreter of the generator; by default the current one."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the strategy."""

    def __post_init__(self) -> None:
        is_short = len(self.name) <= MAX_NAME_LENGTH
        if not (self.name.strip() and is_short and self.name.isprintable()):
            raise FreneticError(
                f"the name {self.name!r} cannot be used: 1 to {MAX_NAME_LENGTH} printable"
                " characters are needed"
            )
        if self.is_strategy:
            self._require_no_paths()
        else:
            self._resolve_generator()

    def _require_no_paths(self) -> None:
        """Check that a strategy has no options of a generator.

        Raises:
            FreneticError: the strategy has a path.
        """
        if any(getattr(self, name) is not None for name in PATH_OPTIONS):
            names = " and no ".join(PATH_OPTIONS)
            raise FreneticError(f"{self.name} is a strategy: it takes no {names}")

    def _resolve_generator(self) -> None:
        """Make the paths of a generator absolute.

        Raises:
            FreneticError: the spec names no class, a path does not exist, or there are options.
        """
        module, colon, class_name = self.spec.rpartition(":")
        if not (module and colon and class_name.isidentifier()):
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
        home = self.path or self.copy or Path.cwd()
        if module.endswith(".py"):
            file = Path(module).expanduser()
            file = (file if file.is_file() else home / file).resolve()
            object.__setattr__(self, "spec", f"{file}:{class_name}")
        elif self.copy is None:
            object.__setattr__(self, "path", home)

    @property
    def module(self) -> str:
        """Module of a generator, or the absolute path of its file."""
        return self.spec.rpartition(":")[0]

    @property
    def class_name(self) -> str:
        """Name of a generator's class."""
        return self.spec.rpartition(":")[2]

    @property
    def own_pipeline(self) -> Path | None:
        """Folder of the pipeline's modules for a generator; None if it lies in no clone."""
        if self.pipeline is not None:
            return self.pipeline
        home = self.path or self.copy or Path(self.module).parent
        for folder in (home, *home.parents):
            if all((folder / file).is_file() for file in _PIPELINE_FILES):
                return folder
        return None

    def as_json(self) -> dict[str, Any]:
        """Return the entrant as a JSON object."""
        fields: dict[str, Any] = msgspec.to_builtins(self, enc_hook=str)  # paths as texts
        return fields | {"source": self.source()}

    @property
    def word(self) -> str:
        """Text of the entrant as on the command line."""
        paths = {name: getattr(self, name) for name in PATH_OPTIONS}
        options = {name: str(path) for name, path in paths.items() if path is not None}
        return part_word(self.spec, {**options, **self.options, "name": self.name})

    def absolute(self, folder: Path) -> Entrant:
        """Return the entrant with absolute paths of the user's own strategy.

        Args:
            folder: folder from which relative paths go.

        Raises:
            FreneticError: the strategy is in a module, which has no path.
        """
        if not (self.is_strategy and STRATEGIES.is_own(self.spec)):
            return self
        spec, options = STRATEGIES.absolute(self.spec, self.options, folder)
        return replace(self, spec=spec, options=options)

    def source(self) -> str | None:
        """Return the SHA-256 digest of a generator's own file.

        None for a strategy, or if the file cannot be read.
        """
        if self.is_strategy:
            return None
        file = Path(self.module)
        if not self.module.endswith(".py"):
            module = (self.path or self.copy or Path()).joinpath(*self.module.split("."))
            file = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        try:
            return hashlib.sha256(file.read_bytes()).hexdigest()
        except OSError:
            return None


def entrant_parts(generator: Iterable[str], strategy: Iterable[str]) -> Parts:
    """Return the parts that entrants name, such as "generator 1" -> its name and options.

    `frenetic.parts.named_code` takes them.

    Args:
        generator: the generators as on the command line.
        strategy: the strategies as on the command line.

    Raises:
        ValueError: a text has no form NAME,OPTION=VALUE.
    """
    parts = {}
    for kind, texts in (("generator", generator), ("strategy", strategy)):
        for number, text in enumerate(texts, 1):
            name, options = read_part(text)
            options.pop("name", None)  # it is for tables alone
            parts[f"{kind} {number}"] = name or "", options
    return parts


def folder_names(entrants: Sequence[Entrant]) -> dict[str, str]:
    """Return name of each entrant -> name of its folder, which every file system allows.

    Raises:
        FreneticError: two entrants have the same name.
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
