"""A process that holds an object and does one call at a time.

Isolation is one such worker; local workers of a campaign, runs of a bench and the fitting of a twin
are several. The process leaves Ctrl-C to its parent and ends with it; it is killed with all that it
has started. What the library logs there is logged here.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from frenetic._support.child_processes import (
    ending_of,
    kill_process,
    one_process,
    process_context,
    stand_alone,
    start_process,
)
from frenetic.errors import (
    ENDS_ITS_PROCESS,
    HANGS,
    CampaignError,
    Fault,
    describe_error,
    reason_of,
    traceback_of,
)
from frenetic.registry import load_user_file, made_by, user_files

START_LIMIT: Final = 600.0
"""Time that a worker may take to start what it holds, in s."""
CLOSING_LIMIT: Final = 30.0
"""Time that it has to close it, in s."""
MOST_WORKERS: Final = 30 if sys.platform == "win32" else sys.maxsize
"""Most workers at once: Windows waits for 64 objects."""
_LEAVING_LIMIT: Final = 1.0  # s that the process has to leave after that
_HINT: Final = "see its traceback; scripts that start workers need 'if __name__ == \"__main__\":'"

logger = logging.getLogger(__name__)


class LostWorkerError(Exception):
    """A worker died, hangs, or what it holds raised."""

    def __init__(self, reason: str, traceback: str = "", fault: Fault | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.traceback = traceback
        self.fault = fault
        """The driver's, if it was its turn when the worker died or had taken too long."""


class RaisedError(LostWorkerError):
    """What a worker holds raised."""


class Worker:
    """A process that holds an object and does one call at a time.

    Args:
        name: for messages.
        held: the object, see `pack`.
        preloads: modules that the server of processes imports beside the usual ones.
    """

    def __init__(self, name: str, held: bytes, preloads: Sequence[str] = ()) -> None:
        self.name = name
        self.since = 0.0
        """When its present call began, on the monotonic clock."""
        self._held = held
        self._preloads = preloads
        self._calls: deque[tuple[int, float]] = deque()  # number and limit, the present one first
        self._number = 0
        self._process: BaseProcess | None = None
        self._connection: Connection
        self._turn: Any  # shared with the process, see `turn`

    def __len__(self) -> int:
        """Number of calls that were sent and are not answered."""
        return len(self._calls)

    @property
    def deadline(self) -> float:
        """End of the present call's time, on the monotonic clock; infinite without one."""
        return self.since + self._calls[0][1] if self._calls else float("inf")

    @property
    def handles(self) -> tuple[Any, Any]:
        """What `multiprocessing.connection.wait` tells ready when it sends something, or ends."""
        assert self._process is not None
        return self._connection, self._process.sentinel

    def start(self) -> None:
        """Starts the process, which calls the object's ``start``, without waiting.

        Raises:
            OSError: there are too many processes.
            EOFError: the server that makes them was killed.
        """
        context = process_context(self._preloads)
        self._turn = context.RawValue("b", 0)
        self._process, self._connection = start_process(
            context, _serve, user_files(), self._held, self._turn, name=self.name
        )
        self.send("start", limit=START_LIMIT)

    def send(self, method: str, *args: object, limit: float) -> None:
        """Lets it call a method of the object after the calls before, for at most so many s."""
        self._number += 1
        if not self._calls:
            self.since = time.monotonic()
        self._calls.append((self._number, limit))
        with suppress(OSError):  # it has died, as will be heard
            self._connection.send_bytes(pickle.dumps((self._number, method, args)))

    def receive(self) -> list[Any]:
        """Answers and reports that are there, in the order of the calls; waits for nothing.

        Raises:
            LostWorkerError: it has died, the call raised, or took too long.
        """
        answers: list[Any] = []
        assert self._process is not None
        try:
            while self._connection.poll():
                # It comes from our own process, so it may be unpickled.
                self._hear(pickle.loads(self._connection.recv_bytes()), answers)  # noqa: S301
        except LostWorkerError:
            raise
        except Exception:  # its end, or nonsense that a driver has written there
            self._process.join(_LEAVING_LIMIT)
            raise self._lost() from None
        if answers:
            return answers
        if not self._process.is_alive() and not self._connection.poll():
            raise self._lost()
        if time.monotonic() > self.deadline:
            what = "start" if self._calls[0][0] == 1 else "drive"
            reason = f"its {what} took more than {self._calls[0][1]:.3g} s"
            raise LostWorkerError(reason, fault=self._fault(HANGS))
        return answers

    def _lost(self) -> LostWorkerError:
        assert self._process is not None
        end = f"it {ending_of(self._process.exitcode)}"
        reason = f"{end}, {_HINT}" if self._process.exitcode == 1 else end
        return LostWorkerError(reason, fault=self._fault(ENDS_ITS_PROCESS))

    def _fault(self, kind: str) -> Fault | None:
        """The driver's fault, if it is its turn."""
        return Fault("driver", kind) if self._turn.value else None

    def _hear(self, message: _Message, answers: list[Any]) -> None:
        match message:
            case _Logged(level, name, text):
                logging.getLogger(name).log(level, "%s: %s", self.name, text)
            case _Failed(reason, traceback):
                raise RaisedError(reason, traceback)
            case _Report(value):
                answers.append(value)
            case _Answer(number, value) if self._calls and self._calls[0][0] == number:
                self._calls.popleft()
                self.since = time.monotonic()
                answers.append(value)
            case _:
                logger.warning("%s sent what is not counted: does the driver fork?", self.name)

    def call(self, method: str, *args: object, limit: float) -> Any:
        """Calls a method of the object and waits for its answer.

        Raises:
            LostWorkerError: as for `receive`.
        """
        self.send(method, *args, limit=limit)
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
                    if error.traceback:
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
            self._connection.close()


