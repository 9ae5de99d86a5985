"""Two versions of a driver on the same roads: which is better, and what each does wrong.

Both drive on fresh random roads: the old version in a campaign of random search, the new version in
a rerun of that campaign. The verdict rests on these roads. The new version also drives the roads on
which the old version's campaign failed. They are only shown: the search looked for failures of the
old version, so it looks worse on them than it is (regression to the mean).
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple, Unpack

from msgspec import structs

from frenetic._support.bounds import require_count
from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted, part_word
from frenetic.analysis.causes import in_words
from frenetic.analysis.failures import Failure
from frenetic.analysis.statistics import ValueWithInterval, median_estimate, paired_share_difference
from frenetic.campaign.configuration import with_budget
from frenetic.campaign.counts import Counts
from frenetic.campaign.record import Test
from frenetic.campaign.status import signed_spec
from frenetic.campaign.store import DATABASE, SOURCES, CampaignStore
from frenetic.campaign.summary import Event, EventKind, Progress, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.domain import Domain
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import DRIVERS, absolute_files, user_folders
from frenetic.parts.trust import NOT_DRIVING, REGISTRIES
from frenetic.parts.versions import comparison_key, sources_named
from frenetic.processes.interrupt import catch_interrupt
from frenetic.processes.worker import LostWorkerError, Worker, pack, ready, report
from frenetic.rerun.campaigns import (
    RerunOptions,
    RerunPlan,
    drive_missing,
    report_complete,
    rerun_campaign,
)
from frenetic.rerun.rerun import drive_tests
from frenetic.rerun.stability import Change
from frenetic.search import RandomSearch
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Budget, Spec
from frenetic.spec.part_record import part_text

FRESH: Final = 200
"""Default number of fresh roads."""
SLOWER: Final = 0.01
"""Least relative increase of the median time at which a version counts as slower; ours."""
BETTER: Final = "new is better"
WORSE: Final = "new is worse"
_POLL: Final = 0.2  # [s] between two checks whether Ctrl-C was pressed; ours


class Pair(NamedTuple):
    """Drives of both versions on one road."""

    old: Test
    new: Test

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

    @property
    def judged(self) -> list[Pair]:
        """Pairs of which both drives were judged."""
        return [pair for pair in self.pairs if pair.change is not Change.NOT_JUDGED]

    @property
    def changes(self) -> Counter[Change]:
        """Roads with each change."""
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
        """Failure rate of the new version minus the old one's, -1..1; None without pairs."""
        return _failure_difference(self.fresh.judged)

    @cached_property
    def time_difference(self) -> ValueWithInterval | None:
        """Median relative increase of the time from old to new, on roads that both passed."""
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
        """Verdict: better or worse if the whole interval of the difference lies on one side of 0.

        It must do so both without the simulator's errors and with these counted as failures.
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
        """Answer in one line."""
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
        if time is not None and time.sign > 0 and time.value >= SLOWER:
            word = "but" if verdict == BETTER else "and"
            verdict += f" {word} {100.0 * time.value:.0f} % slower"
        return f"{verdict}: {roads}, it fails on {new}, old on {old} {rates}"

    @cached_property
    def causes(self) -> dict[str, tuple[int, int]]:
        """Cause in words -> numbers of all roads on which old and new version fail by it."""
        counts: tuple[Counter[str], ...] = Counter(), Counter()
        for pair in (*self.fresh.judged, *self.known.judged):
            for causes, test in zip(counts, pair, strict=True):
                if (failure := Failure.of_test(test)) is not None:
                    cause = failure.cause
                    words = "" if cause is None else in_words(cause.kind, None, cause.criterion)
                    causes[words or str(failure.fault)] += 1
        old, new = counts
        names = sorted({*old, *new}, key=lambda name: (-max(old[name], new[name]), name))
        return {name: (old[name], new[name]) for name in names}

    @property
    def notes(self) -> tuple[str, ...]:
        """Limits of the answer, each in a sentence."""
        return tuple(self._notes())

    def _notes(self) -> Iterator[str]:
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
            more = 4 * len(self.fresh.pairs)
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
    """Return the difference of the failure rates, None without pairs; an error is a failure."""
    if not pairs:
        return None
    old, new = ([pair[i].outcome is not Outcome.PASS for pair in pairs] for i in range(2))
    return paired_share_difference(old, new)


def _points(share: float) -> str:
    """Return a difference of shares in percentage points, with a sign unless it is 0."""
    text = f"{100.0 * share:+.1f}"
    return text[1:] if float(text) == 0.0 else text


def _interval_json(value: ValueWithInterval | None) -> dict[str, JSONValue] | None:
    if value is None:
        return None
    return {name: end if math.isfinite(end) else None for name, end in asdict(value).items()}


# Driving


@dataclass(frozen=True)
class FreshRoads:
    """Fresh random roads that the old version has driven."""

    campaign: Path
    """Folder of the old version's campaign."""
    folder: Path
    """Folder of the campaign of random search that drove these roads."""
    count: int
    """Number of planned roads."""
    seed: int
    """Seed of the random search."""
    driver: Mapping[str, JSONValue]
    """Old version, as `frenetic.spec.part_record.describe` records it."""
    tests: tuple[int, ...]
    """Ids of the driven tests in `folder`; Ctrl-C leaves fewer than `count`."""


