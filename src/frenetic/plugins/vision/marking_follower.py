"""A driver that sees nothing but its camera's picture: it follows the line at the lane's edge."""

from __future__ import annotations

import math
from typing import ClassVar, Final

import numpy as np

from frenetic._support.bounds import Positive, check
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import Controls, DriveSetup, Observation

NEAREST: Final = 4.0
"""Distance ahead at which it begins to look for the line, in m."""
FARTHEST: Final = 25.0
"""Distance ahead up to which it looks, in m."""
CONTRAST: Final = 15.0
"""Least contrast of a line with what is on both sides of it, of 255."""
INSIDE: Final = 0.2
"""Distance of the line's middle from the lane's edge, in m."""

_NEARBY = 0.8  # m within which the line goes on from one row of pixels to the next
_WIDE = 0.25  # m beside the middle of a line, where there is none


class MarkingFollower:
    """Follows the line at the right edge of its lane, half a lane from it, by its camera alone.

    It looks for something brighter than what is left and right of it, row by row from the car on,
    and steers for a point beside it (pure pursuit); its speed follows from how much it has to turn.
    Of an observation it takes the picture and the speed. Where it loses the line it goes on as
    before, slower.

    Args:
        speed: km/h at which it drives straight on.
        lateral: m/s^2, the lateral acceleration that it accepts.

    Raises:
        ValueError: an option is not positive.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when it drives differently; campaigns record it."""

    def __init__(self, *, speed: Positive = 45.0, lateral: Positive = 2.5) -> None:
        check(locals(), MarkingFollower.__init__)
        self.camera = Camera()
        self.options = {"speed": float(speed), "lateral": float(lateral)}
        rays = self.camera.rays_through(*np.mgrid[0 : self.camera.height, 0 : self.camera.width])
        reach = self.camera.up / np.maximum(-rays[..., 2], 1e-9)
        self._ahead = rays[..., 0] * reach + self.camera.forward
        self._left = rays[..., 1] * reach + self.camera.left
        middle = self._ahead[:, self.camera.width // 2]
        self._rows = np.flatnonzero((middle > NEAREST) & (middle < FARTHEST))[::-1]

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive."""
        self._setup = setup
        self._curvature = 0.0
        self._line = INSIDE - 0.5 * setup.lane_width

    def act(self, observation: Observation) -> Controls:
        """Steer for a point beside the line."""
        assert observation.image is not None
        points = self._line_points(observation.image)
        limit = min(self.options["speed"] / 3.6, observation.speed_limit)
        if len(points) >= 3:
            self._line = points[0][1]
            wanted = 5.0 + 0.5 * observation.speed
            i = min(int(np.searchsorted([x for x, _ in points], wanted)), len(points) - 1)
            (x0, y0), (x1, y1) = points[max(i - 2, 0)], points[i]
            length = max(math.hypot(x1 - x0, y1 - y0), 1e-6)
            beside = 0.5 * self._setup.lane_width - INSIDE
            x, y = x1 - beside * (y1 - y0) / length, y1 + beside * (x1 - x0) / length
            # From the rear axle, as pure pursuit has it.
            x += self._setup.rear_axle
            self._curvature = 2.0 * y / (x * x + y * y)
        else:
            limit *= 0.6
        bend = math.sqrt(self.options["lateral"] / max(abs(self._curvature), 1e-3))
        error = min(limit, bend) - observation.speed
        return Controls(
            steering=math.atan(self._setup.wheelbase * self._curvature),
            throttle=min(max(0.4 * error, 0.0), 1.0),
            brake=min(max(-0.3 * error, 0.0), 1.0),
        )

    def _line_points(self, image: Image) -> list[tuple[float, float]]:
        """Points of the line from the car on: m ahead, m to the left."""
        grey = image.min(axis=2).astype(np.float64)
        points: list[tuple[float, float]] = []
        line, slope, last = self._line, 0.0, NEAREST
        for row in self._rows:
            left, ahead = self._left[row], float(self._ahead[row, 0])
            gap = max(round(_WIDE / abs(left[0] - left[1])), 1)
            values = grey[row]
            contrast = np.zeros_like(values)
            sides = np.maximum(values[: -2 * gap], values[2 * gap :])
            contrast[gap:-gap] = values[gap:-gap] - sides
            expected = line + slope * (ahead - last)
            contrast[np.abs(left - expected) > _NEARBY] = 0.0
            best = int(contrast.argmax())
            if contrast[best] < CONTRAST:
                continue
            nearest = float(left[best])
            if points:
                slope = 0.5 * (slope + (nearest - line) / max(ahead - last, 1e-6))
            points.append((ahead, nearest))
            line, last = nearest, ahead
        return points
