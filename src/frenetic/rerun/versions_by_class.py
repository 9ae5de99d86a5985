"""Compare two versions of a driver on roads of several classes: on which is which better.

Each class has a campaign of the old version and a comparison of its own, see
`frenetic.rerun.back_to_back`. What they say together is corrected for the number of classes::

    results = {name: back_to_back(folder, simulator, old, new) for name, folder in roads.items()}
    print(VersionsByClass.of(results).sentences)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted, in_short
from frenetic.analysis.quality_comparison import (
    BETTER,
    MIXED,
    WORSE,
    QualityComparison,
    classes_sentence,
    common_verdict,
)
from frenetic.analysis.quality_text import NO_DIFFERENCE
from frenetic.campaign.store import CampaignStore
from frenetic.criteria.criterion import COMPETITION
from frenetic.errors import CampaignError
from frenetic.parts.records import differences
from frenetic.rerun.back_to_back import CANNOT_TELL, BackToBack, in_points, paired_counts
from frenetic.spec.terms import DriveSetting, Terms


@dataclass(frozen=True)
class VersionsByClass:
    """Comparison of two versions of a driver on roads of several classes."""

    classes: Mapping[str, BackToBack]
    """Road class in words -> comparison on its roads, corrected for the number of classes."""

    @classmethod
    def of(cls, results: Mapping[str, BackToBack]) -> Self:
        """Return comparisons on roads of several classes, corrected for their number.

        Args:
            results: road class in words -> comparison on its roads, without missing drives.

        Raises:
            ValueError: there is no comparison, drives are missing, or the versions differ.
        """
        if not results:
            raise ValueError("there is no comparison: one on each road class is needed")
        first, *others = results.values()
        if any(result.old != first.old or result.new != first.new for result in others):
            raise ValueError("the comparisons are of different versions: the same are needed")
        qualities = {name: result.quality for name, result in results.items() if result.quality}
        if missing := [name for name in results if name not in qualities]:
            raise ValueError(f"drives are missing on {in_short(missing)}: compare to the end")
        corrected = QualityComparison.by_class(
            {name: quality.drives for name, quality in qualities.items()}
        )
        return cls(
            {
                name: replace(result, quality=corrected[name], classes=len(results))
                for name, result in results.items()
            }
        )

    @property
    def old(self) -> Mapping[str, JSONValue]:
        """Old version, as `frenetic.spec.part_record.describe` records it."""
        return next(iter(self.classes.values())).old

    @property
    def new(self) -> Mapping[str, JSONValue]:
        """New version, as `frenetic.spec.part_record.describe` records it."""
        return next(iter(self.classes.values())).new

    @property
    def simulator(self) -> Mapping[str, JSONValue]:
        """Simulator, as `frenetic.spec.part_record.describe` records it."""
        return next(iter(self.classes.values())).simulator

    @property
    def confidence(self) -> float:
        """Confidence of the intervals of failures, corrected for all classes."""
        return next(iter(self.classes.values())).confidence

    @property
    def qualities(self) -> dict[str, QualityComparison]:
        """Road class in words -> comparison where both pass."""
        return {name: result.quality for name, result in self.classes.items() if result.quality}

    @property
    def verdict(self) -> str:
        """Verdict on failures, `MIXED` if each version is better on some class."""
        verdicts = [result.verdict for result in self.classes.values()]
        common = common_verdict(verdicts)
        return CANNOT_TELL if common == NO_DIFFERENCE and CANNOT_TELL in verdicts else common

    @property
    def quality_verdict(self) -> str:
        """Verdict where both pass, `MIXED` if each version is better on some class."""
        return common_verdict(quality.verdict for quality in self.qualities.values())

    @property
    def overall(self) -> str:
        """Verdict on failures; if they show no difference, the verdict on quality."""
        if self.verdict in (BETTER, WORSE, MIXED) or self.quality_verdict == NO_DIFFERENCE:
            return self.verdict
        return self.quality_verdict

    @property
    def answer(self) -> str:
        """On which classes a version fails less, with numbers, in one line."""
        names: dict[tuple[str, str], list[str]] = {}
        for name, result in self.classes.items():
            names.setdefault((result.verdict_with_time, _failures_text(result)), []).append(name)
        texts = [
            f"{verdict} on {in_short(alike, len(alike))} ({failures})"
            for (verdict, failures), alike in names.items()
        ]
        return "; ".join(sorted(texts, key=lambda text: not text.startswith((BETTER, WORSE))))

    @property
    def sentences(self) -> tuple[str, ...]:
        """Answer and the sentence on quality; what shows a difference comes first."""
        quality = classes_sentence(self.qualities)
        is_shown = any(quality.shown for quality in self.qualities.values())
        if self.verdict in (BETTER, WORSE, MIXED) or not is_shown:
            return self.answer, f"quality: {quality}"
        return quality, f"failures: {self.answer}"

    @property
    def causes(self) -> Mapping[str, tuple[int, int]]:
        """Cause in words -> numbers of roads on which the old and the new version fail by it.

        The roads of all classes count; the most frequent cause comes first.
        """
        old, new = Counter[str](), Counter[str]()
        for result in self.classes.values():
            for cause, (of_old, of_new) in result.causes.items():
                old[cause] += of_old
                new[cause] += of_new
        return paired_counts(old, new)

    @property
    def notes(self) -> tuple[str, ...]:
        """Limits of the answer, each in a sentence; of a limit on some classes, which classes."""
        classes: dict[str, list[str]] = {}
        for name, result in self.classes.items():
            for note in result.notes:
                classes.setdefault(note, []).append(name)
        notes = [
            note if len(names) == len(self.classes) else f"{in_short(names, len(names))}: {note}"
            for note, names in classes.items()
        ]
        notes.append(
            f"corrected for {len(self.classes)} road classes: intervals of failures are of"
            f" {100.0 * self.confidence:.3g} %, so that all of them hold together with 95 %"
        )
        return tuple(notes)

    def as_json(self) -> dict[str, JSONValue]:
        """Return the comparison as a JSON object."""
        return {
            "answer": self.answer,
            "verdict": self.verdict,
            "overall": self.overall,
            "sentences": list(self.sentences),
            "notes": list(self.notes),
            "old": dict(self.old),
            "new": dict(self.new),
            "simulator": dict(self.simulator),
            "confidence": self.confidence,
            "causes": {cause: list(roads) for cause, roads in self.causes.items()},
            "classes": {name: result.as_json() for name, result in self.classes.items()},
        }


def _failures_text(result: BackToBack) -> str:
    """Return on how many fresh roads of a class each version fails, with the difference."""
    if result.difference is None:
        return "no fresh road was judged with both"
    old, new = result.fresh.failing
    roads = counted(len(result.fresh.judged), "fresh road")
    value, interval = in_points(result.difference)
    return f"fails on {new} of {roads}, old on {old}: {value} points, {interval}"


def campaigns_by_class(folders: Sequence[Path], *, on_own_roads: bool = False) -> dict[str, Path]:
    """Return road class in words -> campaign, of campaigns of one driver on different roads.

    A name that several campaigns would have is followed by the campaign's folder.

    Args:
        folders: folders of one or more campaigns.
        on_own_roads: whether the campaigns' own roads are compared: then their terms may be equal.

    Raises:
        CampaignError: driver or simulator differ, or two campaigns have the same terms.
    """
    names: list[str] = []
    settings: list[DriveSetting] = []
    records: list[Mapping[str, Any]] = []
    for folder in folders:
        with CampaignStore.open(folder) as store:
            setting, config = store.setting, store.config
        records.append(config)
        for kind in ("driver", "simulator"):
            for difference in differences(kind, records[0].get(kind), config.get(kind))[:1]:
                raise CampaignError(
                    f"{folder} has other parts than {folders[0]}: {difference}; compare the"
                    " versions on each alone"
                )
        if setting in settings and not on_own_roads:
            raise CampaignError(
                f"{folders[settings.index(setting)]} and {folder} have the same roads and"
                " conditions: leave out one of them"
            )
        settings.append(setting)
        names.append(_roads_name(setting))
    return {
        name if names.count(name) == 1 else f"{name} ({folder})": folder
        for name, folder in zip(names, folders, strict=True)
    }


def _roads_name(terms: Terms) -> str:
    """Return the name of the domain or road class of terms."""
    if terms.domain is not None:
        return terms.domain.name
    return COMPETITION if terms.road_class is None else terms.road_class.name
