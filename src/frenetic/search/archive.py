"""The archive of a search: the critical places of all drives.

A critical place is where the car left its lane or came nearest to its edge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray, with_room
from frenetic.oracle.outcome import Outcome
from frenetic.road.geometry import build_table, sub_steps
from frenetic.search.approach import (
    SIZE,
    as_vector,
    lower_squares,
    road_around,
    states_before,
)
from frenetic.search.known_failures import Known, KnownFailures, nearest_known_square

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.search.records import Candidate, Evaluation, Trace

FAR = 4.0
"""Difference beyond which two approaches count as equally different, in m (our choice)."""
NEAR_MISS = 1.3
"""Oob distance below which a second place of a drive is critical, too, in m (our choice)."""
APART = 25.0
"""Least distance along the road between two critical places of a drive, in m (our choice)."""

LEFT, RIGHT, NEITHER = 0, 1, 2
SIDES = {"left": LEFT, "right": RIGHT, None: NEITHER}
"""Side of a departure -> number of the side."""
_HALF_LANE = 2.0  # [m] half the width of the competition's lanes
_PLACE = np.dtype(
    [
        ("distance", np.float64),  # distance along the road, in m
        ("side", np.int64),  # LEFT, RIGHT or NEITHER
        ("fitness", np.float64),  # value that the search minimises
        ("has_failed", np.bool_),  # whether the drive failed at the place
        ("yaw_acceleration", np.float64),  # largest of the drive, in rad/s²
        ("cost", np.float64),  # what speaks against the place as a parent, such as its children
    ]
)


class Place(NamedTuple):
    """A critical place of a drive."""

    distance: float
    """Distance along the road, in m."""
    side: int
    """LEFT, RIGHT or NEITHER."""
    fitness: float
    """Value that the search minimises."""
    has_failed: bool
    """Whether the drive failed at the place."""
    yaw_acceleration: float
    """Largest yaw acceleration of the drive, in rad/s²; 0 if it is not known."""
    vector: FloatArray
    """Approach to the place, (64,) in m."""


class Archive:
    """Critical places, each with its difference from the nearest known failure on its side."""

    def __init__(self) -> None:
        self.candidates: list[Candidate] = []
        """Candidate of each place."""
        self._places = np.zeros(64, dtype=_PLACE)
        self._vectors = np.empty((64, SIZE))
        self._squares = np.empty(64)
        self._failures = [KnownFailures() for _ in (LEFT, RIGHT, NEITHER)]
        # Id of an outstanding candidate -> side and approach with which it is expected to fail.
        self._expected: dict[int, tuple[int, FloatArray]] = {}

    def __len__(self) -> int:
        return len(self.candidates)

    @property
    def places(self) -> npt.NDArray[np.void]:
        """Record of each place, (n,): its values but the vector, and its cost; a view."""
        return self._places[: len(self)]

    @property
    def vectors(self) -> FloatArray:
        """Approach of each place, (n, 64) in m; a view."""
        return self._vectors[: len(self)]

    @property
    def squares(self) -> FloatArray:
        """Square of each place's difference from the nearest known failure on its side, (n,).

        It is at most `FAR`², in m².
        """
        return self._squares[: len(self)]

    def failures(self, side: int) -> Known:
        """Return the known failures on a side, with the expected ones; valid until `add`."""
        expected = [vector for its_side, vector in self._expected.values() if its_side == side]
        return self._failures[side].known(expected)

    def expect(self, candidate: int, side: int, vector: FloatArray) -> None:
        """Count a candidate, by its id, as failing on a side, until it is settled."""
        self._expected[candidate] = side, vector

    def settle(self, candidate: int) -> None:
        """Expect nothing of a candidate any more."""
        self._expected.pop(candidate, None)

    @property
    def has_failures(self) -> bool:
        """Whether a failure is known."""
        return any(self._failures)

    def add(self, candidate: Candidate, place: Place) -> float:
        """Add a place; return its difference from the failures known before, up to `FAR` m."""
        side, vector = place.side, place.vector
        square = nearest_known_square(self._failures[side].known(), vector, FAR * FAR)
        if place.has_failed:
            self._failures[side].add(vector)
            lower_squares(self.squares, self.places["side"], self.vectors, side, vector)
        row = len(self)
        self._places = with_room(self._places, row)
        self._vectors = with_room(self._vectors, row)
        self._squares = with_room(self._squares, row)
        self._places[row] = (*place[:5], 0.0)
        self._vectors[row] = vector
        self._squares[row] = square
        self.candidates.append(candidate)
        return float(np.sqrt(square))


def critical_places(evaluation: Evaluation, candidate: Candidate, fitness: float) -> list[Place]:
    """Return one or two critical places of a driven road, the worst first.

    The first is the place of the result: where the drive failed, or else was worst. The second is
    where the car was furthest from its lane's centre at least `APART` away from the first, if it
    came near the lane's edge there.

    Args:
        evaluation: Result of a driven road. Without a trace, there is one place, and offsets and
            speeds before it count as 0.
        candidate: The road.
        fitness: Value that the search minimises.

    """
    curvatures, step = candidate.curvatures, candidate.step
    length = (len(curvatures) - 1) * step
    per_piece = sub_steps(curvatures, step)
    table = build_table(curvatures, step, 0.0, 0.0, 0.0, per_piece)
    trace = evaluation.trace

    yaw_acceleration = 0.0 if trace is None else _largest_yaw_acceleration(trace)

    def place_at(distance: float, side: int, fitness: float, has_failed: bool) -> Place:
        """Return the place at a distance along the road, kept within the road."""
        distance = min(max(distance, 0.0), length)
        road = road_around(table, step / per_piece, distance)
        states = states_before(trace, distance)
        vector = as_vector(road, *states)
        return Place(distance, side, fitness, has_failed, yaw_acceleration, vector)

    has_failed = evaluation.outcome is Outcome.FAIL
    finding = evaluation.finding
    finding_side = SIDES[None if finding is None else finding.side]
    if trace is None:
        distance = 0.5 * length if evaluation.place is None else evaluation.place
        return [place_at(distance, finding_side, fitness, has_failed)]
    offsets = np.abs(trace.lateral_offset)
    peak = int(np.argmax(offsets))
    distance = float(trace.distance[peak]) if evaluation.place is None else evaluation.place
    side = finding_side if has_failed else _side(trace, peak)
    places = [place_at(distance, side, fitness, has_failed)]
    offsets_apart = np.where(np.abs(trace.distance - distance) > APART, offsets, 0.0)
    second = int(np.argmax(offsets_apart))
    oob_distance = _HALF_LANE - float(offsets_apart[second])
    if oob_distance < NEAR_MISS:
        second_distance = float(trace.distance[second])
        side = _side(trace, second)
        places.append(place_at(second_distance, side, fitness=oob_distance, has_failed=False))
    return places


def _side(trace: Trace, record: int) -> int:
    """Return the side of the lane's centre on which the car is in a record."""
    return LEFT if trace.lateral_offset[record] > 0.0 else RIGHT


def _largest_yaw_acceleration(trace: Trace) -> float:
    """Return the largest yaw acceleration of a drive, in rad/s²; 0 if it is not known."""
    path, n = trace.trajectory, len(trace.distance)
    if path is None or n < 2:
        return 0.0
    changes, times = np.diff(path.yaw_rate[:n]), np.diff(path.time[:n])
    largest = float(np.max(np.abs(changes) / times))
    return largest if np.isfinite(largest) else 0.0
