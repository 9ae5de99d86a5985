"""Compare how well two versions of a driver drive on the same roads: `QualityComparison`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from frenetic._support.json_value import JSONValue
from frenetic.analysis.quality import QUALITY, Axis, QualityMeasure
from frenetic.analysis.quality_differences import (
    FAILING,
    CurvePoint,
    PairedQuality,
    QualityDifference,
    curve,
    differences_of,
)
from frenetic.analysis.quality_text import NO_DIFFERENCE, no_difference_text, shown_text
from frenetic.analysis.statistics import holm

BETTER: Final = "new is better"
"""Verdict if the differences that count are in favour of the new version."""
WORSE: Final = "new is worse"
"""Verdict if the differences that count are in favour of the old version."""
MIXED: Final = "new is better and worse"
"""Verdict if some of them are in favour of the new version, and some of the old."""
CLEARLY_LARGER: Final = 1.5
"""Factor from which on a disturbed difference is named before an undisturbed one; our choice."""
MOST_PHRASES: Final = 4
"""Largest number of differences in the sentence; our choice."""
_SAFETY: Final = ("failing", "edge")
"""Groups of measures that decide alone if any of them shows a difference."""


@dataclass(frozen=True)
class QualityComparison:
    """Two versions of a driver compared by `QUALITY`, in one or more kinds of conditions."""

    drives: Sequence[PairedQuality]
    """Drives in each kind of conditions, those in the campaign's conditions first."""

    @cached_property
    def differences(self) -> tuple[QualityDifference, ...]:
        """Differences by each measure in each kind of conditions, with corrected p."""
        uncorrected = [
            difference for drives in self.drives for difference in differences_of(drives)
        ]
        corrected = holm([difference.p for difference in uncorrected])
        return tuple(
            replace(difference, p_corrected=p)
            for difference, p in zip(uncorrected, corrected, strict=True)
        )

    @cached_property
    def shown(self) -> tuple[QualityDifference, ...]:
        """Differences that are shown, one for each measure, in the order of `QUALITY`.

        Of several kinds of conditions it is the one with the largest difference. The campaign's
        conditions are preferred, unless the difference in others is `CLEARLY_LARGER`.
        """
        largest: dict[str, QualityDifference] = {}
        for difference in self.differences:
            name = difference.measure.name
            before = largest.get(name)
            if difference.is_shown and (before is None or _weight(difference) > _weight(before)):
                largest[name] = difference
        names = [measure.name for measure in (FAILING, *QUALITY.values())]
        return tuple(largest[name] for name in names if name in largest)

    @property
    def main(self) -> tuple[QualityDifference, ...]:
        """Largest shown difference of each group of measures, the most important group first."""
        groups: dict[str, QualityDifference] = {}
        for difference in self.shown:
            group = difference.measure.group
            if group not in groups or difference.size > groups[group].size:
                groups[group] = difference
        return tuple(groups.values())[:MOST_PHRASES]

    @property
    def verdict(self) -> str:
        """Verdict in words: `BETTER`, `WORSE`, `MIXED` or `NO_DIFFERENCE`.

        Differences in safety decide alone: a version that fails or crosses its lane's edge more
        often is worse, however little it steers.
        """
        shown = [difference for difference in self.differences if difference.better]
        safety = [difference for difference in shown if difference.measure.group in _SAFETY]
        signs = {difference.better for difference in safety or shown}
        if len(signs) == 2:
            return MIXED
        return {1: BETTER, -1: WORSE}[signs.pop()] if signs else NO_DIFFERENCE

    @property
    def sentence(self) -> str:
        """What differs, in one sentence; if nothing does, how much could differ unseen."""
        return shown_text(self.main) or no_difference_text(self.differences)

    def curves(self) -> Iterator[tuple[PairedQuality, Axis, QualityMeasure, list[CurvePoint]]]:
        """Yield the points of each measure over each axis in each kind of conditions."""
        axes: tuple[Axis, ...] = ("speed", "radius")
        for drives in self.drives:
            for axis in axes:
                for measure in QUALITY.values():
                    if measure.series is not None:
                        yield drives, axis, measure, curve(drives, axis, measure.name)

    def as_json(self) -> dict[str, JSONValue]:
        """Return the comparison as a JSON object."""
        return {
            "sentence": self.sentence,
            "verdict": self.verdict,
            "drives": [
                {
                    "conditions": drives.conditions,
                    "judged": len(drives.fails),
                    "failing": dict(zip(("old", "new"), drives.failing, strict=True)),
                    "both_pass": len(drives.pairs),
                }
                for drives in self.drives
            ],
            "differences": [difference.as_json() for difference in self.differences],
            "curves": [
                {
                    "conditions": drives.conditions,
                    "over": axis,
                    "measure": measure.name,
                    "points": [point.as_json() for point in points],
                }
                for drives, axis, measure, points in self.curves()
            ],
        }


def _weight(difference: QualityDifference) -> float:
    """Return the size of a difference, less for one in disturbed drives."""
    return difference.size / (CLEARLY_LARGER if difference.conditions else 1.0)
