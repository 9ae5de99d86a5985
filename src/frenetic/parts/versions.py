"""Versions of a campaign's parts: what tells two states of a driver apart.

The version of a built-in part is its declared ``BEHAVIOUR``, that of an installed one its
distribution's. A part of your own has a digest of its source: its file and the local modules that
this one imports, and theirs. Local is what is neither in the standard library nor in a
``site-packages``; a package in an editable install is local. Files that are arguments, such as
models, count with their content. Modules that are imported by a computed name, and data that a part
opens by itself, are not in it.
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
from frenetic.parts.registry import Made, part_name
from frenetic.parts.source_imports import files_of, imported_names
from frenetic.parts.user_modules import USER_MODULE, is_local

SHORT: Final = 8
"""Characters of a digest for people."""
_OURS: Final = "frenetic"
_DISTRIBUTION: Final = "frenetic-roads"
PACKAGES: Final = (_DISTRIBUTION, "numpy", "numba", "scipy")
"""Distributions that a campaign's results depend on."""
_SHOWN: Final = 60  # characters of an argument for people


@dataclass(frozen=True)
class Version:
    """The version of a part, and the source of it that is the user's own."""

    text: str
    """Such as ``version 3``, ``my-drivers 1.2`` or ``source 1f3a9c07``."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """Name of a local file, from where its packages lie -> its text."""


def version_of(
    part: object, arguments: Mapping[str, Any] | None = None, made: Made | None = None
) -> Version:
    """The version of a strategy, driver, layer, simulator or other part; never raises.

    Args:
        part: the object.
        arguments: of its constructor.
        made: how it was made by its name, if it was: its factory may be no class.
    """
    try:
        return _version(part, arguments or {}, made)
    except Exception as error:  # foreign classes, loaders and files may raise anything
        return Version(f"unknown ({describe_error(error)})")


def _version(part: object, arguments: Mapping[str, Any], made: Made | None) -> Version:
    kinds = inspect.getmro(type(part)) if not isinstance(part, FunctionType) else [part]
    texts: list[str] = []
    sources: dict[str, str] = {}
    values = [made.factory] if made is not None and made.factory is not type(part) else []
    for kind in [*kinds, *values, *map(_kind, arguments.values())]:
        name = str(kind.__module__)
        top, file = name.partition(".")[0], _file(name)
        if top == _OURS:
            if kind in kinds:  # the behaviour of a class covers that of its own bases
                texts.append(f"{kind.__qualname__} {_behaviour(kind)}" if sources else "")
                texts[-1] = texts[-1] or _behaviour(kind)
                break
        elif name == "__main__" or (file is not None and is_local(Path(file))):
            loaded = {} if file is None else _sources(Path(file), name)
            sources |= loaded or {name: inspect.getsource(kind)}
        elif kind in kinds and top not in sys.stdlib_module_names:
            texts.append(_distribution(name))
    files = [digest_of_file(Path(path)) for path in _paths(arguments)]
    if sources:
        digest = hashlib.sha256(json.dumps(sorted(sources.items())).encode()).hexdigest()
        texts.insert(0, f"source {digest[:SHORT]}")
    if files:
        texts.append(f"files {hashlib.sha256(''.join(files).encode()).hexdigest()[:SHORT]}")
    return Version(", ".join(dict.fromkeys(texts)), sources)


def sources_named(name: str) -> dict[str, str]:
    """The source of ``file.py:Class`` or ``package.module:Class``, by the names of its files.

    Those of the local modules that it imports are among them; nothing is imported for it. Relative
    files and the user's modules go from the current folder.

    Raises:
        OSError: a file cannot be read.
    """
    module = name.rpartition(":")[0]
    if not module.endswith(".py"):
        is_ours = module.partition(".")[0] in ("", _OURS)
        found = None if is_ours else _local_file(module, Path.cwd())
        return {} if found is None else _sources(found, module)
    file = Path(module).expanduser().resolve()
    return _sources(file, f"{USER_MODULE}{file.stem}") if file.is_file() else {}


def edited_files(names: Iterable[str], sources: object) -> list[str]:
    """Names of users' own files that are not as a campaign keeps them; nothing is imported.

    Args:
        names: of parts, as `sources_named` takes them.
        sources: name of a file -> its text, as the campaign keeps them.
    """
    known = sources if isinstance(sources, Mapping) else {}
    present: dict[str, str] = {}
    for name in names:
        with suppress(OSError, ValueError, RuntimeError):
            present |= sources_named(name)
    return [name for name, text in sorted(present.items()) if known.get(name, text) != text]


def _local_file(module: str, folder: Path) -> Path | None:
    """The file of a local module as an import of a user's own finds it; None if there is none."""
    parts = Path(*module.split("."))
    for place in map(Path, [*sys.path, str(folder)]):
        for file in (place / parts.with_suffix(".py"), place / parts / "__init__.py"):
            if file.is_file():
                return file if is_local(file) else None
    return None


