"""State of the car in BeamNG.tech, as the connection reads it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from frenetic._support.arrays import FloatArray


@dataclass(frozen=True)
class CarState:
    """State of the car in BeamNG.tech at one moment."""

    time: float
    """Time of BeamNG.tech's clock, in s; only differences of times matter."""
    position: FloatArray
    """Position of the car's reference node, which need not be in its middle, (3,) in m."""
    forward: FloatArray
    """Unit vector ahead, (3,)."""
    up: FloatArray
    """Unit vector upwards, (3,)."""
    velocity: FloatArray
    """Velocity of the reference node, (3,) in m/s."""
    steering_input: float
    """Steering input -1..1; `MeasuredCar.steering` says to which side it turns."""
    throttle_input: float
    """Throttle input, 0..1."""
    brake_input: float
    """Brake input, 0..1."""

    @property
    def heading(self) -> float:
        """Heading in rad, counter-clockwise from +x."""
        return math.atan2(self.forward[1], self.forward[0])

    @property
    def speed(self) -> float:
        """Speed over the ground, in m/s."""
        return math.hypot(self.velocity[0], self.velocity[1])

    def point(self, ahead: float, left: float) -> tuple[float, float]:
        """Return x and y of a point ahead and to the left of the car's position, all in m."""
        left_vector = np.cross(self.up, self.forward)
        x, y, _ = self.position + ahead * self.forward + left * left_vector
        return float(x), float(y)
