"""Trust: which code that a file names may be loaded, since its user has signed, listed or named it.

A campaign, a road's file, a TOML or a profile names its driver, simulator and strategy, and a
stranger may have written it. `named_code` finds the parts that name code; such code is loaded

- if the command names the part itself, or with ``--trust``: from the current folder;
- if this user's own commands wrote the file (`sign`, `is_signed`): from the folder that the
  signature names, and from no other;
- if this user has named or trusted it before in this very file of TOML (`allow`, `is_allowed`), in
  the same current folder.

The key of the signatures and the list of such files lie in the user's own folder, `user_folder`.
Neither holds digests of files: a digest cannot bind what the file imports. Each command asks
`require_trusted` before it makes a part; workers, clusters and `compare`'s child process load only
code that passed. A script in Python that makes the parts of a file has no such check.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import re
import secrets
import shlex
import sys
import tempfile
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from frenetic._support.files import write_file
from frenetic._support.json_value import plain
from frenetic._support.option_text import part_word
from frenetic._support.printable import shortened
from frenetic.errors import FreneticError
from frenetic.parts.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES, Registry
from frenetic.parts.versions import sources_named

Parts: TypeAlias = Mapping[str, tuple[str, Mapping[str, Any]]]
"""Kind of a part -> its name and options.

The kinds are the keys of `REGISTRIES`, ``generator``, of a bench, and ``workers``, for the address
of a scheduler. A word tells several parts of a kind apart, as in ``strategy 2``.
"""
VARIABLE: Final = "FRENETIC_HOME"
"""Environment variable with another folder for the user's key and list."""
REGISTRIES: Final[Mapping[str, Registry]] = {
    registry.kind: registry for registry in (STRATEGIES, DRIVERS, SIMULATORS, OBJECTIVES)
}
NOT_DRIVING: Final = ("strategy", "objective", "workers")
"""Kinds of parts that reruns of a campaign's roads do not make."""
_PROGRAMS: Final = frozenset({"home", "user", "python", "copy", "pipeline", "path"})
"""Options that name a program to start, or a folder of code, whatever their value looks like."""
_FILE: Final = re.compile(r"[/\\]|^[.~]|\.[A-Za-z]\w*$")
"""Pattern of a path or the name of a file, such as ``net.onnx``."""
_PLAIN: Final = frozenset({"host"})
"""Options whose texts are no files though they have dots: names of computers."""
_KEY: Final = "key"
_KEY_BYTES: Final = 32  # as many as SHA-256 gives
_MOST_LISTED: Final = 1000  # files of TOML, the last ones
_LIST_BYTES: Final = 2**20  # of the list that are read; a thousand entries have about 200,000
_MOST_SHOWN: Final = 300  # characters of a part in a message


def user_folder() -> Path:
    """Return the user's own folder.

    Raises:
        FreneticError: `VARIABLE` holds a relative path.
    """
    if text := os.environ.get(VARIABLE):
        if not (place := Path(text).expanduser()).is_absolute():
            raise FreneticError(f"{VARIABLE} is {text}: the whole path of a folder is needed")
        return place
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", "~")).expanduser() / "frenetic"
    if sys.platform == "darwin":
        return Path("~/Library/Application Support/frenetic").expanduser()
    return Path(os.environ.get("XDG_DATA_HOME") or "~/.local/share").expanduser() / "frenetic"


def is_here(folder: Path) -> bool:
    """Return whether a folder is the current folder."""
    return folder.resolve() == Path.cwd()


# Named code


def named_code(parts: Parts) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the parts that name code: kind -> name and the options that count.

    A part that is neither built in nor installed by an entry point counts with all its options. Of
    the others only an option counts that names a program or a file.
    """
    code = {}
    for kind, (name, options) in parts.items():
        registry = REGISTRIES.get(_word(kind))
        is_known = registry is not None and name in {entry.name for entry in registry.entries()}
        counting = {
            option: value
            for option, value in options.items()
            if not is_known or _starts_code(option, value)
        }
        if counting or not is_known:
            code[kind] = name, counting
    return code


def _word(kind: str) -> str:
    """Return the kind of a part, without the word that tells it from others of its kind."""
    return kind.partition(" ")[0]


def _starts_code(option: str, value: object) -> bool:
    """Return whether an option names a program or a file."""
    if option in _PROGRAMS:
        return value is not None
    return option not in _PLAIN and names_file(value)


def names_file(value: object) -> bool:
    """Return whether an option's value is the path of a file, or holds such a path."""
    if isinstance(value, os.PathLike):
        return True
    if isinstance(value, Mapping):
        return any(map(names_file, value.values()))
    if isinstance(value, (list, tuple)):
        return any(map(names_file, value))
    return isinstance(value, str) and _FILE.search(value) is not None


# Signatures


