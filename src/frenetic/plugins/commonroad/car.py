"""CommonRoad's car; this module alone imports the package ``vehiclemodels``.

M. Althoff, G. Würsching, "CommonRoad: Vehicle Models", 2020. The package's multi-body model has 29
states: body and axles that roll, pitch and heave, four wheels that spin, and Pacejka tyres with
combined slip. The states that this module uses:

    ====== ====================================================
    index  state
    ====== ====================================================
    0, 1   place of the centre of mass, in m
    2      angle of the front wheels, in rad
    3      speed along the car, in m/s
    4      heading, in rad
    5      yaw rate, in rad/s
    6      roll angle, in rad
    10     speed across the car, to the left, in m/s
    23-26  rotation of the wheels, in rad/s
    ====== ====================================================

**Slow cars.** The slip of a rolling wheel decays at 4,500/s divided by the speed in m/s, and half
as fast again under full braking. The Runge-Kutta method is stable while this rate times the step is
at most 2.78, so the slower the car, the shorter the steps. Below `KINEMATIC_SPEED` the kinematic
single-track model of the same package is used instead. It has states 0 to 4; its speed is the
speed of the centre of mass, and its wheels do not slip. It is also used in a spin that is so fast
that an inner wheel rolls backwards, which the multi-body model cannot do.

**Wheels that lift.** The multi-body model holds all wheels on the ground: a wheel that would lift
has a negative load. The package's tyre functions would then push the wheel along its sliding. Our
functions around them give it next to no load, and so next to no grip. A car that rolls over is
braked to a stop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType, SimpleNamespace
from typing import Any, Final, TypeAlias

import numpy as np
from vehiclemodels.init_mb import init_mb
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.utils import tire_model
from vehiclemodels.utils.vehicle_dynamics_ks_cog import vehicle_dynamics_ks_cog
from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

from frenetic._support.arrays import FloatArray
from frenetic.road import Pose
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.simulators.stepped import Motion

# All values are our choice.
PERIOD: Final = 0.01
"""Time by which `CommonRoadCar.advance` moves the car on, in s."""
KINEMATIC_SPEED: Final = 3.0
"""Speed from which on the multi-body model is used, in m/s."""
LEAVING_SPEED: Final = 2.8
"""Speed below which the multi-body model is left again, in m/s."""
_STEPS: Final = ((8.0, 10), (math.inf, 4))
"""Speed in m/s -> number of steps of a period below that speed."""
MAX_SLIP: Final = 0.15
"""Longitudinal slip of a wheel from which on brake, or throttle, lets go of all wheels."""
MAX_ROLL: Final = 0.3
"""Roll angle beyond which the car has rolled over, in rad; on four wheels it is below 0.12."""
MIN_LOAD: Final = 1.0
"""Load of a wheel that would lift, in N."""
_SPIN_SHARE: Final = 0.55
"""Share of track width times yaw rate below whose speed the kinematic model is used.

At a share of 0.5 an inner wheel stands; at less it rolls backwards.
"""

# Indices of the state, see above.
_STEERING, _SPEED = 2, 3
_YAW_RATE, _ROLL, _LATERAL_SPEED = 5, 6, 10
_WHEELS = slice(23, 27)
_KINEMATIC_STATES: Final = 5  # of the kinematic model; the multi-body model has 29

_Dynamics: TypeAlias = Callable[[list[float], list[float], Any], list[float]]


def _longitudinal(kappa: float, gamma: float, load: float, p: Any) -> Any:
    """Return the package's longitudinal force of a tyre, with at least `MIN_LOAD`."""
    return tire_model.formula_longitudinal(kappa, gamma, max(load, MIN_LOAD), p)


def _lateral(alpha: float, gamma: float, load: float, p: Any) -> Any:
    """Return the package's lateral force of a tyre, with at least `MIN_LOAD`."""
    return tire_model.formula_lateral(alpha, gamma, max(load, MIN_LOAD), p)


def _lateral_combined(
    kappa: float, alpha: float, gamma: float, mu: float, load: float, pure: float, p: Any
) -> Any:
    """Return the package's lateral force at combined slip, with at least `MIN_LOAD`."""
    load = max(load, MIN_LOAD)
    return tire_model.formula_lateral_comb(kappa, alpha, gamma, mu, load, pure, p)


_TYRES: Final = SimpleNamespace(
    formula_longitudinal=_longitudinal,
    formula_lateral=_lateral,
    formula_longitudinal_comb=tire_model.formula_longitudinal_comb,
    formula_lateral_comb=_lateral_combined,
)
# A copy of the package's function that finds our tyres under the name of its module.
multi_body: Final[_Dynamics] = FunctionType(
    vehicle_dynamics_mb.__code__, {**vehicle_dynamics_mb.__globals__, "tireModel": _TYRES}
)
"""The package's multi-body model with our tyre functions: slopes of the 29 states."""


