"""Drivers for `research/make_bench.py`, on which no search was tuned unless the page says so."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from frenetic.drivers import Controls, DriveSetup, Observation

_POINT_SPACING = 2.0  # [m] between two points of the road ahead
_STEP = 0.05  # [s] between two observations


def bend_speed(observation: Observation, lateral: float, braking: float) -> float:
    """Return the largest speed, in m/s, from which all bends in view can still be taken.

    Args:
        observation: What the driver sees.
        lateral: Lateral acceleration in bends, in m/s^2.
        braking: Deceleration before bends, in m/s^2.
    """
    bends = np.maximum(np.abs(observation.curvature_ahead), 1e-4)
    distances = _POINT_SPACING * np.arange(len(bends))
    squares = lateral / bends + 2.0 * braking * distances  # [m^2/s^2]
    return min(math.sqrt(float(squares.min())), observation.speed_limit)


class Lqr:
    """A linear-quadratic regulator of lateral offset and heading, with the curvature ahead.

    Args:
        lateral: Lateral acceleration that it plans in bends, in m/s^2.
        preview: Time ahead at which it takes the curvature, in s.
    """

    def __init__(self, *, lateral: float = 4.5, preview: float = 0.3) -> None:
        self.lateral, self.preview = lateral, preview

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive."""
        self.setup = setup

    def act(self, observation: Observation) -> Controls:
        """Return steering and pedals."""
        speed = bend_speed(observation, self.lateral, braking=3.0)
        bends = observation.curvature_ahead
        point = min(int(self.preview * observation.speed / _POINT_SPACING), len(bends) - 1)
        offset_gain, heading_gain = lqr_gains(
            self.setup.wheelbase, max(round(observation.speed), 1)
        )
        steering = math.atan(self.setup.wheelbase * float(bends[point]))
        steering -= offset_gain * observation.lateral_offset
        steering -= heading_gain * observation.heading_error
        return Controls.from_acceleration(
            1.5 * (speed - observation.speed), steering, speed=observation.speed, setup=self.setup
        )


@cache
def lqr_gains(wheelbase: float, speed: int) -> tuple[float, float]:
    """Return the gains of offset in rad/m and heading at a speed in m/s, by Riccati's iteration."""
    moved = speed * _STEP
    a = np.array([[1.0, moved], [0.0, 1.0]])
    b = np.array([[0.0], [moved / wheelbase]])
    cost, effort = np.diag([0.4, 1.0]), np.array([[4.0]])
    p = cost
    for _ in range(150):
        gain = np.linalg.solve(effort + b.T @ p @ b, b.T @ p @ a)
        p = cost + a.T @ p @ (a - b @ gain)
    return float(gain[0, 0]), float(gain[0, 1])


class RateLimitedPursuit:
    """Pure pursuit whose steering turns at most so fast.

    Args:
        rate: Largest rate of the steering angle, in rad/s.
        lookahead: Time to the point that it steers for, in s.
        lateral: Lateral acceleration that it plans in bends, in m/s^2.
    """

    def __init__(self, *, rate: float = 0.5, lookahead: float = 0.7, lateral: float = 6.0) -> None:
        self.rate, self.lookahead, self.lateral = rate, lookahead, lateral

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive."""
        self.setup, self.steering = setup, 0.0

    def act(self, observation: Observation) -> Controls:
        """Return steering and pedals."""
        speed = bend_speed(observation, self.lateral, braking=3.0)
        x, y = observation.ahead[:, 0] + self.setup.rear_axle, observation.ahead[:, 1]
        distances = np.hypot(x, y)
        k = int(np.argmax(distances >= max(4.0, self.lookahead * observation.speed)))
        wanted = math.atan(2.0 * self.setup.wheelbase * y[k] / distances[k] ** 2)
        most = self.rate * _STEP
        self.steering += min(max(wanted - self.steering, -most), most)
        return Controls.from_acceleration(
            1.5 * (speed - observation.speed),
            self.steering,
            speed=observation.speed,
            setup=self.setup,
        )
