"""A process that holds an object and does one call at a time.

An isolated driver has one such process; the local workers of a campaign, the runs of a bench and
the fitting of a twin have several. The process leaves Ctrl-C to its parent and ends when its parent
ends; it is killed with all that it has started. What the library logs in the process is logged in
the parent. The code that runs in the process is `frenetic.processes.object_host`.

A user's code runs in the process, so the parent trusts no message from it: an answer is one of
`frenetic._support.messages`, of a type that the caller names, and each call has a time limit. The
parent's own messages are pickled.
"""

from __future__ import annotations

import logging
import pickle
import sys
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from enum import Enum
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, NamedTuple

from frenetic._support.messages import (
    MAX_OWN_BYTES,
    Channel,
    Frame,
    FrameReader,
    ProtocolError,
    decode,
    to_bytes,
)
from frenetic.errors import CampaignError, Trouble, describe_error
from frenetic.parts.user_modules import user_files
from frenetic.processes.children import (
    ending_of,
    kill_process,
    process_context,
    start_process,
)
from frenetic.processes.keeper import END_LIMIT
from frenetic.processes.object_host import (
    ANSWER,
    CALL,
    CUT_OFF,
    FAILED,
    LIBRARY,
    LOGGED,
    REPORT,
    LoggedRecord,
    serve,
)
from frenetic.processes.shared_flag import SharedFlag

START_LIMIT: Final = 600.0
"""Time that a process has to start its object, in s (our choice)."""
CLOSING_LIMIT: Final = 30.0
"""Time that a process has to close its object, in s (our choice)."""
MOST_WORKERS: Final = 30 if sys.platform == "win32" else sys.maxsize
"""Largest number of processes at once: Windows waits for 64 handles, two of each process."""
_EXIT_LIMIT: Final = 1.0
"""Time that a process has to end after its object was closed, in s (our choice)."""
_KILLED: Final = -9
"""Exit code of a process that SIGKILL has ended."""
_MOST_LOG_RECORDS: Final = 1_000
"""Largest number of log records of one call that are passed on (our choice)."""
_MAIN_HINT: Final = (
    "see its traceback; scripts that start workers need 'if __name__ == \"__main__\":'"
)

logger = logging.getLogger(__name__)


class Loss(Enum):
    """How a process was lost."""

    RAISED = "its object raised"
    LATE = "a call took too long"
    ENDED = "its process ended"
    KILLED = "its process was killed, by itself or by the system"
    BROKE_PROTOCOL = "it sent something else than an answer, or closed its connection"


class LostProcessError(Exception):
    """A process died, hung or broke the protocol, or its object raised."""

    def __init__(self, trouble: Trouble, loss: Loss, *, is_drivers_turn: bool = False) -> None:
        super().__init__(trouble.reason)
        self.trouble = trouble
        self.loss = loss
        self.is_drivers_turn = is_drivers_turn
        """Whether a driver was acting, see `frenetic.processes.object_host.turn`."""


class RaisedError(LostProcessError):
    """The object in a process raised."""

    def __init__(self, trouble: Trouble) -> None:
        super().__init__(trouble, Loss.RAISED)


class Call(NamedTuple):
    """A call that was sent and has no answer yet."""

    number: int
    """Number from 1 in the order of calls."""
    limit: float
    """Time that the call may take, in s."""
    answer: Any
    """Type of the answer."""
    report: Any
    """Type of the reports; None for a method that reports nothing."""


