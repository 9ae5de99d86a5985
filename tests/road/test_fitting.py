from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from frenetic.errors import RoadError
from frenetic.road.fitting import RigidMotion, fit_to_map

FloatArray = npt.NDArray[np.float64]

MAP, MARGIN = 200.0, 10.0
ROOM = MAP - 2 * MARGIN
STAY = RigidMotion(0.0, 0.0, 0.0)


def random_road(rng: np.random.Generator) -> FloatArray:
    """A road of 40 to 400 m with a point every 2 m."""
    n = int(rng.integers(20, 200))
    curvature = np.interp(
        np.arange(n), np.arange(0, n, 5), rng.uniform(-0.07, 0.07, len(range(0, n, 5)))
    )
    if rng.random() < 0.3:
        curvature *= 0.1  # long and narrow
    heading = rng.uniform(0, 7) + np.cumsum(2.0 * curvature)
    return np.cumsum(2.0 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)


def shape(rng: np.random.Generator) -> FloatArray:
    """Something whose extent is known to be awkward: symmetric, flat, round or a rectangle."""
    kind = rng.integers(5)
    if kind == 0:
        line = np.outer(np.linspace(0, 1, int(rng.integers(2, 50))), [1.0, 0.0])
    elif kind == 1:
        t = np.linspace(0, rng.uniform(1, 6.2), 60)
        line = np.column_stack([np.cos(t), np.sin(t)])
    elif kind == 2:
        line = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, rng.uniform(0, 1)], [0.0, 1e-3]])
    elif kind == 3:
        corners = int(rng.integers(3, 9))
        t = np.arange(corners, dtype=np.float64) * (2 * np.pi / corners)
        line = np.column_stack([np.cos(t), np.sin(t)])
    else:
        line = rng.normal(0, 1, (int(rng.integers(3, 20)), 2))
    angle = rng.choice([0.0, math.pi / 4, rng.uniform(0, 7)])
    return turned(line * 100, angle) + rng.uniform(-1000, 1000, 2)


def turned(line: FloatArray, angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(line @ np.array([[c, s], [-s, c]]))


def smallest_of_many_squares(line: FloatArray, angles: int = 20_000) -> float:
    """The side of the smallest square box of the road turned by many angles."""
    flat = np.linalg.matrix_rank(line - line[0], tol=1e-9 * np.ptp(line)) < 2
    corners = line if flat else line[ConvexHull(line).vertices]
    theta = np.arange(angles) * (math.pi / 2 / angles)
    x = np.outer(np.cos(theta), corners[:, 0]) - np.outer(np.sin(theta), corners[:, 1])
    y = np.outer(np.sin(theta), corners[:, 0]) + np.outer(np.cos(theta), corners[:, 1])
    return float(np.maximum(np.ptp(x, axis=1), np.ptp(y, axis=1)).min())


def assert_within_margins(line: FloatArray, map_size: float = MAP, margin: float = MARGIN) -> None:
    assert line.min() >= margin - 1e-9
    assert line.max() <= map_size - margin + 1e-9


@pytest.mark.parametrize("make", [random_road, shape])
@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_found_exactly_when_one_exists(make: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(20):
        line = make(rng)
        best = smallest_of_many_squares(line)

        # The sampled angles come within 4e-5 rad of the best one, and the box grows with at most
        # its diagonal: 6e-5 of its side.
        just_fits = line * (ROOM / (best * (1 + 1e-6)))
        motion = fit_to_map(just_fits)
        assert motion is not None
        assert_within_margins(motion.apply(just_fits))
        assert fit_to_map(line * (ROOM / (best * (1 - 1e-4)))) is None

        motion = fit_to_map(line)
        assert (motion is not None) == (best <= ROOM) or abs(best - ROOM) < 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_a_motion_is_rigid_and_leads_into_the_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = turning = 0
    for _ in range(200):
        line = random_road(rng)
        motion = fit_to_map(line)
        if motion is None:
            continue
        found += 1
        turning += motion.rotation != 0.0
        moved = motion.apply(line)
        assert_within_margins(moved)
        np.testing.assert_allclose(pdist(moved), pdist(line), rtol=0, atol=1e-10)
        # Not a mirror image: areas keep their sign.
        assert np.isclose(signed_area(moved), signed_area(line), rtol=1e-9, atol=1e-6)
        assert -math.pi / 4 < motion.rotation <= math.pi / 4
    assert found > 100
    assert turning > 5


def signed_area(line: FloatArray) -> float:
    x, y = (line - line[0]).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) / 2)


def test_a_road_within_the_margins_stays() -> None:
    line = np.array([[10.0, 10.0], [190.0, 10.0], [190.0, 190.0], [100.0, 77.0]])
    assert fit_to_map(line) == STAY
    np.testing.assert_array_equal(STAY.apply(line), line)
    assert fit_to_map(line, margin=10.001) is None


def test_a_road_that_fits_unturned_is_centred() -> None:
    line = np.array([[-5.0, 0.0], [15.0, 0.0], [15.0, 100.0]])
    motion = fit_to_map(line)
    assert motion == RigidMotion(0.0, 95.0, 50.0)
    assert motion.apply(line).tolist() == [[90, 50], [110, 50], [110, 150]]


