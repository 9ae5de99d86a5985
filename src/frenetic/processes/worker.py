"""A process that holds an object and does one call at a time.

Isolation is one such worker; local workers of a campaign, runs of a bench and the fitting of a twin
are several. The process leaves Ctrl-C to its parent and ends with it; it is killed with all that it
has started. What the library logs there is logged here.

Foreign code runs in the process, so this side believes nothing that comes from there: answers are
`frenetic._support.messages` of a type that the caller names, and each call has a time limit. What
this side sends is pickled.
"""

from __future__ import annotations

import logging
import os
import pickle
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from enum import Enum
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Final, NamedTuple

from msgspec import Meta

from frenetic._support.messages import (
    MOST_BYTES_OF_OURS,
    Channel,
    Frame,
    FrameReader,
    ProtocolError,
    decode,
    encode,
    to_bytes,
)
from frenetic.errors import CampaignError, Trouble, describe_error, reason_of, traceback_of
from frenetic.parts.user_modules import load_user_file, user_files
from frenetic.processes.children import (
    END_LIMIT,
    SharedFlag,
    ending_of,
    kill_process,
    one_process,
    process_context,
    start_process,
)

START_LIMIT: Final = 600.0
"""Time that a worker may take to start what it holds, in s."""
CLOSING_LIMIT: Final = 30.0
"""Time that it has to close it, in s."""
MOST_WORKERS: Final = 30 if sys.platform == "win32" else sys.maxsize
"""Most workers at once: Windows waits for 64 objects."""
_LEAVING_LIMIT: Final = 1.0  # s that the process has to leave after that
_CUT_OFF: Final = 83
"""Exit code of a process whose connection was closed or replaced in it."""
_KILLED: Final = -9  # exit code, SIGKILL's
_MOST_LOGGED: Final = 2_000  # characters of a log message
_MOST_RECORDS: Final = 1_000  # that are logged of one call
_MOST_LEVEL: Final = 100  # of a log message
_LIBRARY: Final = "frenetic"
"""Name of the logger whose records are passed on."""
_HINT: Final = "see its traceback; scripts that start workers need 'if __name__ == \"__main__\":'"

logger = logging.getLogger(__name__)


class Loss(Enum):
    """How a worker was lost."""

    RAISED = "what it holds raised"
    LATE = "a call took too long"
    ENDED = "its process ended"
    KILLED = "its process was killed, by itself or by the system"
    BROKE_PROTOCOL = "what it sent is no answer, or its connection was closed in it"


class LostWorkerError(Exception):
    """A worker died, hangs, breaks the protocol, or what it holds raised."""

    def __init__(self, trouble: Trouble, loss: Loss, *, is_drivers_turn: bool = False) -> None:
        super().__init__(trouble.reason)
        self.trouble = trouble
        self.loss = loss
        self.is_drivers_turn = is_drivers_turn
        """Whether a driver was being asked, see `turn`."""


class RaisedError(LostWorkerError):
    """What a worker holds raised."""

    def __init__(self, trouble: Trouble) -> None:
        super().__init__(trouble, Loss.RAISED)


class Call(NamedTuple):
    """A call that was sent and is not answered."""

    number: int
    limit: float
    """s."""
    answer: Any
    """Type of its answer."""
    report: Any
    """Type of its reports; None without any."""


