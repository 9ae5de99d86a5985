from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle import LEFT_LANE, REACHED, RUNNING, STUCK, TIMED_OUT, Result, assess, judge
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road

FloatArray = npt.NDArray[np.float64]

STRAIGHT = Road(np.zeros(11))
"""100 m."""
LEFT_TURN = Road(np.full(11, 0.03))
RIGHT_TURN = Road(np.full(11, -0.03))
WIDTH = CarBody().width


def trajectory(
    road: Road,
    distances: npt.ArrayLike,
    offsets: npt.ArrayLike = 0.0,
    period: float = 0.05,
) -> Trajectory:
    """A car along the road: m along it, m to the left of the ego lane's centre line, aligned."""
    s, offset = np.broadcast_arrays(
        np.asarray(distances, dtype=np.float64), np.asarray(offsets, dtype=np.float64)
    )
    poses = np.array([road.pose_at(float(at)) for at in s]).reshape(-1, 3)
    d = offset - 0.5 * road.lane_width
    zero = np.zeros(len(s))
    return Trajectory(
        time=period * np.arange(len(s), dtype=np.float64),
        x=poses[:, 0] - d * np.sin(poses[:, 2]),
        y=poses[:, 1] + d * np.cos(poses[:, 2]),
        heading=poses[:, 2],
        speed=zero,
        lateral_speed=zero,
        yaw_rate=zero,
        steering=zero,
        steering_input=zero,
        throttle=zero,
        brake=zero,
    )


def steady(road: Road, speed: float = 10.0, period: float = 0.05) -> FloatArray:
    """Distances of a car that drives at constant speed from the road's start to its end."""
    return np.arange(0.0, road.length + 1e-9, speed * period)


def judged(
    road: Road,
    distances: npt.ArrayLike,
    offsets: npt.ArrayLike = 0.0,
    rules: Rules | None = None,
    period: float = 0.05,
    car: CarBody | None = None,
) -> Result:
    path = trajectory(road, distances, offsets, period)
    return judge(road, Drive(path, car or CarBody(), rules or Rules()))


def outside(offset: float, width: float = WIDTH, lane_width: float = 4.0) -> float:
    """Closed form of the oob share of an aligned car on a straight road."""
    return min(max((abs(offset) + 0.5 * width - 0.5 * lane_width) / width, 0.0), 1.0)


# --- PASS ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("road", [STRAIGHT, LEFT_TURN, RIGHT_TURN])
@pytest.mark.parametrize("goal", [8.0, 3.0, 20.0])
def test_a_drive_passes_when_it_comes_near_the_roads_end(road: Road, goal: float) -> None:
    distances = steady(road)
    path = trajectory(road, distances)
    end = road.pose_at(road.length)
    near = np.hypot(path.x - end.x, path.y - end.y) <= goal
    first = int(np.argmax(near))
    result = judge(road, Drive(path, rules=Rules(goal_distance=goal)))
    assert result.outcome is Outcome.PASS
    assert result.reason == "Car reached the end of the road"
    assert result.duration == path.time[first]
    assert result.moobd == pytest.approx(2.0, abs=1e-9)
    assert result.max_oob_share == 0.0
    assert result.departure is None
    assert distances[first] == pytest.approx(road.length - goal, abs=1.5)


def test_a_drive_that_stops_just_before_the_goal_has_not_passed() -> None:
    # The lane's centre is 2 m beside the road's last point.
    goal = STRAIGHT.length - math.sqrt(8.0**2 - 2.0**2)
    assert judged(STRAIGHT, [0.0, goal + 1e-6]).outcome is Outcome.PASS
    assert judged(STRAIGHT, [0.0, goal - 1e-6]).outcome is Outcome.ERROR


