"""Validity: whether the competition accepts a list of road points as a road test.

The rules are the rules of the SBST/SBFT tool competition; `check_validity` lists them. The method
is our own: compiled kernels that give the same verdicts.
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
    "MIN_RADIUS",
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

# Numbers of the competition's rules.
_MAX_POINTS: Final = 500  # number of road points
_NODE_DISTANCE: Final = 1.0  # [m] between nodes, along the polyline of the road points
_MIN_STEPS: Final = 20  # least number of steps between nodes
_HALF_WIDTH: Final = LANE_WIDTH  # [m] of a road of two lanes
_MIN_LENGTH: Final = 20.0  # [m] of the road
_MIN_RADIUS: Final = 47.0  # [ft] of a bend
_FEET_PER_METRE: Final = 3.280839895
MIN_RADIUS: Final = _MIN_RADIUS / _FEET_PER_METRE
"""Least radius of a bend in the competition, in m."""
_STRAIGHT: Final = 1e-6  # [m2] twice the area of the largest triangle of collinear points

_LONGEST: Final = 1e6
"""Length of the longest road that `interpolate` accepts, in m; our choice, since it makes a node
for every metre."""
_MOST_LENGTHS: Final = 1000.0
"""Length, in sides of the map, beyond which a road surely leaves the map: a polyline of at most 500
points inside the map has at most 499 diagonals."""


@dataclass(frozen=True)
class Verdict:
    """Whether a road is valid, and the reason if it is not. A valid road's verdict is true."""

    valid: bool
    message: str
    """First rule that the road breaks, in the competition's words; empty if it is valid."""

    def __bool__(self) -> bool:
        """Return whether the road is valid."""
        return self.valid


class RoadRules(Protocol):
    """Rules in place of the competition's rules, see `frenetic.road.classes.RoadClass`."""

    def verdict(self, road: Any) -> Verdict:
        """Return the verdict on a `frenetic.road.Road` by these rules."""


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
) = range(len(_VERDICTS))
"""Codes that the kernels return: indices of `_VERDICTS`."""


def check_validity(points: npt.ArrayLike, map_size: float = MAP_SIZE) -> Verdict:
    """Return the competition's verdict on a road; its message names the first rule that it breaks.

    The rules, in this order:

    - There are 2 to 500 points, and consecutive points differ.
    - The 8 m wide road around the interpolated points (see `interpolate`) is strictly inside the
      map.
    - No quadrilateral of that road is twisted, meets a quadrilateral that is not its neighbour, or
      shares more than an edge with its neighbour.
    - The road is more than 20 m long.
    - No radius is less than 47 ft (see `min_radius`).

    Two verdicts differ from the competition's code: it crashes on equal consecutive points (here
    they are invalid, with a message), and it takes a perfectly straight road for infinitely sharp
    (here the road is valid).

    Args:
        points: road points x, y, (N, 2) in m.
        map_size: side of the map, in m: the map is the square [0, map_size]^2.

    Raises:
        RoadError: the points are not N finite pairs of numbers, or the map has no size.
    """
    if not 0.0 < map_size < math.inf:
        raise RoadError(f"map_size is {map_size!r}, but must be a positive number of metres")
    return _VERDICTS[_check(as_points(points), float(map_size))]


def check_layout(points: npt.ArrayLike, map_size: float) -> Verdict:
    """Return the verdict on a road by two rules: it lies in the map, and it does not meet itself.

    Args:
        points: points of the road's centre line, (N, 2) in m, at most 2 m apart.
        map_size: side of the map, in m: the map is the square [0, map_size]^2.
    """
    return _VERDICTS[_check_layout(as_points(points), float(map_size))]