def _sources(path: Path, name: str) -> dict[str, str]:
    """The sources of a module; nothing is imported."""
    is_alone = name == "__main__" or name.startswith(USER_MODULE)
    packages = 0 if is_alone else name.count(".") + (path.name == "__init__.py")
    root = path.parents[packages]
    others = (Path(place) for place in sys.path if place and is_local(Path(place) / "x"))
    places = [root, *others]
    waiting = [("", path, root)] if is_alone else list(files_of(name, [root]))
    sources: dict[str, str] = {}
    files: set[Path] = set()
    while waiting:
        module, file, place = waiting.pop()
        if file in files:
            continue
        files.add(file)
        text = file.read_bytes().decode("utf-8", "replace").replace("\r\n", "\n")
        sources[file.relative_to(place).as_posix()] = text
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        for imported in imported_names(text, package):
            waiting += files_of(imported, places)
    return sources


def _file(module: str) -> str | None:
    """The file of a loaded module, None without one."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return str(file) if file and str(file).endswith(".py") else None


def _kind(value: object) -> Any:
    return value if isinstance(value, type | FunctionType) else type(value)


def _paths(values: Mapping[str, Any]) -> Iterator[str]:
    """Those arguments that are paths of files."""
    for value in values.values():
        if isinstance(value, str | os.PathLike):
            path = os.fsdecode(value)
            try:
                is_file = Path(path).expanduser().is_file()
            except (OSError, ValueError, RuntimeError):  # a text that is no path
                continue
            if is_file:
                yield path


def _behaviour(kind: type[Any]) -> str:
    """Version of the behaviour of a built-in class."""
    version = getattr(kind, "BEHAVIOUR", None)
    if version is None:
        return _distribution(_OURS)
    packages = getattr(kind, "BEHAVIOUR_PACKAGES", ())
    return ", ".join([f"version {version}", *map(_distribution, packages)])


def _distribution(name: str) -> str:
    """The distribution of a module, or of this name, with its version."""
    from importlib.metadata import packages_distributions  # takes its time

    top = _DISTRIBUTION if name == _OURS else name.partition(".")[0]
    if version := _installed(top):
        return f"{top} {version}"
    names = sorted(set(packages_distributions().get(top, ())))
    return ", ".join(f"{one} {_installed(one)}" for one in names) or f"{top} of unknown version"


def _installed(name: str) -> str | None:
    """The version of a distribution; None if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version  # takes its time

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def package_versions() -> dict[str, str]:
    """Versions of Python and of `PACKAGES`."""
    versions = {name: _installed(name) or "unknown" for name in PACKAGES}
    return {"python": platform.python_version(), **versions}


def changed_packages(recorded: object) -> list[str]:
    """How the versions of packages differ from a campaign's, each in words."""
    theirs, ours = recorded if isinstance(recorded, Mapping) else {}, package_versions()
    return [f"{k} {v}, now {ours.get(k)}" for k, v in theirs.items() if ours.get(k) != v]


def digest_of_file(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        OSError: it cannot be read.
    """
    place = path.expanduser()
    state = place.stat()
    return _digest(str(place.absolute()), state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=64)  # large ones are read once
def _digest(path: str, size: int, changed: int) -> str:  # noqa: ARG001
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# Described parts, see `frenetic.spec.part_record.describe`


def over_each_other(described: object) -> Iterator[Mapping[str, Any]]:
    """A described part and those under it, from the outside; an empty one if it is none."""
    part = described if isinstance(described, Mapping) else {}
    yield part
    while isinstance(part.get("driver"), Mapping):
        part = part["driver"]
        yield part


def innermost(described: object) -> Mapping[str, Any]:
    """A described part, without layers over it."""
    *_, inner = over_each_other(described)
    return inner


def differences(kind: str, recorded: object, ours: object) -> tuple[str, ...]:
    """How a described part differs from a recorded one, with those under it, each in words."""
    old, new = (one if isinstance(one, Mapping) else {} for one in (recorded, ours))
    if old.get("class") != new.get("class"):
        return (f"{kind} is {part_name(new)}, it was {part_name(old)}",)
    texts = [
        f"{name} is {_shown(theirs.get(name))}, it was {_shown(mine.get(name))}"
        for mine, theirs in [(old.get("options") or {}, new.get("options") or {})]
        for name in [*mine, *(name for name in theirs if name not in mine)]
        if mine.get(name) != theirs.get(name)
    ]
    if old.get("version") != new.get("version"):
        texts.append(f"it is {new.get('version')}, it was {old.get('version')}")
    found = tuple(f"{kind} {part_name(new)}: {text}" for text in texts)
    if "driver" in old or "driver" in new:
        found += differences(kind, old.get("driver"), new.get("driver"))
    return found


def other_version(kind: str, recorded: object, ours: object) -> str:
    """How a part is another version of a recorded one, in words, whatever its arguments and layers.

    Empty if it is the same version, another part, or if nothing is recorded.
    """
    old, new = (innermost(one) for one in (recorded, ours))
    if old.get("class") != new.get("class") or old.get("version") == new.get("version"):
        return ""
    return (
        f"{kind} {part_name(new)} is another version than the campaign's: it is"
        f" {new.get('version')}, it was {old.get('version')}"
    )


def comparison_key(*described: object) -> str:
    """Described parts as JSON that is equal for equal ones."""
    return json.dumps(described, sort_keys=True)


def short_version(described: object) -> str:
    """The version of a described part; empty if it is not recorded."""
    version = described.get("version") if isinstance(described, Mapping) else None
    return str(version or "")


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
