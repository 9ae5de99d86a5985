"""List of the files of TOML whose code their user has named or trusted before.

Each line is a digest of the file's path, the code that it names and the folder of the code. The
path follows for people who read the list. The list lies beside the user's key.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.errors import FreneticError
from frenetic.parts.named_code import Parts
from frenetic.parts.signatures import canonical_json, user_folder, write_at_once

_MAX_LINES: Final = 1000
"""Largest number of lines of the list; a longer list loses its older half. Our choice."""
_MAX_BYTES: Final = 2**20
"""Largest number of bytes read from the list's end; a thousand lines have about 200,000."""
_MAX_PATH: Final = 300
"""Largest number of characters of a path in a line, so that a line is written at once."""


def allow(path: Path | str, code: Parts, folder: Path | str | None = None) -> bool:
    """Note that a file may name code; return False if the list cannot be written.

    Args:
        path: file of TOML.
        code: result of `named_code`.
        folder: folder from which the code is loaded; by default the current folder.
    """
    if is_allowed(path, code, folder):
        return True
    path_text = json.dumps(os.path.realpath(path))[:_MAX_PATH]  # for people who read the list
    with suppress(OSError, RuntimeError, FreneticError):
        file = _list_file()
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if len(lines := _read_lines()) >= _MAX_LINES:
            newest = "".join(f"\n{line}" for line in lines[-_MAX_LINES // 2 :])
            write_file(file, newest, remedy="")
        # The line break first: an interrupted process may have left half a line.
        write_at_once(file, f"\n{_entry_digest(path, code, folder)} {path_text}", os.O_APPEND)
        return True
    return False


def is_allowed(path: Path | str, code: Parts, folder: Path | str | None = None) -> bool:
    """Return whether `allow` has noted a file with the same code and folder."""
    entry = _entry_digest(path, code, folder)
    return any(line.partition(" ")[0] == entry for line in _read_lines())


def _list_file() -> Path:
    """Return the path of the user's list of allowed files."""
    return user_folder() / "allowed"


def _read_lines() -> list[str]:
    """Return the last lines of the list, without damaged lines."""
    try:
        with _list_file().open("rb") as file:
            file.seek(-min(_MAX_BYTES, file.seek(0, os.SEEK_END)), os.SEEK_END)
            text = file.read(_MAX_BYTES).decode("ascii", "replace")
    except (OSError, RuntimeError):
        return []
    return [line for line in text.splitlines() if re.match(r"[0-9a-f]{64} ", line)]


def _entry_digest(path: Path | str, code: Parts, folder: Path | str | None) -> str:
    """Return a digest of file, folder and code, which are allowed together."""
    paths = [os.path.realpath(path), os.path.realpath(folder or "")]
    return hashlib.sha256(canonical_json([paths, code])).hexdigest()
