"""Fingerprints of a campaign's parts: what tells two versions of a driver apart.

A fingerprint is taken of what is on disk when it is taken, in the process that asks for it:

- of a part of your own, the source of its module and of the local modules that this one imports,
  transitively, comments included. Local is what is neither in the standard library nor in a
  ``site-packages``; a package in an editable install is local. Of a class of a notebook or script,
  the source of the class and of what it uses there;
- of an installed part, the version of its distribution; of a built-in one, its declared behaviour
  version, ``BEHAVIOUR``, which is raised when its results change;
- of files that are arguments, such as models and profiles, their content.

Modules that are imported by a computed name, and the data that a part opens by itself, are not in
it.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import os
import platform
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from importlib.util import resolve_name
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic.errors import describe_error
from frenetic.registry import USER_MODULE, is_local, made_by

FIRST_VERSION: Final = "version 1"
"""Version of a built-in behaviour that campaigns of before there were versions have, too."""
SHORT: Final = 8
"""Characters of a digest for people."""
_OURS: Final = "frenetic"
_DISTRIBUTION: Final = "frenetic-roads"
PACKAGES: Final = (_DISTRIBUTION, "numpy", "numba", "scipy")
"""Distributions that a campaign's results depend on."""
_MAIN: Final = frozenset({"__main__", "__mp_main__"})
_CUT: Final = 200  # characters of a long argument in older records
_SHOWN: Final = 60  # characters of an argument for people
_CHUNK: Final = 1 << 20
_PYC_HEADER: Final = 16  # bytes, with the time of the source
_MOST_FILES: Final = 1000
"""Most files of a folder that is an argument."""


@dataclass(frozen=True)
class Fingerprint:
    """What tells a version of a part apart from others."""

    version: str = ""
    """Declared version, such as ``version 1`` or ``my-drivers 1.2``; empty for own source alone."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Name of a module's file, of a class in a notebook or of an argument -> SHA-256."""
    trouble: str = ""
    """Why it is incomplete; empty if it is whole."""

    @property
    def digest(self) -> str:
        """The first characters of a digest of all that is in it."""
        content = json.dumps([self.version, dict(sorted(self.files.items()))])
        return hashlib.sha256(content.encode()).hexdigest()[:SHORT]

    def to_json(self) -> dict[str, JSONValue]:
        """The form in a campaign's record."""
        document: dict[str, JSONValue] = {"digest": self.digest}
        if self.version:
            document["version"] = self.version
        if self.files:
            document["files"] = dict(sorted(self.files.items()))
        if self.trouble:
            document["trouble"] = self.trouble
        return document


def fingerprint_of(part: object, arguments: Mapping[str, Any] | None = None) -> Fingerprint:
    """The fingerprint of a strategy, driver, layer, simulator or other part; never raises.

    Args:
        part: the object.
        arguments: of its constructor.
    """
    try:
        return _Taker().take(part, arguments or {})
    except Exception as error:  # foreign classes, loaders and files may raise anything
        return Fingerprint(trouble=f"no fingerprint is possible: {describe_error(error)}")


@dataclass(frozen=True)
class Differences:
    """How a part differs from a recorded one."""

    changed: tuple[str, ...] = ()
    """What changed, each in a few words."""
    unknown: tuple[str, ...] = ()
    """What cannot be told, likewise."""


def differences(kind: str, recorded: object, ours: object) -> Differences:
    """How a part differs from a recorded one, with those under it.

    Args:
        kind: of the part, for the words.
        recorded: as `frenetic.spec.describe` gives it, or only its fingerprint; a record of an
            older version lacks fingerprint and arguments.
        ours: likewise.
    """
    old, new = (one if isinstance(one, Mapping) else {} for one in (recorded, ours))
    if "class" not in new:
        old, new = ({"fingerprint": one} if one else {} for one in (old, new))
    elif old.get("class") != new["class"]:
        return Differences((f"{kind} is {_name(new)}, it was {_name(old)}",))
    what = f"{kind} {_name(new)}" if "class" in new else kind
    before, now = old.get("fingerprint"), new.get("fingerprint")
    changed = list(_changed_options(old, new))
    unknown = []
    if not isinstance(before, Mapping) or not isinstance(now, Mapping):
        unknown.append(f"{what}: the campaign has no fingerprint of it")
    else:
        troubles = [str(one["trouble"]) for one in (before, now) if one.get("trouble")]
        unknown += [f"{what}: {trouble}" for trouble in dict.fromkeys(troubles)]
        changed += _changed_content(before, now)
    found = Differences(tuple(f"{what}: {text}" for text in changed), tuple(unknown))
    if "driver" in old or "driver" in new:
        inner = differences(kind, old.get("driver"), new.get("driver"))
        found = Differences(found.changed + inner.changed, found.unknown + inner.unknown)
    return found


