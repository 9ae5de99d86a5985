"""Causes of failures: what the driver did wrong, from the records before the car left its lane.

A car that leaves its lane has gained lateral speed over it. Its last *excursion* begins where it
last moved no faster than `SETTLED` towards the side where it left. The lateral speed gained since
then is the sum of two integrals of v² times a curvature, in m/s: the road's, which bends away, and
the car's, which turns. As long as the tyres grip, the car turns as it steers. The first cause that
holds is the failure's:

- The rear slides before the car leaves: it brakes too late, accelerates too hard or is too fast.
- The car steers out by itself: while the road bends to the other side (the wrong way), coming from
  the other side of the lane (it oscillates), or before or in a bend to this side (it cuts it).
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
from frenetic.analysis.segments import Segment, bend_of_place, bends_of, segment_of
from frenetic.criteria.criterion import DRIVER, EDGE_DISTANCE, LANE, signal_named
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import TIMED_OUT, Side, judge
from frenetic.road import Road

SETTLED: Final = 0.1
"""Lateral speed towards the side where the car leaves at which its excursion begins, in m/s."""

# The following values are ours.
_WHEELBASE: Final = 0.57  # share of the car's length
_REAR: Final = 0.3  # share of the car's length from the centre of mass to the rear axle
_SLIDES: Final = np.radians(10.0)  # [rad] least slip angle of a rear that slides
_GRIPS: Final = np.radians(5.0)  # [rad] largest slip angle of a rear that grips
_SLIDE: Final = 0.4  # [s] least time from the start of a slide to a departure by it
_BEFORE_SLIDE: Final = 0.6  # [s] before a slide in which the pedals count
_BRAKES: Final = 0.1  # mean of the brake pedal above which a car brakes
_ACCELERATES: Final = 0.5  # mean of the throttle pedal above which a car accelerates
_STEERS_OUT: Final = 2.5  # [m/s] least gain by steering beyond the lane's middle
_OVERSHOOTS: Final = 0.5  # [m/s] least gain by steering before the middle, beyond the road's need
_BENDS: Final = 0.5  # [m/s] least gain by a road that bends
_OTHER_SIDE: Final = 0.4  # [m] from the lane's middle to the start of an oscillation
_FOLLOWS: Final = 0.75  # least turn of a car whose tyres grip, as a share of its steering
_STEERS: Final = 4.0  # [m/s] least gain of a car that steers into a bend
_HELD: Final = 0.3  # [s] least time at the largest steering
_STRAIGHT_AHEAD: Final = 1e-3  # [rad] largest steering of a car that drives straight ahead
_AHEAD: Final = 15.0  # [m] length of road that a car may cut
_FEWEST_RECORDS: Final = 5


class Kind(StrEnum):
    """Kind of mistake of a driver, in words; ``{}`` stands for the bends' side."""

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


class Cause(NamedTuple):
    """Mistake of a driver, and the side of the bends in which it happens."""

    kind: Kind
    bends: Side | None = None
    """Side to which the bends turn; None outside bends."""
    criterion: str = ""
    """Name of the signal whose limit the drive exceeds, for `Kind.EXCEEDS`; else empty."""


def as_text(kind: Kind, bends: Side | None = None, criterion: str = "") -> str:
    """Return a kind of cause in words, in bends to one side, or to either side for None."""
    if kind is Kind.EXCEEDS:
        text = kind.value.format(signal_named(criterion).words)
        return text if bends is None else f"{text} in {bends}-hand bends"
    return kind.value.format("" if bends is None else f"{bends}-hand ")


def kind_number(road: Road, drive: Drive) -> float:
    """Return the number of the kind of cause of a drive's failure, from 1; 0 without a failure.

    It is the objective of minimising, which so knows whether a shorter road fails alike.
    """
    result = judge(road, drive)
    if result.outcome is not Outcome.FAIL or not len(drive.trajectory):
        return 0.0
    cause = cause_of(segment_of(road, drive, result.finding))
    limited = [criterion.signal for criterion in drive.rules.criteria.criteria]
    number = limited.index(cause.criterion) if cause.criterion else 0
    return 1.0 + list(Kind).index(cause.kind) + number


def cause_of(segment: Segment) -> Cause:
    """Return the cause of a failure; see this module's text."""
    if segment.criterion not in (None, LANE, DRIVER, EDGE_DISTANCE):
        return Cause(Kind.EXCEEDS, _side_of_bend(segment), segment.criterion)
    if segment.side is None:
        is_slow = segment.assessment.end == TIMED_OUT
        return Cause(Kind.SLOW if is_slow else Kind.STANDS)
    if len(segment.assessment.distance) < _FEWEST_RECORDS:
        return Cause(Kind.ASTRAY)
    return _cause_of_departure(segment, _gains_of(segment))


def _side_of_bend(segment: Segment) -> Side | None:
    """Return the side of the bend at a segment's place; None on straights and before a bend."""
    bends = bends_of(segment.road.curvatures, segment.road.step)
    bend = bend_of_place(bends, segment.place)
    return None if bend is None or bend.start > segment.place else bend.side


@dataclass(frozen=True, eq=False)
class _Gains:
    """Drive up to a departure, record by record: (n,) each.

    The gains are lateral speeds towards the side where the car leaves, in m/s.
    """

    time: FloatArray
    """Simulated time, in s."""
    offset: FloatArray
    """Offset from the lane's middle towards the side where the car leaves, in m."""
    lateral_speed: FloatArray
    """Lateral speed towards this side, in m/s."""
    road: FloatArray
    """Gain by the road, which bends away."""
    steered: FloatArray
    """Gain by the car if its tyres grip."""
    turned: FloatArray
    """Gain by the car."""
    steering: FloatArray
    """Angle of the front wheels, in rad."""
    steering_input: FloatArray
    """Steering that the driver asks for."""
    throttle: FloatArray
    """Throttle pedal, 0..1."""
    brake: FloatArray
    """Brake pedal, 0..1."""
    slide: int | None
    """First record of the slide by which the car leaves; None without a slide."""


