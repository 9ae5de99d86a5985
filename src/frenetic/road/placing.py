"""Moving a road into the map, turned to the angle at which it needs the smallest square.

A road fits the map if some rotation makes its bounding box no wider and no higher than the room
between the margins. Turned by theta, the box is as wide and as high as the turned convex hull:

    width(theta)  = x cos(theta) - y sin(theta)     (x, y) from the hull's leftmost corner
                                                    to its rightmost corner
    height(theta) = x sin(theta) + y cos(theta)     (x, y) from the hull's lowest corner
                                                    to its highest corner

These corners change only at angles at which an edge of the hull is parallel to an axis. Between two
such angles, width and height are each an arc of a sinusoid, which is concave, since it is positive.
So the larger of width and height is smallest at one of the two angles, or where both are equal.
That leaves a few angles for every corner of the hull. A quarter turn only exchanges width and
height, so angles in a quarter turn suffice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.errors import RoadError
from frenetic.road.validity import MAP_SIZE, as_points

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["MAP_MARGIN", "RigidMotion", "fit_to_map"]

MAP_MARGIN: Final = 10.0
"""Least distance of a road's centre line from the map's edge, in m: half the road's width of 8 m,
and 6 m of space."""

_QUARTER: Final = math.pi / 2  # [rad]
_Number = TypeVar("_Number", float, FloatArray)


@dataclass(frozen=True)
class RigidMotion:
    """A rotation about the origin, then a translation: distances and curvatures stay."""

    rotation: float
    """Rotation in rad, counter-clockwise, applied first."""
    dx: float
    """Translation along x, in m."""
    dy: float
    """Translation along y, in m."""

    def apply(self, points: npt.ArrayLike) -> FloatArray:
        """Return the moved points, (N, 2) in m."""
        return np.column_stack(self.moved(*as_points(points).T))

    def moved(self, x: _Number, y: _Number) -> tuple[_Number, _Number]:
        """Return the moved point, or points by their coordinates, in m."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        return c * x - s * y + self.dx, s * x + c * y + self.dy


def fit_to_map(
    points: npt.ArrayLike, map_size: float = MAP_SIZE, map_margin: float = MAP_MARGIN
) -> RigidMotion | None:
    """Return the motion that moves a road into the map; None if the road fits in no pose.

    A road inside the margins stays in place. A road that fits without turning is centred in the
    map. Any other road is turned by the angle in (-45, 45] degrees at which its bounding box needs
    the smallest square, and centred. So the new place does not depend on the old place. The margins
    are kept up to rounding.

    The time is O(N log N).

    Args:
        points: points of the road's centre line, (N, 2) in m, at most 2 m apart.
        map_size: side of the map, in m: the map is the square [0, map_size]^2.
        map_margin: least distance of the centre line from the map's edge, in m.

    Raises:
        RoadError: there are no points, they are not finite pairs of numbers, the map's side is not
            positive, or the margin is negative.
    """
    if not 0.0 < map_size < math.inf:
        raise RoadError(f"map_size is {map_size!r}, but must be a positive number of metres")
    if not 0.0 <= map_margin < math.inf:
        raise RoadError(f"map_margin is {map_margin!r}, but must be a number of metres, at least 0")
    line = as_points(points)
    if len(line) == 0:
        raise RoadError("there are no points to fit to the map; a road has at least one")
    low_x, low_y, high_x, high_y = _box(line)
    if math.inf in (high_x - low_x, high_y - low_y):
        raise RoadError("the road is longer than any number of metres")

    room = map_size - 2.0 * map_margin
    if room <= 0.0:
        return None
    if map_margin <= min(low_x, low_y) and max(high_x, high_y) <= map_size - map_margin:
        return RigidMotion(0.0, 0.0, 0.0)
    rotation = 0.0
    if max(high_x - low_x, high_y - low_y) > room:
        hull = _convex_hull(line[np.lexsort((line[:, 1], line[:, 0]))])
        # Sorted here: numba's sorts take a second to compile, and two cached ones get mixed up.
        rotation, size = _smallest_square(hull, np.sort(_edge_rotations(hull)))
        if size > room:
            return None
        low_x, low_y, high_x, high_y = _box(RigidMotion(rotation, 0.0, 0.0).apply(hull))
    centre = map_size / 2.0
    return RigidMotion(rotation, centre - (low_x + high_x) / 2.0, centre - (low_y + high_y) / 2.0)


