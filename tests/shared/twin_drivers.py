"""Drivers of users for twins, in a module that another process can import."""

from __future__ import annotations

import math
import os

import numpy as np

from frenetic import Camera
from frenetic.drivers import Controls, DriveSetup, Observation

SHARP = 0.05
"""Curvature that `Leaving` does not survive, in 1/m."""


class Follower:
    """Pure pursuit, with a speed for the sharpest bend within 24 m: too late for some bends."""

    def __init__(self, lateral: float = 6.5) -> None:
        self.lateral = lateral
        self.resets = 0

    def reset(self, setup: DriveSetup) -> None:
        self.setup = setup
        self.resets += 1

    def act(self, observation: Observation) -> Controls:
        sharpest = float(np.abs(observation.curvature_ahead[:12]).max())
        speed = min(math.sqrt(self.lateral / max(sharpest, 1e-3)), self.setup.speed_limit)
        point = observation.ahead[min(max(int(0.4 * observation.speed), 2), 20)]
        x, y = float(point[0]) + self.setup.rear_axle, float(point[1])
        steering = math.atan(2.0 * self.setup.wheelbase * y / (x * x + y * y))
        wanted = 1.5 * (speed - observation.speed)
        return Controls.from_acceleration(
            wanted, steering, speed=observation.speed, setup=self.setup
        )


class Forgetful(Follower):
    """A driver that drives differently each time."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return Controls(controls.steering + 1e-3 * self.resets, controls.throttle, controls.brake)


class Raising(Follower):
    """A driver that cannot drive."""

    def act(self, observation: Observation) -> Controls:
        raise RuntimeError("no idea")


class Leaving(Follower):
    """A driver that ends its process in a sharp bend."""

    def act(self, observation: Observation) -> Controls:
        if abs(float(observation.curvature_ahead[0])) > SHARP:
            os._exit(3)
        return super().act(observation)


class Seeing(Follower):
    """A driver with a camera."""

    camera = Camera()


class Uncopied(Follower):
    """A driver that cannot be copied to another process."""

    def __reduce__(self) -> str:
        raise TypeError("there is only one of me")


class Untouched(Follower):
    """A campaign's driver, with which nobody else may drive."""

    def reset(self, setup: DriveSetup) -> None:
        raise AssertionError("the twin drove with the campaign's driver")