@pytest.mark.parametrize(("lane_width", "goal"), [(16.0, 8.0), (40.0, 8.0), (4.0, 1.0)])
def test_the_roads_end_is_reached_however_far_from_its_last_point(
    lane_width: float, goal: float
) -> None:
    road = Road(np.zeros(11), lane_width=lane_width)
    result = judged(road, steady(road), rules=Rules(goal_distance=goal))
    assert result.outcome is Outcome.PASS
    assert result.moobd == pytest.approx(lane_width / 2.0)


def test_passing_by_the_roads_end_early_on_is_no_pass() -> None:
    """A circle ends where it starts."""
    circle = Road(np.full(13, 2.0 * math.pi / 120.0))
    path = trajectory(circle, steady(circle))
    assert math.hypot(path.x[0], path.y[0]) < 8.0
    result = judge(circle, Drive(path))
    assert result.outcome is Outcome.PASS
    assert result.duration == pytest.approx((120.0 - 8.0) / 10.0, abs=0.15)


# --- FAIL: out of the lane -----------------------------------------------------------------------


@pytest.mark.parametrize("road", [STRAIGHT, LEFT_TURN, RIGHT_TURN], ids=["straight", "l", "r"])
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("tolerance", [0.95, 0.5, 0.1])
def test_a_car_that_drifts_out_of_its_lane_fails_there(
    road: Road, side: str, tolerance: float
) -> None:
    distances = steady(road)
    drift = 0.047 * distances * (1.0 if side == "left" else -1.0)
    path = trajectory(road, distances, drift)
    result = judge(road, Drive(path, rules=Rules(oob_tolerance=tolerance)))
    assert result.outcome is Outcome.FAIL
    assert result.reason.startswith(f"Car drove out of the lane to the {side} after ")
    departure = result.departure
    assert departure is not None
    assert departure.side == side
    shares = [outside(offset) for offset in drift]
    i = int(np.argmax(np.array(shares) > tolerance))
    # In a bend, the car's front and rear stand out a little further than on a straight road.
    slack = 0 if road is STRAIGHT else 4
    assert departure.time == pytest.approx(0.05 * i, abs=0.05 * slack + 1e-9)
    at = round(departure.time / 0.05)
    assert departure.distance == pytest.approx(distances[at], abs=1e-6)
    assert (departure.x, departure.y) == (path.x[at], path.y[at])
    assert result.duration == departure.time
    assert result.moobd == pytest.approx(2.0 - abs(drift[at]), abs=1e-6)
    assert result.moobd_distance == pytest.approx(distances[at], abs=1e-6)
    assert result.max_oob_share is not None
    assert tolerance < result.max_oob_share < tolerance + 0.1


@given(offset=st.floats(1.3, 2.7), left=st.booleans())
@settings(max_examples=50)
def test_a_share_equal_to_the_tolerance_is_tolerated(offset: float, left: bool) -> None:
    distances = steady(STRAIGHT)
    offsets = np.where(distances > 50.0, offset if left else -offset, 0.0)
    path = trajectory(STRAIGHT, distances, offsets)
    shares = assess(STRAIGHT, Drive(path, rules=Rules(oob_tolerance=1.0))).oob_share
    share = float(shares.max())
    assert share == pytest.approx(outside(offset), abs=1e-7)

    def verdict(tolerance: float) -> Result:
        return judge(STRAIGHT, Drive(path, rules=Rules(oob_tolerance=tolerance)))

    assert verdict(share).outcome is Outcome.PASS
    assert verdict(share).max_oob_share == share
    less = verdict(float(np.nextafter(shares[shares > 0.0].min(), 0.0)))
    assert less.outcome is Outcome.FAIL
    assert less.departure is not None
    assert less.departure.distance == pytest.approx(50.5)


def test_with_tolerance_1_nothing_but_time_ends_a_drive_off_the_road() -> None:
    distances = steady(STRAIGHT)
    result = judged(STRAIGHT, distances, 0.5 * distances, Rules(oob_tolerance=1.0))
    assert result.outcome is Outcome.ERROR  # the trajectory stops far to the left of the goal
    assert "before the drive had ended" in result.reason


