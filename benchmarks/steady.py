"""README's example of a driver, with its speed as an option."""

from __future__ import annotations

from frenetic import Controls
from frenetic.drivers import DriveSetup, Observation


class Steady:
    """A driver that steers for a point 8 m ahead at a steady speed.

    Args:
        speed: km/h.
    """

    def __init__(self, speed: float = 30.0) -> None:
        self.options = {"speed": speed}
        self._speed = speed / 3.6
        self._wheelbase = 0.0

    def reset(self, setup: DriveSetup) -> None:
        """Learns the car."""
        self._wheelbase = setup.wheelbase

    def act(self, observation: Observation) -> Controls:
        """Steers along the circle through the point."""
        x, y = observation.ahead[4]
        steering = 2.0 * self._wheelbase * y / (x * x + y * y)
        return Controls(steering, throttle=0.2 if observation.speed < self._speed else 0.0)
