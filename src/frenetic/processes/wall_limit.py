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
from typing import Final

from frenetic.errors import place_of


class WallLimitExceeded(BaseException):
    """Exception that is raised inside code that runs for too long.

    It is not an `Exception`, so a driver's own ``except Exception`` does not catch it.
    """

    @property
    def place(self) -> str:
        """Where the user's code was, as the end of a sentence: ``, and was at mpc.py:42``.

        Empty if no user's code was running.
        """
        place = place_of(self)
        return place and f", and was at {place}"


_REPEAT_INTERVAL: Final = 1.0
"""Time after which the exception is raised again in code that has caught it, in s (our choice)."""


@contextmanager
def wall_limit(seconds: float) -> Iterator[None]:
    """Raise `WallLimitExceeded` in the calling thread if the block takes longer.

    In the main thread of a POSIX system the signal of a timer raises it, which also ends a blocking
    system call. Elsewhere the interpreter raises it at the next Python instruction: a call that
    blocks in compiled code ends only when it returns.

    Args:
        seconds: longest time of the block, in s.
    """
    if sys.platform != "win32" and threading.current_thread() is threading.main_thread():
        yield from _by_signal(seconds)
    else:
        yield from _by_thread(seconds)


def _by_signal(seconds: float) -> Iterator[None]:
    """Limit the block by a timer that sends SIGALRM."""
    if sys.platform == "win32":
        raise OSError("Windows has no such timer")  # never reached: for the type checker
    is_armed = True

    def expire(_number: int, _frame: FrameType | None) -> None:
        if is_armed:
            raise WallLimitExceeded

    start = time.monotonic()
    outer_seconds, outer_interval = signal.getitimer(signal.ITIMER_REAL)
    outer_handler = signal.signal(signal.SIGALRM, expire)
    # The alarm may come in the inner `finally`. Then the outer one still restores timer and
    # handler, long before the alarm comes again.
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds, _REPEAT_INTERVAL)
            yield
        finally:
            is_armed = False
    finally:
        is_armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, outer_handler)
        if outer_seconds > 0.0:  # another limit encloses this one
            outer_seconds -= time.monotonic() - start
            # 0 would stop the timer, so an expired limit gets the shortest time instead.
            signal.setitimer(signal.ITIMER_REAL, max(outer_seconds, 1e-6), outer_interval)


def _by_thread(seconds: float) -> Iterator[None]:
    """Limit the block by a thread that lets the interpreter raise the exception."""
    target = ctypes.c_ulong(threading.get_ident())
    lock = threading.Lock()
    done = threading.Event()
    armed = [True]  # empty when the limit no longer applies

    def watch() -> None:
        delay = seconds
        while not done.wait(delay):
            with lock:
                if not armed:
                    return
                ctypes.pythonapi.PyThreadState_SetAsyncExc(
                    target, ctypes.py_object(WallLimitExceeded)
                )
            delay = _REPEAT_INTERVAL

    watcher = threading.Thread(target=watch, name="wall-limit", daemon=True)
    # The exception may come in the inner `finally`, as in `_by_signal`.
    try:
        try:
            watcher.start()
            yield
        finally:
            armed.clear()
    finally:
        armed.clear()
        with lock:  # the watcher raises no exception now; one that is pending is withdrawn
            ctypes.pythonapi.PyThreadState_SetAsyncExc(target, None)
        done.set()
        watcher.join()
