"""The car: the only module that knows the package ``vehiclemodels``.

M. Althoff, G. Würsching, "CommonRoad: Vehicle Models", 2020. Its multi-body model has 29 states:
body and axles that roll, pitch and heave, four wheels that spin, and Pacejka tyres with combined
slip. A state begins like this, in SI units:

    ===== ====================================
    index meaning
    ===== ====================================
    0, 1  m, centre of mass
    2     rad, angle of the front wheels
    3     m/s, along the car
    4     rad, heading
    5     rad/s, yaw rate
    10    m/s, across the car
    23-26 rad/s, the wheels' rotation
    ===== ====================================

A rolling wheel's slip decays at 4,500/s divided by the speed in m/s, half as fast again under full
braking, so steps of the Runge-Kutta method, which is stable up to 2.78, have to be the shorter the
slower the car is. Below `KINEMATIC_SPEED` the kinematic single-track model of the same package
takes over; its speed is the speed of the centre of mass: wheels do not slip there. It does so in a
spin that is so fast that an inner wheel rolls backwards, too, which the multi-body model cannot.

The multi-body model holds wheels on the ground: one that would lift has a negative load. With our
tyre functions around its own such a wheel has next to no grip; with theirs it would be driven round
by a friction along its sliding. A car that rolls over is braked to a stop.
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

PERIOD: Final = 0.01
"""Time by which the car is moved on at once, in s."""
KINEMATIC_SPEED: Final = 3.0
"""Speed from which on the multi-body model holds, in m/s."""
LEAVING_SPEED: Final = 2.8
"""Speed below which it is left again, in m/s."""
_STEPS: Final = ((8.0, 10), (math.inf, 4))
"""Speed in m/s below which a period has so many steps."""
SLIP: Final = 0.15
"""Longitudinal slip of a wheel at which brake or throttle let go of all of them."""
ROLL: Final = 0.3
"""Roll angle beyond which the car has rolled over, in rad; on four wheels it is below 0.12."""
LEAST_LOAD: Final = 1.0
"""Load that is left to a wheel that would lift, in N."""

_Dynamics: TypeAlias = Callable[[list[float], list[float], Any], list[float]]


def _longitudinal(kappa: float, gamma: float, load: float, p: Any) -> Any:
    return tire_model.formula_longitudinal(kappa, gamma, max(load, LEAST_LOAD), p)


def _lateral(alpha: float, gamma: float, load: float, p: Any) -> Any:
    return tire_model.formula_lateral(alpha, gamma, max(load, LEAST_LOAD), p)


def _combined(
    kappa: float, alpha: float, gamma: float, mu: float, load: float, pure: float, p: Any
) -> Any:
    load = max(load, LEAST_LOAD)
    return tire_model.formula_lateral_comb(kappa, alpha, gamma, mu, load, pure, p)


_TYRES: Final = SimpleNamespace(
    formula_longitudinal=_longitudinal,
    formula_lateral=_lateral,
    formula_longitudinal_comb=tire_model.formula_longitudinal_comb,
    formula_lateral_comb=_combined,
)
multi_body: Final[_Dynamics] = FunctionType(
    vehicle_dynamics_mb.__code__, {**vehicle_dynamics_mb.__globals__, "tireModel": _TYRES}
)
"""The package's multi-body model with these tyres."""


class CommonRoadCar:
    """A car that stands, or rolls straight on.

    Args:
        pose: of its centre of mass.
        vehicle: its engine, brakes and steering.
        speed: m/s.
    """

    def __init__(self, pose: Pose, vehicle: Vehicle, speed: float = 0.0) -> None:
        self._p = parameters_vehicle2()
        self._vehicle = vehicle
        # The wheels' own inertia takes its share of a pedal: the car gets what a driver is told.
        self._effort = 1.0 + 4.0 * self._p.I_y_w / (self._p.m * self._p.R_w**2)
        self._state = np.array([pose.x, pose.y, 0.0, speed, pose.heading])
        self._has_rolled_over = False

    @property
    def motion(self) -> Motion:
        """Its place and motion."""
        x, y, steering, speed, heading, *others = self._state.tolist()
        if others:
            return Motion(x, y, heading, speed, others[5], others[0], steering)
        slip = self._kinematic_slip(steering)
        ahead, left = speed * math.cos(slip), speed * math.sin(slip)
        return Motion(x, y, heading, ahead, left, left / self._p.b, steering)

    def _kinematic_slip(self, steering: float) -> float:
        return math.atan(math.tan(steering) * self._p.b / (self._p.a + self._p.b))

    def advance(self, steering: float, throttle: float, brake: float) -> None:
        """Move it on by a period."""
        self._choose_model()
        if self._has_rolled_over:
            steering, throttle, brake = float(self._state[2]), 0.0, 1.0
        speed = float(self._state[3])
        steps = next(steps for below, steps in _STEPS if speed < below)
        for _ in range(steps):
            self._step(steering, throttle, brake, PERIOD / steps)

    def _choose_model(self) -> None:
        x, y, steering, speed, heading, *others = self._state.tolist()
        if others:
            self._has_rolled_over = abs(others[1]) > ROLL
            least = max(LEAVING_SPEED, 0.55 * self._p.T_f * abs(others[0]))
            if speed < least or self._has_rolled_over:
                speed = math.hypot(speed, others[5])
                self._state = np.array([x, y, steering, speed, heading])
        elif speed >= KINEMATIC_SPEED and not self._has_rolled_over:
            core = [x, y, steering, speed, heading, self.motion.yaw_rate]
            self._state = np.array(init_mb([*core, self._kinematic_slip(steering)], self._p), float)

    def _step(self, steering: float, throttle: float, brake: float, dt: float) -> None:
        """One step of the classical Runge-Kutta method (RK4)."""
        car, state = self._vehicle, self._state
        wheels, speed = state[2], max(state[3], 0.0)
        rate = (steering - wheels) / car.steering_lag
        engine = car.engine_acceleration * min(car.switch_speed / max(speed, 1e-9), 1.0)
        acceleration = throttle * engine - brake * car.brake_deceleration
        if len(state) > 5:
            acceleration *= self._effort
            rolling = state[23:27] * self._p.R_w
            if rolling.max() > (1.0 + SLIP) * speed:
                acceleration = min(acceleration, 0.0)
            if rolling.min() < (1.0 - SLIP) * speed:
                acceleration = max(acceleration, 0.0)
        elif speed == 0.0:
            acceleration = max(acceleration, 0.0)
        inputs = [min(max(rate, -car.steering_rate), car.steering_rate), acceleration]

        dynamics = multi_body if len(state) > 5 else vehicle_dynamics_ks_cog

        def slope(at: FloatArray) -> FloatArray:
            return np.array(dynamics(at.tolist(), inputs, self._p))

        a = slope(state)
        b = slope(state + 0.5 * dt * a)
        c = slope(state + 0.5 * dt * b)
        d = slope(state + dt * c)
        self._state = state + dt / 6.0 * (a + 2.0 * (b + c) + d)
        # Wheels do not turn backwards, and the car has no reverse gear.
        self._state[23:27] = np.maximum(self._state[23:27], 0.0)
        if len(self._state) == 5:
            self._state[3] = max(self._state[3], 0.0)
