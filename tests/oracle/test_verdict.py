"""How drives end: passes, failures and errors, and the oob distance."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from frenetic.criteria.criterion import DRIVER
from frenetic.errors import Fault, Trouble
from frenetic.oracle.assessment import LEFT_LANE, REACHED, RUNNING, STUCK, TIMED_OUT, assess
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.road import Pose, Road

FloatArray = npt.NDArray[np.float64]

STRAIGHT = Road(np.zeros(11))
"""A straight road of 100 m."""
LEFT_TURN = Road(np.full(11, 0.03))
RIGHT_TURN = Road(np.full(11, -0.03))
WIDTH = CarBody().width


def trajectory(
    road: Road,
    distances: npt.ArrayLike,
    offsets: npt.ArrayLike = 0.0,
    period: float = 0.05,
) -> Trajectory:
    """Return the path of a car at m along the road and m left of the ego lane's centre, aligned."""
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
    """Return distances of a car that drives at constant speed from the road's start to its end."""
    return np.arange(0.0, road.length + 1e-9, speed * period)


def judged(
    road: Road,
    distances: npt.ArrayLike,
    offsets: npt.ArrayLike = 0.0,
    rules: Rules | None = None,
    period: float = 0.05,
    car: CarBody | None = None,
) -> Result:
    """Return the verdict on a car at these distances and offsets."""
    path = trajectory(road, distances, offsets, period)
    return judge(road, Drive(path, car or CarBody(), rules or Rules()))


def outside(offset: float, width: float = WIDTH, lane_width: float = 4.0) -> float:
    """Return the oob share of an aligned car on a straight road, in closed form."""
    return min(max((abs(offset) + 0.5 * width - 0.5 * lane_width) / width, 0.0), 1.0)


# --- PASS ----------------------------------------------------------------------------------------


def expected_end(
    distances: FloatArray, offsets: FloatArray, period: float, rules: Rules, road: Road
) -> tuple[int, int]:
    """Return how and at which record a drive on a straight road ends, by the text of the rules."""
    for i, (s, offset) in enumerate(zip(distances, offsets, strict=True)):
        time = i * period
        long_ago = [j for j in range(i + 1) if time - j * period >= rules.stuck_time - 1e-9]
        if outside(offset, lane_width=road.lane_width) > rules.oob_tolerance:
            return LEFT_LANE, i
        if math.hypot(road.length - s, offset - 0.5 * road.lane_width) <= rules.goal_distance or (
            s >= road.length - 1e-9 and abs(offset) <= 0.5 * road.lane_width
        ):
            return REACHED, i
        if long_ago and math.hypot(s - distances[long_ago[-1]], offset - offsets[long_ago[-1]]) < (
            rules.stuck_distance
        ):
            return STUCK, i
        if time > rules.timeout_base + road.length / rules.timeout_speed:
            return TIMED_OUT, i
    return RUNNING, len(distances) - 1


REASONS = {
    REACHED: (Outcome.PASS, "Car reached the end of the road"),
    LEFT_LANE: (Outcome.FAIL, "Car drove out of the lane to the "),
    STUCK: (Outcome.FAIL, "Car moved less than "),
    TIMED_OUT: (Outcome.FAIL, "Car took longer than "),
    RUNNING: (Outcome.ERROR, "The simulator stopped after "),
}


