"""Geometry of roads, against numerical integration and brute force."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid, solve_ivp

from frenetic.errors import RoadError
from frenetic.road import Pose, Road
from frenetic.search.operators import random_curvatures

FloatArray = npt.NDArray[np.float64]


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a pose up to 200 m from the origin in x and in y."""
    x, y = rng.uniform(-200.0, 200.0, 2)
    return Pose(float(x), float(y), float(rng.uniform(-10.0, 10.0)))


def beside(road: Road, s: float, d: float) -> tuple[float, float]:
    """Return the point ``d`` m left of the centre line at ``s``."""
    x, y, heading = road.pose_at(s)
    return x - d * math.sin(heading), y + d * math.cos(heading)


def nearest(road: Road, positions: npt.ArrayLike) -> FloatArray:
    """Return the nearest place of the whole road to each of (n, 2) positions."""
    return np.concatenate([road.track([position]) for position in np.asarray(positions)])


def reference_points(curvatures: FloatArray, step: float) -> FloatArray:
    """Integrate the samples' positions by a Runge-Kutta method of order 8, piece by piece."""
    points = [(0.0, 0.0)]
    heading = math.pi / 2
    for k0, k1 in pairwise(curvatures):

        def tangent(
            s: float, _: FloatArray, h: float = heading, k0: float = k0, k1: float = k1
        ) -> tuple[float, float]:
            angle = h + k0 * s + (k1 - k0) / (2.0 * step) * s * s
            return math.cos(angle), math.sin(angle)

        solution = solve_ivp(
            tangent, (0.0, step), points[-1], method="DOP853", rtol=1e-13, atol=1e-13
        )
        points.append((float(solution.y[0, -1]), float(solution.y[1, -1])))
        heading += 0.5 * step * (k0 + k1)
    return np.array(points)


def hairpin(apart: float = 9.0, leg: float = 60.0) -> Road:
    """Return a road with a leg, a left turn of 180 degrees and a leg back, ``apart`` m away."""
    turn = np.concatenate([[0.0], np.full(8, math.pi / 8.0), [0.0]])
    step = apart / -float(Road(turn, 1.0).points[-1, 0])
    straight = np.zeros(math.ceil(leg / step))
    return Road(np.concatenate([straight, turn[1:-1] / step, straight]), step)


def gentle_road(rng: np.random.Generator) -> Road:
    """Return a road whose heading stays within 45 degrees of its mean.

    Its normals meet no closer than its smallest radius: every nearer point has a single foot on the
    road and its straight extensions.
    """
    curvatures = random_curvatures(rng, int(rng.integers(15, 31))) * rng.uniform(0.2, 1.0)
    step = float(rng.choice([2.0, 5.0, 10.0]))
    fine = np.linspace(0.0, len(curvatures) - 1.0, 100 * (len(curvatures) - 1) + 1)
    kappa = np.interp(fine, np.arange(len(curvatures)), curvatures)
    heading = cumulative_trapezoid(kappa, fine * step, initial=0)
    curvatures *= min(1.0, (0.49 * math.pi) / np.ptp(heading))
    return Road(curvatures, step, random_pose(rng))