def test_the_car_counts_as_it_is_long_and_wide() -> None:
    distances = steady(STRAIGHT)
    narrow, wide = CarBody(4.5, 1.0), CarBody(4.5, 3.0)
    rules = Rules(oob_tolerance=0.3)
    drift = 0.03 * distances
    for car in (narrow, wide):
        result = judged(STRAIGHT, distances, drift, rules, car=car)
        assert result.departure is not None
        shares = np.array([outside(offset, car.width) for offset in drift])
        assert result.departure.time == pytest.approx(0.05 * int(np.argmax(shares > 0.3)))


def test_a_car_that_stands_across_is_out_with_its_bumpers() -> None:
    path = trajectory(STRAIGHT, [0.0, 0.5, 1.0])
    across = replace(path, heading=path.heading + np.array([0.0, 0.0, 0.5 * math.pi]))
    seen = assess(STRAIGHT, Drive(across))
    assert seen.oob_share[:2] == pytest.approx([0.0, 0.0])
    assert seen.oob_share[2] == pytest.approx(1.0 - 4.0 / 4.508, abs=1e-9)
    assert seen.oob_distance[2] == pytest.approx(2.0)


# --- FAIL: time ----------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.05, 0.1, 0.02, 1.0 / 30.0, 1.0])
def test_a_car_that_never_starts_is_stuck_after_ten_seconds_and_not_before(period: float) -> None:
    n = round(10.0 / period)
    result = judged(STRAIGHT, np.zeros(n + 50), period=period)
    assert result.outcome is Outcome.FAIL
    assert result.reason == "Car moved less than 1 m in 10 s at 0 m"
    assert result.duration == pytest.approx(10.0, abs=1e-9)
    assert result.departure is None
    assert result.moobd == pytest.approx(2.0)
    early = judged(STRAIGHT, np.zeros(n), period=period)
    assert early.outcome is Outcome.ERROR


@pytest.mark.parametrize("period", [0.05, 0.1, 1.0 / 30.0])
def test_a_car_that_stops_on_its_way_is_stuck_ten_seconds_after_its_last_metre(
    period: float,
) -> None:
    times = np.arange(0.0, 60.0, period)
    distances = np.minimum(5.0 * times, 40.0)
    result = judged(STRAIGHT, distances, period=period)
    assert result.outcome is Outcome.FAIL
    # It was 1 m short of its place at 7.8 s; from then on it moved less.
    assert result.duration == pytest.approx(17.8, abs=1.01 * period)
    assert result.reason == "Car moved less than 1 m in 10 s at 40 m"


@pytest.mark.parametrize(("speed", "stuck"), [(0.09, True), (0.11, False)])
def test_a_metre_in_ten_seconds_is_enough(speed: float, stuck: bool) -> None:
    distances = speed * np.arange(0.0, 120.0, 0.05)
    result = judged(STRAIGHT, distances)
    assert result.outcome is Outcome.FAIL
    assert result.reason.startswith("Car moved less" if stuck else "Car took longer")
    assert result.duration == pytest.approx(10.0 if stuck else 60.05)


def test_other_rules_for_standing_still() -> None:
    rules = Rules(stuck_distance=3.0, stuck_time=2.0)
    result = judged(STRAIGHT, 1.4 * np.arange(0.0, 5.0, 0.05), rules=rules)
    assert result.reason == "Car moved less than 3 m in 2 s at 3 m"
    assert result.duration == pytest.approx(2.0)
    moving = judged(STRAIGHT, 1.6 * np.arange(0.0, 70.0, 0.05), rules=rules)
    assert moving.outcome is Outcome.PASS


