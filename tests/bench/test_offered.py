"""The pipeline's modules as the bench offers them, checked against shapely and our own road."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from itertools import combinations, pairwise
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from frenetic.bench.hosting.offered.code_pipeline import test_analysis
from frenetic.bench.hosting.offered.code_pipeline.beamng_executor import BeamngExecutor
from frenetic.bench.hosting.offered.code_pipeline.executors import MockExecutor
from frenetic.bench.hosting.offered.code_pipeline.tests_generation import (
    RoadTest,
    RoadTestFactory,
    TestGenerationStatistic,
)
from frenetic.bench.hosting.offered.code_pipeline.validation import TestValidator, min_radius
from frenetic.bench.hosting.offered.code_pipeline.visualization import RoadTestVisualizer
from frenetic.bench.hosting.offered.self_driving.bbox import RoadBoundingBox
from frenetic.bench.hosting.offered.self_driving.catmull_rom import (
    catmull_rom,
    catmull_rom_2d,
)
from frenetic.bench.hosting.offered.self_driving.edit_distance_polyline import (
    iterative_levenshtein,
)
from frenetic.bench.hosting.offered.self_driving.oob_monitor import OutOfBoundsMonitor
from frenetic.bench.hosting.offered.self_driving.road_points import (
    List2DTuple,
    List4DTuple,
    RoadPoints,
)
from frenetic.bench.hosting.offered.self_driving.road_polygon import RoadPolygon
from frenetic.bench.hosting.offered.self_driving.simulation_data import SimulationDataRecord
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon, box

from frenetic.analysis import competition, edit_distance
from frenetic.errors import FreneticError, RoadError
from frenetic.road import Road, check_validity, validity
from frenetic.road.validity import interpolate

BEND = [(50.0, 20.0), (52.0, 50.0), (70.0, 80.0), (110.0, 90.0)]


# --- road tests --------------------------------------------------------------------------------


def test_tests_are_numbered() -> None:
    first = RoadTestFactory.create_road_test(BEND)
    assert RoadTestFactory.create_road_test(BEND).id == first.id + 1
    assert first.road_points == BEND


def test_a_test_is_interpolated_as_the_validity_check_does_it() -> None:
    test = RoadTest(BEND, 1)
    points = np.array(test.interpolated_points)
    assert np.array_equal(points[:, :2], interpolate(BEND))
    assert set(map(tuple, points[:, 2:].tolist())) == {(-28.0, 8.0)}
    assert isinstance(test.interpolated_points[0], tuple)


def test_the_length_of_a_road_is_that_of_its_interpolated_points() -> None:
    test = RoadTest([(20, 100), (60, 140), (100, 60), (180, 100)], 1)
    line = LineString([point[:2] for point in test.interpolated_points])
    assert test.get_road_length() == pytest.approx(line.length)
    assert test.get_road_length() == pytest.approx(265.6, abs=0.1)
    again = LineString(interpolate([point[:2] for point in test.interpolated_points]))
    assert again.length != line.length
    assert test.get_road_length(interpolate_road_points=True) == pytest.approx(again.length)


@pytest.mark.parametrize("points", [[], [(5.0, 5.0)], [(5.0, 5.0), (5.0, 5.0)], "road"])
def test_a_road_that_is_none_has_no_length(points: Any) -> None:
    with pytest.raises(RoadError):
        RoadTest(points, 1).get_road_length()


def test_a_test_is_a_snapshot() -> None:
    points = [[50.0, 20.0], [50.0, 90.0]]
    rows = np.array(points)
    tests = [RoadTestFactory.create_road_test(given) for given in (points, rows, list(rows))]
    points.append([50.0, 190.0])
    points[0][0] = 300.0
    rows[:] = 0.0
    for test in tests:
        assert np.array_equal(test.road_points, [[50.0, 20.0], [50.0, 90.0]])
        assert TestValidator(200).validate_test(test) == (True, "")


def test_iterators_are_read_once() -> None:
    given: Any = (map(float, point) for point in [(50, 20), (50, 90)])
    test = RoadTestFactory.create_road_test(given)
    for _ in range(2):
        assert TestValidator(200).validate_test(test) == (True, "")
    assert test.road_points == [(50.0, 20.0), (50.0, 90.0)]


def test_a_test_as_json() -> None:
    test = RoadTest([(np.float64(50.0), 20), (50.0, 90.0)], 7)
    assert json.loads(test.to_json())["is_valid"] is None
    test.set_validity(True, "")
    test.execution_data = [SimulationDataRecord(*[0.0] * 17)]  # type: ignore[arg-type]
    test.test_outcome, test.description = "PASS", "Successful test"
    document = json.loads(test.to_json())
    assert list(document) == [
        "id",
        "is_valid",
        "validation_message",
        "road_points",
        "interpolated_points",
        "test_outcome",
        "description",
        "execution_data",
        "features",
    ]
    assert document["road_points"] == [[50.0, 20.0], [50.0, 90.0]]
    assert document["execution_data"] == [[0.0] * 17]
    assert document["features"] == {"MAX_CURV": 0.0, "DIR_COV": 1 / 26}


CIRCULAR: list[Any] = []
CIRCULAR.append(CIRCULAR)
ODD = [
    None,
    "abc",
    7,
    np.array(5.0),
    [1, 2],
    [(1, 2, 3), (4, 5, 6)],
    [("a", "b")],
    np.array([["1", "2"], ["3", "4"]]),
    [(math.nan, 1.0), (2.0, 3.0)],
    [(math.inf, 1.0), (2.0, 3.0)],
    [(10**400, 1.0), (2.0, 3.0)],
    [(1j, 1.0), (2.0, 3.0)],
    [(1.0, 2.0), (3.0,)],
    [(1.0, 2.0), None],
    [itertools.count(), itertools.count()],
    CIRCULAR,
    {"x": 5},
]


@pytest.mark.parametrize("points", [*ODD, [], [(5.0, 5.0)], [(5.0, 5.0), (5.0, 5.0)]])
def test_whatever_a_test_is_made_of_it_can_be_written(points: Any) -> None:
    test = RoadTest(points, 1)
    test.execution_data, test.description = [object()], "odd"  # type: ignore[list-item]
    document = json.loads(test.to_json(), parse_constant=pytest.fail)
    assert document["interpolated_points"] == []
    assert "features" not in document


def test_odd_points_are_written_as_far_as_they_are_numbers() -> None:
    points: list[Any] = [("a", 20), (50.0, math.nan), 7]
    test = RoadTest(points, 1)
    assert json.loads(test.to_json())["road_points"] == [[None, 20.0], [50.0, None], None]


def test_a_road_that_is_none_says_so_when_it_is_looked_at() -> None:
    test = RoadTest([(5.0, 5.0)], 1)
    with pytest.raises(RoadError, match="at least 2 points"):
        test.interpolated_points  # noqa: B018


# --- counts ------------------------------------------------------------------------------------


def test_the_counts_as_a_table_and_as_text() -> None:
    stats = TestGenerationStatistic(
        test_generated=5,
        test_valid=3,
        test_invalid=2,
        test_passed=1,
        test_failed=2,
        obes=1,
        test_generation_real_times=[0.25, 0.5],
        test_execution_real_times=[36.0] * 3,
        test_execution_simulation_times=[8.5],
    )
    row = next(csv.DictReader(io.StringIO(stats.as_csv())))
    assert {name: float(value) for name, value in row.items()} == {
        "test_generated": 5,
        "test_valid": 3,
        "test_invalid": 2,
        "test_passed": 1,
        "test_failed": 2,
        "test_in_error": 0,
        "real_time_generation": 0.75,
        "real_time_execution": 108.0,
        "simulated_time_execution": 8.5,
    }
    lines = str(stats).splitlines()
    assert lines[0] == "test generated: 5"
    assert lines[5] == "test in_error: 0"
    assert lines[6] == "seconds of generating: 0.75"


# --- features ----------------------------------------------------------------------------------


def moment(steering: float, oob_distance: float) -> SimulationDataRecord:
    here = (0.0, 0.0, 0.0)
    return SimulationDataRecord(
        0.0, here, here, here, steering, 0, 0, 0, 0, 0, 0, 0, False, 0, 0.0, oob_distance, 0.0
    )


def test_features_are_those_of_our_own_analysis() -> None:
    test = RoadTest(BEND, 1)
    line = [point[:2] for point in test.interpolated_points]
    test.execution_data = [moment(-2.0, 1.5), moment(0.0, 0.5), moment(2.0, -0.5)]
    assert test.features == pytest.approx(
        {
            "MAX_CURV": 1.0 / validity.min_radius(line),
            "DIR_COV": competition.direction_coverage(line),
            "STD_SA": math.sqrt(8 / 3),
            "MEAN_LP": 0.5,
            "MAX_LP": 1.5,
        }
    )
    assert test_analysis.compute_all_features(line, []) == {
        name: test.features[name] for name in ("MAX_CURV", "DIR_COV")
    }
    assert list(test_analysis.compute_all_features(test, test.execution_data[:2])) == [
        "MAX_CURV",
        "DIR_COV",
    ]


def test_a_test_that_was_not_executed_has_no_features() -> None:
    test = RoadTest(BEND, 1)
    assert not hasattr(test, "features")
    test.features = {"MINE": 1.0}
    assert json.loads(test.to_json())["features"] == {"MINE": 1.0}


@pytest.mark.parametrize("window", [3, 5, 9])
def test_the_curvature_of_a_circle(window: int) -> None:
    angles = np.arange(0.0, 3.0, 0.05)
    circle = 20.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    name, curvature = test_analysis.max_curvature(circle.tolist(), w=window)
    assert name == "MAX_CURV"
    assert curvature == pytest.approx(0.05)
    assert test_analysis.max_curvature(circle[:window].tolist(), w=window) == ("MAX_CURV", 0.0)


def test_directions_of_a_circle_fill_half_the_bins_or_all() -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 400)
    circle = np.column_stack([np.cos(angles), np.sin(angles)]).tolist()
    assert test_analysis.direction_coverage(circle) == ("DIR_COV", 13 / 26)
    assert test_analysis.direction_coverage(circle, n_bins=5) == ("DIR_COV", 3 / 6)
    assert test_analysis.direction_coverage_klk(circle) == ("DIR_COV", 35 / 36)


# --- lines -------------------------------------------------------------------------------------


def test_edits_are_those_of_our_own_analysis() -> None:
    rng = np.random.default_rng(3)
    lines = []
    for _ in range(6):
        headings = np.cumsum(rng.normal(0.0, 0.4, rng.integers(1, 30)))
        steps = rng.uniform(0.9, 1.1, len(headings))[:, None]
        moves = steps * np.column_stack([np.cos(headings), np.sin(headings)])
        lines.append(np.vstack([[0.0, 0.0], np.cumsum(moves, axis=0)]))
    for one in lines:
        for other in lines:
            edits = iterative_levenshtein(one.tolist(), other.tolist())
            assert edits == pytest.approx(edit_distance(one, other), abs=1e-9)
    with pytest.raises(RoadError, match="at least 2 points"):
        iterative_levenshtein([(0.0, 0.0)], [(0.0, 0.0), (1.0, 0.0)])


def by_the_pyramid(points: Any, t: float) -> Any:
    """A point between the second and third of four, as Barry and Goldman find it."""
    p = [np.array(point) for point in points]
    knots = [0.0, *itertools.accumulate(math.dist(a, b) ** 0.5 for a, b in pairwise(points))]
    u = knots[1] + t * (knots[2] - knots[1])

    def between(a: Any, b: Any, i: int, j: int) -> Any:
        return ((knots[j] - u) * a + (u - knots[i]) * b) / (knots[j] - knots[i])

    a = [between(p[i], p[i + 1], i, i + 1) for i in range(3)]
    b = [between(a[i], a[i + 1], i, i + 2) for i in range(2)]
    return between(b[0], b[1], 1, 2)


def test_a_catmull_rom_spline() -> None:
    points = [(0.0, 0.0), (10.0, 1.0), (13.0, 9.0), (30.0, 12.0), (31.0, 20.0)]
    line = catmull_rom_2d(points, 11)
    assert len(line) == 21
    assert (line[0], line[10], line[20]) == (points[1], points[2], points[3])
    for k in range(21):
        i = min(k // 10, 1)
        expected = by_the_pyramid(points[i : i + 4], k / 10 - i)
        assert line[k] == pytest.approx(expected, abs=1e-9)
    nodes = catmull_rom([(x, y, -28.0, 8.0) for x, y in points], num_spline_points=11)
    assert nodes == [(x, y, -28.0, 8.0) for x, y in line]
    assert len(catmull_rom_2d(points)) == 39


@pytest.mark.parametrize("points", [[], [(0, 0), (1, 0), (2, 0)], [(0, 0), (1, 0), (1, 0), (2, 0)]])
def test_a_spline_needs_four_places(points: Any) -> None:
    with pytest.raises(RoadError):
        catmull_rom_2d(points)


def test_names_for_annotations() -> None:
    assert RoadTestFactory.RoadTest is RoadTest
    assert List4DTuple == list[tuple[float, float, float, float]]
    assert List2DTuple == list[tuple[float, float]]


# --- validity ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(40))
def test_the_validator_agrees_with_the_bench(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = Road(rng.uniform(-0.09, 0.09, rng.integers(2, 25)), 10.0).placed(200.0)[0]
    points = road.road_points if road is not None else rng.uniform(0.0, 200.0, (5, 2))
    verdict = check_validity(points, 200.0)
    kinds: list[Any] = [points, [tuple(point) for point in points], points.tolist()]
    for given_points in kinds:
        assert TestValidator(200).validate_test(RoadTest(given_points, 1)) == (
            verdict.valid,
            verdict.message,
        )


@pytest.mark.parametrize("odd", [None, BEND, "road", RoadTest])
def test_what_is_no_test_has_the_wrong_type(odd: Any) -> None:
    assert TestValidator(map_size=200).validate_test(odd) == (False, "Wrong type")


@pytest.mark.parametrize("points", ODD)
def test_points_that_are_none_have_the_wrong_type(points: Any) -> None:
    test = RoadTest(points, 1)
    assert TestValidator(200).validate_test(test) == (False, "Wrong type")
    with pytest.raises(RoadError, match="pairs x, y"):
        test.interpolated_points  # noqa: B018


@pytest.mark.parametrize("radius", [15.0, 30.0, 200.0])
def test_the_radius_is_in_feet(radius: float) -> None:
    angles = np.arange(0.0, 30.0 / radius, 1.0 / radius)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    assert min_radius(circle.tolist()) == pytest.approx(radius / 0.3048)
    assert min_radius([(x, y, -28.0, 8.0) for x, y in circle.tolist()]) == min_radius(circle)


def test_a_straight_road_is_not_sharp() -> None:
    assert min_radius([(float(i), 0.0) for i in range(20)]) == math.inf


# --- areas -------------------------------------------------------------------------------------


def nodes_of(seed: int) -> list[tuple[float, float, float, float]]:
    """Nodes of a road that winds so much that it often meets itself."""
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-0.4, 0.4, rng.integers(2, 40)) + rng.uniform(-0.5, 0.5)
    headings = np.cumsum(turns)
    steps = rng.uniform(3.0, 12.0, len(headings))
    moves = steps[:, None] * np.column_stack([np.cos(headings), np.sin(headings)])
    places = np.vstack([[0.0, 0.0], np.cumsum(moves, axis=0)])
    return [(x, y, -28.0, 8.0) for x, y in places.tolist()]


def is_valid_by_shapely(pieces: list[Any]) -> bool:
    if not all(piece.is_valid for piece in pieces):
        return False
    for i, j in combinations(range(len(pieces)), 2):
        common = pieces[i].intersection(pieces[j])
        if j > i + 1 and not common.is_empty:
            return False
        if j == i + 1 and common.area > 1e-9:
            return False
    return True


def test_overlaps_are_those_that_shapely_sees() -> None:
    verdicts = []
    for seed in range(150):
        road = RoadPolygon.from_nodes(nodes_of(seed))
        verdicts.append(road.is_valid())
        assert verdicts[-1] == is_valid_by_shapely(road.polygons), seed
    assert 20 < sum(verdicts) < 130


def test_a_road_that_stands_still_is_not_valid() -> None:
    nodes = [(0.0, 0.0, 0.0, 8.0), (0.0, 10.0, 0.0, 8.0), (0.0, 10.0, 0.0, 8.0)]
    assert not RoadPolygon.from_nodes(nodes).is_valid()


@pytest.mark.parametrize("width", [4.0, 8.0, 10.0])
def test_a_straight_road_has_the_areas_it_should(width: float) -> None:
    road = RoadPolygon.from_nodes([(10.0, 10.0 * k, -28.0, width) for k in range(6)])
    assert road.is_valid()
    assert road.polygon.equals(box(10.0 - width / 2, 0.0, 10.0 + width / 2, 50.0))
    assert road.right_polygon.equals(box(10.0, 0.0, 10.0 + width / 2, 50.0))
    assert road.left_polygon.equals(box(10.0 - width / 2, 0.0, 10.0, 50.0))
    assert road.polyline.equals(LineString([(10.0, 0.0), (10.0, 50.0)]))
    quarter = width / 4
    assert road.right_polyline.equals(LineString([(10.0 + quarter, 0.0), (10.0 + quarter, 50.0)]))
    assert road.left_polyline.equals(LineString([(10.0 - quarter, 0.0), (10.0 - quarter, 50.0)]))
    assert len(road.polygons) == road.num_polygons == 5
    assert road.road_points.right == [(10.0 + width / 2, 10.0 * k) for k in range(6)]


def test_a_bend_lies_where_a_buffer_of_its_middle_lies() -> None:
    road = RoadTest(BEND, 1).get_road_polygon()
    buffer = road.polyline.buffer(4.0, cap_style="flat")
    assert road.polygon.symmetric_difference(buffer).area < 0.01 * buffer.area
    assert road.polygon.equals(Polygon([*road.road_points.left, *reversed(road.road_points.right)]))
    lanes = road.left_polygon.union(road.right_polygon)
    assert lanes.symmetric_difference(road.polygon).area < 1e-6


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=0, max_size=5), max_size=6))
def test_nodes_are_four_numbers_each_or_refused(nodes: list[list[float]]) -> None:
    if len(nodes) >= 2 and all(len(node) == 4 for node in nodes):
        road = RoadPoints.from_nodes(nodes)
        assert len(road.middle) == len(road.left) == len(road.right) == len(nodes)
    else:
        with pytest.raises(RoadError):
            RoadPoints.from_nodes(nodes)


def test_a_road_is_drawn_on_axes_by_its_lines() -> None:
    axes = MagicMock()
    road = RoadTest(BEND, 1).get_road_polygon().road_points
    road.plot_on_ax(axes)
    drawn = [list(zip(*call.args, strict=True)) for call in axes.plot.call_args_list]
    assert drawn == [road.middle, road.left, road.right]


def test_the_box_of_the_map() -> None:
    area = RoadBoundingBox((0, 0, 200, 200))
    inside = RoadTest(BEND, 1).get_road_polygon()
    across = RoadTest([(50.0, 20.0), (50.0, 220.0)], 1).get_road_polygon()
    beyond = RoadTest([(300.0, 20.0), (300.0, 90.0)], 1).get_road_polygon()
    assert [area.contains(road) for road in (inside, across, beyond)] == [True, False, False]
    assert [area.intersects_boundary(road.polygon) for road in (inside, across, beyond)] == [
        False,
        True,
        False,
    ]
    places = Point(0, 0), Point(0, 50), Point(200, 200), Point(50, 50)
    assert [area.intersects_vertices(place) for place in places] == [True, False, True, False]
    assert [area.intersects_sides(place) for place in places] == [True, True, True, False]
    assert area.bbox.bounds == (0.0, 0.0, 200.0, 200.0)
    assert sum(side.length for side in area.get_sides()) == area.bbox.length == 800.0
    assert len(area.get_vertices()) == 4


# --- names only --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [BeamngExecutor, MockExecutor, OutOfBoundsMonitor])
def test_what_needs_beamng_cannot_be_built(kind: type[Any]) -> None:
    with pytest.raises(FreneticError, match=f"{kind.__name__} cannot be built"):
        kind(time_budget=5, map_size=200)


def test_the_visualizer_draws_nothing() -> None:
    visualizer = RoadTestVisualizer(map_size=200)
    visualizer.visualize_road_test(RoadTest(BEND, 1))
    visualizer.draw_anything(1, colour="red")
    with pytest.raises(AttributeError):
        visualizer._drawn  # noqa: B018
