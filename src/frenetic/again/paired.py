"""Paired drives: two versions of a driver on the same roads, and what the pairs show.

The verdict rests on the fresh roads alone. Failing roads were found by searching against the old
version, so it looks worse on them than it is (regression to the mean).
They show which problems are fixed and which are new.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Final

from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted, simulated_time
from frenetic.again.verdicts import LEVEL, Change, Repeat, failing_share
from frenetic.analysis.causes import in_words
from frenetic.analysis.failures import COMPARED, Failure, cluster_failures
from frenetic.analysis.statistics import Estimate, median_estimate, paired_share_difference
from frenetic.campaign.record import Test
from frenetic.domain import Domain
from frenetic.oracle import Side
from frenetic.outcome import Outcome

SLOWER: Final = 0.01
"""Least share of the time by which a version counts as slower."""


class Version(StrEnum):
    """A version of a driver."""

    OLD = "old"
    NEW = "new"


class RoadSet(StrEnum):
    """Roads on which both versions drive."""

    FRESH = "fresh roads"
    """Random roads that no search has chosen."""
    OLD = "old's failing roads"
    """Those on which the old version failed in its campaign."""
    SHARED = "shared random roads"
    """Random roads that two campaigns drove, each with its version."""


class Fate(StrEnum):
    """Fate of a distinct failure."""

    FIXED = "fixed"
    """Only the old version fails so, and the new one passes all these roads."""
    CHANGED = "changed"
    """Only one version fails so, where the other fails otherwise: on some of the old one's roads,
    on all of the new one's."""
    REMAINS = "remaining"
    NEW = "new"
    """Only the new version fails so, and the old one passes one of these roads or more."""


class Verdict(StrEnum):
    """Verdict on the new version."""

    BETTER = "new is better"
    WORSE = "new is worse"
    LEVEL = "no difference shown"
    """The interval of the difference holds 0."""
    UNKNOWN = "cannot tell"
    """No fresh road was judged, or broken drives decide."""


@dataclass(frozen=True)
class Pair:
    """A road with the drives of both versions, one or more each."""

    record: Test
    """The test of the campaign that holds the road."""
    old: tuple[Repeat, ...]
    new: tuple[Repeat, ...]

    def drives(self, version: Version) -> tuple[Repeat, ...]:
        """The drives of a version."""
        return self.old if version is Version.OLD else self.new

    @property
    def is_judged(self) -> bool:
        """Whether each version has a drive that was judged."""
        return all(any(one.outcome.is_driven for one in own) for own in (self.old, self.new))

    @property
    def change(self) -> Change:
        """Change from the old version to the new: a version fails if half of its drives do."""
        if not self.is_judged:
            return Change.NOT_JUDGED
        return Change.of(failing_share(self.old) >= LEVEL, failing_share(self.new) >= LEVEL)


