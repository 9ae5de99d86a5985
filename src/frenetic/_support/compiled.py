"""The decorator of all kernels, which numba compiles and keeps on disk.

Processes take turns at compiling. Numba keeps an index, from the types of a kernel's arguments to
the numbers of its compiled forms, beside these forms. Two processes that compile a kernel at once
for different arguments may take the same number; from then on one of the two calls runs the other's
machine code. A fresh installation meets this as soon as its first campaign starts two workers.
Numba announces the start and end of compiling, which includes reading and writing these files: a
process holds the lock in between. Others find its result on disk afterwards.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, cast

import numba
from filelock import FileLock, Timeout
from numba.core import event
from numba.extending import is_jitted

LOCK: Final = "frenetic-kernels.lock"

PATIENCE: Final = 30.0
"""Wait of a process for its turn, in s. One kernel takes a few seconds; a process that takes longer
has been stopped, and the others stop waiting for it."""

_PAUSE: Final = 0.002

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def njit(*, error_model: Literal["python", "numpy"] = "python") -> Callable[[_Kernel], _Kernel]:
    """Numba's decorator of the same name, with its cache on disk.

    Kernels are called from Python and by each other, never as C functions: that entry takes its
    share of compiling.
    """

    def compile_lazily(kernel: _Kernel) -> _Kernel:
        made = numba.njit(error_model=error_model, cache=True, no_cfunc_wrapper=True)
        return cast("_Kernel", made(kernel))

    return compile_lazily


def cache_folder(kernel: Callable[..., Any]) -> Path | None:
    """The cache folder of a kernel; None if it is not compiled."""
    if not is_jitted(kernel):
        return None
    return Path(cast("Any", kernel).stats.cache_path)


@njit()
def _placed() -> None:
    """Never called: gives numba's folder for this module, where the lock lies."""


class Turns(event.Listener):  # type: ignore[misc]
    """Holds the lock while this process compiles."""

    def __init__(self) -> None:
        self._folder = cache_folder(_placed)
        self._guard = threading.Lock()
        self._depth = 0  # threads and kernels of kernels that compile
        self._lock: FileLock | None = None
        self.is_waiting = False
        """Whether another process compiles, and this one waits for it."""

    def on_start(self, _: event.Event) -> None:
        """Waits for this process's turn."""
        with self._guard:
            if self._depth == 0 and self._folder is not None:
                self._lock = self._turn(self._folder)
                if self._lock is None:
                    self._folder = None  # nobody waits twice
            self._depth += 1

    def on_end(self, _: event.Event) -> None:
        """Ends the turn."""
        with self._guard:
            self._depth -= 1
            if self._depth == 0 and self._lock is not None:
                self._lock.release()
                self._lock = None

    def _turn(self, folder: Path) -> FileLock | None:
        # A new one each time: a fork of this process can lock none that was made before.
        lock = FileLock(folder / LOCK, thread_local=False)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            self.is_waiting = True
            try:
                lock.acquire(timeout=PATIENCE, poll_interval=_PAUSE)
            except Timeout:
                return None
            finally:
                self.is_waiting = False
        except OSError:  # nobody can write or lock files there
            return None
        return lock


class Compilation(event.Listener):  # type: ignore[misc]
    """Notices kernels that are compiled: a kernel that is found on disk is not."""

    def __init__(self) -> None:
        self.under_way = 0

    def on_start(self, _: event.Event) -> None:
        """Counts one more."""
        self.under_way += 1

    def on_end(self, _: event.Event) -> None:
        """Counts one less."""
        self.under_way -= 1


_TURNS, _COMPILATION = Turns(), Compilation()
event.register("numba:compiler_lock", _TURNS)
event.register("numba:compile", _COMPILATION)


def is_compiling() -> bool:
    """Whether kernels are compiled now, by this process or by one for which it waits."""
    return _COMPILATION.under_way > 0 or _TURNS.is_waiting