def fresh_roads(
    campaign: Path | str,
    tester: RoadTester,
    *,
    fresh: int = FRESH,
    strategy_name: str | None = "random",
    **options: Unpack[RerunOptions],
) -> FreshRoads:
    """Return fresh random roads that the old version has driven; missing drives are made.

    The seed is the least one that is not the campaign's.

    Args:
        campaign: folder of a campaign of the old version.
        tester: drives with the old version on the campaign's terms.
        fresh: number of roads.
        strategy_name: name of the strategy in the record; None leaves a record without a spec,
            which is not signed.
        options: see `RerunOptions`.

    Raises:
        CampaignError: the campaign does not exist, or see
            `frenetic.rerun.campaigns.rerun_campaign`.
        ValueError: an option is out of range.
    """
    require_count("fresh", fresh)
    with CampaignStore.open(campaign) as store:
        seed = _fresh_seed(store)
    terms, budget = tester.terms, Budget(simulations=fresh)
    strategy = RandomSearch(
        seed=seed, map_size=terms.map_size, road_class=terms.road_class, domain=terms.domain
    )
    if tester.spec is not None:
        tester = replace(tester, spec=with_budget(structs.replace(tester.spec, seed=seed), budget))
    plan = RerunPlan(
        strategy,
        budget,
        identity=["fresh", seed],
        purpose={"fresh": True},
        strategy_name=strategy_name,
    )
    driving, on_event = rerun_campaign(campaign, plan, tester, options), options.get("on_event")
    tests = _driven_tests(driving.folder)
    if len(tests) < fresh:
        drive_missing(driving, on_event)
    else:
        outcomes = Counter(test.outcome for test in tests[:fresh])
        report_complete(driving.folder, Counts.of(outcomes), on_event)
    driver = tester.described["driver"]
    return _read_fresh_roads(Path(campaign), driving.folder, fresh, seed, driver)


def recorded_driver(store: CampaignStore) -> Mapping[str, JSONValue]:
    """Return the driver of a campaign as the campaign records it."""
    driver = store.config["driver"]
    return driver if isinstance(driver, Mapping) else {}


def _fresh_seed(store: CampaignStore) -> int:
    """Return the least seed that is not a campaign's."""
    taken = store.config.get("seed")
    return next(number for number in count() if number != taken)


def _read_fresh_roads(
    campaign: Path, folder: Path, fresh: int, seed: int, driver: Mapping[str, JSONValue]
) -> FreshRoads:
    """Return the fresh roads in a folder that were driven, at most ``fresh`` of them."""
    ids = tuple(test.id for test in _driven_tests(folder)[:fresh])
    return FreshRoads(campaign, folder, fresh, seed, driver, ids)


def fresh_roads_as_recorded(
    campaign: Path | str,
    spec: Spec,
    *,
    fresh: int = FRESH,
    is_trusted: bool = False,
    **options: Unpack[RerunOptions],
) -> FreshRoads:
    """Return fresh random roads that a campaign's driver has driven, in its recorded version.

    A user's driver is made in a separate process, from the source that the campaign keeps if the
    file was edited since: two versions of one module never meet in one process.

    Args:
        campaign: folder of the campaign.
        spec: spec of the campaign.
        fresh: number of roads.
        is_trusted: whether the user trusts the campaign, with the sources that it keeps.
        options: see `RerunOptions`.

    Raises:
        CampaignError: the source was edited and the campaign keeps none, or see `fresh_roads`.
        FreneticError: the user has not trusted the code, see `frenetic.parts.trust`.
    """
    with as_recorded(campaign, spec, is_trusted=is_trusted) as old:
        recorded = old.spec
        if not DRIVERS.is_own(recorded.part("driver").name):
            return fresh_roads(campaign, old.tester(), fresh=fresh, **options)
        return _drive_in_process(old, fresh, options)


