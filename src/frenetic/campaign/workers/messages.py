"""What a campaign and its worker processes say to each other, as bytes.

What is said for every test travels as plain values. Pickled as they are, records name their classes
and modules, which are looked up on both sides: little, but a drive may take no more than a
millisecond, and leaves the processor's caches full of other things.
"""

from __future__ import annotations

import pickle
from dataclasses import fields
from operator import attrgetter
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from frenetic.campaign.tester import Tested
from frenetic.oracle import Departure, Result
from frenetic.outcome import Outcome
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin


class Ready(NamedTuple):
    """The simulator has started; a candidate may be sent."""


class Finished(NamedTuple):
    """A candidate was tested; the next one may be sent, unless the simulator broke."""

    candidate_id: int
    seconds: float
    tested: Tested
    """Its trajectory is packed."""


class Hopeless(NamedTuple):
    """This process cannot go on: its simulator does not start, or a drive broke it, too."""

    reason: str


class Logged(NamedTuple):
    """Something for the campaign's log."""

    level: int
    name: str
    message: str


Message: TypeAlias = Ready | Finished | Hopeless | Logged

_KINDS: Final = (Ready, Finished, Hopeless, Logged)
_PROTOCOL: Final = 5
_of_result = attrgetter(*(field.name for field in fields(Result)))
_of_departure = attrgetter(*(field.name for field in fields(Departure)))


def encode_message(message: Message) -> bytes:
    """A worker's message as bytes."""
    values: tuple[object, ...] = message
    if isinstance(message, Finished):
        values = (message.candidate_id, message.seconds, *_values_of_tested(message.tested))
    return pickle.dumps((_KINDS.index(type(message)), *values), _PROTOCOL)


def decode_message(data: bytes) -> Message:
    """What `encode_message` was given; any error if these are other bytes.

    They come from a process of our own, so they may be unpickled.
    """
    index, *values = pickle.loads(data)  # noqa: S301
    kind: Any = _KINDS[index]
    if kind is Finished:
        candidate_id, seconds, *others = values
        return Finished(candidate_id, seconds, _tested(*others))
    message: Message = kind(*values)
    return message


def encode_candidate(candidate: Candidate | None) -> bytes:
    """A candidate for a worker as bytes; None says that no other will come."""
    if type(candidate) is not Candidate or candidate.points is not None:
        return pickle.dumps(candidate, _PROTOCOL)
    origin = candidate.origin
    values = (
        candidate.id,
        candidate.curvatures.tobytes(),
        candidate.step,
        origin.operator,
        origin.parents,
        origin.generation,
    )
    return pickle.dumps(values, _PROTOCOL)


def decode_candidate(data: bytes) -> Candidate | None:
    """What `encode_candidate` was given."""
    # It comes from our own parent, so it may be unpickled.
    candidate: Candidate | tuple[Any, ...] | None = pickle.loads(data)  # noqa: S301
    if not isinstance(candidate, tuple):
        return candidate
    candidate_id, curvatures, step, *origin = candidate
    return Candidate(candidate_id, np.frombuffer(curvatures), step, Origin(*origin))


def _values_of_tested(tested: Tested) -> tuple[object, ...]:
    assert tested.trajectory is None
    outcome, *others, departure = _of_result(tested.result)
    return (
        (str(outcome), *others, departure and _of_departure(departure)),
        tested.pose and tuple(tested.pose),
        tested.packed,
        tested.simulator_broke,
    )


def _tested(
    result: tuple[Any, ...],
    pose: tuple[float, float, float] | None,
    packed: bytes | None,
    simulator_broke: bool,
) -> Tested:
    outcome, *others, departure = result
    values = (Outcome(outcome), *others, departure and Departure(*departure))
    return Tested(
        Result(*values),
        pose and Pose(*pose),
        None,
        packed,
        simulator_broke,
    )
