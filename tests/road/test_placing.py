"""Placing a road on the map, against a search over many angles."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from frenetic.errors import RoadError
from frenetic.road import LANE_WIDTH, Road
from frenetic.road.placing import RigidMotion, fit_to_map
from frenetic.road.road import placed_road

FloatArray = npt.NDArray[np.float64]

MAP, MAP_MARGIN = 200.0, 10.0
ROOM = MAP - 2 * MAP_MARGIN
STAY = RigidMotion(0.0, 0.0, 0.0)


def random_road(rng: np.random.Generator) -> FloatArray:
    """Return a road of 40 to 400 m with a point every 2 m."""
    n = int(rng.integers(20, 200))
    curvature = np.interp(np.arange(n), np.arange(0, n, 5), rng.uniform(-0.07, 0.07, -(-n // 5)))
    if rng.random() < 0.3:
        curvature *= 0.1  # long and narrow
    heading = rng.uniform(0, 7) + np.cumsum(2.0 * curvature)
    return np.cumsum(2.0 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)


def shape(rng: np.random.Generator) -> FloatArray:
    """Return points whose extent is difficult: flat, nearly a rectangle, round or random."""
    kind = rng.integers(4)
    line = rng.normal(0, 1, (int(rng.integers(3, 20)), 2))
    if kind == 0:
        line = np.outer(np.linspace(0, 1, int(rng.integers(2, 50))), [1.0, 0.0])
    elif kind == 1:
        line = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, rng.uniform(0, 1)], [0.0, 1e-3]])
    elif kind == 2:
        t = np.arange(rng.integers(3, 60)) * rng.uniform(0.1, 2.1)
        line = np.column_stack([np.cos(t), np.sin(t)])
    angle = rng.choice([0.0, math.pi / 4, rng.uniform(0, 7)])
    return turned(line * 100, angle) + rng.uniform(-1000, 1000, 2)


def turned(line: FloatArray, angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(line @ np.array([[c, s], [-s, c]]))


def smallest_of_many_squares(line: FloatArray, angles: int = 20_000) -> float:
    """Return the side of the smallest square around the road, over many angles."""
    theta = np.arange(angles)[:, None] * (math.pi / 2 / angles)
    c, s = np.cos(theta), np.sin(theta)
    x, y = line.T
    return float(np.maximum(np.ptp(c * x - s * y, axis=1), np.ptp(s * x + c * y, axis=1)).min())


def assert_within_margins(line: FloatArray) -> None:
    """Assert that no point is too close to the edge of the map."""
    assert line.min() >= MAP_MARGIN - 1e-9
    assert line.max() <= MAP - MAP_MARGIN + 1e-9


@pytest.mark.parametrize("make", [random_road, shape])
@pytest.mark.parametrize("seed", range(3))
def test_a_pose_is_found_if_and_only_if_one_exists(
    make: Callable[[np.random.Generator], FloatArray], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(12):
        line = make(rng)
        best = smallest_of_many_squares(line)
        # A sampled angle is within 4e-5 rad of the best one. The box grows by at most its diagonal
        # per rad: by 6e-5 of its side.
        just_fits = line * (ROOM / (best * (1 + 1e-6)))
        motion = fit_to_map(just_fits)
        assert motion is not None
        assert -math.pi / 4 < motion.rotation <= math.pi / 4
        moved = motion.apply(just_fits)
        assert_within_margins(moved)
        np.testing.assert_allclose(pdist(moved), pdist(just_fits), rtol=0, atol=1e-9)
        assert fit_to_map(line * (ROOM / (best * (1 - 1e-4)))) is None


def test_a_road_that_fits_stays_or_is_centred_before_it_is_turned() -> None:
    line = np.array([[10.0, 10.0], [190.0, 10.0], [190.0, 190.0], [100.0, 77.0]])
    assert fit_to_map(line) == STAY
    np.testing.assert_array_equal(STAY.apply(line), line)
    assert fit_to_map(line, map_margin=10.001) is None
    assert fit_to_map([[-5, 0], [15, 0], [15, 100]]) == RigidMotion(0.0, 95.0, 50.0)
    assert fit_to_map([[0.0, 0.0]]) == RigidMotion(0.0, 100.0, 100.0)


def test_a_narrow_rectangle_is_turned_by_45_degrees() -> None:
    # (a + b) / sqrt(2) is the box of an a x b rectangle at 45 degrees.
    a, b = 220.0, 30.0
    rectangle = np.array([[0, 0], [a, 0], [a, b], [0, b]])
    needed = (a + b) / math.sqrt(2)
    assert fit_to_map(rectangle, map_size=needed + 20.001) is not None
    assert fit_to_map(rectangle, map_size=needed + 19.999) is None
    assert fit_to_map(rectangle, map_margin=100.0) is None
    assert fit_to_map(rectangle.tolist()) == fit_to_map(np.asfortranarray(rectangle.astype(int)))


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ([], {}, "there are no points"),
        ([[1.0, 2.0, 3.0]], {}, "shape"),
        ("road", {}, "shape"),
        ([["1", "2"], ["3", "4"]], {}, "of type"),
        ([[0.0, 0.0], [1.0, math.inf]], {}, "road point 1 is"),
        ([[-1e308, 0.0], [1e308, 0.0]], {}, "longer than any"),
        ([[0.0, 0.0]], {"map_size": 0.0}, "map_size"),
        ([[0.0, 0.0]], {"map_size": math.inf}, "map_size"),
        ([[0.0, 0.0]], {"map_margin": -1.0}, "map_margin"),
        ([[0.0, 0.0]], {"map_margin": math.nan}, "map_margin"),
    ],
)
def test_invalid_points_and_options_are_refused(
    points: Any, options: dict[str, float], message: str
) -> None:
    with pytest.raises(RoadError, match=message):
        fit_to_map(points, **options)


coordinate = st.integers(-300, 300).map(float) | st.floats(-300, 300)


@given(st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=12))
@settings(max_examples=100)
def test_any_points_fit_or_are_too_large(points: list[tuple[float, float]]) -> None:
    line = np.array(points)
    motion = fit_to_map(line)
    if motion is None:
        assert smallest_of_many_squares(line, 200) > ROOM
    else:
        assert_within_margins(motion.apply(line))
        assert fit_to_map(motion.apply(line), map_margin=MAP_MARGIN - 1e-9) == STAY


def test_a_placed_road_is_the_road_of_its_values() -> None:
    for curvatures in (np.full(12, 0.03), np.zeros(12, np.int64), np.full(30, 0.0)):
        road, verdict = placed_road(curvatures, 10.0, LANE_WIDTH, MAP, MAP_MARGIN)
        expected, expected_verdict = Road(curvatures).placed(MAP, MAP_MARGIN)
        assert verdict == expected_verdict
        if road is None:
            assert expected is None
            continue
        assert expected is not None
        assert road.pose == expected.pose
        rebuilt = Road(curvatures, 10.0, road.pose)
        for name in ("curvatures", "table", "road_points", "stations"):
            values = getattr(road, name)
            np.testing.assert_array_equal(values, getattr(rebuilt, name))
            assert not values.flags.writeable


@pytest.mark.parametrize("curvatures", [np.zeros((2, 6)), np.zeros(1), np.full(12, np.nan)])
def test_values_that_are_no_road_are_not_placed(curvatures: FloatArray) -> None:
    placed_road(np.zeros(12), 10.0, LANE_WIDTH, MAP, MAP_MARGIN)  # the same bytes as a road
    with pytest.raises(RoadError, match="curvature"):
        placed_road(curvatures, 10.0, LANE_WIDTH, MAP, MAP_MARGIN)
