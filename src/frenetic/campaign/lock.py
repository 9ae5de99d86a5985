"""The lock that keeps a folder to one writer, and its holder."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout, lock_descriptor
from msgspec import Struct
from msgspec.json import encode

from frenetic._support.files import open_file
from frenetic._support.outside_text import read_json
from frenetic._support.words import present_moment
from frenetic.errors import CampaignError

PATIENCE: Final = 1.0
"""Wait for a lock, in s (ours): a look at its holder locks it for a moment."""


class _Holder(Struct):
    """The process that holds a lock, as its file says."""

    process_id: int
    host: str
    process_start: int | None
    time: str

    @classmethod
    def here(cls) -> _Holder:
        process_id = os.getpid()
        return cls(process_id, platform.node(), _start_of(process_id), present_moment())

    @classmethod
    def read(cls, file: BufferedReader) -> _Holder:
        """Return the last holder of the lock on a file."""
        file.seek(1)  # on Windows the first byte is locked
        return read_json(file.read(), cls)

    def __str__(self) -> str:
        """Return the process, if it surely is the one that runs here under this number."""
        here = self.host == platform.node() and self.process_start == _start_of(self.process_id)
        if here and self.process_id == os.getpid():
            return "this process"
        is_known = here and self.process_start is not None
        return f"process {self.process_id}" if is_known else "another process"


def lock_file(path: Path) -> FileLock:
    """Lock the file at a path for this process, until it is released or the process ends.

    The file stays, and says who locked it last. A fork of the process does not hold the lock.

    Raises:
        CampaignError: the file is locked already, or cannot be written.
    """
    lock = FileLock(path, thread_local=False, on_acquired=_write_holder)
    try:
        lock.acquire(timeout=PATIENCE)
    except Timeout:
        who = holder(path) or "another process"
        raise CampaignError(
            f"{path.parent} is being written by {who}: wait for it or stop it, or choose another"
            " folder"
        ) from None
    except OSError as error:
        raise CampaignError(
            f"cannot lock {path}: {error.strerror or error}; check its folder's permissions, or"
            " choose another disk"
        ) from error
    return lock


def holder(path: Path) -> str | None:
    """Return the holder of the lock on a file, such as "process 123"; None if nobody holds it.

    Nothing changes.
    """
    try:
        with open_file(path) as file:
            with suppress(OSError):  # files cannot be locked there by a reader
                if lock_descriptor(file.fileno(), blocking=False):
                    return None
            return str(_Holder.read(file))
    except ValueError:
        return "another process"
    except OSError:
        return None


def last_host(path: Path) -> str | None:
    """Return the machine that locked a file last; None if that is not known."""
    try:
        with open_file(path) as file:
            return _Holder.read(file).host
    except (ValueError, OSError):
        return None


def _write_holder(file: int) -> None:
    with suppress(OSError):  # the disk is full
        os.ftruncate(file, 0)
        os.write(file, b" " + encode(_Holder.here()) + b"\n")


def _start_of(process_id: int) -> int | None:
    """Return when a process started, in ticks of the machine; None without Linux's table."""
    try:
        text = Path(f"/proc/{process_id}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return int(text.rpartition(")")[2].split()[19])
