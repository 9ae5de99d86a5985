"""Numbers of a step response and of a frequency response, from sampled signals.

Terms as in control engineering: the rise time is the time from 10 % to 90 % of the step, the
overshoot is how far the response exceeds its final value, in per cent of the step, and the settling
time is the time from the step until the response stays within `BAND` of its final value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.manoeuvres.manoeuvre import (
    CURVATURE,
    STEADY_TIME,
    Quantity,
    QuantityName,
    unsettled_text,
)

BAND: Final = 0.05
"""Share of the step within which a settled response stays; usual in control engineering."""
BANDWIDTH_GAIN: Final = math.sqrt(0.5)
"""Gain at the bandwidth, -3 dB."""
_LOW, _HALF, _HIGH = 0.1, 0.5, 0.9
"""Shares of the step by which rise time and delay are measured."""


@dataclass(frozen=True)
class StepResponse:
    """Numbers of a response to a step; None where there is no such number."""

    final: float | None
    """Mean at the end, in the signal's unit; None if the response does not settle."""
    unrest: float
    """Largest minus least value at the end, in the signal's unit."""
    rise_time: float | None
    """Time from 10 % to 90 % of the step, in s; None if it never gets there."""
    delay: float | None
    """Time from the step to half of the response in s, negative if the response is ahead."""
    overshoot: float | None
    """Excess over the final value, in per cent of the step; over the asked value if the response
    does not settle. None if it does not move."""
    settling_time: float | None
    """Time from the step until the response stays near its final value, in s; None if it does not
    settle or does not move."""


def step_response(
    time: FloatArray, values: FloatArray, *, step_time: float, start: float, asked: float
) -> StepResponse:
    """Return the numbers of a response to a step.

    Args:
        time: times of the samples, (n,) in s, ascending; they may begin before the step.
        values: samples of the response, (n,).
        step_time: time of the step, in s.
        start: value before the step.
        asked: value that is asked after the step, other than `start`.
    """
    last = values[time >= time[-1] - STEADY_TIME]
    final, unrest = float(last.mean()), float(np.ptp(last))
    band = BAND * abs(asked - start)
    is_steady = bool(np.abs(last - final).max() <= band)
    if is_steady and np.abs(values - start).max() <= band:
        return StepResponse(final, unrest, None, None, None, None)
    # A response that ends near its start has no step of its own.
    has_step = is_steady and abs(final - start) > band
    step = final - start if has_step else asked - start
    shares = (values - start) / step
    high = _crossing(time, shares, _HIGH)
    low = None if high is None else _last_crossing(time, shares, _LOW, before=high)
    half = _crossing(time, shares, _HALF)
    reached = final if is_steady else asked
    settling_time = None
    if is_steady:
        outside = np.flatnonzero(np.abs(values - final) > BAND * abs(step))
        settling_time = 0.0
        if len(outside):
            settling_time = max(_entry(time, values - final, int(outside[-1]), step) - step_time, 0)
    return StepResponse(
        final=final if is_steady else None,
        unrest=unrest,
        rise_time=None if high is None or low is None else high - low,
        delay=None if half is None else half - step_time,
        overshoot=100.0 * max(float(((values - reached) / step).max()), 0.0),
        settling_time=settling_time,
    )


def _crossing(time: FloatArray, shares: FloatArray, level: float) -> float | None:
    """Return when the shares reach a level for the first time, in s; None if they never do."""
    above = np.flatnonzero(shares >= level)
    if not len(above):
        return None
    return _between(time, shares, int(above[0]), level)


def _last_crossing(
    time: FloatArray, shares: FloatArray, level: float, *, before: float
) -> float | None:
    """Return when the shares are at a level for the last time before a time, in s; None: never."""
    below = np.flatnonzero((shares < level) & (time < before))
    return _between(time, shares, int(below[-1]) + 1, level) if len(below) else None


def _between(time: FloatArray, shares: FloatArray, i: int, level: float) -> float:
    """Return when a straight line from sample i - 1 to sample i is at a level, in s."""
    if i == 0:
        return float(time[0])
    share = (level - shares[i - 1]) / (shares[i] - shares[i - 1])
    return float(time[i - 1] + share * (time[i] - time[i - 1]))


