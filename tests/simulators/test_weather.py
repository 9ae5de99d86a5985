"""Wet stretches, gusts, loads and hasty drivers, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from frenetic import EmbeddedSimulator, Road
from frenetic._support.arrays import FloatArray
from frenetic.drivers import Controls, Driver, DriveSetup, Observation, Planner, Stanley
from frenetic.drivers.wrappers import Hasty
from frenetic.errors import FreneticError
from frenetic.oracle import Trajectory
from frenetic.simulators.conditions import in_conditions
from frenetic.simulators.embedded.vehicle import AIR_DENSITY, PULL_LEFT, Vehicle
from frenetic.simulators.embedded.weather import (
    GUST_LENGTH,
    SIDE_AREA,
    WET_LENGTH,
    in_gust,
    weather_array,
)

STRAIGHT = Road([0.0] * 31)
BEND = Road([0.0] * 8 + [0.01, 0.02, 0.02, 0.02, 0.02, 0.01] + [0.0] * 12)


class FullThrottle:
    """A driver with straight wheels: full throttle for some seconds, then a constant brake."""

    def __init__(self, seconds: float = 4.0, brake: float = 0.0) -> None:
        self.calls, self.seconds, self.brake = 0, seconds, brake

    def reset(self, setup: DriveSetup) -> None:
        self.calls, self.period = 0, setup.period

    def act(self, observation: Observation) -> Controls:
        self.calls += 1
        if self.calls * self.period <= self.seconds:
            return Controls(0.0, throttle=1.0)
        return Controls(0.0, brake=self.brake)


def way(drive: Trajectory) -> FloatArray:
    """Return the distance from the start on a straight road, in m."""
    distances: FloatArray = np.hypot(drive.x - drive.x[0], drive.y - drive.y[0])
    return distances


def rows(simulator: EmbeddedSimulator, driver: Driver, road: Road = BEND) -> FloatArray:
    """Return the records of a drive."""
    return simulator.drive(road, driver).trajectory.to_rows()


@pytest.mark.parametrize("driver", [Planner, Stanley])
@pytest.mark.parametrize(
    "conditions",
    [{"wet": 0.4, "wet_at": 110.0}, {"gust": 15.0, "gust_at": 90.0}, {"load": 300.0},
     {"overspeed": 20.0}, {"wet": 0.5, "gust": -10.0, "load": 100.0, "overspeed": 10.0}],
)  # fmt: skip
def test_compiled_and_python_drivers_drive_alike_in_weather(
    driver: type[Planner], conditions: dict[str, float]
) -> None:
    class Subclass(driver):  # type: ignore[misc, valid-type]
        pass

    simulator = EmbeddedSimulator()
    without_conditions = rows(simulator, driver())
    with in_conditions(conditions, simulator, driver()) as there:
        compiled = rows(simulator, there)
    with in_conditions(conditions, simulator, Subclass()) as there:
        called = rows(simulator, there)
    assert np.array_equal(compiled, called)
    assert compiled.shape != without_conditions.shape or not np.array_equal(
        compiled, without_conditions
    )
    assert np.array_equal(rows(simulator, driver()), without_conditions), "the conditions stayed"


def test_a_gust_pushes_by_its_formula_and_only_at_its_place() -> None:
    car = Vehicle()
    weather = weather_array(car, 1.0, 12.0, 0.0, 100.0)
    assert weather is not None
    state = np.array([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
    for away in (-30.0, -15.0, 0.0, 25.0, 30.1):
        wind = 12.0 * 0.5 * (1.0 + math.cos(2.0 * math.pi * away / GUST_LENGTH))
        wind = wind if abs(away) < GUST_LENGTH / 2.0 else 0.0
        push = 0.5 * AIR_DENSITY * SIDE_AREA * wind * math.hypot(20.0, wind) / car.mass
        ground = in_gust(weather, car.to_array(), state, 100.0 + away)
        assert ground[PULL_LEFT] == pytest.approx(push)
    drive = (
        EmbeddedSimulator(gust=12.0, gust_at=100.0).drive(STRAIGHT, FullThrottle(20.0)).trajectory
    )
    place = STRAIGHT.track(np.column_stack([drive.x, drive.y]))
    before = place[:, 0] < 100.0 - GUST_LENGTH / 2.0 - 2.0
    assert np.all(np.abs(drive.lateral_speed[before]) < 1e-9)
    assert place[-1, 1] > place[0, 1] + 0.1, "the gust pushes to the left"


def test_a_gust_to_the_right_is_the_mirror_image() -> None:
    left = rows(EmbeddedSimulator(gust=9.0), FullThrottle(6.0), STRAIGHT)
    right = rows(EmbeddedSimulator(gust=-9.0), FullThrottle(6.0), STRAIGHT)
    n = min(len(left), len(right))
    assert np.allclose(left[:n, 6], -right[:n, 6], atol=1e-12)


def test_brakes_are_weaker_only_on_the_wet_stretch() -> None:
    road = Road([0.0] * 60)
    dry = EmbeddedSimulator().drive(road, FullThrottle(6.5, brake=1.0)).trajectory
    begin = float(np.interp(6.5, dry.time, way(dry)))
    wet = EmbeddedSimulator(wet=0.3, wet_at=begin + 12.0 + WET_LENGTH / 2.0)
    drive = wet.drive(road, FullThrottle(6.5, brake=1.0)).trajectory
    slowing = -np.gradient(drive.speed, drive.time)
    along = way(drive)
    braking = (drive.time > 6.65) & (drive.speed > 3.0)
    inside = braking & (along > begin + 14.0) & (along < begin + 8.0 + WET_LENGTH)
    outside = braking & (along < begin + 9.0)
    limit = 0.3 * Vehicle().grip * 9.81
    assert inside.any()
    assert slowing[inside].max() < limit + 0.5
    assert outside.any()
    assert slowing[outside].min() > 7.0
    assert along[-1] > way(dry)[-1] + 5.0


def test_a_load_makes_engine_and_brakes_weaker_in_proportion() -> None:
    car = Vehicle()
    empty = EmbeddedSimulator().drive(STRAIGHT, FullThrottle(2.0)).trajectory
    full = EmbeddedSimulator(load=1000.0).drive(STRAIGHT, FullThrottle(2.0)).trajectory
    share = car.mass / (car.mass + 1000.0)
    k = int(np.argmin(np.abs(empty.time - 1.9)))
    rolling = car.rolling_resistance * 9.81
    assert full.speed[k] + rolling * 1.9 == pytest.approx(
        share * (empty.speed[k] + rolling * 1.9), rel=0.02
    )


def test_a_hasty_driver_drives_over_the_limit() -> None:
    simulator = EmbeddedSimulator()
    usual = simulator.drive(Road([0.0] * 60), Planner()).trajectory.speed.max()
    hasty = simulator.drive(Road([0.0] * 60), Hasty(Planner(), excess=18.0)).trajectory.speed.max()
    assert usual <= 70.0 / 3.6 + 0.1
    assert hasty == pytest.approx(usual + 5.0, abs=0.2)


def test_amounts_of_no_effect_leave_the_drive_unchanged() -> None:
    without_weather = rows(EmbeddedSimulator(), Planner())
    nothing = EmbeddedSimulator(wet=1.0, wet_at=50.0, gust=0.0, gust_at=20.0, load=0.0)
    assert np.array_equal(rows(nothing, Planner()), without_weather)


@pytest.mark.parametrize(
    ("name", "value"), [("wet", 0.0), ("gust", 99.0), ("load", -1.0), ("gust_at", -5.0)]
)
def test_amounts_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} is {value}: .* is needed"):
        EmbeddedSimulator(**{name: value})  # type: ignore[arg-type]
    with (
        pytest.raises(FreneticError, match=name),
        in_conditions({name: value}, EmbeddedSimulator(), Planner()),
    ):
        pass
