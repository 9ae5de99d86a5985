"""Ctrl-C during a campaign: once to stop after the test at hand, twice to leave at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupt:
    """Whether the user asked to stop."""

    requested = False


@contextmanager
def catch_interrupt(on_request: Callable[[], None] | None = None) -> Iterator[Interrupt]:
    """Turns the first Ctrl-C into a request; the second raises `KeyboardInterrupt` as usual.

    Compiled code and databases are not left in the middle of something this way. Outside the main
    thread, which alone receives signals, nothing changes.

    Args:
        on_request: called at the first Ctrl-C.
    """
    interrupt = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler:
        # Ignored, or handled by somebody else: their decision stands.
        yield interrupt
        return

    def request(number: int, frame: FrameType | None) -> None:
        if interrupt.requested:
            signal.default_int_handler(number, frame)
        interrupt.requested = True
        if on_request is not None:
            on_request()

    signal.signal(signal.SIGINT, request)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, before)
