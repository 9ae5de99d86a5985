"""comma.ai's `opendbc`: a vehicle model and steering limits of real cars (MIT licence)."""

from __future__ import annotations

import math
from typing import ClassVar, Final

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.drivers.half_drivers import speed_plan, wanted_curvature
from frenetic.plugins.third_party import package

# Of a car about which the simulator does not say them, our choice:
_MASS: Final = 1500.0  # [kg]
_STIFFNESS: Final = 1e5  # [N/rad] of an axle, per m from the centre of mass to the other axle
_MIN_SPEED: Final = 3.0  # [m/s] by which the law divides at least, our choice
_TESLA_STEER_RATIO: Final = 12.0  # angle of the steering wheel to angle of the front wheels


class Opendbc:
    """opendbc's vehicle model and its steering limits of a Tesla, under our curvature law.

    openpilot's planner is not in the package, so the glue has a law of its own,
    `wanted_curvature`: the curvature of the lane a moment ahead, with a critically damped return to
    the lane's centre. opendbc turns the curvature into an angle of the steering wheel, and limits
    lateral acceleration (3.6 m/s^2), jerk and rate.

    Args:
        lateral: largest lateral acceleration of the planned speed in bends, in m/s^2.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, increased when the controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("opendbc",)
    """Distributions whose versions belong to the behaviour, too."""

    period: ClassVar[float] = 0.02
    """Time between two calls of `act`, in s: a Tesla is steered at 50 Hz."""

    def __init__(self, *, lateral: Positive = 3.0) -> None:
        check(locals(), Opendbc.__init__)
        self.options = {"lateral": float(lateral)}
        self._params = package("opendbc.car.structs", "opendbc").CarParams
        self._model = package("opendbc.car.vehicle_model", "opendbc").VehicleModel
        self._limits = package("opendbc.car.tesla.values", "opendbc").CarControllerParams
        self._limit_angle = package("opendbc.car.lateral", "opendbc").apply_steer_angle_limits_vm

    def reset(self, setup: DriveSetup) -> None:
        """Make opendbc's model of the car."""
        self._plan = speed_plan(setup, self.options["lateral"])
        self._angle = 0.0  # [degrees] of the steering wheel, as last limited
        front, rear = setup.front_axle, setup.rear_axle
        self._car = self._model(
            self._params.new_message(
                mass=setup.mass or _MASS,
                rotationalInertia=setup.yaw_inertia or _MASS * front * rear,
                wheelbase=setup.wheelbase,
                centerToFront=front,
                steerRatio=_TESLA_STEER_RATIO,
                tireStiffnessFront=setup.front_cornering_stiffness or _STIFFNESS * rear,
                tireStiffnessRear=setup.rear_cornering_stiffness or _STIFFNESS * front,
            )
        )

    def act(self, observation: Observation) -> Controls:
        """Return the limited steering, and the pedals of the speed plan."""
        speed = max(observation.speed, _MIN_SPEED)
        curvature, no_roll = wanted_curvature(observation), 0.0
        # In degrees at the steering wheel:
        wanted = math.degrees(self._car.get_steer_from_curvature(curvature, speed, no_roll))
        measured = math.degrees(observation.steering) * self._car.sR
        is_active = True
        self._angle = self._limit_angle(
            wanted, self._angle, observation.speed, measured, is_active, self._limits, self._car
        )
        return self._plan.controls(observation, math.radians(self._angle) / self._car.sR)