def _entry(time: FloatArray, errors: FloatArray, i: int, step: float) -> float:
    """Return when a straight line from sample i, outside the band, enters the band, in s."""
    if i + 1 == len(time):
        return float(time[i])
    level = math.copysign(BAND * abs(step), errors[i])
    share = (errors[i] - level) / (errors[i] - errors[i + 1])
    return float(time[i] + share * (time[i + 1] - time[i]))


def response_names(of: str) -> tuple[QuantityName, ...]:
    """Return the names of the quantities of a step response.

    Args:
        of: signal of the response, such as ``curvature``.
    """
    return (
        QuantityName("rise_time", of, "s"),
        QuantityName("delay", of, "s"),
        QuantityName("overshoot", of, "%"),
        QuantityName("settling_time", of, "s"),
    )


def response_quantities(response: StepResponse, of: str, unit: str) -> tuple[Quantity, ...]:
    """Return rise time, delay, overshoot and settling time of a response, as quantities.

    Args:
        response: the response.
        of: signal of the response, such as ``curvature``.
        unit: unit of the signal.
    """
    rise_time, delay, overshoot, settling_time = response_names(of)
    never = "never reaches {:.0%} of the step"
    if response.overshoot is None:
        return tuple(name.missing("does not move") for name in response_names(of))
    return (
        rise_time.measured_if(response.rise_time, never.format(_HIGH)),
        delay.measured_if(response.delay, never.format(_HALF)),
        overshoot.measured(response.overshoot),
        settling_time.measured_if(response.settling_time, unsettled_text(response.unrest, unit)),
    )


@dataclass(frozen=True)
class FrequencyResponse:
    """Gain and phase of a response at one frequency."""

    frequency: float
    """Frequency in Hz."""
    gain: float
    """Amplitude of the response divided by the amplitude of what is asked."""
    lag: float
    """Phase by which the response lags, in degrees from -180 to 180."""

    @property
    def delay(self) -> float:
        """Time by which the response lags, in s."""
        return self.lag / 360.0 / self.frequency


def frequency_response(
    time: FloatArray, phase: FloatArray, asked: FloatArray, reached: FloatArray
) -> FrequencyResponse:
    """Return gain and phase over whole periods of a sine, by least squares.

    Args:
        time: times of the samples, (n,) in s.
        phase: phase of the sine at each sample, (n,) in rad; it need not grow evenly.
        asked: samples of what is asked, (n,).
        reached: samples of the response, (n,).
    """
    basis = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(phase)])
    coefficients, *_ = np.linalg.lstsq(basis, np.column_stack([asked, reached]), rcond=None)
    # a sin(p) + b cos(p) is the imaginary part of (a + ib) exp(ip).
    asked_wave, reached_wave = (complex(a, b) for a, b in coefficients[:2].T.tolist())
    ratio = reached_wave / asked_wave
    frequency = (phase[-1] - phase[0]) / (time[-1] - time[0]) / math.tau
    lag = -math.degrees(math.atan2(ratio.imag, ratio.real))
    return FrequencyResponse(float(frequency), abs(ratio), lag)


def unwrapped_lags(responses: Sequence[FrequencyResponse]) -> FloatArray:
    """Return the phases of responses by rising frequency without jumps by a turn, in degrees."""
    lags = np.radians([response.lag for response in responses])
    return np.asarray(np.degrees(np.unwrap(lags)))


BANDWIDTH: Final = QuantityName("bandwidth", CURVATURE, "Hz")


def bandwidth(responses: Sequence[FrequencyResponse]) -> Quantity:
    """Return the frequency at which the gain falls below -3 dB, as a quantity in Hz.

    Between two frequencies the gain is linear on logarithmic axes.

    Args:
        responses: responses by rising frequency.
    """
    first, last = responses[0], responses[-1]
    if first.gain < BANDWIDTH_GAIN:
        return BANDWIDTH.missing(
            f"below {first.frequency:.2g} Hz, where the gain is {first.gain:.2f} already"
        )
    for before, after in pairwise(responses):
        if after.gain < BANDWIDTH_GAIN:
            gains = np.log([after.gain, before.gain])
            frequencies = np.log([after.frequency, before.frequency])
            logarithm = np.interp(math.log(BANDWIDTH_GAIN), gains, frequencies)
            return BANDWIDTH.measured(math.exp(logarithm))
    return BANDWIDTH.missing(
        f"above {last.frequency:.2g} Hz, where the gain is {last.gain:.2f} still"
    )
