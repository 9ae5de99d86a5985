"""Manoeuvres whose curvature is a sine: a sweep over the frequency, and a slalom."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Annotated, ClassVar, Final, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.bounds import Positive, check
from frenetic.errors import RoadError
from frenetic.manoeuvres.manoeuvre import (
    CURVATURE,
    LARGEST_OFFSET,
    MAX_CHANGE,
    MEAN_SPEED,
    RUN_OUT,
    Graph,
    Line,
    ManoeuvreDrive,
    Measures,
    Period,
    QuantityName,
    run_up,
)
from frenetic.manoeuvres.response import (
    BANDWIDTH,
    BANDWIDTH_GAIN,
    FrequencyResponse,
    bandwidth,
    frequency_response,
    unwrapped_lags,
)
from frenetic.road import Road
from frenetic.road.road_values import MAX_SAMPLES
from frenetic.road.validity import MIN_RADIUS

_SAMPLES: Final = 24  # curvature samples in the shortest period; our choice
_MEASURED: Final = 2  # periods of each frequency that are measured; our choice
_LEAST_SAMPLES: Final = 12  # curvature samples in the shortest period of a long road; our choice
_SETTLING: Final = 8.0  # [s] that each frequency lasts at least before it is measured; our choice

MINUS_3_DB: Final = "−3 dB"
"""Name of the line of the gain at the bandwidth."""
_LARGEST_GAIN: Final = QuantityName("largest_gain", CURVATURE, "")
_LARGEST_GAIN_AT: Final = QuantityName("largest_gain_at", CURVATURE, "Hz")
_GAIN: Final = QuantityName("gain", CURVATURE, "")
_PHASE_DELAY: Final = QuantityName("phase_delay", CURVATURE, "s")
_Several: TypeAlias = Annotated[int, Meta(ge=2, le=50)]
"""A whole number from 2 to 50."""


@dataclass(frozen=True)
class Wave:
    """Some periods of a sine along the road."""

    start: float
    """Distance along the road at which the sine begins with phase 0, in m."""
    length: float
    """Length of a period, in m."""
    amplitude: float
    """Largest curvature, in 1/m."""
    periods: int
    """Number of periods."""
    measured: int
    """Number of the last periods, which are measured."""

    @property
    def end(self) -> float:
        """Distance along the road at which the sine ends, in m."""
        return self.start + self.periods * self.length

    def response(self, drive: ManoeuvreDrive) -> FrequencyResponse | None:
        """Return gain and phase in the measured periods; None if the car never got to their end."""
        first = drive.time_at(self.end - self.measured * self.length)
        last = drive.time_at(self.end)
        if first is None or last is None:
            return None
        records = drive.between(first, last)
        phase = math.tau * (drive.distance[records] - self.start) / self.length
        asked, driven = drive.asked_curvature[records], drive.driven_curvature[records]
        return frequency_response(drive.time[records], phase, asked, driven)


def amplitude_of(acceleration: float, speed: float, length: float) -> float:
    """Return the largest curvature of a sine, in 1/m, as far as roads may bend.

    Args:
        acceleration: largest lateral acceleration, in m/s².
        speed: speed, in m/s.
        length: length of a period, in m.
    """
    return min(acceleration / (speed * speed), 1.0 / MIN_RADIUS, MAX_CHANGE * length / math.tau)


def wave_road(waves: Sequence[Wave], lane_width: float) -> Road:
    """Return the road with a straight, waves one after the other, and a straight.

    Args:
        waves: the waves; each begins where the last one ends.
        lane_width: width of each lane, in m.

    Raises:
        RoadError: the waves need too long a road.
    """
    shortest = min(wave.length for wave in waves)
    length = waves[-1].end + RUN_OUT
    step = max(shortest / _SAMPLES, length / (MAX_SAMPLES - 2))
    if step > shortest / _LEAST_SAMPLES:
        raise RoadError(
            f"{length:.0f} m of sines with periods down to {shortest:.3g} m: a road has at most"
            f" {MAX_SAMPLES} samples; ask for fewer frequencies or a longer shortest period"
        )
    stations = step * np.arange(math.ceil(length / step) + 1)
    curvatures = np.zeros_like(stations)
    for wave in waves:
        is_inside = (stations >= wave.start) & (stations < wave.end)
        phase = math.tau * (stations[is_inside] - wave.start) / wave.length
        curvatures[is_inside] = wave.amplitude * np.sin(phase)
    return Road(curvatures, step, lane_width=lane_width)


@dataclass
class SweptSine:
    """A sine whose period gets shorter: gain, phase and bandwidth of the curvature driven.

    Each period is driven at least three times. It is measured in its last two repetitions, before
    which the car has at least eight seconds to become steady.
    """

    name: ClassVar[str] = "sine"
    QUANTITIES: ClassVar[tuple[QuantityName, ...]] = (
        BANDWIDTH,
        _LARGEST_GAIN,
        _LARGEST_GAIN_AT,
        LARGEST_OFFSET,
    )

    acceleration: Positive = 1.0
    """Largest lateral acceleration at the speed limit, in m/s², as far as roads may bend."""
    longest: Period = 8.0
    """Longest period, in s at the speed limit."""
    shortest: Period = 0.5
    """Shortest period, in s at the speed limit."""
    frequencies: _Several = 12
    """Number of periods from the longest to the shortest, each shorter by the same factor."""

    def __post_init__(self) -> None:
        check(vars(self), SweptSine)
        if self.shortest >= self.longest:
            raise ValueError(
                f"shortest is {self.shortest:g} s and longest {self.longest:g} s: the shortest"
                " period has to be less"
            )

    def conditions(self, speed: float) -> Mapping[str, float]:  # noqa: ARG002  # as the protocol
        """Return the conditions of the drive: none of its own."""
        return {}

    def waves(self, speed: float) -> list[Wave]:
        """Return the waves at a speed limit in m/s, from the longest to the shortest."""
        periods = np.geomspace(self.longest, self.shortest, self.frequencies).tolist()
        counts = [max(1, math.ceil(_SETTLING / period)) + _MEASURED for period in periods]
        lengths = [speed * period for period in periods]
        sizes = [count * length for count, length in zip(counts, lengths, strict=True)]
        starts = list(accumulate(sizes[:-1], initial=run_up(speed)))
        return [
            Wave(start, length, amplitude_of(self.acceleration, speed, length), count, _MEASURED)
            for start, length, count in zip(starts, lengths, counts, strict=True)
        ]

    def road(self, speed: float, lane_width: float) -> Road:
        """Return the road.

        Args:
            speed: speed limit, in m/s.
            lane_width: width of each lane, in m.

        Raises:
            RoadError: the sines need too long a road.
        """
        return wave_road(self.waves(speed), lane_width)

    def measure(self, drive: ManoeuvreDrive) -> Measures:
        """Return the bandwidth, the largest gain, and gain and phase over the frequency."""
        waves = self.waves(drive.speed)
        measured = [wave.response(drive) for wave in waves]
        responses = [response for response in measured if response is not None]
        if not responses:
            return Measures.missing(self.QUANTITIES, drive.end_text)
        quantity = bandwidth(responses)
        if quantity.value is None and len(responses) < len(waves):
            quantity = BANDWIDTH.missing(drive.end_text)
        highest = max(responses, key=lambda response: response.gain)
        quantities = (
            quantity,
            _LARGEST_GAIN.measured(highest.gain),
            _LARGEST_GAIN_AT.measured(highest.frequency),
            drive.largest_offset(0.0, math.inf),
        )
        rows = [
            {
                "frequency": response.frequency,
                "gain": response.gain,
                "lag": lag,
                "delay": lag / 360.0 / response.frequency,
            }
            for response, lag in zip(responses, unwrapped_lags(responses).tolist(), strict=True)
        ]
        columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        frequencies = columns["frequency"]
        limit = Line(MINUS_3_DB, frequencies, np.full_like(frequencies, BANDWIDTH_GAIN))
        graphs = (
            _over_frequency("gain", Line("car", frequencies, columns["gain"]), limit),
            _over_frequency("lag (°)", Line("car", frequencies, columns["lag"])),
        )
        return Measures(quantities, graphs, {"frequencies": rows})


def _over_frequency(title: str, *lines: Line) -> Graph:
    """Return a graph over the frequency, with a title of its vertical axis."""
    return Graph("frequency (Hz)", title, lines, is_logarithmic=True)


@dataclass
class Slalom:
    """Bends to both sides in turn: the largest offset, and how late the car follows."""

    name: ClassVar[str] = "slalom"
    QUANTITIES: ClassVar[tuple[QuantityName, ...]] = (
        MEAN_SPEED,
        LARGEST_OFFSET,
        _GAIN,
        _PHASE_DELAY,
    )

    period: Period = 4.0
    """Period, in s at the speed limit: a bend to the left and a bend to the right."""
    acceleration: Positive = 2.0
    """Largest lateral acceleration at the speed limit, in m/s², as far as roads may bend."""
    periods: _Several = 4
    """Number of periods; all but the first are measured."""

    def __post_init__(self) -> None:
        check(vars(self), Slalom)

    def conditions(self, speed: float) -> Mapping[str, float]:  # noqa: ARG002  # as the protocol
        """Return the conditions of the drive: none of its own."""
        return {}

    def wave(self, speed: float) -> Wave:
        """Return the wave at a speed limit in m/s."""
        length = self.period * speed
        amplitude = amplitude_of(self.acceleration, speed, length)
        return Wave(run_up(speed), length, amplitude, self.periods, self.periods - 1)

    def road(self, speed: float, lane_width: float) -> Road:
        """Return the road.

        Args:
            speed: speed limit, in m/s.
            lane_width: width of each lane, in m.

        Raises:
            RoadError: the slalom needs too long a road.
        """
        return wave_road([self.wave(speed)], lane_width)

    def measure(self, drive: ManoeuvreDrive) -> Measures:
        """Return the largest offset, the gain and the phase delay of the curvature driven."""
        wave = self.wave(drive.speed)
        response = wave.response(drive)
        first, last = drive.time_at(wave.start), drive.time_at(wave.end)
        if response is None or first is None or last is None:
            return Measures.missing(self.QUANTITIES, drive.end_text)
        quantities = (
            drive.mean_speed(first, last),
            drive.largest_offset(first, last),
            _GAIN.measured(response.gain),
            _PHASE_DELAY.measured(response.delay),
        )
        records = drive.between(first, last)
        time, title = drive.time[records] - first, "time since the slalom began (s)"
        curvatures = (
            Line("road", time, drive.asked_curvature[records]),
            Line("car", time, drive.driven_curvature[records]),
        )
        graphs = (
            Graph(title, "curvature (1/m)", curvatures),
            Graph(title, "lateral offset (m)", (Line("car", time, drive.offset[records]),)),
        )
        return Measures(quantities, graphs)
