"""Roads from points: `Road.from_points` against circles, splines and sampled roads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import BSpline, splprep
from scipy.spatial import cKDTree

from frenetic.errors import RoadError
from frenetic.road import Pose, Road
from frenetic.search.operators import random_curvatures

FloatArray = npt.NDArray[np.float64]


def random_road(seed: int) -> Road:
    """Return a random road in a random pose."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-200.0, 200.0, 2)
    values = random_curvatures(rng, int(rng.integers(15, 26)))
    return Road(values, pose=Pose(float(x), float(y), float(rng.uniform(-7.0, 7.0))))


def competition_spline(points: FloatArray) -> BSpline[np.float64]:
    """Return the spline through the points, by scipy."""
    tck: Any
    tck, _ = splprep(points.T, s=0, k=min(len(points) - 1, 3))
    knots, coefficients, degree = tck
    return BSpline(knots, np.column_stack(coefficients), degree)


def assert_follows_the_spline(points: FloatArray, tolerance: float = 5e-3) -> Road:
    """Assert that road and spline agree in place and length, within a tolerance in m."""
    road = Road.from_points(points)
    polyline = float(np.hypot(*np.diff(points, axis=0).T).sum())
    dense = competition_spline(points)(np.linspace(0.0, 1.0, max(1000, int(polyline / 2e-3))))
    length = float(np.hypot(*np.diff(dense, axis=0).T).sum())
    line = road.sample(0.05)
    assert np.asarray(cKDTree(dense).query(line)[0]).max() < tolerance
    # Also the other way round: the road leaves out no part of the spline.
    thin = dense[:: max(1, len(dense) // 5000)]
    assert np.asarray(cKDTree(road.sample(2e-3)).query(thin)[0]).max() < tolerance + 2e-3
    assert road.length == pytest.approx(length, abs=tolerance)
    np.testing.assert_allclose(line[[0, -1]], points[[0, -1]], rtol=0, atol=tolerance)
    return road


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("step", [10.0, 2.0])
def test_a_road_is_recovered_from_its_samples(seed: int, step: float) -> None:
    """Length and place agree to 1e-6 m, curvatures to 1e-6 1/m, also between the samples."""
    road = random_road(seed)
    recovered = Road.from_points(road.sample(step))
    assert recovered.step == pytest.approx(step, abs=1e-7)
    assert recovered.length == pytest.approx(road.length, abs=1e-6)
    # Rounding may make the recovered road a little shorter.
    distances = np.linspace(0.0, min(road.length, recovered.length), 500)
    np.testing.assert_allclose(
        recovered.curvature_at(distances), road.curvature_at(distances), rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(recovered.road_points, road.road_points, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kappa", [0.0, 0.07, -0.07, 1e-4])
@pytest.mark.parametrize("spacing", [1.0, 10.0])
def test_points_of_a_circle_or_a_line_give_a_constant_curvature(
    kappa: float, spacing: float
) -> None:
    arc = np.arange(0.0, 80.0 + 1e-9, spacing)
    points = np.column_stack([arc, 0.0 * arc])
    if kappa:
        points = np.column_stack([np.sin(kappa * arc), 1.0 - np.cos(kappa * arc)]) / kappa
    road = Road.from_points(points)
    assert road.length == pytest.approx(80.0, abs=1e-6)
    np.testing.assert_allclose(road.curvatures, kappa, rtol=0, atol=1e-6)
    assert road.pose == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_other_points_are_joined_by_a_spline(seed: int) -> None:
    """The points are rounded, unevenly spaced, or few and far apart, as of a generator."""
    rng = np.random.default_rng(seed)
    road = random_road(seed)
    assert_follows_the_spline(np.round(road.points, 1 + seed))
    places = np.cumsum(rng.uniform(3.0, 25.0, 12))
    assert_follows_the_spline(
        np.array([road.pose_at(float(s))[:2] for s in places[places < road.length]])
    )
    heading = rng.uniform(-3.0, 3.0) + np.cumsum(rng.uniform(-0.9, 0.9, 8))
    steps = rng.uniform(15.0, 40.0, (8, 1))
    points = np.cumsum(steps * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    assert_follows_the_spline(points)


@pytest.mark.parametrize(
    "points",
    [
        [(10.0, 20.0), (150.0, 90.0)],
        [(0.0, 0.0), (0.0, 0.5)],
        [(0.0, 0.0), (30.0, 0.0), (40.0, 1.0)],
        [(10.0, 20.0), (30.0, 20.0), (40.0, 30.0), (60.0, 80.0)],
    ],
    ids=["line", "short", "parabola", "cubic"],
)
def test_few_points_are_joined_by_a_spline_of_lower_degree(
    points: list[tuple[float, float]],
) -> None:
    road = assert_follows_the_spline(np.array(points))
    if len(points) == 2:
        np.testing.assert_allclose(road.curvatures, 0.0, rtol=0, atol=1e-12)


def test_a_road_along_a_spline_has_its_curvature() -> None:
    points = np.array([(0.0, 0.0), (40.0, 0.0), (70.0, 30.0), (70.0, 80.0), (100.0, 110.0)])
    u = np.linspace(0.0, 1.0, 200_001)
    (x, y), (a, b) = (competition_spline(points).derivative(k)(u).T for k in (1, 2))
    rate = np.hypot(x, y)
    arc = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(u))])
    road = Road.from_points(points)
    distances = np.linspace(0.0, road.length, 400)
    expected = np.interp(distances, arc, (x * b - y * a) / rate**3)
    np.testing.assert_allclose(road.curvature_at(distances), expected, rtol=0, atol=5e-4)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0.0, 0.0], [1e3, 0.0], [0.0, 0.0], [1e-14, 0.0], [0.0, 5.0]], "2 and 3 are the same"),
        ([[0.0, 0.0], [1e-160, 0.0], [0.0, 5.0]], "0 and 1 are the same: consecutive points"),
        ([[0.0, 0.0], [1e308, 0.0], [0.0, 5.0]], "at most 1e\\+07 m from the origin"),
        ([[0.0, 0.0], [50_001.0, 0.0]], "a road of 50001 m: at most 50000 m"),
        ([[0.0, 0.0], [math.nan, 1.0]], r"point 1 is \(nan, 1\): finite numbers"),
        ([[0.0, math.inf], [1.0, 1.0]], r"point 0 is \(0, inf\): finite numbers"),
        ([], "a road of 0 points: 2 to 10000 are allowed"),
        ([[1.0, 2.0]], "a road of 1 points"),
        (np.zeros((1_000_000, 2)), "a road of 1000000 points"),
        (np.zeros((4, 3)), r"shape \(4, 3\)"),
        ([["a", "b"], ["c", "d"]], "must be numbers"),
        ([[0.0, 1.0], [2.0]], "must all be pairs"),
    ],
)
def test_bad_points_are_refused_by_name(points: Any, message: str) -> None:
    with pytest.raises(RoadError, match=message):
        Road.from_points(points)
