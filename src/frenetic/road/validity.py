"""The competition's verdict whether a list of road points is a road test.

The rules are the competition's; the method is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.errors import RoadError
from frenetic.road.overlap import is_overlapping

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = [
    "LANE_WIDTH",
    "MAP_SIZE",
    "Verdict",
    "check_validity",
    "interpolate",
    "min_radius",
    "overlaps_itself",
]


MAP_SIZE: Final = 200.0
"""Side of the competition's square map, in m."""
LANE_WIDTH: Final = 4.0
"""Width of each of the two lanes of the competition's roads, in m; the default of any road."""

_MAX_POINTS: Final = 500
_NODE_DISTANCE: Final = 1.0  # [m] along the polyline of the road points
_MIN_STEPS: Final = 20
_HALF_WIDTH: Final = LANE_WIDTH  # [m] of a road of two lanes
_MIN_LENGTH: Final = 20.0  # [m]
_MIN_RADIUS: Final = 47.0  # [ft]
_FEET_PER_METRE: Final = 3.280839895
_STRAIGHT: Final = 1e-6  # [m2] less than this, and three points count as collinear

_LONGEST: Final = 1e6  # [m] what `interpolate` accepts, since it makes a node for every metre


@dataclass(frozen=True)
class Verdict:
    """Whether a road is valid, and if not, why; true in a condition when it is."""

    valid: bool
    message: str
    """The first rule that the road does not keep, in the competition's words; empty when valid."""

    def __bool__(self) -> bool:
        return self.valid


class RoadRules(Protocol):
    """Rules in place of the competition's, see `frenetic.road.classes.RoadClass`."""

    def verdict(self, road: Any) -> Verdict:
        """Whether a `frenetic.road.Road` keeps them."""


_VERDICTS: Final = tuple(
    Verdict(not message, message)
    for message in (
        "",
        "Not enough road points.",
        "The road definition contains too many points",
        "Two consecutive road points are the same",
        "Not entirely inside the map boundaries",
        "The road is self-intersecting",
        "The road is not long enough.",
        "The road is too sharp",
    )
)
(
    _VALID,
    _TOO_FEW,
    _TOO_MANY,
    _REPEATED,
    _OUTSIDE,
    _SELF_INTERSECTING,
    _TOO_SHORT,
    _TOO_SHARP,
) = range(len(_VERDICTS))  # what the kernels answer


def check_validity(points: npt.ArrayLike, map_size: float = MAP_SIZE) -> Verdict:
    """Return the competition's verdict on a road; its message names the first rule not kept.

    In this order: 2 to 500 points, no two consecutive ones the same; the 8 m wide road around the
    interpolated points (see `interpolate`) strictly inside the map; no quadrilateral of that road
    twisted, meeting one that is not its neighbour, or sharing more than an edge with its
    neighbour; more than 20 m long; nowhere sharper than a radius of 47 ft (see `min_radius`).

    Two cases are ours, because the competition's code cannot go on: it crashes on consecutive
    points that are the same (here: invalid, with a message of its own), and it takes a perfectly
    straight road for infinitely sharp (here: it passes).

    Args:
        points: (N, 2) road points x, y in m.
        map_size: The map is the square [0, map_size]^2, in m.

    Raises:
        RoadError: The points are not N finite pairs of numbers, or the map has no size.
    """
    if not 0.0 < map_size < math.inf:
        raise RoadError(f"map_size is {map_size!r}, but must be a positive number of metres")
    return _VERDICTS[_check(as_points(points), float(map_size))]


def check_layout(points: npt.ArrayLike, map_size: float) -> Verdict:
    """The verdict whether a road lies in the map and keeps clear of itself; no other rule counts.

    Args:
        points: (N, 2) the road's centre line in m, dense enough to stand for the curve.
        map_size: The map is the square [0, map_size]^2, in m.
    """
    return _VERDICTS[_check_layout(as_points(points), float(map_size))]


