"""The share of a car outside its lane, against polygons of shapely."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from shapely.geometry import Polygon

from frenetic.oracle.lane_share import share_outside
from frenetic.road import Pose, Road, geometry
from frenetic.search.operators import random_curvatures

FloatArray = npt.NDArray[np.float64]
Box = tuple[float, float, float]
"""Length, width, and distance of the centre ahead of the centre of mass, in m."""

CAR: Box = (4.508, 1.610, -0.1333)


def random_road(rng: np.random.Generator) -> Road:
    """Return a random road in a random pose."""
    x, y, heading = rng.uniform(-200.0, 200.0, 3)
    values = random_curvatures(rng, int(rng.integers(10, 26)))
    return Road(values, pose=(x, y, heading / 30.0), lane_width=float(rng.choice([3.0, 4.0])))


def place(road: Road, s: float, d: float) -> tuple[float, float]:
    """Return x and y of a point s m along a road and d m to its left."""
    x, y, heading = road.pose_at(s)
    return x - d * math.sin(heading), y + d * math.cos(heading)


def share(
    road: Road,
    s: float,
    d: float,
    error: float,
    box: Box = CAR,
    lane: tuple[float, float] | None = None,
    least: float = 0.0,
) -> float:
    """Return the share outside the lane of a car at (s, d), turned by ``error`` rad."""
    left, right = lane or (0.0, -road.lane_width)
    x, y = place(road, s, d)
    heading = road.pose_at(s).heading
    result: float = share_outside(
        road.table, road.sub_step, left, right, s, d, heading, x, y, heading + error, *box, least
    )
    return result


def reference(
    road: Road,
    s: float,
    d: float,
    error: float,
    box: Box = CAR,
    lane: tuple[float, float] | None = None,
) -> float:
    """Return the share by polygons of shapely, with the lane's edges sampled every 5 cm."""
    length, width, ahead = box
    heading = road.pose_at(s).heading + error
    forward = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    centre = place(road, s, d) + ahead * forward
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    car = Polygon([centre + 0.5 * (a * length * forward + b * width * left) for a, b in corners])
    reach = 2.0 * (math.hypot(length, width) + abs(ahead))
    near = np.arange(s - reach, s + reach, 0.05)
    sides = lane or (0.0, -road.lane_width)
    edges = [geometry.sample_line(road.table, road.sub_step, near, side) for side in sides]
    lane_there = Polygon(np.concatenate([edges[0], edges[1][::-1]]))
    assert lane_there.is_valid
    return float(car.difference(lane_there).area / car.area)


# Range of the lateral offset in m, largest turn in rad: near either edge of the lane, and anywhere.
POSES = [(-1.4, 1.4, 0.15), (-3.5, -0.8, 0.6), (0.8, 3.5, 0.6), (-7.0, 5.0, math.pi)]


@pytest.mark.parametrize("seed", range(3))
def test_share_agrees_with_polygons(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shares = []
    for low, high, turn in POSES:
        road = random_road(rng)
        for s in [*rng.uniform(-6.0, road.length + 6.0, 50), -3.0, road.length + 3.0]:
            d, error = rng.uniform(low, high) - 0.5 * road.lane_width, rng.uniform(-turn, turn)
            shares.append(share(road, s, d, error))
            assert shares[-1] == pytest.approx(reference(road, s, d, error), abs=3e-3)
    assert (min(shares), max(shares)) == (0.0, 1.0)
    assert sum(0.1 < share < 0.9 for share in shares) > 50


@pytest.mark.parametrize("kappa", [0.07, -0.07])
@pytest.mark.parametrize("lane", [(0.0, -4.0), (4.0, 0.0)])
@pytest.mark.parametrize("box", [CAR, (12.0, 2.5, 3.0), (2.0, 2.0, -0.5)])
def test_share_agrees_in_the_tightest_curves_for_any_box(
    kappa: float, lane: tuple[float, float], box: Box
) -> None:
    road = Road(np.full(10, kappa))
    for d in np.linspace(-7.0, 7.0, 15).tolist():
        for error in (0.0, 0.3, -1.2, math.pi):
            expected = reference(road, 45.0, d, error, box, lane)
            assert share(road, 45.0, d, error, box, lane) == pytest.approx(expected, abs=4e-3)


@pytest.mark.parametrize("least", [0.5, 0.8, 0.95, 1.0])
@pytest.mark.parametrize("box", [CAR, (12.0, 2.5, 3.0), (2.0, 2.0, -0.5)])
def test_only_shares_below_the_least_share_may_be_returned_as_0(least: float, box: Box) -> None:
    rng = np.random.default_rng(1)
    skipped = 0
    for _ in range(40):
        road = random_road(rng)
        for s in rng.uniform(-6.0, road.length + 6.0, 40):
            pose = s, rng.uniform(-6.0, 2.0), rng.uniform(-math.pi, math.pi)
            whole, bounded = share(road, *pose, box), share(road, *pose, box, least=least)
            assert bounded == whole or (bounded == 0.0 and whole < least)
            skipped += bounded != whole
    assert skipped > 100 or least == 0.5 or box[2] == 3.0


@pytest.mark.parametrize("backwards", [False, True])
def test_on_a_straight_road_the_share_is_linear_in_the_offset(backwards: bool) -> None:
    road = Road(np.zeros(10), pose=Pose(9e3, -1e4, -7.0))  # a far road loses no digits
    _, width, _ = CAR
    for offset in np.linspace(-6.0, 6.0, 49).tolist():
        outside = (abs(offset) + 0.5 * width - 2.0) / width
        outside_share = share(road, 40.0, offset - 2.0, math.pi if backwards else 0.0)
        assert outside_share == pytest.approx(min(max(outside, 0.0), 1.0), abs=1e-7)


def test_the_lane_of_another_leg_does_not_count() -> None:
    """The legs of a hairpin are 9 m apart; the ego lane of the leg back is the farther lane."""
    turn = np.concatenate([[0.0], np.full(8, math.pi / 8.0), [0.0]])
    step = 9.0 / -float(Road(turn, 1.0).points[-1, 0])
    straight = np.zeros(math.ceil(60.0 / step))
    road = Road(np.concatenate([straight, turn[1:-1] / step, straight]), step)
    for x in (-11.0, -7.0):
        s_back, d_back = road.length - 20.0, x + 9.0
        assert place(road, s_back, d_back) == pytest.approx((x, 20.0), abs=1e-6)
        # The car is outside the lane of its leg; it may be inside the lane of the leg back.
        assert share(road, 20.0, -x, 0.0) == 1.0
        assert share(road, s_back, d_back, 0.0) == (0.0 if x == -11.0 else 1.0)
