"""Commands of a driver that are wrong by themselves, before the car leaves its line.

Each function returns the record in which the wrong command begins, or None. Only commands count
that begin around the last record in which the car was sound: what a driver asks for later may be
its answer to a departure that has begun already.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.segments.departure import Departure, last_record, stretches

# The values are our choice.
_BEFORE: Final = 1.5  # [s] before the last sound record in which a wrong command may begin
_AFTER: Final = 0.4  # [s] after it
MOST_STEERING: Final = 1.2
"""Angle of front wheels that no car has, in rad."""
_MOST_AHEAD: Final = 0.5  # [rad] by which the wanted steering may be ahead of the front wheels
_BEYOND_TIME: Final = 0.3  # [s] for which a command is beyond the car, at least
_PEDAL: Final = 0.2  # pedal above which it counts as pressed
_PEDALS_TIME: Final = 1.0  # [s] for which both pedals are pressed, at least
_BEND: Final = 0.015  # [1/m] least curvature of a bend against which a driver may steer
_STEERING_BACK: Final = 0.03  # [rad] least steering against a bend
_MOST_INSIDE: Final = 0.8  # [m] largest offset to the bend's inside, where no driver has to return
_CHANGE_TIME: Final = 0.3  # [s] within which the steering turns against the bend
_AGAINST_TIME: Final = 0.15  # [s] for which it is against the bend, at least
_SWINGING_TIME: Final = 2.0  # [s] before a turn against the bend, in which the steering may swing
_MOST_SWINGS: Final = 2  # swings of a steering that does not oscillate
_SWING: Final = 0.02  # [rad] least swing of the steering about what the road needs
_LEAST_RATE: Final = 0.03  # [rad/s] least rate of steering that may be a limit
_RATE_ROUNDING: Final = 0.004  # [rad/s] by which two rates differ that are equal before rounding
_RATE_TIME: Final = 0.4  # [s] for which a steering turns at its limit without a break, at least
_RATE_SHARE: Final = 0.5  # least share of the excursion in which it turns at its limit


def beyond_the_car(departure: Departure) -> int | None:
    """Return where a driver begins to ask for steering that a car cannot have, or not so fast."""
    wanted = np.abs(departure.steering_input)
    ahead = np.abs(departure.steering_input - departure.steering)
    return _begin_of(departure, (wanted > MOST_STEERING) | (ahead > _MOST_AHEAD), _BEYOND_TIME)


def both_pedals(time: FloatArray, throttle: FloatArray, brake: FloatArray) -> int | None:
    """Return where a driver begins to press both pedals at once, in the last such stretch."""
    for first, last in reversed(stretches((throttle > _PEDAL) & (brake > _PEDAL))):
        if time[last] - time[first] >= _PEDALS_TIME:
            return first
    return None


def against_the_bend(departure: Departure) -> int | None:
    """Return where a driver that steered as the road bends begins to steer the other way.

    A driver that is late steers the other way, too, once the road has changed its side. Here the
    driver's steering changes its side, and the road does not.
    """
    sign, inside = np.sign(departure.curvature), departure.sign * departure.offset
    steering = departure.steering_input * sign  # positive into the bend
    is_against = (np.abs(departure.curvature) > _BEND) & (steering < -_STEERING_BACK)
    is_against &= inside * sign < _MOST_INSIDE
    if departure.last_slide is not None:
        is_against[departure.last_slide :] = False  # a driver may catch a slide
    begin = _begin_of(departure, is_against, _AGAINST_TIME)
    if begin is None:
        return None
    before = max(begin - _records_in(departure.time, _CHANGE_TIME), 0)
    has_turned = sign[before] == sign[begin] and departure.steering_input[before] * sign[begin] > 0
    if not has_turned or _swings_before(departure, begin) > _MOST_SWINGS:
        return None
    return begin


def _swings_before(departure: Departure, record: int) -> int:
    """Return how often the steering swung about what the road needs, just before a record."""
    first = last_record(departure.time <= departure.time[record] - _SWINGING_TIME)
    excess = (departure.steering_input - departure.needed_steering)[first:record]
    sides = np.sign(excess[np.abs(excess) > _SWING])
    return int(np.count_nonzero(np.diff(sides)))


def at_a_rate_limit(departure: Departure) -> int | None:
    """Return where the wanted steering begins to turn at the fastest rate that the driver has.

    A rate is a limit if the steering turns at exactly this rate, to one side or the other, for half
    of the excursion, and for `_RATE_TIME` without a break.
    """
    first = departure.last_sound
    rates = departure.steering_rates(first)
    if not len(rates) or (fastest := float(rates.max())) < _LEAST_RATE:
        return None
    is_fastest = rates >= fastest - _RATE_ROUNDING
    times = departure.time[first:]
    longest = max((times[last + 1] - times[begin] for begin, last in stretches(is_fastest)))
    if is_fastest.mean() < _RATE_SHARE or longest < _RATE_TIME:
        return None
    return first + int(np.argmax(is_fastest))


def _begin_of(departure: Departure, is_wrong: npt.NDArray[np.bool_], least: float) -> int | None:
    """Return the first record of a wrong command that begins while the car is sound.

    Args:
        departure: The departure.
        is_wrong: Whether the command is wrong, for each record.
        least: Least time for which it is, in s.
    """
    if not is_wrong.any():
        return None
    time, sound = departure.time, departure.time[departure.last_sound]
    for first, last in stretches(is_wrong):
        lasts = time[min(last + 1, len(time) - 1)] - time[first] >= least
        if lasts and sound - _BEFORE <= time[first] <= sound + _AFTER:
            return first
    return None


def _records_in(time: FloatArray, seconds: float) -> int:
    """Return the number of records in some seconds, at least 1."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else seconds
    return max(round(seconds / max(period, 1e-6)), 1)