def test_where_a_road_came_from_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        line = random_road(rng) - 500
        elsewhere = line + np.array([64.0, -1024.0])
        first, second = fit_to_map(line), fit_to_map(elsewhere)
        assert (first is None) == (second is None)
        if first is not None and second is not None:
            np.testing.assert_allclose(
                first.apply(line), second.apply(elsewhere), rtol=0, atol=1e-9
            )


@pytest.mark.parametrize("points", [2, 3, 100])
@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, math.pi / 2, 3.0])
def test_a_straight_road_as_long_as_the_diagonal_fits_at_45_degrees_only(
    points: int, angle: float
) -> None:
    diagonal = ROOM * math.sqrt(2)
    straight = np.outer(np.linspace(0, 1, points), [math.cos(angle), math.sin(angle)])
    motion = fit_to_map(straight * diagonal * 0.999)
    assert motion is not None
    heading = math.degrees(angle + motion.rotation)
    assert heading % 90 == pytest.approx(45, abs=1e-6)
    assert_within_margins(motion.apply(straight * diagonal * 0.999))
    assert fit_to_map(straight * diagonal * 1.001) is None


@pytest.mark.parametrize("angle", [0.2, 0.7, 1.3])
def test_a_tilted_square_is_turned_upright(angle: float) -> None:
    square = turned(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * ROOM * 0.9999, angle)
    motion = fit_to_map(square)
    assert motion is not None
    assert math.sin(2 * (angle + motion.rotation)) == pytest.approx(0, abs=1e-9)


def test_a_narrow_rectangle_lies_across() -> None:
    # (a + b) / sqrt(2) is the box of an a x b rectangle at 45 degrees.
    a, b = 220.0, 30.0
    rectangle = np.array([[0, 0], [a, 0], [a, b], [0, b]])
    needed = (a + b) / math.sqrt(2)
    assert fit_to_map(rectangle, map_size=needed + 20.001) is not None
    assert fit_to_map(rectangle, map_size=needed + 19.999) is None


def test_a_single_point_and_a_tiny_road() -> None:
    assert fit_to_map([[0.0, 0.0]]) == RigidMotion(0.0, 100.0, 100.0)
    assert fit_to_map([[50, 50]]) == STAY
    tiny = fit_to_map([[0.0, 0.0], [1e-300, 1e-12]])
    assert tiny is not None
    assert tiny.rotation == 0.0


@pytest.mark.parametrize("margin", [100.0, 150.0])
def test_no_road_fits_between_margins_that_leave_no_room(margin: float) -> None:
    assert fit_to_map([[100.0, 100.0], [100.0, 101.0]], margin=margin) is None


def test_integers_lists_and_read_only_arrays_will_do() -> None:
    line = np.array([[0.0, 0.0], [250.0, 10.0], [250.0, 12.0]])
    line.setflags(write=False)
    motion = fit_to_map(line)
    assert motion is not None
    assert motion.rotation != 0.0
    assert fit_to_map(line.tolist()) == motion
    assert fit_to_map(line.astype(int)) == motion
    assert fit_to_map(np.asfortranarray(line)) == motion
    np.testing.assert_array_equal(motion.apply(line.tolist()), motion.apply(line))


@pytest.mark.parametrize(
    "points",
    [
        [],
        [[1.0, 2.0, 3.0]],
        [1.0, 2.0],
        "road",
        [["1", "2"], ["3", "4"]],
        [[0.0, 0.0], [math.nan, 1.0]],
        [[0.0, 0.0], [1.0, math.inf]],
        [[math.inf, 0.0], [math.inf, 0.0]],
        [[-1e308, 0.0], [1e308, 0.0]],
    ],
)
def test_bad_points(points: Any) -> None:
    with pytest.raises(RoadError):
        fit_to_map(points)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf])
def test_bad_map(size: float) -> None:
    with pytest.raises(RoadError, match="map_size"):
        fit_to_map([[0.0, 0.0]], map_size=size)


@pytest.mark.parametrize("margin", [-1.0, math.nan, math.inf])
def test_bad_margin(margin: float) -> None:
    with pytest.raises(RoadError, match="margin"):
        fit_to_map([[0.0, 0.0]], margin=margin)


def test_many_corners() -> None:
    """So many that anything that grows with their square would take minutes."""
    t = np.linspace(0, 6, 200_000)  # nearly every point is a corner of the hull
    line = 120 * np.column_stack([np.cos(t), np.sin(t)])
    assert fit_to_map(line) is None
    assert fit_to_map(line[:, ::-1] * [1.0, 1e-9]) is not None


coordinate = st.integers(-300, 300).map(float) | st.floats(-300, 300)


@given(st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=12))
@settings(max_examples=150)
def test_any_points_are_fitted_or_too_large(points: list[tuple[float, float]]) -> None:
    line = np.array(points)
    motion = fit_to_map(line)
    if motion is not None:
        assert_within_margins(motion.apply(line))
        assert fit_to_map(motion.apply(line), margin=MARGIN - 1e-9) == STAY
    else:
        assert smallest_of_many_angles(line) > ROOM


def smallest_of_many_angles(line: FloatArray) -> float:
    """As above without the hull, for few points that may coincide or lie on a line."""
    return min(
        float(np.ptp(turned(line, angle), axis=0).max())
        for angle in np.linspace(0, math.pi / 2, 200)
    )
