"""The known failures on a side, in an order in which those near an approach are found at once.

An approach has an *outline*, (6,) in m: projections on six perpendicular directions of length 1.
Two describe how far the road bends to the side before and after the place, four the mean and the
trend of speeds and offsets. So two approaches differ by at least the difference of their outlines.
Rows that are sorted by the first of these numbers are looked up by bisection; the outline tells
nearly all of the rest apart.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray, with_room
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

    IntArray = npt.NDArray[np.int64]

OUTLINE_SIZE: Final = 6
_ASIDE: Final = np.arange(1, ROAD_SIZE, 2)
"""Indices of an approach's values to the side of the place, one for each point of its road."""
_STATION: Final = -BEHIND + SPACING * np.arange(len(_ASIDE))
"""Distance of each point of the road from the place, in m."""


def _unit(direction: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(direction / np.linalg.norm(direction), dtype=np.float64)


# The directions. A road of constant curvature leaves its tangent by the square of the distance.
_BEFORE: Final = _unit(_STATION[:POINTS_BEHIND] ** 2)
_AFTER: Final = _unit(_STATION[POINTS_BEHIND:] ** 2)
_MEAN: Final = _unit(np.ones(STATES))
_TREND: Final = _unit(np.arange(STATES) - 0.5 * (STATES - 1))
_ROUNDING: Final = 1e-9
"""Share and amount, in m, by which a bound is widened: far more than outlines are rounded by."""


class Known(NamedTuple):
    """Approaches of known failures, as the kernels take them."""

    vectors: FloatArray
    """(n, 64) m; those beyond the number of rows in `order` are in no order."""
    order: IntArray
    """(m,) numbers of vectors, in the order of their outlines' first number."""
    outlines: FloatArray
    """(m, 6) m, outlines of the vectors in `order`."""


class KnownFailures:
    """Approaches of the known failures on a side."""

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
        row = first_from(self._outlines[:n], outline[0])
        self._vectors[n] = vector
        self._order[row + 1 : n + 1] = self._order[row:n]
        self._order[row] = n
        self._outlines[row + 1 : n + 1] = self._outlines[row:n]
        self._outlines[row] = outline
        self._count = n + 1

    def known(self, expected: Sequence[FloatArray] = ()) -> Known:
        """Return the failures, and approaches that count as failures; views that hold until `add`.

        Args:
            expected: (64,) m each.
        """
        n = self._count
        for i, vector in enumerate(expected):
            self._vectors = with_room(self._vectors, n + i)
            self._vectors[n + i] = vector
        return Known(self._vectors[: n + len(expected)], self._order[:n], self._outlines[:n])


NOTHING: Final = KnownFailures().known()
"""No failure on a side."""


@njit()
def outline_of(vector: FloatArray) -> FloatArray:
    """Return the outline of an approach, (6,) in m."""
    before = after = 0.0
    for i in range(POINTS_BEHIND):
        before += _BEFORE[i] * vector[2 * i + 1]
    for i in range(POINTS_BEHIND, len(_ASIDE)):
        after += _AFTER[i - POINTS_BEHIND] * vector[2 * i + 1]
    offset = offset_trend = speed = speed_trend = 0.0
    for i in range(STATES):
        offset += _MEAN[i] * vector[ROAD_SIZE + i]
        offset_trend += _TREND[i] * vector[ROAD_SIZE + i]
        speed += _MEAN[i] * vector[ROAD_SIZE + STATES + i]
        speed_trend += _TREND[i] * vector[ROAD_SIZE + STATES + i]
    return np.array([before, after, speed, speed_trend, offset, offset_trend])


@njit()
def first_from(outlines: FloatArray, bend: float) -> int:
    """Return the number of the first of (m, 6) sorted outlines whose first number is as high."""
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
    """Return the squared difference of an outline from one of (m, 6), or some value >= `most`."""
    square = 0.0
    for i in range(OUTLINE_SIZE):
        change = outlines[row, i] - outline[i]
        square += change * change
        if square >= most:
            break
    return square


@njit()
def _widened(most: float) -> float:
    """Return a squared difference in m², wide enough for the rounding of outlines."""
    reach = math.sqrt(most) * (1.0 + _ROUNDING) + _ROUNDING
    return reach * reach


@njit()
def near_failure(known: Known, vector: FloatArray, square: float) -> int:
    """Return the number of a known failure nearer to an approach than `square`, in m², or -1."""
    vectors, outlines, last = known.vectors, known.outlines, len(known.order)
    for row in range(last, len(vectors)):
        if squared_difference(vectors[row], vector, square) < square:
            return row
    outline, bound = outline_of(vector), _widened(square)
    reach = math.sqrt(bound)
    for i in range(first_from(outlines, outline[0] - reach), last):
        if outlines[i, 0] > outline[0] + reach:
            break
        row = int(known.order[i])
        if (
            _outline_square(outlines, i, outline, bound) < bound
            and squared_difference(vectors[row], vector, square) < square
        ):
            return row
    return -1


@njit()
def nearest_known_square(known: Known, vector: FloatArray, most: float) -> float:
    """Return the least squared difference of an approach from known failures, at most `most`."""
    least, outline, last = most, outline_of(vector), len(known.order)
    for row in range(last, len(known.vectors)):
        least = min(least, squared_difference(known.vectors[row], vector, least))
    start = first_from(known.outlines, outline[0])
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
