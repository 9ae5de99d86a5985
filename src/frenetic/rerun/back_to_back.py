"""Compare two versions of a driver on the same roads: which is better, and what each does wrong.

Both drive on fresh random roads: the old version in a campaign of random search, the new version in
a rerun of that campaign. The verdict rests on these roads alone. The new version also drives the
known roads, on which the old version failed in its campaign. Their results are only shown: the
search chose these roads for failures of the old version, which therefore looks worse on them than
it is (regression to the mean).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple, Unpack

from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted
from frenetic.analysis.failures import Failure
from frenetic.analysis.statistics import ValueWithInterval, median_estimate, paired_share_difference
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.domain import Domain
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.parts.records import comparison_key
from frenetic.rerun.campaigns import DrivingOptions
from frenetic.rerun.old_version import DEFAULT_FRESH_ROADS, FreshRoads, fresh_roads
from frenetic.rerun.rerun import drive_tests
from frenetic.rerun.stability import Change
from frenetic.segments.causes import as_text
from frenetic.simulators.simulator import Simulator
from frenetic.spec.part_text import part_text

MIN_SLOWDOWN: Final = 0.01
"""Relative increase of the median time from which on a version counts as slower; our choice."""
BETTER: Final = "new is better"
"""Verdict on a new version that fails less often."""
WORSE: Final = "new is worse"
"""Verdict on a new version that fails more often."""
_HALVING_FACTOR: Final = 4
"""Factor on the number of roads that halves the interval, whose width goes with 1/sqrt(roads)."""


class Pair(NamedTuple):
    """Drives of both versions on one road."""

    old: Test
    """Drive of the old version."""
    new: Test
    """Drive of the new version."""

    @property
    def change(self) -> Change:
        """Change of the outcome from the old version to the new one."""
        if not (self.old.outcome.is_driven and self.new.outcome.is_driven):
            return Change.NOT_JUDGED
        return Change.of(*(test.outcome is Outcome.FAIL for test in self))


@dataclass(frozen=True)
class PairedRoads:
    """Drives of both versions on several roads."""

    folder: Path
    """Folder of the campaign that holds the roads, and the old version's drives."""
    pairs: tuple[Pair, ...]
    """Drives on each road."""

    @property
    def judged(self) -> list[Pair]:
        """Pairs whose two drives were both judged."""
        return [pair for pair in self.pairs if pair.change is not Change.NOT_JUDGED]

    @property
    def changes(self) -> Counter[Change]:
        """Number of roads with each change."""
        return Counter(pair.change for pair in self.pairs)

    @property
    def failing(self) -> tuple[int, int]:
        """Numbers of judged roads on which the old and the new version fail."""
        old, new = (sum(pair[i].outcome is Outcome.FAIL for pair in self.judged) for i in range(2))
        return old, new

    def as_json(self) -> dict[str, JSONValue]:
        """Return the counts as a JSON object."""
        old, new = self.failing
        return {
            "campaign": str(self.folder),
            "judged": len(self.judged),
            "failing": {"old": old, "new": new},
            "changes": {str(change): self.changes[change] for change in Change},
        }


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

    @cached_property
    def difference(self) -> ValueWithInterval | None:
        """Failure rate of the new version minus the old version's rate, -1..1.

        None if no fresh road was judged with both versions.
        """
        return _failure_difference(self.fresh.judged)

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
        differences = (self.difference, _failure_difference(with_errors))
        signs = {0 if difference is None else difference.sign for difference in differences}
        if len(signs) > 1 or self.difference is None:
            return "cannot tell"
        return {-1: BETTER, 0: "no difference shown", 1: WORSE}[signs.pop()]

    @property
    def answer(self) -> str:
        """Verdict with its numbers, in one line."""
        difference, verdict = self.difference, self.verdict
        if difference is None:
            return "cannot tell which is better: no fresh road was judged with both"
        old, new = self.fresh.failing
        value, low, high = (_points(share) for share in asdict(difference).values())
        rates = f"(difference {value} points, 95 % interval {low} to {high})"
        roads = f"of {counted(len(self.fresh.judged), 'fresh road')}"
        if verdict not in (BETTER, WORSE):
            if verdict == "cannot tell":
                verdict += " which is better, the drives in which the simulator broke decide"
            return f"{verdict}: {roads}, new fails on {new}, old on {old} {rates}"
        time = self.time_difference
        if time is not None and time.sign > 0 and time.value >= MIN_SLOWDOWN:
            word = "but" if verdict == BETTER else "and"
            verdict += f" {word} {100.0 * time.value:.0f} % slower"
        return f"{verdict}: {roads}, it fails on {new}, old on {old} {rates}"

    @cached_property
    def causes(self) -> dict[str, tuple[int, int]]:
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
        old, new = counts
        names = sorted({*old, *new}, key=lambda name: (-max(old[name], new[name]), name))
        return {name: (old[name], new[name]) for name in names}

    @property
    def notes(self) -> tuple[str, ...]:
        """Limits of the answer, each in a sentence."""
        return tuple(self._notes())

    def _notes(self) -> Iterator[str]:
        """Yield each limit of the answer."""
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
        if self.verdict not in (BETTER, WORSE) and self.fresh.judged:
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
        }