@given(
    legs=st.lists(  # s, m/s, m/s to the left
        st.tuples(
            st.sampled_from([0.5, 2.0, 4.0, 9.0]),
            st.sampled_from([0.0, 0.31, 2.03, 5.07, 12.1]),
            st.sampled_from([0.0, 0.0, 0.29, -0.29, 1.53, -1.53]),
        ),
        min_size=1,
        max_size=6,
    ),
    period=st.sampled_from([0.05, 0.1, 1.0 / 30.0]),
    rules=st.builds(
        Rules,
        oob_tolerance=st.sampled_from([0.1, 0.5, 0.95, 1.0]),
        goal_distance=st.sampled_from([1.0, 3.0, 8.0, 20.0]),
        stuck_distance=st.sampled_from([1.0, 3.0]),
        stuck_time=st.sampled_from([2.0, 10.0]),
        timeout_base=st.sampled_from([5.0, 20.0]),
        timeout_speed=st.sampled_from([2.5, 10.0]),
    ),
    lane_width=st.sampled_from([4.0, 5.0]),
    length=st.sampled_from([30.0, 60.0]),
)
@settings(max_examples=300)
def test_drives_end_by_the_text_of_the_rules(
    legs: list[tuple[float, float, float]],
    period: float,
    rules: Rules,
    lane_width: float,
    length: float,
) -> None:
    road = Road(np.zeros(4), length / 3.0, lane_width=lane_width)
    steps = [[(v * period, side * period)] * round(s / period) for s, v, side in legs]
    distances, offsets = np.cumsum(np.concatenate([[(0.0, 0.0)], *steps]), axis=0).T
    path = trajectory(road, distances, offsets, period)
    end, last = expected_end(distances, offsets, period, rules, road)
    assessment, result = (
        assess(road, Drive(path, rules=rules)),
        judge(road, Drive(path, rules=rules)),
    )
    assert (assessment.end, len(assessment.distance)) == (end, last + 1)
    outcome, reason = REASONS[end]
    assert result.outcome is outcome
    assert result.reason.startswith(reason)
    assert result.duration == path.time[last]
    np.testing.assert_allclose(assessment.distance, distances[: last + 1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(assessment.lateral_offset, offsets[: last + 1], rtol=0, atol=1e-6)
    shares = [outside(offset, lane_width=lane_width) for offset in offsets[: last + 1]]
    np.testing.assert_allclose(assessment.oob_share, shares, rtol=0, atol=1e-6)
    if end == RUNNING:
        assert (result.moobd, result.findings) == (None, ())
        return
    away = np.abs(offsets[: last + 1])
    assert result.moobd == pytest.approx(0.5 * lane_width - away.max(), abs=1e-6)
    assert result.max_oob_share == pytest.approx(max(shares), abs=1e-6)
    departure = result.departure
    assert (departure is not None) == (end == LEFT_LANE)
    if departure is not None:
        assert departure.side == ("left" if offsets[last] > 0.0 else "right")
        assert (departure.time, departure.x, departure.y) == (
            *(path.time[last], path.x[last], path.y[last]),
        )
        assert departure.distance == pytest.approx(distances[last], abs=1e-6)


def test_a_drive_that_stops_just_before_the_goal_has_not_passed() -> None:
    # The lane's centre is 2 m beside the road's last point.
    goal = STRAIGHT.length - math.sqrt(8.0**2 - 2.0**2)
    assert judged(STRAIGHT, [0.0, goal + 1e-6]).outcome is Outcome.PASS
    assert judged(STRAIGHT, [0.0, goal - 1e-6]).outcome is Outcome.ERROR


@pytest.mark.parametrize(("lane_width", "goal"), [(16.0, 8.0), (40.0, 8.0), (4.0, 1.0)])
def test_reaching_the_end_does_not_depend_on_lane_width_or_goal_distance(
    lane_width: float, goal: float
) -> None:
    road = Road(np.zeros(11), lane_width=lane_width)
    result = judged(road, steady(road), rules=Rules(goal_distance=goal))
    assert result.outcome is Outcome.PASS
    assert result.moobd == pytest.approx(lane_width / 2.0)
    elsewhere = Rules(oob_tolerance=1.0, goal_distance=0.1)
    beside = judged(road, steady(road), 0.5 * lane_width + 1.0, elsewhere)
    # In the other lane, only the time limit ends the drive.
    assert beside.outcome is Outcome.ERROR


def test_a_car_near_the_roads_end_at_the_start_has_not_passed() -> None:
    """A circle ends where it starts."""
    circle = Road(np.full(13, 2.0 * math.pi / 120.0))
    path = trajectory(circle, steady(circle))
    assert math.hypot(path.x[0], path.y[0]) < 8.0
    result = judge(circle, Drive(path))
    assert result.outcome is Outcome.PASS
    assert result.duration == pytest.approx((120.0 - 8.0) / 10.0, abs=0.15)


# --- FAIL: out of the lane -----------------------------------------------------------------------


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
    stricter = verdict(float(np.nextafter(shares[shares > 0.0].min(), 0.0)))
    assert stricter.outcome is Outcome.FAIL
    assert stricter.departure is not None
    assert stricter.departure.distance == pytest.approx(50.5)


def test_the_share_follows_the_width_of_the_car() -> None:
    distances = steady(STRAIGHT)
    narrow, wide = CarBody(4.5, 1.0), CarBody(4.5, 3.0)
    rules = Rules(oob_tolerance=0.3)
    drift = 0.03 * distances
    for car in (narrow, wide):
        result = judged(STRAIGHT, distances, drift, rules, car=car)
        assert result.departure is not None
        shares = np.array([outside(offset, car.width) for offset in drift])
        assert result.departure.time == pytest.approx(0.05 * int(np.argmax(shares > 0.3)))


def test_a_car_across_its_lane_is_outside_with_its_bumpers() -> None:
    path = trajectory(STRAIGHT, [0.0, 0.5, 1.0])
    across = replace(path, heading=path.heading + np.array([0.0, 0.0, 0.5 * math.pi]))
    assessment = assess(STRAIGHT, Drive(across))
    assert assessment.oob_share[:2] == pytest.approx([0.0, 0.0])
    assert assessment.oob_share[2] == pytest.approx(1.0 - 4.0 / 4.508, abs=1e-9)
    assert assessment.oob_distance[2] == pytest.approx(2.0)


def test_reasons_name_place_and_limit() -> None:
    assert judged(STRAIGHT, np.zeros(300)).reason == "Car moved less than 1 m in 10 s at 0 m"
    slow = judged(STRAIGHT, 0.9 * np.arange(0.0, 70.0, 0.05))
    assert slow.reason == "Car took longer than 60 s and was at 54 m of 100 m"
    drift = judged(STRAIGHT, steady(STRAIGHT), 0.047 * steady(STRAIGHT))
    assert drift.reason == (
        "Car drove out of the lane to the left after 58 m: 95.1% of it outside, 95% tolerated"
    )


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
    # The car comes returning at once, but the drive is over.
    i = round(failed.departure.time / 0.05)
    returning = np.where(np.arange(len(distances)) > i, 0.0, 0.1 * distances)
    assert judged(STRAIGHT, distances, returning) == failed


@pytest.mark.parametrize("column", ["time", "x", "y", "heading"])
def test_a_record_of_nan_is_an_error(column: str) -> None:
    path = trajectory(STRAIGHT, steady(STRAIGHT))
    values = getattr(path, column).copy()
    values[50] = math.nan
    result = judge(STRAIGHT, Drive(replace(path, **{column: values})))
    assert result.outcome is Outcome.ERROR
    assert result.moobd is None


def test_a_drive_with_trouble_is_an_error_in_spite_of_its_records() -> None:
    path = trajectory(STRAIGHT, steady(STRAIGHT))
    result = judge(STRAIGHT, Drive(path, trouble=Trouble("the simulator's window was closed")))
    assert result.outcome is Outcome.ERROR
    assert result.reason == "the simulator's window was closed"
    assert (result.moobd, result.moobd_distance, result.max_oob_share) == (None, None, None)
    assert result.departure is None
    assert (result.duration, result.distance) == (path.time[-1], None)


def test_a_fault_of_the_driver_fails_its_drive() -> None:
    fault = Fault("driver", "ValueError", "mine.py", 41)
    path = trajectory(STRAIGHT, steady(STRAIGHT))
    until = Trajectory.from_rows(path.to_rows()[:60])
    passed = judge(STRAIGHT, Drive(path))
    result = judge(STRAIGHT, Drive(until, trouble=Trouble("it raised", fault=fault)))
    assert (result.outcome, result.reason, result.fault) == (Outcome.FAIL, "it raised", fault)
    assert result.moobd == pytest.approx(2.0)
    (finding,) = result.findings
    assert (finding.criterion, finding.side, finding.value, finding.limit) == (DRIVER, None, 1, 0)
    assert (finding.time, finding.x, finding.y) == (until.time[-1], until.x[-1], until.y[-1])
    assert result.departure is None
    unrecorded = judge(STRAIGHT, Drive(Trajectory.empty(), trouble=Trouble("it left", fault=fault)))
    assert (unrecorded.outcome, unrecorded.moobd) == (Outcome.FAIL, None)
    # A fault after the end of a drive does not count; a fault of the simulator is no failure.
    assert judge(STRAIGHT, Drive(path, trouble=Trouble("too late", fault=fault))) == passed
    simulators_fault = replace(fault, part="simulator")
    assert (
        judge(STRAIGHT, Drive(until, trouble=Trouble("x", fault=simulators_fault))).outcome
        is Outcome.ERROR
    )


def test_trouble_that_is_a_text_is_refused() -> None:
    text: Any = "no connection"
    with pytest.raises(TypeError, match="trouble is 'no connection': a frenetic"):
        Drive(Trajectory.empty(), trouble=text)


@pytest.mark.parametrize("trouble", [None, Trouble("the simulator did not start")])
def test_an_empty_drive_is_an_error(trouble: Trouble | None) -> None:
    result = judge(STRAIGHT, Drive(trajectory(STRAIGHT, []), trouble=trouble))
    assert result.outcome is Outcome.ERROR
    assert result.reason == (trouble.reason if trouble else "The simulator recorded nothing")
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
    assessment = assess(road, Drive(trajectory(road, distances, offsets)))
    assert assessment.end == REACHED
    n = len(assessment.distance)
    np.testing.assert_allclose(assessment.distance, distances[:n], rtol=0, atol=1e-6)
    np.testing.assert_allclose(assessment.lateral_offset, offsets[:n], rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        assessment.oob_distance,
        np.where(distances[:n] >= 30.0, oob_distance, 2.0),
        rtol=0,
        atol=1e-6,
    )
    result = judged(road, distances, offsets)
    assert result.moobd == pytest.approx(oob_distance, abs=1e-6)
    assert result.max_oob_share == assessment.oob_share.max()


def test_a_car_is_judged_on_its_own_leg_of_a_hairpin() -> None:
    """A car that crosses to the leg back has left its lane, even where that leg is nearer."""
    turn = np.full(8, math.pi / 8.0)
    step = 9.0 / -float(Road([0.0, *turn, 0.0], 1.0).points[-1, 0])
    leg = np.zeros(math.ceil(60.0 / step))
    road = Road(np.concatenate([leg, turn / step, leg]), step)
    y = np.arange(0.0, 50.0, 0.5)
    # From the centre of the car's lane to the ego lane's centre on the leg back, 9 m to the left.
    x = 2.0 - np.clip(0.4 * (y - 5.0), 0.0, 9.0 + 4.0)
    path = replace(trajectory(STRAIGHT, y), x=x, y=y)
    rules = Rules(oob_tolerance=1.0)
    assessment = assess(road, Drive(path, rules=rules))
    assert len(assessment.distance) == len(y)
    np.testing.assert_allclose(assessment.distance, y, rtol=0, atol=1e-6)
    assert assessment.oob_share[-1] == 1.0
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
def test_a_moved_and_turned_road_has_the_same_verdict(
    seed: int, x: float, y: float, turn: float, drift: float
) -> None:
    rng = np.random.default_rng(seed)
    curvatures = 0.03 * rng.uniform(-1.0, 1.0, 10)
    road = Road(curvatures)
    moved_road = Road(curvatures, pose=Pose(x, y, math.pi / 2 + turn))
    distances = steady(road)
    result = judged(road, distances, drift * distances)
    moved = judged(moved_road, distances, drift * distances)
    assert moved.outcome is result.outcome
    assert moved.duration == result.duration
    assert moved.moobd == pytest.approx(result.moobd, abs=1e-6)
    assert moved.moobd_distance == pytest.approx(result.moobd_distance, abs=1e-5)
    assert moved.max_oob_share == pytest.approx(result.max_oob_share, abs=1e-6)
    assert (moved.departure is None) == (result.departure is None)
    if moved.departure is not None and result.departure is not None:
        assert moved.departure.side == result.departure.side
        assert moved.departure.distance == pytest.approx(result.departure.distance, abs=1e-5)


# --- Rules and records ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", [item.name for item in fields(Rules) if item.type == "float"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_rules_that_are_not_positive_are_refused_by_name(name: str, value: float) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=f"{name} is {value}: a positive number is needed"):
        Rules(**options)


def test_a_tolerance_above_1_is_refused() -> None:
    assert Rules(oob_tolerance=1.0).oob_tolerance == 1.0
    with pytest.raises(ValueError, match=r"oob_tolerance is 1\.5: a share above 0 and up to 1"):
        Rules(oob_tolerance=1.5)


def test_a_trajectory_is_restored_from_its_rows_and_is_read_only() -> None:
    path = trajectory(LEFT_TURN, steady(LEFT_TURN), 0.3)
    rows = path.to_rows()
    assert rows.shape == (len(path), 11)
    from_rows = Trajectory.from_rows(rows)
    for name in Trajectory.names():
        column = getattr(from_rows, name)
        np.testing.assert_array_equal(column, getattr(path, name))
        with pytest.raises(ValueError, match="read-only"):
            column[0] = 1.0


def test_columns_of_unequal_length_are_refused_by_name() -> None:
    path = trajectory(STRAIGHT, [0.0, 1.0, 2.0])
    message = r"column speed has shape \(2,\), the time column \(3,\)"
    with pytest.raises(ValueError, match=message):
        replace(path, speed=np.zeros(2))