def _drive_in_process(old: OldVersion, fresh: int, options: RerunOptions) -> FreshRoads:
    """Let an old version drive fresh roads in a separate process, which Ctrl-C ends."""
    on_event = options.get("on_event") or (lambda _: None)
    with CampaignStore.open(old.campaign) as store:
        seed, driver = _fresh_seed(store), recorded_driver(store)
    now, folder = Summary(), old.campaign
    worker = Worker("the old version", pack(old), files=())

    def on_interrupt() -> None:
        on_event(Event("interrupted", now))

    with catch_interrupt(on_interrupt) as interrupt:
        try:
            worker.start()
            workers, isolate = options.get("workers", 1), options.get("isolate", False)
            worker.send(
                *("drive", fresh, workers, isolate),
                limit=math.inf,
                answer=str,
                report=tuple[EventKind, Progress],
            )
            while len(worker) and not interrupt.requested:
                for _ in ready([worker], _POLL):
                    for message in filter(None, worker.receive()):
                        if isinstance(message, str):
                            folder = Path(message)
                            continue
                        kind, progress = message
                        now = progress.summary()
                        folder = now.folder
                        on_event(Event(kind, now))
        except LostWorkerError as error:
            raise CampaignError(f"the old version did not drive: {error}") from None
        finally:
            worker.kill()
    return _read_fresh_roads(old.campaign, folder, fresh, seed, driver)


@dataclass(frozen=True)
class OldVersion:
    """Recorded version of a campaign's driver, which a process makes and lets drive."""

    campaign: Path
    """Folder of the campaign."""
    spec: Spec
    """Spec of the campaign, whose parts lie in `sources` if that is set."""
    code_folder: Path
    """Folder from which the campaign's code is loaded."""
    sources: Path | None
    """Temporary folder with the recorded sources; None if the code was not edited."""
    others: frozenset[str] = field(default_factory=user_folders)
    """Folders of other versions' modules, which the process must not search."""

    def start(self) -> None:
        """Put the recorded sources before all other folders of `sys.path`."""
        path = [folder for folder in sys.path if folder not in self.others]
        sys.path[:] = path if self.sources is None else [str(self.sources), *path]

    def tester(self) -> RoadTester:
        """Return a tester with the old version on the campaign's terms, without warnings."""
        with CampaignStore.open(self.campaign) as store, chdir(self.sources or self.code_folder):
            return RoadTester.of(self.spec, store.setting.terms)

    def drive(self, fresh: int, workers: int, isolate: bool) -> str:
        """Drive fresh roads and report events; return the folder of the campaign that drove."""

        def on_event(event: Event) -> None:
            report((event.kind, Progress.of_summary(event.summary)))

        # A signature would outlive sources in a temporary folder, so these get none.
        roads = fresh_roads(
            self.campaign,
            self.tester(),
            fresh=fresh,
            strategy_name="random" if self.sources is None else None,
            workers=workers,
            isolate=isolate,
            on_event=on_event,
        )
        return str(roads.folder)

    def close(self) -> None:
        """Do nothing: an old version holds nothing open."""


def _driven_tests(folder: Path) -> list[Test]:
    """Return the driven tests of a campaign by their ids; an empty list without a campaign."""
    if not (folder / DATABASE).exists():
        return []
    with CampaignStore.open(folder) as store:
        driven = [test for test in store.tests() if test.outcome.is_simulated]
        return sorted(driven, key=lambda test: test.id)