class ObjectProcess:
    """A process that holds an object and does one call at a time.

    Args:
        name: name of the process in messages.
        packed: the object, see `pack`.
        preloads: modules that the server of processes imports, see `process_context`.
        files: users' files that the process loads before the object; by default the files that
            the parent has loaded.
    """

    def __init__(
        self,
        name: str,
        packed: bytes,
        preloads: Sequence[str] = (),
        files: Sequence[str] | None = None,
    ) -> None:
        self.name = name
        self.since = 0.0
        """Time at which the present call began, on the monotonic clock, in s."""
        self._packed = packed
        self._preloads = preloads
        self._files = files
        self._calls: deque[Call] = deque()  # the present call first
        self._number = 0  # of the last call that was sent
        self._process: BaseProcess | None = None
        self._channel: Channel
        self._frames: FrameReader
        self._turn: SharedFlag
        self._log_count = 0  # log records of the present call
        # A loss that came after answers: the answers are returned first, then the loss is raised.
        self._loss: LostProcessError | None = None

    def __len__(self) -> int:
        """Return the number of calls without an answer."""
        return len(self._calls)

    @property
    def deadline(self) -> float:
        """Time until which to wait, on the monotonic clock, in s; infinite without a call."""
        if self._loss is not None:
            return -float("inf")
        return self.since + self._calls[0].limit if self._calls else float("inf")

    @property
    def handles(self) -> tuple[Any, Any]:
        """Handles for `multiprocessing.connection.wait`, ready at a message or the end."""
        assert self._process is not None
        return self._channel.handle, self._process.sentinel

    def start(self, start_answer: Any = None) -> None:
        """Start the process, which calls the object's ``start``, without waiting.

        Args:
            start_answer: type of the value that ``start`` returns.

        Raises:
            OSError: there are too many processes.
            EOFError: the server that makes them was killed.
        """
        context = process_context(self._preloads)
        turn = SharedFlag()
        try:
            self._process, connection = start_process(
                context,
                serve,
                user_files() if self._files is None else self._files,
                self._packed,
                turn,
                name=self.name,
            )
        except BaseException:
            turn.close()
            raise
        self._turn, self._frames, self._loss = turn, FrameReader(), None
        self._log_count = 0
        self._channel = Channel(connection, blocks=False)
        self.send("start", limit=START_LIMIT, answer=start_answer)

    def send(
        self, method: str, *args: object, limit: float, answer: Any = None, report: Any = None
    ) -> None:
        """Ask the process to call a method of the object, after the calls that were sent before.

        Args:
            method: name of the method.
            args: arguments of the method.
            limit: time that the call may take, in s.
            answer: type of the answer.
            report: type of the values that the method sends by `report`; None if it sends none.
        """
        self._number += 1
        if not self._calls:
            self.since = time.monotonic()
        self._calls.append(Call(self._number, limit, answer, report))
        call = Frame(CALL, self._number, pickle.dumps((method, args)))
        data = to_bytes(call, MAX_OWN_BYTES)
        with suppress(OSError):  # the process has died or does not read: `receive` will notice
            self._channel.send(data, deadline=time.monotonic() + limit)

    def receive(self) -> list[Any]:
        """Return the answers and reports that have come, in the order of the calls; do not wait.

        Raises:
            LostProcessError: the process has died, the call raised or took too long, or the answer
                has another type.
        """
        self._raise_loss()
        assert self._process is not None
        try:
            data = self._channel.receive()
        except (EOFError, OSError):
            raise self._end_error() from None
        answers: list[Any] = []
        try:
            for frame in self._frames.feed(data):
                self._take_message(frame, answers)
        except ProtocolError as error:
            self._loss = self._loss_error(f"it broke the protocol: {error}", Loss.BROKE_PROTOCOL)
        except RaisedError as error:
            self._loss = error
        if answers:
            return answers
        self._raise_loss()
        if not data and not self._process.is_alive():
            raise self._end_error()
        if time.monotonic() > self.deadline:
            work = "start" if self._calls[0].number == 1 else "drive"
            reason = f"its {work} took more than {self._calls[0].limit:.3g} s"
            raise self._loss_error(reason, Loss.LATE)
        return answers

    def _raise_loss(self) -> None:
        """Raise the loss that came after answers, which were returned, and forget it."""
        loss, self._loss = self._loss, None
        try:
            if loss is not None:
                raise loss
        finally:
            del (
                loss
            )  # the error's traceback holds this frame, so the two would keep each other alive

    def _end_error(self) -> LostProcessError:
        """Return the error for a process that has ended, or is no longer connected."""
        assert self._process is not None
        self._process.join(END_LIMIT + _EXIT_LIMIT)
        exit_code = self._process.exitcode
        if exit_code in (None, CUT_OFF):
            return self._loss_error(
                "the descriptors of its process were closed", Loss.BROKE_PROTOCOL
            )
        loss = Loss.KILLED if exit_code == _KILLED else Loss.ENDED
        hint = f", {_MAIN_HINT}" if exit_code == 1 else ""
        return self._loss_error(f"it {ending_of(exit_code)}{hint}", loss)

    def _loss_error(self, reason: str, loss: Loss) -> LostProcessError:
        """Return the error for a lost process; it says whether a driver was acting."""
        return LostProcessError(Trouble(reason), loss, is_drivers_turn=self._turn.is_set)

    def _take_message(self, frame: Frame, answers: list[Any]) -> None:
        """Take a message of the process; add an answer or a report to `answers`.

        Raises:
            ProtocolError: no message of this kind is expected.
            RaisedError: the call raised.
        """
        call = self._calls[0] if self._calls else None
        if frame.kind == LOGGED:
            self._log(decode(frame.body, LoggedRecord))
        elif frame.kind == FAILED:
            raise RaisedError(decode(frame.body, Trouble))
        elif frame.number <= self._number - len(self._calls):  # its call was answered before
            logger.warning("%s sent what is not counted: does the driver fork?", self.name)
        elif call is None or frame.number != call.number:
            raise ProtocolError("nobody has asked for it")
        elif frame.kind == REPORT and call.report is not None:
            answers.append(decode(frame.body, call.report))
        elif frame.kind == ANSWER:
            answers.append(decode(frame.body, call.answer))
            self._calls.popleft()
            self.since = time.monotonic()
            self._log_count = 0
        else:
            raise ProtocolError("it is of another kind")

    def _log(self, record: LoggedRecord) -> None:
        """Log a record of the process, up to `_MOST_LOG_RECORDS` records per call."""
        self._log_count += 1
        if self._log_count <= _MOST_LOG_RECORDS:
            target = logging.getLogger(f"{LIBRARY}{record.name}")
            target.log(record.level, "%s: %s", self.name, record.message)
        elif self._log_count == _MOST_LOG_RECORDS + 1:
            logger.warning(
                "%s logs more than %d lines: the rest is left out", self.name, _MOST_LOG_RECORDS
            )

    def call(self, method: str, *args: object, limit: float, answer: Any = None) -> Any:
        """Call a method of the object and wait for the answer, a value of type `answer`.

        Raises:
            LostProcessError: the process was lost, see `receive`.
        """
        self.send(method, *args, limit=limit, answer=answer)
        return self.answer()

    def answer(self) -> Any:
        """Wait for the answers to all calls; return the answer to the last call.

        Raises:
            LostProcessError: the process was lost, see `receive`.
        """
        answers: list[Any] = []
        while self._calls:
            ready([self])
            answers += self.receive()
        return answers[-1]

    def close(self) -> None:
        """Close the object unless it is in a call, then end the process.

        Raises:
            LostProcessError: the object's ``close`` raised.
        """
        if self._process is None:
            return
        try:
            if not self._calls and self._process.is_alive():
                try:
                    self.call("close", limit=CLOSING_LIMIT)
                except LostProcessError as error:
                    if (
                        error.trouble.traceback
                    ):  # otherwise the process died or hung: it is killed below
                        raise
                # No longer: a driver's threads and processes may never end.
                self._process.join(_EXIT_LIMIT)
        finally:
            self.kill()

    def kill(self) -> None:
        """Kill the process with all that it has started."""
        process, self._process = self._process, None
        self._calls.clear()
        self._number = 0
        if process is not None:
            kill_process(process)
            process.join()
            process.close()
            self._channel.close()
            self._turn.close()


def ready(processes: Iterable[ObjectProcess], timeout: float = 3600.0) -> list[ObjectProcess]:
    """Wait for messages for at most `timeout` s; return the processes to `receive` from.

    These are processes that have sent a message, have ended, or have passed their deadline.
    """
    processes, now = list(processes), time.monotonic()
    handles = [handle for process in processes for handle in process.handles]
    longest_wait = min([timeout, *(process.deadline - now for process in processes)])
    ready_handles, now = set(wait(handles, max(0.0, longest_wait))), time.monotonic()
    return [
        process
        for process in processes
        if process.deadline < now or not ready_handles.isdisjoint(process.handles)
    ]


def pack(part: object) -> bytes:
    """Return an object as bytes for a process that has loaded the user's files.

    Raises:
        CampaignError: the object cannot be copied.
    """
    try:
        return pickle.dumps(part)
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be copied to another process"
            f" ({describe_error(error)}): name it in a Spec, so that each process makes its own, or"
            " drive it in this process, with one worker"
        ) from error
