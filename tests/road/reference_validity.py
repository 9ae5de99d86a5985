"""The competition's rules once more: scipy, shapely and plain loops, slow and easy to check."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from scipy.interpolate import splev, splprep

Points = list[tuple[float, float]]

TOO_FEW = "Not enough road points."
TOO_MANY = "The road definition contains too many points"
REPEATED = "Two consecutive road points are the same"
OUTSIDE = "Not entirely inside the map boundaries"
SELF_INTERSECTING = "The road is self-intersecting"
TOO_SHORT = "The road is not long enough."
TOO_SHARP = "The road is too sharp"


def verdict_message(points: npt.NDArray[np.float64], map_size: float = 200.0) -> str:
    """The first rule that the road breaks, "" if none."""
    if len(points) < 2:
        return TOO_FEW
    if len(points) > 500:
        return TOO_MANY
    if any(np.array_equal(p, q) for p, q in pairwise(points)):
        return REPEATED

    nodes = interpolated(points)
    left, right = edges(nodes)
    if not all(0 < c < map_size for point in nodes + left + right for c in point):
        return OUTSIDE
    if any(p == q for p, q in pairwise(nodes)) or overlaps_itself(left, right):
        return SELF_INTERSECTING
    if not shapely.LineString(nodes).length > 20:
        return TOO_SHORT
    if sharpest_radius(nodes) * 3.280839895 < 47:
        return TOO_SHARP
    return ""


def interpolated(points: npt.NDArray[np.float64]) -> Points:
    steps = max(20, int(shapely.LineString(points).length / 1.0))
    degree = {2: 1, 3: 2}.get(len(points), 3)
    spline, _ = splprep([points[:, 0], points[:, 1]], s=0, k=degree)
    xs, ys = np.asarray(splev(np.arange(0, 1 + 1 / steps, 1 / steps), spline))  # type: ignore[call-overload]
    return [(round(x, 3), round(y, 3)) for x, y in zip(xs.tolist(), ys.tolist(), strict=True)]


def edges(nodes: Points) -> tuple[Points, Points]:
    left, right = [], []
    for i, (x, y) in enumerate(nodes):
        (ax, ay), (bx, by) = nodes[i : i + 2] if i + 1 < len(nodes) else nodes[-2:]
        dx, dy = bx - ax, by - ay
        length = math.sqrt(dx * dx + dy * dy)
        if length > 0:
            dx, dy = dx / length * 4, dy / length * 4
        left.append((x - dy, y + dx))
        right.append((x + dy, y - dx))
    return left, right


def overlaps_itself(left: Points, right: Points) -> bool:
    quads: npt.NDArray[Any] = shapely.polygons(
        [[left[i], left[i + 1], right[i + 1], right[i]] for i in range(len(left) - 1)]
    )
    if not shapely.is_valid(quads).all():
        return True
    # Every pair whose boxes meet, each once.
    first, second = shapely.STRtree(quads).query(quads)
    first, second = first[first < second], second[first < second]
    apart = second - first > 1
    if shapely.intersects(quads[first[apart]], quads[second[apart]]).any():
        return True
    neighbours = shapely.intersection(quads[:-1], quads[1:])
    return not (shapely.get_type_id(neighbours) == shapely.GeometryType.LINESTRING).all()


def sharpest_radius(nodes: Points) -> float:
    """The smallest circle, found where two perpendicular bisectors meet."""
    smallest = math.inf
    for i in range(len(nodes) - 5):
        (x1, y1), (x2, y2), (x3, y3) = nodes[i], nodes[i + 2], nodes[i + 4]
        det = (x1 - x2) * (y2 - y3) - (x2 - x3) * (y1 - y2)
        if abs(det) < 1e-6:
            continue
        # Relative to the middle point, to keep digits.
        p, q = x1 - x2, y1 - y2
        r, s = x3 - x2, y3 - y2
        cx = ((p * p + q * q) * s - (r * r + s * s) * q) / (2 * (p * s - r * q))
        cy = ((r * r + s * s) * p - (p * p + q * q) * r) / (2 * (p * s - r * q))
        smallest = min(smallest, math.hypot(cx, cy))
    return smallest
