"""The work of a worker process: it tests the candidates from its connection."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from operator import attrgetter
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import Placement, RoadTester
from frenetic.errors import reason_of, traceback_of
from frenetic.oracle import Departure, Result
from frenetic.outcome import Outcome
from frenetic.registry import load_user_file
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin

if sys.platform == "linux":
    import fcntl


LOST_PARENT: Final = 1
"""Exit code of a worker whose campaign is gone."""


def serve(connection: Connection, user_files: Sequence[str], tester: bytes) -> None:
    """Tests candidates from the connection until it ends or a None comes.

    Args:
        connection: gives candidates, takes messages.
        user_files: the user's own modules, to load first.
        tester: a pickled `RoadTester`, from the process that started this one.
    """
    stand_alone()
    campaign = _Campaign(connection)
    logger = logging.getLogger("frenetic")
    logger.addHandler(_Sending(campaign.send))
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.INFO)
    try:
        for file in user_files:
            load_user_file(file)
        # Made by our own parent a moment ago and given to us alone, so it may be unpickled.
        the_tester: RoadTester = pickle.loads(tester)  # noqa: S301
        while _serve_one_start(campaign, the_tester):
            pass
    except _GoneError:
        pass
    except BaseException as error:  # also what a driver's sys.exit() raises
        with suppress(_GoneError):
            campaign.send(WorkerFailed(reason_of(error), traceback_of(error)))
    finally:
        connection.close()  # which says that the simulator has ended


def _serve_one_start(campaign: _Campaign, tester: RoadTester) -> bool:
    """Serves while the simulator works; returns whether to start it again."""
    with tester.simulator:
        campaign.send(Ready())
        while True:
            candidate, placement = campaign.receive()
            if candidate is None:
                return False
            attempt = tester.attempt(candidate, placement)
            campaign.send(attempt)
            if attempt.simulator_broke:
                return True


class _GoneError(Exception):
    """The campaign has gone, or no longer needs this worker."""


class _Campaign:
    """The campaign at the other end of a worker's connection."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def send(self, message: Message) -> None:
        """Sends a message, from any thread.

        Raises:
            _GoneError: the campaign has gone. A simulator's own connection errors are different.
        """
        data = encode_message(message)
        with self._lock:
            try:
                self._connection.send_bytes(data)
            except OSError as error:
                raise _GoneError from error

    def receive(self) -> tuple[Candidate | None, Placement | None]:
        """The next candidate, None at the end, and its placement."""
        try:
            return decode_task(self._connection.recv_bytes())
        except (EOFError, OSError):
            return None, None


def stand_alone() -> None:
    """Makes this process leave Ctrl-C to its parent and end with it.

    It becomes the head of a group, which can be ended as a whole.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setsid"):
        with suppress(OSError):  # it is the head of one already
            os.setsid()
    threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()


def _die_with_parent() -> None:
    """Ends this process, and all that it started, when the campaign's process has ended."""
    parent = parent_process()
    if parent is not None:
        _die_with(parent.sentinel)
        wait([parent.sentinel])
        kill_group(os.getpid())
        os._exit(LOST_PARENT)


def _die_with(pipe: int) -> None:
    """Linux: lets the kernel kill the group when the pipe's other end is closed.

    So it ends even if a driver's compiled code blocks every thread of this process.
    """
    if sys.platform == "linux":
        with suppress(OSError):  # it is the pipe of an emulation, say
            fcntl.fcntl(pipe, fcntl.F_SETOWN, -os.getpid())
            fcntl.fcntl(pipe, fcntl.F_SETSIG, signal.SIGKILL)
            fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)


def kill_group(process_id: int) -> None:
    """Kills the processes of the group that a worker heads; nothing where there are no groups."""
    if hasattr(os, "killpg"):
        with suppress(OSError):  # gone already, or not yet a group
            os.killpg(process_id, signal.SIGKILL)


class _Sending(logging.Handler):
    """Sends log records to the campaign."""

    def __init__(self, send: Callable[[Message], None]) -> None:
        super().__init__(logging.INFO)
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._send(Logged(record.levelno, record.name, record.getMessage()))
        except _GoneError:
            pass  # and with it the log
        except Exception:
            self.handleError(record)


# Messages
#
# The messages of every test travel as plain values. Pickled records would name their classes and
# modules, which both sides look up: little, but a drive may take only a millisecond, and leaves the
# processor's caches full of other data.


class Ready(NamedTuple):
    """The simulator has started; a candidate may be sent."""


class WorkerFailed(NamedTuple):
    """This process must end: its simulator does not start, or a drive broke the process."""

    reason: str
    traceback: str


class Logged(NamedTuple):
    """Something for the campaign's log."""

    level: int
    name: str
    message: str


Message: TypeAlias = Ready | Attempt | WorkerFailed | Logged

_KINDS: Final = (Ready, Attempt, WorkerFailed, Logged)
_PROTOCOL: Final = 5
_of_result = attrgetter(*(field.name for field in fields(Result)))
_of_departure = attrgetter(*(field.name for field in fields(Departure)))


def encode_message(message: Message) -> bytes:
    """A worker's message as bytes; an attempt's trajectory must be packed."""
    values = _values_of(message) if isinstance(message, Attempt) else message
    return pickle.dumps((_KINDS.index(type(message)), *values), _PROTOCOL)


def decode_message(data: bytes) -> Message:
    """The message in bytes from `encode_message`; any error for other bytes.

    They come from our own process, so they may be unpickled.
    """
    index, *values = pickle.loads(data)  # noqa: S301
    kind: Any = _KINDS[index]
    message: Message = _attempt(*values) if kind is Attempt else kind(*values)
    return message


def encode_task(candidate: Candidate | None, placement: Placement | None = None) -> bytes:
    """A candidate for a worker as bytes, see `RoadTester.test`; None ends the worker."""
    if type(candidate) is not Candidate or candidate.points is not None:
        return pickle.dumps((candidate, placement), _PROTOCOL)
    origin = candidate.origin
    values = (
        candidate.id,
        candidate.curvatures.tobytes(),
        candidate.step,
        origin.operator,
        origin.parents,
        origin.generation,
    )
    return pickle.dumps((values, placement), _PROTOCOL)


def decode_task(data: bytes) -> tuple[Candidate | None, Placement | None]:
    """The task in bytes from `encode_task`."""
    # It comes from our own parent, so it may be unpickled.
    candidate, placement = pickle.loads(data)  # noqa: S301
    if isinstance(candidate, tuple):
        candidate_id, curvatures, step, *origin = candidate
        candidate = Candidate(candidate_id, np.frombuffer(curvatures), step, Origin(*origin))
    return candidate, placement


def _values_of(attempt: Attempt) -> tuple[object, ...]:
    assert attempt.trajectory is None
    outcome, *others, departure = _of_result(attempt.result)
    return (
        attempt.candidate_id,
        (str(outcome), *others, departure and _of_departure(departure)),
        attempt.pose and tuple(attempt.pose),
        attempt.packed,
        attempt.simulator_broke,
        attempt.worker_lost,
        attempt.worker,
        attempt.seconds,
        attempt.traceback,
    )


def _attempt(
    candidate_id: int,
    result: tuple[Any, ...],
    pose: tuple[float, float, float] | None,
    *others: Any,
) -> Attempt:
    outcome, *numbers, departure = result
    values = (Outcome(outcome), *numbers, departure and Departure(*departure))
    return Attempt(candidate_id, Result(*values), pose and Pose(*pose), None, *others)
