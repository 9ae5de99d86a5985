"""`SteppedSimulator`, the base class of simulators that move step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from frenetic import DriveSetup, Road, Stanley
from frenetic.errors import DriverError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Pose
from frenetic.simulators import Motion, SteppedSimulator
from frenetic.simulators.capabilities import capabilities, check_pair

HALF_TURN = Road([0.0, 0.0, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.0, 0.0])


class Bicycle(SteppedSimulator):
    """A kinematic bicycle with headings in -pi..pi; its position is nan after `breaks_at` s."""

    breaks_at = math.inf

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:
        self.motion, self.time = Motion(*pose), 0.0
        self.asked: list[float] = []
        self.lengths: set[float] = set()
        self.wheelbase = setup.wheelbase
        return self.motion

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        self.time += seconds
        self.lengths.add(round(seconds, 9))
        self.asked.append(steering)
        x, y, heading, speed, *_ = self.motion
        speed = max(speed + seconds * (4.0 * throttle - 9.0 * brake), 0.0)
        yaw_rate = speed * math.tan(steering) / self.wheelbase
        heading = math.remainder(heading + seconds * yaw_rate, math.tau)
        x, y = x + seconds * speed * math.cos(heading), y + seconds * speed * math.sin(heading)
        if self.time > self.breaks_at:
            x = math.nan
        self.motion = Motion(x, y, heading, speed, 0.0, yaw_rate, steering)
        return self.motion


def test_headings_are_unwrapped_and_steering_is_cut() -> None:
    simulator = Bicycle()
    drive = simulator.drive(HALF_TURN, Stanley())
    assert judge(HALF_TURN, drive).outcome is Outcome.PASS
    heading = drive.trajectory.heading
    assert np.abs(np.diff(heading)).max() < 0.2
    assert heading[-1] - heading[0] > 2.5
    simulator.max_steering = 0.05  # type: ignore[misc]
    simulator.drive(HALF_TURN, Stanley())
    assert max(simulator.asked) == 0.05


def test_the_start_of_the_car_can_be_varied() -> None:
    simulator = Bicycle()
    assert {"rules", "start_offset", "start_heading"} == capabilities(simulator).variable
    simulator.start_offset, simulator.start_heading = 0.5, -0.2
    t = simulator.drive(HALF_TURN, Stanley()).trajectory
    ((s, d),) = HALF_TURN.track([[t.x[0], t.y[0]]])
    assert (s, d) == pytest.approx((0.0, 0.5 - 2.0), abs=1e-9)
    assert t.heading[0] == pytest.approx(HALF_TURN.pose.heading - 0.2)


def test_a_motion_of_nan_is_the_fault_of_the_simulator() -> None:
    simulator = Bicycle()
    simulator.breaks_at = 1.0
    with pytest.raises(ArithmeticError, match="the physics broke: the car's motion is"):
        simulator.drive(HALF_TURN, Stanley())


class OverwritesCar(Bicycle):
    """A simulator that overwrites `car`, the box of its car, with another object."""

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:
        self.car = object()  # type: ignore[assignment]
        return super().start(road, pose, setup)


def test_an_overwritten_car_box_is_an_error_that_names_it() -> None:
    simulator = OverwritesCar()
    for _ in range(2):
        with pytest.raises(
            TypeError, match=r"OverwritesCar\.car is the box .* keep the object under"
        ):
            simulator.drive(HALF_TURN, Stanley())


class SlowStanley(Stanley):
    """Stanley with a period of 0.1 s."""

    period = 0.1


def test_steps_are_as_long_as_the_drivers_period_allows() -> None:
    simulator, driver = Bicycle(), SlowStanley()
    assert judge(HALF_TURN, simulator.drive(HALF_TURN, driver)).outcome is Outcome.PASS
    assert simulator.lengths == {0.05}
    driver.period = 0.02
    with pytest.raises(DriverError, match=r"multiples of 0\.05 s"):
        check_pair(simulator, driver)
    simulator.period_step = 0.01  # type: ignore[misc]
    assert judge(HALF_TURN, simulator.drive(HALF_TURN, driver)).outcome is Outcome.PASS
    assert simulator.lengths == {0.01}
