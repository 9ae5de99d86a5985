"""Causes of failures: what the driver did wrong first, from the records before the failure.

`frenetic.segments.departure` says what an *excursion* is, and its *gains*. The first of these
causes that holds is the failure's:

- While the car is sound, the driver asks for what a car cannot do, or steers against a bend.
- The steering turns at the fastest rate that the driver has, too slowly for the road.
- The car steers out by itself, before a slide if there is one: while the road bends to the other
  side (the wrong way), or before or in a bend to this side (it cuts the bend), or on a straight.
- The car steers too far coming from the other side of the lane: it cuts the bend if it was inside
  the bend before, too, and oscillates otherwise.
- The rear slides before the car leaves: it brakes too late, accelerates too hard or is too fast.
- The road bends to this side, or the car is about to cut a bend.
- The road bends away, and the car turns less than it steers: it brakes too late or is too fast.
- The road bends away, and the steering is held at its largest, or is too little.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.criteria.criterion import DRIVER, EDGE_DISTANCE, LANE, signal_named
from frenetic.oracle.assessment import STUCK, TIMED_OUT
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Side, judge
from frenetic.road import Road
from frenetic.segments.bends import bend_of_place, bends_of
from frenetic.segments.commands import (
    against_the_bend,
    at_a_rate_limit,
    beyond_the_car,
    both_pedals,
)
from frenetic.segments.departure import Departure
from frenetic.segments.segment import Segment, segment_of

# The values are our choice.
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
_STANDING_SPEED: Final = 0.2  # [m/s] up to which a car stands
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
    SLOW_STEERING = "turns its steering too slowly for {}bends"
    BEYOND = "asks for steering that a car cannot have"
    BOTH_PEDALS = "presses both pedals at once"
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


class Mistake(NamedTuple):
    """The first thing that a driver did wrong before a failure."""

    cause: Cause
    """The cause of the failure."""
    record: int
    """Record of the drive in which the mistake begins."""


def cause_of(segment: Segment) -> Cause:
    """Return the cause of a failure, see `mistake_of`."""
    return mistake_of(segment).cause


def mistake_of(segment: Segment, usual_offset: float | None = None) -> Mistake:
    """Return the first mistake before a failure, by the rules in this module's docstring.

    Criteria other than leaving the lane have the cause `Kind.EXCEEDS`. A car that stayed in its
    lane stood still or was too slow.

    Args:
        segment: segment of the failure.
        usual_offset: see `Departure.usual_offset`.
    """
    place = int(np.argmin(np.abs(segment.assessment.distance - segment.place)))
    if segment.criterion not in (None, LANE, DRIVER, EDGE_DISTANCE):
        side = _side_of_bend(segment)
        return Mistake(Cause(Kind.EXCEEDS, side, segment.criterion), place)
    if segment.side is None:
        return _mistake_of_standing(segment)
    if len(segment.assessment.distance) < _MIN_RECORDS:
        return Mistake(Cause(Kind.ASTRAY), place)
    departure = Departure.of(segment, usual_offset)
    return _wrong_command(departure) or _mistake_of_departure(departure)


def _mistake_of_standing(segment: Segment) -> Mistake:
    """Return the mistake of a driver that stayed in its lane and did not arrive."""
    path = segment.drive.trajectory
    pressed = both_pedals(path.time, path.throttle, path.brake)
    if pressed is not None:
        return Mistake(Cause(Kind.BOTH_PEDALS), pressed)
    # A client of `frenetic ask-tell` may call any drive a failure.
    kind = _KINDS_OF_ENDS.get(segment.assessment.end, Kind.STANDS)
    moving = np.flatnonzero(path.speed > _STANDING_SPEED)
    return Mistake(Cause(kind), int(moving[-1]) if len(moving) else 0)


def _side_of_bend(segment: Segment) -> Side | None:
    """Return the side of the bend at a segment's place; None on straights and before a bend."""
    bends = bends_of(segment.road.curvatures, segment.road.step)
    bend = bend_of_place(bends, segment.place)
    return None if bend is None or bend.start > segment.place else bend.side


def _wrong_command(departure: Departure) -> Mistake | None:
    """Return a mistake that a command is by itself; None if there is none."""
    beyond = beyond_the_car(departure)
    if beyond is not None:
        return Mistake(Cause(Kind.BEYOND), beyond)
    against = against_the_bend(departure)
    if against is not None:
        return Mistake(Cause(Kind.WRONG_WAY, _side(departure.curvature[against])), against)
    limited = at_a_rate_limit(departure)
    if limited is not None:
        bend = _side(-departure.sign * departure.road[departure.last_sound : departure.end].sum())
        return Mistake(Cause(Kind.SLOW_STEERING, bend), limited)
    return None


