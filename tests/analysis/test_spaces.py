"""Spaces in which failures are compared: closed cases."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.analysis.spaces import SPACES
from frenetic.campaign import Test
from frenetic.oracle.drive import CarBody, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result
from frenetic.road import Pose
from frenetic.search import Candidate, Origin
from frenetic.search.approach import SIZE
from frenetic.segments.values import SegmentValues
from frenetic.spec.terms import DriveSetting

SETTING = DriveSetting(rules=Rules(), car=CarBody())
HOME = Pose(0.0, 0.0, 0.0)


def failed(
    curvatures: FloatArray,
    place: float,
    *,
    pose: Pose = HOME,
    trajectory: Trajectory | None = None,
    time: float = 0.0,
) -> Test:
    """Return a test that failed at a place of a road with curvatures every 10 m."""
    return Test(
        candidate=Candidate(1, curvatures, 10.0, Origin("random")),
        result=Result(Outcome.FAIL, "", findings=(Finding.departure("left", place, time=time),)),
        result_number=1,
        budget_spent=0.0,
        pose=pose,
        setting=SETTING,
        trajectory=trajectory,
        stored_values=SegmentValues(place, "left", "lane", None, {}, 0.0, 0.0, np.zeros(SIZE)),
    )


def driven(speed: FloatArray, steering: float = 0.0, yaw_rate: float = 0.0) -> Trajectory:
    """Return a drive along a straight road, with a record every 0.05 s."""
    n, zeros = len(speed), np.zeros(len(speed))
    time = 0.05 * np.arange(n, dtype=np.float64)
    x = np.concatenate([[0.0], np.cumsum(0.05 * speed[:-1])])
    return Trajectory(
        time=time,
        x=x,
        y=np.full(n, -2.0),
        heading=zeros,
        speed=speed,
        lateral_speed=zeros,
        yaw_rate=np.full(n, yaw_rate),
        steering=np.full(n, steering),
        steering_input=zeros,
        throttle=zeros,
        brake=zeros,
    )


def vector(name: str, test: Test) -> FloatArray:
    """Return the vector of a failure in a space that has one."""
    values = SPACES[name].vector(test)
    assert values is not None
    return values


def difference(name: str, first: Test, second: Test) -> float:
    """Return the difference of two failures in a space."""
    return float(np.linalg.norm(vector(name, first) - vector(name, second)))


# The bend


def test_a_bend_and_a_straight_differ_by_the_curvature() -> None:
    straight, bend = failed(np.zeros(21), 100.0), failed(np.full(21, 0.02), 100.0)
    assert len(vector("bend", bend)) == 27
    assert difference("bend", straight, bend) == pytest.approx(1.0)


def test_mirror_images_differ_in_the_bend() -> None:
    curvatures = np.full(21, 0.02)
    left, right = failed(curvatures, 100.0), failed(-curvatures, 100.0)
    assert difference("bend", left, right) == pytest.approx(2.0)
    assert difference("road", left, right) > 0.0


def test_beyond_the_ends_of_the_road_the_curvature_is_zero() -> None:
    # 9 of the 27 places lie on the road: from 5 m before the place to 15 m after it.
    bend = vector("bend", failed(np.full(3, 0.02), 5.0))
    assert np.flatnonzero(bend).tolist() == [*range(18, 27)]


# The driven road


def test_turning_and_moving_a_road_does_not_matter() -> None:
    curvatures = 0.02 * np.sin(np.arange(30.0))
    here, there = failed(curvatures, 230.0), failed(curvatures, 230.0, pose=Pose(50.0, 70.0, 2.0))
    assert difference("road", here, there) == pytest.approx(0.0, abs=1e-9)
    assert difference("bend", here, there) == 0.0


def test_the_points_of_a_circle_follow_from_its_radius() -> None:
    points = vector("road", failed(np.full(31, 0.01), 300.0)).reshape(50, 2) * 10.0 * math.sqrt(50)
    angles = np.arange(200.0, 0.0, -4.0) / 100.0
    circle = 100.0 * np.column_stack([-np.sin(angles), 1.0 - np.cos(angles)])
    assert points == pytest.approx(circle, abs=1e-6)


def test_a_short_road_is_continued_straight_backwards() -> None:
    bend = np.concatenate([[0.0], np.full(5, 0.01)])  # the last 50 m of both roads
    short, long = failed(bend, 50.0), failed(np.concatenate([np.zeros(20), bend]), 250.0)
    assert difference("road", short, long) == pytest.approx(0.0, abs=1e-9)
    assert difference("road", short, failed(np.zeros(30), 250.0)) > 2.0


# The behaviour


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (driven(np.full(101, 13.0)), 1.0),
        (driven(np.full(101, 10.0), steering=0.15), 1.0),
        (driven(np.full(101, 10.0), yaw_rate=0.6), 2.0),
        (driven(np.full(101, 13.0), steering=0.15), math.sqrt(2.0)),
    ],
    ids=["speed", "steering", "lateral acceleration", "two together"],
)
def test_behaviours_differ_by_speed_steering_and_lateral_acceleration(
    other: Trajectory, expected: float
) -> None:
    road, usual = np.zeros(11), driven(np.full(101, 10.0))
    first = failed(road, 45.0, trajectory=usual, time=4.5)
    second = failed(road, 45.0, trajectory=other, time=4.5)
    assert len(vector("behaviour", first)) == 39
    assert difference("behaviour", first, second) == pytest.approx(expected)


def test_only_the_three_seconds_before_the_place_count() -> None:
    speed = np.where(np.arange(201) < 100, 3.0, 10.0)  # faster from 5 s on
    road, time = np.zeros(21), 0.05 * 170
    late = failed(road, 60.0, trajectory=driven(speed), time=time)
    steady = failed(road, 60.0, trajectory=driven(np.full(201, 10.0)), time=time)
    assert difference("behaviour", late, steady) == 0.0
    earlier = failed(road, 40.0, trajectory=driven(speed), time=0.05 * 120)
    assert difference("behaviour", earlier, steady) > 1.0


def test_before_the_start_of_the_drive_its_first_value_holds() -> None:
    speed = np.concatenate([np.full(20, 4.0), np.full(81, 10.0)])
    test = failed(np.zeros(11), 10.0, trajectory=driven(speed), time=1.5)
    speeds = vector("behaviour", test)[:13] * 3.0 * math.sqrt(13)
    assert speeds == pytest.approx([4.0] * 10 + [10.0] * 3)


def test_a_failure_without_records_or_with_odd_values_has_no_vector() -> None:
    undriven = replace(failed(np.zeros(11), 50.0), stored_values=None)
    assert [space.vector(undriven) for space in SPACES.values()] == [None] * 3
    for odd in (driven(np.full(3, np.nan)), driven(np.zeros(3), yaw_rate=math.inf)):
        test = failed(np.zeros(11), 50.0, trajectory=odd)
        assert SPACES["behaviour"].vector(test) is None
