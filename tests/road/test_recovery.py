from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline, splprep
from scipy.spatial import cKDTree

from frenetic.errors import RoadError
from frenetic.road import Pose, Road

FloatArray = npt.NDArray[np.float64]


def random_road(rng: np.random.Generator) -> Road:
    """A road of the random phase (a walk within 0.07 and steps of 0.05 1/m) in any pose."""
    values: list[float] = [0.0]
    for _ in range(int(rng.integers(15, 26))):
        low, high = max(values[-1] - 0.05, -0.07), min(values[-1] + 0.05, 0.07)
        values.append(float(rng.uniform(low, high)))
    x, y = rng.uniform(-200.0, 200.0, 2)
    return Road(np.array(values[1:]), pose=Pose(float(x), float(y), float(rng.uniform(-7.0, 7.0))))


def competition_spline(points: FloatArray) -> BSpline[np.float64]:
    tck: Any
    tck, _ = splprep(points.T, s=0, k=min(len(points) - 1, 3))
    knots, coefficients, degree = tck
    return BSpline(knots, np.column_stack(coefficients), degree)


def spline_through(points: FloatArray) -> tuple[FloatArray, float]:
    """Dense points (about 2 mm apart) of the competition's spline, and its length."""
    polyline = float(np.hypot(*np.diff(points, axis=0).T).sum())
    dense = competition_spline(points)(np.linspace(0.0, 1.0, max(1000, int(polyline / 2e-3))))
    return dense, float(np.hypot(*np.diff(dense, axis=0).T).sum())


