"""Versions of a campaign's parts, which tell two states of a driver apart.

The version of a built-in part is its declared ``BEHAVIOUR``, the version of an installed part its
distribution's. A part of your own has a digest of its source: its file and the local modules that
it imports, directly or not. A module is local unless it lies in the standard library or a
``site-packages``; a package in an editable install is local. Files that are arguments, such as
models, count with their content. The digest leaves out modules that are imported by a computed name
and data that a part opens by itself.
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
from frenetic.parts.registry import part_name
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
    """The version of a part, and its source as far as that is the user's own."""

    text: str
    """Text such as ``version 3``, ``my-drivers 1.2`` or ``source 1f3a9c07``."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """Path of a local file, from the folder of its packages -> its text."""


def version_of(
    part: object,
    arguments: Mapping[str, Any] | None = None,
    construction: Construction | None = None,
) -> Version:
    """Return the version of a strategy, driver, wrapper, simulator or other part; never raise.

    Args:
        part: the object.
        arguments: of its constructor.
        construction: call that made the part of its name, if any; its factory may be no class.
    """
    try:
        return _version(part, arguments or {}, construction)
    except Exception as error:  # foreign classes, loaders and files may raise anything
        return Version(f"unknown ({describe_error(error)})")


def _version(
    part: object, arguments: Mapping[str, Any], construction: Construction | None
) -> Version:
    kinds = inspect.getmro(type(part)) if not isinstance(part, FunctionType) else [part]
    texts: list[str] = []
    sources: dict[str, str] = {}
    factory = type(part) if construction is None else construction.factory
    values = [] if factory is type(part) else [factory]
    for kind in [*kinds, *values, *map(_kind, arguments.values())]:
        name = str(kind.__module__)
        top, file = name.partition(".")[0], _file(name)
        if top == _OURS:
            if kind in kinds:  # the behaviour of a class covers its bases
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
    """Return the sources of ``file.py:Class`` or ``package.module:Class`` by the files' names.

    Local modules that it imports are among them; nothing is imported. Relative files and the user's
    modules are looked for in the current folder.

    Raises:
        OSError: a file cannot be read.
    """
    module = name.rpartition(":")[0]
    if not module.endswith(".py"):
        is_ours = module.partition(".")[0] in ("", _OURS)
        local_file = None if is_ours else _local_file(module, Path.cwd())
        return {} if local_file is None else _sources(local_file, module)
    file = Path(module).expanduser().resolve()
    return _sources(file, f"{USER_MODULE}{file.stem}") if file.is_file() else {}


def edited_files(names: Iterable[str], sources: object) -> list[str]:
    """Return the names of a user's files that differ from a campaign's copies; import nothing.

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
    """Return the file of a local module as an import finds it; None if there is none."""
    parts = Path(*module.split("."))
    for place in map(Path, [*sys.path, str(folder)]):
        for file in (place / parts.with_suffix(".py"), place / parts / "__init__.py"):
            if file.is_file():
                return file if is_local(file) else None
    return None


def _sources(path: Path, name: str) -> dict[str, str]:
    """Return the sources of a module and its local imports; import nothing."""
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
    """Return the file of a loaded module; None without a file."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return str(file) if file and str(file).endswith(".py") else None


def _kind(value: object) -> Any:
    return value if isinstance(value, type | FunctionType) else type(value)


def _paths(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield the arguments that are paths of files."""
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
    """Return the version of the behaviour of a built-in class."""
    version = getattr(kind, "BEHAVIOUR", None)
    if version is None:
        return _distribution(_OURS)
    packages = getattr(kind, "BEHAVIOUR_PACKAGES", ())
    return ", ".join([f"version {version}", *map(_distribution, packages)])


def _distribution(name: str) -> str:
    """Return the distribution of a module, or of this name, with its version."""
    from importlib.metadata import packages_distributions  # takes its time

    top = _DISTRIBUTION if name == _OURS else name.partition(".")[0]
    if version := _installed(top):
        return f"{top} {version}"
    names = sorted(set(packages_distributions().get(top, ())))
    return ", ".join(f"{name} {_installed(name)}" for name in names) or f"{top} of unknown version"


def _installed(name: str) -> str | None:
    """Return the version of a distribution; None if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version  # takes its time

    try:
        return version(name)
    except PackageNotFoundError:
        return None


def package_versions() -> dict[str, str]:
    """Return the versions of Python and of `PACKAGES`."""
    versions = {name: _installed(name) or "unknown" for name in PACKAGES}
    return {"python": platform.python_version(), **versions}


def changed_packages(recorded: object) -> list[str]:
    """Return a text about each package whose version differs from a campaign's."""
    before = recorded if isinstance(recorded, Mapping) else {}
    now = package_versions()
    return [f"{k} {v}, now {now.get(k)}" for k, v in before.items() if now.get(k) != v]


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        OSError: the file cannot be read.
    """
    place = path.expanduser()
    state = place.stat()
    return _digest(str(place.absolute()), state.st_size, state.st_mtime_ns)


@lru_cache(maxsize=64)  # large ones are read once
def _digest(path: str, size: int, changed: int) -> str:  # noqa: ARG001
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# Records of parts, see `frenetic.spec.part_record.describe`


def over_each_other(record: object) -> Iterator[Mapping[str, Any]]:
    """Yield a part's record and the records of the parts under it, outermost first."""
    part = record if isinstance(record, Mapping) else {}
    yield part
    while isinstance(part.get("driver"), Mapping):
        part = part["driver"]
        yield part


def innermost(record: object) -> Mapping[str, Any]:
    """Return the record of a part without the wrappers over it."""
    *_, inner = over_each_other(record)
    return inner


def differences(kind: str, before: object, now: object) -> tuple[str, ...]:
    """Return a text about each difference of two records of a part, with the parts under it."""
    old, new = (record if isinstance(record, Mapping) else {} for record in (before, now))
    if old.get("class") != new.get("class"):
        return (f"{kind} is {part_name(new)}, it was {part_name(old)}",)
    old_options, new_options = old.get("options") or {}, new.get("options") or {}
    texts = [
        f"{name} is {_shown(new_options.get(name))}, it was {_shown(old_options.get(name))}"
        for name in [*old_options, *(name for name in new_options if name not in old_options)]
        if old_options.get(name) != new_options.get(name)
    ]
    if old.get("version") != new.get("version"):
        texts.append(f"it is {new.get('version')}, it was {old.get('version')}")
    sentences = tuple(f"{kind} {part_name(new)}: {text}" for text in texts)
    if "driver" in old or "driver" in new:
        sentences += differences(kind, old.get("driver"), new.get("driver"))
    return sentences


def other_version(kind: str, before: object, now: object) -> str:
    """Return a text if two records show different versions of a part.

    The text is empty for equal versions, for two different parts, and without a record. Options
    and wrappers do not count.
    """
    old, new = (innermost(record) for record in (before, now))
    if old.get("class") != new.get("class") or old.get("version") == new.get("version"):
        return ""
    return (
        f"{kind} {part_name(new)} is another version than the campaign's: it is"
        f" {new.get('version')}, it was {old.get('version')}"
    )


def comparison_key(*records: object) -> str:
    """Return records of parts as JSON that is equal for equal records."""
    return json.dumps(records, sort_keys=True)


def short_version(record: object) -> str:
    """Return the version in a part's record; empty if the record has none."""
    version = record.get("version") if isinstance(record, Mapping) else None
    return str(version or "")


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
