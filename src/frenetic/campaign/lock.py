"""The lock that lets only one process write a folder, and the process that holds it."""

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

LONGEST_WAIT: Final = 1.0
"""Longest wait for a lock, in s (our choice): `holder` locks a free file for a moment."""

_START_TIME_FIELD: Final = 19
"""Index of ``starttime`` in ``/proc/PID/stat`` after the name of the program, see man 5 proc."""


class _Holder(Struct):
    """The process that locked a file last, as the file says."""

    process_id: int
    host: str
    """Name of the machine."""
    process_start: int | None
    """Start of the process in ticks of the machine, see `_start_of`; None if unknown."""
    time: str
    """Date and time of the lock."""

    @classmethod
    def this_process(cls) -> _Holder:
        process_id = os.getpid()
        return cls(process_id, platform.node(), _start_of(process_id), present_moment())

    @classmethod
    def read(cls, file: BufferedReader) -> _Holder:
        """Return the last holder of the lock on a file."""
        file.seek(1)  # the first byte is a blank, which a lock makes unreadable on Windows
        return read_json(file.read(), cls)

    def __str__(self) -> str:
        """Return the process's number if it certainly runs here, otherwise "another process"."""
        # After a restart another process may have the same number, but not the same start.
        is_here = self.host == platform.node() and self.process_start == _start_of(self.process_id)
        if is_here and self.process_id == os.getpid():
            return "this process"
        is_certain = is_here and self.process_start is not None
        return f"process {self.process_id}" if is_certain else "another process"


def lock_file(path: Path) -> FileLock:
    """Lock a file for this process until the lock is released or the process ends.

    The file remains, and says which process locked it last. A fork of the process does not hold the
    lock.

    Raises:
        CampaignError: the file is locked already, or cannot be written.
    """
    lock = FileLock(path, thread_local=False, on_acquired=_write_holder)
    try:
        lock.acquire(timeout=LONGEST_WAIT)
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

    The file is not changed.
    """
    try:
        with open_file(path) as file:
            with suppress(OSError):  # this file system lets no reader lock a file
                if lock_descriptor(file.fileno(), blocking=False):
                    return None
            return str(_Holder.read(file))
    except ValueError:  # the file is locked, but does not say by which process
        return "another process"
    except OSError:
        return None


def last_host(path: Path) -> str | None:
    """Return the name of the machine that locked a file last; None if it is not known."""
    try:
        with open_file(path) as file:
            return _Holder.read(file).host
    except (ValueError, OSError):
        return None


def _write_holder(file: int) -> None:
    with suppress(OSError):  # the disk is full
        os.ftruncate(file, 0)
        os.write(file, b" " + encode(_Holder.this_process()) + b"\n")


def _start_of(process_id: int) -> int | None:
    """Return when a process started, in ticks since the machine's start; None except on Linux."""
    try:
        text = Path(f"/proc/{process_id}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    return int(text.rpartition(")")[2].split()[_START_TIME_FIELD])
