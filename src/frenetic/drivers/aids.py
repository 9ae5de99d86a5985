"""Wrappers that help any driver: slower driving, an earlier view, pedals released in a slide.

A failure that passes with such help has its cause there, see `frenetic.rerun.cause_trials`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.conditions.aids import PACE, PEDAL_RELEASE, PREVIEW
from frenetic.drivers.driver import (
    AHEAD_SPACING,
    Controls,
    DriveSetup,
    Observation,
    changed_observation,
)
from frenetic.drivers.stack import AmountWrapper

_LEAST_SPEED: Final = 1.0  # [m/s] from which on slip angles are computed (our choice)


class Paced(AmountWrapper):
    """A driver whose car is slower, or faster, than the driver takes it to be.

    The driver reads its speed divided by the pace, so it keeps that share of the speed that it
    wants.

    Args:
        driver: the driver underneath.
        amount: speed of the car as a share of the speed that the driver reads.
    """

    condition = PACE
    amount_name = "share"
    place = 23

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the speed that it reads."""
        return self.driver.act(
            changed_observation(observation, speed=observation.speed / self.amount)
        )


class SeesEarlier(AmountWrapper):
    """A driver that sees the road as if its car were further along, by its speed times a time.

    Lateral offset and heading error stay as they are. Beyond the last point of the view the road is
    straight. An image does not change.

    Args:
        driver: the driver underneath.
        amount: the time, in s.
    """

    condition = PREVIEW
    amount_name = "seconds"
    place = 24

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the road further along."""
        shift = self.amount * max(observation.speed, 0.0)
        if shift == 0.0 or len(observation.ahead) < 2:
            return self.driver.act(observation)
        return self.driver.act(_further_along(observation, shift))


class ReleasesPedals(AmountWrapper):
    """A driver whose pedals are released while an axle slides.

    Args:
        driver: the driver underneath.
        amount: slip angle of an axle beyond which it slides, in rad.
    """

    condition = PEDAL_RELEASE
    amount_name = "slip"
    place = 25

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        super().reset(setup)
        self._axles = setup.front_axle, setup.rear_axle

    def act(self, observation: Observation) -> Controls:
        """Return the driver's steering, and its pedals unless an axle slides."""
        controls = self.driver.act(observation)
        front, rear = self._axles
        speed = max(observation.speed, _LEAST_SPEED)
        lateral_speed, yaw_rate = observation.lateral_speed, observation.yaw_rate
        front_slip = math.atan2(lateral_speed + front * yaw_rate, speed) - observation.steering
        rear_slip = math.atan2(lateral_speed - rear * yaw_rate, speed)
        if max(abs(front_slip), abs(rear_slip)) <= self.amount:
            return controls
        return replace(controls, throttle=0.0, brake=0.0)


def _further_along(observation: Observation, shift: float) -> Observation:
    """Return what a driver sees whose car is further along the road, by `shift` m."""
    n = len(observation.ahead)
    ahead = _with_straight(observation.ahead)
    bends = np.concatenate([observation.curvature_ahead, np.zeros(n)])
    pieces = min(shift / AHEAD_SPACING, float(n - 1))  # of road, from point to point
    first, numbers = int(pieces), np.arange(2 * n)
    points = np.column_stack(
        [np.interp(pieces + np.arange(n), numbers, ahead[:, column]) for column in (0, 1)]
    )
    # Heading of the lane there, in the car's frame: the chord's heading, turned with the bend.
    dx, dy = ahead[first + 1] - ahead[first]
    lane = math.atan2(dy, dx) + bends[first] * (pieces - first - 0.5) * AHEAD_SPACING
    normal = np.array([-math.sin(lane), math.cos(lane)])
    origin = points[0] + observation.lateral_offset * normal
    heading = lane + observation.heading_error
    cosine, sine = math.cos(heading), math.sin(heading)
    rotation = np.array([[cosine, -sine], [sine, cosine]])
    c, s = math.cos(observation.heading), math.sin(observation.heading)
    changes = {
        "ahead": (points - origin) @ rotation,
        "curvature_ahead": np.interp(pieces + np.arange(n), numbers, bends),
        "distance": observation.distance + pieces * AHEAD_SPACING,
        "x": observation.x + c * float(origin[0]) - s * float(origin[1]),
        "y": observation.y + s * float(origin[0]) + c * float(origin[1]),
        "heading": observation.heading + heading,
    }
    limits = observation.speed_limit_ahead
    if len(limits):
        later = np.minimum(first + np.arange(len(limits)), len(limits) - 1)
        changes |= {"speed_limit": float(limits[later[0]]), "speed_limit_ahead": limits[later]}
    return changed_observation(observation, **changes)


def _with_straight(ahead: FloatArray) -> FloatArray:
    """Return (n, 2) points with as many further points straight on, (2 n, 2)."""
    n, step = len(ahead), ahead[-1] - ahead[-2]
    return np.vstack([ahead, ahead[-1] + np.arange(1, n + 1)[:, np.newaxis] * step])
