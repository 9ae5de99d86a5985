"""Drivers that only steer or only choose their speed: the other half is the built-in drivers'."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from frenetic.drivers import (
    Controls,
    Driver,
    DriveSetup,
    Observation,
    Planner,
    SpeedOnly,
    Stanley,
    SteeringOnly,
    wanted_curvature,
)
from frenetic.oracle.drive import Drive, Rules
from frenetic.parts.registry import DRIVERS
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator
from frenetic.testing import DriverContract, TrackerContract

ROAD = Road([0.0] * 3 + [0.02] * 9 + [-0.02] * 9, 10.0)


class Pursuit(SteeringOnly):
    """Steers for a point 8 m ahead."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.wheelbase = setup.wheelbase

    def steer(self, observation: Observation) -> float:
        x, y = observation.ahead[4]
        return math.atan(2.0 * self.wheelbase * y / (x * x + y * y))


class Steady(SpeedOnly):
    """Drives at a speed."""

    def __init__(self, wanted: float = 8.0, **options: Any) -> None:
        super().__init__(**options)
        self.wanted = wanted

    def speed(self, observation: Observation) -> float:
        return self.wanted


class Push(SpeedOnly):
    """Accelerates by 1 m/s²."""

    def acceleration(self, observation: Observation) -> float:
        return 1.0


class TestSteeringOnly(TrackerContract):
    def make(self) -> Driver:
        return Pursuit()


class TestSpeedOnly(DriverContract):
    def make(self) -> Driver:
        return Steady()


class Pair:
    """The steering of one driver with the pedals of another."""

    def __init__(self, steering: Driver, pedals: Driver) -> None:
        self.steering, self.pedals = steering, pedals

    def reset(self, setup: DriveSetup) -> None:
        self.steering.reset(setup)
        self.pedals.reset(setup)

    def act(self, observation: Observation) -> Controls:
        return replace(
            self.pedals.act(observation), steering=self.steering.act(observation).steering
        )


def drive(driver: Driver, rules: Rules | None = None) -> Drive:
    driven = EmbeddedSimulator(rules=rules or Rules(speed_limit=50.0)).drive(ROAD, driver)
    assert driven.trouble is None, driven.trouble
    return driven


@pytest.mark.parametrize(
    ("options", "planner"),
    [
        ({}, Planner(lateral_acceleration=4.0)),
        ({"lateral": 2.0}, Planner(lateral_acceleration=2.0)),
        (
            {"lateral": 3.0, "aggression": 1.2},
            Planner(lateral_acceleration=3.0, aggression=1.2),
        ),
    ],
)
def test_a_driver_that_only_steers_drives_at_the_planners_speeds(
    options: dict[str, float], planner: Planner
) -> None:
    driven = drive(Pursuit(**options)).trajectory.to_rows()
    expected = drive(Pair(Pursuit(), planner)).trajectory.to_rows()
    np.testing.assert_array_equal(driven, expected)


@pytest.mark.parametrize(("law", "built_in"), [("stanley", Stanley()), ("planner", Planner())])
def test_a_driver_that_only_chooses_its_speed_keeps_its_lane_by_a_built_in_law(
    law: str, built_in: Driver
) -> None:
    driven = drive(Steady(law=law)).trajectory
    expected = drive(Pair(built_in, Steady())).trajectory
    np.testing.assert_array_equal(driven.to_rows(), expected.to_rows())
    assert driven.speed[-1] == pytest.approx(8.0, abs=0.1)


def test_an_acceleration_is_what_the_car_does() -> None:
    speed = drive(Push(), Rules(timeout_base=4.0, timeout_speed=1e3)).trajectory.speed
    assert speed[-1] - speed[-21] == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        (SteeringOnly(), "SteeringOnly needs a method steer(observation)"),
        (SpeedOnly(), "SpeedOnly needs a method speed(observation) or acceleration(observation)"),
    ],
)
def test_a_driver_without_its_half_says_which_method_it_needs(driver: Driver, message: str) -> None:
    trouble = EmbeddedSimulator().drive(ROAD, driver).trouble
    assert trouble is not None
    assert message in trouble.reason


@pytest.mark.parametrize("base", [SteeringOnly, SpeedOnly])
def test_a_reset_that_forgets_its_base_says_so(base: type[Any]) -> None:
    class Forgetful(base):  # type: ignore[misc]  # one of two classes
        def reset(self, setup: DriveSetup) -> None:
            pass

    trouble = EmbeddedSimulator().drive(ROAD, Forgetful()).trouble
    assert trouble is not None
    assert "reset of Forgetful does not call super().reset(setup)" in trouble.reason


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SteeringOnly(lateral=0.0), "lateral is 0.0"),
        (lambda: SteeringOnly(aggression=-1.0), "aggression is -1.0"),
        (lambda: SpeedOnly(law="pid"), "law is 'pid'"),  # type: ignore[arg-type]
    ],
)
def test_bad_options_are_refused_by_name(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_a_subclass_without_a_constructor_has_the_options(tmp_path: Any) -> None:
    file = tmp_path / "straight_on.py"
    file.write_text(
        "from frenetic.drivers import SteeringOnly\n"
        "class StraightOn(SteeringOnly):\n"
        "    def steer(self, observation):\n"
        "        return 0.0\n"
    )
    driver = DRIVERS.make(f"{file}:StraightOn", lateral=2.5)
    assert driver.lateral == 2.5


def test_a_subclass_may_keep_the_defaults_without_calling_the_constructor() -> None:
    class Own(Pursuit):
        def __init__(self, gain: float = 1.0) -> None:
            self.gain = gain

    np.testing.assert_array_equal(
        drive(Own()).trajectory.to_rows(), drive(Pursuit()).trajectory.to_rows()
    )


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_the_wanted_curvature_returns_to_the_lanes_middle_with_critical_damping(
    rate: float,
) -> None:
    """With y for the offset and v for the speed, v² κ = y'' = -2 rate y' - rate² y."""
    wanted: list[float] = []
    expected: list[float] = []

    class Watch(Stanley):
        def act(self, observation: Observation) -> Controls:
            off = replace(observation, lateral_offset=0.4, heading_error=0.02, lateral_speed=0.1)
            speed = max(off.speed, 3.0)
            across = speed * math.sin(0.02 + math.atan2(0.1, speed))
            wanted.append(wanted_curvature(off, rate=rate))
            expected.append(-(2.0 * rate * across + rate * rate * 0.4) / speed**2)
            return super().act(observation)

    EmbeddedSimulator().drive(Road([0.0] * 8, 10.0), Watch())
    assert len(wanted) > 100
    assert wanted == pytest.approx(expected, rel=1e-9)


def test_the_wanted_curvature_is_the_lanes_where_the_car_will_be() -> None:
    road, wanted = Road(list(np.linspace(0.0, 0.02, 15)), 10.0), []

    class Watch(Stanley):
        def act(self, observation: Observation) -> Controls:
            middle = replace(observation, lateral_offset=0.0, heading_error=0.0, lateral_speed=0.0)
            if 20.0 < middle.distance < 100.0:
                ahead = middle.lane(spacing=0.1, ahead=0.5 * middle.speed + 0.5)
                wanted.append((wanted_curvature(middle, preview=0.5), ahead.curvatures[-1]))
            return super().act(observation)

    EmbeddedSimulator().drive(road, Watch())
    assert len(wanted) > 50
    for curvature, lanes in wanted:
        assert curvature == pytest.approx(lanes, rel=0.05)
