"""Drivers as users write them, for `foresight.py`: each has weak spots."""

from __future__ import annotations

import math

import numpy as np

from frenetic.drivers import Controls, DriveSetup, Observation


class Pursuit:
    """Pure pursuit, with a speed for all bends in view.

    Args:
        lookahead: time to the point that it steers for, in s.
        lateral: lateral acceleration that it plans in bends, in m/s^2.
        braking: deceleration that it plans before bends, in m/s^2.
    """

    def __init__(
        self, *, lookahead: float = 0.9, lateral: float = 7.5, braking: float = 3.5
    ) -> None:
        self.lookahead, self.lateral, self.braking = lookahead, lateral, braking

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive."""
        self.setup = setup

    def act(self, observation: Observation) -> Controls:
        """Return steering and pedals."""
        ahead = 2.0 * np.arange(len(observation.ahead))  # [m]
        bends = np.maximum(np.abs(observation.curvature_ahead), 1e-4)
        reachable = self.lateral / bends + 2.0 * self.braking * ahead  # [m^2/s^2]
        speed = min(math.sqrt(float(reachable.min())), observation.speed_limit)
        x, y = observation.ahead[:, 0] + self.setup.rear_axle, observation.ahead[:, 1]
        distances = np.hypot(x, y)
        k = int(np.argmax(distances >= max(3.0, self.lookahead * observation.speed)))
        steering = math.atan(2.0 * self.setup.wheelbase * y[k] / distances[k] ** 2)
        return Controls.from_acceleration(
            1.5 * (speed - observation.speed),
            steering,
            speed=observation.speed,
            setup=self.setup,
        )


class Feedforward:
    """Curvature ahead plus a damped return to the lane, both filtered; a PI law for the speed.

    Args:
        preview: time ahead at which it takes the curvature, in s.
        lateral: lateral acceleration that it plans in bends, in m/s^2.
        view: number of points ahead among which it looks for bends.
    """

    def __init__(self, *, preview: float = 0.35, lateral: float = 9.0, view: int = 6) -> None:
        self.preview, self.lateral, self.view = preview, lateral, view

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive."""
        self.setup, self.steering, self.integral = setup, 0.0, 0.0

    def act(self, observation: Observation) -> Controls:
        """Return steering and pedals."""
        bends = observation.curvature_ahead[: self.view + 1]
        sharpest = max(float(np.abs(bends).max()), 1e-4)
        speed = min(math.sqrt(self.lateral / sharpest), self.setup.speed_limit)
        point = min(self.preview * observation.speed / 2.0, len(bends) - 1)
        curvature = float(np.interp(point, np.arange(len(bends)), bends))
        gain = 0.12 / (1.0 + 0.08 * observation.speed)
        wanted = math.atan(self.setup.wheelbase * curvature)
        wanted -= gain * observation.lateral_offset + 0.9 * observation.heading_error
        self.steering += 0.45 * (wanted - self.steering)
        error = speed - observation.speed
        self.integral = min(max(self.integral + 0.05 * error, -3.0), 3.0)
        pedals = error + 0.2 * self.integral
        return Controls(self.steering, throttle=pedals / 4.0, brake=-pedals / 8.0)
