"""The pipeline's modules as the bench offers them, checked against shapely and our own road."""

from __future__ import annotations

import json
import math
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon, box

from frenetic.competition.hosting.offered.code_pipeline.beamng_executor import BeamngExecutor
from frenetic.competition.hosting.offered.code_pipeline.executors import MockExecutor
from frenetic.competition.hosting.offered.code_pipeline.tests_generation import (
    RoadTest,
    RoadTestFactory,
)
from frenetic.competition.hosting.offered.code_pipeline.validation import TestValidator, min_radius
from frenetic.competition.hosting.offered.code_pipeline.visualization import RoadTestVisualizer
from frenetic.competition.hosting.offered.self_driving.bbox import RoadBoundingBox
from frenetic.competition.hosting.offered.self_driving.oob_monitor import OutOfBoundsMonitor
from frenetic.competition.hosting.offered.self_driving.road_points import RoadPoints
from frenetic.competition.hosting.offered.self_driving.road_polygon import RoadPolygon
from frenetic.competition.hosting.offered.self_driving.simulation_data import SimulationDataRecord
from frenetic.errors import FreneticError, RoadError
from frenetic.road import Road, check_validity
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


def test_the_length_of_a_road() -> None:
    test = RoadTest(BEND, 1)
    assert test.get_road_length() == pytest.approx(LineString(BEND).length)
    line = LineString([point[:2] for point in test.interpolated_points])
    assert test.get_road_length(interpolate_road_points=True) == pytest.approx(line.length)
    assert RoadTest([], 1).get_road_length() == 0.0
    assert RoadTest([(5.0, 5.0)], 1).get_road_length() == 0.0


def test_a_test_as_json() -> None:
    test = RoadTest([(np.float64(50.0), 20), (50.0, 90.0)], 7)
    assert json.loads(test.to_json())["is_valid"] is None
    test.set_validity(True, "")
    test.execution_data = [SimulationDataRecord(*[0.0] * 17)]  # type: ignore[arg-type]
    test.test_outcome, test.description, test.features = "PASS", "Successful test", {}
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


def test_a_road_that_is_none_says_so_when_it_is_looked_at() -> None:
    test = RoadTest([(5.0, 5.0)], 1)
    with pytest.raises(RoadError, match="at least 2 points"):
        test.interpolated_points  # noqa: B018


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


@pytest.mark.parametrize(
    "points", [None, [1, 2], [(1, 2, 3), (4, 5, 6)], [("a", "b")], [(math.nan, 1.0), (2.0, 3.0)]]
)
def test_points_that_are_none_are_invalid(points: Any) -> None:
    valid, message = TestValidator(200).validate_test(RoadTest(points, 1))
    assert not valid
    assert message
    assert "\n" not in message


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