@dataclass(frozen=True)
class PairedRoads:
    """The pairs of a set of roads."""

    roads: RoadSet
    folder: Path
    """Folder of the campaign that holds them."""
    pairs: tuple[Pair, ...]
    repeats: int
    """Number of drives of each version on each road."""

    @cached_property
    def judged(self) -> tuple[Pair, ...]:
        """Pairs of which both sides were judged."""
        return tuple(pair for pair in self.pairs if pair.is_judged)

    def count(self, change: Change) -> int:
        """Roads with this change."""
        return sum(pair.change is change for pair in self.pairs)

    def failing(self, version: Version) -> int:
        """Judged roads on which a version fails in half of its drives or more."""
        return sum(failing_share(pair.drives(version)) >= LEVEL for pair in self.judged)

    def failure_rate(self, version: Version) -> float | None:
        """Mean failing share 0..1 of a version; None if no road was judged."""
        shares = [failing_share(pair.drives(version)) for pair in self.judged]
        return sum(shares) / len(shares) if shares else None

    def broken(self, version: Version) -> list[Repeat]:
        """Drives of a version that broke."""
        return [
            drive
            for pair in self.pairs
            for drive in pair.drives(version)
            if drive.outcome is Outcome.ERROR
        ]

    @cached_property
    def difference(self) -> Estimate | None:
        """Failure rate of the new version minus that of the old, -1..1; None without pairs."""
        return self._difference(self.judged)

    @cached_property
    def difference_with_broken(self) -> Estimate | None:
        """The same with every broken drive counted as a failure."""
        pairs = [
            pair
            for pair in self.pairs
            if all(
                any(one.outcome.is_driven or one.outcome is Outcome.ERROR for one in own)
                for own in (pair.old, pair.new)
            )
        ]
        return self._difference(pairs, broken_fail=True)

    def _difference(self, pairs: Sequence[Pair], *, broken_fail: bool = False) -> Estimate | None:
        if not pairs:
            return None
        old, new = (
            [failing_share(pair.drives(version), broken_fail=broken_fail) for pair in pairs]
            for version in Version
        )
        return paired_share_difference(old, new, repeats=self.repeats)

    @cached_property
    def both_passed(self) -> tuple[tuple[float, float], ...]:
        """Mean simulated times (old, new) in s on the roads that both always passed."""
        return tuple(
            (old, new)
            for pair in self.judged
            if all(one.outcome is Outcome.PASS for one in (*pair.old, *pair.new))
            and (old := _mean(pair.old, "duration")) is not None
            and (new := _mean(pair.new, "duration")) is not None
        )

    @property
    def mean_times(self) -> tuple[float, float] | None:
        """Means of these times (old, new) in s; None without such roads."""
        if not self.both_passed:
            return None
        old, new = (sum(times) / len(times) for times in zip(*self.both_passed, strict=True))
        return old, new

    @cached_property
    def time_difference(self) -> Estimate | None:
        """Median of the new version's time over the old one's, minus 1, where both passed."""
        ratios = [new / old - 1.0 for old, new in self.both_passed if old > 0.0]
        return median_estimate(ratios) if ratios else None

    @property
    def verdict(self) -> Verdict:
        """Verdict by these roads: the interval of the difference lies on one side of 0.

        It has to do so whether broken drives are left out or count as failures.
        """
        signs = {
            0 if difference is None else difference.sign
            for difference in (self.difference, self.difference_with_broken)
        }
        if len(signs) > 1 or self.difference is None:
            return Verdict.UNKNOWN
        return {-1: Verdict.BETTER, 0: Verdict.LEVEL, 1: Verdict.WORSE}[signs.pop()]


def _mean(drives: Iterable[Repeat], name: str) -> float | None:
    values = [value for one in drives if (value := getattr(one, name)) is not None]
    return sum(values) / len(values) if values else None


# Distinct failures


@dataclass(frozen=True)
class DistinctFailure:
    """A problem: failures of either version, on any of the roads, that are alike."""

    description: str
    cause: str
    """What the driver does wrong, or its fault; in bends to either side."""
    side: Side | None
    """The side of the lane on which the car left; None if it failed without leaving."""
    moobd: float
    """Lowest MOOBD, in m."""
    old: int
    """Number of roads on which the old version fails so."""
    new: int
    folder: Path
    """Folder of the campaign with the road of the most severe failure."""
    test_id: int
    """Test of that road."""
    conditions: Mapping[str, float]
    """Its conditions."""
    otherwise: int
    """Number of the old version's roads on which the new one fails, so or otherwise."""
    passed_before: int
    """Number of the new version's roads that the old one passes."""

    @property
    def fate(self) -> Fate:
        """Whether it is fixed, changed, remaining or new."""
        if self.new == 0:
            return Fate.CHANGED if self.otherwise else Fate.FIXED
        if self.old:
            return Fate.REMAINS
        return Fate.NEW if self.passed_before else Fate.CHANGED


def distinct_failures(sets: Iterable[PairedRoads]) -> tuple[DistinctFailure, ...]:
    """The distinct failures of both versions, the most severe first, by `cluster_failures`.

    Of each version the first failing drive on a road counts, if both were judged there. Only the
    most severe failures are compared if there are very many.
    """
    found: list[tuple[Version, PairedRoads, Pair, Repeat]] = []
    for roads in sets:
        for pair in roads.judged:
            for version in Version:
                failing = (
                    one
                    for one in pair.drives(version)
                    if one.outcome is Outcome.FAIL
                    and (one.test.trajectory is not None or one.test.result.fault is not None)
                )
                found += [(version, roads, pair, one) for one in islice(failing, 1)]
    found.sort(key=lambda one: one[-1].moobd or 0.0)
    del found[COMPARED:]
    clusters = cluster_failures(_failure(i, drive) for i, (*_, drive) in enumerate(found))
    distinct = []
    for cluster in clusters:
        old, new = (
            [found[i] for i in cluster.ids if found[i][0] is version] for version in Version
        )
        passed = [one for one in new if failing_share(one[2].old) == 0.0]
        # Of a new one such a road is shown, the most severe first.
        _, roads, _, worst = passed[0] if passed and not old else found[cluster.most_severe]
        distinct.append(
            DistinctFailure(
                cluster.description,
                str(cluster.fault) if cluster.cause is None else in_words(cluster.cause.kind),
                cluster.side,
                cluster.moobd,
                len(old),
                len(new),
                roads.folder,
                worst.test_id,
                worst.conditions,
                sum(failing_share(pair.new) > 0.0 for _, _, pair, _ in old),
                len(passed),
            )
        )
    return tuple(distinct)


