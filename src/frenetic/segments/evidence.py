"""Evidence of a cause: what the driver did first, with numbers, place and time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import itemgetter
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np

from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.road import Road
from frenetic.segments.bends import bend_of_place, bends_of, place_text
from frenetic.segments.causes import Cause, Kind, Mistake, hold_time, mistake_of
from frenetic.segments.commands import MOST_STEERING
from frenetic.segments.departure import Departure
from frenetic.segments.passing import PassingDrives, UsualRange
from frenetic.segments.segment import Segment, segment_of

_AFTERWARDS: Final = 0.6
"""Time after the beginning of a mistake in which its largest command is looked for, in s; our
choice."""
_MOST_SWINGS: Final = 4  # largest number of swings that a text tells (our choice)
_LEAST_SWING: Final = 0.1  # [m] from the lane's middle to the peak of a swing (our choice)
_DEGREES: Final = 180.0 / np.pi
_OF_SPEED: Final = frozenset({Kind.BRAKES_LATE, Kind.ACCELERATES, Kind.TOO_FAST})
_OF_STEERING: Final = frozenset(
    {Kind.WRONG_WAY, Kind.CUTS, Kind.TOO_LITTLE, Kind.HELD, Kind.SLOW_STEERING}
)
_OF_OFFSET: Final = frozenset({Kind.OSCILLATES, Kind.ASTRAY})
"""Kinds of mistake whose speed, steering or offset is compared with passing drives."""


@dataclass(frozen=True)
class Evidence:
    """The first mistake before a failure, as numbers and in words."""

    cause: Cause
    """Cause that the evidence is of."""
    text: str
    """What the driver did, where and when, such as "steers 9° to the right where the road needs 8°
    to the left, entering a left-hand bend of 18 m radius, 1.2 s before it leaves"."""
    time: float
    """Simulated time at which the mistake begins, in s."""
    place: float
    """Distance along the road at which it begins, in m."""
    before: float
    """Time from there to the failure, in s."""
    steering_input: float
    """Angle of the front wheels for which the driver asks, in rad, as in `text`."""
    needed_steering: float
    """Angle with which a car follows the road there, in rad, roughly."""
    speed: float
    """Speed there, in m/s."""
    lateral_acceleration: float
    """Acceleration that the road's curvature demands at this speed, in m/s²."""
    usual: UsualRange | None = None
    """What the driver does in its passing drives, which `text` says at its end; None if they are
    not known, or too few."""

    def as_json(self) -> dict[str, Any]:
        """Return text and numbers as a JSON object."""
        return {
            "text": self.text,
            "time": round(self.time, 3),
            "place": round(self.place, 2),
            "before_failure": round(self.before, 3),
            "steering_input": round(self.steering_input, 4),
            "needed_steering": round(self.needed_steering, 4),
            "speed": round(self.speed, 3),
            "lateral_acceleration": round(self.lateral_acceleration, 3),
            "passing_drives": None if self.usual is None else self.usual.as_json(),
        }


def evidence_of_drive(
    road: Road, drive: Drive, result: Result, passing: PassingDrives | None = None
) -> Evidence | None:
    """Return the evidence of a drive's failure; see `evidence_of_result` for when there is none."""
    if result.outcome is not Outcome.FAIL or not len(drive.trajectory):
        return None
    return evidence_of_result(segment_of(road, drive, result.finding), result, passing)


