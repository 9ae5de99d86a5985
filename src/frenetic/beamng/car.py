"""The car in BeamNG.tech: its state, its box, and its measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drive import CarBody

WHEELBASE_PER_LENGTH: Final = 0.6
"""Assumed share: BeamNG.tech does not report the axles."""


@dataclass(frozen=True)
class CarState:
    """State of the car in BeamNG.tech at one moment."""

    time: float
    """Time on the simulator's own clock in s, which started at some time."""
    position: FloatArray
    """The car's reference node, (3,) in m."""
    forward: FloatArray
    """Unit vector ahead, (3,)."""
    up: FloatArray
    """Unit vector upwards, (3,)."""
    velocity: FloatArray
    """Velocity, (3,) in m/s."""
    steering_input: float
    """Steering input -1..1, as BeamNG.tech counts it."""
    throttle_input: float
    """0..1."""
    brake_input: float
    """0..1."""

    @property
    def heading(self) -> float:
        """Heading in rad, counter-clockwise from +x."""
        return math.atan2(self.forward[1], self.forward[0])

    @property
    def left(self) -> FloatArray:
        """Unit vector to the left, (3,)."""
        side: FloatArray = np.cross(self.up, self.forward)
        return side

    @property
    def speed(self) -> float:
        """Speed over the ground, in m/s."""
        return math.hypot(self.velocity[0], self.velocity[1])


@dataclass(frozen=True)
class MeasuredCar:
    """A car as it was measured in BeamNG.tech, to the millimetre."""

    length: float
    """Length of its bounding box, in m."""
    width: float
    """Width of its bounding box, in m."""
    ahead: float
    """Distance by which the box's middle lies ahead of the car's position, in m."""
    left: float
    """Distance by which it lies to the left, in m."""
    steering: float
    """Front wheels' angle at steering input 1, in rad; negative if that turns to the right."""
    steers_directly: bool = False
    """Whether steering can pass by the filter of BeamNG.tech's Control message."""
    sign_shown: float = 1.0
    """Sign of the steering input that BeamNG.tech reports at input 1; 0 if it reports none."""

    @property
    def body(self) -> CarBody:
        """Box of the car; drives record its middle."""
        return CarBody(self.length, self.width, 0.0)

    @property
    def wheelbase(self) -> float:
        """Assumed distance between the axles, in m."""
        return WHEELBASE_PER_LENGTH * self.length

    def middle(self, state: CarState) -> tuple[float, float]:
        """Middle of the car's box, in m."""
        x, y, _ = state.position + self.ahead * state.forward + self.left * state.left
        return float(x), float(y)

    def angle_shown(self, steering_input: float) -> float:
        """Front wheels' angle in rad, positive to the left, at a reported steering input."""
        return self.steering * (self.sign_shown or 1.0) * steering_input

    def input_of(self, angle: float) -> float:
        """Steering input -1..1 for an angle of the front wheels in rad, positive to the left."""
        return min(max(angle / self.steering, -1.0), 1.0)


def measured_box(corners: FloatArray, state: CarState) -> tuple[float, float, float, float]:
    """Length, width, ahead and left of a box in m, to the millimetre.

    Args:
        corners: (8, 3) m: front, then rear; each bottom left, bottom right, top left, top right.
        state: of the car at the same moment.
    """
    front, rear = corners[:4].mean(axis=0), corners[4:].mean(axis=0)
    left, right = corners[0::2].mean(axis=0), corners[1::2].mean(axis=0)
    away = corners.mean(axis=0) - state.position
    sizes = (
        float(np.linalg.norm(front - rear)),
        float(np.linalg.norm(left - right)),
        float(away @ state.forward),
        float(away @ state.left),
    )
    length, width, ahead, aside = (round(size, 3) + 0.0 for size in sizes)
    return length, width, ahead, aside
