"""Ctrl-C during a campaign: once to stop after the test at hand, twice to leave at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

ENDING: Final = tuple(
    signal.Signals[name]
    for name in ("SIGTERM", "SIGHUP", "SIGBREAK")  # the second on POSIX, the third on Windows only
    if name in signal.Signals.__members__
)
"""Signals, beside that of Ctrl-C, by which others end a process."""


class Interrupt:
    """Whether the user asked to stop."""

    requested = False


@contextmanager
def catch_interrupt(on_request: Callable[[], None] | None = None) -> Iterator[Interrupt]:
    """Turns the first Ctrl-C into a request; the second raises `KeyboardInterrupt` as usual.

    Compiled code and databases are not left in the middle of something this way. So do the signals
    in `ENDING` if they raise `KeyboardInterrupt`, too, as they do on the command line. Outside the
    main thread, which alone receives signals, nothing changes.

    Args:
        on_request: called at the first Ctrl-C.
    """
    interrupt = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return
    # Where one is ignored, or handled by somebody else, their decision stands.
    taken = [
        number
        for number in (signal.SIGINT, *ENDING)
        if signal.getsignal(number) is signal.default_int_handler
    ]

    def request(number: int, frame: FrameType | None) -> None:
        if interrupt.requested:
            signal.default_int_handler(number, frame)
        interrupt.requested = True
        if on_request is not None:
            on_request()

    for number in taken:
        signal.signal(number, request)
    try:
        yield interrupt
    finally:
        for number in taken:
            signal.signal(number, signal.default_int_handler)
