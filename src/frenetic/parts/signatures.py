"""Signatures of the user: keyed digests of code and of the folder from which it was loaded.

The key lies in the user's own folder, `user_folder`. A signature covers the names and options of
parts, their folder and the sources stored beside it, but no digests of files: a digest cannot bind
what a file imports.
"""

from __future__ import annotations

import hmac
import json
import os
import secrets
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from frenetic._support.json_value import plain
from frenetic.errors import FreneticError
from frenetic.parts.named_code import Parts

HOME_VARIABLE: Final = "FRENETIC_HOME"
"""Environment variable that names another folder for the user's key and list of allowed files."""
_KEY_FILE: Final = "key"
_KEY_LENGTH: Final = 32  # [bytes], as long as a digest of SHA-256
_SIGNATURE_VERSION: Final = "frenetic 1"
"""First entry of what is signed; another version of the entries needs another text."""


def user_folder() -> Path:
    """Return the folder of the user's key and list of allowed files.

    Raises:
        FreneticError: `HOME_VARIABLE` holds a relative path.
    """
    if text := os.environ.get(HOME_VARIABLE):
        if not (folder := Path(text).expanduser()).is_absolute():
            raise FreneticError(f"{HOME_VARIABLE} is {text}: the whole path of a folder is needed")
        return folder
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", "~")).expanduser() / "frenetic"
    if sys.platform == "darwin":
        return Path("~/Library/Application Support/frenetic").expanduser()
    return Path(os.environ.get("XDG_DATA_HOME") or "~/.local/share").expanduser() / "frenetic"


def sign(code: Parts, folder: Path | str, sources: object = None) -> str | None:
    """Return the user's signature of code and of the folder from which it is loaded.

    Args:
        code: result of `named_code`.
        folder: folder from which the code was loaded.
        sources: name -> text of the parts' sources, if they are stored beside the signature.

    Returns:
        The signature, as text; empty if there is no code to sign; None if the user's folder cannot
        be written, which `unsigned_text` puts into words.
    """
    if not code:
        return ""
    key = _read_key(may_create=True)
    return None if key is None else _signature(key, code, folder, sources)


def is_signed(signature: object, code: Parts, folder: object, sources: object = None) -> bool:
    """Return whether the present user signed this code, folder and these sources.

    The time of the check does not depend on the signature. Signature, folder and sources may be
    any values, since they may come from a stranger's file.
    """
    if not (isinstance(signature, str) and isinstance(folder, (str, Path))):
        return False
    key = _read_key(may_create=False)
    if key is None:
        return False
    expected = _signature(key, code, folder, sources)
    return hmac.compare_digest(expected.encode(), signature.encode("utf-8", "replace"))


def unsigned_text() -> str:
    """Return one line that says why `sign` returned no signature, and what to do."""
    try:
        file = user_folder() / _KEY_FILE
    except RuntimeError:  # there is no home folder
        file = Path("~", _KEY_FILE)
    return (
        f"{file} cannot be written, or is no key, so later commands ask about your own parts again:"
        f" remove it, or set {HOME_VARIABLE} to a folder where it can"
    )


def _signature(key: bytes, code: Parts, folder: Path | str, sources: object) -> str:
    """Return the keyed digest (HMAC-SHA-256) of code, folder and sources, as hexadecimal text."""
    signed = [_SIGNATURE_VERSION, code, os.path.realpath(folder), sources or {}]
    return hmac.new(key, canonical_json(signed), "sha256").hexdigest()


def canonical_json(value: object) -> bytes:
    """Return a value as JSON that is the same for equal values; other objects become their repr."""
    return json.dumps(value, sort_keys=True, default=_as_json).encode()


def _as_json(value: object) -> object:
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    try:
        return plain(value)
    except ValueError:  # an object that came from Python, not from a file
        return repr(value)


def _read_key(*, may_create: bool) -> bytes | None:
    """Return the user's key; None if it does not exist, cannot be read or is damaged.

    Args:
        may_create: whether to create a missing key. Processes that create it at the same time
            get the same key.
    """
    with suppress(OSError, ValueError, RuntimeError):
        file = user_folder() / _KEY_FILE
        if may_create and not file.exists():
            _write_key(file)
        key = bytes.fromhex(file.read_text("ascii"))
        return key if len(key) == _KEY_LENGTH else None
    return None


def _write_key(file: Path) -> None:
    """Write a new key that its user alone can read, unless another process was first.

    Raises:
        OSError: the file cannot be written.
    """
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    descriptor, partial = tempfile.mkstemp(dir=file.parent)  # readable by its user alone
    text = secrets.token_hex(_KEY_LENGTH)
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as opened:
            opened.write(text)
        os.link(partial, file)  # unlike a renaming, it replaces nothing
    except FileExistsError:  # another process was first: its key stands
        return
    except OSError:  # a file system without links
        with suppress(FileExistsError):
            write_at_once(file, text, os.O_EXCL)
    finally:
        Path(partial).unlink()


def write_at_once(file: Path, text: str, flag: int) -> None:
    """Write a text to a file by one call of the system, so that texts of processes do not mix.

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
