"""Causes of failures: what the driver did wrong, from the records before the car left its lane.

The *excursion* of a car that leaves its lane begins in the last record in which the car moved no
faster than `SETTLED_SPEED` towards the side where it left. The lateral speed gained since then is
the sum of two *gains*, in m/s, each the integral of v² times a curvature over time. The road's gain
is positive where the road bends away from that side. The car's gain is positive where the car turns
towards that side; as long as the tyres grip, the car turns as it steers. The first of these causes
that holds is the failure's:

- The car steers out by itself, before a slide if there is one: while the road bends to the other
  side (the wrong way), or before or in a bend to this side (it cuts the bend), or on a straight.
- The car steers too far coming from the other side of the lane: it oscillates.
- The rear slides before the car leaves: it brakes too late, accelerates too hard or is too fast.
- The road bends to this side, or the car is about to cut a bend.
- The road bends away, and the car turns less than it steers: it brakes too late or is too fast.
- The road bends away, and the steering is held at its largest, or is too little.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.criteria.criterion import DRIVER, EDGE_DISTANCE, LANE, signal_named
from frenetic.oracle.assessment import STUCK, TIMED_OUT
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Side, judge
from frenetic.road import Road
from frenetic.segments.bends import bend_of_place, bends_of
from frenetic.segments.segment import Segment, segment_of

# The values are our choice.
SETTLED_SPEED: Final = 0.1
"""Lateral speed towards the side where the car leaves at which its excursion begins, in m/s."""
_WHEELBASE_SHARE: Final = 0.57  # wheelbase as a share of the car's length
_REAR_AXLE_SHARE: Final = 0.3  # from centre of mass to rear axle, as a share of the car's length
_SLIDING_SLIP: Final = np.radians(10.0)  # [rad] least slip angle of a rear that slides
_GRIPPING_SLIP: Final = np.radians(5.0)  # [rad] largest slip angle of a rear that grips
_MIN_SLIDE_TIME: Final = 0.4  # [s] least time from the start of a slide to a departure by it
_PEDAL_TIME: Final = 0.6  # [s] before a slide, over which the pedals are averaged
_BRAKING: Final = 0.1  # mean of the brake pedal above which a car brakes
_ACCELERATING: Final = 0.5  # mean of the throttle pedal above which a car accelerates
_MIN_STEERING_OUT: Final = 2.5  # [m/s] least gain by steering out beyond the lane's middle
_MIN_OVERSHOOT: Final = 0.5  # [m/s] least gain by steering before the middle, beyond the road's
_MIN_BEND_GAIN: Final = 0.5  # [m/s] least gain by a road that bends away
_MIN_OSCILLATION: Final = 0.4  # [m] from the lane's middle to where an oscillation begins
_MIN_TURN_SHARE: Final = 0.75  # least turn of a car whose tyres grip, as a share of its steering
_MIN_STEERING_IN: Final = 4.0  # [m/s] least gain of a car that steers into a bend
_MIN_HOLD_TIME: Final = 0.3  # [s] least time at the largest steering
_MAX_STRAIGHT_STEERING: Final = 1e-3  # [rad] largest steering of a car that drives straight ahead
_LENGTH_AHEAD: Final = 15.0  # [m] length of road ahead in which a car may cut a bend
_MIN_CURVATURE_AHEAD: Final = 0.01  # [1/m] least mean curvature of a road that bends ahead
_MIN_RECORDS: Final = 5  # least number of records from which a cause is derived


class Kind(StrEnum):
    """Kind of mistake of a driver, in words.

    ``{}`` stands for the side of the bends, such as ``left-hand``; in `EXCEEDS` for the criterion.
    """

    STANDS = "stands still"
    SLOW = "is too slow"
    BRAKES_LATE = "brakes too late into {}bends"
    ACCELERATES = "accelerates too hard in {}bends"
    TOO_FAST = "takes {}bends too fast"
    WRONG_WAY = "steers the wrong way in {}bends"
    OSCILLATES = "oscillates from side to side"
    CUTS = "cuts the inside of {}bends"
    ASTRAY = "steers out of its lane on straights"
    HELD = "holds its steering at a limit, too little for {}bends"
    TOO_LITTLE = "steers too little in {}bends"
    EXCEEDS = "exceeds the limit of {}"


_KINDS_OF_ENDS: Final = {STUCK: Kind.STANDS, TIMED_OUT: Kind.SLOW}
"""How a drive ended whose car stayed in its lane -> kind of the failure's cause."""