def other_version(kind: str, recorded: object, ours: object) -> str:
    """How a part is another version of a recorded one, in words, whatever its arguments and layers.

    Empty if it is the same version, another part, or if nothing is recorded.
    """
    old, new = (innermost(one) for one in (recorded, ours))
    before, now = old.get("fingerprint"), new.get("fingerprint")
    if old.get("class") != new.get("class") or not before or not now:
        return ""
    changed = "; ".join(_changed_content(before, now))
    return f"{kind} {_name(new)} is another version than the campaign's: {changed}" * bool(changed)


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


def comparable(described: Any) -> Any:
    """A described part in a form that is equal for equal ones.

    Fingerprints of first versions are left out, since older campaigns have them unrecorded.
    """
    if not isinstance(described, Mapping):
        return described
    kept = {name: one if name == "options" else comparable(one) for name, one in described.items()}
    return {
        name: one
        for name, one in kept.items()
        if not (isinstance(one, Mapping) and one.get("version") == FIRST_VERSION)
    }


def comparison_key(*described: object) -> str:
    """Described parts as JSON that is equal for equal ones, see `comparable`."""
    return json.dumps([comparable(part) for part in described], sort_keys=True)


def short_version(described: object) -> str:
    """The version of a described part in a few words; empty if it is not recorded."""
    fingerprint = described.get("fingerprint") if isinstance(described, Mapping) else None
    if not isinstance(fingerprint, Mapping):
        return ""
    if fingerprint.get("files"):
        return f"source {fingerprint.get('digest')}"
    return str(fingerprint.get("version", ""))


def _name(described: Mapping[str, Any]) -> str:
    return str(described.get("class", "unknown")).rpartition(":")[2]


