"""`fiss-planner`: trajectories by FISS+, followed by an MPC (S. Sun, Apache licence)."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final, Literal

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.drivers.half_drivers import LATERAL
from frenetic.plugins.third_party import package

PATH_AHEAD: Final = 1000.0
"""Length of the reference path ahead of the car, in m; our choice."""
PATH_BEHIND: Final = 30.0
"""Length of the reference path behind the car, in m; our choice."""
_PATH_INTERVAL: Final = 600.0  # [m] of road after which the planner gets a new path; our choice
_MIN_CURVATURE_SPEED: Final = 1.0  # [m/s] at which the car's curvature counts as 0; our choice
_CALLS_PER_PLAN: Final = 2  # planning at 10 Hz, control at 20 Hz
_TOP_SPEED_RATIO: Final = 1.5  # of the car's top speed to the speed limit, our choice


class FissPlanner:
    """fiss-planner's FISS+ in one lane at 10 Hz, with its MPC or Stanley controller at 20 Hz.

    The planner chooses its speed itself. It forgets its plan with every new reference path, and the
    car drifts if it gets one in each cycle. So the glue gives it a new path only every 600 m, or
    earlier if its view of the road is short.

    Args:
        lateral: largest lateral acceleration of a trajectory, in m/s^2.
        controller: controller that follows the trajectory, ``mpc`` or ``stanley``.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, increased when the controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("fiss-planner",)
    """Distributions whose versions belong to the behaviour, too."""

    def __init__(
        self, *, lateral: Positive = LATERAL, controller: Literal["mpc", "stanley"] = "mpc"
    ) -> None:
        check(locals(), FissPlanner.__init__)
        self.options: dict[str, Any] = {"lateral": float(lateral), "controller": controller}
        self._fiss = package("fiss_planner", "fiss-planner")

    def reset(self, setup: DriveSetup) -> None:
        """Make planner and controller for the car."""
        self._setup = setup
        car, config = self._fiss.VehicleParams(), self._fiss.LocalPlannerConfig()
        car.length, car.width, car.wheelbase = setup.car_length, setup.car_width, setup.wheelbase
        car.rear_axle_to_center, car.max_steer = setup.rear_axle, setup.max_steering
        car.max_speed = _TOP_SPEED_RATIO * setup.speed_limit
        car.max_lat_accel = self.options["lateral"]
        if setup.steering_rate is not None and math.isfinite(setup.steering_rate):
            car.max_steer_rate = setup.steering_rate
        config.path.num_left_lanes = config.path.num_right_lanes = 0
        config.path.lane_width = setup.lane_width
        self._planner = self._fiss.LocalPlanner(config, car)
        self._controller = self._fiss.make_controller(self.options["controller"], car)
        self._calls, self._acceleration = 0, 0.0
        self._path_distance = -math.inf  # [m] along the road, of the car at its latest path

    def act(self, observation: Observation) -> Controls:
        """Return the controller's steering and acceleration; planner and controller use the map."""
        o = observation
        curvature = o.yaw_rate / o.speed if o.speed > _MIN_CURVATURE_SPEED else 0.0
        ego = self._fiss.EgoState(o.x, o.y, o.heading, o.speed, self._acceleration, curvature)
        if o.distance > self._path_distance + min(_PATH_INTERVAL, 0.5 * o.view):
            ahead, left = o.lane(ahead=PATH_AHEAD, behind=PATH_BEHIND).points.T
            cos, sin = math.cos(o.heading), math.sin(o.heading)
            x, y = o.x + cos * ahead - sin * left, o.y + sin * ahead + cos * left
            self._planner.set_reference_path(x, y)
            self._path_distance = o.distance
        if self._calls % _CALLS_PER_PLAN == 0:
            no_obstacles: list[Any] = []
            plan = self._planner.step(o.time, ego, no_obstacles, o.speed_limit)
            self._trajectory, self._planned_at = plan.trajectory, o.time
        self._calls += 1
        command = self._controller.compute(ego, self._trajectory, o.time - self._planned_at)
        self._acceleration = command.accel
        return Controls.from_acceleration(
            command.accel, command.steer, speed=o.speed, setup=self._setup
        )
