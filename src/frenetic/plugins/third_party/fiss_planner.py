"""`fiss-planner`: trajectories by FISS+ and an MPC that tracks them (S. Sun, Apache licence)."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final, Literal

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.plugins.third_party import LATERAL, package

AHEAD: Final = 1000.0
"""Length of lane that the planner is given at once, in m."""
_RENEWED: Final = 600.0  # m after which it is given more


class FissPlanner:
    """fiss-planner's FISS+ in one lane, with its MPC or its Stanley controller, at 10 and 20 Hz.

    It plans its speed itself. The glue gives it the lane once for 600 m of road: with every new
    reference path it forgets its plan, and one that it is given in each cycle lets the car drift.

    Args:
        lateral: m/s^2, largest lateral acceleration of a trajectory.
        controller: ``mpc`` or ``stanley``.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("fiss-planner",)
    """Distributions whose versions belong to it."""

    def __init__(
        self, *, lateral: Positive = LATERAL, controller: Literal["mpc", "stanley"] = "mpc"
    ) -> None:
        check(locals(), FissPlanner.__init__)
        self.options: dict[str, Any] = {"lateral": float(lateral), "controller": controller}
        self._fiss = package("fiss_planner", "fiss-planner")

    def reset(self, setup: DriveSetup) -> None:
        """Make planner and controller for the car."""
        self._setup, car, config = (
            setup,
            self._fiss.VehicleParams(),
            self._fiss.LocalPlannerConfig(),
        )
        car.length, car.width, car.wheelbase = setup.car_length, setup.car_width, setup.wheelbase
        car.rear_axle_to_center, car.max_steer = setup.rear_axle, setup.max_steering
        car.max_speed, car.max_lat_accel = 1.5 * setup.speed_limit, self.options["lateral"]
        if setup.steering_rate is not None and math.isfinite(setup.steering_rate):
            car.max_steer_rate = setup.steering_rate
        config.path.num_left_lanes = config.path.num_right_lanes = 0
        config.path.lane_width = setup.lane_width
        self._planner = self._fiss.LocalPlanner(config, car)
        self._controller = self._fiss.make_controller(self.options["controller"], car)
        self._calls, self._given, self._acceleration = 0, -math.inf, 0.0

    def act(self, observation: Observation) -> Controls:
        """Return the controller's steering and acceleration, on the map."""
        o = observation
        curvature = o.yaw_rate / o.speed if o.speed > 1.0 else 0.0
        ego = self._fiss.EgoState(o.x, o.y, o.heading, o.speed, self._acceleration, curvature)
        if o.distance > self._given + min(_RENEWED, 0.5 * o.view):
            ahead, left = o.lane(ahead=AHEAD, behind=30.0).points.T
            cos, sin = math.cos(o.heading), math.sin(o.heading)
            x, y = o.x + cos * ahead - sin * left, o.y + sin * ahead + cos * left
            self._planner.set_reference_path(x, y)
            self._given = o.distance
        if self._calls % 2 == 0:
            planned = self._planner.step(o.time, ego, [], o.speed_limit)
            self._trajectory, self._since = planned.trajectory, o.time
        self._calls += 1
        command = self._controller.compute(ego, self._trajectory, o.time - self._since)
        self._acceleration = command.accel
        return Controls.from_acceleration(
            command.accel, command.steer, speed=o.speed, setup=self._setup
        )
