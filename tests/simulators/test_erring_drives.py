"""Drives with sensors and steering that err, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bicycle import Bicycle

from frenetic import Controls, DriveSetup, EmbeddedSimulator, Observation, Road, Rules
from frenetic.conditions.condition import SEED
from frenetic.conditions.sensors_and_steering import SENSOR_CONDITIONS, STEERING_CONDITIONS
from frenetic.drivers import (
    BeamngAi,
    Driver,
    HeadingBias,
    LateralBias,
    Planner,
    SpeedBias,
    SpeedPlan,
    Stanley,
    SteeringGain,
    SteeringOffset,
    SteeringRate,
    YawRateBias,
)
from frenetic.drivers.compiled_form import compiled_form
from frenetic.drivers.loading import with_wrappers
from frenetic.oracle import Trajectory

CALM = Rules(speed_limit=40.0)
LIMIT = 40.0 / 3.6  # m/s
STRAIGHT = Road([0.0] * 60)
"""A road to the north."""


class PlannerInPython(Planner): ...


class StanleyInPython(Stanley): ...


class BeamngAiInPython(BeamngAi): ...


def drive(driver: Driver) -> Trajectory:
    """Return the trajectory of a drive on `STRAIGHT`."""
    return EmbeddedSimulator(rules=CALM).drive(STRAIGHT, driver).trajectory


def final_offset(driver: Driver) -> float:
    """Return the offset from the lane's centre at the end of a long straight road, in m."""
    offsets = STRAIGHT.sample(1, -0.5 * STRAIGHT.lane_width)[0][0] - drive(driver).x[-40:]
    assert np.ptp(offsets) < 2e-3, "it is steady"
    return float(offsets[-1])


@pytest.mark.parametrize("driver", [Planner(), Stanley(), PlannerInPython()])
def test_a_lateral_bias_ends_in_the_opposite_offset(driver: Driver) -> None:
    """A driver that reads the view ahead errs as one that reads the lateral offset."""
    assert final_offset(LateralBias(driver, 0.3)) == pytest.approx(-0.3, abs=2e-3)


def final_speed(driver: Driver) -> float:
    """Return the speed at the end of a long straight road, in m/s."""
    return float(drive(driver).speed[-1])


def test_a_heading_bias_ends_in_an_offset_that_steers_against_it() -> None:
    """Stanley: 0 = -h - atan(k e / (k_s + v)), where e = y + l sin h at the front axle."""
    error, stanley = 0.03, Stanley()
    front = EmbeddedSimulator().vehicle.setup(CALM, STRAIGHT, 0.05).front_axle
    speed = final_speed(HeadingBias(stanley, error))
    at_axle = -math.tan(error) * (stanley.softening + speed) / stanley.offset_gain
    expected = at_axle - front * math.sin(error)
    assert final_offset(HeadingBias(stanley, error)) == pytest.approx(expected, rel=0.01)


def test_a_heading_bias_turns_the_road_ahead() -> None:
    """Pure pursuit: the point at the distance L seems straight ahead if y = -L tan h."""
    error, planner = 0.03, Planner()
    speed = final_speed(HeadingBias(planner, error))
    distance = planner.lookahead_min + planner.lookahead_time * speed
    expected = -distance * math.tan(error)
    assert final_offset(HeadingBias(planner, error)) == pytest.approx(expected, rel=0.01)


def test_a_yaw_rate_bias_ends_in_an_offset_by_stanleys_damping() -> None:
    """Stanley: 0 = -d b - atan(k y / (k_s + v))."""
    error, stanley = 0.3, Stanley()
    speed = final_speed(YawRateBias(stanley, error))
    expected = -math.tan(stanley.yaw_damping * error) * (stanley.softening + speed)
    expected /= stanley.offset_gain
    assert final_offset(YawRateBias(stanley, error)) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("bias", [-9.0, 5.4])
def test_a_speed_bias_ends_in_the_opposite_speed(bias: float) -> None:
    """The speed is the limit less the bias, and the pedal's error that holds it against drag."""
    without_bias, with_bias = final_speed(Planner()), final_speed(SpeedBias(Planner(), bias))
    assert with_bias - without_bias == pytest.approx(-bias / 3.6, abs=0.1)
    assert without_bias == pytest.approx(LIMIT, abs=0.3)


