"""How well a driver drives on a road that it passes: `QUALITY`, the measures of one drive.

Failures say nothing about two drivers that both pass. These measures do: how far the car strays
from the middle of its lane, how busily it is steered, and how it shakes its passengers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.analysis.oscillation import (
    MAX_FREQUENCY,
    MIN_FREQUENCY,
    MIN_PERIODS,
    PEAK_SHARE,
    REVERSAL_GAP,
    dominant_sway,
    reversals,
)
from frenetic.oracle.drive import Drive
from frenetic.oracle.signals import LocatedDrive, series
from frenetic.oracle.verdict import locate_drive
from frenetic.road import Road

SPEED_STEP: Final = 10.0
"""Width of a bin of speeds, in km/h; our choice."""
RADII: Final = (50.0, 100.0, 200.0, 400.0, 800.0)
"""Radii that part the bins of radii, in m; the last bin holds all wider bends and straights; our
choice."""
MIN_BIN_RECORDS: Final = 10
"""Fewest records of a drive in a bin, 0.5 s of an ordinary drive, for the bin to count; our
choice."""
MIN_SWAY: Final = 0.01
"""Least amplitude of a sway, in m; less is no sway; our choice."""
_JERK_WINDOW: Final = 0.5
"""Time over which jerk and deceleration are averaged, in s, as in the criteria `lateral_jerk` and
`longitudinal_jerk`."""

_Series: TypeAlias = Callable[[LocatedDrive], FloatArray]
"""Function that returns a value for each record, (n,), NaN where it has none."""
_Reduction: TypeAlias = Callable[[FloatArray], float]
"""Function that returns the measure of some records' values, (m,) without NaN, m >= 1."""
Axis: TypeAlias = Literal["speed", "radius"]
"""Name of what the bins along a drive go by."""


@dataclass(frozen=True, kw_only=True)
class QualityMeasure:
    """A number that says how well a driver drives on one road."""

    name: str
    """Name in JSON and tables."""
    title: str
    """Title for people."""
    unit: str
    """Unit of the values."""
    definition: str
    """Definition, in a sentence or two."""
    group: Literal["failing", "edge", "lane", "steering", "comfort", "pace"]
    """What the measure is about."""
    better: Literal["less", "more", "neither"] = "less"
    """Whether less or more is better for a driver."""
    least: float
    """Least difference that anyone would notice; a smaller one is not told (our choice)."""
    phrases: tuple[str, str]
    """Phrases for a smaller and for a larger value, in which ``{}`` stands for the difference; of a
    share, for both versions' shares."""
    is_share: bool = False
    """Whether a value is 0 or 100, so that the mean over roads is a share of them in percent."""
    in_percent: bool = False
    """Whether the phrases have the difference in percent of the old version's value."""
    decimals: int = 2
    """Number of decimals of values as text."""
    series: _Series | None = None
    """Function that returns the values from which `reduction` makes the measure; None for a measure
    of whole drives only."""
    reduction: _Reduction | None = None
    """Function that makes the measure of the records' values."""

    def text(self, value: float | None) -> str:
        """Return a value in the measure's decimals, without its unit."""
        return "–" if value is None else f"{value:.{self.decimals}f}"


@dataclass(frozen=True)
class DriveQuality:
    """The measures of one drive."""

    values: Mapping[str, float]
    """Name of a measure -> value; measures without a value in this drive are left out."""
    bins: Mapping[Axis, Mapping[int, Mapping[str, float]]]
    """Axis -> number of a bin, see `bin_ends` -> name of a measure -> value in the bin."""


def _root_mean_square(values: FloatArray) -> float:
    """Return the root mean square of values."""
    return math.sqrt(float(values @ values) / len(values))


def _largest(values: FloatArray) -> float:
    """Return the largest value."""
    return float(values.max())


def _least(values: FloatArray) -> float:
    """Return the least value."""
    return float(values.min())


_CROSSES: Final = "crosses the edge of its lane on {}"
"""Phrase for the share of roads with a crossed edge."""

