"""Versions of a campaign's parts, which tell two states of a driver apart.

- A built-in part has the version that its class declares, ``BEHAVIOUR``.
- An installed part has the version of its distribution.
- A part of your own has a digest of its source: its file and the local modules that it imports,
  directly or not. A module is local unless it lies in the standard library or a ``site-packages``;
  a package in an editable install is local. The digest leaves out modules that are imported by a
  computed name, and data that the part opens by itself.

Files that are arguments of a part, such as models, and a part that is a program add a digest of
their contents.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any, Final

from frenetic.errors import describe_error
from frenetic.parts.construction import Construction
from frenetic.parts.program import COMMIT, DISTRIBUTION, installed_version, program_commit
from frenetic.parts.source_imports import files_of, imported_names
from frenetic.parts.user_modules import USER_MODULE, is_local

SHORT: Final = 8
"""Number of characters of a digest that people see."""
FILES: Final = "files "
"""Beginning of the digest, in a version's text, of files of data and programs."""
_PACKAGE: Final = "frenetic"
PACKAGES: Final = (DISTRIBUTION, "numpy", "numba", "scipy")
"""Distributions that a campaign's results depend on."""


@dataclass(frozen=True)
class Version:
    """The version of a part, and the source of its code that is the user's own."""

    text: str
    """Text such as ``version 3``, ``my-drivers 1.2`` or ``source 1f3a9c07``."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """Path of a local file, relative to the folder of its top package -> text of the file."""


def version_of(
    part: object,
    arguments: Mapping[str, Any] | None = None,
    construction: Construction | None = None,
) -> Version:
    """Return the version of a strategy, driver, wrapper, simulator or other part.

    Never raises: if the version cannot be found out, its text says why.

    Args:
        part: the object.
        arguments: arguments of the object's constructor.
        construction: call that made the part from its name, if any; its factory may be a function.
    """
    try:
        return _version(part, arguments or {}, construction)
    except Exception as error:  # foreign classes, loaders and files may raise anything
        return Version(f"unknown ({describe_error(error)})")


def _version(
    part: object, arguments: Mapping[str, Any], construction: Construction | None
) -> Version:
    """Return the version of a part, or raise what foreign classes, loaders and files raise."""
    classes = [part] if isinstance(part, FunctionType) else inspect.getmro(type(part))
    factory = type(part) if construction is None else construction.factory
    factories = [] if factory is type(part) else [factory]
    texts: list[str] = []
    sources: dict[str, str] = {}
    for item in [*classes, *factories, *map(_class_of, arguments.values())]:
        module = str(item.__module__)
        package, file = module.partition(".")[0], _source_file(module)
        if package == _PACKAGE:
            if item in classes:  # the version of a built-in class covers its bases
                behaviour = _behaviour(item)
                texts.append(f"{item.__qualname__} {behaviour}" if sources else behaviour)
                break
        elif module == "__main__" or (file is not None and is_local(Path(file))):
            loaded = {} if file is None else _sources(Path(file), module)
            sources |= loaded or {module: inspect.getsource(item)}
        elif item in classes and package not in sys.stdlib_module_names:
            texts.append(_distribution(module))
    own_files = getattr(part, "version_files", ()) if _is_ours(part) else ()
    file_digests = [digest_of_file(Path(path)) for path in (*own_files, *_paths(arguments))]
    if sources:
        digest = hashlib.sha256(json.dumps(sorted(sources.items())).encode()).hexdigest()
        texts.insert(0, f"source {digest[:SHORT]}")
    if file_digests:
        digest = hashlib.sha256("".join(file_digests).encode()).hexdigest()
        texts.append(f"{FILES}{digest[:SHORT]}")
    return Version(", ".join(dict.fromkeys(texts)), sources)


def sources_named(name: str) -> dict[str, str]:
    """Return the sources of ``file.py:Class`` or ``package.module:Class``: name -> text of a file.

    The sources include the local modules that the named one imports. Nothing is imported. Relative
    files and the user's modules are looked for in the current folder.

    Raises:
        OSError: a file cannot be read.
    """
    module = name.rpartition(":")[0]
    if not module.endswith(".py"):
        is_excluded = module.partition(".")[0] in ("", _PACKAGE)
        local_file = None if is_excluded else _local_file(module, Path.cwd())
        return {} if local_file is None else _sources(local_file, module)
    file = Path(module).expanduser().resolve()
    return _sources(file, f"{USER_MODULE}{file.stem}") if file.is_file() else {}


def edited_files(names: Iterable[str], sources: object) -> list[str]:
    """Return the names of a user's files that differ from a campaign's copies; import nothing.

    Args:
        names: names of parts, as `sources_named` takes them.
        sources: name of a file -> text of the file, as the campaign keeps it.
    """
    stored = sources if isinstance(sources, Mapping) else {}
    present: dict[str, str] = {}
    for name in names:
        with suppress(OSError, ValueError, RuntimeError):
            present |= sources_named(name)
    return [name for name, text in sorted(present.items()) if stored.get(name, text) != text]


def _local_file(module: str, folder: Path) -> Path | None:
    """Return the file that an import of a module would load; None if it is missing or not local.

    Args:
        module: name of the module, with dots.
        folder: folder in which the import would look last.
    """
    stem = Path(*module.split("."))
    for place in map(Path, [*sys.path, str(folder)]):
        for file in (place / stem.with_suffix(".py"), place / stem / "__init__.py"):
            if file.is_file():
                return file if is_local(file) else None
    return None


def _sources(path: Path, name: str) -> dict[str, str]:
    """Return the sources of a module and of the local modules that it imports; import nothing.

    Args:
        path: the module's file.
        name: the module's name, with dots.

    Returns:
        Path of a file, relative to the folder of its top package -> text of the file.
    """
    is_alone = name == "__main__" or name.startswith(USER_MODULE)
    package_depth = 0 if is_alone else name.count(".") + (path.name == "__init__.py")
    root = path.parents[package_depth]
    others = (
        Path(folder) for folder in sys.path if folder and is_local(Path(folder) / "module.py")
    )
    folders = [root, *others]
    waiting = [("", path, root)] if is_alone else list(files_of(name, [root]))
    sources: dict[str, str] = {}
    read_files: set[Path] = set()
    while waiting:
        module, file, folder = waiting.pop()
        if file in read_files:
            continue
        read_files.add(file)
        text = file.read_bytes().decode("utf-8", "replace").replace("\r\n", "\n")
        sources[file.relative_to(folder).as_posix()] = text
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        for imported in imported_names(text, package):
            waiting += files_of(imported, folders)
    return sources


def _source_file(module: str) -> str | None:
    """Return the Python file of a loaded module; None for other modules, such as extensions."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return str(file) if file and str(file).endswith(".py") else None


