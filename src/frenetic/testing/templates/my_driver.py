"""A driver for Frenetic, ready to edit.

The driver slows down for the sharpest bend in sight and steers for a point ahead of the car.
"""

import math

from frenetic import Controls, DriveSetup, Observation

LATERAL_ACCELERATION = 6.0  # m/s^2, the most in bends
TOP_SPEED = 60 / 3.6  # m/s


class MyDriver:
    """Keeps to the middle of the lane. Arguments are options: --driver FILE:MyDriver,sight=30."""

    def __init__(self, sight: float = 20.0) -> None:
        """Store ``sight``, the length of road ahead, in m, for which the speed is chosen."""
        self.sight = sight
        self.wheelbase = 0.0

    def reset(self, setup: DriveSetup) -> None:
        """Begin a drive. Forget the last drive here: the same road has to give the same drive."""
        self.wheelbase = setup.wheelbase

    def act(self, observation: Observation) -> Controls:
        """Return the controls for the next 0.05 s; see `frenetic.Observation` for what it knows."""
        bends = observation.curvature_ahead[: int(self.sight / 2) + 1]  # one value every 2 m
        sharpest = max(float(abs(bends).max()), 1e-3)  # 1/m
        wanted = min(TOP_SPEED, math.sqrt(LATERAL_ACCELERATION / sharpest))
        too_slow = wanted - observation.speed

        x, y = observation.ahead[4]  # the lane's middle 8 m ahead, as the car sees it
        return Controls(
            steering=math.atan(2 * self.wheelbase * y / (x * x + y * y)),
            throttle=min(max(0.5 * too_slow, 0.0), 1.0),
            brake=min(max(-0.3 * too_slow, 0.0), 1.0),
        )
