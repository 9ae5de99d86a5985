"""Features of a test: properties of its road and of the drive along it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.criteria.criterion import signal_named
from frenetic.oracle.signals import series
from frenetic.segments.bends import heading_range
from frenetic.segments.segment import Segment

HEADING_BINS: Final = 10
"""Number of bins of heading in the full circle, 36 degrees each, as in the competition."""
_ROUNDING: Final = 1e-9  # [rad] change of heading that a rounding error can make

Features: TypeAlias = Mapping[str, float]
"""Name in `FEATURES` -> value for a stretch of road and the drive along it.

Moving or turning the road changes none of them; mirroring it flips the signs of the offsets.
"""


@dataclass(frozen=True)
class Feature:
    """Published range of a feature, cut into equal bins: an axis of a feature map."""

    name: str
    """Name in `Features`."""
    description: str
    """Description in a few words, for people."""
    unit: str
    """Unit; empty for a share or a number."""
    low: float
    """Lower end of the range; smaller values count into the first bin."""
    high: float
    """Upper end of the range; this and larger values count into the last bin."""
    bins: int
    """Number of bins."""

    @cached_property
    def edges(self) -> FloatArray:
        """Edges of the bins, (bins + 1,); a value on an edge belongs to the bin above."""
        return np.linspace(self.low, self.high, self.bins + 1)

    @property
    def is_count(self) -> bool:
        """Whether the feature's values are whole numbers: then each bin holds one number."""
        return self.low % 1.0 == 0.5 and self.high - self.low == self.bins

    def bin(self, value: float) -> int:
        """Return the bin of a value, from 0."""
        index = int(np.searchsorted(self.edges, value, side="right")) - 1
        return min(max(index, 0), self.bins - 1)


FEATURES: Final[Mapping[str, Feature]] = MappingProxyType(
    {
        feature.name: feature
        for feature in (
            Feature("length", "Length of the road", "m", 0.0, 400.0, 10),
            Feature("max_curvature", "Largest curvature", "1/m", 0.0, 0.07, 10),
            Feature("direction_coverage", "Share of directions covered", "", 0.05, 1.05, 10),
            Feature("bends", "Number of bends", "", -0.5, 9.5, 10),
            Feature("mean_speed", "Mean speed", "m/s", 0.0, 25.0, 10),
            Feature("std_speed", "Standard deviation of speed", "m/s", 0.0, 8.0, 10),
            Feature("std_steering", "Standard deviation of steering", "rad", 0.0, 0.3, 10),
            Feature("mean_offset", "Mean lateral position", "m", -1.5, 1.5, 10),
            Feature("extreme_offset", "Extreme lateral position", "m", -5.0, 5.0, 10),
            Feature("lateral_acceleration", "Lateral acceleration", "m/s²", 0.0, 12.0, 12),
            Feature("lateral_jerk", "Lateral jerk", "m/s³", 0.0, 20.0, 10),
        )
    }
)
"""Name of a feature -> feature with its range."""


def features_of(segment: Segment) -> Features:
    """Return the features of a segment, or of a whole test: ``features_of(segment.whole())``.

    The bin of the direction in which the stretch begins has this direction in its middle. Means and
    deviations are over the records of the drive; offsets are to the left of the ego lane's centre
    line.
    """
    distances, curvatures = segment.curvature_samples
    offset = segment.lateral_offset
    mean_speed, std_speed = _mean_and_deviation(segment.speed)
    return {
        "length": segment.length,
        "max_curvature": float(np.abs(curvatures).max()),
        "direction_coverage": _directions(distances, curvatures) / HEADING_BINS,
        "bends": float(len(segment.bends)),
        "mean_speed": mean_speed,
        "std_speed": std_speed,
        "std_steering": _mean_and_deviation(segment.steering)[1],
        "mean_offset": float(np.add.reduce(offset) / len(offset)),
        "extreme_offset": float(offset[np.abs(offset).argmax()]),
        **_worst_values(segment),
    }


def _mean_and_deviation(values: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation of values, (n,), in a third of the time of numpy's own."""
    mean = np.add.reduce(values) / len(values)
    deviations = values - mean
    return float(mean), math.sqrt(np.add.reduce(deviations * deviations) / len(values))


def _worst_values(segment: Segment) -> dict[str, float]:
    """Return the largest lateral acceleration and jerk in a segment; 0 without finite values."""
    worst = {}
    for name in ("lateral_acceleration", "lateral_jerk"):
        signal = series(name, segment.signals, signal_named(name).window)
        values = np.abs(signal[segment.first : segment.last])
        largest = np.maximum.reduce(values, initial=0.0)  # NaN if a value is NaN
        if not math.isfinite(largest):
            largest = values[np.isfinite(values)].max(initial=0.0)
        worst[name] = float(largest)
    return worst


def _directions(distances: FloatArray, curvatures: FloatArray) -> int:
    """Return the number of heading bins that a line covers.

    Heading is continuous, so these are all bins between the least and the largest heading.
    """
    width = 2.0 * math.pi / HEADING_BINS
    least, most = heading_range(distances, curvatures)
    # A rounding error at the edge of a bin must not add another bin.
    first = math.ceil((least + _ROUNDING) / width - 0.5)
    last = math.floor((most - _ROUNDING) / width + 0.5)
    return min(last - first + 1, HEADING_BINS)