@njit(interpret_first=0.6)
def _box(points: FloatArray) -> tuple[float, float, float, float]:
    """Return the least x and y, then the largest x and y, of points (N, 2)."""
    x, y = points[:, 0], points[:, 1]
    return x.min(), y.min(), x.max(), y.max()


@njit(interpret_first=0.3)
def _convex_hull(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull, (H, 2), counter-clockwise (Andrew's chain).

    Args:
        points: (N, 2), ordered by x, then y. The hull of collinear points is the two ends.
    """
    n = len(points)
    hull = np.empty((2 * n, 2))
    size = 0
    # The lower side from left to right, then the upper side back.
    for side in range(2):
        first = size
        for k in range(n):
            row = k if side == 0 else n - 1 - k
            x, y = points[row, 0], points[row, 1]
            while size >= first + 2 and not (
                (hull[size - 1, 0] - hull[size - 2, 0]) * (y - hull[size - 2, 1])
                > (hull[size - 1, 1] - hull[size - 2, 1]) * (x - hull[size - 2, 0])
            ):
                size -= 1
            if size == first or x != hull[size - 1, 0] or y != hull[size - 1, 1]:
                hull[size, 0] = x
                hull[size, 1] = y
                size += 1
        size -= 1  # each side ends where the other begins
    return hull[: max(size, 1)].copy()


@njit(interpret_first=0.2)
def _edge_rotations(hull: FloatArray) -> FloatArray:
    """Return the rotations from 0 to 90 degrees that make an edge parallel to an axis, (H,) rad."""
    n = len(hull)
    rotations = np.empty(n)
    for k in range(n):
        dx = hull[(k + 1) % n, 0] - hull[k, 0]
        dy = hull[(k + 1) % n, 1] - hull[k, 1]
        rotations[k] = -math.atan2(dy, dx) % _QUARTER
    return rotations


@njit(interpret_first=0.4)
def _smallest_square(hull: FloatArray, bounds: FloatArray) -> tuple[float, float]:
    """Return the rotation at which a hull needs the smallest square, and the square's side in m.

    The rotation is in rad, above -45 and at most 45 degrees.

    Args:
        hull: corners of a convex polygon, (H, 2) in m, counter-clockwise.
        bounds: `_edge_rotations` of the hull, (H,) rad, ascending.
    """
    n = len(hull)
    best = 0.0
    smallest = math.inf
    right = top = left = bottom = 0
    for k in range(n):
        begin, end = bounds[k], bounds[k + 1] if k + 1 < n else bounds[0] + _QUARTER
        # The extreme corners are the same in the whole interval; at its middle they are clearest.
        c, s = math.cos((begin + end) / 2.0), math.sin((begin + end) / 2.0)
        right = _farthest(hull, c, -s, right)
        top = _farthest(hull, s, c, top)
        left = _farthest(hull, -c, s, left)
        bottom = _farthest(hull, -s, -c, bottom)
        wx = hull[right, 0] - hull[left, 0]
        wy = hull[right, 1] - hull[left, 1]
        hx = hull[top, 0] - hull[bottom, 0]
        hy = hull[top, 1] - hull[bottom, 1]
        # Width and height are equal where (wx - hy) cos = (wy + hx) sin: once in a half turn.
        equal = begin + (math.atan2(wx - hy, wy + hx) - begin) % math.pi
        for angle in (begin, min(equal, end), end):
            c, s = math.cos(angle), math.sin(angle)
            size = max(wx * c - wy * s, hx * s + hy * c)
            if size < smallest:
                smallest = size
                best = angle
    best %= _QUARTER
    return (best if best <= _QUARTER / 2.0 else best - _QUARTER), smallest


@njit()
def _farthest(hull: FloatArray, x: float, y: float, start: int) -> int:
    """Return the index of the corner farthest in direction (x, y).

    The search walks along the hull from corner `start`, as long as the next corner is farther.
    """
    n = len(hull)
    here = start
    for step in (1, n - 1):
        while True:
            there = (here + step) % n
            dx = hull[there, 0] - hull[here, 0]
            dy = hull[there, 1] - hull[here, 1]
            if dx * x + dy * y <= 0.0:
                break
            here = there
    return here