@pytest.mark.parametrize(("samples", "timeout"), [(11, 60.0), (21, 100.0), (31, 140.0)])
def test_the_timeout_grows_with_the_road(samples: int, timeout: float) -> None:
    road = Road(np.zeros(samples))
    rules = Rules()
    assert rules.timeout(road.length) == pytest.approx(timeout)
    times = np.arange(0.0, timeout + 10.0, 0.05)
    slow = judged(road, 0.9 * times)
    assert slow.outcome is Outcome.FAIL
    assert slow.duration == pytest.approx(timeout + 0.05, abs=1e-6)
    assert slow.reason == (
        f"Car took longer than {timeout:.0f} s"
        f" and was at {0.9 * (timeout + 0.05):.0f} m of {road.length:.0f} m"
    )
    assert slow.departure is None
    assert slow.moobd == pytest.approx(2.0)
    in_time = judged(road, (road.length - 7.0) / (timeout - 0.1) * times)
    assert in_time.outcome is Outcome.PASS


def test_other_rules_for_the_timeout() -> None:
    rules = Rules(timeout_base=5.0, timeout_speed=10.0)
    assert rules.timeout(100.0) == pytest.approx(15.0)
    result = judged(STRAIGHT, 2.0 * np.arange(0.0, 40.0, 0.05), rules=rules)
    assert result.duration == pytest.approx(15.05)


# --- What counts ---------------------------------------------------------------------------------


def test_records_after_the_end_do_not_count() -> None:
    distances = steady(STRAIGHT)
    path = trajectory(STRAIGHT, distances, 0.01 * distances)
    passed = judge(STRAIGHT, Drive(path))
    assert passed.outcome is Outcome.PASS
    assert passed.duration is not None
    i = round(passed.duration / 0.05)
    wild = path.to_rows().copy()
    wild[i + 1 :, 1] += 50.0
    assert judge(STRAIGHT, Drive(Trajectory.from_rows(wild))) == passed
    assert judge(STRAIGHT, Drive(Trajectory.from_rows(wild[: i + 1]))) == passed

    failed = judged(STRAIGHT, distances, 0.1 * distances)
    assert failed.departure is not None
    # It comes back at once, but the drive is over.
    i = round(failed.departure.time / 0.05)
    back = np.where(np.arange(len(distances)) > i, 0.0, 0.1 * distances)
    assert judged(STRAIGHT, distances, back) == failed


def test_out_of_the_lane_within_reach_of_the_goal_is_a_fail() -> None:
    distances = steady(STRAIGHT)
    offsets = np.where(distances >= 93.0, 3.5, 0.0)
    assert judged(STRAIGHT, distances, offsets).outcome is Outcome.PASS
    offsets = np.where(distances >= 92.0, 3.5, 0.0)
    assert judged(STRAIGHT, distances, offsets).outcome is Outcome.FAIL


@pytest.mark.parametrize("records", [1, 2, 50])
def test_a_drive_that_stops_before_a_rule_ended_it_is_an_error(records: int) -> None:
    result = judged(STRAIGHT, steady(STRAIGHT)[:records])
    seconds = 0.05 * (records - 1)
    reason = f"The simulator stopped after {seconds:.1f} s, before the drive had ended"
    assert result == Result(Outcome.ERROR, reason, duration=seconds)


@pytest.mark.parametrize("column", ["time", "x", "y", "heading"])
def test_records_that_are_no_numbers_are_an_error(column: str) -> None:
    path = trajectory(STRAIGHT, steady(STRAIGHT))
    values = getattr(path, column).copy()
    values[50] = math.nan
    result = judge(STRAIGHT, Drive(replace(path, **{column: values})))
    assert result.outcome is Outcome.ERROR
    assert result.moobd is None


def test_a_drive_with_an_error_is_an_error_whatever_it_recorded() -> None:
    path = trajectory(STRAIGHT, steady(STRAIGHT))
    result = judge(STRAIGHT, Drive(path, error="the simulator's window was closed"))
    assert result.outcome is Outcome.ERROR
    assert result.reason == "the simulator's window was closed"
    assert (result.moobd, result.moobd_distance, result.max_oob_share) == (None, None, None)
    assert result.departure is None
    assert result.duration == path.time[-1]


