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
from scipy.special import fresnel

from frenetic.errors import RoadError
from frenetic.road import Pose, Road, geometry, integrate

FloatArray = npt.NDArray[np.float64]

SHARPEST = 0.07
"""1/m, a little more than a valid road's sharpest curve."""


def random_curvatures(rng: np.random.Generator, n: int | None = None) -> FloatArray:
    """A random walk within the curvatures of valid roads: values at most 0.05 1/m apart."""
    values: list[float] = [0.0]
    for _ in range(n or int(rng.integers(15, 31))):
        low, high = max(values[-1] - 0.05, -SHARPEST), min(values[-1] + 0.05, SHARPEST)
        values.append(float(rng.uniform(low, high)))
    return np.array(values[1:])


def random_pose(rng: np.random.Generator) -> Pose:
    """A pose up to 200 m from the origin."""
    x, y = rng.uniform(-200.0, 200.0, 2)
    return Pose(float(x), float(y), float(rng.uniform(-10.0, 10.0)))


def road_of(curvatures: list[float], step: float = 10.0, **options: Any) -> Road:
    return Road(np.array(curvatures), step, **options)


def moved(points: FloatArray, pose: Pose) -> FloatArray:
    """Points of a road at the origin, heading along +y, as they lie when it starts at ``pose``."""
    angle = pose.heading - math.pi / 2
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + [pose.x, pose.y])


def reference_points(curvatures: FloatArray, step: float) -> FloatArray:
    """The samples' positions by an adaptive Runge-Kutta method of order 8, piece by piece."""
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
    """A straight leg, a turn to the left by 180 degrees, and a leg back, ``apart`` m away."""
    turn = 8
    kappa = math.pi / turn
    curvatures = np.concatenate([[0.0], np.full(turn, kappa), [0.0]])
    width = -integrate(curvatures, 1.0)[1][-1, 0]
    step = apart / width
    straight = np.zeros(math.ceil(leg / step))
    return Road(np.concatenate([straight, curvatures[1:-1] / step, straight]), step)


def gentle_road(rng: np.random.Generator) -> Road:
    """A road whose heading stays within 45 degrees of its mean.

    No two of its tangents' normals meet closer than the smallest radius: every point nearer than
    that has one foot on the road and its straight extensions.
    """
    curvatures = random_curvatures(rng) * rng.uniform(0.2, 1.0)
    step = float(rng.choice([2.0, 5.0, 10.0]))
    fine = np.linspace(0.0, len(curvatures) - 1.0, 100 * (len(curvatures) - 1) + 1)
    kappa = np.interp(fine, np.arange(len(curvatures)), curvatures)
    heading = cumulative_trapezoid(kappa, fine * step, initial=0)
    curvatures *= min(1.0, (0.49 * math.pi) / np.ptp(heading))
    return Road(curvatures, step, random_pose(rng))


# --- Integration ---------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [2.0, 10.0, 25.0])
@pytest.mark.parametrize("seed", range(4))
def test_positions_agree_with_a_reference_to_a_micrometre(seed: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    curvatures = random_curvatures(rng, int(300.0 / step) + 1)
    if seed == 0:
        curvatures[:] = SHARPEST * np.sign(np.sin(np.arange(len(curvatures)) + 0.5))
    _, points = integrate(curvatures, step)
    np.testing.assert_allclose(points, reference_points(curvatures, step), rtol=0, atol=1e-8)
    np.testing.assert_array_equal(Road(curvatures, step).points, points)


@pytest.mark.parametrize(
    ("step", "curvatures"),
    [
        (50.0, [0.07, -0.07, 0.07, 0.07, -0.02, 0.0, 0.05]),
        (150.0, [0.0, 0.07, -0.07]),
        (1.0, [3.0, -3.0, 3.0, 8.0, 0.0]),
        (10.0, [10.0, -10.0, 10.0]),
    ],
    ids=["spirals", "two-pieces", "wriggle", "sharpest"],
)
def test_large_steps_and_sharp_curves_are_no_less_accurate(
    step: float, curvatures: list[float]
) -> None:
    values = np.array(curvatures)
    _, points = integrate(values, step)
    np.testing.assert_allclose(points, reference_points(values, step), rtol=0, atol=1e-8)


def test_a_piece_with_linear_curvature_is_a_clothoid() -> None:
    """x(s) and y(s) of the clothoid kappa = rate s are Fresnel integrals."""
    rate, step = 0.07 / 100.0, 5.0
    s = np.arange(0.0, 101.0, step)
    unit = math.sqrt(math.pi / rate)
    sine, cosine = fresnel(s / unit)
    _, points = integrate(rate * s, step)
    expected = np.column_stack([-unit * sine, unit * cosine])
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-9)