_LANE_MEASURES: Final = (
    QualityMeasure(
        name="crossing",
        title="roads with the lane's edge crossed",
        unit="%",
        definition="Share of the roads on which the car's outline crosses an edge of its lane.",
        group="edge",
        least=1.0,
        phrases=(_CROSSES, _CROSSES),
        is_share=True,
        decimals=1,
        series=lambda located: located.edge_distances.min(axis=1),
        reduction=lambda values: 100.0 * float(values.min() < 0.0),
    ),
    QualityMeasure(
        name="edge_distance",
        title="least edge distance",
        unit="m",
        definition="Least distance of the car's outline from an edge of its lane, negative"
        " outside.",
        group="lane",
        better="more",
        least=0.05,
        phrases=(
            "comes {} nearer to the edge of its lane",
            "stays {} farther from the edge of its lane",
        ),
        series=lambda located: located.edge_distances.min(axis=1),
        reduction=_least,
    ),
    QualityMeasure(
        name="rms_offset",
        title="offset, rms",
        unit="m",
        definition="Root mean square of the distance of the centre of mass from the lane's centre.",
        group="lane",
        least=0.02,
        phrases=("keeps {} closer to the middle", "keeps {} farther from the middle"),
        series=lambda located: located.lateral_offset,
        reduction=_root_mean_square,
    ),
    QualityMeasure(
        name="largest_offset",
        title="largest offset",
        unit="m",
        definition="Largest distance of the centre of mass from the lane's centre, to either side.",
        group="lane",
        least=0.05,
        phrases=("strays {} less from the middle", "strays {} farther from the middle"),
        series=lambda located: np.abs(located.lateral_offset),
        reduction=_largest,
    ),
    QualityMeasure(
        name="sway_amplitude",
        title="sway",
        unit="m",
        definition="Amplitude of the dominant oscillation of the offset: of the highest peak in its"
        f" spectrum from {MIN_FREQUENCY:g} to {MAX_FREQUENCY:g} Hz, if it holds"
        f" {100.0 * PEAK_SHARE:g} % of the power from {MIN_FREQUENCY:g} Hz on and has"
        f" {MIN_PERIODS:g} periods in the drive; 0 without such a peak.",
        group="lane",
        least=0.02,
        phrases=("sways {} less to either side", "sways {} more to either side"),
    ),
    QualityMeasure(
        name="sway_frequency",
        title="frequency of the sway",
        unit="Hz",
        definition="Frequency of the dominant oscillation of the offset; none below an amplitude of"
        f" {MIN_SWAY:g} m.",
        group="lane",
        better="neither",
        least=0.05,
        phrases=("sways {} slower", "sways {} faster"),
    ),
)
_STEERING_MEASURES: Final = (
    QualityMeasure(
        name="rms_steering_rate",
        title="steering rate, rms",
        unit="°/s",
        definition="Root mean square of the rate at which the front wheels turn.",
        group="steering",
        least=0.2,
        phrases=("steers {} less", "steers {} more"),
        in_percent=True,
        series=lambda located: series("steering_rate", located, 0.0),
        reduction=_root_mean_square,
    ),
    QualityMeasure(
        name="steering_reversals",
        title="steering reversals",
        unit="/min",
        definition="How often a minute the front wheels turn back by at least"
        f" {REVERSAL_GAP:g}°, about 3° at a steering wheel.",
        group="steering",
        least=2.0,
        phrases=("turns the wheel back {} less often", "turns the wheel back {} more often"),
        in_percent=True,
        decimals=1,
    ),
)
_COMFORT_MEASURES: Final = (
    QualityMeasure(
        name="rms_lateral_jerk",
        title="lateral jerk, rms",
        unit="m/s³",
        definition="Root mean square of the change of the lateral acceleration, each a mean over"
        f" {_JERK_WINDOW:g} s.",
        group="comfort",
        least=0.1,
        phrases=("jerks {} less to the sides", "jerks {} more to the sides"),
        in_percent=True,
        series=lambda located: series("lateral_jerk", located, _JERK_WINDOW),
        reduction=_root_mean_square,
    ),
    QualityMeasure(
        name="rms_longitudinal_jerk",
        title="longitudinal jerk, rms",
        unit="m/s³",
        definition="Root mean square of the change of the acceleration along the car, each a mean"
        f" over {_JERK_WINDOW:g} s.",
        group="comfort",
        least=0.1,
        phrases=("jerks {} less along the road", "jerks {} more along the road"),
        in_percent=True,
        series=lambda located: series("longitudinal_jerk", located, _JERK_WINDOW),
        reduction=_root_mean_square,
    ),
    QualityMeasure(
        name="largest_deceleration",
        title="largest deceleration",
        unit="m/s²",
        definition=f"Largest deceleration along the car, as a mean over {_JERK_WINDOW:g} s.",
        group="comfort",
        least=0.2,
        phrases=("brakes {} less", "brakes {} harder"),
        in_percent=True,
        series=lambda located: series("deceleration", located, _JERK_WINDOW),
        reduction=_largest,
    ),
)
_PACE_MEASURES: Final = (
    QualityMeasure(
        name="mean_speed",
        title="mean speed",
        unit="km/h",
        definition="Mean speed along the car.",
        group="pace",
        better="neither",
        least=1.0,
        phrases=("drives {} slower", "drives {} faster"),
        in_percent=True,
        decimals=1,
        series=lambda located: 3.6 * located.path.speed,
        reduction=lambda values: float(values.mean()),
    ),
)

