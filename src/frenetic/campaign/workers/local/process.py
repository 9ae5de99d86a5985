"""The work of a worker process: it tests the candidates from its connection."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import fields
from multiprocessing.connection import Connection
from operator import attrgetter
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.child_processes import Failed, Line, Logged, serving
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import Placement, RoadTester
from frenetic.oracle import Departure, Result
from frenetic.outcome import Outcome
from frenetic.registry import load_user_file
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.copying import unpack


def serve(connection: Connection, user_files: Sequence[str], tester: bytes) -> None:
    """Tests candidates from the connection until it ends or a None comes.

    Args:
        connection: gives candidates, takes messages.
        user_files: the user's own modules, to load first.
        tester: a packed `RoadTester`, from the process that started this one.
    """
    with serving(connection, encode_message) as line:
        for file in user_files:
            load_user_file(file)
        # Made by our own parent a moment ago and given to us alone, so it may be unpickled.
        the_tester: RoadTester = unpack(tester)
        while _serve_one_start(line, the_tester):
            pass


def _serve_one_start(line: Line, tester: RoadTester) -> bool:
    """Serves while the simulator works; returns whether to start it again."""
    with tester.simulator:
        line.send(encode_message(Ready()))
        while (data := line.receive()) is not None:
            number, candidate, placement = decode_task(data)
            if candidate is None:
                return False
            attempt = tester.attempt(candidate, placement)
            line.send(encode_message(Answer(number, attempt)))
            if attempt.simulator_broke:
                return True
    return False


# Messages
#
# The messages of every test travel as plain values. Pickled records would name their classes and
# modules, which both sides look up: little, but a drive may take only a millisecond, and leaves the
# processor's caches full of other data.


class Ready(NamedTuple):
    """The simulator has started; a candidate may be sent."""


class Answer(NamedTuple):
    """The attempt at a task."""

    task: int
    """Number of the task."""
    attempt: Attempt


Message: TypeAlias = Ready | Answer | Failed | Logged

_KINDS: Final = (Ready, Answer, Failed, Logged)
_PROTOCOL: Final = 5
_of_result = attrgetter(*(field.name for field in fields(Result)))
_of_departure = attrgetter(*(field.name for field in fields(Departure)))


def encode_message(message: Message) -> bytes:
    """A worker's message as bytes; an attempt's trajectory must be packed."""
    values: tuple[object, ...] = message
    if isinstance(message, Answer):
        values = (message.task, *_values_of(message.attempt))
    return pickle.dumps((_KINDS.index(type(message)), *values), _PROTOCOL)


def decode_message(data: bytes) -> Message:
    """The message in bytes from `encode_message`; any error for other bytes.

    They come from our own process, so they may be unpickled.
    """
    index, *values = pickle.loads(data)  # noqa: S301
    kind: Any = _KINDS[index]
    if kind is Answer:
        task, *of_attempt = values
        return Answer(task, _attempt(*of_attempt))
    message: Message = kind(*values)
    return message


def encode_task(
    number: int, candidate: Candidate | None, placement: Placement | None = None
) -> bytes:
    """A candidate for a worker as bytes, see `RoadTester.test`; None ends the worker."""
    if type(candidate) is not Candidate or candidate.points is not None:
        return pickle.dumps((number, candidate, placement), _PROTOCOL)
    origin = candidate.origin
    values = (
        candidate.id,
        candidate.curvatures.tobytes(),
        candidate.step,
        origin.operator,
        origin.parents,
        origin.generation,
    )
    return pickle.dumps((number, values, placement), _PROTOCOL)


def decode_task(data: bytes) -> tuple[int, Candidate | None, Placement | None]:
    """The task in bytes from `encode_task`, with its number."""
    # It comes from our own parent, so it may be unpickled.
    number, candidate, placement = pickle.loads(data)  # noqa: S301
    if isinstance(candidate, tuple):
        candidate_id, curvatures, step, *origin = candidate
        candidate = Candidate(candidate_id, np.frombuffer(curvatures), step, Origin(*origin))
    return number, candidate, placement


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
