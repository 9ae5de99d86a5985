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
"""Far beyond a file's text: on Windows nobody else can read a byte that is locked."""


def try_to_lock(file: int, *, shared: bool = False) -> None:
    """Locks the open `file` until it is closed.

    POSIX record locks belong to the process: they neither stop it from locking twice nor survive
    its closing any other descriptor of the file. They are chosen because a forked process does not
    inherit them: an orphan keeps nothing locked.

    A file that is open for reading only can be locked `shared`, which keeps nobody from reading.

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