class Worker:
    """A process that holds an object and does one call at a time.

    Args:
        name: for messages.
        held: the object, see `pack`.
        files: users' files that the process loads before the object; by default those that this
            one has loaded.
        preloads: modules that the server of processes imports beside the usual ones.
    """

    def __init__(
        self,
        name: str,
        held: bytes,
        preloads: Sequence[str] = (),
        files: Sequence[str] | None = None,
    ) -> None:
        self.name = name
        self.since = 0.0
        """When its present call began, on the monotonic clock."""
        self._held = held
        self._preloads = preloads
        self._files = files
        self._calls: deque[Call] = deque()  # the present one first
        self._number = 0
        self._process: BaseProcess | None = None
        self._channel: Channel
        self._frames: FrameReader
        self._turn: SharedFlag
        self._logged = 0  # records of the present call
        self._loss: LostWorkerError | None = None  # to be raised after the answers before it

    def __len__(self) -> int:
        """Number of calls that were sent and are not answered."""
        return len(self._calls)

    @property
    def deadline(self) -> float:
        """End of the present call's time, on the monotonic clock; infinite without one."""
        if self._loss is not None:
            return -float("inf")
        return self.since + self._calls[0].limit if self._calls else float("inf")

    @property
    def handles(self) -> tuple[Any, Any]:
        """What `multiprocessing.connection.wait` tells ready when it sends something, or ends."""
        assert self._process is not None
        return self._channel.handle, self._process.sentinel

    def start(self, start_answer: Any = None) -> None:
        """Starts the process, which calls the object's ``start``, without waiting.

        Args:
            start_answer: type of what ``start`` returns.

        Raises:
            OSError: there are too many processes.
            EOFError: the server that makes them was killed.
        """
        context = process_context(self._preloads)
        turn = SharedFlag()
        try:
            self._process, connection = start_process(
                context,
                _serve,
                user_files() if self._files is None else self._files,
                self._held,
                turn,
                name=self.name,
            )
        except BaseException:
            turn.close()
            raise
        self._turn, self._frames, self._loss = turn, FrameReader(), None
        self._logged = 0
        self._channel = Channel(connection, blocks=False)
        self.send("start", limit=START_LIMIT, answer=start_answer)

    def send(
        self, method: str, *args: object, limit: float, answer: Any = None, report: Any = None
    ) -> None:
        """Let it call a method of the object after the calls before.

        Args:
            method: name of the method.
            args: its arguments.
            limit: s that the call may take.
            answer: type of the answer.
            report: type of what the method reports, see `report`; None if it reports nothing.
        """
        self._number += 1
        if not self._calls:
            self.since = time.monotonic()
        self._calls.append(Call(self._number, limit, answer, report))
        call = Frame(_CALL, self._number, pickle.dumps((method, args)))
        data = to_bytes(call, MOST_BYTES_OF_OURS)
        with suppress(OSError):  # it has died, or does not listen, as will be heard
            self._channel.send(data, deadline=time.monotonic() + limit)

    def receive(self) -> list[Any]:
        """Answers and reports that are there, in the order of the calls; waits for nothing.

        Raises:
            LostWorkerError: it has died, the call raised or took too long, or the answer is of
                another type.
        """
        self._raise_loss()
        assert self._process is not None
        try:
            data = self._channel.receive()
        except (EOFError, OSError):
            raise self._ended() from None
        answers: list[Any] = []
        try:
            for frame in self._frames.feed(data):
                self._hear(frame, answers)
        except ProtocolError as error:
            self._loss = self._lost(f"it broke the protocol: {error}", Loss.BROKE_PROTOCOL)
        except RaisedError as error:
            self._loss = error
        if answers:
            return answers
        self._raise_loss()
        if not data and not self._process.is_alive():
            raise self._ended()
        if time.monotonic() > self.deadline:
            work = "start" if self._calls[0].number == 1 else "drive"
            reason = f"its {work} took more than {self._calls[0].limit:.3g} s"
            raise self._lost(reason, Loss.LATE)
        return answers

    def _raise_loss(self) -> None:
        """Raise the loss that came behind answers which are returned by now, and forget it."""
        loss, self._loss = self._loss, None
        try:
            if loss is not None:
                raise loss
        finally:
            del loss

    def _ended(self) -> LostWorkerError:
        """The error for a process that has ended, or is no longer connected."""
        assert self._process is not None
        self._process.join(END_LIMIT + _LEAVING_LIMIT)
        exit_code = self._process.exitcode
        if exit_code in (None, _CUT_OFF):
            return self._lost("the descriptors of its process were closed", Loss.BROKE_PROTOCOL)
        loss = Loss.KILLED if exit_code == _KILLED else Loss.ENDED
        hint = f", {_HINT}" if exit_code == 1 else ""
        return self._lost(f"it {ending_of(exit_code)}{hint}", loss)

    def _lost(self, reason: str, loss: Loss) -> LostWorkerError:
        return LostWorkerError(Trouble(reason), loss, is_drivers_turn=self._turn.is_set)

    def _hear(self, frame: Frame, answers: list[Any]) -> None:
        """Take one message.

        Raises:
            ProtocolError: it is no message that may come now.
            RaisedError: the call raised.
        """
        call = self._calls[0] if self._calls else None
        if frame.kind == _LOGGED:
            self._log(decode(frame.body, _Logged))
        elif frame.kind == _FAILED:
            raise RaisedError(decode(frame.body, Trouble))
        elif frame.number <= self._number - len(self._calls):
            logger.warning("%s sent what is not counted: does the driver fork?", self.name)
        elif call is None or frame.number != call.number:
            raise ProtocolError("nobody has asked for it")
        elif frame.kind == _REPORT and call.report is not None:
            answers.append(decode(frame.body, call.report))
        elif frame.kind == _ANSWER:
            answers.append(decode(frame.body, call.answer))
            self._calls.popleft()
            self.since = time.monotonic()
            self._logged = 0
        else:
            raise ProtocolError("it is of another kind")

    def _log(self, record: _Logged) -> None:
        """Log what the library logged there, up to `_MOST_RECORDS` records a call."""
        self._logged += 1
        if self._logged <= _MOST_RECORDS:
            target = logging.getLogger(f"{_LIBRARY}{record.name}")
            target.log(record.level, "%s: %s", self.name, record.message)
        elif self._logged == _MOST_RECORDS + 1:
            logger.warning(
                "%s logs more than %d lines: the rest is left out", self.name, _MOST_RECORDS
            )

    def call(self, method: str, *args: object, limit: float, answer: Any = None) -> Any:
        """Call a method of the object and wait for its answer, which is of the given type.

        Raises:
            LostWorkerError: as for `receive`.
        """
        self.send(method, *args, limit=limit, answer=answer)
        return self.answer()

    def answer(self) -> Any:
        """Waits for the answer to the last call.

        Raises:
            LostWorkerError: as for `receive`.
        """
        answers: list[Any] = []
        while self._calls:
            ready([self])
            answers += self.receive()
        return answers[-1]

    def close(self) -> None:
        """Lets the object close and the process end, if it does nothing else; kills it then.

        Raises:
            LostWorkerError: the object's ``close`` raised.
        """
        if self._process is None:
            return
        try:
            if not self._calls and self._process.is_alive():
                try:
                    self.call("close", limit=CLOSING_LIMIT)
                except LostWorkerError as error:
                    if error.trouble.traceback:
                        raise
                # Not for a driver's threads and processes, which may never end.
                self._process.join(_LEAVING_LIMIT)
        finally:
            self.kill()

    def kill(self) -> None:
        """Kills the process with all that it has started."""
        process, self._process = self._process, None
        self._calls.clear()
        self._number = 0
        if process is not None:
            kill_process(process)
            process.join()
            process.close()
            self._channel.close()
            self._turn.close()


