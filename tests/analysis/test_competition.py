from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from made_drives import departing, departure, drive

from frenetic._support.arrays import FloatArray
from frenetic.analysis import (
    competition_features,
    competition_segment,
    features_of,
    segment_of,
)
from frenetic.analysis.competition import direction_coverage, first_record
from frenetic.road import Road
from frenetic.road.validity import min_radius

NORTH = [(0.0, 10.0 * k) for k in range(11)]
"""100 m northwards; interpolated, the nodes are 0, 1 .. 100 m."""


def circle(radius: float, degrees: float) -> FloatArray:
    """Points every metre on an arc that begins northwards and turns left."""
    angle = np.arange(0.0, math.radians(degrees), 1.0 / radius)
    return radius * np.column_stack([np.cos(angle) - 1.0, np.sin(angle)])


@pytest.mark.parametrize(
    ("x", "side"), [(-2.1, "right"), (-1.9, "left"), (1.9, "left"), (2.1, "right"), (5.0, "right")]
)
def test_left_is_near_the_centre_line(x: float, side: str) -> None:
    cut = competition_segment(NORTH, (x, 50.2))
    assert cut is not None
    assert cut.side == side


def test_segment_of_a_straight_worked_out_by_hand() -> None:
    # The place is 50.7 m; the node near it is 51 m. Backwards, 21 m is 29.7 m away, 20 m too far;
    # forwards from 51 m, 80 m is 29 m away, and 81 m, which is 30 m away, too far.
    cut = competition_segment(NORTH, (2.5, 50.7))
    assert cut is not None
    expected = [*range(21, 51), 50.7, *range(51, 81)]
    assert cut.points[:, 1] == pytest.approx(expected)
    assert cut.points[:, 0] == pytest.approx(0.0)
    assert len(cut.line) == 101


def test_segment_turns_back_where_the_place_lies_just_behind_a_node() -> None:
    # The place is 50.2 m, and the last node that is near is 50 m, which lies before it.
    cut = competition_segment(NORTH, (2.5, 50.2))
    assert cut is not None
    assert cut.points[:, 1] == pytest.approx([*range(21, 50), 50.2, *range(50, 80)])


def test_segment_is_cut_off_at_the_roads_ends() -> None:
    early = competition_segment(NORTH, (0.0, 5.7))
    late = competition_segment(NORTH, (0.0, 95.7))
    assert early is not None
    assert late is not None
    assert early.points[0, 1] == pytest.approx(0.0)
    assert late.points[-1, 1] == pytest.approx(100.0)


@pytest.mark.parametrize(
    ("road", "position"),
    [
        (NORTH, (0.0, 0.1)),  # at the start
        (NORTH[:3], (0.0, 15.0)),  # no cubic spline
        ([NORTH[0], *NORTH], (0.0, 50.0)),  # a repeated point
    ],
)
def test_there_is_no_segment_where_the_competition_breaks(
    road: list[tuple[float, float]], position: tuple[float, float]
) -> None:
    assert competition_segment(road, position) is None


def test_first_record_is_the_first_whose_nearest_place_is_at_the_segments_start() -> None:
    """Against the definition, position by position, on paths that stray far from a winding road."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(60):
        road = Road(rng.uniform(-0.06, 0.06, 20)).road_points
        place = road[rng.integers(20, len(road) - 5)]
        cut = competition_segment(road, (place[0], place[1]))
        assert cut is not None
        drift = rng.normal(0.0, 4.0, 2)
        path = cut.line[::3] + np.cumsum(rng.normal(0.0, 1.0, cut.line[::3].shape), axis=0) + drift
        expected = 0
        for i, position in enumerate(path):
            node = node_of(cut.line, position)
            if node is not None and math.dist(node, cut.points[0]) < 0.01:
                expected = i
                break
        found.append(first_record(cut, path))
        assert found[-1] == expected
    assert sum(record > 0 for record in found) > 10


def node_of(line: FloatArray, position: FloatArray) -> FloatArray | None:
    """The first node within 0.55 m of the line's point that is nearest to a position."""
    feet = []
    for a, b in pairwise(line):
        share = min(max(float((position - a) @ (b - a) / ((b - a) @ (b - a))), 0.0), 1.0)
        feet.append(a + share * (b - a))
    foot = min(feet, key=lambda one: math.dist(one, position))
    return next((node for node in line if math.dist(node, foot) < 0.55), None)