def evidence_of_result(
    segment: Segment | None, result: Result, passing: PassingDrives | None = None
) -> Evidence | None:
    """Return the evidence of a failure, see `frenetic.segments.causes.mistake_of`.

    There is none if the drive did not fail, if a fault of the driver ended it, if it exceeded
    another criterion than the lane's edge, or if it has no records (then `segment` is None).

    Args:
        segment: segment of the failure.
        result: result of the drive.
        passing: passing drives of the same driver, if they are known.
    """
    if segment is None or result.outcome is not Outcome.FAIL or result.fault is not None:
        return None
    cause, record = _mistake_of(segment, passing)
    if cause.kind is Kind.EXCEEDS:
        return None
    departure = Departure.of(segment, None if passing is None else passing.offset)
    record = min(record, len(departure.time) - 1)
    account = _ACCOUNTS[cause.kind](departure, record)
    place = float(segment.assessment.distance[record])
    text = account.text
    needed = float(departure.needed_steering[account.record])
    if account.asked is not None:
        is_same_side = account.asked * needed > 0.0
        text += f" where the road needs {_steering(needed, with_side=not is_same_side)}"
    text += f", {place_text(segment.road.curvatures, segment.road.step, place)}"
    before = departure.before_end(record)
    if segment.side is not None:
        text += f", {before:.1f} s before it leaves"
    usual = None if passing is None else _usual(cause.kind, passing, departure, account.record)
    if usual is not None:
        text += f" (in its passing drives it {usual.text})"
    speed = float(departure.speed[account.record])
    return Evidence(
        cause=cause,
        text=text,
        time=float(departure.time[record]),
        place=place,
        before=before,
        steering_input=float(departure.steering_input[account.record]),
        needed_steering=needed,
        speed=speed,
        lateral_acceleration=speed**2 * abs(float(departure.curvature[account.record])),
        usual=usual,
    )


def _mistake_of(segment: Segment, passing: PassingDrives | None) -> Mistake:
    """Return the first mistake, from the last moment at which the car drove as in passing drives.

    The cause is the one that was stored with the drive, when its driver's passing drives were not
    known. Should they speak for another cause, the moment is the one on which that cause rests.
    """
    mistake = mistake_of(segment)
    if passing is None:
        return mistake
    compared = mistake_of(segment, passing.offset)
    return compared if compared.cause == mistake.cause else mistake


def _usual(
    kind: Kind, passing: PassingDrives, departure: Departure, record: int
) -> UsualRange | None:
    """Return what a driver does in passing drives instead of a mistake of this kind.

    Args:
        kind: kind of the mistake.
        passing: passing drives.
        departure: the departure.
        record: record in which the mistake is largest.
    """
    if kind in _OF_SPEED:
        segment = departure.segment
        bends = bends_of(segment.road.curvatures, segment.road.step)
        bend = bend_of_place(bends, float(segment.assessment.distance[record]))
        return None if bend is None else passing.usual_demand(bend.sharpest)
    if kind in _OF_STEERING:
        return passing.usual_steering(float(departure.curvature[record]))
    return passing.usual_offset() if kind in _OF_OFFSET else None


@dataclass(frozen=True)
class _Account:
    """What a text tells first, and where its numbers are from."""

    text: str
    record: int
    """Record of the numbers."""
    asked: float | None = None
    """Steering with which the text compares what the road needs, in rad; None for none."""


_Tell: TypeAlias = Callable[[Departure, int], _Account]


def _largest(departure: Departure, record: int, values: Any) -> int:
    """Return the record of the largest value within `_AFTERWARDS` of a record."""
    last = int(np.searchsorted(departure.time, departure.time[record] + _AFTERWARDS))
    return record + int(np.argmax(values[record : max(last, record + 1)]))


def _steering(angle: float, *, with_side: bool = True) -> str:
    """Return an angle of the front wheels in words, such as ``9° to the left``."""
    degrees = round(abs(angle) * _DEGREES)
    if not degrees or not with_side:
        return f"{degrees}°"
    return f"{degrees}° to the {'left' if angle > 0.0 else 'right'}"


def _tell_steering(departure: Departure, record: int) -> _Account:
    """Tell the steering that differs most from what the road needs."""
    excess = np.abs(departure.steering_input - departure.needed_steering)
    most = _largest(departure, record, excess)
    asked = float(departure.steering_input[most])
    return _Account(f"steers {_steering(asked)}", most, asked)


def _tell_holding(departure: Departure, record: int) -> _Account:
    """Tell for how long the steering is at its largest."""
    columns = departure.steering[record:], departure.steering_input[record:]
    seconds, longest = max(
        ((hold_time(column, departure.time[record:]), column) for column in columns),
        key=itemgetter(0),
    )
    angle = float(longest[np.argmax(np.abs(longest))])
    text = f"holds its steering at {_steering(angle)} for {seconds:.1f} s"
    return _Account(text, _largest(departure, record, np.abs(departure.curvature)), angle)


