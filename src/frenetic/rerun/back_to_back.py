"""Compare two versions of a driver on the same roads: which is better, and what each does wrong.

Both drive on fresh random roads: the old version in a campaign of random search, the new version in
a rerun of that campaign. The verdict rests on these roads alone. The new version also drives the
known roads, on which the old version failed in its campaign. Their results are only shown: the
search chose these roads for failures of the old version, which therefore looks worse on them than
it is (regression to the mean). Where both versions pass, `BackToBack.quality` says which drives
better, also disturbed, see `frenetic.rerun.disturbances`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Unpack

from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted
from frenetic.analysis.failures import Failure
from frenetic.analysis.quality_comparison import BETTER, WORSE, QualityComparison
from frenetic.analysis.quality_differences import PairedQuality
from frenetic.analysis.quality_text import NO_DIFFERENCE
from frenetic.analysis.statistics import (
    SIGNIFICANT,
    ValueWithInterval,
    median_estimate,
    paired_share_difference,
)
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import as_text as conditions_text
from frenetic.conditions.domain import Domain
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.parts.records import comparison_key, innermost, short_version
from frenetic.parts.versions import FILES
from frenetic.rerun.campaigns import DrivingOptions
from frenetic.rerun.disturbances import (
    QualityPlan,
    disturbed_conditions,
)
from frenetic.rerun.old_version import DEFAULT_FRESH_ROADS, FreshRoads, fresh_roads
from frenetic.rerun.paired_roads import Pair, PairedRoads
from frenetic.rerun.quality import paired_quality, paired_tests
from frenetic.rerun.replay import DriveConditions
from frenetic.rerun.rerun import drive_tests
from frenetic.rerun.reruns import Rerun, read_rerun
from frenetic.segments.causes import as_text
from frenetic.simulators.simulator import Simulator
from frenetic.spec.part_text import part_text

MIN_SLOWDOWN: Final = 0.01
"""Relative increase of the median time from which on a version counts as slower; our choice."""
CANNOT_TELL: Final = "cannot tell"
"""Verdict if no road was judged, or if the drives in which the simulator broke decide."""
_HALVING_FACTOR: Final = 4
"""Factor on the number of roads that halves the interval, whose width goes with 1/sqrt(roads)."""


@dataclass(frozen=True)
class BackToBack:
    """Comparison of two versions of a driver that drove on the same roads."""

    old: Mapping[str, JSONValue]
    """Old version, as `frenetic.spec.part_record.describe` records it."""
    new: Mapping[str, JSONValue]
    """New version, as `frenetic.spec.part_record.describe` records it."""
    simulator: Mapping[str, JSONValue]
    """Simulator, as `frenetic.spec.part_record.describe` records it."""
    seed: int
    """Seed of the fresh roads."""
    fresh: PairedRoads
    """Fresh roads, on which the verdict rests."""
    known: PairedRoads
    """Roads on which the old version failed in its campaign."""
    domain: Domain | None = None
    """Domain of the roads and their conditions; None for the usual conditions."""
    missing: int = 0
    """Number of drives that Ctrl-C prevented."""
    quality: QualityComparison | None = None
    """How well both drive where both pass; None if drives are missing."""
    on_own_roads: bool = False
    """Whether `quality` is on the roads of the campaign, in place of the fresh roads."""
    classes: int = 1
    """Number of road classes on which both versions are compared, for which p and intervals are
    corrected."""

    @property
    def confidence(self) -> float:
        """Confidence of the interval of `difference`, corrected by Bonferroni for all classes."""
        return 1.0 - SIGNIFICANT / self.classes

    @cached_property
    def difference(self) -> ValueWithInterval | None:
        """Failure rate of the new version minus the old version's rate, -1..1.

        None if no fresh road was judged with both versions.
        """
        return _failure_difference(self.fresh.judged, self.confidence)

    @cached_property
    def time_difference(self) -> ValueWithInterval | None:
        """Median relative increase of the driving time from old to new, on fresh roads.

        Only roads that both versions passed count; None without such roads.
        """
        ratios = [
            new.result.duration / old.result.duration - 1.0
            for old, new in self.fresh.judged
            if old.outcome is new.outcome is Outcome.PASS
            and old.result.duration
            and new.result.duration is not None
        ]
        return median_estimate(ratios) if ratios else None

    @property
    def verdict(self) -> str:
        """Verdict in words: `BETTER` or `WORSE` if the interval of the difference excludes 0.

        The interval must exclude 0 on the same side, whether drives in which the simulator broke
        are left out or count as failures; if the two disagree, the verdict is "cannot tell".
        """
        with_errors = [
            pair
            for pair in self.fresh.pairs
            if all(test.outcome.is_driven or test.outcome is Outcome.ERROR for test in pair)
        ]
        differences = (self.difference, _failure_difference(with_errors, self.confidence))
        signs = {0 if difference is None else difference.sign for difference in differences}
        if len(signs) > 1 or self.difference is None:
            return CANNOT_TELL
        return {-1: BETTER, 0: NO_DIFFERENCE, 1: WORSE}[signs.pop()]

    @property
    def answer(self) -> str:
        """Verdict with its numbers, in one line."""
        if self.difference is None:
            return "cannot tell which is better: no fresh road was judged with both"
        old, new = self.fresh.failing
        rates = f"(difference {self.difference_text})"
        roads = f"of {counted(len(self.fresh.judged), 'fresh road')}"
        verdict = self.verdict
        if verdict not in (BETTER, WORSE):
            if verdict == CANNOT_TELL:
                verdict += " which is better, the drives in which the simulator broke decide"
            return f"{verdict}: {roads}, new fails on {new}, old on {old} {rates}"
        return f"{self.verdict_with_time}: {roads}, it fails on {new}, old on {old} {rates}"

    @property
    def difference_text(self) -> str:
        """Difference of the failure rates with its interval, in percentage points.

        The text is empty without a difference.
        """
        if self.difference is None:
            return ""
        value, interval = in_points(self.difference)
        return f"{value} points, {100.0 * self.confidence:.3g} % interval {interval}"

    @property
    def verdict_with_time(self) -> str:
        """Verdict, with how much slower the new version drives, if it is better or worse."""
        time, verdict = self.time_difference, self.verdict
        is_slower = time is not None and time.sign > 0 and time.value >= MIN_SLOWDOWN
        if time is None or not is_slower or verdict not in (BETTER, WORSE):
            return verdict
        word = "but" if verdict == BETTER else "and"
        return f"{verdict} {word} {100.0 * time.value:.0f} % slower"

    @property
    def overall(self) -> str:
        """Verdict on failures; if they show neither version to be better, the verdict on quality.

        Failures come first: a version that drives smoothly until it leaves its lane is not better.
        """
        if self.verdict in (BETTER, WORSE) or self.quality is None:
            return self.verdict
        quality = self.quality.verdict
        return self.verdict if quality == NO_DIFFERENCE else quality

    @property
    def sentences(self) -> tuple[str, ...]:
        """Answer and the sentence on quality; what shows a difference comes first."""
        if self.quality is None:
            return (self.answer,)
        has_failures_first = self.verdict in (BETTER, WORSE) or not self.quality.shown
        if has_failures_first:
            return self.answer, f"quality: {self.quality.sentence}"
        return self.quality.sentence, f"failures: {self.answer}"

    @cached_property
    def causes(self) -> Mapping[str, tuple[int, int]]:
        """Cause in words -> numbers of roads on which the old and the new version fail by it.

        All roads count; the most frequent cause comes first.
        """
        counts: tuple[Counter[str], ...] = Counter(), Counter()
        for pair in (*self.fresh.judged, *self.known.judged):
            for causes, test in zip(counts, pair, strict=True):
                if (failure := Failure.of_test(test)) is not None:
                    cause = failure.cause
                    text = "" if cause is None else as_text(cause.kind, None, cause.criterion)
                    causes[text or str(failure.fault)] += 1
        return paired_counts(*counts)

    @property
    def notes(self) -> tuple[str, ...]:
        """Limits of the answer, each in a sentence."""
        return tuple(self._notes())

    def _notes(self) -> Iterator[str]:
        """Yield each limit of the answer."""
        if self.on_own_roads:
            yield (
                "quality is compared on the campaign's own roads; if a search chose them, old looks"
                " worse on them than it is"
            )
        if self.known.pairs:
            yield (
                "the answer rests on the fresh roads; failing roads were found by searching against"
                " old, which looks worse on them than it is"
            )
        for i, version in enumerate(("old", "new")):
            pairs = (*self.fresh.pairs, *self.known.pairs)
            tests = [pair[i] for pair in pairs]
            reasons = Counter(test.reason for test in tests if test.outcome is Outcome.ERROR)
            for reason, _ in reasons.most_common(1):
                yield (
                    f"the simulator broke in {counted(reasons.total(), 'drive')} with {version},"
                    f" which count as neither passed nor failed, most often: {reason}"
                )
        if self.overall in (NO_DIFFERENCE, CANNOT_TELL) and self.fresh.judged:
            more = _HALVING_FACTOR * len(self.fresh.pairs)
            yield f"four times as many fresh roads, {more}, halve the interval"

    def as_json(self) -> dict[str, JSONValue]:
        """Return the comparison as a JSON object."""
        return {
            "answer": self.answer,
            "verdict": self.verdict,
            "notes": list(self.notes),
            "old": dict(self.old),
            "new": dict(self.new),
            "simulator": dict(self.simulator),
            "seed": self.seed,
            "domain": None if self.domain is None else self.domain.entries(),
            "difference": _interval_json(self.difference),
            "time_difference": _interval_json(self.time_difference),
            "fresh": self.fresh.as_json(),
            "known": self.known.as_json(),
            "causes": {cause: list(roads) for cause, roads in self.causes.items()},
            "overall": self.overall,
            "sentences": list(self.sentences),
            "quality": None if self.quality is None else self.quality.as_json(),
        }


def _failure_difference(pairs: Sequence[Pair], confidence: float) -> ValueWithInterval | None:
    """Return the difference of the failure rates, new minus old; None without pairs.

    Every outcome but PASS counts as a failure.
    """
    if not pairs:
        return None
    old, new = ([pair[i].outcome is not Outcome.PASS for pair in pairs] for i in range(2))
    return paired_share_difference(old, new, confidence=confidence)


def paired_counts(old: Counter[str], new: Counter[str]) -> dict[str, tuple[int, int]]:
    """Return cause -> counts of the old and the new version; the most frequent cause first."""
    names = sorted({*old, *new}, key=lambda name: (-max(old[name], new[name]), name))
    return {name: (old[name], new[name]) for name in names}


def in_points(difference: ValueWithInterval) -> tuple[str, str]:
    """Return a difference of shares and its interval in percentage points."""
    value, low, high = (_points(share) for share in asdict(difference).values())
    return value, f"{low} to {high}"


def _points(share: float) -> str:
    """Return a difference of shares in percentage points, with a sign unless it is 0."""
    text = f"{100.0 * share:+.1f}"
    return text[1:] if float(text) == 0.0 else text


def _interval_json(value: ValueWithInterval | None) -> dict[str, JSONValue] | None:
    """Return a value with its interval as a JSON object, with null for an infinite end."""
    if value is None:
        return None
    return {name: end if math.isfinite(end) else None for name, end in asdict(value).items()}


def compare_versions(
    roads: FreshRoads, tester: RoadTester, **options: Unpack[DrivingOptions]
) -> BackToBack:
    """Let a new version drive the roads that the old version has driven, and compare both.

    Args:
        roads: roads that the old version has driven.
        tester: drives with the new version on the campaign's terms.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: both versions are the same, or see
            `frenetic.rerun.campaigns.driving_campaign`.
    """
    new, simulator = tester.described["driver"], tester.described["simulator"]
    check_differ(roads.driver, new)
    with CampaignStore.open(roads.campaign) as store:
        domain = store.setting.domain
        failed = store.tests(Outcome.FAIL, with_repeats=False)
        failing = tuple(sorted(test.id for test in failed))
    drives = _NewDrives(roads, tester, options)
    paired_roads = [
        PairedRoads(folder, drives.again(folder, ids))
        for folder, ids in ((roads.folder, roads.tests), (roads.campaign, failing))
    ]
    fresh, known = paired_roads
    quality_pairs = fresh.pairs
    if roads.quality_plan.on_own_roads:
        quality_pairs = drives.again(*roads.quality_roads)
    disturbed = drives.all_disturbed()
    return BackToBack(
        *(roads.driver, new, simulator, roads.seed, fresh, known, domain),
        missing=drives.missing,
        on_own_roads=roads.quality_plan.on_own_roads,
        quality=None
        if drives.missing
        else QualityComparison.of([paired_quality(quality_pairs), *disturbed]),
    )


class _NewDrives:
    """Drives of the new version on roads that the old version has driven.

    After Ctrl-C, which leaves drives missing, nothing more is driven.
    """

    def __init__(self, roads: FreshRoads, tester: RoadTester, options: DrivingOptions) -> None:
        self._roads = roads
        self._tester = tester
        self._options = options
        self._quality_folder, self._quality_ids = roads.quality_roads
        self._disturbances = tuple(roads.quality_plan.disturbances or ())
        self._old = [read_rerun(folder, self._quality_folder) for folder in roads.disturbed]
        driven = len(roads.tests) + sum(len(rerun.drives) for rerun in self._old)
        planned = roads.count + roads.quality_count * len(self._disturbances)
        self.missing = planned - driven
        """Number of drives that Ctrl-C prevented."""

    def again(self, folder: Path, ids: Sequence[int]) -> tuple[Pair, ...]:
        """Return pairs of recorded drives and the new version's drives on the same roads."""
        planned = self._roads.count if folder == self._roads.folder else len(ids)
        rerun = self._drive(folder, ids, ({},), planned)
        repeats = () if rerun is None else rerun.tests
        return tuple(Pair(test.recorded, test.drives[0].test) for test in repeats)

    def all_disturbed(self) -> list[PairedQuality]:
        """Return the measures of both versions' drives in each disturbance."""
        folder, ids = self._quality_folder, self._quality_ids
        measured = []
        for i, disturbance in enumerate(self._disturbances):
            conditions = disturbed_conditions(folder, ids, disturbance)
            new = self._drive(folder, ids, conditions, self._roads.quality_count)
            pairs = paired_tests(self._old[i], new) if new is not None and ids else ()
            measured.append(paired_quality(pairs, conditions_text(disturbance)))
        return measured

    def _drive(
        self, folder: Path, ids: Sequence[int], conditions: DriveConditions, planned: int
    ) -> Rerun | None:
        """Return the drives on the roads of tests; None if earlier drives are missing.

        Args:
            folder: folder of the campaign that holds the roads.
            ids: ids of the tests.
            conditions: conditions of each drive, see `ReplayRoads`.
            planned: number of drives in all.
        """
        if self.missing:
            self.missing += planned
            return None
        rerun = drive_tests(folder, self._tester, ids, conditions, options=self._options)
        self.missing = planned - len(rerun.drives)
        return rerun