def interpolate(points: npt.ArrayLike) -> FloatArray:
    """Return the nodes, (M, 2) in m, from which the competition builds the road.

    An interpolating spline through the points (degree 1 for two points, 2 for three, otherwise 3,
    not-a-knot), parametrised by the share u of the polyline's length, is evaluated at
    n = max(20, floor(length / 1 m)) equal steps of u and rounded to the millimetre. M is n + 1.
    For some n, M is n + 2: the competition's steps are ``numpy.arange(0, 1 + 1 / n, 1 / n)``, whose
    rounding lets in another one, beyond the last road point.

    Args:
        points: (N, 2) road points x, y in m, at least two.

    Raises:
        RoadError: The points are not finite pairs of numbers, fewer than two, more than 1000 km of
            road, or two consecutive ones are the same.
    """
    road_points = as_points(points)
    if len(road_points) < 2:
        raise RoadError(f"a road needs at least 2 points, but there are {len(road_points)}")
    parameters, length = _chord_parameters(road_points)
    if not length <= _LONGEST:
        raise RoadError(
            f"the road is {length:.6g} m long, but at most {_LONGEST:.0f} m are allowed"
        )
    if not _increasing(parameters):
        raise RoadError("two consecutive road points are the same; a road moves on at every point")
    nodes: FloatArray = _nodes(road_points, parameters, length)
    return nodes


def min_radius(interpolated: npt.ArrayLike) -> float:
    """Return the radius in m at the sharpest place of a road, infinity if it is straight.

    That is the smallest circle through the points i, i + 2 and i + 4, for i = 0 .. M - 6 (the
    competition leaves out the last such triple).

    Args:
        interpolated: (M, 2) points in m about 1 m apart, as `interpolate` returns them.

    Raises:
        RoadError: The points are not finite pairs of numbers.
    """
    return float(_min_radius(as_points(interpolated)))


def overlaps_itself(left: npt.ArrayLike, right: npt.ArrayLike) -> bool:
    """Return whether a road is twisted or meets itself, as the competition decides it.

    Args:
        left: (M, 2) points of the left edge in m, at least two.
        right: (M, 2) points of the right edge in m.

    Raises:
        RoadError: The points are not M finite pairs of numbers each.
    """
    left_edge, right_edge = as_points(left), as_points(right)
    if left_edge.shape != right_edge.shape or len(left_edge) < 2:
        raise RoadError(
            "a road's edges must have equally many points, at least 2 each, but have"
            f" {len(left_edge)} and {len(right_edge)}"
        )
    return bool(is_overlapping(left_edge, right_edge))


def as_points(points: npt.ArrayLike) -> FloatArray:
    """Return a fresh (N, 2) array in C order: the one type for which the kernels are compiled.

    Raises:
        RoadError: The points are not N finite pairs of numbers.
    """
    try:
        array = np.asarray(points)
    except ValueError:
        raise RoadError("road points must be pairs x, y of numbers, all of them pairs") from None
    if array.ndim != 2 or array.shape[1] != 2:
        if array.shape == (0,):
            return np.empty((0, 2))
        raise RoadError(
            f"road points must be an array with shape (N, 2), x and y in metres, "
            f"but it has shape {array.shape}"
        )
    if array.dtype.kind not in "fiu":
        raise RoadError(f"road points must be numbers, but they are of type {array.dtype}")
    pairs = array.astype(np.float64, order="C")
    if not np.isfinite(pairs).all():
        i = np.flatnonzero(~np.isfinite(pairs).all(axis=1))[0]
        x, y = pairs[i]
        raise RoadError(f"road point {i} is ({x:g}, {y:g}): finite numbers of metres are needed")
    return pairs


# --- the rules ---------------------------------------------------------------------------------


@njit()
def _check(points: FloatArray, map_size: float) -> int:
    """Return the code of the first rule that is not kept, _VALID if all are."""
    if len(points) < 2:
        return _TOO_FEW
    if len(points) > _MAX_POINTS:
        return _TOO_MANY
    parameters, length = _chord_parameters(points)
    if not _increasing(parameters):
        # A length that overflows says nothing of the points, but that the road leaves any map.
        return _REPEATED if length < math.inf else _OUTSIDE
    # No polyline of so few points inside the map is longer than 499 diagonals of it.
    if length > 1000.0 * map_size:
        return _OUTSIDE

    nodes = _nodes(points, parameters, length)
    layout = _check_layout(nodes, map_size)
    if layout != _VALID:
        return layout
    if _length(nodes) <= _MIN_LENGTH:
        return _TOO_SHORT
    if _min_radius(nodes) * _FEET_PER_METRE < _MIN_RADIUS:
        return _TOO_SHARP
    return _VALID


