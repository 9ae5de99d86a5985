from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from frenetic.road import Pose, Road, geometry, integrate
from frenetic.road.overlap import share_outside

FloatArray = npt.NDArray[np.float64]
Box = tuple[float, float, float]
"""m: length, width, how far the centre lies ahead of the centre of mass."""

CAR: Box = (4.508, 1.610, -0.1333)


def random_road(rng: np.random.Generator, lane_width: float = 4.0) -> Road:
    """A walk within the curvatures of valid roads, in any pose."""
    values: list[float] = [0.0]
    for _ in range(int(rng.integers(10, 26))):
        low, high = max(values[-1] - 0.05, -0.07), min(values[-1] + 0.05, 0.07)
        values.append(float(rng.uniform(low, high)))
    x, y = rng.uniform(-200.0, 200.0, 2)
    pose = Pose(float(x), float(y), float(rng.uniform(-7.0, 7.0)))
    return Road(np.array(values[1:]), pose=pose, lane_width=lane_width)


def place(road: Road, s: float, d: float) -> tuple[float, float]:
    x, y, heading = road.pose_at(s)
    return x - d * math.sin(heading), y + d * math.cos(heading)


def share(
    road: Road,
    s: float,
    d: float,
    error: float,
    box: Box = CAR,
    lane: tuple[float, float] | None = None,
) -> float:
    """The share of a car at (s, d), turned by ``error`` rad from the road, outside the ego lane."""
    left, right = lane or (0.0, -road.lane_width)
    x, y = place(road, s, d)
    heading = road.pose_at(s).heading
    result: float = share_outside(
        road.table, road.sub_step, left, right, s, d, heading, x, y, heading + error, *box
    )
    return result


def box_polygon(road: Road, s: float, d: float, error: float, box: Box = CAR) -> Polygon:
    length, width, ahead = box
    x, y = place(road, s, d)
    heading = road.pose_at(s).heading + error
    forward = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    centre = np.array([x, y]) + ahead * forward
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    return Polygon([centre + 0.5 * (a * length * forward + b * width * left) for a, b in corners])


def lane_polygon(
    road: Road, s: float, lane: tuple[float, float] | None = None, reach: float = 9.0
) -> Polygon:
    """The lane ``reach`` m before and after ``s``, its edges sampled every 5 cm."""
    left, right = lane or (0.0, -road.lane_width)
    near = np.arange(s - reach, s + reach, 0.05)
    edges = [geometry.sample_line(road.table, road.sub_step, near, d) for d in (left, right)]
    return Polygon(np.concatenate([edges[0], edges[1][::-1]]))


def reference(
    road: Road,
    s: float,
    d: float,
    error: float,
    box: Box = CAR,
    lane: tuple[float, float] | None = None,
) -> float:
    car = box_polygon(road, s, d, error, box)
    return float(car.difference(lane_polygon(road, s, lane)).area / car.area)


# --- Against general polygons --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("low", "high", "turn"),
    [
        (-1.4, 1.4, 0.15),
        (-3.5, -0.8, 0.6),
        (0.8, 3.5, 0.6),
        (-7.0, 5.0, math.pi),
    ],
    ids=["inside", "straddling-right", "straddling-left", "anywhere"],
)
@pytest.mark.parametrize("seed", range(6))
def test_share_agrees_with_polygons_around_random_roads(
    seed: int, low: float, high: float, turn: float
) -> None:
    rng = np.random.default_rng(seed)
    road = random_road(rng, lane_width=float(rng.choice([4.0, 5.0, 3.0])))
    shares = []
    for _ in range(120):
        s = float(rng.uniform(-3.0, road.length + 3.0))
        d = float(rng.uniform(low, high)) - 0.5 * road.lane_width
        error = float(rng.uniform(-turn, turn))
        found = share(road, s, d, error)
        assert found == pytest.approx(reference(road, s, d, error), abs=3e-3)
        shares.append(found)
    # The poses are what the names say.
    if high == 1.4:
        assert np.mean(shares) < 0.2
        assert min(shares) == 0.0
    else:
        assert max(shares) > 0.9
        assert np.std(shares) > 0.2