def test_a_straight_road_goes_straight_up() -> None:
    headings, points = integrate(np.zeros(31))
    np.testing.assert_array_equal(headings, np.full(31, math.pi / 2))
    np.testing.assert_allclose(
        points, np.column_stack([np.zeros(31), 10.0 * np.arange(31)]), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("kappa", [0.07, -0.07, 0.001, -0.02])
def test_constant_curvature_is_a_circle(kappa: float) -> None:
    _, points = integrate(np.full(31, kappa))
    turned = kappa * 10.0 * np.arange(31)
    expected = np.column_stack([np.cos(turned) - 1.0, np.sin(turned)]) / kappa
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("step", [1.0, 10.0, 25.0])
def test_headings_are_the_exact_integral_of_the_curvature(step: float) -> None:
    curvatures = random_curvatures(np.random.default_rng(1), 40)
    headings, _ = integrate(curvatures, step)
    expected = math.pi / 2 + cumulative_trapezoid(curvatures, dx=step, initial=0)
    np.testing.assert_allclose(headings, expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(Road(curvatures, step).headings, headings)


@pytest.mark.parametrize("n", [2, 3, 30, 101])
def test_n_samples_give_n_points_from_the_origin_upwards(n: int) -> None:
    road = Road(random_curvatures(np.random.default_rng(n), n))
    assert road.points.shape == (n, 2)
    assert road.headings.shape == (n,)
    assert road.length == 10.0 * (n - 1)
    np.testing.assert_array_equal(road.points[0], [0.0, 0.0])
    assert road.headings[0] == math.pi / 2


def test_a_batch_gives_every_road_bit_for_bit() -> None:
    rng = np.random.default_rng(2)
    batch = np.stack([random_curvatures(rng, 25) * scale for scale in (1.0, 0.01, 0.5, 12.0)])
    pose = (3.0, -4.0, 0.5)
    headings, points = integrate(batch, 7.0, pose)
    assert headings.shape == (4, 25)
    assert points.shape == (4, 25, 2)
    for k, curvatures in enumerate(batch):
        one_headings, one_points = integrate(curvatures, 7.0, pose)
        np.testing.assert_array_equal(headings[k], one_headings)
        np.testing.assert_array_equal(points[k], one_points)
        np.testing.assert_array_equal(Road(curvatures, 7.0, Pose(*pose)).points, one_points)
    nested, _ = integrate(batch.reshape(2, 2, 25), 7.0, pose)
    np.testing.assert_array_equal(nested.reshape(4, 25), headings)


# --- What leaves a road the same road ------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_a_moved_and_turned_road_has_the_same_shape(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curvatures = random_curvatures(rng)
    pose = random_pose(rng)
    here, there = Road(curvatures), Road(curvatures, pose=pose)
    assert there.pose == pose
    np.testing.assert_allclose(there.points, moved(here.points, pose), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        there.ego_lane.centre, moved(here.ego_lane.centre, pose), rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        there.headings - here.headings, pose.heading - math.pi / 2, rtol=0, atol=1e-9
    )
    positions = here.points + rng.uniform(-6.0, 6.0, here.points.shape)
    np.testing.assert_allclose(
        there.project(moved(positions, pose)), here.project(positions), rtol=0, atol=1e-6
    )


@pytest.mark.parametrize("seed", range(5))
def test_reversed_and_negated_curvatures_are_the_road_driven_from_its_other_end(
    seed: int,
) -> None:
    road = Road(random_curvatures(np.random.default_rng(seed)))
    end = road.pose_at(road.length)
    back = Road(-road.curvatures[::-1], pose=Pose(end.x, end.y, end.heading + math.pi))
    np.testing.assert_allclose(back.points[::-1], road.points, rtol=0, atol=1e-8)
    np.testing.assert_allclose(back.ego_lane.centre[::-1], road.other_lane.centre, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_negated_curvatures_are_the_mirrored_road(seed: int) -> None:
    curvatures = random_curvatures(np.random.default_rng(seed))
    np.testing.assert_allclose(
        Road(-curvatures).points, Road(curvatures).points * [-1.0, 1.0], rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("parts", [2, 3, 10])
def test_a_finer_sampling_of_the_same_curvature_is_the_same_road(parts: int) -> None:
    curvatures = random_curvatures(np.random.default_rng(3))
    n = len(curvatures)
    fine = np.interp(np.linspace(0.0, n - 1.0, parts * (n - 1) + 1), np.arange(n), curvatures)
    coarse_road, fine_road = Road(curvatures), Road(fine, 10.0 / parts)
    assert fine_road.length == pytest.approx(coarse_road.length, abs=1e-9)
    np.testing.assert_allclose(fine_road.points[::parts], coarse_road.points, rtol=0, atol=1e-9)


# --- Places along a road -------------------------------------------------------------------------


@pytest.mark.parametrize(("step", "seed"), [(10.0, 0), (3.0, 1), (25.0, 2), (0.7, 3)])
def test_pose_and_curvature_anywhere_agree_with_a_road_sampled_there(
    step: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    road = Road(random_curvatures(rng, 25), step, random_pose(rng))
    for distance in [road.length, *rng.uniform(0.0, road.length, 20)]:
        # The same road cut off at `distance`: whole pieces, then the start of one.
        i = min(int(distance / step), len(road.curvatures) - 2)
        rest = distance - i * step
        start = Pose(float(road.points[i, 0]), float(road.points[i, 1]), float(road.headings[i]))
        kappa = float(np.interp(distance / step, range(25), road.curvatures))
        pose = road.pose_at(distance)
        assert road.curvature_at(distance) == pytest.approx(kappa, abs=1e-12)
        headings, points = integrate([road.curvatures[i], kappa], rest, start)
        expected = (float(points[1, 0]), float(points[1, 1]), float(headings[1]))
        assert pose == pytest.approx(expected, abs=1e-9)


def test_beyond_its_ends_a_road_goes_straight_on() -> None:
    road = Road(random_curvatures(np.random.default_rng(4)) + 0.01, pose=Pose(5.0, 6.0, 1.0))
    first, last = road.pose, road.pose_at(road.length)
    for end, sign, distance in ((first, -1.0, -7.5), (last, 1.0, road.length + 7.5)):
        x = end.x + sign * 7.5 * math.cos(end.heading)
        y = end.y + sign * 7.5 * math.sin(end.heading)
        assert road.pose_at(distance) == pytest.approx((x, y, end.heading), abs=1e-9)
        assert road.curvature_at(distance) == 0.0


def test_curvature_keeps_the_shape_of_the_distances() -> None:
    road = road_of([0.0, 0.02, 0.06])
    np.testing.assert_allclose(
        road.curvature_at([[0.0, 5.0], [15.0, 20.0]]), [[0.0, 0.01], [0.04, 0.06]]
    )
    np.testing.assert_array_equal(road.curvature_at(np.array([-0.1, 20.1])), [0.0, 0.0])


@pytest.mark.parametrize(("step", "samples"), [(10.0, 30), (3.0, 8), (0.7, 5)])
@pytest.mark.parametrize("spacing", [0.5, 2.0, 7.3, 1000.0])
def test_distances_are_equal_steps_no_longer_than_asked(
    step: float, samples: int, spacing: float
) -> None:
    road = Road(np.linspace(0.0, 0.05, samples), step)
    distances = road.distances(spacing)
    assert distances[0] == 0.0
    assert distances[-1] == road.length
    steps = np.diff(distances)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert steps[0] <= spacing * (1.0 + 1e-9)
    assert len(distances) == 2 or steps[0] * (len(steps)) / (len(steps) - 1) > spacing


def test_road_points_lie_every_two_metres_on_the_exact_centre_line() -> None:
    road = Road(random_curvatures(np.random.default_rng(5), 31))
    assert road.road_points.shape == (151, 2)
    np.testing.assert_allclose(road.road_points[::5], road.points, rtol=0, atol=1e-9)
    poses = np.array([road.pose_at(distance) for distance in road.distances(2.0)])
    np.testing.assert_allclose(road.road_points, poses[:, :2], rtol=0, atol=1e-9)


@given(
    seed=st.integers(0, 2**32 - 1),
    offset=st.floats(-8.0, 8.0),
    spacing=st.sampled_from([0.5, 2.0, 3.7]),
)
@settings(max_examples=50)
def test_sampled_points_face_the_centre_line_at_the_offset(
    seed: int, offset: float, spacing: float
) -> None:
    road = Road(random_curvatures(np.random.default_rng(seed)))
    poses = np.array([road.pose_at(distance) for distance in road.distances(spacing)])
    left = np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
    points = road.sample(spacing, offset)
    np.testing.assert_allclose(points, poses[:, :2] + offset * left, rtol=0, atol=1e-9)


def test_distances_are_those_of_numpy_linspace_bit_for_bit() -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        road = Road(np.zeros(rng.integers(2, 40)), float(rng.uniform(0.3, 20.0)))
        found = road.distances(spacing := float(rng.uniform(0.1, 30.0)))
        assert np.array_equal(found, np.linspace(0.0, road.length, len(found)))
        assert np.diff(found).max() <= spacing * (1.0 + 1e-9)


@pytest.mark.parametrize("lane_width", [4.0, 5.0, 3.25])
def test_lanes_lie_side_by_side_at_constant_distances(lane_width: float) -> None:
    road = gentle_road(np.random.default_rng(6))
    road = Road(road.curvatures, road.step, road.pose, lane_width=lane_width)
    half = 0.5 * lane_width
    ego, other = road.ego_lane, road.other_lane
    for line, offset in [
        (ego.left, 0.0),
        (ego.centre, -half),
        (ego.right, -lane_width),
        (other.left, lane_width),
        (other.centre, half),
        (other.right, 0.0),
    ]:
        assert line.shape == ego.centre.shape
        projected = road.project(line)
        np.testing.assert_allclose(projected[:, 1], offset, rtol=0, atol=1e-6)
        np.testing.assert_allclose(
            projected[:, 0], np.linspace(0.0, road.length, len(line)), rtol=0, atol=1e-6
        )
    np.testing.assert_array_equal(ego.left, other.right)


# --- Projection ----------------------------------------------------------------------------------


@given(
    seed=st.integers(0, 2**32 - 1),
    place=st.floats(-0.2, 1.2),
    share=st.floats(-0.85, 0.85),
)
@settings(max_examples=100)
def test_projecting_a_point_gives_the_place_that_it_was_made_from(
    seed: int, place: float, share: float
) -> None:
    road = gentle_road(np.random.default_rng(seed))
    s = place * road.length
    d = min(share / float(np.abs(road.curvatures).max()), 200.0)
    x, y, heading = road.pose_at(s)
    point = (x - d * math.sin(heading), y + d * math.cos(heading))
    ((found_s, found_d),) = road.project([point])
    assert found_s == pytest.approx(s, abs=1e-5)
    assert found_d == pytest.approx(d, abs=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_projection_finds_the_nearest_point_of_the_whole_road(seed: int) -> None:
    """Against all points of the road, 2 cm apart, on roads that may cross themselves."""
    rng = np.random.default_rng(seed)
    road = Road(random_curvatures(rng))
    dense = road.sample(0.02)
    low, high = dense.min(axis=0) - 10.0, dense.max(axis=0) + 10.0
    positions = rng.uniform(low, high, (300, 2))
    between = np.hypot(*(positions[:, None] - dense[None]).transpose(2, 0, 1))
    nearest = between.argmin(axis=1)
    # Beside the ends' straight extensions the foot is no point of the road.
    inside = (nearest > 0) & (nearest < len(dense) - 1)
    found = road.project(positions[inside])
    expected = between.min(axis=1)[inside]
    # Rows 1 m apart decide between two pieces that are almost equally far away.
    slack = np.hypot(expected, 0.5) - expected
    assert np.all(np.abs(found[:, 1]) >= expected - 1e-3)
    assert np.all(np.abs(found[:, 1]) <= expected + slack + 1e-3)
    places = np.array([road.pose_at(s) for s in found[:, 0]])
    feet = places[:, :2] + found[:, 1:] * np.column_stack(
        [-np.sin(places[:, 2]), np.cos(places[:, 2])]
    )
    np.testing.assert_allclose(feet, positions[inside], rtol=0, atol=1e-5)
    # Where only one piece comes into question, it is that one.
    s = np.linspace(0.0, road.length, len(dense))
    elsewhere = np.abs(s[None] - s[nearest][:, None]) > 2.0
    rivals = np.where(elsewhere, between, np.inf).min(axis=1)[inside]
    clear = rivals > expected + 0.2
    assert clear.sum() > 30
    np.testing.assert_allclose(found[clear, 0], s[nearest[inside]][clear], rtol=0, atol=0.2)


def test_beyond_both_ends_the_straight_extension_is_projected_onto() -> None:
    road = Road(np.full(20, 0.02))
    first, last = road.pose_at(0.0), road.pose_at(road.length)
    for pose, along, s in ((first, -12.0, -12.0), (last, 12.0, road.length + 12.0)):
        for d in (-3.0, 0.0, 3.0):
            x = pose.x + along * math.cos(pose.heading) - d * math.sin(pose.heading)
            y = pose.y + along * math.sin(pose.heading) + d * math.cos(pose.heading)
            ((found_s, found_d),) = road.project([(x, y)])
            assert (found_s, found_d) == pytest.approx((s, d), abs=1e-9)


def test_a_path_stays_on_its_leg_of_a_hairpin() -> None:
    road = hairpin(apart=9.0, leg=60.0)
    end = road.points[-1]
    assert end == pytest.approx([-9.0, 0.0], abs=1e-6)
    # The path drifts to the left until the other leg, 9 m away, is nearer.
    y = np.arange(0.0, 50.0, 1.0)
    x = -np.minimum(6.0, 0.2 * y)
    path = np.column_stack([x, y])
    followed = road.track(path)
    np.testing.assert_allclose(followed[:, 0], y, rtol=0, atol=1e-6)
    np.testing.assert_allclose(followed[:, 1], -x, rtol=0, atol=1e-6)
    nearest = road.project(path)
    beyond = x < -4.6
    np.testing.assert_allclose(nearest[beyond, 0], road.length - y[beyond], rtol=0, atol=1e-6)
    # To the left of the leg that comes back lies the one that the path is on.
    np.testing.assert_allclose(nearest[beyond, 1], 9.0 + x[beyond], rtol=0, atol=1e-6)
    np.testing.assert_allclose(nearest[~beyond], followed[~beyond], rtol=0, atol=1e-6)


@pytest.mark.parametrize("offset", [-6.0, -2.0, 0.0, 4.0])
def test_a_path_along_a_tight_road_is_followed_at_car_speeds(offset: float) -> None:
    road = road_of([0.0, 0.05, 0.07, 0.07, 0.02, -0.03, -0.07, -0.07, 0.0])
    # 1.7 m of centre line between positions: 34 m/s, seen at 20 Hz.
    distances = np.linspace(-3.0, road.length + 3.0, 51)
    poses = np.array([road.pose_at(s) for s in distances])
    path = poses[:, :2] + offset * np.column_stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])])
    followed = road.track(path)
    np.testing.assert_allclose(followed[:, 0], distances, rtol=0, atol=1e-6)
    np.testing.assert_allclose(followed[:, 1], offset, rtol=0, atol=1e-6)


def test_a_car_that_stands_still_keeps_its_place() -> None:
    road = hairpin()
    path = np.tile(road.points[10] + [-2.0, 0.0], (50, 1))
    followed = road.track(path)
    np.testing.assert_array_equal(followed, np.tile(followed[0], (50, 1)))
    assert followed[0] == pytest.approx([10 * road.step, 2.0], abs=1e-9)


def test_no_positions_project_onto_no_places() -> None:
    road = road_of([0.0, 0.01])
    assert road.project(np.empty((0, 2))).shape == (0, 2)
    assert road.track(np.empty((0, 2))).shape == (0, 2)


# --- The map -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_a_fitted_road_lies_in_the_map_with_its_curvatures(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    road = Road(random_curvatures(rng, 18), pose=pose, lane_width=5.0)
    fitted = road.fitted()
    assert fitted is not None
    np.testing.assert_array_equal(fitted.curvatures, road.curvatures)
    assert (fitted.step, fitted.lane_width) == (road.step, 5.0)
    assert fitted.road_points.min() >= 10.0 - 1e-6
    assert fitted.road_points.max() <= 190.0 + 1e-6
    turned = moved(road.points, Pose(0.0, 0.0, math.pi / 2 + fitted.pose.heading - pose.heading))
    np.testing.assert_allclose(
        fitted.points - fitted.points[0], turned - turned[0], rtol=0, atol=1e-8
    )


def test_a_road_inside_the_map_stays_where_it_is() -> None:
    road = road_of([0.0, 0.01, 0.02], pose=Pose(100.0, 100.0, 0.3))
    assert road.fitted() is road


def test_a_straight_road_of_a_map_diagonal_fits_turned_and_no_longer_one_does() -> None:
    diagonal = math.hypot(180.0, 180.0)
    fitted = road_of([0.0, 0.0, 0.0], (diagonal - 0.01) / 2.0).fitted()
    assert fitted is not None
    assert math.tan(fitted.pose.heading) ** 2 == pytest.approx(1.0, abs=1e-3)
    assert road_of([0.0, 0.0, 0.0], (diagonal + 0.01) / 2.0).fitted() is None
    assert road_of([0.0, 0.0, 0.0], (diagonal + 0.01) / 2.0).fitted(300.0) is not None
    assert road_of([0.0, 0.0, 0.0], (diagonal + 0.01) / 2.0).fitted(margin=5.0) is not None


# --- Roads are values ----------------------------------------------------------------------------


def test_a_road_cannot_be_changed() -> None:
    values = np.array([0.0, 0.01, 0.02])
    road = Road(values)
    values[0] = 1.0
    assert road.curvatures[0] == 0.0
    for array in (road.curvatures, road.points, road.headings, road.road_points, road.table):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        road.step = 2.0  # type: ignore[misc]


def test_a_road_takes_any_list_of_numbers_and_makes_floats_of_it() -> None:
    for values in ([0, 1, 0], (0.0, 1.0, 0.0), np.array([0, 1, 0], dtype=np.float32)):
        road = Road(values, 2, (1, 2, 3))
        assert road.curvatures.dtype == np.float64
        np.testing.assert_array_equal(road.curvatures, [0.0, 1.0, 0.0])
        assert isinstance(road.step, float)
        assert road.pose == Pose(1.0, 2.0, 3.0)
        assert isinstance(road.pose, Pose)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0.0, math.nan, 0.0], "curvature 1 is nan: every curvature must be a finite number"),
        ([0.0, 0.0, -math.inf], "curvature 2 is -inf: every curvature must be a finite number"),
        ([], "a road of 0 curvature samples: 2 to 10000 are allowed"),
        ([0.1], "a road of 1 curvature samples: 2 to 10000 are allowed"),
        (np.zeros(1_000_000), "a road of 1000000 curvature samples: 2 to 10000 are allowed"),
        (np.zeros((3, 2)), r"curvatures have shape \(3, 2\): a flat list \(N,\) is needed"),
        (0.1, r"curvatures have shape \(\): a flat list"),
        (["left", "right"], "curvatures are not a list of numbers"),
        ("0.1", r"curvatures have shape \(\)"),
        ([[0.1], [0.1, 0.2]], "curvatures are not a list of numbers"),
        ([0.1, object()], "curvatures are not a list of numbers"),
        ([0.1, 1j], "curvatures are not a list of numbers"),
        ([0.0, 10.5], "curvature 1 is 10.5 1/m: at most 10 in either direction"),
        ([-1e300, 0.0], r"curvature 0 is -1e\+300 1/m: at most 10 in either direction"),
    ],
)
def test_bad_curvatures_are_refused_by_name(values: Any, message: str) -> None:
    with pytest.raises(RoadError, match=message):
        Road(values)