def _failure(number: int, repeat: Repeat) -> Failure:
    failure = Failure.of_test(repeat.test)
    assert failure is not None
    return replace(failure, id=number)


# The whole


@dataclass(frozen=True)
class BackToBack:
    """Two versions of a driver, driven on the same roads."""

    old: Mapping[str, JSONValue]
    """Driver as a campaign describes it."""
    new: Mapping[str, JSONValue]
    simulator: Mapping[str, JSONValue]
    seed: int
    """Seed of the fresh roads."""
    sets: tuple[PairedRoads, ...]
    """The fresh roads first."""
    domain: Domain | None = None
    """Domain of the roads and their conditions; None for the usual conditions."""

    @property
    def fresh(self) -> PairedRoads:
        """The fresh roads, on which the verdict rests."""
        return self.sets[0]

    @property
    def verdict(self) -> Verdict:
        """Verdict by the fresh roads."""
        return self.fresh.verdict

    @cached_property
    def distinct(self) -> tuple[DistinctFailure, ...]:
        """The distinct failures of both versions on all roads."""
        return distinct_failures(self.sets)

    @property
    def causes(self) -> dict[str, tuple[int, int]]:
        """What the drivers do wrong -> on how many roads the old and the new version do."""
        found: dict[str, tuple[int, int]] = {}
        for one in self.distinct:
            old, new = found.get(one.cause, (0, 0))
            found[one.cause] = old + one.old, new + one.new
        return dict(sorted(found.items(), key=lambda item: -max(item[1])))

    @property
    def is_slower(self) -> bool:
        """Whether the new version takes longer where both pass, by 1 % or more."""
        time = self.fresh.time_difference
        return time is not None and time.sign > 0 and time.value >= SLOWER

    @property
    def answer(self) -> str:
        """The answer in one line."""
        fresh, verdict = self.fresh, self.verdict
        difference, n = fresh.difference, len(fresh.judged)
        kind = fresh.roads.removesuffix("s")
        if difference is None:
            return f"cannot tell which is better: no {kind} was judged with both"
        rates = (
            f"(difference {_points(difference.value)} points, 95 % interval"
            f" {_points(difference.low)} to {_points(difference.high)})"
        )
        roads = counted(n, kind)
        if fresh.repeats > 1:
            roads += f", {fresh.repeats} drives each"
            old, new = (f"in {_percent(fresh.failure_rate(version))}" for version in Version)
        else:
            old, new = (f"on {fresh.failing(version)}" for version in Version)
        if verdict in (Verdict.BETTER, Verdict.WORSE):
            return f"{verdict}{_slower_by(self)}: of {roads}, it fails {new}, old {old} {rates}"
        counts = f"of {roads}, new fails {new}, old {old} {rates}"
        passing, failing = (
            sum(own.count(change) for own in self.sets)
            for change in (Change.PASSES_NOW, Change.FAILS_NOW)
        )
        every = counted(sum(len(own.judged) for own in self.sets), "road")
        changes = f"of all {every}, {passing} pass now and {failing} fail now"
        if verdict is Verdict.UNKNOWN:
            return f"cannot tell which is better, drives that broke decide: {counts}; {changes}"
        return f"{verdict}: {counts}; {changes}"

    @property
    def time_in_words(self) -> str:
        """Difference in time on the fresh roads, in a sentence; empty without any."""
        found, times = self.fresh.time_difference, self.fresh.mean_times
        if found is None or times is None:
            return ""
        old, new = times
        low, value, high = (f"{100.0 * end:+.1f}" for end in (found.low, found.value, found.high))
        if math.isinf(found.low):
            shown = f"too few roads to tell (median {value} %)"
        else:
            shown = f"{value} % with new (median, 95 % interval {low} to {high} %)"
        return f"time where both pass: {shown}, on average {new:.1f} s instead of {old:.1f} s"

    @property
    def notes(self) -> tuple[str, ...]:
        """Limits of the answer, each in a sentence."""
        return tuple(self._notes())

    def _notes(self) -> Iterator[str]:
        fresh = self.fresh
        if any(roads.pairs for roads in self.sets[1:]):
            yield (
                "the answer rests on the fresh roads; failing roads were found by searching against"
                " old, which looks worse on them than it is"
            )
        for version in Version:
            broken = [drive for roads in self.sets for drive in roads.broken(version)]
            if broken:
                (reason, _), *_ = Counter(drive.reason for drive in broken).most_common(1)
                yield (
                    f"{version} broke in {counted(len(broken), 'drive')}, which count as neither"
                    f" passed nor failed, most often: {reason}"
                )
        for own in self.sets:
            passed = len(own.judged) - own.failing(Version.OLD)
            if own.roads is RoadSet.OLD and passed:
                yield (
                    f"old passes {passed} of the {len(own.judged)} roads on which its campaign"
                    " failed: its drives do not repeat (more repeats tell), or it has changed since"
                )
        if self.verdict not in (Verdict.BETTER, Verdict.WORSE) and fresh.judged:
            more = 4 * len(fresh.pairs)
            yield f"four times as many fresh roads, {more}, halve the interval"


