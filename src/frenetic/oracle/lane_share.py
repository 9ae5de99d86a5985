"""Oob share: the kernel that computes the share of a car's box outside a lane.

The lane is cut into quadrilaterals by cross-sections. The car's box, a rectangle, is clipped
against each quadrilateral (Sutherland and Hodgman's algorithm); the areas sum up to the part of the
box inside the lane. Boxes that are surely inside are not clipped.
"""

from __future__ import annotations

import math

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, hypotenuse, sine
from frenetic.road.geometry import CURVATURE, frame_at, widening_at

SECTION = 0.5
"""Distance between two cross-sections of the lane, in m; our choice.

On the sharpest valid curve (radius 14.3 m), the edges of a quadrilateral are up to 2 mm away from
the edges of the lane, and the share is wrong by up to 0.001.
"""
_MIN_STRETCH = 0.3
"""Least factor by which distances shrink towards the inside of a bend; our choice. A sharper bend
is treated as having this factor."""
_MOST_CORNERS = 12
"""Rows of the arrays for clipped polygons: a rectangle cut by four lines has at most 8 corners."""


@njit()
def _clip(
    polygon: FloatArray, n: int, ax: float, ay: float, bx: float, by: float, out: FloatArray
) -> int:
    """Write the part of a convex polygon (n vertices) left of the line from a to b into ``out``.

    Returns:
        Number of vertices of that part.
    """
    count = 0
    px, py = polygon[n - 1, 0], polygon[n - 1, 1]
    before = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    for i in range(n):
        qx, qy = polygon[i, 0], polygon[i, 1]
        here = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
        if (before >= 0.0) != (here >= 0.0):
            t = before / (before - here)
            out[count, 0] = px + t * (qx - px)
            out[count, 1] = py + t * (qy - py)
            count += 1
        if here >= 0.0:
            out[count, 0] = qx
            out[count, 1] = qy
            count += 1
        px, py, before = qx, qy, here
    return count


@njit()
def _area(polygon: FloatArray, n: int) -> float:
    """Return the area of a polygon of n vertices."""
    total = 0.0
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        total += polygon[i, 0] * polygon[j, 1] - polygon[j, 0] * polygon[i, 1]
    return 0.5 * abs(total)


@njit(error_model="numpy")
def _sharpest_curvature(table: FloatArray, ds: float, start: float, end: float) -> float:
    """Return the largest absolute curvature of a road between two distances in m, in 1/m."""
    last = len(table) - 1
    sharpest = 0.0
    for i in range(
        min(max(int(start / ds), 0), last),
        min(max(int(end / ds) + 1, 0), last) + 1,
    ):
        sharpest = max(sharpest, abs(table[i, CURVATURE]))
    return sharpest


@njit()
def _box_corners(
    heading: float, half_length: float, half_width: float, centre_ahead: float, x: float, y: float
) -> FloatArray:
    """Return the corners of a car's box relative to its centre of mass (x, y), (4, 2) in m.

    Relative coordinates lose no digits far from the origin.
    """
    c, n = cosine(heading), sine(heading)
    cx, cy = x + centre_ahead * c, y + centre_ahead * n
    box = np.empty((4, 2))
    for i in range(4):
        a = half_length if i in (0, 3) else -half_length
        b = half_width if i < 2 else -half_width
        box[i, 0] = cx - x + a * c - b * n
        box[i, 1] = cy - y + a * n + b * c
    return box


@njit(error_model="numpy")
def share_outside(
    table: FloatArray,
    ds: float,
    left: float,
    right: float,
    s: float,
    d: float,
    road_heading: float,
    x: float,
    y: float,
    heading: float,
    length: float,
    width: float,
    centre_ahead: float,
    least: float = 0.0,
) -> float:
    """Return the share (0..1) of a car's box outside the lane between two lateral offsets.

    Only the lane near ``s`` counts: a car that has crossed over to another piece of the same road
    is outside.

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        left, right: lateral offsets of the lane's edges without widening, in m, left > right.
            Where the road widens, the right edge is further out.
        s, d, road_heading: distance along the road and lateral offset of the centre of mass, in m,
            and the road's heading there, in rad.
        x, y, heading: centre of mass and heading of the car, in m, m and rad.
        length, width, centre_ahead: the car's box, in m, see `CarBody`.
        least: the kernel may return 0 for a share below ``least``, to save time.
    """
    half_length, half_width = 0.5 * length, 0.5 * width
    radius = hypotenuse(half_length, half_width) + abs(centre_ahead)
    sharpest = _sharpest_curvature(table, ds, s - 2.0 * radius, s + 2.0 * radius)
    # Most boxes are well inside. Bound how far the box reaches to a side, including how far the
    # road bends away under the box.
    error = heading - road_heading
    reach_ahead = half_length + abs(centre_ahead)
    sideways = reach_ahead * abs(sine(error)) + half_width * abs(cosine(error))
    stretch = 1.0 - sharpest * (abs(d) + radius)
    if stretch > _MIN_STRETCH:
        bend = 0.5 * sharpest * radius * radius / stretch
        if d + sideways + bend < left and d - sideways - bend > right:
            return 0.0
        # If a disc in the middle of the box, with a share of 1 - least of its area, is inside the
        # lane, then the share outside is below least. A tenth more for the chords of the lane.
        disc = 1.1 * math.sqrt((1.0 - least) * length * width / math.pi)
        aside = disc + abs(centre_ahead)
        if 2.0 * disc < min(length, width) and d + aside < left and d - aside > right:
            return 0.0
    box = _box_corners(heading, half_length, half_width, centre_ahead, x, y)
    along = radius / max(stretch, _MIN_STRETCH)
    sections = math.ceil(2.0 * along / SECTION)
    inside = 0.0
    first = np.empty((_MOST_CORNERS, 2))
    second = np.empty((_MOST_CORNERS, 2))
    lx0 = ly0 = rx0 = ry0 = 0.0
    for k in range(sections + 1):
        px, py, c, n, _ = frame_at(table, ds, s - along + k * SECTION)
        lx1, ly1 = px - left * n - x, py + left * c - y
        edge = right - widening_at(table, ds, s - along + k * SECTION)
        rx1, ry1 = px - edge * n - x, py + edge * c - y
        if k > 0:
            # The quadrilateral right0, right1, left1, left0 is counter-clockwise, so its inside is
            # left of each edge.
            m = _clip(box, len(box), rx0, ry0, rx1, ry1, first)
            m = _clip(first, m, rx1, ry1, lx1, ly1, second) if m else 0
            m = _clip(second, m, lx1, ly1, lx0, ly0, first) if m else 0
            m = _clip(first, m, lx0, ly0, rx0, ry0, second) if m else 0
            if m > 2:
                inside += _area(second, m)
        lx0, ly0, rx0, ry0 = lx1, ly1, rx1, ry1
    return min(max(1.0 - inside / (length * width), 0.0), 1.0)