def _failure_difference(pairs: Sequence[Pair]) -> ValueWithInterval | None:
    """Return the difference of the failure rates, new minus old; None without pairs.

    Every outcome but PASS counts as a failure.
    """
    if not pairs:
        return None
    old, new = ([pair[i].outcome is not Outcome.PASS for pair in pairs] for i in range(2))
    return paired_share_difference(old, new)


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
    missing = roads.count - len(roads.tests)
    paired_roads: list[PairedRoads] = []
    for folder, ids in ((roads.folder, roads.tests), (roads.campaign, failing)):
        # After Ctrl-C, which leaves drives missing, nothing more is driven.
        repeats = () if missing else drive_tests(folder, tester, ids, options=options).tests
        pairs = tuple(Pair(test.recorded, test.drives[0].test) for test in repeats)
        paired_roads.append(PairedRoads(folder, pairs))
        missing += len(ids) - len(repeats)
    fresh, known = paired_roads
    return BackToBack(roads.driver, new, simulator, roads.seed, fresh, known, domain, missing)


def check_differ(old: Mapping[str, JSONValue], new: Mapping[str, JSONValue]) -> None:
    """Refuse two equal versions.

    Args:
        old: old version, as `frenetic.spec.part_record.describe` records it.
        new: new version, in the same form.

    Raises:
        CampaignError: both versions are the same.
    """
    if comparison_key(old) == comparison_key(new):
        raise CampaignError(
            f"both versions are the same, {part_text(old)}: edit its file, which the campaign keeps"
            " as it was, or give it other options"
        )


def back_to_back(
    campaign: Path | str,
    simulator: Simulator,
    old: Driver,
    new: Driver,
    *,
    fresh: int = DEFAULT_FRESH_ROADS,
    workers: int = 1,
) -> BackToBack:
    """Compare two versions of a driver on fresh random roads and on the old version's failures.

    Args:
        campaign: folder of the old version's campaign.
        simulator: any simulator, not yet entered.
        old: old version, which drove in the campaign.
        new: new version.
        fresh: number of random roads.
        workers: number of roads driven at once.

    Raises:
        CampaignError: both versions are the same, or see `fresh_roads`.
        ValueError: an option is out of range.
    """
    with CampaignStore.open(campaign) as store:
        terms = store.setting.terms
    testers = [RoadTester(simulator, driver, terms) for driver in (old, new)]
    check_differ(*(tester.described["driver"] for tester in testers))
    roads = fresh_roads(campaign, testers[0], fresh=fresh, workers=workers)
    return compare_versions(roads, testers[1], workers=workers)
