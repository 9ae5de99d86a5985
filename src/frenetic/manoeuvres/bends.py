"""Manoeuvres with one bend: a step of curvature, and a steady bend."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Positive, check
from frenetic.manoeuvres.manoeuvre import (
    CAR,
    CURVATURE,
    FRONT_WHEELS,
    LARGEST_OFFSET,
    MAX_CHANGE,
    MEAN_SPEED,
    RUN_OUT,
    STEADY_OFFSET,
    STEADY_TIME,
    VIEW,
    Graph,
    Hold,
    Line,
    ManoeuvreDrive,
    Measures,
    Quantity,
    QuantityName,
    Transition,
    require_drivable,
    run_up,
)
from frenetic.manoeuvres.response import response_names, response_quantities, step_response
from frenetic.road import Road
from frenetic.road.pieces import sampled_curvatures, single_bend
from frenetic.road.validity import MIN_RADIUS

_STEP: Final = 1.0  # [m] between two curvature samples; our choice
_USUAL_TRANSITION: Final = 5.0  # [m]; our choice
_BEFORE: Final = 3.0  # [s] before the bend that belong to the response; our choice
_LEAST_ACCELERATION: Final = 1e-3  # [m/s²] below which a car does not turn; our choice


@dataclass
class BendManoeuvre:
    """Base of manoeuvres with one bend: a straight, a short clothoid and a long arc.

    The car reaches its speed on the straight. Behind the part of the arc on which the drive is
    measured, the arc goes on for as far as a driver sees, so that no driver reacts to its end.
    """

    radius: Positive | None = None
    """Radius of the road's centre line in the arc, in m; None: from `acceleration`."""
    acceleration: Positive = 2.0
    """Lateral acceleration in the arc at the speed limit, in m/s², if there is no `radius`, as far
    as roads may bend."""
    side: Literal["left", "right"] = "left"
    """Side to which the road bends."""
    transition: Transition | None = None
    """Length of the clothoid between straight and arc, in m; None: 5 m, or the least allowed."""
    hold: Hold = 10.0
    """Driving time on the arc that is measured, in s at the speed limit."""

    def __post_init__(self) -> None:
        check(vars(self), BendManoeuvre)

    def conditions(self, speed: float) -> Mapping[str, float]:  # noqa: ARG002  # as the protocol
        """Return the conditions of the drive: none of its own."""
        return {}

    def curvature(self, speed: float) -> float:
        """Return the curvature of the arc at a speed limit in m/s, in 1/m, positive to the left."""
        radius = self.radius
        if radius is None:
            radius = max(speed * speed / self.acceleration, MIN_RADIUS)
        return (1.0 if self.side == "left" else -1.0) / radius

    def transition_at(self, speed: float) -> float:
        """Return the length of the clothoid at a speed limit in m/s, in m."""
        if self.transition is not None:
            return self.transition
        return max(_USUAL_TRANSITION, abs(self.curvature(speed)) / MAX_CHANGE)

    def road(self, speed: float, lane_width: float) -> Road:
        """Return the road.

        Args:
            speed: speed limit, in m/s.
            lane_width: width of each lane, in m.

        Raises:
            RoadError: the bend is too sharp, its clothoid too short, or the road too long.
        """
        curvature, transition = self.curvature(speed), self.transition_at(speed)
        require_drivable(curvature, curvature / transition)
        pieces = single_bend(
            curvature,
            run_up=math.ceil(run_up(speed)),
            transition=transition,
            arc=self.hold * speed + VIEW,
            run_out=RUN_OUT,
        )
        return Road(sampled_curvatures(pieces, _STEP), _STEP, lane_width=lane_width)

    def places(self, speed: float) -> tuple[float, float]:
        """Return where the curvature is half of the arc's, and where the measured part ends, in m.

        Args:
            speed: speed limit, in m/s.
        """
        start, transition = math.ceil(run_up(speed)), self.transition_at(speed)
        return start + 0.5 * transition, start + transition + self.hold * speed