QUALITY: Final[Mapping[str, QualityMeasure]] = MappingProxyType(
    {
        measure.name: measure
        for measure in (
            *_LANE_MEASURES,
            *_STEERING_MEASURES,
            *_COMFORT_MEASURES,
            *_PACE_MEASURES,
        )
    }
)
"""Name -> measure; measures of the most important group come first."""


def drive_quality(road: Road, drive: Drive) -> DriveQuality:
    """Return the measures of a drive, also in bins of speed and radius.

    Args:
        road: road of the drive, in its place on the map.
        drive: the drive, of which the records up to its end count.
    """
    located = locate_drive(road, drive)
    values = dict(_whole_drive_values(located))
    bins: dict[Axis, dict[int, dict[str, float]]] = {"speed": {}, "radius": {}}
    parts = [
        (np.flatnonzero(numbers == number), bins[axis].setdefault(number, {}))
        for axis, numbers in _bin_numbers(located).items()
        for number in np.unique(numbers).tolist()
    ]
    for name, measure in QUALITY.items():
        if measure.series is None or measure.reduction is None:
            continue
        records = measure.series(located)
        for chosen, part_values in ((np.arange(len(records)), values), *parts):
            part = records[chosen]
            part = part[np.isfinite(part)]
            if len(part) >= (1 if part_values is values else MIN_BIN_RECORDS):
                part_values[name] = measure.reduction(part)
    return DriveQuality({name: values[name] for name in QUALITY if name in values}, bins)


def _whole_drive_values(located: LocatedDrive) -> Iterator[tuple[str, float]]:
    """Yield name and value of each measure of whole drives only."""
    time = located.path.time
    sway = dominant_sway(time, located.lateral_offset)
    if sway is not None and sway.amplitude < MIN_SWAY:
        sway = None
    if len(time) > 1:
        yield "sway_amplitude", 0.0 if sway is None else sway.amplitude
        minutes = float(time[-1] - time[0]) / 60.0
        angle = np.degrees(located.path.steering)
        yield "steering_reversals", reversals(angle, REVERSAL_GAP) / minutes
    if sway is not None:
        yield "sway_frequency", sway.frequency


def _bin_numbers(located: LocatedDrive) -> dict[Axis, IntArray]:
    """Return the number of the bin of each record, (n,), by each axis."""
    curvature = np.abs(located.road.curvature_at(np.maximum(located.distance, 0.0)))
    limits = 1.0 / np.array(RADII)
    return {
        "speed": np.floor(np.maximum(3.6 * located.path.speed, 0.0) / SPEED_STEP).astype(np.int64),
        "radius": (curvature[:, None] < limits).sum(axis=1).astype(np.int64),
    }


def bin_ends(axis: Axis, number: int) -> tuple[float, float]:
    """Return the two ends of a bin: of speeds in km/h, of radii in m, which may be infinite."""
    if axis == "speed":
        return number * SPEED_STEP, (number + 1) * SPEED_STEP
    ends = (0.0, *RADII, math.inf)
    return ends[number], ends[number + 1]