@njit()
def _check_layout(nodes: FloatArray, map_size: float) -> int:
    """Return the code of what is wrong with the place of a road of these nodes, or _VALID."""
    left, right, moves = _edges(nodes)
    if not (_inside(nodes, map_size) and _inside(left, map_size) and _inside(right, map_size)):
        return _OUTSIDE
    if not moves or is_overlapping(left, right):
        return _SELF_INTERSECTING
    return _VALID


@njit()
def _inside(points: FloatArray, map_size: float) -> bool:
    for i in range(len(points)):
        if not (0.0 < points[i, 0] < map_size and 0.0 < points[i, 1] < map_size):
            return False
    return True


@njit()
def _length(points: FloatArray) -> float:
    total = 0.0
    for i in range(len(points) - 1):
        dx = points[i + 1, 0] - points[i, 0]
        dy = points[i + 1, 1] - points[i, 1]
        total += math.sqrt(dx * dx + dy * dy)
    return total


@njit()
def _min_radius(points: FloatArray) -> float:
    smallest = math.inf  # the square of the radius
    for i in range(len(points) - 5):
        ax = points[i + 2, 0] - points[i, 0]
        ay = points[i + 2, 1] - points[i, 1]
        bx = points[i + 4, 0] - points[i + 2, 0]
        by = points[i + 4, 1] - points[i + 2, 1]
        cross = ax * by - bx * ay  # [m2] twice the triangle's area
        if abs(cross) < _STRAIGHT:
            continue
        # The circumradius is the product of the sides over four times the area.
        sides = (ax * ax + ay * ay) * (bx * bx + by * by) * ((ax + bx) ** 2 + (ay + by) ** 2)
        smallest = min(smallest, sides / (4.0 * cross * cross))
    return math.sqrt(smallest)


# --- interpolation -----------------------------------------------------------------------------


@njit()
def _chord_parameters(points: FloatArray) -> tuple[FloatArray, float]:
    """Return each point's share of the polyline's length, (N,) in 0..1, and that length in m."""
    parameters = np.zeros(len(points))
    for i in range(len(points) - 1):
        dx = points[i + 1, 0] - points[i, 0]
        dy = points[i + 1, 1] - points[i, 1]
        parameters[i + 1] = parameters[i] + math.sqrt(dx * dx + dy * dy)
    length = parameters[-1]
    if length > 0.0:
        parameters /= length
    return parameters, length


@njit()
def _increasing(parameters: FloatArray) -> bool:
    return bool((parameters[1:] > parameters[:-1]).all())


@njit()
def _nodes(points: FloatArray, parameters: FloatArray, length: float) -> FloatArray:
    """Return the interpolated points, (M, 2) in m, rounded to the millimetre."""
    step = 1.0 / max(_MIN_STEPS, int(length / _NODE_DISTANCE))
    # numpy.arange(0, 1 + step, step) has this many values, and i * step is one of them.
    nodes = np.empty((math.ceil((1.0 + step) / step), 2))

    # On segment j: x(u) = x_j + t (m_j + t (c_j + t d_j)) with t = u - u_j. The first two segments
    # have their polynomial in common, and so have the last two (not-a-knot): there the longer one
    # is used. A tiny one has few digits of c and d, too few to go on beyond the last point.
    gaps = parameters[1:] - parameters[:-1]
    last = len(gaps) - 1
    first_choice = 1 if last > 0 and gaps[1] > gaps[0] else 0
    last_choice = last - 1 if last > 0 and gaps[last - 1] > gaps[last] else last
    for axis in range(2):
        x = points[:, axis].copy()
        secants = (x[1:] - x[:-1]) / gaps
        slopes = _slopes(gaps, secants)
        segment = 0
        for i in range(len(nodes)):
            u = i * step
            while segment < last and u > parameters[segment + 1]:
                segment += 1
            j = last_choice if segment >= last - 1 else first_choice if segment <= 1 else segment
            t = u - parameters[j]
            excess = slopes[j] + slopes[j + 1] - 2.0 * secants[j]
            c = (secants[j] - slopes[j] - excess) / gaps[j]
            d = excess / (gaps[j] * gaps[j])
            nodes[i, axis] = _to_millimetre(x[j] + t * (slopes[j] + t * (c + t * d)))
    return nodes