@pytest.mark.parametrize("name", ["step", "lane_width"])
@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (-1.0, "-1"),
        (math.nan, "nan"),
        (math.inf, "inf"),
        ("far", "'far'"),
        (None, "None"),
    ],
)
def test_lengths_that_are_not_positive_are_refused(name: str, value: Any, shown: str) -> None:
    with pytest.raises(RoadError, match=f"{name} is {shown}: a positive number of metres"):
        Road(np.zeros(3), **{name: value})


def test_roads_that_are_too_long_or_lie_nowhere_are_refused() -> None:
    assert Road(np.zeros(5001), 10.0).length == 50_000.0
    with pytest.raises(RoadError, match="a road of 50010 m: at most 50000 m can be represented"):
        Road(np.zeros(5002), 10.0)
    for bad in (math.nan, math.inf):
        with pytest.raises(RoadError, match="x, y and heading must be finite numbers"):
            road_of([0.0, 0.0], pose=Pose(0.0, bad, 0.0))


SQUARE = [[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 30.0]]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[0.0, 0.0], [math.nan, 1.0]], r"point 1 is \(nan, 1.0\): coordinates must be finite"),
        ([[0.0, math.inf], [1.0, 1.0]], r"point 0 is \(0.0, inf\): coordinates must be finite"),
        ([], r"points have shape \(0,\): a list of \(x, y\), \(N, 2\), is needed"),
        (np.empty((0, 2)), "a road of 0 points: 2 to 10000 are allowed"),
        ([[1.0, 2.0]], "a road of 1 points: 2 to 10000 are allowed"),
        (np.zeros((1_000_000, 2)), "a road of 1000000 points: 2 to 10000 are allowed"),
        ([1.0, 2.0, 3.0], r"points have shape \(3,\)"),
        (np.zeros((4, 3)), r"points have shape \(4, 3\)"),
        (np.zeros((4, 2, 2)), r"points have shape \(4, 2, 2\)"),
        ([["a", "b"], ["c", "d"]], "points are not a list of numbers"),
        ([[0.0, 1.0], [2.0]], "points are not a list of numbers"),
        ([*SQUARE[:2], *SQUARE[1:]], "points 1 and 2 are the same"),
        ([[0.0, 0.0], [0.0, 0.0]], "points 0 and 1 are the same: consecutive points must differ"),
        ([[0.0, 0.0], [50_001.0, 0.0]], "a road of 50001 m: at most 50000 m"),
    ],
)
def test_bad_points_are_refused_by_name(points: Any, message: str) -> None:
    with pytest.raises(RoadError, match=message):
        Road.from_points(points)


