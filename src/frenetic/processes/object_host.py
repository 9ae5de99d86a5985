"""The code in the process of an `ObjectProcess`: it calls the object's methods as its parent asks.

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
    MAX_OWN_BYTES,
    Channel,
    Frame,
    FrameReader,
    encode,
    to_bytes,
)
from frenetic.errors import Trouble, reason_of, traceback_of
from frenetic.parts.user_modules import load_user_file
from frenetic.processes.forks import one_process

CALL, ANSWER, REPORT, FAILED, LOGGED = range(5)
"""Kinds of messages: a call from the parent, and the four kinds that the process sends."""
CUT_OFF: Final = 83
"""Exit code of a process in which a driver has closed or replaced the connection to the parent."""
LIBRARY: Final = "frenetic"
"""Name of the logger whose records are passed on to the parent."""
_MOST_CHARACTERS: Final = 2_000
"""Largest number of characters of a log message; the rest is cut (our choice)."""
_MOST_NAME_CHARACTERS: Final = 200
"""Largest number of characters of a logger's name; the rest is cut (our choice)."""
_HIGHEST_LEVEL: Final = 100
"""Highest level of a log record (our choice)."""


class LoggedRecord(NamedTuple):
    """A log record of the library on its way to the parent."""

    level: Annotated[int, Meta(ge=logging.NOTSET, le=_HIGHEST_LEVEL)]
    name: Annotated[str, Meta(max_length=_MOST_NAME_CHARACTERS, pattern=r"(?s)^(\..*)?\Z")]
    """Name of the logger, without `LIBRARY`."""
    message: Annotated[str, Meta(max_length=_MOST_CHARACTERS)]


def report(value: object) -> None:
    """Send a value to the parent from within a call, before the answer.

    `ObjectProcess.receive` returns it.
    """
    _send(REPORT, value)


turn: Any = SimpleNamespace(value=0)
"""Flag whose ``value`` is 1 while a driver acts; the parent reads it if the process is lost."""


class _Sender:
    """The sender of messages to the parent, one at a time."""

    def __init__(self, channel: Channel) -> None:
        self.number = 1
        """Number of the call that is answered."""
        self._channel = channel
        self._lock = threading.Lock()
        self._owner = os.getpid()

    def send(self, kind: int, value: object) -> None:
        """Send a value; in a process that a driver has forked, send nothing."""
        if os.getpid() == self._owner:
            data = to_bytes(Frame(kind, self.number, encode(value)))
            with self._lock:
                _send_whole(self._channel, data)


_send: Callable[[int, object], None]
"""Function that sends a kind of message and a value to the parent; `serve` sets it."""


def serve(connection: Connection, files: Sequence[str], packed: bytes, shared_turn: Any) -> None:
    """Answer the parent's calls until the connection ends or the object was closed.

    Args:
        connection: connection to the parent.
        files: users' files that are loaded before the object.
        packed: the object, see `frenetic.processes.object_process.pack`.
        shared_turn: flag that becomes `turn`.
    """
    global _send, turn
    turn = shared_turn
    channel = Channel(connection, blocks=True)
    sender = _Sender(channel)
    _send = send = sender.send
    _detach_in_forks(channel)
    _pass_log_records(send)
    try:
        for file in files:
            load_user_file(file)
        # The bytes come from our own parent, so they may be unpickled.
        hosted = pickle.loads(packed)  # noqa: S301
        for sender.number, method, args in _calls(channel):  # which sets the sender's number, too
            with one_process():
                value = getattr(hosted, method)(*args)
            send(ANSWER, value)
            if method == "close":
                break
        _silence_stderr()
    except BaseException as error:  # including the SystemExit of a driver's sys.exit()
        send(FAILED, Trouble(reason_of(error), traceback_of(error)))
    finally:
        channel.close()


def _calls(channel: Channel) -> Iterator[tuple[int, str, Any]]:
    """Yield number, method and arguments of each call until the parent closes the connection."""
    frames = FrameReader(MAX_OWN_BYTES)
    while True:
        try:
            data = channel.receive()
        except (EOFError, OSError):
            _require_whole(channel)
            return
        for frame in frames.feed(data):
            # These bytes come from our own parent, too, so they may be unpickled.
            method, args = pickle.loads(frame.body)  # noqa: S301
            yield frame.number, method, args


def _send_whole(channel: Channel, data: bytes) -> None:
    """Send bytes to the parent unless the parent has ended; end this process if it is cut off."""
    _require_whole(channel)
    try:
        channel.send(data)
    except OSError:  # the parent has ended, or a driver has just closed the connection
        _require_whole(channel)


def _require_whole(channel: Channel) -> None:
    """End this process if a driver has closed the connection or replaced it by a file."""
    if not channel.is_whole:
        os._exit(CUT_OFF)


def _detach_in_forks(channel: Channel) -> None:
    """Take the connection and the flag away from each process that a driver forks."""
    if sys.platform != "win32":

        def detach() -> None:
            global turn
            turn = SimpleNamespace(value=0)
            channel.close()

        os.register_at_fork(after_in_child=detach)


def _silence_stderr() -> None:
    """Throw away what the process prints from now on, such as a driver's text on its deletion."""
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)


def _pass_log_records(send: Callable[[int, object], None]) -> None:
    """Pass the library's log records, from INFO on, to the parent."""

    class PassingHandler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            name = record.name.removeprefix(LIBRARY)[:_MOST_NAME_CHARACTERS]
            level = min(max(record.levelno, logging.NOTSET), _HIGHEST_LEVEL)
            text = record.getMessage()[:_MOST_CHARACTERS].encode(errors="replace").decode()
            send(LOGGED, LoggedRecord(level, name, text))

    library = logging.getLogger(LIBRARY)
    library.addHandler(PassingHandler(logging.INFO))
    if library.level == logging.NOTSET:
        library.setLevel(logging.INFO)