def compare_versions(
    roads: FreshRoads, tester: RoadTester, **options: Unpack[RerunOptions]
) -> BackToBack:
    """Let a new version drive the roads that the old version drove, and compare both.

    Args:
        roads: roads that the old version has driven.
        tester: drives with the new version on the campaign's terms.
        options: see `RerunOptions`.

    Raises:
        CampaignError: both versions are the same, or see
            `frenetic.rerun.campaigns.rerun_campaign`.
    """
    new, simulator = tester.described["driver"], tester.described["simulator"]
    check_differ(roads.driver, new)
    with CampaignStore.open(roads.campaign) as store:
        domain = store.setting.domain
        failed = store.tests(Outcome.FAIL, with_repeats=False)
        failing = tuple(sorted(test.id for test in failed))
    missing = roads.count - len(roads.tests)
    sets: list[PairedRoads] = []
    for folder, ids in ((roads.folder, roads.tests), (roads.campaign, failing)):
        repeats = () if missing else drive_tests(folder, tester, ids, options=options).tests
        pairs = tuple(Pair(test.recorded, test.drives[0].test) for test in repeats)
        sets.append(PairedRoads(folder, pairs))
        missing += len(ids) - len(repeats)
    fresh, known = sets
    return BackToBack(roads.driver, new, simulator, roads.seed, fresh, known, domain, missing)


def check_differ(old: Mapping[str, JSONValue], new: Mapping[str, JSONValue]) -> None:
    """Refuse two equal versions, in the form of `frenetic.spec.part_record.describe`.

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
    fresh: int = FRESH,
    workers: int = 1,
) -> BackToBack:
    """Compare two versions of a driver on fresh random roads and on the old version's failures.

    Args:
        campaign: folder of the old version's campaign.
        simulator: any simulator, not yet entered.
        old: the old version, which drove in the campaign.
        new: the new version.
        fresh: number of random roads.
        workers: roads driven at once.

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


@contextmanager
def as_recorded(
    folder: Path | str, spec: Spec, *, is_trusted: bool = False
) -> Iterator[OldVersion]:
    """Yield a campaign's driver in its recorded version.

    If the source was edited since, the one that the campaign keeps lies in a temporary folder
    until the context ends.

    Args:
        folder: folder of the campaign.
        spec: spec of the campaign.
        is_trusted: whether the user trusts the campaign, with the sources that it keeps.

    Raises:
        CampaignError: the source was edited, and the campaign keeps none.
        FreneticError: the user has not trusted the code, see `frenetic.parts.trust`.
    """
    with CampaignStore.open(folder) as store:
        sources: Any = store.fact(SOURCES)
        driving = {kind: part for kind, part in spec.parts.items() if kind not in NOT_DRIVING}
        code_folder = signed_spec(store).require_trusted(
            folder, made=driving, sources=sources, is_trusted=is_trusted, optional=()
        )
    sources = sources if isinstance(sources, Mapping) else {}
    driver = spec.part("driver")
    with chdir(code_folder):
        present = sources_named(driver.name)
    is_edited = not sources.items() >= present.items() or bool(sources and not present)
    if not (is_edited and DRIVERS.is_own(driver.name)):
        yield OldVersion(Path(folder), spec, code_folder, None)
        return
    if not sources:
        raise CampaignError(
            f"{folder} keeps no source of its driver {driver.name!r}: bring the old version"
            " back first"
        )
    with TemporaryDirectory() as text:
        temporary = Path(text).resolve()
        for file, source in sources.items():
            target = (temporary / file).resolve()
            if not target.is_relative_to(temporary):
                raise CampaignError(f"{folder} is damaged: it keeps the source of {file!r}")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(str(source), encoding="utf-8", newline="\n")
        restored = _with_sources_in(temporary, spec, code_folder)
        yield OldVersion(Path(folder), restored, code_folder, temporary)


def _with_sources_in(sources: Path, spec: Spec, code_folder: Path) -> Spec:
    """Return a spec that loads a user's driver and simulator from recorded sources.

    Args:
        sources: folder with the recorded sources, by the names in the campaign.
        spec: spec of the campaign.
        code_folder: folder to which the other paths of the parts are relative.
    """
    words = {}
    for kind in ("driver", "simulator"):
        (name, options), registry = spec.part(kind), REGISTRIES[kind]
        module, _, attribute = name.rpartition(":")
        if not (module and registry.is_own(name)):
            words[kind] = part_word(*registry.absolute(name, options, code_folder))
            continue
        if module.endswith(".py"):
            name = f"{sources / Path(module).name}:{attribute}"
        words[kind] = part_word(name, absolute_files(options, code_folder))
    return structs.replace(spec, **words)