def _changed_options(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    """Arguments that differ, of those that both records can hold."""
    before, now = (one.get("options") for one in (old, new))
    before, now = (one if isinstance(one, Mapping) else {} for one in (before, now))
    # Older records lack the arguments of users' own parts, and new options of built-in ones have
    # the effect that was there before, or their version is raised.
    is_built_in = str(new.get("class", "")).startswith(f"{_OURS}.")
    may_be_new = is_built_in or "fingerprint" not in old
    for name in [*before, *(name for name in now if name not in before)]:
        if name not in now:
            yield f"{name} is gone, it was {_shown(before[name])}"
        elif name not in before:
            if not may_be_new:
                yield f"{name} is {_shown(now[name])}, it was not there"
        elif before[name] != now[name] and ("fingerprint" in old or not _was_cut(before[name])):
            yield f"{name} is {_shown(now[name])}, it was {_shown(before[name])}"


def _was_cut(value: object) -> bool:
    """Whether an older version may have recorded only a part of a long value."""
    return isinstance(value, str) and (len(value) >= _CUT or " at 0x" in value or "..." in value)


def _changed_content(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    version, before = new.get("version", ""), old.get("version", "")
    if version != before:
        yield f"it is {version or 'own source'}, it was {before or 'own source'}"
    files, known = new.get("files", {}), old.get("files", {})
    for name in [*known, *(name for name in files if name not in known)]:
        if name not in files:
            yield f"{name} is gone"
        elif name not in known:
            # A file that is an argument and was not there is what the part writes.
            if not name.endswith(")"):
                yield f"{name} is new"
        elif files[name] != known[name]:
            yield f"{name} was changed"


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."


class _Taker:
    """Collects what makes a fingerprint."""

    def __init__(self) -> None:
        self.versions: list[str] = []
        self.files: dict[str, str] = {}
        self.troubles: list[str] = []
        self._is_built_in = False
        self._modules: list[str] = []
        self._seen: set[str] = set()

    def take(self, part: object, arguments: Mapping[str, Any]) -> Fingerprint:
        made = made_by(part)
        self._is_built_in = type(part).__module__.partition(".")[0] == _OURS
        if isinstance(part, FunctionType):
            self._add_used(part)
        else:
            self._add_class(type(part))
        if made is not None and made.factory is not type(part):
            self._add_used(made.factory)
        for name, value in arguments.items():
            self._add_argument(name, value)
        while self._modules:
            self._add_module(self._modules.pop())
        return Fingerprint(", ".join(self.versions), self.files, "; ".join(self.troubles))

    def _add_class(self, kind: type[Any]) -> None:
        is_own = False
        for base in inspect.getmro(kind):
            top = base.__module__.partition(".")[0]
            if top in sys.stdlib_module_names and base.__module__ not in _MAIN:
                continue
            if top == _OURS:
                # The behaviour of a class covers that of its own bases.
                version = _behaviour(base)
                self._add_version(f"{base.__qualname__} {version}" if is_own else version)
                break
            if base.__module__ in _MAIN:
                is_own = True
                self._add_piece(base)
            elif _is_local(_spec(base.__module__)):
                is_own = True
                self._modules.append(base.__module__)
            else:
                self._add_version(_distribution(base.__module__))

    def _add_argument(self, name: str, value: object, depth: int = 0) -> None:
        if isinstance(value, str | os.PathLike):
            self._add_path(name, value)
        elif isinstance(value, Mapping) and depth < 3:
            for key, item in value.items():
                self._add_argument(f"{name}.{key}", item, depth + 1)
        elif isinstance(value, list | tuple | set | frozenset) and depth < 3:
            is_set = isinstance(value, set | frozenset)  # whose order differs between processes
            for item in sorted(value, key=repr) if is_set else value:
                self._add_argument(name, item, depth + 1)
        else:
            self._add_used(value if isinstance(value, type | FunctionType) else type(value))

    def _add_version(self, version: str) -> None:
        if version and version not in self.versions:
            self.versions.append(version)

    def _add_path(self, name: str, path: str | os.PathLike[Any]) -> None:
        try:
            place = Path(os.fsdecode(path)).expanduser()
            is_file, is_folder = place.is_file(), place.is_dir()
        except (OSError, ValueError, RuntimeError):  # a text that is no path
            return
        # A word such as "models" is a folder only if it is given as one.
        is_folder &= not isinstance(path, str) or "/" in path or os.sep in path
        try:
            if is_file:
                self.files[f"{name} ({place.name})"] = digest_of_file(place)
            elif is_folder and not self._is_built_in:
                self.files[f"{name} ({place.name}/)"] = _digest_of_folder(place)
        except OSError as error:
            self.troubles.append(f"{name} {place} cannot be read: {error.strerror or error}")
        except ValueError as error:
            self.troubles.append(f"{name} {place} {error}")

    # Local modules

    def _add_module(self, name: str) -> None:
        """A local module, its packages, and what it imports."""
        if name in self._seen or name in _MAIN:
            return
        self._seen.add(name)
        if name.partition(".")[0] in sys.stdlib_module_names | {_OURS}:
            return
        package, _, _ = name.rpartition(".")
        if package:
            self._add_module(package)
        spec = _spec(name)
        if spec is None or not _is_local(spec):
            return
        file = _file_name(spec)
        try:
            source, data = _content(spec)
            self.files[file] = hashlib.sha256(data).hexdigest()
            if source is not None:
                self._modules += _imports(source, spec.parent or "")
        except Exception as error:  # a foreign loader, or no Python
            self.troubles.append(f"{file} cannot be read: {describe_error(error)}")
        if name in sys.modules:
            held = map(_module_of, list(vars(sys.modules[name]).values()))
            self._modules += [module for module in held if module is not None]

    # Classes and functions of a notebook or script

    def _add_piece(self, piece: Any) -> None:
        """A class or function of ``__main__``, with all of it that it uses."""
        name = f"{piece.__module__}.{piece.__qualname__}"
        if name in self._seen:
            return
        self._seen.add(name)
        try:
            source = inspect.getsource(piece)
        except (OSError, TypeError):
            self.troubles.append(f"the source of {piece.__qualname__} is not available")
            return
        self.files[name] = hashlib.sha256(source.encode()).hexdigest()
        known = vars(sys.modules[piece.__module__])
        for used in sorted({one for code in _codes(piece) for one in code.co_names}):
            value = known.get(used)
            if isinstance(value, bool | int | float | str):
                content = f"{used}={value!r}"
                self.files[f"{piece.__module__}.{used}"] = hashlib.sha256(
                    content.encode()
                ).hexdigest()
            else:
                self._add_used(value)

    def _add_used(self, value: object) -> None:
        """A module, class or function that something uses."""
        module = _module_of(value)
        if module in _MAIN and hasattr(value, "__qualname__"):
            self._add_piece(value)
        elif module is not None:
            self._modules.append(module)


def _behaviour(kind: type[Any]) -> str:
    """Version of the behaviour of a built-in class."""
    version = getattr(kind, "BEHAVIOUR", None)
    if version is None:
        return _distribution(_OURS)
    packages = getattr(kind, "BEHAVIOUR_PACKAGES", ())
    return ", ".join([f"version {version}", *map(_distribution, packages)])


def _distribution(name: str) -> str:
    """The distribution of a module, or of this name, with its version."""
    from importlib.metadata import (  # takes its time, and no help needs it
        PackageNotFoundError,
        packages_distributions,
        version,
    )

    top = _DISTRIBUTION if name == _OURS else name.partition(".")[0]
    try:
        return f"{top} {version(top)}"
    except PackageNotFoundError:
        pass
    names = sorted(set(packages_distributions().get(top, ())))
    return ", ".join(f"{one} {version(one)}" for one in names) or f"{top} of unknown version"


def package_versions() -> dict[str, str]:
    """Versions of Python and of `PACKAGES`."""
    from importlib.metadata import PackageNotFoundError, version  # as above

    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions


def changed_packages(recorded: object) -> list[str]:
    """How the versions of packages differ from a campaign's, each in words."""
    theirs, ours = recorded if isinstance(recorded, Mapping) else {}, package_versions()
    return [f"{k} {v}, now {ours.get(k)}" for k, v in theirs.items() if ours.get(k) != v]


def _spec(name: str) -> ModuleSpec | None:
    """The spec of a module, without importing anything; None if there is no such module."""
    module = sys.modules.get(name)
    if module is not None:
        spec = getattr(module, "__spec__", None)
        return spec if isinstance(spec, ModuleSpec) else None
    package, _, _ = name.rpartition(".")
    path = None
    if package:
        parent = _spec(package)
        if parent is None or parent.submodule_search_locations is None:
            return None
        path = list(parent.submodule_search_locations)
    for finder in sys.meta_path:
        find = getattr(finder, "find_spec", None)
        found = None if find is None else find(name, path)
        if isinstance(found, ModuleSpec):
            return found
    return None


def _is_local(spec: ModuleSpec | None) -> bool:
    """Whether a module is neither of the standard library nor installed."""
    if spec is None or spec.origin is None or not spec.has_location:
        return False
    return is_local(Path(spec.origin))


def _content(spec: ModuleSpec) -> tuple[str | None, bytes]:
    """The source of a module, None without one, and the bytes that tell its versions apart."""
    loader: Any = spec.loader
    get_source = getattr(loader, "get_source", None)
    source = get_source(spec.name) if callable(get_source) else None
    if isinstance(source, str):
        return source, source.replace("\r\n", "\n").encode("utf-8", "surrogatepass")
    data = bytes(loader.get_data(spec.origin))
    is_compiled = Path(str(spec.origin)).suffix == ".pyc"
    return None, data[_PYC_HEADER:] if is_compiled else data


def _file_name(spec: ModuleSpec) -> str:
    """Name of a module's file, from where its packages lie; the same wherever that is."""
    origin = Path(str(spec.origin))
    if spec.name.startswith(USER_MODULE):
        return origin.name
    *packages, own = spec.name.split(".")
    if spec.submodule_search_locations is not None:
        packages, own = [*packages, own], "__init__"
    return "/".join([*packages, f"{own}{origin.suffix}"])


def _imports(source: str, package: str) -> Iterator[str]:
    """Names that may be modules which a source imports, wherever in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            try:
                place = resolve_name("." * node.level + (node.module or ""), package)
            except ImportError:
                continue
            yield place
            yield from (f"{place}.{alias.name}" for alias in node.names)


def _module_of(value: object) -> str | None:
    """Name of a module, or of that of a class or function; None for other values."""
    try:
        name = value.__name__ if isinstance(value, ModuleType) else value.__module__
    except Exception:  # a foreign object may raise anything
        return None
    return name if isinstance(name, str) else None


def _codes(piece: Any) -> Iterator[CodeType]:
    """The code of a function, or of all functions of a class, nested ones included."""
    if isinstance(piece, type):
        for value in vars(piece).values():
            if isinstance(value, property):
                yield from (c for f in (value.fget, value.fset) if f for c in _codes(f))
            elif not isinstance(value, type):
                yield from _codes(getattr(value, "__func__", value))
        return
    code = getattr(inspect.unwrap(piece) if callable(piece) else piece, "__code__", None)
    pending = [code] if isinstance(code, CodeType) else []
    while pending:
        one = pending.pop()
        yield one
        pending += [const for const in one.co_consts if isinstance(const, CodeType)]


_digests: dict[tuple[str, int, int, int], str] = {}
"""Place, inode, size and time of a file -> its digest: large ones are read once."""


def digest_of_file(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        OSError: it cannot be read.
    """
    state = path.stat()
    key = (str(path.absolute()), state.st_ino, state.st_size, state.st_mtime_ns)
    if key not in _digests:
        digest = hashlib.sha256()
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK):
                digest.update(chunk)
        _digests[key] = digest.hexdigest()
    return _digests[key]


def _digest_of_folder(path: Path) -> str:
    """Digest of the files in a folder, their names included.

    Raises:
        ValueError: they are too many.
    """
    digest = hashlib.sha256()
    files = []
    for file in path.rglob("*"):
        if file.is_file():
            files.append(file)
            if len(files) > _MOST_FILES:
                raise ValueError(f"holds more than {_MOST_FILES} files: it is in no fingerprint")
    for file in sorted(files):
        name = file.relative_to(path).as_posix()
        digest.update(json.dumps([name, digest_of_file(file)]).encode())
    return digest.hexdigest()
