"""The decorator of all kernels, which numba compiles and keeps on disk.

Processes take turns at the kernels of a module. Numba keeps an index, from the types of a kernel's
arguments to the numbers of its compiled forms, beside these forms. Two processes that compile a
kernel at once for different arguments may take the same number; from then on one of the two calls
runs the other's machine code. So a process holds the module's lock while it compiles, which
includes reading and writing these files, and others find its result on disk afterwards. A kernel
calls others of its module or of those that it imports, so no two processes wait for each other.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, cast

import numba
from filelock import FileLock, Timeout
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import is_jitted

from frenetic._support.kernel_cache import ensure_kernel_cache

ensure_kernel_cache()
numba.config.reload_config()  # numba reads the folder's variable when it is imported

PATIENCE: Final = 60.0
"""Longest wait of a process for its turn, in s; ours. A module takes some seconds: a process that
takes longer has been stopped, and the others stop waiting for it."""

_PAUSE: Final = 0.002  # [s] between two looks at a lock; ours

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def njit(
    *,
    error_model: Literal["python", "numpy"] = "python",
    inline: Literal["never", "always"] = "never",
) -> Callable[[_Kernel], _Kernel]:
    """Return Numba's decorator ``njit``, with its cache on disk.

    Kernels are called from Python and by each other, never as C functions: that entry takes its
    share of compiling.
    """

    def compile_lazily(kernel: _Kernel) -> _Kernel:
        dispatcher = numba.njit(
            error_model=error_model, inline=inline, cache=True, no_cfunc_wrapper=True
        )(kernel)
        if is_jitted(dispatcher):
            compile_now = dispatcher.compile

            def compile_in_turn(signature: Any) -> Any:
                with global_compiler_lock, _turns.turn(dispatcher):
                    return compile_now(signature)

            dispatcher.compile = compile_in_turn
        return cast("_Kernel", dispatcher)

    return compile_lazily


def cache_folder(kernel: Callable[..., Any]) -> Path | None:
    """Return the cache folder of a kernel; None if the function is not compiled."""
    if not is_jitted(kernel):
        return None
    return Path(cast("Any", kernel).stats.cache_path)


class _Turns:
    """Locks of modules whose kernels this process compiles, one thread at a time."""

    def __init__(self) -> None:
        self.is_waiting = False
        """Whether this process waits for another one that compiles."""
        self._are_locked = True

    @contextmanager
    def turn(self, kernel: Any) -> Iterator[None]:
        """Wait for this process's turn at the kernel's module, and hold the lock meanwhile."""
        module = kernel.py_func.__module__
        lock = _lock(Path(kernel.stats.cache_path) / f"{module}.lock", os.getpid())
        is_held = self._are_locked and self._acquire(lock)
        try:
            yield
        finally:
            if is_held:
                lock.release()

    def _acquire(self, lock: FileLock) -> bool:
        try:
            lock.acquire(timeout=0)
        except Timeout:
            self.is_waiting = True
            try:
                lock.acquire(timeout=PATIENCE, poll_interval=_PAUSE)
            except Timeout:
                self._are_locked = False  # nobody waits twice
            finally:
                self.is_waiting = False
        except OSError:  # nobody can write or lock files there
            self._are_locked = False
        return self._are_locked


@cache
def _lock(path: Path, _process: int) -> FileLock:
    """Return the lock in a file, a new one for each process: a fork cannot use its parent's."""
    return FileLock(path, thread_local=False)


class Compilation(event.Listener):  # type: ignore[misc]
    """A count of the kernels that are being compiled; kernels read from disk do not count."""

    def __init__(self) -> None:
        self.under_way = 0

    def on_start(self, _: event.Event) -> None:
        """Count a kernel whose compilation starts."""
        self.under_way += 1

    def on_end(self, _: event.Event) -> None:
        """Count a kernel whose compilation ends."""
        self.under_way -= 1


_turns, _COMPILATION = _Turns(), Compilation()
event.register("numba:compile", _COMPILATION)


def is_compiling() -> bool:
    """Return whether kernels are being compiled, by this process or one for which it waits."""
    return _COMPILATION.under_way > 0 or _turns.is_waiting