def _slower_by(result: BackToBack) -> str:
    time = result.fresh.time_difference
    if time is None or not result.is_slower:
        return ""
    word = "but" if result.verdict is Verdict.BETTER else "and"
    return f" {word} {time.value:.0%} slower".replace("%", " %")


def _points(share: float) -> str:
    """A difference of shares in percentage points, with its sign but for 0."""
    text = f"{100.0 * share:+.1f}"
    return text[1:] if float(text) == 0.0 else text


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f} %"


def back_to_back_document(result: BackToBack) -> dict[str, JSONValue]:
    """A result as a JSON object."""
    return {
        "answer": result.answer,
        "verdict": str(result.verdict),
        "notes": list(result.notes),
        "old": dict(result.old),
        "new": dict(result.new),
        "simulator": dict(result.simulator),
        "seed": result.seed,
        "repeats": result.fresh.repeats,
        "domain": None if result.domain is None else result.domain.entries(),
        "sets": [_set_document(roads) for roads in result.sets],
        "causes": {cause: list(roads) for cause, roads in result.causes.items()},
        "distinct_failures": [
            {
                "fate": str(one.fate),
                "description": one.description,
                "side": one.side,
                "moobd": one.moobd,
                "old": one.old,
                "new": one.new,
                "campaign": str(one.folder),
                "test_id": one.test_id,
                "conditions": dict(one.conditions),
            }
            for one in result.distinct
        ],
    }


def _set_document(roads: PairedRoads) -> dict[str, JSONValue]:
    def estimate(value: Estimate | None) -> dict[str, JSONValue] | None:
        if value is None:
            return None
        known = {name: None if math.isinf(v) else v for name, v in asdict(value).items()}
        return {**known, "cannot_tell": value.sign == 0}

    old_time, new_time = roads.mean_times or (None, None)
    return {
        "roads": str(roads.roads),
        "campaign": str(roads.folder),
        "judged": len(roads.judged),
        "changes": {str(change): roads.count(change) for change in Change},
        "failing": {str(version): roads.failing(version) for version in Version},
        "failure_rate": {str(version): roads.failure_rate(version) for version in Version},
        "broken": {str(version): len(roads.broken(version)) for version in Version},
        "difference": estimate(roads.difference),
        "difference_with_broken": estimate(roads.difference_with_broken),
        "both_passed": len(roads.both_passed),
        "time": {
            "old": old_time,
            "new": new_time,
            "relative_difference": estimate(roads.time_difference),
        },
        "tests": [
            {
                "test_id": pair.record.id,
                "conditions": dict(pair.record.candidate.conditions),
                "change": str(pair.change),
                **{
                    str(version): [
                        {
                            "outcome": str(drive.outcome),
                            "moobd": drive.moobd,
                            "duration": simulated_time(drive.duration),
                            "reason": drive.reason,
                        }
                        for drive in pair.drives(version)
                    ]
                    for version in Version
                },
            }
            for pair in roads.pairs
        ],
    }
