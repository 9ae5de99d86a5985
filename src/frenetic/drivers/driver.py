"""The Driver protocol: the system under test sees observations and answers with controls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from frenetic._support.arrays import FloatArray
from frenetic.errors import DriverError

AHEAD_SPACING = 2.0
"""m along the road between two points of the view ahead."""
AHEAD_POINTS = 40
"""Points of a full view: 78 m."""


@dataclass(frozen=True)
class DriveSetup:
    """What a driver is told before a drive: the car, the lane and the limits."""

    speed_limit: float
    """m/s."""
    lane_width: float
    """m."""
    period: float
    """s between two calls of `act`."""
    front_axle: float
    """m from the centre of mass to the front axle."""
    rear_axle: float
    """m from the centre of mass to the rear axle."""
    car_length: float
    """m."""
    car_width: float
    """m."""
    max_steering: float
    """rad, the front wheels' largest angle."""
    max_acceleration: float
    """m/s^2 at full throttle and low speed."""
    max_deceleration: float
    """m/s^2 at full brake on a dry road."""

    @property
    def wheelbase(self) -> float:
        """M between the axles."""
        return self.front_axle + self.rear_axle


@dataclass(frozen=True, eq=False)
class Observation:
    """What a driver sees: its car relative to the ego lane, and the lane ahead."""

    time: float
    """s since the start."""
    speed: float
    """m/s along the car."""
    yaw_rate: float
    """rad/s, positive to the left."""
    steering: float
    """rad, angle of the front wheels, positive to the left."""
    lateral_offset: float
    """m, centre of mass to the left of the ego lane's centre line."""
    heading_error: float
    """rad, the car's heading less the lane's, positive when it points to the left, in -pi..pi."""
    ahead: FloatArray
    """(n, 2) m, the ego lane's centre line in the car's frame: x ahead, y to the left.

    The origin is the centre of mass. The first point is abreast of it, then one follows every 2 m
    of road. n is at most 40; a limited view has fewer."""
    curvature_ahead: FloatArray
    """(n,) 1/m, curvature of the ego lane's centre line at the points of `ahead`."""


@dataclass(frozen=True)
class Controls:
    """What a driver does until it is asked again."""

    steering: float
    """rad, wanted angle of the front wheels, positive to the left; the car limits it."""
    throttle: float = 0.0
    """0..1; values beyond are cut."""
    brake: float = 0.0
    """0..1; values beyond are cut."""


@runtime_checkable
class Driver(Protocol):
    """The system under test.

    A simulator calls `reset` before every drive and `act` every control period (20 Hz). A driver
    may be of any class that has these two methods. It must behave the same after every `reset`, or
    a failing road cannot be reproduced; randomness belongs into a seeded generator made there.
    """

    def reset(self, setup: DriveSetup) -> None:
        """Prepares for the next drive: forgets the last one."""

    def act(self, observation: Observation) -> Controls:
        """The controls for the next period."""


def checked_controls(controls: Any) -> tuple[float, float, float]:
    """(steering, throttle, brake) of what a driver returned, pedals cut to 0..1.

    Raises:
        DriverError: something else than `Controls`, or values that are not finite numbers.
    """
    if not isinstance(controls, Controls):
        raise DriverError(
            f"the driver returned {type(controls).__name__} instead of frenetic.Controls"
        )
    values = []
    for name in ("steering", "throttle", "brake"):
        value = getattr(controls, name)
        try:
            number = math.nan if isinstance(value, (str, bytes)) else float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise DriverError(
                f"the driver returned {name} = {repr(value)[:40]}, not a finite number"
            )
        values.append(number)
    steering, throttle, brake = values
    return steering, min(max(throttle, 0.0), 1.0), min(max(brake, 0.0), 1.0)
