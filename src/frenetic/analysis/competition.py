"""The competition's own features of a failure, mistakes included, for comparison with its tables.

They are computed as the published pipeline does it. research/measures.md lists the mistakes.
`Features` are the corrected form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.analysis.segments import REACH, Segment
from frenetic.oracle import Side
from frenetic.road.validity import as_points, min_radius

_DIRECTION_EDGES: Final = 26
"""Edges of the competition's bins of direction, from 0 to 360 degrees."""
_NEAR: Final = 0.55
"""Distance from a place to the road's node for it, in m: half of 1 m, and a tolerance."""
_LEFT: Final = 2.0
"""Distance from the centre line up to which a departure counts as one to the left, in m."""
_AT_NODE: Final = 0.01
"""Largest distance between two equal nodes, in m."""


@dataclass(frozen=True)
class CompetitionFeatures:
    """Features of a failure's segment as the competition of 2022 to 2024 computed them."""

    max_curv: float
    """MAX_CURV, 1/m: one over the radius of the smallest circle through points about 2 m apart."""
    dir_cov: float
    """DIR_COV, 0 .. 0.5: occupied bins of the angle to north, which never exceeds 180 degrees, in
    25 bins for 360 degrees, divided by 26."""
    std_sa: float
    """STD_SA, standard deviation of `steering`: here of the front wheels' angle in degrees, as in
    the competition's files that we write; BeamNG reports the steering wheel's."""
    mean_lp: float
    """MEAN_LP, m: mean oob distance of the records before the departure."""
    max_lp: float
    """MAX_LP, m: largest oob distance, so the record closest to the lane's centre."""
    std_speed: float
    """Standard deviation of speed, in m/s: announced in 2024, in no published code."""


@dataclass(frozen=True, eq=False)
class CompetitionSegment:
    """A failure's segment as the competition cuts it out of a road."""

    line: FloatArray
    """The whole road interpolated at about 1 m, (m, 2) in m."""
    points: FloatArray
    """The segment, (n, 2) in m: nodes before, the place on the road, nodes after.

    The first node after the place may lie half a metre *before* it, where the line then turns back
    and forth; the competition's measures are computed on that.
    """
    side: Side
    """The side on which the car left its lane, as the competition's evaluation has it: the left
    one within 2 m of the centre line, on either side of it, and the right one further away. A car
    that goes far enough out to the left counts as right."""


def competition_segment(
    road_points: npt.ArrayLike, position: tuple[float, float], reach: float = REACH
) -> CompetitionSegment | None:
    """The segment around the place of a road that is nearest to a position.

    Args:
        road_points: (N, 2) m, the road as it was submitted.
        position: m, where the car was first out of its lane.
        reach: m of road before and after the place.

    Returns:
        None where the competition's code breaks: for a place at the road's start, and for a road
        of fewer than four points.

    Raises:
        RoadError: the road points are not pairs of numbers.
    """
    line = _interpolated(as_points(road_points))
    if line is None:
        return None
    place = _foot(line, np.array([position]))[0]
    near = np.flatnonzero(np.hypot(*(line - place).T) < _NEAR)
    if len(near) == 0 or near[-1] == 0:
        return None
    i = int(near[-1])
    before = _within(np.vstack([line[:i], place])[::-1], reach)[::-1]
    after = _within(line[i:], reach)
    away = float(np.hypot(*(np.array(position) - place)))
    return CompetitionSegment(line, np.vstack([before, after]), "left" if away < _LEFT else "right")


def competition_features(
    segment: Segment, road_points: npt.ArrayLike | None = None
) -> CompetitionFeatures | None:
    """The competition's features of a failure.

    Args:
        segment: of the failure.
        road_points: (N, 2) m, the road as it was submitted; by default `Road.road_points`.

    Returns:
        None if the car did not leave its lane, or where the competition's code breaks: it leaves
        such failures out.

    Raises:
        RoadError: the road points are not pairs of numbers.
    """
    path = segment.drive.trajectory
    departure = len(segment.assessment.distance) - 1
    if segment.side is None:
        return None
    submitted = segment.road.road_points if road_points is None else road_points
    cut = competition_segment(submitted, (float(path.x[departure]), float(path.y[departure])))
    if cut is None:
        return None
    positions = np.column_stack([path.x, path.y])[: departure + 1]
    first = first_record(cut, positions)
    if first >= departure:
        return None
    records = slice(first, departure)
    position = segment.assessment.oob_distance[records]
    return CompetitionFeatures(
        max_curv=1.0 / min_radius(cut.points),
        dir_cov=direction_coverage(cut.points),
        std_sa=float(np.degrees(path.steering[records]).std()),
        mean_lp=float(position.mean()),
        max_lp=float(position.max()),
        std_speed=float(path.speed[records].std()),
    )


def direction_coverage(points: npt.ArrayLike) -> float:
    """DIR_COV of a line of (n, 2) points in m: see `CompetitionFeatures`."""
    steps = np.diff(as_points(points), axis=0)
    with np.errstate(invalid="ignore"):  # a step of no length has no direction: a bin of its own
        angles = np.degrees(np.arccos(steps[:, 1] / np.hypot(steps[:, 0], steps[:, 1])))
    edges = np.linspace(0.0, 360.0, _DIRECTION_EDGES)
    return len(set(np.digitize(angles, edges).tolist())) / _DIRECTION_EDGES


def first_record(segment: CompetitionSegment, positions: FloatArray) -> int:
    """Index of the first of (n, 2) positions in m at a segment's start; 0 if none is."""
    # Only positions near the start matter: they are hardly further from it than from any node.
    x, y = positions[:, :1] - segment.line[:, 0], positions[:, 1:] - segment.line[:, 1]
    nearest = np.sqrt((x * x + y * y).min(axis=1))
    to_start = np.hypot(*(positions - segment.points[0]).T)
    likely = np.flatnonzero(to_start <= nearest + _NEAR + 2.0 * _AT_NODE)
    away = _foot(segment.line, positions[likely])[:, None] - segment.line
    near = np.hypot(away[:, :, 0], away[:, :, 1]) < _NEAR
    nodes = np.where(near.any(axis=1, keepdims=True), segment.line[near.argmax(axis=1)], np.inf)
    at_start = likely[np.hypot(*(nodes - segment.points[0]).T) < _AT_NODE]
    return int(at_start[0]) if len(at_start) else 0


def _interpolated(points: FloatArray) -> FloatArray | None:
    """The road every metre or so, rounded to a tenth of a millimetre, as for these measures.

    None if no cubic spline passes through the points: fewer than four, or one that is repeated.
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


def _foot(line: FloatArray, positions: FloatArray) -> FloatArray:
    """(n, 2) nearest points of a line of (m, 2) points to (n, 2) positions."""
    starts, steps = line[:-1], np.diff(line, axis=0)
    along = ((positions[:, None] - starts) * steps).sum(axis=2) / (steps**2).sum(axis=1)
    feet = starts + np.clip(along, 0.0, 1.0)[:, :, None] * steps
    nearest = ((feet - positions[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    chosen: FloatArray = feet[np.arange(len(positions)), nearest]
    return chosen


def _within(points: FloatArray, reach: float) -> FloatArray:
    """The points up to, not including, the one that is ``reach`` m or more along the line.

    A single point is no line and gives nothing.
    """
    if len(points) < 2:
        return np.empty((0, 2))
    along = np.cumsum(np.hypot(*np.diff(points, axis=0).T))
    return points[: 1 + int(np.searchsorted(along, reach))]
