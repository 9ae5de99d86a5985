"""Locks on open files, which the operating system releases when their process ends.

Runs on Python 3.9, as all that the competition's pipeline imports of the package does.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Final

from frenetic.errors import CampaignError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_LOCKED_BYTE: Final = 1 << 30
"""Offset of the lock, far beyond a file's text: on Windows nobody else can read a locked byte."""


def try_to_lock(file: int, *, shared: bool = False) -> None:
    """Locks the open `file` until it is closed.

    POSIX record locks belong to the process: it may lock twice, and closing any other descriptor of
    the file releases them. A forked process does not inherit them, so an orphan keeps nothing
    locked; that is why we use them.

    A file open for reading only can be locked `shared`, which allows other readers.

    Raises:
        BlockingIOError, PermissionError: another process has it locked.
        OSError: files cannot be locked there.
    """
    if sys.platform == "win32":
        os.lseek(file, _LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        finally:
            os.lseek(file, 0, os.SEEK_SET)
    else:
        kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        fcntl.lockf(file, kind | fcntl.LOCK_NB, 1, _LOCKED_BYTE)


# A process may lock a file twice, and loses its lock when it closes any descriptor of the file (see
# `try_to_lock`). So a file that this process holds is not opened again.
_held_here: set[Path] = set()


class FileLock:
    """Exclusive hold on the file at `path`, from its creation until `release`.

    Killing the process in any way releases it. The file stays, with the id of the process that
    locked it last; only the operating system knows whether it is locked. Advisory on POSIX: it
    keeps out processes that ask.

    Raises a `CampaignError` if another process, or this one, already holds it, or if the file
    cannot be opened for writing.
    """

    def __init__(self, path: Path) -> None:
        self._path = path.resolve()
        if self._path in _held_here:
            raise CampaignError(
                f"{path.parent} is already open for writing in this process: close that campaign "
                "first, or open this one for reading"
            )
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise CampaignError(
                f"cannot write {path}: {error.strerror or error}; check its folder's permissions"
            ) from error
        try:
            try_to_lock(self._file)
        except OSError as error:
            holder = _read_holder(self._file)
            os.close(self._file)
            if not isinstance(error, (BlockingIOError, PermissionError)):
                raise CampaignError(
                    f"cannot lock {path}: {error.strerror or error}; choose another disk"
                ) from error
            raise CampaignError(
                f"{path.parent} is being written by another process{holder}: wait for it or stop "
                "it, or choose another folder"
            ) from error
        _held_here.add(self._path)
        self._is_held = True
        self._write_holder()

    def release(self) -> None:
        """Release the lock; does nothing when it is released already."""
        if self._is_held:
            self._is_held = False
            _held_here.discard(self._path)
            os.close(self._file)

    def __enter__(self) -> FileLock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _write_holder(self) -> None:
        """Write this process's id for the messages of others, if the disk has room."""
        try:
            os.ftruncate(self._file, 0)
            os.write(self._file, f"{os.getpid()}\n".encode())
        except OSError:
            pass


def find_holder(path: Path) -> str | None:
    """Return the holder of the lock on the file at `path`, such as "process 123", or None.

    It changes nothing. A process that tries to lock in the same microsecond is refused.
    """
    path = path.resolve()
    if path in _held_here:
        return "this process"  # which would lose its lock if it opened and closed the file here
    try:
        file = os.open(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        try_to_lock(file, shared=True)
    except OSError:
        return _read_holder(file).strip(" ()") or "another process"
    else:
        return None
    finally:
        os.close(file)  # and with it the lock, if it was got


def _read_holder(file: int) -> str:
    """Return " (process 123)" if the locked file says so, "" otherwise."""
    try:
        text = os.read(file, 20).decode("ascii", "replace").strip()
    except OSError:
        return ""
    return f" (process {text})" if text.isdecimal() else ""
