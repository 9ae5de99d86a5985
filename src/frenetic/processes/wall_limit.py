"""A limit on the wall time of a call into a user's code."""

from __future__ import annotations

import ctypes
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from frenetic.errors import place_of


class WallLimitExceeded(BaseException):
    """Exception inside code that runs for too long.

    It is not an `Exception`, so a driver's own ``except Exception`` does not catch it.
    """

    @property
    def place(self) -> str:
        """Place at which it interrupted the user's code, as the end of a sentence, or empty."""
        place = place_of(self)
        return place and f", and was at {place}"


_AGAIN = 1.0  # [s] after which a driver that swallowed the exception gets another, ours


@contextmanager
def wall_limit(seconds: float) -> Iterator[None]:
    """Raise `WallLimitExceeded` in the calling thread if the block takes longer.

    In the main thread of a POSIX system a timer signal does it, which also ends a blocking system
    call. Elsewhere the interpreter raises it at the next Python instruction, so a call that blocks
    in compiled code is ended when it returns.
    """
    if sys.platform != "win32" and threading.current_thread() is threading.main_thread():
        yield from _by_signal(seconds)
    else:
        yield from _by_thread(seconds)


def _by_signal(seconds: float) -> Iterator[None]:
    if sys.platform == "win32":
        raise OSError("Windows has no such timer")
    armed = True

    def expire(_number: int, _frame: FrameType | None) -> None:
        if armed:
            raise WallLimitExceeded

    start = time.monotonic()
    rest, interval = signal.getitimer(signal.ITIMER_REAL)
    before = signal.signal(signal.SIGALRM, expire)
    # The alarm may come while the block is being left. The outer `finally` then still puts timer
    # and handler back, long before the alarm comes again.
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN)
            yield
        finally:
            armed = False
    finally:
        armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if rest > 0.0:  # an outer limit's timer
            rest -= time.monotonic() - start
            signal.setitimer(signal.ITIMER_REAL, max(rest, 1e-6), interval)


def _by_thread(seconds: float) -> Iterator[None]:
    target = ctypes.c_ulong(threading.get_ident())
    lock = threading.Lock()
    done = threading.Event()
    armed = [True]

    def watch() -> None:
        delay = seconds
        while not done.wait(delay):
            with lock:
                if not armed:
                    return
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    target, ctypes.py_object(WallLimitExceeded)
                )
            delay = _AGAIN

    watcher = threading.Thread(target=watch, name="wall-limit", daemon=True)
    # As above, the exception may come while the block is being left.
    try:
        try:
            watcher.start()
            yield
        finally:
            armed.clear()
    finally:
        armed.clear()
        with lock:  # nobody raises it now: a pending one is taken back
            ctypes.pythonapi.PyThreadState_SetAsyncExc(target, None)
        done.set()
        watcher.join()