@njit()
def _slopes(gaps: FloatArray, secants: FloatArray) -> FloatArray:
    """Return the interpolating spline's derivative at its N points, (N,).

    The degree follows from the number of points. The cubic's second derivative is continuous at
    every inner point, its third at the second and the second-last (not-a-knot): N equations with a
    tridiagonal matrix.

    Args:
        gaps: (N - 1,) between the parameters of consecutive points.
        secants: (N - 1,) difference quotients.
    """
    last = len(gaps)
    slopes = np.empty(last + 1)
    if last == 1:
        slopes[:] = secants[0]
        return slopes
    if last == 2:
        bend = (secants[1] - secants[0]) / (gaps[0] + gaps[1])
        slopes[0] = secants[0] - gaps[0] * bend
        slopes[1] = secants[0] + gaps[0] * bend
        slopes[2] = secants[1] + gaps[1] * bend
        return slopes

    # Row i, divided by its diagonal: slopes[i] + upper[i] slopes[i + 1] = slopes[i] as stored.
    upper = np.empty(last)
    g, h = gaps[0], gaps[1]
    upper[0] = (g + h) / h
    slopes[0] = ((3.0 * g + 2.0 * h) * h * secants[0] + g * g * secants[1]) / (h * (g + h))
    for i in range(1, last):
        g, h = gaps[i - 1], gaps[i]
        pivot = 2.0 * (g + h) - h * upper[i - 1]
        upper[i] = g / pivot
        right_side = 3.0 * (h * secants[i - 1] + g * secants[i])
        slopes[i] = (right_side - h * slopes[i - 1]) / pivot
    g, h = gaps[last - 1], gaps[last - 2]
    right_side = ((3.0 * g + 2.0 * h) * h * secants[last - 1] + g * g * secants[last - 2]) / (g + h)
    slopes[last] = (right_side - (g + h) * slopes[last - 1]) / (h - (g + h) * upper[last - 1])
    for i in range(last - 1, -1, -1):
        slopes[i] -= upper[i] * slopes[i + 1]
    return slopes


@njit()
def _to_millimetre(value: float) -> float:
    """Return what Python's ``round(value, 3)`` does: the nearest decimal to the exact value."""
    scaled = value * 1000.0
    below = math.floor(scaled)
    if scaled - below == 0.5:
        # The product looks like a tie. What its rounding lost tells on which side it is: a half of
        # the value's digits is multiplied without loss (Dekker's splitting).
        half = 134217729.0 * value
        half -= half - value
        lost = (1000.0 * half - scaled) + 1000.0 * (value - half)
        if lost != 0.0:
            return (below + 1.0 if lost > 0.0 else below) / 1000.0
    return float(np.rint(scaled) / 1000.0)


# --- the road's edges --------------------------------------------------------------------------


@njit()
def _edges(nodes: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return left and right edge, (M, 2) each, and whether every step has a direction.

    The normal at a node is the normal of the step ahead, at the last node of the step behind. Where
    a step has no length, the edges are at the node itself.
    """
    left = np.empty_like(nodes)
    right = np.empty_like(nodes)
    moves = True
    last = len(nodes) - 1
    for i in range(last + 1):
        j = min(i, last - 1)
        dx = nodes[j + 1, 0] - nodes[j, 0]
        dy = nodes[j + 1, 1] - nodes[j, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        if distance > 0.0:
            dx = dx / distance * _HALF_WIDTH
            dy = dy / distance * _HALF_WIDTH
        else:
            moves = False
        left[i, 0] = nodes[i, 0] - dy
        left[i, 1] = nodes[i, 1] + dx
        right[i, 0] = nodes[i, 0] + dy
        right[i, 1] = nodes[i, 1] - dx
    return left, right, moves
