"""The competition's segment around a departure."""

from __future__ import annotations

import math

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.analysis import competition_segment
from frenetic.road.validity import min_radius

NORTH = [(0.0, 10.0 * k) for k in range(11)]
"""A road of 100 m northwards; its interpolated nodes are 0, 1 .. 100 m."""


def circle(radius: float, degrees: float) -> FloatArray:
    """Return points every metre on an arc that begins northwards and turns left."""
    angle = np.arange(0.0, math.radians(degrees), 1.0 / radius)
    return radius * np.column_stack([np.cos(angle) - 1.0, np.sin(angle)])


@pytest.mark.parametrize(
    ("place", "before", "after"),
    [
        # The nearest node is at 51 m. Backwards, the node at 21 m is 29.7 m away, and 20 m is too
        # far. Forwards from 51 m, the node at 80 m is 29 m away, and 81 m, 30 m away, is too far.
        (50.7, range(21, 51), range(51, 81)),
        (50.5, range(21, 51), range(51, 81)),  # the last of two nearest nodes
        (50.2, range(21, 50), range(50, 80)),  # the nearest node, at 50 m, lies before the place
    ],
)
def test_segment_of_a_straight_worked_out_by_hand(
    place: float, before: range, after: range
) -> None:
    cut = competition_segment(NORTH, (2.5, place))
    assert cut is not None
    assert cut[:, 1] == pytest.approx([*before, place, *after])
    assert cut[:, 0] == pytest.approx(0.0)


def test_segment_is_cut_off_at_the_roads_ends() -> None:
    early = competition_segment(NORTH, (0.0, 5.7))
    late = competition_segment(NORTH, (0.0, 95.7))
    assert early is not None
    assert late is not None
    assert early[0, 1] == pytest.approx(0.0)
    assert late[-1, 1] == pytest.approx(100.0)


def test_four_points_are_enough_for_a_segment() -> None:
    cut = competition_segment(NORTH[:4], (0.0, 15.0))
    assert cut is not None
    assert cut[:, 1] == pytest.approx([*range(15), 15.0, *range(15, 32)])


@pytest.mark.parametrize(
    ("road", "position"),
    [
        (NORTH, (0.0, 0.1)),  # at the start
        (NORTH[:3], (0.0, 15.0)),  # no cubic spline
        ([NORTH[0], *NORTH], (0.0, 50.0)),  # a repeated point
    ],
)
def test_there_is_no_segment_where_the_competitions_code_breaks(
    road: list[tuple[float, float]], position: tuple[float, float]
) -> None:
    assert competition_segment(road, position) is None


def test_curvature_of_a_circle_is_too_large_where_the_segment_turns_back() -> None:
    points = circle(20.0, 170.0)
    curvatures = []
    for degrees in np.linspace(80.0, 83.0, 13):  # about a metre further along in 12 steps
        way = math.radians(degrees)
        cut = competition_segment(points, (20.0 * math.cos(way) - 20.0, 20.0 * math.sin(way)))
        assert cut is not None
        steps = np.diff(cut, axis=0)
        turns_back = bool(((steps[1:] * steps[:-1]).sum(axis=1) < 0.0).any())
        curvatures.append((turns_back, 1.0 / min_radius(cut)))
    assert {turns_back for turns_back, _ in curvatures} == {False, True}
    for turns_back, curvature in curvatures:
        assert curvature >= 0.05 - 1e-3
        assert turns_back or curvature < 0.053
    assert max(curvature for _, curvature in curvatures) > 0.055