def assert_follows_the_spline(points: FloatArray, tolerance: float = 5e-3) -> Road:
    """Both lines lie within the tolerance (m) of each other, and are equally long."""
    road = Road.from_points(points)
    dense, length = spline_through(points)
    line = road.sample(0.05)
    to_spline = np.asarray(cKDTree(dense).query(line)[0])
    assert to_spline.max() < tolerance
    # The other way round: nothing of the spline is left out.
    finer = road.sample(2e-3)
    to_road = np.asarray(cKDTree(finer).query(dense[:: max(1, len(dense) // 5000)])[0])
    assert to_road.max() < tolerance + 2e-3
    assert road.length == pytest.approx(length, abs=tolerance)
    np.testing.assert_allclose(line[0], points[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(line[-1], points[-1], rtol=0, atol=tolerance)
    return road


def assert_same_road(found: Road, road: Road) -> None:
    """Curvature, length and place agree to a micrometre or 1e-6 1/m, also between the samples."""
    assert found.length == pytest.approx(road.length, abs=1e-6)
    # Rounding may put the found road's end before the road's.
    distances = np.linspace(0.0, min(road.length, found.length), 500)
    np.testing.assert_allclose(
        found.curvature_at(distances), road.curvature_at(distances), rtol=0, atol=1e-6
    )
    # An end's curvature is what its points say least about.
    ends = [found.curvatures[0], found.curvatures[-1]]
    assert ends == pytest.approx([road.curvatures[0], road.curvatures[-1]], abs=1e-6)
    np.testing.assert_allclose(found.road_points, road.road_points, rtol=0, atol=1e-6)


# --- Points of a road ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(25))
def test_a_road_is_recovered_from_its_samples(seed: int) -> None:
    road = random_road(np.random.default_rng(seed))
    found = Road.from_points(road.points)
    assert found.step == pytest.approx(10.0, abs=1e-7)
    assert_same_road(found, road)


@pytest.mark.parametrize("seed", range(25))
def test_a_road_is_recovered_from_the_points_in_which_it_leaves_our_hands(seed: int) -> None:
    road = random_road(np.random.default_rng(1000 + seed))
    found = Road.from_points(road.road_points)
    assert found.step == pytest.approx(2.0, abs=1e-7)
    assert_same_road(found, road)


@pytest.mark.parametrize("kappa", [0.0, 0.07, -0.07, 0.01, 1e-4])
@pytest.mark.parametrize("spacing", [1.0, 2.0, 10.0])
def test_points_of_a_circle_or_a_line_give_its_constant_curvature(
    kappa: float, spacing: float
) -> None:
    arc = np.arange(0.0, 80.0 + 1e-9, spacing)
    if kappa:
        points = np.column_stack([np.sin(kappa * arc), 1.0 - np.cos(kappa * arc)]) / kappa
    else:
        points = np.column_stack([arc, 0.0 * arc])
    road = Road.from_points(points)
    assert road.length == pytest.approx(80.0, abs=1e-6)
    np.testing.assert_allclose(road.curvatures, kappa, rtol=0, atol=1e-6)
    assert road.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_a_point_list_driven_the_other_way_gives_the_reversed_and_negated_curvatures() -> None:
    road = random_road(np.random.default_rng(5))
    found = Road.from_points(road.points[::-1])
    np.testing.assert_allclose(found.curvatures, -road.curvatures[::-1], rtol=0, atol=1e-6)


# --- Any other points ----------------------------------------------------------------------------


@pytest.mark.parametrize("decimals", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_rounded_points_are_joined_by_the_spline(seed: int, decimals: int) -> None:
    road = random_road(np.random.default_rng(seed))
    assert_follows_the_spline(np.round(road.points, decimals))


@pytest.mark.parametrize("seed", range(8))
def test_unevenly_spaced_points_are_joined_by_the_spline(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = random_road(rng)
    places = np.cumsum(rng.uniform(3.0, 25.0, 12))
    places = places[places < road.length]
    poses = np.array([road.pose_at(float(s)) for s in places])
    assert_follows_the_spline(poses[:, :2])


@pytest.mark.parametrize("seed", range(8))
def test_competition_points_are_joined_by_the_spline(seed: int) -> None:
    """A handful of points far apart, as the competition's generators propose them."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(rng.uniform(-0.9, 0.9, 8))
    steps = rng.uniform(15.0, 40.0, 8)
    points = np.cumsum(steps[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    assert_follows_the_spline(points)


@pytest.mark.parametrize(
    "points",
    [
        [(10.0, 20.0), (150.0, 90.0)],
        [(0.0, 0.0), (0.0, 0.5)],
        [(10.0, 20.0), (80.0, 30.0), (100.0, 100.0)],
        [(0.0, 0.0), (30.0, 0.0), (40.0, 1.0)],
        [(10.0, 20.0), (30.0, 20.0), (40.0, 30.0), (60.0, 80.0)],
        [(10.0, 20.0), (30.0, 20.0), (40.0, 30.0), (60.0, 80.0), (90.0, 80.0)],
    ],
    ids=["line", "short", "parabola", "uneven-parabola", "cubic", "two-pieces"],
)
def test_few_points_are_joined_by_a_spline_of_lower_degree(
    points: list[tuple[float, float]],
) -> None:
    road = assert_follows_the_spline(np.array(points))
    if len(points) == 2:
        np.testing.assert_allclose(road.curvatures, 0.0, rtol=0, atol=1e-12)


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 20),
    spread=st.floats(0.1, 0.8),
)
@settings(max_examples=15)
def test_no_bend_that_a_car_could_drive_leaves_the_spline(seed: int, n: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.uniform(-spread, spread, n))
    steps = rng.uniform(8.0, 30.0, n)
    points = np.cumsum(steps[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    dense, _ = spline_through(points)
    thin = dense[:: max(1, len(dense) // 2000)]
    tangents = np.unwrap(np.arctan2(*np.diff(thin, axis=0).T[::-1]))
    curvature = np.abs(np.diff(tangents)) / np.hypot(*np.diff(thin, axis=0)[1:].T)
    assume(curvature.max() < 0.2)
    assert_follows_the_spline(points)


def test_a_road_along_a_spline_has_the_splines_curvature() -> None:
    points = np.array([(0.0, 0.0), (40.0, 0.0), (70.0, 30.0), (70.0, 80.0), (100.0, 110.0)])
    spline = competition_spline(points)
    u = np.linspace(0.0, 1.0, 200_001)
    x, y = spline.derivative(1)(u).T
    a, b = spline.derivative(2)(u).T
    rate = np.hypot(x, y)
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(u))])
    road = Road.from_points(points)
    distances = np.linspace(0.0, road.length, 400)
    expected = np.interp(distances, arc, (x * b - y * a) / rate**3)
    np.testing.assert_allclose(road.curvature_at(distances), expected, rtol=0, atol=5e-4)


@pytest.mark.parametrize("seed", range(5))
def test_moved_and_turned_points_give_the_same_curvatures(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.round(random_road(rng).points, 2)
    angle = float(rng.uniform(-3.0, 3.0))
    c, s = math.cos(angle), math.sin(angle)
    here = Road.from_points(points)
    there = Road.from_points(points @ np.array([[c, s], [-s, c]]) + rng.uniform(-500.0, 500.0, 2))
    np.testing.assert_allclose(there.curvatures, here.curvatures, rtol=0, atol=1e-7)
    assert there.step == pytest.approx(here.step, abs=1e-9)


@pytest.mark.parametrize(
    "points",
    [
        [[0.0, 0.0], [1000.0, 0.0], [0.0, 0.0], [1e-14, 0.0], [0.0, 5.0]],
        [[0.0, 0.0], [1e-160, 0.0], [0.0, 5.0]],
    ],
)
def test_points_closer_than_a_spline_can_tell_apart_are_the_same(points: list[list[float]]) -> None:
    with pytest.raises(RoadError, match="are the same"):
        Road.from_points(points)


def test_points_beyond_any_map_are_refused() -> None:
    with pytest.raises(RoadError, match="at most 1e\\+07 m from the origin"):
        Road.from_points([[0.0, 0.0], [1e308, 0.0], [0.0, 5.0]])


def test_points_of_unequal_steps_are_not_searched_for_a_chain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The search takes a hundred times as long as the spline."""

    def search(*_: object) -> None:
        raise AssertionError("points of a spline were searched for a chain")

    nodes = Road(np.array([0.02, 0.05, -0.04, 0.06, 0.0, 0.03]), pose=Pose(50, 60, 1.0)).sample(9.0)
    spline = competition_spline(nodes)(np.linspace(0.0, 1.0, 60))
    monkeypatch.setattr("frenetic.road.recovery._gauss_newton", search)
    assert_follows_the_spline(spline)
