"""Messages between a campaign and its worker processes, as bytes.

The messages of every test travel as plain values. Pickled records would name their classes and
modules, which both sides look up: little, but a drive may take only a millisecond, and leaves the
processor's caches full of other data.
"""

from __future__ import annotations

import pickle
from dataclasses import fields
from operator import attrgetter
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import Placement
from frenetic.oracle import Departure, Result
from frenetic.outcome import Outcome
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin


class Ready(NamedTuple):
    """The simulator has started; a candidate may be sent."""


class WorkerFailed(NamedTuple):
    """This process must end: its simulator does not start, or a drive broke the process."""

    reason: str


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
    """A worker's message as bytes; an attempt's trajectory has to be packed."""
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
    """A candidate for a worker as bytes, see `RoadTester.test`; None if no other will come."""
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
