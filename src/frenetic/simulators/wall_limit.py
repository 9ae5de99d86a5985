"""A limit on the wall time of a call into a user's code."""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class WallLimitExceeded(BaseException):
    """Raised inside code that runs for too long.

    Not an `Exception`, so that a driver's own ``except Exception`` does not keep it alive.
    """


_AGAIN = 1.0  # s after which a driver that swallowed the exception gets another


@contextmanager
def wall_limit(seconds: float) -> Iterator[None]:
    """Raises `WallLimitExceeded` in the calling thread if the block takes longer.

    In the main thread of a POSIX system a timer signal does it, which also ends a blocking system
    call. Elsewhere the interpreter raises it at the next Python instruction, so a call that blocks
    in compiled code is ended when it returns.
    """
    if hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread():
        yield from _by_signal(seconds)
    else:
        yield from _by_thread(seconds)


def _by_signal(seconds: float) -> Iterator[None]:
    def expire(_number: int, _frame: FrameType | None) -> None:
        raise WallLimitExceeded

    before = signal.signal(signal.SIGALRM, expire)
    signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _by_thread(seconds: float) -> Iterator[None]:
    target = ctypes.c_ulong(threading.get_ident())
    lock = threading.Lock()
    done = threading.Event()

    def watch() -> None:
        delay = seconds
        while not done.wait(delay):
            with lock:
                if done.is_set():
                    return
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    target, ctypes.py_object(WallLimitExceeded)
                )
            delay = _AGAIN

    watcher = threading.Thread(target=watch, name="wall-limit", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        with lock:
            done.set()
        watcher.join()
