"""Ctrl-C during a campaign: once to stop after the running tests, twice to stop at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType
from typing import Final, TypeAlias

_Handler: TypeAlias = Callable[[int, FrameType | None], object] | signal.Handlers

ENDING: Final = tuple(
    signal.Signals[name]
    for name in ("SIGTERM", "SIGHUP", "SIGBREAK")  # the second on POSIX, the third on Windows only
    if name in signal.Signals.__members__
)
"""Signals that end a process, beside Ctrl-C's."""


@contextmanager
def plain_interrupts() -> Iterator[None]:
    """Raise a Ctrl-C that compiled code has turned into a `SystemError` as `KeyboardInterrupt`."""
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise


class Interrupt:
    """A user's request to stop."""

    requested = False
    insisted = False
    """Whether they asked again, so that a `KeyboardInterrupt` was raised."""


@contextmanager
def catch_interrupt(on_request: Callable[[], None] | None = None) -> Iterator[Interrupt]:
    """Turn the first Ctrl-C into a request; the second raises `KeyboardInterrupt` as usual.

    So compiled code and databases are never interrupted halfway. The signals in `ENDING` work alike
    if they raise `KeyboardInterrupt`, as they do on the command line. Outside the main thread,
    which alone receives signals, nothing changes.

    Args:
        on_request: called at the first Ctrl-C.
    """
    interrupt = Interrupt()

    def request(number: int, frame: FrameType | None) -> None:
        if interrupt.requested:
            interrupt.insisted = True
            signal.default_int_handler(number, frame)
        interrupt.requested = True
        if on_request is not None:
            on_request()

    with _handled((signal.SIGINT, *ENDING), signal.default_int_handler, request):
        yield interrupt


def ending_in_order() -> AbstractContextManager[None]:
    """Make the signals of a job scheduler or a closed terminal act like Ctrl-C.

    So results are stored and simulators ended. Ignored signals, as under nohup, stay ignored.
    """
    return _handled(ENDING, signal.SIG_DFL, signal.default_int_handler)


@contextmanager
def _handled(
    numbers: Iterable[signal.Signals], before: _Handler, handler: _Handler
) -> Iterator[None]:
    """Set the handler of signals that still have the handler `before`; leave others alone."""
    taken = []
    if threading.current_thread() is threading.main_thread():
        taken = [number for number in numbers if signal.getsignal(number) is before]
    for number in taken:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, before)