def test_direction_coverage_of_a_straight_is_one_bin_of_26() -> None:
    assert direction_coverage(NORTH) == pytest.approx(1.0 / 26.0)


def test_direction_coverage_of_a_quarter_circle() -> None:
    # Chords from 0.5 to about 88 degrees off north, in bins of 14.4: 88 lies in the seventh.
    assert direction_coverage(circle(60.0, 90.0)) == pytest.approx(7.0 / 26.0)


@pytest.mark.parametrize("degrees", [180.0, 270.0, 360.0])
def test_direction_coverage_never_exceeds_a_half(degrees: float) -> None:
    assert direction_coverage(circle(60.0, degrees)) == pytest.approx(13.0 / 26.0)


def test_features_of_a_departure_worked_out_by_hand() -> None:
    road = Road(np.zeros(11))
    places = [10.0, 20.6, 30.0, 40.0, 50.7]
    made = drive(
        road,
        places,
        [0.0, 0.5, 0.0, 1.0, 4.0],
        [9.0, 10.0, 12.0, 14.0, 9.0],
        [9.0, 0.1, 0.2, 0.3, 9.0],
    )
    leaving = departure(4.0, 50.7, 2.0, 50.7)
    found = competition_features(segment_of(road, made, leaving), NORTH)
    assert found is not None
    # The segment begins at the node 21 m. The record at 20.6 m is the first near it, and the one
    # at the departure does not count: three records.
    assert found.max_curv == 0.0
    assert found.dir_cov == pytest.approx(1.0 / 26.0)
    assert found.std_sa == pytest.approx(math.degrees(math.sqrt((0.01 + 0.0 + 0.01) / 3.0)))
    assert found.mean_lp == pytest.approx((1.5 + 2.0 + 1.0) / 3.0)
    assert found.max_lp == pytest.approx(2.0)
    assert found.std_speed == pytest.approx(math.sqrt((4.0 + 0.0 + 4.0) / 3.0))


def test_curvature_of_a_circle_is_too_large_where_the_segment_turns_back() -> None:
    points = circle(20.0, 170.0)
    found = []
    for degrees in np.linspace(80.0, 83.0, 13):  # about a metre further along in 12 steps
        way = math.radians(degrees)
        cut = competition_segment(points, (20.0 * math.cos(way) - 20.0, 20.0 * math.sin(way)))
        assert cut is not None
        steps = np.diff(cut.points, axis=0)
        turns_back = bool(((steps[1:] * steps[:-1]).sum(axis=1) < 0.0).any())
        found.append((turns_back, 1.0 / min_radius(cut.points)))
    assert {turns_back for turns_back, _ in found} == {False, True}
    for turns_back, curvature in found:
        assert curvature >= 0.05 - 1e-3
        assert turns_back or curvature < 0.053
    assert max(curvature for _, curvature in found) > 0.055


def test_turning_the_road_changes_the_competitions_direction_coverage_but_not_ours() -> None:
    north = departing(Road([0.0] * 4 + [0.03] * 7), 60.0)
    turned = departing(Road([0.0] * 4 + [0.03] * 7, pose=(0.0, 0.0, math.radians(200.0))), 60.0)
    theirs = [competition_features(north), competition_features(turned)]
    assert theirs[0] is not None
    assert theirs[1] is not None
    assert theirs[0].dir_cov != theirs[1].dir_cov
    assert features_of(north).direction_coverage == features_of(turned).direction_coverage


def test_the_road_that_was_submitted_can_be_given() -> None:
    road = Road(np.zeros(11))
    segment = departing(road, 60.0)
    wavy = [(0.5 * (-1) ** k, 10.0 * k) for k in range(11)]
    found = competition_features(segment, wavy)
    assert found is not None
    assert found.max_curv > 0.01


def test_a_failure_without_departure_is_left_out() -> None:
    road = Road(np.zeros(11))
    assert competition_features(segment_of(road, drive(road, [0.0, 0.1]), None)) is None
