"""Third-party drivers: the contract, and roads that reveal an error of the adapter."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest

from frenetic import Controls, Driver, DriveSetup, EmbeddedSimulator, Observation, Rules
from frenetic.errors import FreneticError
from frenetic.parts.registry import DRIVERS
from frenetic.plugins.third_party.vehicles import (
    FissCar,
    HighwayEnvCar,
    OpendbcCar,
    PackageCar,
    RoxCar,
)
from frenetic.simulators import Simulator
from frenetic.testing import TrackerContract
from frenetic.testing.tracker_contract import ROADS

MODULES = {
    "highway-env": "highway_env",
    "opendbc": "opendbc",
    "rox-control": "rox_control",
    "fiss-planner": "fiss_planner",
}
"""Driver, whose name is also the extra -> module of its package."""
CARS: dict[str, type[PackageCar]] = {
    "highway-env": HighwayEnvCar,
    "opendbc": OpendbcCar,
    "rox-control": RoxCar,
    "fiss-planner": FissCar,
}
LARGEST_OFFSET = {
    "highway-env": 0.2,
    "opendbc": 0.15,
    "rox-control": 0.1,
    "fiss-planner": 0.1,
}
"""Driver -> its largest distance from the lane's centre on the contract's roads, in m."""
UNAVAILABLE = {"opendbc": sys.version_info >= (3, 13), "fiss-planner": sys.platform == "win32"}
"""Driver -> whether its package cannot be installed here."""


def heavy_drivers(names: Any) -> list[Any]:
    """Return the drivers as heavy parameters, skipped where their package cannot be installed."""
    return [
        pytest.param(
            name,
            marks=[
                pytest.mark.heavy,
                pytest.mark.skipif(
                    UNAVAILABLE.get(name, False), reason=f"{name} is not packaged for this Python"
                ),
            ],
        )
        for name in names
    ]


class TestContract(TrackerContract):
    """Each driver in the car of its package."""

    @pytest.fixture(autouse=True, params=heavy_drivers(MODULES))
    def _named(self, request: pytest.FixtureRequest) -> None:
        self.name = request.param
        self.keeps = LARGEST_OFFSET[self.name]

    def make(self) -> Driver:
        driver: Driver = DRIVERS.make(self.name)
        return driver

    def simulator(self) -> Simulator:
        return CARS[self.name](rules=Rules(speed_limit=36.0))


@pytest.mark.parametrize("name", heavy_drivers(MODULES))
def test_the_option_lateral_limits_the_speed_in_bends(name: str) -> None:
    """On a circle of 50 m, `lateral` decides about the speed; with 100 the speed limit does."""
    fastest = {}
    for lateral in (1.0, 100.0):
        driver = DRIVERS.make(name, lateral=lateral)
        simulator = EmbeddedSimulator(rules=Rules(speed_limit=32.0), steering_lag=0.03)
        drive = simulator.drive(ROADS["left-hand circle"], driver)
        assert drive.trouble is None, drive.trouble
        fastest[lateral] = drive.trajectory.speed[-1]
    assert fastest[1.0] == pytest.approx(math.sqrt(1.0 * 52.0), abs=0.5)
    assert fastest[100.0] == pytest.approx(32.0 / 3.6, abs=0.4)


@pytest.mark.parametrize("name", MODULES)
def test_an_error_names_the_missing_package(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [m for m in sys.modules if m.partition(".")[0] == MODULES[name]]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, MODULES[name], None)
    with pytest.raises(FreneticError, match=rf"{name} needs the package .*\[{name}\]"):
        DRIVERS.make(name)


class Steady:
    """Holds the wheels' angle, and 8 m/s."""

    def __init__(self, steering: float) -> None:
        self.steering = steering

    def reset(self, setup: DriveSetup) -> None:
        self.setup = setup

    def act(self, observation: Observation) -> Controls:
        acceleration = 2.0 * (8.0 - observation.speed)
        return Controls.from_acceleration(
            acceleration, self.steering, speed=observation.speed, setup=self.setup
        )


@pytest.mark.parametrize("name", heavy_drivers(CARS))
def test_the_packages_cars_turn_by_their_wheels_angle(name: str) -> None:
    """A kinematic car's yaw rate is speed / wheelbase times the tangent of the wheels' angle."""
    simulator = CARS[name](rules=Rules(timeout_base=8.0, timeout_speed=1e3))
    path = simulator.drive(ROADS["straight"], Steady(0.01)).trajectory
    setup = simulator.setup(ROADS["straight"])
    expected = path.speed[-1] * math.tan(0.01) / setup.wheelbase
    assert path.speed[-1] == pytest.approx(8.0, abs=0.1)
    # opendbc's car has tyres and understeers: at 8 m/s it turns 6 % less.
    assert path.yaw_rate[-1] == pytest.approx(expected, rel=0.1 if name == "opendbc" else 0.01)
    assert np.diff(path.heading)[-1] == pytest.approx(path.yaw_rate[-1] * 0.05, rel=0.02)
    moved = math.hypot(np.diff(path.x)[-1], np.diff(path.y)[-1])
    assert moved == pytest.approx(
        math.hypot(path.speed[-1], path.lateral_speed[-1]) * 0.05, rel=0.01
    )


@pytest.mark.parametrize("name", heavy_drivers(CARS))
def test_a_lag_delays_the_wheels_of_the_packages_cars(name: str) -> None:
    simulator = CARS[name](rules=Rules(timeout_base=0.5, timeout_speed=1e3), steering_lag=0.2)
    path = simulator.drive(ROADS["straight"], Steady(0.02)).trajectory
    assert path.steering[4] == pytest.approx(0.02 * (1.0 - math.exp(-1.0)), rel=0.02)
    assert simulator.setup(ROADS["straight"]).steering_lag == 0.2