def ready(workers: Iterable[Worker], timeout: float = 3600.0) -> list[Worker]:
    """Waits for at most so many s; returns the workers to `receive` from."""
    workers, now = list(workers), time.monotonic()
    handles = [handle for worker in workers for handle in worker.handles]
    left = min([timeout, *(worker.deadline - now for worker in workers)])
    heard, now = set(wait(handles, max(0.0, left))), time.monotonic()
    return [w for w in workers if w.deadline < now or not heard.isdisjoint(w.handles)]


# In the process


def report(value: object) -> None:
    """Send a value from within a call, which `Worker.receive` gives before the call's answer."""
    _send(_REPORT, value)


turn: Any = SimpleNamespace(value=0)
"""Its ``value`` is 1 while a driver is asked; in a worker, the parent sees it."""

_CALL, _ANSWER, _REPORT, _FAILED, _LOGGED = range(5)  # kinds of messages


class _Logged(NamedTuple):
    level: Annotated[int, Meta(ge=logging.NOTSET, le=_MOST_LEVEL)]
    name: Annotated[str, Meta(max_length=200, pattern=r"(?s)^(\..*)?\Z")]
    """Name of the logger, without `_LIBRARY`."""
    message: Annotated[str, Meta(max_length=_MOST_LOGGED)]


class _Sender:
    """Sends messages to the parent, one at a time."""

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


def _serve(connection: Connection, files: Sequence[str], held: bytes, shared: Any) -> None:
    """Answers the calls from the connection until it ends or the object was closed."""
    global _send, turn  # of this process
    turn = shared
    channel = Channel(connection, blocks=True)
    sender = _Sender(channel)
    _send = send = sender.send
    _let_forks_go(channel)
    _attach_log(send)
    try:
        for file in files:
            load_user_file(file)
        # It comes from our own parent, so it may be unpickled.
        thing = pickle.loads(held)  # noqa: S301
        for sender.number, method, args in _calls(channel):
            with one_process():
                value = getattr(thing, method)(*args)
            send(_ANSWER, value)
            if method == "close":
                break
        _fall_silent()
    except BaseException as error:  # also what a driver's sys.exit() raises
        send(_FAILED, Trouble(reason_of(error), traceback_of(error)))
    finally:
        channel.close()


def _calls(channel: Channel) -> Iterator[tuple[int, str, Any]]:
    """Number, method and arguments of each call until the parent closes the connection."""
    frames = FrameReader(MOST_BYTES_OF_OURS)
    while True:
        try:
            data = channel.receive()
        except (EOFError, OSError):
            _require_whole(channel)
            return
        for frame in frames.feed(data):
            # Likewise.
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
        os._exit(_CUT_OFF)


def _let_forks_go(channel: Channel) -> None:
    """Take the connection and the flag from each process that a driver forks."""
    if sys.platform != "win32":

        def let_go() -> None:
            global turn
            turn = SimpleNamespace(value=0)
            channel.close()

        os.register_at_fork(after_in_child=let_go)


def _fall_silent() -> None:
    """Lets nobody hear what a driver says when it is thrown away."""
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)


def _attach_log(send: Callable[[int, object], None]) -> None:
    """Pass the library's log records, from INFO on, to the parent."""

    class Passing(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            name = record.name.removeprefix(_LIBRARY)[:200]
            level = min(max(record.levelno, logging.NOTSET), _MOST_LEVEL)
            text = record.getMessage()[:_MOST_LOGGED].encode(errors="replace").decode()
            send(_LOGGED, _Logged(level, name, text))

    library = logging.getLogger(_LIBRARY)
    library.addHandler(Passing(logging.INFO))
    if library.level == logging.NOTSET:
        library.setLevel(logging.INFO)


# Copies of objects for other processes


def pack(part: object) -> bytes:
    """An object as bytes for a process that has loaded the user's files.

    Raises:
        CampaignError: it cannot be copied.
    """
    try:
        return pickle.dumps(part)
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be copied to another process"
            f" ({describe_error(error)}): name it in a Spec, so that each process makes its own, or"
            " drive it in this process, with one worker"
        ) from error
