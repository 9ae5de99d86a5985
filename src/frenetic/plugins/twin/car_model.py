"""The twin's car before a fit: a car of the embedded simulator, and the parameters to be fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, NamedTuple, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers.driver import DriveSetup
from frenetic.plugins.twin.unit_values import unit_value_of, value_at
from frenetic.road.classes import GRAVITY
from frenetic.simulators.embedded.vehicle import STEP_RATE, Vehicle


class CarParameter(NamedTuple):
    """A parameter of a car with the bounds of its fit.

    The scale is logarithmic if both bounds are positive.
    """

    name: str
    """Name of the attribute of a `Vehicle`."""
    low: float
    high: float

    def value_at(self, unit_value: float) -> float:
        """Return the value of a unit value: 0 at ``low``, 1 at ``high``."""
        return value_at(unit_value, self.low, self.high)

    def unit_value(self, value: float) -> float:
        """Return the unit value of a value; a value beyond a bound counts as the bound."""
        return unit_value_of(min(max(value, self.low), self.high), self.low, self.high)


PARAMETERS: Final = (
    CarParameter("tyre_peak", 0.3, 1.6),
    CarParameter("tyre_stiffness", 5.0, 150.0),
    CarParameter("front_stiffness", 0.3, 2.0),
    CarParameter("tyre_shape", 0.8, 1.8),
    CarParameter("yaw_inertia", 500.0, 6000.0),
    CarParameter("steering_lag", 0.005, 0.8),
    CarParameter("engine_acceleration", 0.8, 14.0),
    CarParameter("brake_deceleration", 1.5, 16.0),
    CarParameter("slip_control", 0.2, 1.0),
    CarParameter("cg_height", 0.02, 1.0),
    CarParameter("drive_front_share", 0.0, 1.0),
    CarParameter("along_weight", 0.0, 1.0),
)
"""Parameters of the car that are fitted, with bounds of our choice."""

# With these values every fit begins, because no simulator tells its own; our choice:
_DRIVE_FRONT_SHARE: Final = 0.5
_ALONG_WEIGHT: Final = 0.8
_MAX_LIFT: Final = 0.95  # share of the grip that lifts an axle, at most; our choice
_STABLE_STEP: Final = 1.98  # just below the decay rate times step that a `Vehicle` accepts


@dataclass(frozen=True)
class CarModel:
    """A car before the fit, and its parameters.

    A *unit value* says where a parameter's value lies between its bounds, from 0 to 1.
    """

    start: Vehicle
    """The car with which the fit begins."""
    parameters: tuple[CarParameter, ...] = PARAMETERS

    @classmethod
    def of(cls, car: Vehicle, setup: DriveSetup | None) -> Self:
        """Return the model of a car.

        Args:
            car: the car.
            setup: what the slow simulator says about its own car, which replaces the car's values.
        """
        car = replace(car, drive_front_share=_DRIVE_FRONT_SHARE, along_weight=_ALONG_WEIGHT)
        return cls(car if setup is None else _car_of_setup(car, setup))

    @property
    def start_values(self) -> FloatArray:
        """Unit values with which the fit begins, (p,)."""
        return np.array([p.unit_value(getattr(self.start, p.name)) for p in self.parameters])

    def values(self, unit_values: FloatArray) -> dict[str, float]:
        """Return name -> value of the parameters that have these unit values."""
        pairs = zip(self.parameters, unit_values.tolist(), strict=True)
        return {parameter.name: parameter.value_at(value) for parameter, value in pairs}

    def car(
        self, unit_values: FloatArray, conditions: Mapping[str, float] = MappingProxyType({})
    ) -> Vehicle:
        """Return the car with these unit values of the parameters, in conditions.

        Args:
            unit_values: unit values of the parameters, (p,).
            conditions: parameter of the car -> value that the conditions of a drive give it.
        """
        return _possible_car(self.start, {**self.values(unit_values), **conditions})


def _car_of_setup(car: Vehicle, setup: DriveSetup) -> Vehicle:
    """Return a car with the values that a setup knows."""
    mass, wheelbase = setup.mass or car.mass, setup.wheelbase
    values = {
        "mass": mass,
        "yaw_inertia": setup.yaw_inertia or car.yaw_inertia,
        "front_axle": setup.front_axle,
        "rear_axle": setup.rear_axle,
        "steering_limit": setup.max_steering,
        "engine_acceleration": setup.max_acceleration,
        "brake_deceleration": setup.max_deceleration,
    }
    if math.isfinite(setup.switch_speed):
        values["switch_speed"] = setup.switch_speed
    if setup.steering_rate is not None and math.isfinite(setup.steering_rate):
        values["steering_rate"] = setup.steering_rate
    if setup.steering_lag is not None:
        values["steering_lag"] = max(setup.steering_lag, 1.0 / STEP_RATE)
    front, rear = setup.front_cornering_stiffness, setup.rear_cornering_stiffness
    if front is not None and rear is not None:
        # The load on the rear tyres is the weight's share of the front axle's distance.
        values["tyre_stiffness"] = rear * wheelbase / (mass * GRAVITY * setup.front_axle)
        values["front_stiffness"] = front * setup.front_axle / (rear * setup.rear_axle)
    return _possible_car(car, values)


def _possible_car(car: Vehicle, values: Mapping[str, float]) -> Vehicle:
    """Return a car with other values.

    The car's crawl speed and height follow, so that the embedded simulator can integrate its motion
    and no axle lifts off.
    """

    def value(name: str) -> float:
        return values.get(name, getattr(car, name))

    front, rear = value("front_axle"), value("rear_axle")
    arm = front * rear * value("mass") / value("yaw_inertia")
    decay = value("tyre_stiffness") * GRAVITY * max(1.0, arm)
    lifting_height = min(front, rear) / (value("tyre_peak") * value("friction"))
    derived = {
        "crawl_speed": max(car.crawl_speed, decay / (STEP_RATE * _STABLE_STEP)),
        "cg_height": min(value("cg_height"), _MAX_LIFT * lifting_height),
    }
    return replace(car, **{**values, **derived})