class Cause(NamedTuple):
    """Mistake of a driver, and the side of the bends in which it happens."""

    kind: Kind
    bend_side: Side | None = None
    """Side to which the bends turn; None outside bends."""
    criterion: str = ""
    """Name of the signal whose limit the drive exceeds, for `Kind.EXCEEDS`; else empty."""


def as_text(kind: Kind, bend_side: Side | None = None, criterion: str = "") -> str:
    """Return a kind of cause in words, in bends to one side, or to either side for None."""
    if kind is Kind.EXCEEDS:
        text = kind.value.format(signal_named(criterion).words)
        return text if bend_side is None else f"{text} in {bend_side}-hand bends"
    return kind.value.format("" if bend_side is None else f"{bend_side}-hand ")


def kind_number(road: Road, drive: Drive) -> float:
    """Return the number of the kind of cause of a drive's failure, from 1; 0 without a failure.

    Each criterion that a drive can exceed has a number of its own, from the number of
    `Kind.EXCEEDS` on. Minimising takes this number as its objective, to know whether a shorter road
    fails alike.
    """
    result = judge(road, drive)
    if result.outcome is not Outcome.FAIL or not len(drive.trajectory):
        return 0.0
    cause = cause_of(segment_of(road, drive, result.finding))
    signals = [criterion.signal for criterion in drive.rules.criteria.criteria]
    # EXCEEDS is the last kind, so the numbers of the criteria follow it.
    number = signals.index(cause.criterion) if cause.criterion else 0
    return 1.0 + list(Kind).index(cause.kind) + number


def cause_of(segment: Segment) -> Cause:
    """Return the cause of a failure, by the rules in this module's docstring.

    Criteria other than leaving the lane have the cause `Kind.EXCEEDS`. A car that stayed in its
    lane stood still or was too slow.
    """
    if segment.criterion not in (None, LANE, DRIVER, EDGE_DISTANCE):
        return Cause(Kind.EXCEEDS, _side_of_bend(segment), segment.criterion)
    if segment.side is None:
        # A client of `frenetic ask-tell` may call any drive a failure.
        return Cause(_KINDS_OF_ENDS.get(segment.assessment.end, Kind.STANDS))
    if len(segment.assessment.distance) < _MIN_RECORDS:
        return Cause(Kind.ASTRAY)
    return _cause_of_departure(segment, _gains_of(segment))


def _side_of_bend(segment: Segment) -> Side | None:
    """Return the side of the bend at a segment's place; None on straights and before a bend."""
    bends = bends_of(segment.road.curvatures, segment.road.step)
    bend = bend_of_place(bends, segment.place)
    return None if bend is None or bend.start > segment.place else bend.side


@dataclass(frozen=True, eq=False)
class _Gains:
    """Records of a drive up to a departure, and the lateral speed gained in each: (n,) arrays.

    Gains are towards the side where the car leaves, in m/s.
    """

    time: FloatArray
    """Simulated time, in s."""
    offset: FloatArray
    """Offset from the lane's middle towards the side where the car leaves, in m."""
    lateral_speed: FloatArray
    """Lateral speed towards this side, in m/s."""
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
    slide: int | None
    """First record of the slide by which the car leaves; None without a slide."""


def _gains_of(segment: Segment) -> _Gains:
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
    slide = _start_of_slide(lateral_speed - _REAR_AXLE_SHARE * length * yaw_rate, speed)
    leaves_by_slide = slide is not None and time[-1] - time[slide] >= _MIN_SLIDE_TIME
    return _Gains(
        time=time,
        offset=offset,
        lateral_speed=_change(offset) / step,
        road=-sign * step * speed**2 * segment.road.curvature_at(assessment.distance),
        steered=sign * step * speed**2 * np.tan(steering) / (_WHEELBASE_SHARE * length),
        turned=sign * step * speed * yaw_rate,
        steering=steering,
        steering_input=steering_input,
        throttle=throttle,
        brake=brake,
        slide=slide if leaves_by_slide else None,
    )


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


