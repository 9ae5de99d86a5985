"""comma.ai's `opendbc`: the limits and the vehicle model that steer cars on roads (MIT licence)."""

from __future__ import annotations

import math
from typing import ClassVar, Final

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.plugins.third_party import package, speed_plan

PREVIEW: Final = 0.2
"""How far ahead the lane's curvature is taken, in s."""
RETURN: Final = 1.0
"""Rate at which the car returns to the lane's centre, in 1/s."""
_MASS: Final = 1500.0  # kg, where the simulator does not say
_STIFFNESS: Final = 1e5  # N/rad of both axles


class Opendbc:
    """The lateral limits of a Tesla in opendbc and its vehicle model, under a curvature law.

    The law is the glue's, as openpilot's planner is not in the package: the lane's curvature a
    moment ahead and a critically damped return to its centre. opendbc turns curvature into an angle
    and limits its lateral acceleration (3.6 m/s^2), jerk and rate.

    Args:
        lateral: m/s^2, lateral acceleration that the planned speed keeps to in bends.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("opendbc",)
    """Distributions whose versions belong to it."""

    period: ClassVar[float] = 0.02
    """s: the 50 Hz at which a Tesla is steered."""

    def __init__(self, *, lateral: Positive = 3.0) -> None:
        check(locals(), Opendbc.__init__)
        self.options = {"lateral": float(lateral)}
        self._params = package("opendbc.car.structs", "opendbc").CarParams
        self._model = package("opendbc.car.vehicle_model", "opendbc").VehicleModel
        self._limits = package("opendbc.car.tesla.values", "opendbc").CarControllerParams
        self._limited = package("opendbc.car.lateral", "opendbc").apply_steer_angle_limits_vm

    def reset(self, setup: DriveSetup) -> None:
        """Make opendbc's model of the car."""
        self._plan, self._angle = speed_plan(setup, self.options["lateral"]), 0.0
        front, rear = setup.front_axle, setup.rear_axle
        self._car = self._model(
            self._params.new_message(
                mass=setup.mass or _MASS,
                rotationalInertia=setup.yaw_inertia or _MASS * front * rear,
                wheelbase=setup.wheelbase,
                centerToFront=front,
                steerRatio=12.0,  # the Tesla's ratio
                tireStiffnessFront=setup.front_cornering_stiffness or _STIFFNESS * rear,
                tireStiffnessRear=setup.rear_cornering_stiffness or _STIFFNESS * front,
            )
        )

    def act(self, observation: Observation) -> Controls:
        """Return the angle of the steering wheel, limited."""
        speed = max(observation.speed, 3.0)
        lane = observation.lane(spacing=1.0, ahead=PREVIEW * speed + 1.0)
        course = observation.heading_error + math.atan2(observation.lateral_speed, speed)
        back = 2.0 * math.sin(course) + RETURN * observation.lateral_offset / speed
        curvature = lane.curvatures[-2:].mean() - RETURN * back / speed
        wanted = math.degrees(self._car.get_steer_from_curvature(curvature, speed, 0.0))
        measured = math.degrees(observation.steering) * self._car.sR
        self._angle = self._limited(
            wanted, self._angle, observation.speed, measured, True, self._limits, self._car
        )
        return self._plan.controls(observation, math.radians(self._angle) / self._car.sR)
