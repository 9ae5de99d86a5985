"""A driver that follows the line at its lane's right edge, by its camera's picture alone."""

from __future__ import annotations

import math
from typing import ClassVar, Final

import numpy as np

from frenetic._support.bounds import Positive, check
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import Controls, DriveSetup, Observation

# All constants are our choice; they suit the markings that `rendering.py` draws.
NEAREST: Final = 4.0
"""Least distance ahead of the car at which the driver looks for the line, in m."""
FARTHEST: Final = 25.0
"""Largest distance ahead of the car at which the driver looks for the line, in m."""
CONTRAST: Final = 15.0
"""Least difference of brightness between a line and both its sides, of 255."""
INSIDE: Final = 0.2
"""Distance of the line's middle from the lane's edge, in m."""

_MOST_DEVIATION = 0.8  # [m], of the line in a row of pixels from where it is expected
_SIDE_DISTANCE = 0.25  # [m], from the middle of a line to the surface beside it
_LEAST_POINTS = 3  # of the line, to steer by it
_TARGET_DISTANCE = 5.0  # [m], to the point for which a car at rest steers
_TARGET_TIME = 0.5  # [s]: this many seconds of driving are added to the target's distance
_LOST_LINE_SPEED = 0.6  # share of the speed that is kept without a line
_THROTTLE_GAIN = 0.4  # [s/m], throttle for each m/s that the car is too slow
_BRAKE_GAIN = 0.3  # [s/m], brake for each m/s that the car is too fast
_LEAST_CURVATURE = 1e-3  # [1/m], for the speed in a bend


class MarkingFollower:
    """A driver that stays half a lane to the left of the line at its lane's right edge.

    In each row of pixels, from the car on, the driver looks for a spot that is brighter than both
    its sides. It steers for a point half a lane beside the line (pure pursuit), and slows down for
    bends. Without a line it keeps its steering and drives slower. It uses the picture, the speed
    and the speed limit of an observation, nothing else.

    Args:
        speed: speed on a straight road, in km/h.
        lateral: largest lateral acceleration in a bend, in m/s^2.

    Raises:
        ValueError: an option is not positive.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, which campaigns record: increase it when the driver drives
    differently."""

    def __init__(self, *, speed: Positive = 45.0, lateral: Positive = 2.5) -> None:
        check(locals(), MarkingFollower.__init__)
        self.camera = Camera()
        self.options = {"speed": float(speed), "lateral": float(lateral)}
        # Where each pixel's ray meets the flat ground, in the car's frame.
        rays = self.camera.rays_through(*np.mgrid[0 : self.camera.height, 0 : self.camera.width])
        length = self.camera.up / np.maximum(-rays[..., 2], 1e-9)
        self._ahead = rays[..., 0] * length + self.camera.forward
        self._left = rays[..., 1] * length + self.camera.left
        middle = self._ahead[:, self.camera.width // 2]
        is_in_reach = (middle > NEAREST) & (middle < FARTHEST)
        self._rows = np.flatnonzero(is_in_reach)[::-1]  # from the car on

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive and prepare for the next."""
        self._setup = setup
        self._curvature = 0.0
        self._line = INSIDE - 0.5 * setup.lane_width  # m to the left of the car

    def act(self, observation: Observation) -> Controls:
        """Return controls that steer for a point half a lane beside the line."""
        assert observation.image is not None
        points = self._line_points(observation.image)
        limit = min(self.options["speed"] / 3.6, observation.speed_limit)
        if len(points) >= _LEAST_POINTS:
            self._line = points[0][1]
            self._curvature = self._curvature_along(points, observation.speed)
        else:
            limit *= _LOST_LINE_SPEED
        curvature = max(abs(self._curvature), _LEAST_CURVATURE)
        bend_speed = math.sqrt(self.options["lateral"] / curvature)
        error = min(limit, bend_speed) - observation.speed
        return Controls(
            steering=math.atan(self._setup.wheelbase * self._curvature),
            throttle=min(max(_THROTTLE_GAIN * error, 0.0), 1.0),
            brake=min(max(-_BRAKE_GAIN * error, 0.0), 1.0),
        )

    def _curvature_along(self, points: list[tuple[float, float]], speed: float) -> float:
        """Return the curvature in 1/m of the arc to a point beside the line (pure pursuit).

        Args:
            points: points of the line, see `_line_points`.
            speed: speed of the car, in m/s.
        """
        distance = _TARGET_DISTANCE + _TARGET_TIME * speed
        target = min(int(np.searchsorted([x for x, _ in points], distance)), len(points) - 1)
        (x0, y0), (x1, y1) = points[max(target - 2, 0)], points[target]
        length = max(math.hypot(x1 - x0, y1 - y0), 1e-6)
        beside = 0.5 * self._setup.lane_width - INSIDE
        x, y = x1 - beside * (y1 - y0) / length, y1 + beside * (x1 - x0) / length
        # Pure pursuit's arc begins at the rear axle, the points' frame at the centre of mass.
        x += self._setup.rear_axle
        return 2.0 * y / (x * x + y * y)

    def _line_points(self, image: Image) -> list[tuple[float, float]]:
        """Return points of the line, from the car on: m ahead, m to the left.

        In each row the point is the spot of the largest contrast near the place that the points
        before let expect; a row without enough contrast has no point.
        """
        brightness = image.min(axis=2).astype(np.float64)  # low also for bright colours
        points: list[tuple[float, float]] = []
        last_left, slope, last_ahead = self._line, 0.0, NEAREST
        for row in self._rows:
            left, ahead = self._left[row], float(self._ahead[row, 0])
            side_pixels = max(round(_SIDE_DISTANCE / abs(left[0] - left[1])), 1)
            values = brightness[row]
            contrast = np.zeros_like(values)
            sides = np.maximum(values[: -2 * side_pixels], values[2 * side_pixels :])
            contrast[side_pixels:-side_pixels] = values[side_pixels:-side_pixels] - sides
            expected = last_left + slope * (ahead - last_ahead)
            contrast[np.abs(left - expected) > _MOST_DEVIATION] = 0.0
            best = int(contrast.argmax())
            if contrast[best] < CONTRAST:
                continue
            line_left = float(left[best])
            if points:
                # The mean with the slope before smooths the step from pixel to pixel.
                slope = 0.5 * (slope + (line_left - last_left) / max(ahead - last_ahead, 1e-6))
            points.append((ahead, line_left))
            last_left, last_ahead = line_left, ahead
        return points
