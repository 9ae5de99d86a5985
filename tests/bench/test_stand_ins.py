"""What stands in for the pipeline's modules where a lone file has no clone of them."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.bench.hosting.standins.code_pipeline.tests_generation import RoadTestFactory
from frenetic.bench.hosting.standins.code_pipeline.validation import TestValidator, min_radius
from frenetic.bench.hosting.validity import overlaps_not
from frenetic.errors import RoadError
from frenetic.road import check_validity
from frenetic.road.validity import interpolate

BEND = [(20.0, 20.0), (60.0, 60.0), (60.0, 110.0), (100.0, 140.0)]
ODD: list[Any] = [
    *("road", None, 7, [(1, 2, 3)], [("a", 20.0), (50.0, None), 7]),
    *([(1.0, math.inf), (2.0, 3.0)], [(10**400, 1), (2, 3)], {1: 2}),
]


def test_tests_are_numbered_and_hold_a_copy_of_their_points() -> None:
    points = list(BEND)
    tests = [RoadTestFactory.create_road_test(points) for _ in range(3)]
    points.clear()
    assert [test.id - tests[0].id for test in tests] == [0, 1, 2]
    assert tests[0].road_points == BEND
    nodes = tests[0].interpolated_points
    assert [node[:2] for node in nodes] == [tuple(p) for p in interpolate(BEND).tolist()]
    assert {node[2:] for node in nodes} == {(-28.0, 8.0)}
    length = sum(math.dist(a[:2], b[:2]) for a, b in pairwise(nodes))
    assert tests[0].get_road_length() == pytest.approx(length)
    assert tests[0].get_road_length(interpolate_road_points=True) == pytest.approx(length, rel=1e-3)


@pytest.mark.parametrize("points", [*ODD, [], [(5.0, 5.0)]])
def test_whatever_a_test_is_made_of_it_is_judged_and_written(points: Any) -> None:
    test = RoadTestFactory.create_road_test(points)
    message = "Wrong type" if points in ODD else "Not enough road points."
    assert TestValidator(200).validate_test(test) == (False, message)
    test.set_validity(False, message)
    assert json.loads(test.to_json())["validation_message"] == message
    with pytest.raises((RoadError, TypeError, ValueError, OverflowError)):
        test.get_road_length()


@given(st.lists(st.tuples(*[st.floats(1.0, 220.0)] * 2), min_size=2, max_size=8))
def test_the_validator_agrees_with_the_bench(points: list[tuple[float, float]]) -> None:
    verdict = check_validity(points)
    test = RoadTestFactory.create_road_test(points)
    assert TestValidator(200).validate_test(test) == (verdict.valid, verdict.message)


def test_what_is_no_test_has_the_wrong_type() -> None:
    for odd in (None, BEND, "road"):
        assert TestValidator(200).validate_test(odd) == (False, "Wrong type")


@pytest.mark.parametrize("radius", [15.0, 200.0, math.inf])
def test_the_radius_is_in_feet(radius: float) -> None:
    along = np.linspace(0.0, 1.0, 50)
    circle = min(radius, 1e6) * np.column_stack([np.cos(along), np.sin(along)])
    points = circle if radius < math.inf else np.column_stack([along, along])
    nodes = [(x, y, -28.0, 8.0) for x, y in points.tolist()]
    assert min_radius(nodes) == pytest.approx(radius * 3.280839895)


class Polygon:
    """A road as the pipeline has it."""

    def __init__(self, *middle: tuple[float, float]) -> None:
        self.road_points = self
        points = interpolate(middle) if len(set(middle)) > 1 else np.array(middle)
        steps = np.gradient(points, axis=0)
        across = 4.0 * np.column_stack([-steps[:, 1], steps[:, 0]])
        across /= np.maximum(np.hypot(*steps.T), 1e-9)[:, None]
        self.left, self.right = (points + across).tolist(), (points - across).tolist()


def test_overlaps_are_seen_as_the_pipeline_sees_them() -> None:
    assert overlaps_not(Polygon(*BEND))
    cross = [(20.0, 20.0), (100.0, 100.0), (100.0, 20.0), (20.0, 100.0)]
    assert not overlaps_not(Polygon(*cross))
    assert not overlaps_not(Polygon((5.0, 5.0), (5.0, 5.0)))