@dataclass
class CurvatureStep(BendManoeuvre):
    """A step of curvature: how fast and how exactly the car follows a road that begins to bend."""

    name: ClassVar[str] = "step"
    QUANTITIES: ClassVar[tuple[QuantityName, ...]] = (
        MEAN_SPEED,
        *response_names(CURVATURE),
        LARGEST_OFFSET,
        STEADY_OFFSET,
    )

    def measure(self, drive: ManoeuvreDrive) -> Measures:
        """Return the step response of the curvature driven, and the lateral offset in the bend."""
        middle, end = self.places(drive.speed)
        step_time, end_time = drive.time_at(middle), drive.time_at(end)
        if step_time is None or end_time is None:
            return Measures.missing(self.QUANTITIES, drive.end_text)
        records = drive.between(step_time - _BEFORE, end_time)
        time = drive.time[records]
        asked, driven = drive.asked_curvature[records], drive.driven_curvature[records]
        response = step_response(
            time, driven, step_time=step_time, start=0.0, asked=float(asked[-1])
        )
        quantities = (
            drive.mean_speed(step_time, end_time),
            *response_quantities(response, CURVATURE, "1/m"),
            drive.largest_offset(step_time - _BEFORE, end_time),
            drive.steady_offset(end_time),
        )
        graphs = (
            _over_time(time - step_time, "curvature (1/m)", {"road": asked, "car": driven}),
            _over_time(time - step_time, "lateral offset (m)", {"car": drive.offset[records]}),
        )
        return Measures(quantities, graphs)


_ACCELERATION: Final = QuantityName("lateral_acceleration", CAR, "m/s²")
_STEERING: Final = QuantityName("steering", FRONT_WHEELS, "°")
_UNDERSTEER: Final = (
    QuantityName("geometric_steering", FRONT_WHEELS, "°"),
    QuantityName("understeer", FRONT_WHEELS, "°"),
    QuantityName("understeer_gradient", FRONT_WHEELS, "°/(m/s²)"),
)


@dataclass
class ConstantRadius(BendManoeuvre):
    """A steady bend: the offset that remains, and how much the car understeers."""

    name: ClassVar[str] = "constant-radius"
    QUANTITIES: ClassVar[tuple[QuantityName, ...]] = (
        MEAN_SPEED,
        _ACCELERATION,
        STEADY_OFFSET,
        _STEERING,
        *_UNDERSTEER,
    )

    def measure(self, drive: ManoeuvreDrive) -> Measures:
        """Return offset, steering and understeer at the end of the bend."""
        middle, end = self.places(drive.speed)
        step_time, end_time = drive.time_at(middle), drive.time_at(end)
        if step_time is None or end_time is None:
            return Measures.missing(self.QUANTITIES, drive.end_text)
        path = drive.located.path
        steady = drive.between(end_time - STEADY_TIME, end_time)
        steering = float(np.degrees(path.steering[steady]).mean())
        acceleration = float((path.yaw_rate * path.speed)[steady].mean())
        curvature = float(drive.driven_curvature[steady].mean())
        quantities = (
            drive.mean_speed(end_time - STEADY_TIME, end_time),
            _ACCELERATION.measured(acceleration),
            drive.steady_offset(end_time),
            _STEERING.measured(steering),
            *_understeer(drive.wheelbase, steering, curvature, acceleration),
        )
        records = drive.between(step_time - _BEFORE, end_time)
        time = drive.time[records] - step_time
        angles = {"front wheels": np.degrees(path.steering[records])}
        if drive.wheelbase is not None:
            geometric = np.arctan(drive.wheelbase * drive.asked_curvature[records])
            angles["geometric angle"] = np.degrees(geometric)
        graphs = (
            _over_time(time, "steering (°)", angles),
            _over_time(time, "lateral offset (m)", {"car": drive.offset[records]}),
        )
        return Measures(quantities, graphs)


def _understeer(
    wheelbase: float | None, steering: float, curvature: float, acceleration: float
) -> tuple[Quantity, ...]:
    """Return the geometric steering angle, and by how much the car's angle exceeds it.

    Args:
        wheelbase: distance between the axles, in m; None if it is not known.
        steering: angle of the front wheels, in degrees.
        curvature: curvature that the car drives, in 1/m.
        acceleration: lateral acceleration, in m/s².
    """
    reason = ""
    if wheelbase is None:
        reason = "not measured: the simulator does not say the wheelbase"
    elif abs(acceleration) < _LEAST_ACCELERATION:
        reason = "not measured: the car does not turn"
    if wheelbase is None or reason:
        return tuple(name.missing(reason) for name in _UNDERSTEER)
    geometric = math.degrees(math.atan(wheelbase * curvature))
    understeer = (steering - geometric) * math.copysign(1.0, curvature)
    values = geometric, understeer, understeer / abs(acceleration)
    return tuple(name.measured(value) for name, value in zip(_UNDERSTEER, values, strict=True))


def _over_time(time: FloatArray, title: str, lines: Mapping[str, FloatArray]) -> Graph:
    """Return a graph over the time since the bend began.

    Args:
        time: times, (n,) in s.
        title: title of the vertical axis.
        lines: name of a line -> values, (n,).
    """
    drawn = tuple(Line(name, time, values) for name, values in lines.items())
    return Graph("time since the bend began (s)", title, drawn)
