"""The example driver of README, with the speed as an option."""

from __future__ import annotations

from frenetic import Controls
from frenetic.drivers import DriveSetup, Observation


class Steady:
    """A driver that steers to a point 8 m ahead, at a steady speed.

    Args:
        speed: speed to keep, in km/h.
    """

    def __init__(self, speed: float = 30.0) -> None:
        self.options = {"speed": speed}
        self._speed = speed / 3.6
        self._wheelbase = 0.0

    def reset(self, setup: DriveSetup) -> None:
        """Store the car's wheelbase."""
        self._wheelbase = setup.wheelbase

    def act(self, observation: Observation) -> Controls:
        """Steer along the circle through the point."""
        x, y = observation.ahead[4]
        steering = 2.0 * self._wheelbase * y / (x * x + y * y)
        return Controls(steering, throttle=0.2 if observation.speed < self._speed else 0.0)
