"""The code that runs in the process of an `ObjectProcess`: it answers calls of its object.

The process sends answers, reports and log records to its parent.
"""

from __future__ import annotations

import logging
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Final, NamedTuple

from msgspec import Meta

from frenetic._support.messages import (
    MOST_BYTES_OF_OURS,
    Channel,
    Frame,
    FrameReader,
    encode,
    to_bytes,
)
from frenetic.errors import Trouble, reason_of, traceback_of
from frenetic.parts.user_modules import load_user_file
from frenetic.processes.children import one_process

CALL, ANSWER, REPORT, FAILED, LOGGED = range(5)
"""Kinds of messages: a call from the parent, and four that the process sends."""
CUT_OFF: Final = 83
"""Exit code of a process whose connection was closed or replaced in it."""
LIBRARY: Final = "frenetic"
"""Name of the logger whose records are passed on."""
_MOST_LOGGED: Final = 2_000  # characters of a log message, ours
_MOST_LEVEL: Final = 100  # highest level of a log message, ours


class LoggedRecord(NamedTuple):
    """A log record of the library on its way to the parent."""

    level: Annotated[int, Meta(ge=logging.NOTSET, le=_MOST_LEVEL)]
    name: Annotated[str, Meta(max_length=200, pattern=r"(?s)^(\..*)?\Z")]
    """Name of the logger, without `LIBRARY`."""
    message: Annotated[str, Meta(max_length=_MOST_LOGGED)]


def report(value: object) -> None:
    """Send a value from within a call; `ObjectProcess.receive` returns it before the answer."""
    _send(REPORT, value)


turn: Any = SimpleNamespace(value=0)
"""Flag whose ``value`` is 1 while a driver is asked; the parent of a worker shares it."""


class _Sender:
    """The sender of messages to the parent, one at a time."""

    def __init__(self, channel: Channel) -> None:
        self.number = 1
        """Number of the present call."""
        self._channel = channel
        self._lock = threading.Lock()
        self._owner = os.getpid()

    def send(self, kind: int, value: object) -> None:
        """Send a value, unless this is a fork of a driver."""
        if os.getpid() == self._owner:
            data = to_bytes(Frame(kind, self.number, encode(value)))
            with self._lock:
                _send_whole(self._channel, data)


_send: Callable[[int, object], None]  # a kind and a body to the parent


def serve(connection: Connection, files: Sequence[str], packed: bytes, shared_turn: Any) -> None:
    """Answer the calls from the connection until it ends or the object was closed."""
    global _send, turn  # of this process
    turn = shared_turn
    channel = Channel(connection, blocks=True)
    sender = _Sender(channel)
    _send = send = sender.send
    _let_forks_go(channel)
    _attach_log(send)
    try:
        for file in files:
            load_user_file(file)
        # The bytes come from our own parent, so they may be unpickled.
        hosted = pickle.loads(packed)  # noqa: S301
        for sender.number, method, args in _calls(channel):
            with one_process():
                value = getattr(hosted, method)(*args)
            send(ANSWER, value)
            if method == "close":
                break
        _fall_silent()
    except BaseException as error:  # also what a driver's sys.exit() raises
        send(FAILED, Trouble(reason_of(error), traceback_of(error)))
    finally:
        channel.close()


def _calls(channel: Channel) -> Iterator[tuple[int, str, Any]]:
    """Yield number, method and arguments of each call until the parent closes the connection."""
    frames = FrameReader(MOST_BYTES_OF_OURS)
    while True:
        try:
            data = channel.receive()
        except (EOFError, OSError):
            _require_whole(channel)
            return
        for frame in frames.feed(data):
            # These bytes come from our own parent, too.
            method, args = pickle.loads(frame.body)  # noqa: S301
            yield frame.number, method, args


def _send_whole(channel: Channel, data: bytes) -> None:
    """Send bytes to the parent, unless it has gone; end the process if it is cut off."""
    _require_whole(channel)
    try:
        channel.send(data)
    except OSError:
        _require_whole(channel)


def _require_whole(channel: Channel) -> None:
    """End the process if a driver has closed its connection, and may have put a file there."""
    if not channel.is_whole:
        os._exit(CUT_OFF)


def _let_forks_go(channel: Channel) -> None:
    """Take the connection and the flag from each process that a driver forks."""
    if sys.platform != "win32":

        def let_go() -> None:
            global turn
            turn = SimpleNamespace(value=0)
            channel.close()

        os.register_at_fork(after_in_child=let_go)


def _fall_silent() -> None:
    """Throw away all that a driver prints when it is deleted."""
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)


def _attach_log(send: Callable[[int, object], None]) -> None:
    """Pass the library's log records, from INFO on, to the parent."""

    class Passing(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            name = record.name.removeprefix(LIBRARY)[:200]
            level = min(max(record.levelno, logging.NOTSET), _MOST_LEVEL)
            text = record.getMessage()[:_MOST_LOGGED].encode(errors="replace").decode()
            send(LOGGED, LoggedRecord(level, name, text))

    library = logging.getLogger(LIBRARY)
    library.addHandler(Passing(logging.INFO))
    if library.level == logging.NOTSET:
        library.setLevel(logging.INFO)
