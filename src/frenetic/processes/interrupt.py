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
"""Signals that end a process, other than SIGINT, the signal of Ctrl-C."""


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
    work in the same way if they raise `KeyboardInterrupt`, as inside `signals_act_like_ctrl_c`,
    which the command line uses. Only the main thread receives signals: in other threads nothing
    changes.

    Args:
        on_request: function that is called at the first Ctrl-C, in the signal handler: keep it
            short.
    """
    interrupt = Interrupt()

    def request(number: int, frame: FrameType | None) -> None:
        if interrupt.requested:
            interrupt.insisted = True
            signal.default_int_handler(number, frame)  # raises KeyboardInterrupt
        interrupt.requested = True
        if on_request is not None:
            on_request()

    with _handler_replaced((signal.SIGINT, *ENDING), signal.default_int_handler, request):
        yield interrupt


def signals_act_like_ctrl_c() -> AbstractContextManager[None]:
    """Let the signals in `ENDING` act like Ctrl-C in the block.

    So a job scheduler or a closed terminal ends the process only after results are stored and
    simulators are ended. Signals that are ignored, as under nohup, stay ignored.
    """
    return _handler_replaced(ENDING, signal.SIG_DFL, signal.default_int_handler)


@contextmanager
def _handler_replaced(
    signals: Iterable[signal.Signals], expected: _Handler, handler: _Handler
) -> Iterator[None]:
    """Replace the handler of those signals whose handler is `expected`, and restore it afterwards.

    A user's own handlers stay. Outside the main thread, which alone may set handlers, nothing is
    replaced.
    """
    replaced = []
    if threading.current_thread() is threading.main_thread():
        replaced = [number for number in signals if signal.getsignal(number) is expected]
    for number in replaced:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in replaced:
            signal.signal(number, expected)
