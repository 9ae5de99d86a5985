"""The car of BeamNG.tech: as it was measured, and during a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from frenetic.drivers.camera import Image
from frenetic.plugins.beamng.link import STEPS_PER_SECOND, BeamngError, Link
from frenetic.road import Road
from frenetic.road.geometry import project_near, reach_of
from frenetic.simulators.drive_loop import RECORD_PERIOD
from frenetic.simulators.observer import LimitsAhead, wrap

WHEELBASE_PER_LENGTH: Final = 0.6
"""Assumed share: BeamNG.tech does not report the axles."""

_CREEP: Final = 0.3  # m/s, below which braking is left to the parking brake
_CLOCK_SHARE, _CLOCK_SLACK = 0.02, 0.01  # how far the clock may be off: of the time, and s
_AI_DECELERATION: Final = 3.0  # m/s^2, with which BeamNG.AI is made to brake to a lower limit; ours
_LIMIT_STEP: Final = 0.5  # m/s, least change of the limit that BeamNG.AI is told; ours


@dataclass(frozen=True)
class MeasuredCar:
    """A car as it was measured in BeamNG.tech, to the millimetre."""

    length: float
    """Length of its bounding box, in m."""
    width: float
    """Width of its bounding box, in m."""
    ahead: float
    """Distance by which the box's middle lies ahead of the car's position, in m."""
    left: float
    """Distance by which it lies to the left, in m."""
    steering: float = 1.0
    """Front wheels' angle at steering input 1, in rad; negative if that turns to the right."""
    shown: float = 0.0
    """Front wheels' angle that a reported steering input of 1 stands for; 0 if none is reported."""

    @property
    def wheelbase(self) -> float:
        """Assumed distance between the axles, in m."""
        return WHEELBASE_PER_LENGTH * self.length


class BeamngCar:
    """The car during one drive.

    Args:
        link: connection to BeamNG.tech, which has placed the car.
        measured: the car as it was measured.
        road: road under the car.
        limits: speed limits of the road under the car.
        by_ai: whether BeamNG.AI drives it.
        has_camera: whether it has a camera.
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
        self._s, self._limit = 0.0, self._limits.at(0.0)[0]  # m along the road, m/s
        self._car = measured
        self._by_ai = by_ai
        self._has_camera = has_camera
        self._times: tuple[int, float] | None = None  # periods, and BeamNG.tech's time at the start
        self._heading = self._speed = 0.0

    def motion(self) -> list[float]:
        """Return the motion of the car; with BeamNG.AI, the controls, too."""
        state, car = self._link.state(), self._car
        heading, yaw_rate = state.heading, 0.0
        if self._times is None:
            self._times = 0, state.time
        else:
            turned = wrap(heading - self._heading)
            heading, yaw_rate = self._heading + turned, turned / RECORD_PERIOD
        periods, began = self._times
        self._check_clock(state.time - began, periods * RECORD_PERIOD)
        self._times = periods + 1, began
        x, y = state.place(car.ahead, car.left)
        c, s = math.cos(heading), math.sin(heading)
        # The velocity belongs to the car's position; the car's middle swings round it.
        vx = state.velocity[0] - yaw_rate * (car.ahead * s + car.left * c)
        vy = state.velocity[1] + yaw_rate * (car.ahead * c - car.left * s)
        self._heading, self._speed = heading, c * vx + s * vy
        if self._by_ai and not self._limits.is_constant:
            self._limit_ai(x, y)
        steering = car.shown * state.steering_input
        motion = [x, y, heading, self._speed, c * vy - s * vx, yaw_rate, steering]
        shown = [steering, state.throttle_input, state.brake_input]
        return [*motion, *shown] if self._by_ai else motion

    def _limit_ai(self, x: float, y: float) -> None:
        """Tell BeamNG.AI the speed from which it can brake to the limits ahead."""
        reach = reach_of(RECORD_PERIOD * abs(self._speed))
        line = self._road.table, self._road.sub_step
        self._s, _ = project_near(*line, x, y, self._s, reach)
        limit = self._limits.speed_at(self._s, _AI_DECELERATION)
        if abs(limit - self._limit) > _LIMIT_STEP:
            self._link.limit_ai(limit)
            self._limit = limit

    def _check_clock(self, passed: float, due: float) -> None:
        if abs(passed - due) > _CLOCK_SHARE * due + _CLOCK_SLACK:
            raise BeamngError(
                f"the clock of BeamNG.tech shows {passed:.3f} s after {due:.2f} s of steps: it does"
                f" not keep {STEPS_PER_SECOND} steps per second"
            )

    def picture(self) -> Image | None:
        """Return what the camera sees."""
        return self._link.picture() if self._has_camera else None

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Steer, unless BeamNG.AI does, and let time pass."""
        if not self._by_ai:
            # The gearbox takes the brake of a car at rest for the wish to drive backwards.
            holds = brake > 0.0 and throttle == 0.0 and self._speed < _CREEP
            self._link.control(
                min(max(steering / self._car.steering, -1.0), 1.0),
                throttle,
                0.0 if holds else brake,
                1.0 if holds else 0.0,
            )
        self._link.step(seconds)
