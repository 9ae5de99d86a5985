"""Ctrl-C during a campaign: the first stops it after the running tests, the second at once."""

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
    for name in ("SIGTERM", "SIGHUP", "SIGBREAK")  # SIGHUP is POSIX's, SIGBREAK is Windows'
    if name in signal.Signals.__members__
)
"""Signals that end a process, without SIGINT, the signal of Ctrl-C."""


@contextmanager
def plain_interrupts() -> Iterator[None]:
    """Raise `KeyboardInterrupt` where compiled code has turned a Ctrl-C into a `SystemError`."""
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        raise


class Interrupt:
    """A user's request to stop."""

    requested = False
    """Whether Ctrl-C was pressed, or a stop was requested otherwise."""
    insisted = False
    """Whether Ctrl-C was pressed again, so that a `KeyboardInterrupt` was raised."""


@contextmanager
def catch_interrupt(on_request: Callable[[], None] | None = None) -> Iterator[Interrupt]:
    """Turn the first Ctrl-C into a request; the second raises `KeyboardInterrupt` as usual.

    So the first interrupts neither compiled code nor a write to a database. The signals in `ENDING`
    work in the same way if they raise `KeyboardInterrupt`, as they do on the command line. In
    another thread than the main thread, which alone receives signals, nothing changes.

    Args:
        on_request: function that is called at the first Ctrl-C.
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
    """Let the signals of a job scheduler or a closed terminal act like Ctrl-C in the block.

    So results are stored and simulators are ended. Signals that are ignored, as under nohup, stay
    ignored.
    """
    return _handled(ENDING, signal.SIG_DFL, signal.default_int_handler)


@contextmanager
def _handled(
    signals: Iterable[signal.Signals], default: _Handler, handler: _Handler
) -> Iterator[None]:
    """Set the handler of signals in the block, except of signals whose handler is not `default`."""
    replaced = []
    if threading.current_thread() is threading.main_thread():
        replaced = [number for number in signals if signal.getsignal(number) is default]
    for number in replaced:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in replaced:
            signal.signal(number, default)
