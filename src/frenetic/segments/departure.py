"""The records of a drive up to where the car left its lane, as the causes of failures need them.

Signs are such that the side where the car left is positive. The *excursion* begins in the last
record in which the car moved no faster than `SETTLED_SPEED` towards that side. The lateral speed
gained since then is the sum of two *gains*, in m/s, each the integral of v² times a curvature over
time. The road's gain is positive where the road bends away from that side. The car's gain is
positive where the car turns towards that side; as long as the tyres grip, the car turns as it
steers.

The car was *sound* while it was on its line: near the lane's middle, or no further from it than
usual, and moving along the road. Usual is what the driver does in its passing drives, where they
are known, and what it did for most of this drive otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.segments.segment import Segment

# The values are our choice.
SETTLED_SPEED: Final = 0.1
"""Lateral speed towards the side where the car leaves at which its excursion begins, in m/s."""
_WHEELBASE_SHARE: Final = 0.57  # wheelbase as a share of the car's length
_REAR_AXLE_SHARE: Final = 0.3  # from centre of mass to rear axle, as a share of the car's length
_SLIDING_SLIP: Final = np.radians(10.0)  # [rad] least slip angle of a rear that slides
_GRIPPING_SLIP: Final = np.radians(5.0)  # [rad] largest slip angle of a rear that grips
_MIN_SLIDE_TIME: Final = 0.4  # [s] least time from the start of a slide to a departure by it
_SLIDE_GAP: Final = 1.5  # [s] without sliding between two slides
_PEDAL_TIME: Final = 0.6  # [s] over which pedals are averaged
_LINE: Final = 0.5  # [m] largest offset of a car on its line, if it keeps to the lane's middle
_FARTHEST_LINE: Final = 1.2  # [m] largest offset of a car on its line, wherever it keeps
_LINE_QUANTILE: Final = 0.75  # quantile of the offsets so far up to which a car is on its line
_ALONG_SPEED: Final = 0.6  # [m/s] largest lateral speed of a car that moves along the road
_SOUND_TIME: Final = 0.2  # [s] for which a car was sound at least


@dataclass(frozen=True, eq=False)
class Departure:
    """Records of a drive up to a departure, and the lateral speed gained in each: (n,) arrays.

    Gains are towards the side where the car leaves, in m/s.
    """

    segment: Segment
    """The segment around the departure."""
    sign: float
    """1 if the car left to the left, -1 if it left to the right."""
    wheelbase: float
    """Wheelbase, in m, from the car's length."""
    time: FloatArray
    """Simulated time, in s."""
    offset: FloatArray
    """Offset from the lane's middle towards the side where the car leaves, in m."""
    lateral_speed: FloatArray
    """Lateral speed towards this side, in m/s."""
    speed: FloatArray
    """Speed, in m/s."""
    curvature: FloatArray
    """Curvature of the road beside the car, in 1/m, positive to the left."""
    road: FloatArray
    """Gain by the road; positive where the road bends away from this side."""
    steered: FloatArray
    """Gain by the turn that the steering would give if the tyres gripped."""
    turned: FloatArray
    """Gain by the turn of the car."""
    steering: FloatArray
    """Angle of the front wheels, in rad."""
    steering_input: FloatArray
    """Angle of the front wheels that the driver asks for, in rad."""
    throttle: FloatArray
    """Throttle pedal, 0..1."""
    brake: FloatArray
    """Brake pedal, 0..1."""
    last_slide: int | None
    """First record of the last slide; None without a slide."""
    usual_offset: float | None = None
    """Offset up to which the driver keeps its line in its passing drives, in m; None if unknown."""

    @classmethod
    def of(cls, segment: Segment, usual_offset: float | None = None) -> Departure:
        """Return the records and gains of a drive up to the departure."""
        assessment, path = segment.assessment, segment.drive.trajectory
        n = len(assessment.distance)
        sign, length = 1.0 if segment.side == "left" else -1.0, segment.drive.car.length
        # Places and times are finite, but other values may not be, and two times may be equal.
        speed, lateral_speed, yaw_rate, steering, steering_input, throttle, brake = (
            _finite(column[:n])
            for column in (
                path.speed,
                path.lateral_speed,
                path.yaw_rate,
                path.steering,
                path.steering_input,
                path.throttle,
                path.brake,
            )
        )
        time, offset = path.time[:n], sign * assessment.lateral_offset
        step = np.maximum(_change(time), 1e-6)
        curvature = segment.road.curvature_at(assessment.distance)
        wheelbase = _WHEELBASE_SHARE * length
        rear_speed = lateral_speed - _REAR_AXLE_SHARE * length * yaw_rate
        return cls(
            segment=segment,
            sign=sign,
            wheelbase=wheelbase,
            time=time,
            offset=offset,
            lateral_speed=_change(offset) / step,
            speed=speed,
            curvature=curvature,
            road=-sign * step * speed**2 * curvature,
            steered=sign * step * speed**2 * np.tan(steering) / wheelbase,
            turned=sign * step * speed * yaw_rate,
            steering=steering,
            steering_input=steering_input,
            throttle=throttle,
            brake=brake,
            last_slide=_start_of_slide(time, rear_speed, speed),
            usual_offset=usual_offset,
        )

    @property
    def slide(self) -> int | None:
        """First record of the slide by which the car leaves; None without such a slide."""
        slide = self.last_slide
        if slide is None or self.before_end(slide) < _MIN_SLIDE_TIME:
            return None
        return slide

    @cached_property
    def begin(self) -> int:
        """First record of the excursion."""
        return last_record(self.lateral_speed[:-1] <= SETTLED_SPEED)

    @cached_property
    def end(self) -> int:
        """Record at which the excursion ends: where a slide begins, or after the last record."""
        return len(self.time) if self.slide is None else max(self.slide, self.begin)

    @cached_property
    def last_sound(self) -> int:
        """Last record in which the car was sound; 0 if there is none."""
        offsets = np.abs(self.offset)
        usual = self.usual_offset
        if usual is None:
            rank = int(_LINE_QUANTILE * (len(offsets) - 1))
            usual = float(np.partition(offsets, rank)[rank])
        line = min(max(_LINE, usual), _FARTHEST_LINE)
        is_sound = (offsets <= line) & (np.abs(self.lateral_speed) <= _ALONG_SPEED)
        # A car that swings through its lane's middle is not sound: it has to stay so for a while.
        for first, last in reversed(stretches(is_sound)):
            if self.time[last] - self.time[first] >= _SOUND_TIME:
                return last
        return 0

    def before_end(self, record: int) -> float:
        """Return the time from a record to the departure, in s."""
        return float(self.time[-1] - self.time[record])

    def mean_before(self, record: int, values: FloatArray) -> float:
        """Return the mean of values, (n,), over `_PEDAL_TIME` up to and with a record."""
        first = last_record(self.time <= self.time[record] - _PEDAL_TIME)
        return float(values[first : record + 1].mean())

    @cached_property
    def needed_steering(self) -> FloatArray:
        """Steering with which a car follows the road at each record, (n,) in rad, roughly."""
        return np.arctan(self.wheelbase * self.curvature)

    def steering_rates(self, first: int) -> FloatArray:
        """Return how fast the wanted steering turns from each record on to the next, in rad/s.

        Args:
            first: Record with which the rates begin.
        """
        steps = np.maximum(np.diff(self.time[first:]), 1e-6)
        return np.abs(np.diff(self.steering_input[first:])) / steps