@pytest.mark.parametrize("error", [None, "the simulator did not start"])
def test_an_empty_drive_is_an_error(error: str | None) -> None:
    result = judge(STRAIGHT, Drive(trajectory(STRAIGHT, []), error=error))
    assert result.outcome is Outcome.ERROR
    assert result.reason == (error or "The simulator recorded nothing")
    assert result.duration == 0.0
    assert result.moobd is None


# --- Oob distance --------------------------------------------------------------------------------


@pytest.mark.parametrize("kappa", [0.0, 0.05, -0.05, 0.069, -0.069])
@pytest.mark.parametrize(
    ("offset", "oob_distance"),
    [(0.0, 2.0), (2.0, 0.0), (-2.0, 0.0), (1.5, 0.5), (-1.5, 0.5), (2.3, -0.3), (-2.3, -0.3)],
)
def test_oob_distance_is_measured_from_the_lanes_centre(
    kappa: float, offset: float, oob_distance: float
) -> None:
    road = Road(np.full(8, kappa))
    distances = steady(road)
    offsets = np.where(distances >= 30.0, offset, 0.0)
    seen = assess(road, Drive(trajectory(road, distances, offsets)))
    assert seen.end == REACHED
    n = len(seen.distance)
    np.testing.assert_allclose(seen.distance, distances[:n], rtol=0, atol=1e-6)
    np.testing.assert_allclose(seen.lateral_offset, offsets[:n], rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        seen.oob_distance, np.where(distances[:n] >= 30.0, oob_distance, 2.0), rtol=0, atol=1e-6
    )
    result = judged(road, distances, offsets)
    assert result.moobd == pytest.approx(oob_distance, abs=1e-6)
    assert result.max_oob_share == seen.oob_share.max()


@pytest.mark.parametrize("road", [LEFT_TURN, RIGHT_TURN])
def test_the_least_oob_distance_is_reported_with_its_place(road: Road) -> None:
    distances = steady(road)
    offsets = 1.5 * np.exp(-(((distances - 42.0) / 5.0) ** 2))
    for sign in (1.0, -1.0):
        result = judged(road, distances, sign * offsets)
        assert result.moobd == pytest.approx(0.5, abs=1e-6)
        assert result.moobd_distance == pytest.approx(42.0, abs=1e-6)


def test_lanes_of_five_metres() -> None:
    road = Road(np.full(11, 0.02), lane_width=5.0)
    distances = steady(road)
    assert judged(road, distances).moobd == pytest.approx(2.5)
    assert judged(road, distances, 2.5).moobd == pytest.approx(0.0, abs=1e-6)
    # Where a lane of 4 m would end, nothing of the car is out yet.
    result = judged(road, distances, -(2.45 - 0.5 * WIDTH))
    assert result.max_oob_share == pytest.approx(0.0, abs=1e-9)
    drift = 0.047 * distances
    straight = Road(np.zeros(11), lane_width=5.0)
    result = judged(straight, distances, drift, Rules(oob_tolerance=0.5))
    assert result.departure is not None
    shares = np.array([outside(offset, lane_width=5.0) for offset in drift])
    assert result.departure.time == pytest.approx(0.05 * int(np.argmax(shares > 0.5)))


def test_a_car_keeps_to_its_piece_of_road_where_another_one_passes_close_by() -> None:
    """Across to the ego lane of the leg back is out of the lane, even where that one is nearer."""
    turn = 8
    kappa = math.pi / turn
    road = Road(np.concatenate([np.zeros(30), np.full(turn, kappa), np.zeros(30)]), 2.0)
    apart = -float(road.points[-1, 0])
    y = np.arange(0.0, 50.0, 0.5)
    # From the own lane's centre to the ego lane's centre on the leg back.
    x = 2.0 - np.clip(0.4 * (y - 5.0), 0.0, apart + 4.0)
    path = replace(trajectory(STRAIGHT, y), x=x, y=y)
    rules = Rules(oob_tolerance=1.0)
    seen = assess(road, Drive(path, rules=rules))
    assert len(seen.distance) == len(y)
    np.testing.assert_allclose(seen.distance, y, rtol=0, atol=1e-6)
    assert seen.oob_share[-1] == 1.0
    result = judge(road, Drive(path))
    assert result.departure is not None
    assert result.departure.side == "left"