def check_differ(old: Mapping[str, JSONValue], new: Mapping[str, JSONValue]) -> None:
    """Refuse two equal versions.

    Args:
        old: old version, as `frenetic.spec.part_record.describe` records it.
        new: new version, in the same form.

    Raises:
        CampaignError: both versions are the same.
    """
    if comparison_key(old) == comparison_key(new):
        remedy = "edit its file, which the campaign keeps as it was, or give it other options"
        if FILES in short_version(innermost(old)):
            remedy = (
                "of programs and files of data the campaign keeps no copy, so give the new one"
                " another name, and name it with --driver"
            )
        raise CampaignError(f"both versions are the same, {part_text(old)}: {remedy}")


def back_to_back(
    campaign: Path | str,
    simulator: Simulator,
    old: Driver,
    new: Driver,
    *,
    fresh: int = DEFAULT_FRESH_ROADS,
    quality: QualityPlan | None = None,
    workers: int = 1,
) -> BackToBack:
    """Compare two versions of a driver on fresh random roads and on the old version's failures.

    Args:
        campaign: folder of the old version's campaign.
        simulator: any simulator, not yet entered.
        old: old version, which drove in the campaign.
        new: new version.
        fresh: number of random roads.
        quality: on which roads and in which disturbances both are compared where both pass; by
            default on the random roads, in the usual disturbances.
        workers: number of roads driven at once.

    Raises:
        CampaignError: both versions are the same, or see `fresh_roads`.
        ValueError: an option is out of range.
    """
    with CampaignStore.open(campaign) as store:
        terms = store.setting.terms
    testers = [RoadTester(simulator, driver, terms) for driver in (old, new)]
    check_differ(*(tester.described["driver"] for tester in testers))
    roads = fresh_roads(
        campaign,
        testers[0],
        fresh=fresh,
        quality_plan=(quality or QualityPlan()).resolved(testers[1]),
        workers=workers,
    )
    return compare_versions(roads, testers[1], workers=workers)