class CommonRoadCar:
    """A car, which at first stands or rolls straight on.

    Args:
        pose: pose of its centre of mass.
        vehicle: its engine, brakes and steering.
        speed: its speed, in m/s.
    """

    def __init__(self, pose: Pose, vehicle: Vehicle, speed: float = 0.0) -> None:
        self._p = parameters_vehicle2()
        self._vehicle = vehicle
        # Part of the engine's and brakes' effort turns the wheels. With more effort the car
        # gets the acceleration of the `DriveSetup`.
        self._effort = 1.0 + 4.0 * self._p.I_y_w / (self._p.m * self._p.R_w**2)
        self._state = np.array([pose.x, pose.y, 0.0, speed, pose.heading])
        self._has_rolled_over = False

    @property
    def _is_multi_body(self) -> bool:
        """Whether the state is one of the multi-body model rather than the kinematic one."""
        return len(self._state) > _KINEMATIC_STATES

    @property
    def motion(self) -> Motion:
        """Pose, speeds and yaw rate of the centre of mass, and the front wheels' angle."""
        state: list[float] = self._state.tolist()
        x, y, steering, speed, heading = state[:_KINEMATIC_STATES]
        if self._is_multi_body:
            return Motion(x, y, heading, speed, state[_LATERAL_SPEED], state[_YAW_RATE], steering)
        slip = self._kinematic_slip(steering)
        ahead, left = speed * math.cos(slip), speed * math.sin(slip)
        return Motion(x, y, heading, ahead, left, left / self._p.b, steering)

    def _kinematic_slip(self, steering: float) -> float:
        """Return the angle between the car and the motion of its centre of mass, in rad."""
        return math.atan(math.tan(steering) * self._p.b / (self._p.a + self._p.b))

    def advance(self, steering: float, throttle: float, brake: float) -> None:
        """Move the car on by a `PERIOD`."""
        self._choose_model()
        if self._has_rolled_over:
            steering, throttle, brake = float(self._state[_STEERING]), 0.0, 1.0
        speed = float(self._state[_SPEED])
        steps = next(steps for speed_limit, steps in _STEPS if speed < speed_limit)
        for _ in range(steps):
            self._step(steering, throttle, brake, PERIOD / steps)

    def _choose_model(self) -> None:
        """Change to the other model's state, where speed, spin or roll ask for it."""
        state: list[float] = self._state.tolist()
        x, y, steering, speed, heading = state[:_KINEMATIC_STATES]
        if self._is_multi_body:
            self._has_rolled_over = abs(state[_ROLL]) > MAX_ROLL
            spin_speed = _SPIN_SHARE * self._p.T_f * abs(state[_YAW_RATE])
            if speed < max(LEAVING_SPEED, spin_speed) or self._has_rolled_over:
                speed = math.hypot(speed, state[_LATERAL_SPEED])
                self._state = np.array([x, y, steering, speed, heading])
        elif speed >= KINEMATIC_SPEED and not self._has_rolled_over:
            core = [x, y, steering, speed, heading, self.motion.yaw_rate]
            self._state = np.array(init_mb([*core, self._kinematic_slip(steering)], self._p), float)

    def _step(self, steering: float, throttle: float, brake: float, dt: float) -> None:
        """Move the car on by dt s, by the classical Runge-Kutta method (RK4)."""
        state = self._state
        inputs = self._inputs(steering, throttle, brake)
        dynamics = multi_body if self._is_multi_body else vehicle_dynamics_ks_cog

        def slope(at: FloatArray) -> FloatArray:
            return np.array(dynamics(at.tolist(), inputs, self._p))

        a = slope(state)
        b = slope(state + 0.5 * dt * a)
        c = slope(state + 0.5 * dt * b)
        d = slope(state + dt * c)
        self._state = state + dt / 6.0 * (a + 2.0 * (b + c) + d)
        # Wheels do not turn backwards, and the car has no reverse gear.
        if self._is_multi_body:
            self._state[_WHEELS] = np.maximum(self._state[_WHEELS], 0.0)
        else:
            self._state[_SPEED] = max(self._state[_SPEED], 0.0)

    def _inputs(self, steering: float, throttle: float, brake: float) -> list[float]:
        """Return the inputs of a model: the wheels' rate in rad/s, the acceleration in m/s^2."""
        car, state = self._vehicle, self._state
        speed = max(state[_SPEED], 0.0)
        rate = (steering - state[_STEERING]) / car.steering_lag
        engine = car.engine_acceleration * min(car.switch_speed / max(speed, 1e-9), 1.0)
        acceleration = throttle * engine - brake * car.brake_deceleration
        if self._is_multi_body:
            acceleration *= self._effort
            rolling_speeds = state[_WHEELS] * self._p.R_w
            if rolling_speeds.max() > (1.0 + MAX_SLIP) * speed:
                acceleration = min(acceleration, 0.0)
            if rolling_speeds.min() < (1.0 - MAX_SLIP) * speed:
                acceleration = max(acceleration, 0.0)
        elif speed == 0.0:
            acceleration = max(acceleration, 0.0)
        return [min(max(rate, -car.steering_rate), car.steering_rate), acceleration]
