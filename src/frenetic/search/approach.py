"""The approach to a place of a road: the part of a drive by which failures are told apart.

Two drives are compared after they are moved and turned so that a place of each and the road's
directions there coincide. Their *difference*, in metres, is

    sqrt(mean |p - p'|^2 + mean (d - d')^2 + mean ((v - v') * 1 s)^2)

where p are the road's points from 30 m before the place to 15 m after it. d are the car's lateral
offsets and v its speeds over the 30 m before the place: its *states*. An *approach* is a vector,
(64,) in m, such that the distance between two approaches is the difference of the drives. Distinct
failures are clusters of approaches, see `frenetic.analysis`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
from frenetic.road.geometry import build_table, frame_at, sub_steps

if TYPE_CHECKING:
    from frenetic.search.records import Trace


SPACING = 2.5
"""Distance between two values of an approach, in m."""
BEHIND = 30.0
"""Length of road before the place, in m (our choice)."""
ALIKE = 2.0
"""Largest difference of two drives with the same problem, in m: half a lane (our choice)."""
AHEAD = 15.0
"""Length of road after the place, in m (our choice)."""

_STATE_DISTANCES = np.arange(-BEHIND, 0.5 * SPACING, SPACING)  # [m] from the place
STATES = len(_STATE_DISTANCES)
"""Number of offsets in an approach, and of speeds."""
POINTS_BEHIND = round(BEHIND / SPACING)
"""Number of points of the road before the place."""
_POINTS = round((BEHIND + AHEAD) / SPACING) + 1  # number of points of the road
_POINT_SCALE = 1.0 / math.sqrt(_POINTS)  # factor of a point in an approach, for the mean
STATE_SCALE = 1.0 / math.sqrt(STATES)
"""Factor of a state in an approach, for the mean."""
ROAD_SIZE = 2 * _POINTS
"""Number of values of an approach that describe the road: x and y of each point. They come first.
"""
SIZE = ROAD_SIZE + 2 * STATES
"""Number of values of an approach: the road's, then offsets, then speeds."""


@njit(interpret_first=0.3)
def road_around(table: FloatArray, ds: float, place: float) -> FloatArray:
    """Return the centre line around a place, (19, 2) in m: x ahead of the place, y to its left.

    Points lie every 2.5 m from 30 m before the place to 15 m after it. Beyond its ends the road
    continues straight.

    Args:
        table: Table of the road, see `frenetic.road.geometry.build_table`.
        ds: Distance between two rows of the table, in m.
        place: Distance along the road, in m.
    """
    x0, y0, cosine, sine, _ = frame_at(table, ds, place)
    points = np.empty((_POINTS, 2))
    for i in range(_POINTS):
        x, y, _, _, _ = frame_at(table, ds, place - BEHIND + i * SPACING)
        points[i, 0] = (x - x0) * cosine + (y - y0) * sine
        points[i, 1] = (y - y0) * cosine - (x - x0) * sine
    return points


def states_before(trace: Trace | None, place: float) -> tuple[FloatArray, FloatArray]:
    """Return lateral offsets, (13,) in m, and speeds, (13,) in m/s, over the 30 m before a place.

    Without a trace, all are zeros.
    """
    if trace is None:
        return np.zeros(STATES), np.zeros(STATES)
    # A sliding car may fall back along the road; then its furthest distance counts.
    along = np.maximum.accumulate(trace.distance)
    places = place + _STATE_DISTANCES
    return np.interp(places, along, trace.lateral_offset), np.interp(places, along, trace.speed)


def as_vector(road: FloatArray, offsets: FloatArray, speeds: FloatArray) -> FloatArray:
    """Return the approach, (64,) in m, of a road around a place and the states before it."""
    return np.concatenate(
        (road.ravel() * _POINT_SCALE, offsets * STATE_SCALE, speeds * STATE_SCALE)
    )


