"""A linear car and a proportional driver, whose responses are known in closed form.

The car is a kinematic single-track car at a constant speed v whose centre of mass is the middle of
its rear axle. The driver steers by -(k_e e + k_h h), where e is the offset from the lane's centre
and h the heading error. With small angles e'' = v² (κ_car - κ_road) and h = e'/v, so a transfer
function of second order leads from the road's curvature to the car's:

    H(s) = (2 ζ ω s + ω²) / (s² + 2 ζ ω s + ω²), where ω = v sqrt(k_e), ζ = k_h / (2 sqrt(k_e)).
"""

from __future__ import annotations

import cmath
import math
from typing import ClassVar

import numpy as np

from frenetic import Controls, DriveSetup, Motion, Observation, Road, Rules, SteppedSimulator
from frenetic._support.arrays import FloatArray
from frenetic.road import Pose

PERIOD = 0.01  # s
WHEELBASE = 2.6  # m


class LinearCar(SteppedSimulator):
    """Drives at the speed limit from the start."""

    front_axle: ClassVar[float] = WHEELBASE
    rear_axle: ClassVar[float] = 0.0
    period_step: ClassVar[float] = PERIOD

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:
        self.motion = Motion(*pose, speed=setup.speed_limit)
        return self.motion

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        x, y, heading, speed, *_ = self.motion
        yaw_rate = speed * math.tan(steering) / WHEELBASE
        turn = yaw_rate * seconds
        chord = speed * seconds * float(np.sinc(0.5 * turn / math.pi))
        x += chord * math.cos(heading + 0.5 * turn)
        y += chord * math.sin(heading + 0.5 * turn)
        self.motion = Motion(x, y, heading + turn, speed, 0.0, yaw_rate, steering)
        return self.motion


class Proportional:
    """Steers in proportion to the offset from the lane's centre and to the heading error."""

    period = PERIOD

    def __init__(self, omega: float, zeta: float, speed: float) -> None:
        self.omega, self.zeta, self.speed = omega, zeta, speed
        self.per_offset = (omega / speed) ** 2
        self.per_heading = 2.0 * zeta * omega / speed

    def reset(self, setup: DriveSetup) -> None: ...

    def act(self, observation: Observation) -> Controls:
        curvature = -self.per_offset * observation.lateral_offset
        curvature -= self.per_heading * observation.heading_error
        return Controls(math.atan(WHEELBASE * curvature))

    # Closed forms

    def offset_after(self, time: FloatArray) -> FloatArray:
        """Share of a start beside the lane's centre that is left after a time."""
        damped = self.omega * math.sqrt(1.0 - self.zeta**2)
        slope = self.zeta / math.sqrt(1.0 - self.zeta**2)
        fading = np.exp(-self.zeta * self.omega * time)
        return np.asarray(fading * (np.cos(damped * time) + slope * np.sin(damped * time)))

    def curvature_after(self, time: FloatArray) -> FloatArray:
        """Share of a step of curvature that the car drives after a time."""
        damped = self.omega * math.sqrt(1.0 - self.zeta**2)
        slope = self.zeta / math.sqrt(1.0 - self.zeta**2)
        fading = np.exp(-self.zeta * self.omega * time)
        return np.asarray(1.0 - fading * (np.cos(damped * time) - slope * np.sin(damped * time)))

    def transfer(self, frequency: float) -> complex:
        """Transfer function from the road's curvature to the car's, at a frequency in Hz.

        Controls that hold for a period act as if they were half a period late.
        """
        s = 2j * math.pi * frequency
        open_loop = (2.0 * self.zeta * self.omega * s + self.omega**2) / s**2
        open_loop *= cmath.exp(-0.5 * PERIOD * s)
        return open_loop / (1.0 + open_loop)

    @property
    def bandwidth(self) -> float:
        """Frequency in Hz at which the transfer function is at -3 dB."""
        half = 1.0 + 2.0 * self.zeta**2
        return self.omega / math.tau * math.sqrt(half + math.sqrt(half**2 + 1.0))


def car_at(speed: float) -> LinearCar:
    """Return the car with a speed limit in m/s."""
    return LinearCar(rules=Rules(speed_limit=3.6 * speed))