def ready(workers: Iterable[Worker], timeout: float = 3600.0) -> list[Worker]:
    """Waits for at most so many s; returns the workers to `receive` from."""
    workers, now = list(workers), time.monotonic()
    handles = [handle for worker in workers for handle in worker.handles]
    left = min([timeout, *(worker.deadline - now for worker in workers)])
    heard, now = set(wait(handles, max(0.0, left))), time.monotonic()
    return [w for w in workers if w.deadline < now or not heard.isdisjoint(w.handles)]


# In the process


def report(value: object) -> None:
    """Sends a value from within a call, which `Worker.receive` gives before the call's answer."""
    _send(_Report(value))


turn: Any = SimpleNamespace(value=0)
"""Its ``value`` is 1 while a driver is asked; in a worker, the parent sees it."""


class _Answer(NamedTuple):
    number: int
    value: Any


class _Failed(NamedTuple):
    reason: str
    traceback: str


class _Logged(NamedTuple):
    level: int
    name: str
    message: str


class _Report(NamedTuple):
    value: Any


_Message = _Answer | _Failed | _Logged | _Report
_send: Callable[[_Message], None]  # to the parent


def _serve(connection: Connection, files: Sequence[str], held: bytes, shared: Any) -> None:
    """Answers the calls from the connection until it ends or the object was closed."""
    global _send, turn  # of this process
    turn = shared
    stand_alone()
    lock = threading.Lock()

    def send(message: _Message) -> None:
        data = pickle.dumps(message)
        with lock, suppress(OSError):  # the parent has gone, or a driver has closed it
            connection.send_bytes(data)

    _send = send
    _attach_log(send)
    try:
        for file in files:
            load_user_file(file)
        thing, method = unpack(held), ""
        while method != "close":
            # It comes from our own parent, so it may be unpickled.
            number, method, args = pickle.loads(connection.recv_bytes())  # noqa: S301
            with one_process():
                value = getattr(thing, method)(*args)
            send(_Answer(number, value))
        _fall_silent()
    except (EOFError, OSError) as error:
        if not isinstance(error, EOFError) and traceback_of(error):
            send(_Failed(reason_of(error), traceback_of(error)))
    except BaseException as error:  # also what a driver's sys.exit() raises
        send(_Failed(reason_of(error), traceback_of(error)))
    finally:
        with suppress(OSError):
            connection.close()


def _fall_silent() -> None:
    """Lets nobody hear what a driver says when it is thrown away."""
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)


def _attach_log(send: Callable[[_Message], None]) -> None:
    """Passes the library's log records, from INFO on, to the parent."""
    owner = os.getpid()

    class Sender(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if os.getpid() == owner:
                send(_Logged(record.levelno, record.name, record.getMessage()))

    library = logging.getLogger("frenetic")
    library.addHandler(Sender(logging.INFO))
    if library.level == logging.NOTSET:
        library.setLevel(logging.INFO)


# Copies of objects for other processes


class StandIn:
    """A part that is not made in this process; its copy by `pack` is the part itself."""

    @property
    def maker(self) -> Callable[[], Any]:
        """Makes the part."""
        raise NotImplementedError


def pack(part: object, known: object = None) -> bytes:
    """An object as bytes for a process that has loaded the user's files.

    What cannot be pickled, such as a loaded network, is made anew there, if it was made by name.

    Args:
        part: a driver, a simulator, or what holds them.
        known: a part of it that the other process has already.

    Raises:
        CampaignError: it cannot be copied.
    """
    errors: list[Exception] = []
    for by_name in (False, True):
        file = io.BytesIO()
        try:
            _Pickler(file, known, by_name).dump(part)
        except Exception as error:
            errors.append(error)
        else:
            return file.getvalue()
    raise CampaignError(
        "the driver or simulator cannot be copied to another process"
        f" ({describe_error(errors[0])}): define it in a module of its own, or drive it in this"
        " process, with a Campaign of objects and one worker"
    ) from errors[0]


def unpack(data: bytes, known: object = None) -> Any:
    """The object in bytes from `pack`; any error for other bytes."""
    return _Unpickler(data, known).load()


class _Pickler(pickle.Pickler):
    """Leaves out a known part, and writes the names of others."""

    def __init__(self, file: io.BytesIO, known: object, by_name: bool) -> None:
        super().__init__(file)
        self._known = known
        self._by_name = by_name

    def persistent_id(self, part: object) -> str | None:
        return "known" if part is self._known and part is not None else None

    def reducer_override(self, part: object) -> Any:
        if isinstance(part, StandIn):
            return part.maker, ()
        made = made_by(part) if self._by_name else None
        if made is None:
            return NotImplemented
        return partial(made.factory, **made.arguments), ()


class _Unpickler(pickle.Unpickler):
    """Puts the known part in its place; the bytes come from our own process."""

    def __init__(self, data: bytes, known: object) -> None:
        super().__init__(io.BytesIO(data))
        self._known = known

    def persistent_load(self, pid: str) -> object:  # noqa: ARG002 - there is one
        return self._known
