"""Segment of a failure as the competition's published code cuts it, mistakes included."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.road.validity import as_points
from frenetic.segments.segment import REACH

_NODE_DISTANCE: Final = 0.55
"""Largest distance from a place to its node, in m: half of the nodes' 1 m, and a tolerance.

It is the published code's, as are all rules of this module."""


def competition_segment(
    road_points: npt.ArrayLike, position: tuple[float, float]
) -> FloatArray | None:
    """Return the segment around the place of a road that is nearest to a position, (n, 2) in m.

    The segment consists of the nodes before the place, the place, and the nodes after it. Nodes are
    points of the road about 1 m apart. The first node after the place may lie half a metre *before*
    it: there the line turns back and forth, and so it enters the competition's measures.

    Args:
        road_points: (N, 2) points of the submitted road, in m.
        position: x and y in m where the car was first out of its lane.

    Returns:
        None where the competition's code raises: for a place at the road's start, and for a road
        of fewer than four points.

    Raises:
        RoadError: the road points are not pairs of numbers.
    """
    nodes = _interpolated(as_points(road_points))
    if nodes is None:
        return None
    place = _nearest_point(nodes, np.array(position))
    near = np.flatnonzero(np.hypot(*(nodes - place).T) < _NODE_DISTANCE)
    if len(near) == 0 or near[-1] == 0:
        return None
    # The last node that is near counts as the first after the place.
    i = int(near[-1])
    before = _up_to_reach(np.vstack([nodes[:i], place])[::-1])[::-1]
    after = _up_to_reach(nodes[i:])
    return np.vstack([before, after])


def failure_segment(test: Test) -> FloatArray | None:
    """Return the `competition_segment` of a failure; None without a departure or such a segment.

    Raises:
        RoadError: the test has no road.
    """
    departure = test.departure
    if departure is None:
        return None
    points = test.candidate.points
    submitted = test.road.road_points if points is None else points
    return competition_segment(submitted, (departure.x, departure.y))


def _interpolated(points: FloatArray) -> FloatArray | None:
    """Return points of the road about 1 m apart, rounded to 0.1 mm as for the sparseness.

    None if there are fewer than four points, or two of them are equal, so that no cubic spline
    passes through them, or if the road is shorter than 1 m. (For a road's validity the competition
    rounds to the millimetre and makes 20 steps or more.)
    """
    from scipy.interpolate import splev, splprep  # slow to import

    moves: FloatArray = np.diff(points, axis=0)
    steps = np.hypot(moves[:, 0], moves[:, 1])
    if len(points) < 4 or steps.min() == 0.0 or steps.sum() < 1.0:
        return None
    spline: Any
    spline, _ = splprep(points.T, s=0, k=3)
    step = 1.0 / int(steps.sum())
    return np.column_stack(splev(np.arange(0.0, 1.0 + step, step), spline)).round(4)


def _nearest_point(line: FloatArray, position: FloatArray) -> FloatArray:
    """Return the point of a line of (m, 2) points that is nearest to a position."""
    starts, steps = line[:-1], np.diff(line, axis=0)
    along = ((position - starts) * steps).sum(axis=1) / (steps**2).sum(axis=1)
    feet = starts + np.clip(along, 0.0, 1.0)[:, None] * steps
    nearest: FloatArray = feet[((feet - position) ** 2).sum(axis=1).argmin()]
    return nearest


def _up_to_reach(points: FloatArray) -> FloatArray:
    """Return the first points of a line, up to `REACH` along it; none of a single point."""
    if len(points) < 2:
        return np.empty((0, 2))
    along = np.cumsum(np.hypot(*np.diff(points, axis=0).T))
    return points[: 1 + int(np.searchsorted(along, REACH))]