def _tell_rate(departure: Departure, record: int) -> _Account:
    """Tell the fastest rate of the steering."""
    rate = departure.steering_rates(record).max() * _DEGREES
    asked = float(departure.steering_input[record])
    text = f"turns its steering by {rate:.0f}° a second at most, is at {_steering(asked)}"
    return _Account(text, record, asked)


def _tell_beyond(departure: Departure, record: int) -> _Account:
    """Tell the steering that is asked for, and what the front wheels reach."""
    most = _largest(departure, record, np.abs(departure.steering_input))
    asked = abs(float(departure.steering_input[most]))
    text = f"asks for {asked * _DEGREES:.0f}° of steering"
    if asked > MOST_STEERING:
        text += f" ({asked:.2g} rad: is it an angle in degrees?)"
    return _Account(text, most)


def _tell_pedals(departure: Departure, record: int) -> _Account:
    """Tell both pedals."""
    throttle, brake = departure.throttle[record], departure.brake[record]
    return _Account(f"presses throttle {throttle:.1f} and brake {brake:.1f} at once", record)


def _tell_swings(departure: Departure, record: int) -> _Account:
    """Tell the last swings about the lane's middle."""
    swings = swings_of(departure)[-_MOST_SWINGS:]
    texts = [f"{abs(swing):.1f} m {'left' if swing > 0.0 else 'right'}" for swing in swings]
    return _Account(f"swings {', then '.join(texts)} of the lane's middle", record)


def swings_of(departure: Departure) -> list[float]:
    """Return the farthest offset of each swing since the car was sound, in m; positive: left."""
    offset = departure.sign * departure.offset[departure.last_sound :]
    crossings = np.flatnonzero(np.diff(np.signbit(offset))) + 1
    peaks = [float(part[np.argmax(np.abs(part))]) for part in np.split(offset, crossings)]
    return [peak for peak in peaks if abs(peak) > _LEAST_SWING]


def _tell_braking(departure: Departure, record: int) -> _Account:
    """Tell the speed in a bend, and the brake before it."""
    speed = _tell_speed(departure, record)
    brake = departure.mean_before(record, departure.brake)
    return _Account(f"{speed.text}, with the brake at {brake:.1f}", speed.record)


def _tell_accelerating(departure: Departure, record: int) -> _Account:
    """Tell the speed in a bend, and the throttle before it."""
    speed = _tell_speed(departure, record)
    throttle = departure.mean_before(record, departure.throttle)
    return _Account(f"{speed.text}, with the throttle at {throttle:.1f}", speed.record)


def _tell_speed(departure: Departure, record: int) -> _Account:
    """Tell the speed at the largest demand of the bend."""
    demand = departure.speed**2 * np.abs(departure.curvature)
    most = _largest(departure, record, demand)
    speed = departure.speed[most] * 3.6
    return _Account(f"drives {speed:.0f} km/h, {demand[most]:.0f} m/s² across the road", most)


def _tell_standing(departure: Departure, record: int) -> _Account:
    """Tell when the car last moved."""
    return _Account(f"stands from {departure.time[record]:.0f} s after the start", record)


_ACCOUNTS: Final[Mapping[Kind, _Tell]] = MappingProxyType(
    {
        Kind.WRONG_WAY: _tell_steering,
        Kind.CUTS: _tell_steering,
        Kind.ASTRAY: _tell_steering,
        Kind.TOO_LITTLE: _tell_steering,
        Kind.HELD: _tell_holding,
        Kind.SLOW_STEERING: _tell_rate,
        Kind.BEYOND: _tell_beyond,
        Kind.BOTH_PEDALS: _tell_pedals,
        Kind.OSCILLATES: _tell_swings,
        Kind.BRAKES_LATE: _tell_braking,
        Kind.TOO_FAST: _tell_speed,
        Kind.ACCELERATES: _tell_accelerating,
        Kind.STANDS: _tell_standing,
        Kind.SLOW: _tell_speed,
    }
)
"""Kind of cause -> function that tells it."""