def _mistake_of_departure(departure: Departure) -> Mistake:
    """Return the mistake of a driver that left its lane by commands that are not wrong alone."""
    sign, begin, end = departure.sign, departure.begin, departure.end
    road, steered, segment = departure.road, departure.steered, departure.segment
    # The excursion: the car returns to the lane's middle, then leaves, until a slide begins.
    middle = min(begin + int(np.argmax(departure.offset[begin:] >= 0.0)), end)
    returning, leaving = slice(begin, middle), slice(middle, end)
    # What the steering gains on the way to the middle beyond what the road's bend needs.
    overshoot = steered[returning].sum() + min(road[returning].sum(), 0.0)
    steered_out, bent_away = steered[leaving].sum(), road[leaving].sum()
    is_cut = _bends_ahead(segment, sign)
    out = Mistake(Cause(Kind.CUTS, _side(sign)) if is_cut else Cause(Kind.ASTRAY), begin)
    steers_out = steered_out > max(_MIN_STEERING_OUT, overshoot)
    if steers_out and bent_away > -0.5 * steered_out:
        if max(bent_away, road[begin:end].sum()) > _MIN_BEND_GAIN:
            return Mistake(Cause(Kind.WRONG_WAY, _side(-sign)), begin)
        return out
    if departure.offset[begin] < -_MIN_OSCILLATION and overshoot > _MIN_OVERSHOOT:
        # The car was inside the bend before, and is inside the next one.
        if is_cut and -sign * departure.curvature[begin] > _MIN_CURVATURE_AHEAD:
            return out
        return Mistake(Cause(Kind.OSCILLATES), departure.last_sound)
    if departure.slide is not None:
        return Mistake(_cause_of_slide(departure, departure.slide), departure.slide)
    if bent_away < 0.0:
        if steered_out > -bent_away:
            return Mistake(Cause(Kind.CUTS, _side(sign)), begin)
        return out
    # The road bends away. Steering into its bend is a negative gain.
    bend_side = _side(-sign)
    turned = departure.turned[begin:].sum()
    if steered[begin:].sum() < min(-_MIN_STEERING_IN, turned / _MIN_TURN_SHARE):
        brakes = departure.brake[begin:].mean() > _BRAKING
        kind = Kind.BRAKES_LATE if brakes else Kind.TOO_FAST
        return Mistake(Cause(kind, bend_side), begin)
    columns = (departure.steering, departure.steering_input)
    is_held = any(
        np.abs(column[begin:]).max() >= _MAX_STRAIGHT_STEERING
        and hold_time(column[begin:], departure.time[begin:]) >= _MIN_HOLD_TIME
        for column in columns
    )
    return Mistake(Cause(Kind.HELD if is_held else Kind.TOO_LITTLE, bend_side), begin)


def _cause_of_slide(departure: Departure, slide: int) -> Cause:
    """Return the cause of a departure by a slide: the pedals just before the slide tell.

    Args:
        departure: The departure.
        slide: First record of the slide.
    """
    road = departure.mean_before(slide, departure.road)
    bend_side = _side(-departure.sign * road)
    if departure.mean_before(slide, departure.brake) > _BRAKING:
        return Cause(Kind.BRAKES_LATE, bend_side)
    if departure.mean_before(slide, departure.throttle) > _ACCELERATING:
        return Cause(Kind.ACCELERATES, bend_side)
    return Cause(Kind.TOO_FAST, bend_side)


def _side(curvature: float) -> Side:
    """Return the side to which a bend of this curvature turns."""
    return "left" if curvature > 0.0 else "right"


def _bends_ahead(segment: Segment, sign: float) -> bool:
    """Return whether the road ahead bends to the side where the car left."""
    ahead = segment.place + np.arange(0.0, _LENGTH_AHEAD, 1.0)
    return bool(sign * segment.road.curvature_at(ahead).mean() > _MIN_CURVATURE_AHEAD)


def hold_time(steering: FloatArray, time: FloatArray) -> float:
    """Return the time from the first to the last record of the largest steering angle, in s."""
    angles = np.abs(steering)
    largest = np.flatnonzero(angles >= angles.max() - 1e-9)
    return float(time[largest[-1]] - time[largest[0]])
