"""The cars that the third-party packages bring, as simulators.

A driver that fails in the car of its package fails by itself, not because of the glue. On the
command line a car is named ``frenetic.plugins.third_party.vehicles:HighwayEnvCar``, for instance.
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
"""Step of the integration, in s; our choice."""
_NO_LIMIT: Final = 100.0  # [m/s; m/s^2] limit of a package's car that no drive reaches
_MAX_KINEMATIC_SPEED: Final = 4.0  # [m/s] below which opendbc's model without slip is used, ours
_HIGHWAY_ENV_AXLE: Final = 2.5  # [m] from the centre of mass to either axle
_FISS_STEERING_RATE: Final = 0.5  # [rad/s] largest rate of the wheels of fiss-planner's car


class PackageCar(SteppedSimulator):
    """Base of the packages' cars: the front wheels follow the driver at once or with a lag.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        steering_lag: time constant of the steering, in s; it may be set between two drives.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, increased when drives change; campaigns record it."""
    period_step = STEP

    def __init__(self, *, rules: Rules | None = None, steering_lag: float = 0.0) -> None:
        super().__init__(rules=rules)
        self.steering_lag = steering_lag

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        return replace(super().setup(road), steering_lag=self.steering_lag)

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:  # noqa: ARG002
        """Put the car at rest on the road."""
        self._wheels = 0.0  # [rad] angle of the front wheels
        self._place(pose)
        return self._motion()

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        """Move the car on by a time, in s."""
        wanted = throttle * self.max_acceleration - brake * self.max_deceleration
        share = 1.0 - math.exp(-STEP / self.steering_lag) if self.steering_lag > 0.0 else 1.0
        for _ in range(round(seconds / STEP)):
            self._wheels += share * (steering - self._wheels)
            full_stop = -self._motion().speed / STEP  # brakes do not make the car go backwards
            self._advance(max(wanted, full_stop))
        return self._motion()

    def _place(self, pose: Pose) -> None:
        """Make the package's car, at rest at a pose of its centre of mass."""
        raise NotImplementedError

    def _advance(self, acceleration: float) -> None:
        """Move the car on by a `STEP`, with this acceleration in m/s^2 and the wheels' angle."""
        raise NotImplementedError

    def _motion(self) -> Motion:
        """Return pose, speeds and yaw rate of the car's centre of mass."""
        raise NotImplementedError


class HighwayEnvCar(PackageCar):
    """HighwayEnv's Vehicle, a kinematic bicycle whose wheelbase is its length, 5 m."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("highway-env",)
    """Distributions whose versions belong to the behaviour, too."""
    car = CarBody(5.0, 2.0)
    front_axle = rear_axle = _HIGHWAY_ENV_AXLE

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
        turn = left / _HIGHWAY_ENV_AXLE
        return Motion(x, y, self._car.heading, ahead, left, turn, self._wheels)


class OpendbcCar(PackageCar):
    """opendbc's VehicleModel of a Tesla Model 3: a linear single-track model with tyres."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("opendbc",)
    """Distributions whose versions belong to the behaviour, too."""
    car = CarBody(4.69, 1.85)
    front_axle = rear_axle = 2.875 / 2

    def _place(self, pose: Pose) -> None:
        self._module = package("opendbc.car.vehicle_model", "opendbc")
        self._model = self._module.VehicleModel(self._params())
        self._state = Motion(*pose)

    @staticmethod
    def _params() -> Any:
        """Return opendbc's parameters of the Tesla, with the mass midway between the axles."""
        interface = package("opendbc.car.tesla.interface", "opendbc").CarInterface
        params = interface.get_non_essential_params("TESLA_MODEL_3")
        params.centerToFront = 0.5 * params.wheelbase
        return params

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        params = self._params()
        return replace(
            super().setup(road),
            mass=params.mass,
            yaw_inertia=params.rotationalInertia,
            front_cornering_stiffness=params.tireStiffnessFront,
            rear_cornering_stiffness=params.tireStiffnessRear,
        )

    def _advance(self, acceleration: float) -> None:
        x, y, heading, speed, left, turn, _ = self._state
        steering_wheel = self._wheels * self._model.sR
        if speed < _MAX_KINEMATIC_SPEED:
            left, turn = self._module.kin_ss_sol(steering_wheel, speed, self._model)[:, 0].tolist()
        else:
            # Its state is the speed to the left and the yaw rate, its input the steering wheel's
            # angle and the roll of the road.
            a, b = self._module.create_dyn_state_matrices(speed, self._model)
            change = a @ np.array([left, turn]) + b @ np.array([steering_wheel, 0.0])
            left, turn = left + STEP * change[0], turn + STEP * change[1]
        cos, sin = math.cos(heading), math.sin(heading)
        x, y = x + STEP * (cos * speed - sin * left), y + STEP * (sin * speed + cos * left)
        heading, speed = heading + STEP * turn, speed + STEP * acceleration
        self._state = Motion(x, y, heading, speed, left, turn, self._wheels)

    def _motion(self) -> Motion:
        return self._state


class RoxCar(PackageCar):
    """rox-control's kinematic BicycleModel, whose wheels turn by at most 45 degrees a second."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("rox-control",)
    """Distributions whose versions belong to the behaviour, too."""
    front_axle = rear_axle = 1.25

    def _place(self, pose: Pose) -> None:
        model = package("rox_control.tools.bicicle_model", "rox-control")
        self._car = model.BicycleModel(accel=_NO_LIMIT, max_velocity=_NO_LIMIT)
        x, y, heading = pose
        back = self.rear_axle  # the model's place is the rear axle
        x, y = x - back * math.cos(heading), y - back * math.sin(heading)
        self._car.state = model.RobotState(x=x, y=y, theta=heading)

    def _advance(self, acceleration: float) -> None:
        self._car.set_target_steering_angle(self._wheels)
        self._car.set_target_velocity(self._car.state.v + acceleration * STEP)
        self._car.step(STEP)

    def _motion(self) -> Motion:
        state, ahead = self._car.state, self.rear_axle
        turn = state.v * math.tan(state.steering_angle) / self._car.wheelbase
        x = state.x + ahead * math.cos(state.theta)
        y = state.y + ahead * math.sin(state.theta)
        return Motion(x, y, state.theta, state.v, ahead * turn, turn, state.steering_angle)


class FissCar(PackageCar):
    """fiss-planner's KinematicBicycle, whose wheels turn by at most 0.5 rad a second."""

    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("fiss-planner",)
    """Distributions whose versions belong to the behaviour, too."""
    front_axle = rear_axle = 1.35

    def _place(self, pose: Pose) -> None:
        self._fiss = package("fiss_planner", "fiss-planner")
        params = self._fiss.VehicleParams()
        params.max_speed = params.max_accel = params.max_decel = _NO_LIMIT
        at_rest = self._fiss.EgoState(*pose, 0.0, 0.0, 0.0)  # speed, acceleration, curvature
        self._car = self._fiss.KinematicBicycle(params, at_rest)

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        return replace(super().setup(road), steering_rate=_FISS_STEERING_RATE)

    def _advance(self, acceleration: float) -> None:
        self._car.step(self._fiss.ControlCommand(self._wheels, acceleration), STEP)

    def _motion(self) -> Motion:
        state = self._car.state
        left, turn = self.rear_axle * state.kappa * state.v, state.kappa * state.v
        return Motion(state.x, state.y, state.yaw, state.v, left, turn, self._car.steer)
