"""Private temporary folders of unpacked files, which last as long as their process.

A process that is killed leaves its folder behind. A later process removes it: a living process
holds a lock on a file in its folder.
"""

from __future__ import annotations

import os
import shutil
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from typing import Final

from filelock import FileLock, Timeout

_PREFIX: Final = "frenetic-fmu-"
"""Beginning of the names of the folders."""
_LOCK: Final = ".lock"
"""Name of the file that a living process locks."""
_NEW: Final = 60.0
"""Age up to which a folder may not be locked yet, in s; our choice."""
_folders: dict[tuple[int, str], Path] = {}
"""Process id and digest of a file -> folder in which the process has unpacked it."""
_locks: list[FileLock] = []
"""Locks of this process, which the system releases when the process ends."""


def private_folder(digest: str, fill: Callable[[Path], None]) -> Path:
    """Return this process's folder for a file, which is filled at the first call.

    Args:
        digest: digest of the file.
        fill: function that unpacks the file into the folder.

    Raises:
        OSError: the folder cannot be made; and what ``fill`` raises.
    """
    key = os.getpid(), digest
    if key not in _folders:
        remove_left_folders()
        folder = Path(mkdtemp(prefix=_PREFIX)).resolve()
        lock = FileLock(folder / _LOCK)
        lock.acquire()
        # In a worker, functions of `atexit` are not called, but these are. Forks do not call them.
        # Windows keeps a loaded library, so that errors are ignored.
        remove = Finalize(None, shutil.rmtree, (folder, True), exitpriority=0)
        try:
            fill(folder)
        except BaseException:
            lock.release()
            remove()
            raise
        _locks.append(lock)
        _folders[key] = folder
    return _folders[key]


def remove_left_folders() -> None:
    """Remove the folders of this user's processes that were killed."""
    for folder in {*Path(gettempdir()).resolve().glob(f"{_PREFIX}*")} - {*_folders.values()}:
        with suppress(OSError, Timeout):
            state = folder.lstat()
            is_ours = not hasattr(os, "getuid") or state.st_uid == os.getuid()
            is_old = time.time() - state.st_mtime > _NEW
            if is_ours and is_old and stat.S_ISDIR(state.st_mode):
                with FileLock(folder / _LOCK, timeout=0):
                    shutil.rmtree(folder, ignore_errors=True)
