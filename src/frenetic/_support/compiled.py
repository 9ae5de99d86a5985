"""The decorator of all kernels: numba compiles them and keeps the result on disk.

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

from frenetic._support.interpreted import interpret_first_calls
from frenetic._support.kernel_cache import ensure_kernel_cache

ensure_kernel_cache()
numba.config.reload_config()  # numba reads the folder's variable when it is imported

MAX_WAIT: Final = 60.0
"""Longest wait of a process for its turn, in s (our choice). The kernels of a module take some
seconds: a process that takes longer has been stopped, and the others stop waiting for it."""
_POLL_INTERVAL: Final = 0.002
"""Time between two attempts to take a lock, in s (our choice)."""

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def njit(
    *,
    error_model: Literal["python", "numpy"] = "python",
    inline: Literal["never", "always"] = "never",
    force_inline: bool = False,
    nogil: bool = False,
    interpret_first: float = 0.0,
) -> Callable[[_Kernel], _Kernel]:
    """Return Numba's decorator ``njit``, with its cache on disk.

    No entry for C functions is compiled, which would take time: kernels are called from Python and
    by each other only.

    Args:
        error_model: whether a division by 0 raises ("python") or gives infinity ("numpy").
        inline: whether the kernel's source is copied into the kernels that call it.
        force_inline: whether its machine code is, so that a loop around it can become vector code.
        nogil: whether other threads of Python may run while the kernel does.
        interpret_first: time that compiling takes, in s, with all that is compiled along. Calls
            from Python are interpreted until they have taken so long; by default, none is. It is
            for kernels of which one call takes less time in Python than compiling.
    """

    def compile_lazily(kernel: _Kernel) -> _Kernel:
        dispatcher = numba.njit(
            error_model=error_model,
            inline=inline,
            forceinline=force_inline,
            nogil=nogil,
            cache=True,
            no_cfunc_wrapper=True,
        )(kernel)
        if is_jitted(dispatcher):
            compile_now = dispatcher.compile

            def compile_in_turn(signature: Any) -> Any:
                with global_compiler_lock, _TURNS.turn(dispatcher):
                    return compile_now(signature)

            dispatcher.compile = compile_in_turn
            if interpret_first:
                interpret_first_calls(dispatcher, interpret_first)
        return cast("_Kernel", dispatcher)

    return compile_lazily


def cache_folder(kernel: Callable[..., Any]) -> Path | None:
    """Return the cache folder of a kernel; None if the function is not compiled."""
    if not is_jitted(kernel):
        return None
    return Path(cast("Any", kernel).stats.cache_path)


class _Turns:
    """The turns of this process at compiling, by a lock for each module with kernels.

    Only one thread uses it at a time.
    """

    def __init__(self) -> None:
        self.is_waiting = False
        """Whether this process waits for another process that compiles."""
        self._uses_locks = True
        """Whether locks can be taken; False for good once that failed."""

    @contextmanager
    def turn(self, kernel: Any) -> Iterator[None]:
        """Wait for this process's turn at the kernel's module, and hold its lock in the context."""
        module = kernel.py_func.__module__
        lock = _lock(Path(kernel.stats.cache_path) / f"{module}.lock", os.getpid())
        has_lock = self._uses_locks and self._acquire(lock)
        try:
            yield
        finally:
            if has_lock:
                lock.release()

    def _acquire(self, lock: FileLock) -> bool:
        """Take a lock, or go without locks from now on; return whether it was taken."""
        try:
            lock.acquire(timeout=0)
        except Timeout:
            self.is_waiting = True
            try:
                lock.acquire(timeout=MAX_WAIT, poll_interval=_POLL_INTERVAL)
            except Timeout:
                self._uses_locks = False  # it does not wait that long a second time
            finally:
                self.is_waiting = False
        except OSError:  # the folder cannot be written, or its files not be locked
            self._uses_locks = False
        return self._uses_locks


@cache
def _lock(path: Path, _process: int) -> FileLock:
    """Return the lock in a file, a new object in each process, since forks share none."""
    return FileLock(path, thread_local=False)


class Compilation(event.Listener):  # type: ignore[misc]
    """A count of the kernels that are being compiled; kernels read from disk do not count."""

    def __init__(self) -> None:
        self.kernels = 0
        """Number of kernels that are being compiled now."""

    def on_start(self, _: event.Event) -> None:
        """Count a kernel whose compilation starts."""
        self.kernels += 1

    def on_end(self, _: event.Event) -> None:
        """Stop counting a kernel whose compilation ends."""
        self.kernels -= 1


_TURNS: Final = _Turns()
_COMPILATION: Final = Compilation()
event.register("numba:compile", _COMPILATION)


def is_compiling() -> bool:
    """Return whether kernels are being compiled, here or in a process for which this one waits."""
    return _COMPILATION.kernels > 0 or _TURNS.is_waiting