def _gains_of(segment: Segment) -> _Gains:
    assessment, path = segment.assessment, segment.drive.trajectory
    n = len(assessment.distance)
    sign, length = 1.0 if segment.side == "left" else -1.0, segment.drive.car.length
    # Only places and times are known to be finite, and no two times to differ.
    speed, lateral_speed, yaw_rate, steering, steering_input, throttle, brake = (
        np.nan_to_num(column[:n], posinf=0.0, neginf=0.0)
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
    step = np.maximum(np.gradient(time), 1e-6)
    slide = _slide(lateral_speed - _REAR * length * yaw_rate, speed)
    slides = slide is not None and time[-1] - time[slide] >= _SLIDE
    return _Gains(
        time=time,
        offset=offset,
        lateral_speed=np.gradient(offset) / step,
        road=-sign * step * speed**2 * segment.road.curvature_at(assessment.distance),
        steered=sign * step * speed**2 * np.tan(steering) / (_WHEELBASE * length),
        turned=sign * step * speed * yaw_rate,
        steering=steering,
        steering_input=steering_input,
        throttle=throttle,
        brake=brake,
        slide=slide if slides else None,
    )


def _cause_of_departure(segment: Segment, gains: _Gains) -> Cause:
    """Return the cause of a failure in which the car left its lane."""
    sign = 1.0 if segment.side == "left" else -1.0
    road, steered = gains.road, gains.steered
    begin = _last(gains.lateral_speed[:-1] <= SETTLED)  # of the excursion
    end = len(road) if gains.slide is None else max(gains.slide, begin)
    middle = begin + int(np.argmax(gains.offset[begin:] >= 0.0))
    returning, leaving = slice(begin, min(middle, end)), slice(min(middle, end), end)
    overshoot = steered[returning].sum() + min(road[returning].sum(), 0.0)
    out, away = steered[leaving].sum(), road[leaving].sum()
    if out > max(_STEERS_OUT, overshoot) and away > -0.5 * out:
        if max(away, road[begin:end].sum()) > _BENDS:
            return Cause(Kind.WRONG_WAY, _bend(-sign))
        return Cause(Kind.CUTS, _bend(sign)) if _is_ahead(segment, sign) else Cause(Kind.ASTRAY)
    if gains.offset[begin] < -_OTHER_SIDE and overshoot > _OVERSHOOTS:
        return Cause(Kind.OSCILLATES)
    if gains.slide is not None:
        return _cause_of_slide(gains, gains.slide, sign)
    if away < 0.0:
        is_cut = out > -away or _is_ahead(segment, sign)
        return Cause(Kind.CUTS, _bend(sign)) if is_cut else Cause(Kind.ASTRAY)
    bend = _bend(-sign)
    if steered[begin:].sum() < min(-_STEERS, gains.turned[begin:].sum() / _FOLLOWS):
        brakes = gains.brake[begin:].mean() > _BRAKES
        return Cause(Kind.BRAKES_LATE if brakes else Kind.TOO_FAST, bend)
    columns = (gains.steering, gains.steering_input)
    is_held = any(_is_held(column[begin:], gains.time[begin:]) for column in columns)
    return Cause(Kind.HELD if is_held else Kind.TOO_LITTLE, bend)


def _cause_of_slide(gains: _Gains, slide: int, sign: float) -> Cause:
    """Return the cause of a departure by a slide from a record on, from the time before it."""
    before = slice(_last(gains.time <= gains.time[slide] - _BEFORE_SLIDE), slide + 1)
    bend = _bend(-sign * gains.road[before].sum())
    if gains.brake[before].mean() > _BRAKES:
        return Cause(Kind.BRAKES_LATE, bend)
    if gains.throttle[before].mean() > _ACCELERATES:
        return Cause(Kind.ACCELERATES, bend)
    return Cause(Kind.TOO_FAST, bend)


def _slide(lateral_speed: FloatArray, speed: FloatArray) -> int | None:
    """Return the record from which on the rear slides; None if it does not slide."""
    slip = np.abs(np.arctan2(lateral_speed, np.maximum(speed, 1.0)))
    sliding = np.flatnonzero(slip > _SLIDES)
    return _last(slip[: sliding[0]] < _GRIPS) if len(sliding) else None


def _last(condition: npt.NDArray[np.bool_]) -> int:
    """Return the last record in which a condition holds; 0 if it never holds."""
    records = np.flatnonzero(condition)
    return int(records[-1]) if len(records) else 0


def _bend(curvature: float) -> Side:
    return "left" if curvature > 0.0 else "right"


def _is_ahead(segment: Segment, sign: float) -> bool:
    """Return whether the road ahead bends to the side where the car left."""
    turn = sign * segment.road.curvature_at(segment.place + np.arange(0.0, _AHEAD, 1.0)).mean()
    return bool(turn > 0.01)


def _is_held(steering: FloatArray, time: FloatArray) -> bool:
    """Return whether a steering is held at its largest angle, other than straight ahead."""
    if np.abs(steering).max() < _STRAIGHT_AHEAD:
        return False
    largest = np.flatnonzero(np.abs(steering) >= np.abs(steering).max() - 1e-9)
    return bool(time[largest[-1]] - time[largest[0]] >= _HELD)