def interpolate(points: npt.ArrayLike) -> FloatArray:
    """Return the nodes, (M, 2) in m, from which the competition builds the road.

    A spline interpolates the points: of degree 1 for two points, 2 for three points, otherwise 3
    with the not-a-knot condition. Its parameter u is the share of the polyline's length. The spline
    is evaluated at n = max(20, floor(length / 1 m)) equal steps of u and rounded to the millimetre,
    so M is n + 1. For some n, M is n + 2: the competition's steps are
    ``numpy.arange(0, 1 + 1 / n, 1 / n)``, which by rounding may contain a further step, beyond the
    last road point.

    Args:
        points: road points x, y, (N, 2) in m, at least two.

    Raises:
        RoadError: the points are not finite pairs of numbers, there are fewer than two, consecutive
            points are the same, or the road is longer than 1000 km.
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
        raise RoadError("two consecutive road points are the same: consecutive points must differ")
    nodes: FloatArray = _nodes(road_points, parameters, length)
    return nodes


def min_radius(interpolated: npt.ArrayLike) -> float:
    """Return the radius of a road's sharpest bend, in m; infinity if the road is straight.

    The radius is the least radius of a circle through the points i, i + 2 and i + 4, for i from 0
    to M - 6. The competition leaves out the last such triple, i = M - 5.

    Args:
        interpolated: points about 1 m apart, (M, 2) in m, from `interpolate`.

    Raises:
        RoadError: the points are not finite pairs of numbers.
    """
    return float(_min_radius(as_points(interpolated)))


def overlaps_itself(left: npt.ArrayLike, right: npt.ArrayLike) -> bool:
    """Return whether a road is twisted or meets itself, by the competition's rule.

    Args:
        left: points of the left edge, (M, 2) in m, at least two.
        right: points of the right edge, (M, 2) in m.

    Raises:
        RoadError: the edges are not M finite pairs of numbers each.
    """
    left_edge, right_edge = as_points(left), as_points(right)
    if left_edge.shape != right_edge.shape or len(left_edge) < 2:
        raise RoadError(
            "a road's edges must have equally many points, at least 2 each, but have"
            f" {len(left_edge)} and {len(right_edge)}"
        )
    return bool(is_overlapping(left_edge, right_edge))


def as_points(points: npt.ArrayLike) -> FloatArray:
    """Return points as a new array (N, 2) of floats in C order, which the kernels need.

    Raises:
        RoadError: the points are not N finite pairs of numbers.
    """
    try:
        array = np.asarray(points)
    except ValueError:
        raise RoadError("road points must all be pairs x, y of numbers") from None
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


@njit(interpret_first=5.0)
def _check(points: FloatArray, map_size: float) -> int:
    """Return the code of the first rule that a road breaks; _VALID if it breaks none."""
    if len(points) < 2:
        return _TOO_FEW
    if len(points) > _MAX_POINTS:
        return _TOO_MANY
    parameters, length = _chord_parameters(points)
    if not _increasing(parameters):
        # Parameters do not increase either if the length overflows: such a road leaves any map.
        return _REPEATED if length < math.inf else _OUTSIDE
    if length > _MOST_LENGTHS * map_size:
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


@njit(interpret_first=2.7)
def _check_layout(nodes: FloatArray, map_size: float) -> int:
    """Return _OUTSIDE, _SELF_INTERSECTING or _VALID for a road with these nodes, (M, 2) in m."""
    left, right, moves = _edges(nodes)
    if not (_inside(nodes, map_size) and _inside(left, map_size) and _inside(right, map_size)):
        return _OUTSIDE
    if not moves or is_overlapping(left, right):
        return _SELF_INTERSECTING
    return _VALID


@njit()
def _inside(points: FloatArray, map_size: float) -> bool:
    """Return whether all points are strictly inside the map."""
    for i in range(len(points)):
        if not (0.0 < points[i, 0] < map_size and 0.0 < points[i, 1] < map_size):
            return False
    return True


@njit()
def _length(points: FloatArray) -> float:
    """Return the length of the polyline through points, in m."""
    total = 0.0
    for i in range(len(points) - 1):
        dx = points[i + 1, 0] - points[i, 0]
        dy = points[i + 1, 1] - points[i, 1]
        total += math.sqrt(dx * dx + dy * dy)
    return total


@njit(interpret_first=0.2)
def _min_radius(points: FloatArray) -> float:
    """Return the least radius in m, see `min_radius`."""
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
        cx, cy = ax + bx, ay + by
        sides = (ax * ax + ay * ay) * (bx * bx + by * by) * (cx * cx + cy * cy)
        smallest = min(smallest, sides / (4.0 * cross * cross))
    return math.sqrt(smallest)


# --- interpolation -----------------------------------------------------------------------------


@njit(interpret_first=0.2)
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


@njit(interpret_first=0.2)
def _increasing(parameters: FloatArray) -> bool:
    """Return whether each parameter is larger than the parameter before."""
    return bool((parameters[1:] > parameters[:-1]).all())


@njit(interpret_first=0.9)
def _nodes(points: FloatArray, parameters: FloatArray, length: float) -> FloatArray:
    """Return the interpolated points, (M, 2) in m, rounded to the millimetre."""
    step = 1.0 / max(_MIN_STEPS, int(length / _NODE_DISTANCE))
    # numpy.arange(0, 1 + step, step) has this many values, and i * step is one of them.
    nodes = np.empty((math.ceil((1.0 + step) / step), 2))

    # On segment j: x(u) = x_j + t (m_j + t (c_j + t d_j)) with t = u - u_j. The first two segments
    # share one polynomial, and so do the last two (not-a-knot). Of two such segments, the longer is
    # used: a tiny segment has too few digits of c and d to continue beyond the last point.
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
    """Return the derivatives of the interpolating spline at its N points, (N,).

    The number of points determines the degree, see `interpolate`. The second derivative of the
    cubic spline is continuous at every inner point, and the third at the second and the second-last
    point (not-a-knot). That makes N equations with a tridiagonal matrix.

    Args:
        gaps: differences between the parameters of consecutive points, (N - 1,).
        secants: slopes of the chords between consecutive points, (N - 1,).
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
    """Return the multiple of 0.001 nearest to the exact value, as Python's ``round(value, 3)``."""
    scaled = value * 1000.0
    below = math.floor(scaled)
    if scaled - below == 0.5:
        # The rounded product is a tie, but the exact product may lie on either side. The rounding
        # error shows the side; Dekker's splitting computes it, as each half of the value's digits
        # is multiplied without error.
        half = 134217729.0 * value
        half -= half - value
        lost = (1000.0 * half - scaled) + 1000.0 * (value - half)
        if lost != 0.0:
            return (below + 1.0 if lost > 0.0 else below) / 1000.0
    return float(np.rint(scaled) / 1000.0)


# --- the road's edges --------------------------------------------------------------------------


@njit()
def _edges(nodes: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return the left and right edge, (M, 2) each, and whether every step has a length.

    The edges are perpendicular to the step from a node to the next; at the last node, to the last
    step. Where a step has no length, both edges are at the node itself.
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