def _class_of(value: object) -> Any:
    """Return the class of a value; a class or a function stands for itself."""
    return value if isinstance(value, type | FunctionType) else type(value)


def _is_ours(part: object) -> bool:
    """Return whether a part's class is Frenetic's."""
    return type(part).__module__.partition(".")[0] == _PACKAGE


def _paths(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield the arguments of a part that are paths of existing files."""
    for value in values.values():
        if isinstance(value, str | os.PathLike):
            path = os.fsdecode(value)
            try:
                is_file = Path(path).expanduser().is_file()
            except (OSError, ValueError, RuntimeError):  # the text is no path
                continue
            if is_file:
                yield path


def _behaviour(class_: type[Any]) -> str:
    """Return the declared version of a built-in class; without one, the version of Frenetic."""
    version = getattr(class_, "BEHAVIOUR", None)
    if version is None:
        return _distribution(_PACKAGE)
    packages = getattr(class_, "BEHAVIOUR_PACKAGES", ())
    return ", ".join([f"version {version}", *map(_distribution, packages)])


def _distribution(name: str) -> str:
    """Return the name and version of the distribution that installed a module or has this name."""
    from importlib.metadata import packages_distributions  # takes its time

    package = DISTRIBUTION if name == _PACKAGE else name.partition(".")[0]
    if version := installed_version(package):
        return f"{package} {version}"
    names = sorted(set(packages_distributions().get(package, ())))
    texts = [f"{name} {installed_version(name)}" for name in names]
    return ", ".join(texts) or f"{package} of unknown version"


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of `PACKAGES`, and the commit of Frenetic if it is known.

    A commit does not tell whether files of the clone were changed after it.
    """
    versions = {name: installed_version(name) or "unknown" for name in PACKAGES}
    commit = program_commit()
    return {
        "python": platform.python_version(),
        **versions,
        **({} if commit is None else {COMMIT: commit}),
    }


def changed_packages(recorded: object) -> list[str]:
    """Return a text about each package whose version is not the recorded one.

    Args:
        recorded: result of `package_versions` when the campaign began; other values are ignored.
    """
    before = recorded if isinstance(recorded, Mapping) else {}
    now = package_versions()
    return [
        f"{package} {version}, now {now.get(package, 'unknown')}"
        for package, version in before.items()
        if now.get(package) != version
    ]


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        OSError: the file cannot be read.
    """
    file = path.expanduser()
    state = file.stat()
    return _digest(str(file.absolute()), state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=64)  # so large files are read once
def _digest(path: str, size: int, changed: int) -> str:  # noqa: ARG001  # part of the cache's key
    """Return the SHA-256 of a file of this size and time of change."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