def _cause_of_departure(segment: Segment, gains: _Gains) -> Cause:
    """Return the cause of a failure in which the car left its lane."""
    sign = 1.0 if segment.side == "left" else -1.0
    road, steered = gains.road, gains.steered
    # The excursion: the car returns to the lane's middle, then leaves, until a slide begins.
    begin = _last(gains.lateral_speed[:-1] <= SETTLED_SPEED)
    end = len(road) if gains.slide is None else max(gains.slide, begin)
    middle = min(begin + int(np.argmax(gains.offset[begin:] >= 0.0)), end)
    returning, leaving = slice(begin, middle), slice(middle, end)
    # What the steering gains on the way to the middle beyond what the road's bend needs.
    overshoot = steered[returning].sum() + min(road[returning].sum(), 0.0)
    steered_out, bent_away = steered[leaving].sum(), road[leaving].sum()
    steers_out = steered_out > max(_MIN_STEERING_OUT, overshoot)
    if steers_out and bent_away > -0.5 * steered_out:
        if max(bent_away, road[begin:end].sum()) > _MIN_BEND_GAIN:
            return Cause(Kind.WRONG_WAY, _side(-sign))
        is_cut = _bends_ahead(segment, sign)
        return Cause(Kind.CUTS, _side(sign)) if is_cut else Cause(Kind.ASTRAY)
    if gains.offset[begin] < -_MIN_OSCILLATION and overshoot > _MIN_OVERSHOOT:
        return Cause(Kind.OSCILLATES)
    if gains.slide is not None:
        return _cause_of_slide(gains, gains.slide, sign)
    if bent_away < 0.0:
        is_cut = steered_out > -bent_away or _bends_ahead(segment, sign)
        return Cause(Kind.CUTS, _side(sign)) if is_cut else Cause(Kind.ASTRAY)
    # The road bends away. Steering into its bend is a negative gain.
    bend_side = _side(-sign)
    if steered[begin:].sum() < min(-_MIN_STEERING_IN, gains.turned[begin:].sum() / _MIN_TURN_SHARE):
        brakes = gains.brake[begin:].mean() > _BRAKING
        return Cause(Kind.BRAKES_LATE if brakes else Kind.TOO_FAST, bend_side)
    columns = (gains.steering, gains.steering_input)
    is_held = any(_is_held(column[begin:], gains.time[begin:]) for column in columns)
    return Cause(Kind.HELD if is_held else Kind.TOO_LITTLE, bend_side)


def _cause_of_slide(gains: _Gains, slide: int, sign: float) -> Cause:
    """Return the cause of a departure by a slide: the pedals just before the slide tell.

    Args:
        gains: drive up to the departure.
        slide: first record of the slide.
        sign: 1 if the car left to the left, -1 if it left to the right.
    """
    before = slice(_last(gains.time <= gains.time[slide] - _PEDAL_TIME), slide + 1)
    bend_side = _side(-sign * gains.road[before].sum())
    if gains.brake[before].mean() > _BRAKING:
        return Cause(Kind.BRAKES_LATE, bend_side)
    if gains.throttle[before].mean() > _ACCELERATING:
        return Cause(Kind.ACCELERATES, bend_side)
    return Cause(Kind.TOO_FAST, bend_side)


def _start_of_slide(lateral_speed: FloatArray, speed: FloatArray) -> int | None:
    """Return the last record in which the rear grips before it slides; None without a slide.

    Args:
        lateral_speed: lateral speed of the rear axle, (n,) in m/s.
        speed: speed, (n,) in m/s.
    """
    slip = np.abs(np.arctan2(lateral_speed, np.maximum(speed, 1.0)))  # as if at 1 m/s when slower
    sliding = np.flatnonzero(slip > _SLIDING_SLIP)
    return _last(slip[: sliding[0]] < _GRIPPING_SLIP) if len(sliding) else None


def _last(condition: npt.NDArray[np.bool_]) -> int:
    """Return the last record in which a condition holds; 0 if it never holds."""
    records = np.flatnonzero(condition)
    return int(records[-1]) if len(records) else 0


def _side(curvature: float) -> Side:
    """Return the side to which a bend of this curvature turns."""
    return "left" if curvature > 0.0 else "right"


def _bends_ahead(segment: Segment, sign: float) -> bool:
    """Return whether the road ahead bends to the side where the car left."""
    ahead = segment.place + np.arange(0.0, _LENGTH_AHEAD, 1.0)
    return bool(sign * segment.road.curvature_at(ahead).mean() > _MIN_CURVATURE_AHEAD)


def _is_held(steering: FloatArray, time: FloatArray) -> bool:
    """Return whether a steering is held at its largest angle, other than straight ahead."""
    if np.abs(steering).max() < _MAX_STRAIGHT_STEERING:
        return False
    largest = np.flatnonzero(np.abs(steering) >= np.abs(steering).max() - 1e-9)
    return bool(time[largest[-1]] - time[largest[0]] >= _MIN_HOLD_TIME)
