"""The cars that the third-party packages bring, as simulators.

A driver that fails in its own package's car fails by itself, not by the glue. Named
``frenetic.plugins.third_party.vehicles:HighwayEnvCar`` and the like on the command line.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar, Final

import numpy as np

from frenetic.drivers import DriveSetup
from frenetic.oracle.drive import CarBody, Rules
from frenetic.plugins.third_party import package
from frenetic.road import Pose, Road
from frenetic.simulators import Motion, SteppedSimulator

STEP: Final = 0.01
"""Step of the integration, in s."""
_KINEMATIC: Final = 4.0  # m/s below which opendbc's model without slip holds


class OwnCar(SteppedSimulator):
    """Base of the packages' own cars, whose steering follows at once or with a lag.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        steering_lag: s, time constant of the steering; it may be set between two drives.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its drives change; campaigns record it."""
    period_step = STEP

    def __init__(self, *, rules: Rules | None = None, steering_lag: float = 0.0) -> None:
        super().__init__(rules=rules)
        self.steering_lag = steering_lag

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        return replace(super().setup(road), steering_lag=self.steering_lag)

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:  # noqa: ARG002
        """Put the car at rest on the road."""
        self._wheels = 0.0
        self._place(pose)
        return self._motion()

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        """Move the car on."""
        wanted = throttle * self.max_acceleration - brake * self.max_deceleration
        share = 1.0 - math.exp(-STEP / self.steering_lag) if self.steering_lag > 0.0 else 1.0
        for _ in range(round(seconds / STEP)):
            self._wheels += share * (steering - self._wheels)
            self._advance(max(wanted, -self._motion().speed / STEP))
        return self._motion()

    def _place(self, pose: Pose) -> None:
        raise NotImplementedError

    def _advance(self, acceleration: float) -> None:
        """Move on by a `STEP` with the wheels as they are."""
        raise NotImplementedError

    def _motion(self) -> Motion:
        raise NotImplementedError


class HighwayEnvCar(OwnCar):
    """HighwayEnv's Vehicle, a kinematic bicycle whose wheelbase is its length, 5 m."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("highway-env",)
    """Distributions whose versions belong to it."""
    car = CarBody(5.0, 2.0)
    front_axle = rear_axle = 2.5

    def _place(self, pose: Pose) -> None:
        kinematics = package("highway_env.vehicle.kinematics", "highway-env")
        self._car = kinematics.Vehicle(None, pose[:2], pose.heading, 0.0)
        self._car.MAX_SPEED = math.inf

    def _advance(self, acceleration: float) -> None:
        self._car.act({"steering": self._wheels, "acceleration": acceleration})
        self._car.step(STEP)

    def _motion(self) -> Motion:
        slip, speed = math.atan(0.5 * math.tan(self._wheels)), float(self._car.speed)
        ahead, left = speed * math.cos(slip), speed * math.sin(slip)
        x, y = self._car.position
        return Motion(x, y, self._car.heading, ahead, left, left / 2.5, self._wheels)


class OpendbcCar(OwnCar):
    """opendbc's VehicleModel of a Tesla Model 3: a linear single-track model with tyres."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("opendbc",)
    """Distributions whose versions belong to it."""
    car = CarBody(4.69, 1.85)
    front_axle = rear_axle = 2.875 / 2

    def _place(self, pose: Pose) -> None:
        self._module = package("opendbc.car.vehicle_model", "opendbc")
        self._model = self._module.VehicleModel(self._params())
        self._state = Motion(*pose)

    @staticmethod
    def _params() -> Any:
        interface = package("opendbc.car.tesla.interface", "opendbc").CarInterface
        params = interface.get_non_essential_params("TESLA_MODEL_3")
        params.centerToFront = 0.5 * params.wheelbase
        return params

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        p = self._params()
        return replace(
            super().setup(road),
            mass=p.mass,
            yaw_inertia=p.rotationalInertia,
            front_cornering_stiffness=p.tireStiffnessFront,
            rear_cornering_stiffness=p.tireStiffnessRear,
        )

    def _advance(self, acceleration: float) -> None:
        x, y, heading, speed, left, turn, _ = self._state
        wheel = self._wheels * self._model.sR
        if speed < _KINEMATIC:
            left, turn = self._module.kin_ss_sol(wheel, speed, self._model)[:, 0].tolist()
        else:
            a, b = self._module.create_dyn_state_matrices(speed, self._model)
            change = a @ np.array([left, turn]) + b @ np.array([wheel, 0.0])
            left, turn = left + STEP * change[0], turn + STEP * change[1]
        cos, sin = math.cos(heading), math.sin(heading)
        x, y = x + STEP * (cos * speed - sin * left), y + STEP * (sin * speed + cos * left)
        heading, speed = heading + STEP * turn, speed + STEP * acceleration
        self._state = Motion(x, y, heading, speed, left, turn, self._wheels)

    def _motion(self) -> Motion:
        return self._state


class RoxCar(OwnCar):
    """rox-control's BicycleModel: kinematic, its wheels turn by 45 degrees a second at most."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("rox-control",)
    """Distributions whose versions belong to it."""
    front_axle = rear_axle = 1.25

    def _place(self, pose: Pose) -> None:
        model = package("rox_control.tools.bicicle_model", "rox-control")
        self._car = model.BicycleModel(accel=100.0, max_velocity=100.0)
        x, y, heading = pose
        back = self.rear_axle
        x, y = x - back * math.cos(heading), y - back * math.sin(heading)
        self._car.state = model.RobotState(x=x, y=y, theta=heading)

    def _advance(self, acceleration: float) -> None:
        self._car.set_target_steering_angle(self._wheels)
        self._car.set_target_velocity(self._car.state.v + acceleration * STEP)
        self._car.step(STEP)

    def _motion(self) -> Motion:
        s, back = self._car.state, self.rear_axle
        turn = s.v * math.tan(s.steering_angle) / self._car.wheelbase
        x, y = s.x + back * math.cos(s.theta), s.y + back * math.sin(s.theta)
        return Motion(x, y, s.theta, s.v, back * turn, turn, s.steering_angle)


class FissCar(OwnCar):
    """fiss-planner's KinematicBicycle, its wheels turn by 0.5 rad a second at most."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("fiss-planner",)
    """Distributions whose versions belong to it."""
    front_axle = rear_axle = 1.35

    def _place(self, pose: Pose) -> None:
        self._fiss = package("fiss_planner", "fiss-planner")
        params = self._fiss.VehicleParams()
        params.max_speed, params.max_accel, params.max_decel = 100.0, 100.0, 100.0
        self._car = self._fiss.KinematicBicycle(params, self._fiss.EgoState(*pose, 0.0, 0.0, 0.0))

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        return replace(super().setup(road), steering_rate=0.5)

    def _advance(self, acceleration: float) -> None:
        self._car.step(self._fiss.ControlCommand(self._wheels, acceleration), STEP)

    def _motion(self) -> Motion:
        s = self._car.state
        return Motion(
            s.x, s.y, s.yaw, s.v, self.rear_axle * s.kappa * s.v, s.kappa * s.v, self._car.steer
        )
