"""Compiled kernels on disk that several processes may write and read at once.

Numba keeps what it compiled in two kinds of files: an index, from the types of a kernel's arguments
to the numbers of its compiled forms, and these forms. A new form gets the least unused number. Two
processes that compile the same kernel for different arguments at once take the same number: the
index of the later one then names the other's machine code, and from then on every process calls it
with the wrong arguments, which crashes it or, worse, does not. A fresh installation meets this as
soon as its first campaign starts two workers.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from numba.core.caching import FunctionCache

from frenetic._support.file_locks import try_to_lock

LOCK: Final = "frenetic-kernels.lock"

PATIENCE: Final = 30.0
"""Wait of a process for its turn, in s. A turn takes some milliseconds; a process that takes longer
has stopped. Then kernels are compiled, but neither read nor kept."""

_PAUSE: Final = 0.002


class SharedCache(FunctionCache):
    """Numba's cache of one kernel, which one process at a time reads or writes."""

    def __init__(self, kernel: Callable[..., Any]) -> None:
        super().__init__(kernel)  # type: ignore[no-untyped-call]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Like numba's; None if other processes hold the cache for too long."""
        with _turn(Path(self.cache_path)) as has_turn:
            if not has_turn:
                return None
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        """Like numba's; nothing is kept if other processes hold the cache for too long."""
        with _turn(Path(self.cache_path)) as has_turn:
            if has_turn:
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]


@contextmanager
def _turn(folder: Path) -> Iterator[bool]:
    """Waits until no other process uses the cache in `folder`; tells whether that happened.

    Threads of one process never meet here: numba compiles in one of them at a time.
    """
    try:
        file = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:  # no cache yet, or one that nobody can write
        yield True
        return
    try:
        yield _wait_for(file)
    finally:
        os.close(file)


def _wait_for(file: int) -> bool:
    """Whether the lock was acquired within `PATIENCE`; true for files that cannot be locked."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            try_to_lock(file)
        except (BlockingIOError, PermissionError):
            if time.monotonic() > end:
                return False
        except OSError:
            return True
        else:
            return True
        time.sleep(_PAUSE)