@njit()
def table_around(
    curvatures: FloatArray, step: float, low: float, high: float
) -> tuple[FloatArray, float, float]:
    """Return a table of the part of a road that approaches to places from `low` to `high` m need.

    Args:
        curvatures: Curvatures of the road, (n,) in 1/m.
        step: Distance between two curvatures, in m.
        low: Distance along the road to the first place, in m.
        high: Distance along the road to the last place, in m.

    Returns:
        The table, the distance between two rows in m, and the distance along the road to its first
        row in m.
    """
    last = len(curvatures) - 1
    first = min(max(int((low - BEHIND) / step), 0), last - 1)
    end = max(min(int((high + AHEAD) / step) + 1, last), first + 1)
    piece = curvatures[first : end + 1]
    per_piece = sub_steps(piece, step)
    return build_table(piece, step, 0.0, 0.0, 0.0, per_piece), step / per_piece, first * step


@njit()
def set_road(vector: FloatArray, table: FloatArray, ds: float, place: float) -> None:
    """Write the road around a place into an approach, (64,) in m; the states stay."""
    points = road_around(table, ds, place)
    for i in range(_POINTS):
        vector[2 * i] = points[i, 0] * _POINT_SCALE
        vector[2 * i + 1] = points[i, 1] * _POINT_SCALE


@njit()
def points_along(table: FloatArray, ds: float, first: float, count: int) -> FloatArray:
    """Return points every `SPACING` m from `first` m along a road on, (count, 4).

    The columns are x, y, and the cosine and sine of the heading.
    """
    points = np.empty((count, 4))
    for i in range(count):
        x, y, cosine, sine, _ = frame_at(table, ds, first + i * SPACING)
        points[i, 0], points[i, 1], points[i, 2], points[i, 3] = x, y, cosine, sine
    return points


@njit()
def set_points(vector: FloatArray, points: FloatArray, place: int) -> None:
    """Write the road around a place into an approach, as `set_road` does, from points of the road.

    Args:
        vector: The approach, (64,) in m.
        points: Points of the road, see `points_along`.
        place: Index of the point at the place.
    """
    x0, y0, cosine, sine = points[place, 0], points[place, 1], points[place, 2], points[place, 3]
    for i in range(_POINTS):
        x, y = points[place - POINTS_BEHIND + i, 0] - x0, points[place - POINTS_BEHIND + i, 1] - y0
        vector[2 * i] = (x * cosine + y * sine) * _POINT_SCALE
        vector[2 * i + 1] = (y * cosine - x * sine) * _POINT_SCALE


@njit()
def squared_difference(first: FloatArray, second: FloatArray, most: float) -> float:
    """Return the squared difference of two approaches, in m².

    If it is at least `most`, any value of at least `most` is returned.
    """
    square = 0.0
    # The last values, speeds at the place, tell most pairs apart at once.
    for i in range(SIZE - 1, -1, -1):
        change = first[i] - second[i]
        square += change * change
        if square >= most:
            break
    return square


@njit(interpret_first=0.1)
def nearest_square(vectors: FloatArray, vector: FloatArray, most: float) -> float:
    """Return the least squared difference of an approach from (n, 64) others, at most `most`."""
    least = most
    for i in range(len(vectors)):
        least = min(least, squared_difference(vectors[i], vector, least))
    return least


@njit(interpret_first=0.1)
def is_near(vectors: FloatArray, vector: FloatArray, square: float) -> bool:
    """Return whether one of (n, 64) approaches differs by a squared difference below `square`."""
    for i in range(len(vectors)):  # noqa: SIM110 - compiled code knows no generators
        if squared_difference(vectors[i], vector, square) < square:
            return True
    return False


@njit(interpret_first=0.1)
def lower_squares(
    squares: FloatArray, sides: IntArray, vectors: FloatArray, side: int, vector: FloatArray
) -> None:
    """Lower squared differences to the squared difference from a new approach, if that is less.

    Args:
        squares: (n,) squared differences, in m²; they are overwritten.
        sides: (n,) sides of the approaches; only those on `side` are compared.
        vectors: (n, 64) approaches, in m.
        side: Side of the new approach.
        vector: The new approach, (64,) in m.
    """
    for i in range(len(squares)):
        if sides[i] == side:
            squares[i] = min(squares[i], squared_difference(vectors[i], vector, squares[i]))