@pytest.mark.parametrize("kappa", [0.07, -0.07])
@pytest.mark.parametrize("lane", [(0.0, -4.0), (4.0, 0.0), (0.0, -5.0)])
@pytest.mark.parametrize("error", [0.0, 0.3, -0.3, 1.2, math.pi / 2, math.pi, -2.5])
def test_share_agrees_with_polygons_in_the_tightest_curves(
    kappa: float, lane: tuple[float, float], error: float
) -> None:
    road = Road(np.full(10, kappa))
    for d in np.linspace(-7.0, 7.0, 29):
        found = share(road, 45.0, float(d), error, lane=lane)
        expected = reference(road, 45.0, float(d), error, lane=lane)
        assert found == pytest.approx(expected, abs=3e-3)


@pytest.mark.parametrize("end", ["start", "end"])
@pytest.mark.parametrize("seed", range(3))
def test_at_its_ends_the_lane_goes_straight_on(seed: int, end: str) -> None:
    rng = np.random.default_rng(seed)
    road = random_road(rng)
    for _ in range(80):
        s = float(rng.uniform(-6.0, 6.0)) + (road.length if end == "end" else 0.0)
        d = float(rng.uniform(-6.0, 2.0))
        error = float(rng.uniform(-0.8, 0.8))
        assert share(road, s, d, error) == pytest.approx(reference(road, s, d, error), abs=3e-3)
    where = road.length if end == "end" else 0.0
    assert share(road, where, -2.0, 0.0) == 0.0


@pytest.mark.parametrize("box", [(2.0, 2.0, 0.0), (12.0, 2.5, 3.0), (4.5, 1.8, -0.5)])
def test_other_cars_and_centres_of_mass(box: Box) -> None:
    rng = np.random.default_rng(7)
    road = random_road(rng)
    reach = 2.0 * (math.hypot(box[0], box[1]) + abs(box[2]))
    for _ in range(100):
        s = float(rng.uniform(20.0, road.length - 20.0))
        d = float(rng.uniform(-6.0, 2.0))
        error = float(rng.uniform(-math.pi, math.pi))
        car = box_polygon(road, s, d, error, box)
        expected = car.difference(lane_polygon(road, s, reach=reach)).area / car.area
        assert share(road, s, d, error, box) == pytest.approx(expected, abs=3e-3)


# --- Closed forms --------------------------------------------------------------------------------


@given(
    offset=st.floats(-6.0, 6.0),
    lane_width=st.sampled_from([3.0, 4.0, 5.0]),
    pose=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-7.0, 7.0)),
    backwards=st.booleans(),
)
@settings(max_examples=80)
def test_on_a_straight_road_the_share_is_linear_in_the_offset(
    offset: float, lane_width: float, pose: tuple[float, float, float], backwards: bool
) -> None:
    road = Road(np.zeros(10), pose=Pose(*pose), lane_width=lane_width)
    _, width, _ = CAR
    outside = (abs(offset) + 0.5 * width - 0.5 * lane_width) / width
    error = math.pi if backwards else 0.0
    found = share(road, 40.0, offset - 0.5 * lane_width, error)
    assert found == pytest.approx(min(max(outside, 0.0), 1.0), abs=1e-7)


@pytest.mark.parametrize("offset", [0.0, 0.254, 1.0, -1.0, 2.0, -3.0, 4.2, 4.4, -4.4])
def test_across_a_straight_road_both_bumpers_may_be_outside(offset: float) -> None:
    road = Road(np.zeros(10))
    length, width, _ = CAR
    low, high = max(offset - 0.5 * length, -2.0), min(offset + 0.5 * length, 2.0)
    expected = 1.0 - max(high - low, 0.0) / length
    for error in (0.5 * math.pi, -0.5 * math.pi):
        found = share(road, 40.0, offset - 2.0, error, (length, width, 0.0))
        assert found == pytest.approx(expected, abs=1e-9)


