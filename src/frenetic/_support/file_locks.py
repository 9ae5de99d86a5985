"""Locks on open files, which the operating system releases when their process ends.

Runs on Python 3.9, as all that the competition's pipeline imports of the package does.
"""

from __future__ import annotations

import os
import sys
from typing import Final

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