def stretches(condition: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and the last record of each stretch in which a condition holds."""
    padded = np.zeros(len(condition) + 2, dtype=np.bool_)
    padded[1:-1] = condition
    edges = np.flatnonzero(padded[1:] != padded[:-1]).tolist()
    return [(first, end - 1) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def last_record(condition: npt.NDArray[np.bool_]) -> int:
    """Return the last record in which a condition holds; 0 if it never holds."""
    records = np.flatnonzero(condition)
    return int(records[-1]) if len(records) else 0


def _finite(values: FloatArray) -> FloatArray:
    """Return values, (n,), with 0 in place of NaN and infinity."""
    if np.isfinite(np.add.reduce(values)):  # so all are finite, as nearly always
        return values
    return np.nan_to_num(values, posinf=0.0, neginf=0.0)


def _change(values: FloatArray) -> FloatArray:
    """Return the change of values per record, (n,), n >= 2: ``np.gradient`` in less time."""
    change = np.empty(len(values))
    change[1:-1] = 0.5 * (values[2:] - values[:-2])
    change[0], change[-1] = values[1] - values[0], values[-1] - values[-2]
    return change


def _start_of_slide(time: FloatArray, lateral_speed: FloatArray, speed: FloatArray) -> int | None:
    """Return the last record in which the rear grips before its last slide; None without a slide.

    Args:
        time: simulated time, (n,) in s.
        lateral_speed: lateral speed of the rear axle, (n,) in m/s.
        speed: speed, (n,) in m/s.
    """
    slip = np.abs(np.arctan2(lateral_speed, np.maximum(speed, 1.0)))  # as if at 1 m/s when slower
    sliding = np.flatnonzero(slip > _SLIDING_SLIP)
    if not len(sliding):
        return None
    first = int(np.append(sliding[0], sliding[1:][np.diff(time[sliding]) > _SLIDE_GAP])[-1])
    return last_record(slip[:first] < _GRIPPING_SLIP)