@given(error=st.floats(0.0, 2.0 * math.pi))
@settings(max_examples=50)
def test_a_box_whose_centre_is_on_the_edge_is_half_outside(error: float) -> None:
    road = Road(np.zeros(10), lane_width=8.0)
    for d in (0.0, -8.0):
        found = share(road, 40.0, d, error, (4.5, 1.6, 0.0))
        assert found == pytest.approx(0.5, abs=1e-9)


# --- Symmetry ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_the_mirrored_car_is_as_far_outside_the_mirrored_lane(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = random_road(rng)
    mirrored = Road(-road.curvatures)
    for _ in range(200):
        s = float(rng.uniform(0.0, road.length))
        d = float(rng.uniform(-6.0, 2.0))
        error = float(rng.uniform(-math.pi, math.pi))
        there = share(mirrored, s, -d, -error, lane=(4.0, 0.0))
        assert share(road, s, d, error) == pytest.approx(there, abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_outside_one_lane_and_the_other_adds_up(seed: int) -> None:
    """A car on a road of two lanes: outside both is what is outside the road."""
    rng = np.random.default_rng(seed)
    road = random_road(rng)
    for _ in range(200):
        s = float(rng.uniform(0.0, road.length))
        d = float(rng.uniform(-6.0, 6.0))
        error = float(rng.uniform(-math.pi, math.pi))
        ego = share(road, s, d, error)
        other = share(road, s, d, error, lane=(4.0, 0.0))
        both = share(road, s, d, error, lane=(4.0, -4.0))
        assert (1.0 - ego) + (1.0 - other) == pytest.approx(1.0 - both, abs=1e-6)


# --- Another piece of the same road --------------------------------------------------------------


def test_the_lane_of_another_leg_does_not_count() -> None:
    """A hairpin whose legs are 9 m apart: on the leg back, the ego lane is the far one."""
    turn = np.concatenate([[0.0], np.full(8, math.pi / 8.0), [0.0]])
    step = 9.0 / -float(integrate(turn, 1.0)[1][-1, 0])
    straight = np.zeros(math.ceil(60.0 / step))
    road = Road(np.concatenate([straight, turn[1:-1] / step, straight]), step)
    for x, y in ((-11.0, 20.0), (-7.0, 20.0)):
        d_here, s_back, d_back = -x, road.length - y, x + 9.0
        assert place(road, 20.0, d_here) == pytest.approx((x, y), abs=1e-6)
        assert place(road, s_back, d_back) == pytest.approx((x, y), abs=1e-6)
        # Seen from the leg that the car drives on, it is outside.
        assert share(road, 20.0, d_here, 0.0) == 1.0
        # Seen from the leg that it drove onto, it is in the ego or in the other lane.
        back = share(road, s_back, d_back, 0.0)
        assert back == (0.0 if x == -11.0 else 1.0)


@given(
    seed=st.integers(0, 2**32 - 1),
    d=st.floats(-100.0, 100.0),
    error=st.floats(-10.0, 10.0),
)
@settings(max_examples=80)
def test_a_share_is_a_share_however_far_away_the_car_is(seed: int, d: float, error: float) -> None:
    rng = np.random.default_rng(seed)
    road = random_road(rng)
    found = share(road, float(rng.uniform(0.0, road.length)), d, error)
    assert 0.0 <= found <= 1.0
    radius = 1.0 / max(float(np.abs(road.curvatures).max()), 1e-9)
    if not -7.0 < d < 3.0 and abs(d) < radius - 3.0:
        assert found == 1.0


def test_the_reference_is_a_valid_polygon() -> None:
    """What the shares are held against, on the sharpest road: neither ring crosses itself."""
    road = Road(np.tile([0.07, 0.07, -0.07, -0.07], 4), lane_width=5.0)
    for s in np.linspace(0.0, road.length, 50):
        lane = lane_polygon(road, float(s))
        assert shapely.is_valid(lane)
        assert lane.area == pytest.approx(18.0 * 5.0, rel=0.25)
