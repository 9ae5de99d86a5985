"""Compare how well two versions of a driver drive on the same roads: `QualityComparison`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Self

from frenetic._support.json_value import JSONValue
from frenetic._support.words import in_short
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
    differences: Sequence[QualityDifference]
    """Differences by each measure in each kind of conditions, with corrected p."""

    @classmethod
    def of(cls, drives: Sequence[PairedQuality]) -> Self:
        """Return the comparison of drives on roads of one class."""
        return cls.by_class({"": drives})[""]

    @classmethod
    def by_class(cls, drives: Mapping[str, Sequence[PairedQuality]]) -> dict[str, Self]:
        """Return road class -> comparison, with p corrected by Holm for all classes.

        Args:
            drives: road class in words -> drives in each kind of conditions.
        """
        uncorrected = {
            name: [difference for paired in of_class for difference in differences_of(paired)]
            for name, of_class in drives.items()
        }
        corrected = iter(holm([each.p for of_class in uncorrected.values() for each in of_class]))
        return {
            name: cls(
                drives[name],
                tuple(replace(each, p_corrected=next(corrected)) for each in of_class),
            )
            for name, of_class in uncorrected.items()
        }

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

    def most_telling(self, most: int) -> list[QualityDifference]:
        """Return the first differences of `main`, and one against their verdict if it is `MIXED`.

        Args:
            most: number of the first differences.
        """
        first, others = self.main[:most], self.main[most:]
        signs = {difference.better for difference in first}
        against = [each for each in others if each.better and each.better not in signs]
        return [*first, *(against[:1] if self.verdict == MIXED else [])]

    @property
    def verdict(self) -> str:
        """Verdict in words: `BETTER`, `WORSE`, `MIXED` or `NO_DIFFERENCE`.

        Differences in safety decide alone: a version that fails or crosses its lane's edge more
        often is worse, however little it steers.
        """
        shown = [difference for difference in self.differences if difference.better]
        safety = [difference for difference in shown if difference.measure.group in _SAFETY]
        verdicts = {1: BETTER, -1: WORSE}
        return common_verdict(verdicts[difference.better] for difference in safety or shown)

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


def common_verdict(verdicts: Iterable[str]) -> str:
    """Return the verdict that follows from several, `MIXED` if they contradict each other."""
    verdicts = {*verdicts} & {BETTER, WORSE, MIXED}
    if len(verdicts) > 1:
        return MIXED
    return verdicts.pop() if verdicts else NO_DIFFERENCE


def classes_sentence(classes: Mapping[str, QualityComparison]) -> str:
    """Return in one sentence on which road classes versions differ, and in what.

    The more classes, the fewer differences of each are named. If nothing differs, the sentence says
    how much could differ unseen on any class.

    Args:
        classes: road class in words -> comparison, see `QualityComparison.by_class`.
    """
    most = max(1, MOST_PHRASES // len(classes))
    phrases = {name: shown_text(quality.most_telling(most)) for name, quality in classes.items()}
    texts = [f"on {name}, {text}" for name, text in phrases.items() if text]
    alike = [name for name, quality in classes.items() if quality.differences and not phrases[name]]
    if alike and texts:
        texts.append(f"{NO_DIFFERENCE} on {in_short(alike, len(alike))}")
    elif alike:
        every = [difference for name in alike for difference in classes[name].differences]
        texts.append(no_difference_text(every, in_short(alike, len(alike))))
    if empty := [name for name, quality in classes.items() if not quality.differences]:
        texts.append(no_difference_text((), in_short(empty, len(empty))))
    return "; ".join(texts)


def _weight(difference: QualityDifference) -> float:
    """Return the size of a difference, less for one in disturbed drives."""
    return difference.size / (CLEARLY_LARGER if difference.conditions else 1.0)
