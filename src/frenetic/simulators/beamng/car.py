"""The car in BeamNG.tech: its state, its box, and what is measured of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.simulators.drive import CarBody

WHEELBASE_PER_LENGTH: Final = 0.6
"""BeamNG.tech does not tell where the axles are."""
LENGTHS: Final = (1.0, 30.0)
"""m, between which the length of a car is."""
WIDTHS: Final = (0.5, 5.0)
"""m, likewise its width."""


@dataclass(frozen=True)
class CarState:
    """What BeamNG.tech says of the car at one moment."""

    time: float
    """s on the simulator's own clock, which started at some time."""
    position: FloatArray
    """(3,) m, the car's reference node."""
    forward: FloatArray
    """(3,) unit vector ahead."""
    up: FloatArray
    """(3,) unit vector."""
    velocity: FloatArray
    """(3,) m/s."""
    steering_input: float
    """-1..1, as BeamNG.tech counts it."""
    throttle_input: float
    """0..1."""
    brake_input: float
    """0..1."""

    @property
    def heading(self) -> float:
        """Rad, counter-clockwise from +x."""
        return math.atan2(self.forward[1], self.forward[0])

    @property
    def left(self) -> FloatArray:
        """(3,) unit vector to the left."""
        side: FloatArray = np.cross(self.up, self.forward)
        return side

    @property
    def speed(self) -> float:
        """m/s over the ground."""
        return math.hypot(self.velocity[0], self.velocity[1])


@dataclass(frozen=True)
class MeasuredCar:
    """A car as it was measured in BeamNG.tech, to the millimetre."""

    length: float
    """m, of its bounding box."""
    width: float
    """m, of its bounding box."""
    ahead: float
    """m by which the box's middle lies ahead of the car's position."""
    left: float
    """m, likewise to the left."""
    steering: float
    """rad of the front wheels at steering input 1; negative if that turns to the right."""

    @property
    def body(self) -> CarBody:
        """What the car covers; drives are recorded by the middle of its box."""
        return CarBody(self.length, self.width, 0.0)

    @property
    def wheelbase(self) -> float:
        """M between the axles, as it is assumed."""
        return WHEELBASE_PER_LENGTH * self.length

    def middle(self, state: CarState) -> tuple[float, float]:
        """m, where the middle of the car's box is."""
        x, y, _ = state.position + self.ahead * state.forward + self.left * state.left
        return float(x), float(y)

    def input_of(self, angle: float) -> float:
        """Steering input -1..1 for an angle of the front wheels in rad, positive to the left."""
        return min(max(angle / self.steering, -1.0), 1.0)


def measured_box(corners: FloatArray, state: CarState) -> tuple[float, float, float, float]:
    """(length, width, ahead, left) m of a box, to the millimetre.

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