def test_a_steering_offset_ends_in_an_offset_that_commands_against_it() -> None:
    """Stanley: the wheels are straight if its command is -o = -atan(k y / (k_s + v))."""
    offset, stanley = 0.02, Stanley()
    speed = final_speed(SteeringOffset(stanley, offset))
    expected = math.tan(offset) * (stanley.softening + speed) / stanley.offset_gain
    assert final_offset(SteeringOffset(stanley, offset)) == pytest.approx(expected, rel=0.01)


class Proportional:
    """A driver that steers for the lane's curvature and in proportion to offset and heading."""

    def reset(self, setup: DriveSetup) -> None:
        self.plan, self.wheelbase = SpeedPlan(setup), setup.wheelbase

    def act(self, view: Observation) -> Controls:
        command = math.atan(self.wheelbase * view.curvature_ahead[0])
        command -= 0.1 * view.lateral_offset + view.heading_error
        return self.plan.controls(view, command)


class Witness:
    """A wrapper that keeps the observations."""

    def __init__(self, driver: Driver) -> None:
        self.driver = driver

    def reset(self, setup: DriveSetup) -> None:
        self.driver.reset(setup)
        self.views: list[Observation] = []

    def act(self, view: Observation) -> Controls:
        self.views.append(view)
        return self.driver.act(view)


@pytest.mark.parametrize("gain", [0.7, 1.3])
def test_a_gain_ends_in_an_offset_in_a_steady_bend(gain: float) -> None:
    """The wheels of a kinematic car are g (atan(L k) - K y - H h) = atan(L k / (1 - k y)).

    That is the angle for the lane's parallel at y, whose curvature is k / (1 - k y). The heading
    error h is half of the turn in a period, in which the car moves straight.
    """
    witness = Witness(SteeringGain(Proportional(), gain))
    Bicycle(rules=Rules(speed_limit=15.0)).drive(Road([0.0, 0.0, *[0.02] * 12]), witness)
    view, wheelbase = witness.views[-20], 2.6
    curvature, offset = float(view.curvature_ahead[0]), view.lateral_offset
    turned = 0.5 * 0.05 * view.speed * curvature
    command = math.atan(wheelbase * curvature) - 0.1 * offset - turned
    needed = math.atan(wheelbase * curvature / (1.0 - curvature * offset))
    assert gain * command == pytest.approx(needed, rel=2e-3)
    assert abs(offset) > 0.05


class Steady:
    """A driver that always asks for the same angle."""

    def reset(self, setup: DriveSetup) -> None: ...

    def act(self, view: Observation) -> Controls:
        return Controls(0.1, throttle=0.1)


def test_a_rate_limits_the_wheels_of_a_car() -> None:
    """The angle of a kinematic car's wheels is rate times time until it is what was asked."""
    driver = SteeringRate(Steady(), 0.2)
    wheels = Bicycle().drive(STRAIGHT, driver).trajectory.steering[:20]
    np.testing.assert_allclose(wheels, np.minimum(0.2 * 0.05 * np.arange(20), 0.1), atol=1e-12)


BENDS = Road([0.0, 0.0, 0.01, 0.03, 0.05, 0.05, 0.02, -0.02, -0.04, -0.04, 0.0, 0.0])


def records(driver: Driver) -> bytes:
    """Return the records of a drive through bends."""
    return EmbeddedSimulator().drive(BENDS, driver).trajectory.to_rows().tobytes()


@pytest.mark.parametrize(
    ("compiled", "in_python"),
    [(Planner, PlannerInPython), (Stanley, StanleyInPython), (BeamngAi, BeamngAiInPython)],
)
def test_compiled_drives_are_the_drives_in_python(
    compiled: type[Driver], in_python: type[Driver]
) -> None:
    each = [
        {condition.name: 0.3 if condition.name == "steering_rate" else condition.usual[1]}
        for condition in STEERING_CONDITIONS + SENSOR_CONDITIONS
    ]
    together = {name: amount for amounts in each for name, amount in amounts.items()}
    mild = {
        condition.name: 0.2 * condition.usual[1]
        for condition in STEERING_CONDITIONS + SENSOR_CONDITIONS
    } | {"steering_gain": 1.1}
    mixed = {**mild, "noise": 0.1, SEED: 7, "delay": 0.1, "view": 40.0, "overspeed": 5.0}
    for amounts in (*each, together, mixed):
        driver = with_wrappers(compiled(), amounts)
        assert compiled_form(driver, 0.05) is not None
        other = with_wrappers(in_python(), amounts)
        assert compiled_form(other, 0.05) is None
        assert records(driver) == records(other), amounts
