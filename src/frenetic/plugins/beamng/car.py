"""The car of BeamNG.tech: its measured sizes, and the car during a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from frenetic._support.trigonometry import wrapped
from frenetic.drivers.camera import Image
from frenetic.plugins.beamng.link import STEPS_PER_SECOND, Link
from frenetic.plugins.beamng.package import BeamngError
from frenetic.road import Road
from frenetic.road.geometry import project_near, reach_of
from frenetic.simulators.drive_loop import RECORD_PERIOD
from frenetic.simulators.observer import LimitsAhead

WHEELBASE_PER_LENGTH: Final = 0.6
"""Distance between the axles as a share of the length: our choice, since BeamNG.tech does not
report the axles."""

_PARKING_SPEED: Final = 0.3
"""Speed in m/s below which the parking brake replaces the brake; our choice."""
_MAX_CLOCK_ERROR: Final = 0.02
"""Share of the time of a drive by which BeamNG.tech's clock may be wrong; our choice."""
_CLOCK_TOLERANCE: Final = 0.01
"""Time by which the clock may be wrong in addition, in s; our choice."""
_AI_DECELERATION: Final = 3.0
"""Deceleration with which BeamNG.AI brakes to a lower speed limit, in m/s²; our choice."""
_MIN_LIMIT_CHANGE: Final = 0.5
"""Least change of the speed limit that BeamNG.AI is told, in m/s; our choice."""


@dataclass(frozen=True)
class MeasuredCar:
    """Sizes of a car and its answer to steering, measured in BeamNG.tech to the millimetre."""

    length: float
    """Length of its bounding box, in m."""
    width: float
    """Width of its bounding box, in m."""
    ahead: float
    """Distance of the box's middle ahead of the car's reference node, in m."""
    left: float
    """Distance of the box's middle to the left of the car's reference node, in m."""
    steering: float = 1.0
    """Front wheels' angle at steering input 1, in rad; negative if that turns to the right."""
    reported_steering: float = 0.0
    """Front wheels' angle when BeamNG.tech reports steering input 1, in rad, positive to the left;
    0 if it reports none."""

    @property
    def wheelbase(self) -> float:
        """Assumed distance between the axles, in m."""
        return WHEELBASE_PER_LENGTH * self.length


class BeamngCar:
    """The car during one drive: a `MovedCar`.

    Args:
        link: connection to BeamNG.tech, which has placed the car.
        measured: measured sizes of the car.
        road: road under the car.
        limits: speed limits of the road.
        by_ai: whether BeamNG.AI drives the car.
        has_camera: whether the car has a camera.
    """

    def __init__(
        self,
        link: Link,
        measured: MeasuredCar,
        road: Road,
        limits: LimitsAhead,
        *,
        by_ai: bool,
        has_camera: bool,
    ) -> None:
        self._link = link
        self._road = road
        self._limits = limits
        self._s = 0.0  # distance along the road, in m
        self._ai_limit = self._limits.at(0.0)[0]  # last limit that BeamNG.AI was told, in m/s
        self._car = measured
        self._by_ai = by_ai
        self._has_camera = has_camera
        # Number of periods driven, and BeamNG.tech's time at the start; None before the start
        self._clock: tuple[int, float] | None = None
        self._heading = self._speed = 0.0  # at the last record, in rad and m/s

    def motion(self) -> list[float]:
        """Return the motion of the car's middle; with BeamNG.AI also its controls."""
        state, car = self._link.state(), self._car
        heading, yaw_rate = state.heading, 0.0
        if self._clock is None:
            self._clock = 0, state.time
        else:
            turned = wrapped(heading - self._heading)
            heading, yaw_rate = self._heading + turned, turned / RECORD_PERIOD
        periods, start_time = self._clock
        self._check_clock(state.time - start_time, periods * RECORD_PERIOD)
        self._clock = periods + 1, start_time
        x, y = state.point(car.ahead, car.left)
        c, s = math.cos(heading), math.sin(heading)
        # The reported velocity is the reference node's; the car's middle turns about this node.
        vx = state.velocity[0] - yaw_rate * (car.ahead * s + car.left * c)
        vy = state.velocity[1] + yaw_rate * (car.ahead * c - car.left * s)
        self._heading, self._speed = heading, c * vx + s * vy
        if self._by_ai and not self._limits.is_constant:
            self._limit_ai(x, y)
        steering = car.reported_steering * state.steering_input
        motion = [x, y, heading, self._speed, c * vy - s * vx, yaw_rate, steering]
        controls = [steering, state.throttle_input, state.brake_input]
        return [*motion, *controls] if self._by_ai else motion

    def _limit_ai(self, x: float, y: float) -> None:
        """Tell BeamNG.AI the highest speed from which it can brake to the limits ahead."""
        reach = reach_of(RECORD_PERIOD * abs(self._speed))
        line = self._road.table, self._road.sub_step
        self._s, _ = project_near(*line, x, y, self._s, reach)
        limit = self._limits.speed_at(self._s, _AI_DECELERATION)
        if abs(limit - self._ai_limit) > _MIN_LIMIT_CHANGE:
            self._link.limit_ai(limit)
            self._ai_limit = limit

    def _check_clock(self, passed: float, due: float) -> None:
        """Check that BeamNG.tech's clock shows the time that the steps should have taken, in s.

        Raises:
            BeamngError: it does not.
        """
        if abs(passed - due) > _MAX_CLOCK_ERROR * due + _CLOCK_TOLERANCE:
            raise BeamngError(
                f"the clock of BeamNG.tech shows {passed:.3f} s after {due:.2f} s of steps: it does"
                f" not keep {STEPS_PER_SECOND} steps per second"
            )

    def picture(self) -> Image | None:
        """Return what the camera sees; None without a camera."""
        return self._link.picture() if self._has_camera else None

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Set the controls, unless BeamNG.AI does, and let time pass."""
        if not self._by_ai:
            # At rest the gearbox takes the brake for the wish to drive backwards.
            parks = brake > 0.0 and throttle == 0.0 and self._speed < _PARKING_SPEED
            self._link.control(
                steering=min(max(steering / self._car.steering, -1.0), 1.0),
                throttle=throttle,
                brake=0.0 if parks else brake,
                parking=1.0 if parks else 0.0,
            )
        self._link.step(seconds)