def test_from_points_refuses_a_bad_lane_width() -> None:
    assert Road.from_points(SQUARE, lane_width=5.0).lane_width == 5.0
    with pytest.raises(RoadError, match="lane_width is -1: a positive number of metres"):
        Road.from_points(SQUARE, lane_width=-1.0)


def test_a_closed_square_may_return_to_its_start() -> None:
    road = Road.from_points([*SQUARE, SQUARE[0]])
    assert road.pose_at(road.length)[:2] == pytest.approx((0.0, 0.0), abs=5e-3)


# --- The table -----------------------------------------------------------------------------------


@given(
    step=st.floats(0.1, 100.0),
    sharpest=st.floats(0.0, 5.0),
    n=st.integers(2, 20),
)
@settings(max_examples=100)
def test_sub_steps_are_short_and_turn_little(step: float, sharpest: float, n: int) -> None:
    road = Road(np.linspace(-sharpest, sharpest, n), step)
    ds = road.sub_step
    assert ds <= geometry.SUB_STEP * (1.0 + 1e-6)
    assert ds * sharpest <= geometry.SUB_TURN * (1.0 + 1e-6)
    per_piece = round(step / ds)
    assert len(road.table) == per_piece * (n - 1) + 1
    turns = np.abs(np.diff(road.table[:, geometry.HEADING]))
    assert turns.max() <= geometry.SUB_TURN * (1.0 + 1e-6)
    np.testing.assert_allclose(
        np.hypot(road.table[:, geometry.COS], road.table[:, geometry.SIN]), 1.0, atol=1e-12
    )