@given(
    seed=st.integers(0, 2**32 - 1),
    x=st.floats(-500.0, 500.0),
    y=st.floats(-500.0, 500.0),
    turn=st.floats(-7.0, 7.0),
    drift=st.floats(0.005, 0.06) | st.floats(-0.06, -0.005),
)
@settings(max_examples=50)
def test_moving_and_turning_the_world_changes_no_verdict(
    seed: int, x: float, y: float, turn: float, drift: float
) -> None:
    rng = np.random.default_rng(seed)
    curvatures = 0.03 * rng.uniform(-1.0, 1.0, 10)
    here = Road(curvatures)
    there = Road(curvatures, pose=Pose(x, y, math.pi / 2 + turn))
    distances = steady(here)
    one = judged(here, distances, drift * distances)
    other = judged(there, distances, drift * distances)
    assert other.outcome is one.outcome
    assert other.duration == one.duration
    assert other.moobd == pytest.approx(one.moobd, abs=1e-6)
    assert other.moobd_distance == pytest.approx(one.moobd_distance, abs=1e-5)
    assert other.max_oob_share == pytest.approx(one.max_oob_share, abs=1e-6)
    assert (other.departure is None) == (one.departure is None)
    if other.departure is not None and one.departure is not None:
        assert other.departure.side == one.departure.side
        assert other.departure.distance == pytest.approx(one.departure.distance, abs=1e-5)


def test_an_assessment_ends_with_the_record_that_ended_the_drive() -> None:
    distances = steady(STRAIGHT)
    still = np.zeros(400)
    slow = 0.2 * np.arange(0.0, 70.0, 0.05)
    for path, end in [
        (trajectory(STRAIGHT, distances), REACHED),
        (trajectory(STRAIGHT, distances, 0.1 * distances), LEFT_LANE),
        (trajectory(STRAIGHT, still), STUCK),
        (trajectory(STRAIGHT, slow), TIMED_OUT),
        (trajectory(STRAIGHT, distances[:20]), RUNNING),
    ]:
        drive = Drive(path)
        seen = assess(STRAIGHT, drive)
        n = len(seen.distance)
        assert seen.end == end
        assert len(seen.lateral_offset) == len(seen.oob_distance) == len(seen.oob_share) == n
        assert path.time[n - 1] == judge(STRAIGHT, drive).duration


# --- Rules and records ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", [item.name for item in fields(Rules)])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_rules_that_are_not_positive_are_refused_by_name(name: str, value: float) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=f"{name} is {value}: a positive number is needed"):
        Rules(**options)


def test_a_tolerance_is_a_share() -> None:
    assert Rules(oob_tolerance=1.0).oob_tolerance == 1.0
    with pytest.raises(ValueError, match=r"oob_tolerance is 1\.5: a share above 0 and up to 1"):
        Rules(oob_tolerance=1.5)


def test_a_trajectory_survives_its_rows_and_cannot_be_changed() -> None:
    path = trajectory(LEFT_TURN, steady(LEFT_TURN), 0.3)
    rows = path.to_rows()
    assert rows.shape == (len(path), 11)
    again = Trajectory.from_rows(rows)
    for name in Trajectory.names():
        column = getattr(again, name)
        np.testing.assert_array_equal(column, getattr(path, name))
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1.0


def test_columns_of_unequal_length_are_refused_by_name() -> None:
    path = trajectory(STRAIGHT, [0.0, 1.0, 2.0])
    message = r"column speed has shape \(2,\), the time column \(3,\)"
    with pytest.raises(ValueError, match=message):
        replace(path, speed=np.zeros(2))