@pytest.mark.parametrize(
    ("step", "curvatures"),
    [
        (2.0, random_curvatures(np.random.default_rng(0), 150)),
        (25.0, random_curvatures(np.random.default_rng(2), 12)),
        (10.0, np.tile([0.07, -0.07, -0.07], 10)),
        (150.0, np.array([0.0, 0.07, -0.07])),
        (1.0, np.array([3.0, -3.0, 3.0, 8.0, 0.0])),
        (10.0, np.array([10.0, -10.0, 10.0])),
    ],
    ids=["fine", "coarse", "sharp", "two-pieces", "wriggle", "sharpest"],
)
def test_positions_and_headings_agree_with_integration_and_sub_steps_are_short(
    step: float, curvatures: FloatArray
) -> None:
    road = Road(curvatures, step)
    np.testing.assert_allclose(road.points, reference_points(curvatures, step), rtol=0, atol=1e-8)
    expected = math.pi / 2 + cumulative_trapezoid(curvatures, dx=step, initial=0)
    np.testing.assert_allclose(road.headings, expected, rtol=0, atol=1e-11)
    assert road.length == step * (len(curvatures) - 1)
    assert road.sub_step <= 1.0 + 1e-6
    assert road.sub_step * np.abs(curvatures).max() <= 0.5 + 1e-6
    assert len(road.table) == round(step / road.sub_step) * (len(curvatures) - 1) + 1


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_mirrored_or_reversed_road_has_the_same_shape(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curvatures, pose = random_curvatures(rng, 22), random_pose(rng)
    road, moved = Road(curvatures), Road(curvatures, pose=pose)
    angle = pose.heading - math.pi / 2
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    np.testing.assert_allclose(moved.points, road.points @ turn + pose[:2], rtol=0, atol=1e-9)
    mirrored = Road(-curvatures)
    np.testing.assert_allclose(mirrored.points, road.points * [-1.0, 1.0], rtol=0, atol=1e-9)
    end = road.pose_at(road.length)
    reversed_road = Road(-curvatures[::-1], pose=(end.x, end.y, end.heading + math.pi))
    np.testing.assert_allclose(reversed_road.points[::-1], road.points, rtol=0, atol=1e-8)


# Places along a road


@pytest.mark.parametrize(("step", "seed"), [(10.0, 0), (25.0, 2), (0.7, 3)])
def test_pose_and_curvature_between_samples_agree_with_a_cut_road(step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = Road(random_curvatures(rng, 25), step, random_pose(rng))
    for distance in [road.length, *rng.uniform(0.0, road.length, 20)]:
        # The piece of the road that ends at `distance`.
        i = min(int(distance / step), len(road.curvatures) - 2)
        rest = distance - i * step
        start = Pose(float(road.points[i, 0]), float(road.points[i, 1]), float(road.headings[i]))
        kappa = float(np.interp(distance / step, range(25), road.curvatures))
        assert road.curvature_at(distance) == pytest.approx(kappa, abs=1e-12)
        cut = Road([road.curvatures[i], kappa], rest, start)
        expected = (*cut.points[1].tolist(), float(cut.headings[1]))
        assert road.pose_at(distance) == pytest.approx(expected, abs=1e-9)


def test_beyond_its_ends_a_road_goes_straight_on() -> None:
    road = Road([0.01, 0.02, -0.01, 0.01, 0.005], pose=Pose(5.0, 6.0, 1.0))
    for s, beyond in ((0.0, -7.5), (road.length, 7.5)):
        end = road.pose_at(s)
        x, y = end.x + beyond * math.cos(end.heading), end.y + beyond * math.sin(end.heading)
        assert road.pose_at(s + beyond) == pytest.approx((x, y, end.heading), abs=1e-9)
        for d in (-3.0, 0.0, 3.0):
            place = nearest(road, [beside(road, s + beyond, d)])[0]
            assert place == pytest.approx([s + beyond, d], abs=1e-9)
    curvatures = road.curvature_at([[-0.1, 0.0], [road.length, road.length + 0.1]])
    assert curvatures.tolist() == [[0.0, road.curvatures[0]], [road.curvatures[-1], 0.0]]


def test_distances_are_even_and_at_most_the_spacing_apart() -> None:
    rng = np.random.default_rng(2)
    for spacing in [1000.0, 2.0, *rng.uniform(0.1, 30.0, 200).tolist()]:
        road = Road(np.zeros(rng.integers(2, 40)), float(rng.choice([10.0, rng.uniform(0.3, 20)])))
        distances = road.distances(spacing)
        assert np.array_equal(distances, np.linspace(0.0, road.length, len(distances)))
        assert distances[1] <= spacing * (1.0 + 1e-9)
        assert len(distances) == 2 or road.length / (len(distances) - 2) > spacing


def test_sampled_points_lie_beside_the_centre_line_at_the_offset() -> None:
    rng = np.random.default_rng(7)
    for offset, spacing in ((-8.0, 0.5), (0.0, 2.0), (3.3, 3.7)):
        road = Road(random_curvatures(rng, 20))
        expected = [beside(road, s, offset) for s in road.distances(spacing)]
        np.testing.assert_allclose(road.sample(spacing, offset), expected, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(road.road_points, road.sample(2.0))


# Projection


@given(st.integers(0, 2**32 - 1), st.floats(-0.2, 1.2), st.floats(-0.85, 0.85))
@settings(max_examples=100)
def test_projecting_a_point_beside_a_road_restores_its_place(
    seed: int, place: float, share: float
) -> None:
    road = gentle_road(np.random.default_rng(seed))
    s = place * road.length
    d = min(share / float(np.abs(road.curvatures).max()), 200.0)
    ((foot, offset),) = nearest(road, [beside(road, s, d)])
    assert foot == pytest.approx(s, abs=1e-5)
    assert offset == pytest.approx(d, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_projection_finds_the_nearest_point_of_the_whole_road(seed: int) -> None:
    """The reference is the nearest of the road's points 2 cm apart; roads may cross themselves."""
    rng = np.random.default_rng(seed)
    road = Road(random_curvatures(rng, 25))
    dense = road.sample(0.02)
    positions = rng.uniform(dense.min(axis=0) - 10.0, dense.max(axis=0) + 10.0, (300, 2))
    between = np.hypot(*(positions[:, None] - dense[None]).transpose(2, 0, 1))
    closest = between.argmin(axis=1)
    # Near the straight extensions of the ends, the foot is no point of the road.
    inside = (closest > 0) & (closest < len(dense) - 1)
    places = nearest(road, positions[inside])
    expected = between.min(axis=1)[inside]
    # Rows 1 m apart decide between two pieces that are almost equally far away.
    slack = np.hypot(expected, 0.5) - expected
    assert np.all(np.abs(places[:, 1]) >= expected - 1e-3)
    assert np.all(np.abs(places[:, 1]) <= expected + slack + 1e-3)
    feet = [beside(road, s, d) for s, d in places]
    np.testing.assert_allclose(feet, positions[inside], rtol=0, atol=1e-5)
    assert road.track(np.empty((0, 2))).shape == (0, 2)


def test_a_path_stays_on_its_leg_of_a_hairpin() -> None:
    road = hairpin(apart=9.0, leg=60.0)
    # The path drifts to the left until the other leg, 9 m away, is nearer; then the car stands.
    y = np.minimum(np.arange(0.0, 60.0), 50.0)
    x = -np.minimum(6.0, 0.2 * y)
    path = np.column_stack([x, y])
    np.testing.assert_allclose(road.track(path), np.column_stack([y, -x]), rtol=0, atol=1e-6)
    places = nearest(road, path)
    beyond = x < -4.6
    # The leg of the path lies left of the leg back.
    expected = np.column_stack([road.length - y, 9.0 + x])
    np.testing.assert_allclose(places[beyond], expected[beyond], rtol=0, atol=1e-6)


@pytest.mark.parametrize("offset", [-6.0, 0.0, 4.0])
def test_a_path_along_a_tight_road_is_tracked_at_car_speeds(offset: float) -> None:
    road = Road([0.0, 0.05, 0.07, 0.07, 0.02, -0.03, -0.07, -0.07, 0.0])
    # 1.7 m of centre line between positions: 34 m/s, seen at 20 Hz.
    distances = np.linspace(-3.0, road.length + 3.0, 51)
    followed = road.track([beside(road, s, offset) for s in distances])
    np.testing.assert_allclose(followed[:, 0], distances, rtol=0, atol=1e-6)
    np.testing.assert_allclose(followed[:, 1], offset, rtol=0, atol=1e-6)


# The map, and roads as values


def test_a_fitted_road_lies_in_the_map_with_its_curvatures() -> None:
    rng = np.random.default_rng(0)
    # Roads of small curvatures are long, and fit only when turned.
    for scale in (0.2, 1.0, 0.2, 1.0):
        values = random_curvatures(rng, 22) * scale
        road = Road(values, 10.0, random_pose(rng), lane_width=5.0)
        fitted = road.fitted()
        assert fitted is not None
        np.testing.assert_array_equal(fitted.curvatures, road.curvatures)
        assert (fitted.step, fitted.lane_width) == (road.step, 5.0)
        assert fitted.road_points.min() >= 10.0 - 1e-6
        assert fitted.road_points.max() <= 190.0 + 1e-6
        assert fitted.fitted(map_margin=9.9) is fitted
    longer = Road([0.0, 0.0, 0.0], 128.0)
    assert longer.fitted() is None
    assert longer.fitted(300.0) is not None
    assert longer.fitted(map_margin=5.0) is not None


def test_a_road_is_read_only_and_turns_numbers_into_floats() -> None:
    values = np.array([0, 1, 0])
    road = Road(values, 2, (1, 2, 3))
    values[0] = 1
    assert road.curvatures.dtype == np.float64
    assert road.curvatures.tolist() == [0.0, 1.0, 0.0]
    assert (repr(road.step), road.pose) == ("2.0", Pose(1.0, 2.0, 3.0))
    for array in (road.curvatures, road.points, road.headings, road.road_points, road.table):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        road.step = 2.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ([0.0, math.nan, 0.0], {}, "curvature 1 is nan 1/m: every curvature must be a finite"),
        ([0.0, 0.0, -math.inf], {}, "curvature 2 is -inf 1/m"),
        ([0.0, 10.5], {}, "curvature 1 is 10.5 1/m: .* at most 10 in either direction"),
        ([0.1], {}, "a road of 1 curvature samples: 2 to 10000 are allowed"),
        (np.zeros(1_000_000), {}, "a road of 1000000 curvature samples: 2 to 10000 are allowed"),
        (np.zeros((3, 2)), {}, r"curvatures have shape \(3, 2\): a flat list \(N,\) is needed"),
        (["left", "right"], {}, "curvatures are not a list of numbers"),
        ([0.1, 10**400], {}, "curvatures are not a list of numbers"),
        (np.zeros(5002), {}, "a road of 50010 m: at most 50000 m can be represented"),
        ([0, 0], {"step": 0.0}, "step is 0: 1e-07 to 50000 m are allowed"),
        ([0, 0], {"step": math.inf}, "step is inf: 1e-07"),
        ([0, 0], {"step": "far"}, "step is 'far': 1e-07"),
        ([0, 0], {"lane_width": math.nan}, "lane_width is nan: 0.1 to 100 m are allowed"),
        ([0, 0], {"lane_width": 0.09}, "lane_width is 0.09: 0.1 to 100"),
        ([0, 0], {"lane_width": 10**400}, "lane_width is 10{39}: 0.1 to 100"),
        ([0, 0], {"pose": (0.0, math.nan, 0.0)}, r"pose \(0, nan, 0\): x and y of at most 1e\+07"),
        ([0, 0], {"pose": (0.0, 2e7, 0.0)}, r"pose \(0, 2e\+07, 0\): x and y"),
        ([0, 0], {"pose": (0.0, 0.0, 2e6)}, r"\(0, 0, 2e\+06\): .* heading of at most 1e\+06 rad"),
        ([0, 0], {"pose": (0.0, 0.0)}, r"pose \(0.0, 0.0\): x, y and heading are needed"),
    ],
)
def test_bad_values_are_refused_by_name(values: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(RoadError, match=message):
        Road(values, **options)
    assert Road(np.zeros(5001), 10.0).length == 50_000.0


def test_sampled_points_lie_at_the_offset_to_the_left() -> None:
    points = Road([0.0, 0.0], pose=(0.0, 0.0, 0.0)).sample(10.0, 3.0)
    assert points == pytest.approx(np.array([[0.0, 3.0], [10.0, 3.0]]))


def test_a_road_that_bends_fast_says_so() -> None:
    usual, fast = Road([0.05, 0.0, -0.05], 10.0), Road([0.0, 0.03, -0.06, 0.0], 10.0)
    assert usual.largest_change == pytest.approx(0.05)
    assert "bends fast" not in usual.as_text()
    assert fast.largest_change == pytest.approx(0.09)
    assert "bends fast: by 0.09 1/m in 10 m (usually at most 0.05)" in fast.as_text()
    finer = Road(np.interp(np.arange(0.0, 31.0, 2.0), [0, 10, 20, 30], fast.curvatures), 2.0)
    assert finer.largest_change == pytest.approx(0.09)
