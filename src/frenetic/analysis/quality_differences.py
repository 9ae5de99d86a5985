"""Differences between two versions of a driver by the measures of `frenetic.analysis.quality`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.json_value import JSONValue
from frenetic.analysis.paired import paired_shift, signed_rank_p
from frenetic.analysis.quality import QUALITY, Axis, DriveQuality, QualityMeasure, bin_ends
from frenetic.analysis.statistics import (
    SIGNIFICANT,
    ValueWithInterval,
    paired_share_difference,
    quartiles,
)

MIN_BIN_ROADS: Final = 6
"""Fewest roads for a point of a curve: fewer give no interval of 95 %."""
_PERCENT: Final = 100.0

FAILING: Final = QualityMeasure(
    name="failing",
    title="roads failed",
    unit="%",
    definition="Share of the roads on which the version fails.",
    group="failing",
    least=1.0,
    phrases=("fails on {}", "fails on {}"),
    is_share=True,
    decimals=1,
)
"""Measure of disturbed drives beside `QUALITY`, of all roads that were judged with both."""


@dataclass(frozen=True)
class PairedQuality:
    """Drives of two versions on the same roads, in the same conditions."""

    conditions: str
    """Conditions in which both drove, in words; empty for the campaign's conditions."""
    fails: Sequence[tuple[bool, bool]]
    """Whether the old and the new version fail, for each road that was judged with both."""
    pairs: Sequence[tuple[DriveQuality, DriveQuality]]
    """Measures of the old and the new version's drive on each road that both pass."""

    @property
    def failing(self) -> tuple[int, int]:
        """Number of roads on which the old and the new version fail."""
        old, new = (sum(fails[i] for fails in self.fails) for i in range(2))
        return old, new

    def values(self, name: str) -> list[tuple[float, float]]:
        """Return the values of a measure of both versions, on roads where both have a value."""
        return [
            (old.values[name], new.values[name])
            for old, new in self.pairs
            if name in old.values and name in new.values
        ]


@dataclass(frozen=True)
class QualityDifference:
    """Difference between two versions by one measure, in one kind of conditions."""

    measure: QualityMeasure
    conditions: str
    """Conditions of the drives, in words; empty for the campaign's conditions."""
    roads: int
    """Number of roads on which both have a value."""
    old: float
    """Median of the old version's values, or their mean if the measure is a share."""
    new: float
    """Median of the new version's values, or their mean if the measure is a share."""
    difference: ValueWithInterval
    """Difference of the values, new minus old, in the measure's unit."""
    p: float
    """p of the signed-rank test."""
    p_corrected: float = 1.0
    """p, corrected by Holm for all measures in all conditions and on all road classes."""

    @property
    def is_shown(self) -> bool:
        """Whether it is more than chance, and large enough for anyone to notice."""
        is_noticeable = abs(self.difference.value) >= self.measure.least
        return self.p_corrected < SIGNIFICANT and is_noticeable

    @property
    def better(self) -> int:
        """1 if the difference is shown and in favour of the new version, -1 of the old, else 0."""
        if not self.is_shown or self.measure.better == "neither":
            return 0
        return 1 if (self.difference.value > 0.0) is (self.measure.better == "more") else -1

    @property
    def size(self) -> float:
        """Absolute difference, as a multiple of the least that anyone would notice."""
        return abs(self.difference.value) / self.measure.least

    def as_json(self) -> dict[str, JSONValue]:
        """Return the difference as a JSON object."""
        measure = self.measure
        return {
            "measure": measure.name,
            "title": measure.title,
            "unit": measure.unit,
            "definition": measure.definition,
            "better": measure.better,
            "least": measure.least,
            "conditions": self.conditions,
            "roads": self.roads,
            "old": self.old,
            "new": self.new,
            **_interval_json(self.difference),
            "p": self.p,
            "p_corrected": self.p_corrected,
            "is_shown": self.is_shown,
        }


@dataclass(frozen=True)
class CurvePoint:
    """Both versions' values in one bin of speeds or radii."""

    low: float
    """Lower end of the bin: speed in km/h or radius in m."""
    high: float
    """Upper end of the bin, which may be infinite."""
    roads: int
    """Number of roads on which both drove in the bin."""
    old: float
    """Median of the old version's values."""
    new: float
    """Median of the new version's values."""
    difference: ValueWithInterval
    """Difference of the values, new minus old, with its interval; no correction is made for the
    number of bins."""

    def as_json(self) -> dict[str, JSONValue]:
        """Return the point as a JSON object, with null for an infinite end."""
        return {
            "from": self.low,
            "to": _finite(self.high),
            "roads": self.roads,
            "old": self.old,
            "new": self.new,
            **_interval_json(self.difference),
        }


def differences_of(drives: PairedQuality) -> Iterator[QualityDifference]:
    """Yield the differences in one kind of conditions, with p not yet corrected.

    In the campaign's conditions, failures have their own verdict, so they are left out.
    """
    fails = [(_PERCENT * old, _PERCENT * new) for old, new in drives.fails]
    measured = [(FAILING, fails if drives.conditions else [])]
    measured += [(measure, drives.values(name)) for name, measure in QUALITY.items()]
    for measure, values in measured:
        if values:
            p = signed_rank_p([new - old for old, new in values])
            yield QualityDifference(measure, drives.conditions, *_summary(measure, values), p)


def curve(drives: PairedQuality, axis: Axis, name: str) -> list[CurvePoint]:
    """Return a measure over speed or radius, in ascending order, where enough roads are.

    Args:
        drives: drives in one kind of conditions.
        axis: what the bins go by.
        name: name of a measure in `QUALITY` that has a value in parts of a drive.
    """
    numbers = {number for old, _ in drives.pairs for number in old.bins[axis]}
    points = []
    for number in sorted(numbers):
        bins = [[drive.bins[axis].get(number, {}) for drive in pair] for pair in drives.pairs]
        values = [(old[name], new[name]) for old, new in bins if name in old and name in new]
        if len(values) >= MIN_BIN_ROADS:
            low, high = bin_ends(axis, number)
            roads, old_median, new_median, difference = _summary(QUALITY[name], values)
            points.append(CurvePoint(low, high, roads, old_median, new_median, difference))
    return points


def _summary(
    measure: QualityMeasure, values: Sequence[tuple[float, float]]
) -> tuple[int, float, float, ValueWithInterval]:
    """Return the number of pairs, a middle value of old and new, and their paired difference."""
    old, new = (np.array(column) for column in zip(*values, strict=True))
    if measure.is_share:
        share = paired_share_difference(old / _PERCENT, new / _PERCENT)
        ends = (_PERCENT * end for end in (share.value, share.low, share.high))
        return len(old), float(old.mean()), float(new.mean()), ValueWithInterval(*ends)
    return len(old), quartiles(old).median, quartiles(new).median, paired_shift(new - old)


def _interval_json(value: ValueWithInterval) -> Mapping[str, JSONValue]:
    """Return difference, low and high for JSON, with null for an infinite end."""
    ends = {"difference": value.value, "low": value.low, "high": value.high}
    return {name: _finite(end) for name, end in ends.items()}


def _finite(value: float) -> float | None:
    """Return a number for JSON, which holds finite numbers only; None for others."""
    return value if math.isfinite(value) else None
