"""Causes of failures: what the driver did wrong, from the records before the car left its lane.

A car that leaves its lane has gained lateral speed over it. In its last *excursion*, since it last
moved no faster than `SETTLED` towards the side where it left, that is the sum of what the road gave
by bending away and what the car gave by turning: integrals of v² times a curvature, in m/s. That of
the steering is the car's as long as the tyres grip. The first of these holds:

- The rear slides before the car leaves: it brakes too late, accelerates too hard or is too fast.
- The car steers out by itself: while the road bends to the other side (the wrong way), coming from
  the other side of the lane (it oscillates), or before or in a bend to this side (it cuts it).
- The road bends away, and the car turns less than it steers: it brakes too late or is too fast.
- The road bends away, and the steering is held at its largest, or is too little.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.analysis.segments import Segment, bend_of_place, bends_of, segment_of
from frenetic.criteria.criterion import DRIVER, EDGE_DISTANCE, LANE, quantity
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import TIMED_OUT, Side, judge
from frenetic.road import Road

SETTLED: Final = 0.1
"""Lateral speed towards the side where the car leaves at which its excursion begins, in m/s."""

_WHEELBASE: Final = 0.57  # of the car's length
_REAR: Final = 0.3  # of the car's length: from the centre of mass to the rear axle
_SLIDES: Final = np.radians(10.0)  # slip angle of the rear
_GRIPS: Final = np.radians(5.0)
_SLIDE: Final = 0.4  # [s] from the start of a slide to the departure that it explains
_BEFORE_SLIDE: Final = 0.6  # [s]
_BRAKES: Final = 0.1  # mean of the pedal
_ACCELERATES: Final = 0.5
_STEERS_OUT: Final = 2.5  # [m/s] that the steering gives from the middle of the lane on
_OVERSHOOTS: Final = 0.5  # [m/s] that it gives before, beyond what the road asks for
_BENDS: Final = 0.5  # [m/s] that the road gives
_OTHER_SIDE: Final = 0.4  # [m] from the middle of the lane
_FOLLOWS: Final = 0.75  # share of its steering by which a car turns whose tyres grip
_STEERS: Final = 4.0  # [m/s]
_HELD: Final = 0.3  # [s]
_STRAIGHT_AHEAD: Final = 1e-3  # steering [rad]
_AHEAD: Final = 15.0  # [m] of road that a car may cut
_FEWEST: Final = 5  # records


class Kind(StrEnum):
    """What a driver does wrong, in words; ``{}`` says in which bends."""

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
    """What a driver does wrong, and in bends to which side."""

    kind: Kind
    bends: Side | None = None
    criterion: str = ""
    """Quantity whose limit it exceeds, if that is all it does wrong."""


def in_words(kind: Kind, bends: Side | None = None, criterion: str = "") -> str:
    """A kind of cause in words, in bends to this side or to either."""
    if kind is Kind.EXCEEDS:
        text = kind.value.format(quantity(criterion).words)
        return text if bends is None else f"{text} in {bends}-hand bends"
    return kind.value.format("" if bends is None else f"{bends}-hand ")


def kind_number(road: Road, drive: Drive) -> float:
    """Number of the kind of cause of a drive's failure, from 1; 0 if it did not fail.

    `minimise` takes it as its objective, so that it knows whether a shorter road fails alike.
    """
    result = judge(road, drive)
    if result.outcome is not Outcome.FAIL or not len(drive.trajectory):
        return 0.0
    cause = cause_of(segment_of(road, drive, result.finding))
    limited = [one.quantity for one in drive.rules.criteria.criteria]
    which = limited.index(cause.criterion) if cause.criterion else 0
    return 1.0 + list(Kind).index(cause.kind) + which


def cause_of(segment: Segment) -> Cause:
    """The cause of a failure, from its segment; see this module's text."""
    seen, path = segment.assessment, segment.drive.trajectory
    if segment.criterion not in (None, LANE, DRIVER, EDGE_DISTANCE):
        road_bends = bends_of(segment.road.curvatures, segment.road.step)
        near = bend_of_place(road_bends, segment.place)
        is_reached = near is not None and near.start <= segment.place
        return Cause(
            Kind.EXCEEDS, near.side if near is not None and is_reached else None, segment.criterion
        )
    if segment.side is None:
        return Cause(Kind.SLOW if seen.end == TIMED_OUT else Kind.STANDS)
    n = len(seen.distance)
    if n < _FEWEST:
        return Cause(Kind.ASTRAY)
    sign, length = 1.0 if segment.side == "left" else -1.0, segment.drive.car.length
    # Only places and times are known to be finite, and no two times to differ.
    speed, lateral_speed, yaw_rate, steering, asked, throttle, brake = (
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
    time, offset = path.time[:n], sign * seen.lateral_offset
    step = np.maximum(np.gradient(time), 1e-6)
    # Lateral speed that each gives to the side where the car leaves, record by record.
    road = -sign * step * speed**2 * segment.road.curvature_at(seen.distance)
    steered = sign * step * speed**2 * np.tan(steering) / (_WHEELBASE * length)
    turned = sign * step * speed * yaw_rate
    began = _last((np.gradient(offset) / step)[:-1] <= SETTLED)

    slide = _slide(lateral_speed - _REAR * length * yaw_rate, speed)
    slides = slide is not None and time[-1] - time[slide] >= _SLIDE
    end = max(slide, began) if slide is not None and slides else n
    middle = began + int(np.argmax(offset[began:] >= 0.0))
    returning, leaving = slice(began, min(middle, end)), slice(min(middle, end), end)
    own = steered[returning].sum() + min(road[returning].sum(), 0.0)
    out, away = steered[leaving].sum(), road[leaving].sum()
    if out > max(_STEERS_OUT, own) and away > -0.5 * out:
        if max(away, road[began:end].sum()) > _BENDS:
            return Cause(Kind.WRONG_WAY, _bend(-sign))
        return Cause(Kind.CUTS, _bend(sign)) if _is_ahead(segment, sign) else Cause(Kind.ASTRAY)
    if offset[began] < -_OTHER_SIDE and own > _OVERSHOOTS:
        return Cause(Kind.OSCILLATES)
    if slides:
        assert slide is not None
        before = slice(_last(time <= time[slide] - _BEFORE_SLIDE), slide + 1)
        bend = _bend(-sign * road[before].sum())
        if brake[before].mean() > _BRAKES:
            return Cause(Kind.BRAKES_LATE, bend)
        if throttle[before].mean() > _ACCELERATES:
            return Cause(Kind.ACCELERATES, bend)
        return Cause(Kind.TOO_FAST, bend)
    if away < 0.0:
        is_cut = out > -away or _is_ahead(segment, sign)
        return Cause(Kind.CUTS, _bend(sign)) if is_cut else Cause(Kind.ASTRAY)
    bend = _bend(-sign)
    if steered[began:].sum() < min(-_STEERS, turned[began:].sum() / _FOLLOWS):
        brakes = brake[began:].mean() > _BRAKES
        return Cause(Kind.BRAKES_LATE if brakes else Kind.TOO_FAST, bend)
    is_held = any(_is_held(column[began:], time[began:]) for column in (steering, asked))
    return Cause(Kind.HELD if is_held else Kind.TOO_LITTLE, bend)


def _slide(lateral_speed: FloatArray, speed: FloatArray) -> int | None:
    """The record from which on the rear slides; None if it does not."""
    slip = np.abs(np.arctan2(lateral_speed, np.maximum(speed, 1.0)))
    sliding = np.flatnonzero(slip > _SLIDES)
    return _last(slip[: sliding[0]] < _GRIPS) if len(sliding) else None


def _last(condition: npt.NDArray[np.bool_]) -> int:
    """The last place where a condition holds; 0 without any."""
    places = np.flatnonzero(condition)
    return int(places[-1]) if len(places) else 0


def _bend(curvature: float) -> Side:
    return "left" if curvature > 0.0 else "right"


def _is_ahead(segment: Segment, sign: float) -> bool:
    """Whether the road ahead bends to the side where the car left."""
    turn = sign * segment.road.curvature_at(segment.place + np.arange(0.0, _AHEAD, 1.0)).mean()
    return bool(turn > 0.01)


def _is_held(steering: FloatArray, time: FloatArray) -> bool:
    """Whether a column of the steering stands at its largest for a while, and not straight."""
    if np.abs(steering).max() < _STRAIGHT_AHEAD:
        return False
    largest = np.flatnonzero(np.abs(steering) >= np.abs(steering).max() - 1e-9)
    return bool(time[largest[-1]] - time[largest[0]] >= _HELD)