def sign(code: Parts, folder: Path | str, sources: object = None) -> str | None:
    """Return the user's signature of code and of the folder from which it is loaded.

    Args:
        code: result of `named_code`.
        folder: from which the code was loaded.
        sources: name -> text of the sources of parts that are stored beside the signature.

    Returns:
        The signature, as text; empty if nothing names code, None if the user's folder cannot be
        written: `unsigned_text` says so.
    """
    if not code:
        return ""
    key = _key_of_user(may_create=True)
    return None if key is None else _signature(key, code, folder, sources)


def is_signed(signature: object, code: Parts, folder: object, sources: object = None) -> bool:
    """Return whether a signature is this user's, for this code, folder and these sources.

    The time of the check does not depend on the signature. Signature, folder and sources may be
    any values, since they may come from a stranger's file.
    """
    if not (isinstance(signature, str) and isinstance(folder, (str, Path))):
        return False
    key = _key_of_user(may_create=False)
    if key is None:
        return False
    known = _signature(key, code, folder, sources)
    return hmac.compare_digest(known.encode(), signature.encode("utf-8", "replace"))


def unsigned_text() -> str:
    """Return a line on why `sign` returned no signature, and what to do."""
    try:
        file = user_folder() / _KEY
    except RuntimeError:  # there is no home folder
        file = Path("~", _KEY)
    return (
        f"{file} cannot be written, or is no key, so later commands ask about your own parts again:"
        f" remove it, or set {VARIABLE} to a folder where it can"
    )


def _signature(key: bytes, code: Parts, folder: Path | str, sources: object) -> str:
    signed = ["frenetic 1", code, os.path.realpath(folder), sources or {}]
    return hmac.new(key, _canonical(signed), "sha256").hexdigest()


def _canonical(value: object) -> bytes:
    """Return JSON that is the same for the same value."""
    return json.dumps(value, sort_keys=True, default=_as_json).encode()


def _as_json(value: object) -> object:
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    try:
        return plain(value)
    except ValueError:  # an object of Python, which no file holds
        return repr(value)


def _key_of_user(*, may_create: bool) -> bytes | None:
    """Return the user's key; None if it does not exist, cannot be read or is damaged.

    Args:
        may_create: whether to create a missing key. Several processes that do so at once get the
            same key.
    """
    with suppress(OSError, ValueError, RuntimeError):
        file = user_folder() / _KEY
        if may_create and not file.exists():
            _write_key(file)
        key = bytes.fromhex(file.read_text("ascii"))
        return key if len(key) == _KEY_BYTES else None
    return None


def _write_key(file: Path) -> None:
    """Write a new key that its user alone can read, unless another process was first.

    Raises:
        OSError: the file cannot be written.
    """
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor, partial = tempfile.mkstemp(dir=file.parent)  # which is readable by its user alone
    text = secrets.token_hex(_KEY_BYTES)
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as opened:
            opened.write(text)
        os.link(partial, file)  # unlike a renaming, it replaces nothing
    except FileExistsError:
        return
    except OSError:  # a file system without links
        with suppress(FileExistsError):
            _write_at_once(file, text, os.O_EXCL)
    finally:
        Path(partial).unlink()


def _write_at_once(file: Path, text: str, flag: int) -> None:
    """Write a text to a file of the user's in one piece, for other processes write there, too.

    Args:
        file: the file; a new one is readable by its user alone.
        text: ASCII text.
        flag: `os.O_EXCL` for a file that must not exist, `os.O_APPEND` to append.

    Raises:
        OSError: the file cannot be written.
    """
    descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | flag, 0o600)
    try:
        os.write(descriptor, text.encode("ascii"))
    finally:
        os.close(descriptor)


# Files that a person wrote


