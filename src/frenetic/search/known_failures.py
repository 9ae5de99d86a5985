"""An index of the known failures on a side, which quickly finds the failures near an approach.

An approach has an *outline*, (6,) in m: its projections on six perpendicular unit vectors. The
projections say how far the road bends to the side before and after the place, and give the mean and
the trend of speeds and of offsets. Projections never increase a distance, so two approaches differ
by at least the difference of their outlines.

The failures are sorted by the first number of their outlines, so that bisection finds the few that
may be near. Outlines tell nearly all of these apart; only the rest are compared as approaches.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray, with_room
from frenetic._support.compiled import njit
from frenetic.search.approach import (
    BEHIND,
    POINTS_BEHIND,
    ROAD_SIZE,
    SIZE,
    SPACING,
    STATES,
    squared_difference,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt


OUTLINE_SIZE: Final = 6
"""Number of values of an outline."""
_Y_INDICES: Final = np.arange(1, ROAD_SIZE, 2)
"""Indices of the values of an approach that are y of the road's points, (points,)."""
_DISTANCES: Final = -BEHIND + SPACING * np.arange(len(_Y_INDICES))
"""Distance of each point of the road from the place, (points,) in m."""


def _unit(direction: npt.NDArray[Any]) -> FloatArray:
    """Return the unit vector of a direction."""
    return np.asarray(direction / np.linalg.norm(direction), dtype=np.float64)


# The unit vectors. A road of constant curvature leaves its tangent with the square of the distance.
_BEFORE: Final = _unit(_DISTANCES[:POINTS_BEHIND] ** 2)
_AFTER: Final = _unit(_DISTANCES[POINTS_BEHIND:] ** 2)
_MEAN: Final = _unit(np.ones(STATES))
_TREND: Final = _unit(np.arange(STATES) - 0.5 * (STATES - 1))
_ROUNDING: Final = 1e-9
"""Share of a bound, and length in m, by which the bound is widened: far above rounding errors."""


class Known(NamedTuple):
    """Approaches of known failures on a side, as kernels take them."""

    vectors: FloatArray
    """Approaches, (n, 64) in m. The first m are in the index, the last n - m only in this list."""
    order: IntArray
    """Rows of `vectors` sorted by the first number of their outlines, (m,)."""
    outlines: FloatArray
    """Outlines of the approaches in this order, (m, 6) in m."""


class KnownFailures:
    """The growing index of the known failures on a side."""

    def __init__(self) -> None:
        self._count = 0
        self._vectors = np.empty((64, SIZE))
        self._order = np.empty(64, dtype=np.int64)
        self._outlines = np.empty((64, OUTLINE_SIZE))

    def __len__(self) -> int:
        return self._count

    def add(self, vector: FloatArray) -> None:
        """Add the approach of a failure, (64,) in m."""
        n = self._count
        self._vectors = with_room(self._vectors, n)
        self._order = with_room(self._order, n)
        self._outlines = with_room(self._outlines, n)
        outline = outline_of(vector)
        row = first_row_from(self._outlines[:n], outline[0])
        self._vectors[n] = vector
        self._order[row + 1 : n + 1] = self._order[row:n]
        self._order[row] = n
        self._outlines[row + 1 : n + 1] = self._outlines[row:n]
        self._outlines[row] = outline
        self._count = n + 1

    def known(self, expected: Sequence[FloatArray] = ()) -> Known:
        """Return the known failures, as views that are valid until the next `add`.

        Args:
            expected: Approaches, (64,) in m each, that count as failures without being added.
        """
        n = self._count
        for i, vector in enumerate(expected):
            self._vectors = with_room(self._vectors, n + i)
            self._vectors[n + i] = vector
        return Known(self._vectors[: n + len(expected)], self._order[:n], self._outlines[:n])


NOTHING: Final = KnownFailures().known()
"""No failure on a side."""


@njit(interpret_first=0.2)
def outline_of(vector: FloatArray) -> FloatArray:
    """Return the outline of an approach, (6,) in m."""
    before = after = 0.0
    for i in range(POINTS_BEHIND):
        before += _BEFORE[i] * vector[2 * i + 1]
    for i in range(POINTS_BEHIND, len(_Y_INDICES)):
        after += _AFTER[i - POINTS_BEHIND] * vector[2 * i + 1]
    offset = offset_trend = speed = speed_trend = 0.0
    for i in range(STATES):
        offset += _MEAN[i] * vector[ROAD_SIZE + i]
        offset_trend += _TREND[i] * vector[ROAD_SIZE + i]
        speed += _MEAN[i] * vector[ROAD_SIZE + STATES + i]
        speed_trend += _TREND[i] * vector[ROAD_SIZE + STATES + i]
    return np.array([before, after, speed, speed_trend, offset, offset_trend])


@njit(interpret_first=0.1)
def first_row_from(outlines: FloatArray, bend: float) -> int:
    """Return the row of the first of (m, 6) sorted outlines whose first number is at least `bend`.

    It is m if there is none.
    """
    low, high = 0, len(outlines)
    while low < high:
        middle = (low + high) // 2
        if outlines[middle, 0] < bend:
            low = middle + 1
        else:
            high = middle
    return low


@njit()
def _outline_square(outlines: FloatArray, row: int, outline: FloatArray, most: float) -> float:
    """Return the squared difference of an outline from a row of (m, 6) outlines, in m².

    If it is at least `most`, any value of at least `most` is returned.
    """
    square = 0.0
    for i in range(OUTLINE_SIZE):
        change = outlines[row, i] - outline[i]
        square += change * change
        if square >= most:
            break
    return square


@njit()
def _widened(most: float) -> float:
    """Return a squared difference, in m², increased by more than rounding errors of outlines."""
    reach = math.sqrt(most) * (1.0 + _ROUNDING) + _ROUNDING
    return reach * reach


@njit()
def near_failure(known: Known, vector: FloatArray, square: float) -> int:
    """Return the row of a known failure near an approach; -1 if there is none.

    Args:
        known: Known failures.
        vector: The approach, (64,) in m.
        square: Squared difference below which a failure is near, in m².
    """
    vectors, outlines, last = known.vectors, known.outlines, len(known.order)
    for row in range(last, len(vectors)):  # those that are not in the index
        if squared_difference(vectors[row], vector, square) < square:
            return row
    outline, bound = outline_of(vector), _widened(square)
    reach = math.sqrt(bound)
    for i in range(first_row_from(outlines, outline[0] - reach), last):
        if outlines[i, 0] > outline[0] + reach:
            break
        row = int(known.order[i])
        if (
            _outline_square(outlines, i, outline, bound) < bound
            and squared_difference(vectors[row], vector, square) < square
        ):
            return row
    return -1


@njit(interpret_first=0.7)
def nearest_known_square(known: Known, vector: FloatArray, most: float) -> float:
    """Return the least squared difference of an approach from known failures, at most `most` m².

    Rows are looked at from the approach's own position in the index on, in both directions.
    """
    least, outline, last = most, outline_of(vector), len(known.order)
    for row in range(last, len(known.vectors)):
        least = min(least, squared_difference(known.vectors[row], vector, least))
    start = first_row_from(known.outlines, outline[0])
    for direction in (1, -1):
        bound = _widened(least)
        i = start if direction == 1 else start - 1
        while 0 <= i < last and (known.outlines[i, 0] - outline[0]) ** 2 < bound:
            if _outline_square(known.outlines, i, outline, bound) < bound:
                square = squared_difference(known.vectors[known.order[i]], vector, least)
                if square < least:
                    least = square
                    bound = _widened(least)
            i += direction
    return least
