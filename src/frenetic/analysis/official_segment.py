"""Segment of a failure as the competition's published code cuts it, mistakes included."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.analysis.segments import REACH
from frenetic.campaign.record import Test
from frenetic.road.validity import as_points

_NEAR: Final = 0.55
"""Largest distance from a place to its node of the road, in m: half of 1 m, and a tolerance."""


def competition_segment(
    road_points: npt.ArrayLike, position: tuple[float, float]
) -> FloatArray | None:
    """Return the segment around the place of a road that is nearest to a position, (n, 2) in m.

    Nodes before, the place on the road, nodes after. The first node after the place may lie half a
    metre *before* it, where the line then turns back and forth; the competition's measures are
    computed on that.

    Args:
        road_points: (N, 2) points of the submitted road, in m.
        position: x and y in m where the car was first out of its lane.

    Returns:
        None where the competition's code breaks: for a place at the road's start, and for a road
        of fewer than four points.

    Raises:
        RoadError: the road points are not pairs of numbers.
    """
    line = _interpolated(as_points(road_points))
    if line is None:
        return None
    place = _foot(line, np.array(position))
    near = np.flatnonzero(np.hypot(*(line - place).T) < _NEAR)
    if len(near) == 0 or near[-1] == 0:
        return None
    i = int(near[-1])
    before = _within(np.vstack([line[:i], place])[::-1])[::-1]
    after = _within(line[i:])
    return np.vstack([before, after])


def failure_segment(test: Test) -> FloatArray | None:
    """Return the segment of a failure; None without a departure or a `competition_segment`.

    Raises:
        RoadError: the test has no road.
    """
    points, left = test.candidate.points, test.departure
    if left is None:
        return None
    submitted = test.road.road_points if points is None else points
    return competition_segment(submitted, (left.x, left.y))


def _interpolated(points: FloatArray) -> FloatArray | None:
    """Return points of the road about 1 m apart, rounded to 0.1 mm as for the sparseness.

    None if no cubic spline passes through the points: there are fewer than four, or two are equal.
    (For a road's validity the competition rounds to the millimetre and makes 20 steps or more.)
    """
    from scipy.interpolate import splev, splprep  # takes its time

    moves: FloatArray = np.diff(points, axis=0)
    steps = np.hypot(moves[:, 0], moves[:, 1])
    if len(points) < 4 or steps.min() == 0.0 or steps.sum() < 1.0:
        return None
    tck: Any
    tck, _ = splprep(points.T, s=0, k=3)
    step = 1.0 / int(steps.sum())
    return np.column_stack(splev(np.arange(0.0, 1.0 + step, step), tck)).round(4)


def _foot(line: FloatArray, position: FloatArray) -> FloatArray:
    """Return the point of a line of (m, 2) points that is nearest to a position."""
    starts, steps = line[:-1], np.diff(line, axis=0)
    along = ((position - starts) * steps).sum(axis=1) / (steps**2).sum(axis=1)
    feet = starts + np.clip(along, 0.0, 1.0)[:, None] * steps
    foot: FloatArray = feet[((feet - position) ** 2).sum(axis=1).argmin()]
    return foot


def _within(points: FloatArray) -> FloatArray:
    """Return the points that lie less than `REACH` along the line; none for a single point."""
    if len(points) < 2:
        return np.empty((0, 2))
    along = np.cumsum(np.hypot(*np.diff(points, axis=0).T))
    return points[: 1 + int(np.searchsorted(along, REACH))]