def allow(path: Path | str, code: Parts, folder: Path | str | None = None) -> bool:
    """Note that a file of TOML may name code; return False if the list cannot be written.

    Args:
        path: the file.
        code: result of `named_code`.
        folder: folder from which the code is loaded; by default the current folder.
    """
    if is_allowed(path, code, folder):
        return True
    about = json.dumps(os.path.realpath(path))[:_MOST_SHOWN]  # for people
    with suppress(OSError, RuntimeError, FreneticError):
        file = _list_of_user()
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if len(lines := _listed()) >= _MOST_LISTED:
            last = "".join(f"\n{line}" for line in lines[-_MOST_LISTED // 2 :])
            write_file(file, last, remedy="")
        # The line break first: an interrupted process may have left half a line.
        _write_at_once(file, f"\n{_entry(path, code, folder)} {about}", os.O_APPEND)
        return True
    return False


def is_allowed(path: Path | str, code: Parts, folder: Path | str | None = None) -> bool:
    """Return whether `allow` has noted a file with the same code and folder."""
    entry = _entry(path, code, folder)
    return any(line.partition(" ")[0] == entry for line in _listed())


def _list_of_user() -> Path:
    return user_folder() / "allowed"


def _listed() -> list[str]:
    """Return the entries of the list, without damaged lines."""
    try:
        with _list_of_user().open("rb") as file:
            file.seek(-min(_LIST_BYTES, file.seek(0, os.SEEK_END)), os.SEEK_END)
            text = file.read(_LIST_BYTES).decode("ascii", "replace")
    except (OSError, RuntimeError):
        return []
    return [line for line in text.splitlines() if re.match(r"[0-9a-f]{64} ", line)]


def _entry(path: Path | str, code: Parts, folder: Path | str | None) -> str:
    """Return a digest of file, folder and code, which are allowed together."""
    places = [os.path.realpath(path), os.path.realpath(folder or "")]
    return hashlib.sha256(_canonical([places, code])).hexdigest()


# The check


class CodeClaim(NamedTuple):
    """The parts that a file names, and what it says of their signature."""

    parts: Parts
    """All parts that the file names, as it names them."""
    signature: object = None
    """Signature in the file; None without a signature."""
    folder: object = None
    """Folder of the code, as the file says."""
    sources: object = None
    """Sources that the file stores, as for `sign`."""


def require_trusted(
    source: Path | str,
    claim: CodeClaim,
    *,
    named: Parts = MappingProxyType({}),
    needed: Parts | None = None,
    is_trusted: bool = False,
    is_toml: bool = False,
    optional: Collection[str] = tuple(REGISTRIES),
) -> Path:
    """Return the folder from which the code may be loaded that a file or campaign names.

    Code that the command names itself is loaded from the current folder, whatever the answer.

    Args:
        source: the file or campaign.
        claim: parts and signature in the source.
        named: parts that the command names itself, with the options that it sets.
        needed: parts that the command makes; by default the parts of the source, with named parts
            in their places. An option of a named part that comes from the source has to be
            trusted, too. Parts of another file need another call.
        is_trusted: whether the command trusts the source: ``--trust``. The caller then signs a
            campaign or a road's file, with the returned folder.
        is_toml: whether a person may have written the source: named or trusted code is noted then.
        optional: kinds of parts for which the command has an option, for the message.

    Raises:
        FreneticError: the source names code that the user has neither signed nor allowed; one line
            says which, and what to do.
    """
    code, command_code, here = named_code(claim.parts), named_code(named), Path.cwd()
    needed_code = named_code({**claim.parts, **named} if needed is None else needed)
    asked = [kind for kind in needed_code if command_code.get(kind) != needed_code[kind]]
    folder = claim.folder
    if asked and is_signed(claim.signature, code, folder, claim.sources):
        if not Path(str(folder)).is_dir() and not is_trusted:
            texts, remedy = _in_words(asked, needed_code, optional)
            raise FreneticError(
                f"{source} names {texts}, code that was in {shortened(str(folder), _MOST_SHOWN)},"
                f" which is no folder now: if it is here, {remedy}"
            )
        if Path(str(folder)).is_dir():
            return Path(str(folder))
    if is_trusted or not asked:
        is_named = all(command_code.get(kind) == code[kind] for kind in code)
        if is_toml and code and (is_trusted or is_named):
            allow(source, code)
        return here
    if is_toml and is_allowed(source, code):
        return here
    texts, remedy = _in_words(asked, needed_code, optional)
    if folder and any(_is_missing(_word(kind), needed_code[kind][0]) for kind in asked):
        place = shortened(str(folder), _MOST_SHOWN)
        remedy = f"go to where it was as that says, {place}, and {remedy}"
    raise FreneticError(
        f"{source} names {texts}, code that you have not trusted: if you do, {remedy}"
    )


def _in_words(kinds: Iterable[str], parts: Parts, optional: Collection[str]) -> tuple[str, str]:
    """Return the parts in words, and the advice that makes a command load them."""
    texts, words, are_nameable = [], [], True
    for kind in kinds:
        word, (name, options) = _word(kind), parts[kind]
        texts.append(f"the {word} {shortened(name, _MOST_SHOWN)!r}")
        if word in optional:
            words += [f"--{word}", shortened(part_word(name, options), _MOST_SHOWN)]
        else:
            are_nameable = False
    remedy = f"name it yourself, {shlex.join(words)}, or add --trust"
    return " and ".join(texts), remedy if are_nameable else "add --trust"


def _is_missing(kind: str, name: str) -> bool:
    """Return whether the file or module of a part is missing; import nothing."""
    registry, place = REGISTRIES.get(kind), name.rpartition(":")[0] or name
    if registry is None or name in {entry.name for entry in registry.entries()}:
        return False
    try:
        if place.endswith(".py") or Path(place).suffix.lower() in registry.files:
            return not Path(place).expanduser().is_file()
        return not sources_named(name) and find_spec(place.partition(".")[0]) is None
    except (OSError, ValueError, RuntimeError):
        return False
