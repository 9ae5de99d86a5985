"""Two versions of a driver on the same roads: which is better, and what each does wrong.

Both drive on fresh random roads, on which the verdict rests: a campaign of random search with the
old version, in the folder ``again`` of its campaign, and a rerun of it with the new one. The roads
on which the old version failed, which the new one drives, too, are shown beside: they were found by
searching against the old version, so it looks worse on them than it is (regression to the mean).
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
from frenetic.analysis.statistics import Estimate, median_estimate, paired_share_difference
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.campaign.reader import SOURCES
from frenetic.campaign.record import Test
from frenetic.campaign.status import signed_spec
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event, EventKind, Progress, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.domain import Domain
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import DRIVERS, absolute_files
from frenetic.parts.trust import NOT_DRIVING, REGISTRIES
from frenetic.parts.user_modules import user_folders
from frenetic.parts.versions import comparison_key, sources_named
from frenetic.processes.interrupt import catch_interrupt
from frenetic.processes.object_host import report
from frenetic.processes.object_process import LostWorkerError, ObjectProcess, pack, ready
from frenetic.rerun.campaigns import How, campaign_again, complete, say_complete
from frenetic.rerun.rerun import drive_tests
from frenetic.rerun.stability import Change
from frenetic.search import RandomSearch
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Budget, Spec
from frenetic.spec.part_record import part_text

FRESH: Final = 200
"""Default number of fresh roads."""
SLOWER: Final = 0.01
"""Least share of the time by which a version counts as slower."""
BETTER: Final = "new is better"
WORSE: Final = "new is worse"
_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed


class Pair(NamedTuple):
    """The drives of both versions on a road."""

    old: Test
    new: Test

    @property
    def change(self) -> Change:
        """From the old version to the new."""
        if not (self.old.outcome.is_driven and self.new.outcome.is_driven):
            return Change.NOT_JUDGED
        return Change.of(*(test.outcome is Outcome.FAIL for test in self))


@dataclass(frozen=True)
class PairedRoads:
    """The drives of both versions on several roads."""

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
        """Judged roads on which the old version fails, and the new."""
        old, new = (sum(pair[i].outcome is Outcome.FAIL for pair in self.judged) for i in range(2))
        return old, new

    def as_json(self) -> dict[str, JSONValue]:
        """Its counts."""
        old, new = self.failing
        return {
            "campaign": str(self.folder),
            "judged": len(self.judged),
            "failing": {"old": old, "new": new},
            "changes": {str(change): self.changes[change] for change in Change},
        }


@dataclass(frozen=True)
class BackToBack:
    """Two versions of a driver, driven on the same roads."""

    old: Mapping[str, JSONValue]
    """Driver as a campaign describes it."""
    new: Mapping[str, JSONValue]
    simulator: Mapping[str, JSONValue]
    seed: int
    """Seed of the fresh roads."""
    fresh: PairedRoads
    """The fresh roads, on which the verdict rests."""
    known: PairedRoads
    """Those on which the old version failed in its campaign."""
    domain: Domain | None = None
    """Domain of the roads and their conditions; None for the usual conditions."""
    missing: int = 0
    """Number of drives that Ctrl-C prevented."""

    @cached_property
    def difference(self) -> Estimate | None:
        """Failure rate of the new version minus that of the old, -1..1; None without pairs."""
        return _difference(self.fresh.judged)

    @cached_property
    def time_difference(self) -> Estimate | None:
        """Median of the new version's time over the old one's, minus 1, where both passed."""
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
        """The verdict: the whole interval of the difference lies on one side of 0.

        It has to do so whether errors of the simulator are left out or count as failures.
        """
        broken_too = [
            pair
            for pair in self.fresh.pairs
            if all(test.outcome.is_driven or test.outcome is Outcome.ERROR for test in pair)
        ]
        signs = {
            0 if one is None else one.sign for one in (self.difference, _difference(broken_too))
        }
        if len(signs) > 1 or self.difference is None:
            return "cannot tell"
        return {-1: BETTER, 0: "no difference shown", 1: WORSE}[signs.pop()]

    @property
    def answer(self) -> str:
        """The answer in one line."""
        difference, verdict = self.difference, self.verdict
        if difference is None:
            return "cannot tell which is better: no fresh road was judged with both"
        old, new = self.fresh.failing
        value, low, high = (_points(one) for one in asdict(difference).values())
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
        """What the drivers do wrong -> on how many of all roads the old and the new version do."""
        found: tuple[Counter[str], ...] = Counter(), Counter()
        for pair in (*self.fresh.judged, *self.known.judged):
            for causes, test in zip(found, pair, strict=True):
                if (failure := Failure.of_test(test)) is not None:
                    cause = failure.cause
                    words = "" if cause is None else in_words(cause.kind, None, cause.criterion)
                    causes[words or str(failure.fault)] += 1
        old, new = found
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
            reasons = Counter(one[i].reason for one in pairs if one[i].outcome is Outcome.ERROR)
            for reason, _ in reasons.most_common(1):
                yield (
                    f"the simulator broke in {counted(reasons.total(), 'drive')} with {version},"
                    f" which count as neither passed nor failed, most often: {reason}"
                )
        if self.verdict not in (BETTER, WORSE) and self.fresh.judged:
            more = 4 * len(self.fresh.pairs)
            yield f"four times as many fresh roads, {more}, halve the interval"

    def as_json(self) -> dict[str, JSONValue]:
        """The result for JSON."""
        return {
            "answer": self.answer,
            "verdict": self.verdict,
            "notes": list(self.notes),
            "old": dict(self.old),
            "new": dict(self.new),
            "simulator": dict(self.simulator),
            "seed": self.seed,
            "domain": None if self.domain is None else self.domain.entries(),
            "difference": _interval(self.difference),
            "time_difference": _interval(self.time_difference),
            "fresh": self.fresh.as_json(),
            "known": self.known.as_json(),
            "causes": {cause: list(roads) for cause, roads in self.causes.items()},
        }


def _difference(pairs: Sequence[Pair]) -> Estimate | None:
    """The difference of the failure rates; errors of the simulator count as failures."""
    if not pairs:
        return None
    old, new = ([pair[i].outcome is not Outcome.PASS for pair in pairs] for i in range(2))
    return paired_share_difference(old, new)


def _points(share: float) -> str:
    """A difference of shares in percentage points, with its sign but for 0."""
    text = f"{100.0 * share:+.1f}"
    return text[1:] if float(text) == 0.0 else text


def _interval(value: Estimate | None) -> dict[str, JSONValue] | None:
    if value is None:
        return None
    return {name: v if math.isfinite(v) else None for name, v in asdict(value).items()}


# Driving


@dataclass(frozen=True)
class FreshRoads:
    """Fresh random roads, driven by the old version."""

    campaign: Path
    """Folder of the campaign of the old version."""
    folder: Path
    """Folder of the campaign of random search with these roads."""
    count: int
    seed: int
    driver: Mapping[str, JSONValue]
    """The old version as a campaign describes it."""
    tests: tuple[int, ...]
    """Ids of the roads' tests there; Ctrl-C leaves fewer."""


def fresh_roads(
    campaign: Path | str, tester: RoadTester, *, fresh: int = FRESH, **how: Unpack[How]
) -> FreshRoads:
    """Lets the old version drive on fresh random roads, as far as these drives are not stored.

    The seed is the least that is not the campaign's.

    Args:
        campaign: folder of a campaign of the old version.
        tester: drives with the old version on the campaign's terms.
        fresh: number of roads.
        how: see `How`.

    Raises:
        CampaignError: there is no such campaign, or as for
            `frenetic.rerun.campaigns.campaign_again`.
        ValueError: an option is out of range.
    """
    return _drive_fresh(campaign, tester, fresh, how, named="random")


def _drive_fresh(
    campaign: Path | str, tester: RoadTester, fresh: int, how: How, *, named: str | None
) -> FreshRoads:
    """`fresh_roads`, by a strategy of that name; without one, its record has no spec to sign."""
    require_count("fresh", fresh)
    with CampaignStore.open(campaign) as store:
        seed = _fresh_seed(store)
    terms, budget = tester.terms, Budget(simulations=fresh)
    strategy = RandomSearch(
        seed=seed, map_size=terms.map_size, road_class=terms.road_class, domain=terms.domain
    )
    if tester.spec is not None:
        tester = replace(tester, spec=structs.replace(tester.spec, seed=seed).with_budget(budget))
    driving = campaign_again(
        campaign,
        strategy,
        tester,
        budget,
        what=["fresh", seed],
        terms={"fresh": True},
        how=how,
        named=named,
    )
    tests = _driven(driving.folder)
    if len(tests) < fresh:
        complete(driving, how)
    else:
        outcomes = Counter(test.outcome for test in tests[:fresh])
        say_complete(driving.folder, Counts.of(outcomes), how.get("on_event"))
    described = tester.described["driver"]
    return _fresh_roads(Path(campaign), driving.folder, fresh, seed, described)


def recorded_driver(store: CampaignStore) -> Mapping[str, JSONValue]:
    """The driver of a campaign, as it describes it."""
    described = store.config["driver"]
    return described if isinstance(described, Mapping) else {}


def _fresh_seed(store: CampaignStore) -> int:
    """The least seed that is not a campaign's."""
    taken = store.config.get("seed")
    return next(number for number in count() if number != taken)


def _fresh_roads(
    campaign: Path, folder: Path, fresh: int, seed: int, driver: Mapping[str, JSONValue]
) -> FreshRoads:
    """The fresh roads in a folder, as far as they were driven."""
    ids = tuple(test.id for test in _driven(folder)[:fresh])
    return FreshRoads(campaign, folder, fresh, seed, driver, ids)


def fresh_roads_as_recorded(
    campaign: Path | str,
    spec: Spec,
    *,
    fresh: int = FRESH,
    is_trusted: bool = False,
    **how: Unpack[How],
) -> FreshRoads:
    """`fresh_roads` with the driver of a campaign as it was then.

    A driver of the user's own is made in a process of its own, from the source that the campaign
    keeps if it was edited since: two versions of one module never meet in one process.

    Args:
        campaign: its folder.
        spec: its spec.
        fresh: number of roads.
        is_trusted: as for `as_recorded`.
        how: see `How`.

    Raises:
        CampaignError: the source was edited and the campaign keeps none, or as for `fresh_roads`.
        FreneticError: it is code that this user has not trusted, see `frenetic.parts.trust`.
    """
    with as_recorded(campaign, spec, is_trusted=is_trusted) as old:
        recorded = old.spec
        if not DRIVERS.is_own(recorded.part("driver").name):
            return fresh_roads(campaign, old.tester(), fresh=fresh, **how)
        return _in_process(old, fresh, how)


def _in_process(old: OldVersion, fresh: int, how: How) -> FreshRoads:
    """The fresh roads of an old version, driven in a process of its own; Ctrl-C ends that."""
    on_event = how.get("on_event") or (lambda _: None)
    with CampaignStore.open(old.campaign) as store:
        seed, described = _fresh_seed(store), recorded_driver(store)
    now, folder = Summary(), old.campaign
    worker = ObjectProcess("the old version", pack(old), files=())

    def on_interrupt() -> None:
        on_event(Event("interrupted", now))

    with catch_interrupt(on_interrupt) as interrupt:
        try:
            worker.start()
            workers, isolate = how.get("workers", 1), how.get("isolate", False)
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
    return _fresh_roads(old.campaign, folder, fresh, seed, described)


@dataclass(frozen=True)
class OldVersion:
    """The driver of a campaign as it was then, which a process makes and lets drive."""

    campaign: Path
    spec: Spec
    folder: Path
    """From which the campaign's code is loaded."""
    place: Path | None
    """Folder with its source as it was then; None if that is where it was."""
    others: frozenset[str] = field(default_factory=user_folders)
    """Folders of other versions' modules, which its process does not look into."""

    def start(self) -> None:
        """Finds its source before any other."""
        path = [place for place in sys.path if place not in self.others]
        sys.path[:] = path if self.place is None else [str(self.place), *path]

    def tester(self) -> RoadTester:
        """Drives with it on the campaign's terms; unlike `campaign_tester`, it warns of nothing."""
        with CampaignStore.open(self.campaign) as store, chdir(self.place or self.folder):
            return RoadTester.of(self.spec, store.setting.terms)

    def drive(self, fresh: int, workers: int, isolate: bool) -> str:
        """Lets it drive on fresh roads, and reports events; returns the folder of its campaign."""

        def on_event(event: Event) -> None:
            report((event.kind, Progress.of_summary(event.summary)))

        how: How = {"workers": workers, "isolate": isolate, "on_event": on_event}
        # A source that lies in a temporary folder gets no signature, which would outlive that.
        named = "random" if self.place is None else None
        return str(_drive_fresh(self.campaign, self.tester(), fresh, how, named=named).folder)

    def close(self) -> None:
        """Has nothing to close."""


def _driven(folder: Path) -> list[Test]:
    """Return the tests of a campaign that were driven, by their ids; none without a campaign."""
    if not (folder / DATABASE).exists():
        return []
    with CampaignStore.open(folder) as store:
        driven = [test for test in store.tests() if test.outcome.is_simulated]
        return sorted(driven, key=lambda test: test.id)


def compare_versions(roads: FreshRoads, tester: RoadTester, **how: Unpack[How]) -> BackToBack:
    """Lets a new version drive on the same roads, and compares it with the old one.

    Args:
        roads: as the old version drove them.
        tester: drives with the new version on the campaign's terms.
        how: see `How`.

    Raises:
        CampaignError: both versions are the same, or as for
            `frenetic.rerun.campaigns.campaign_again`.
    """
    described = tester.described
    check_differ(roads.driver, described["driver"])
    with CampaignStore.open(roads.campaign) as store:
        domain = store.setting.domain
        failed = store.tests(Outcome.FAIL, with_repeats=False)
        failing = tuple(sorted(test.id for test in failed))
    missing = roads.count - len(roads.tests)
    sets: list[PairedRoads] = []
    for folder, ids in ((roads.folder, roads.tests), (roads.campaign, failing)):
        again = () if missing else drive_tests(folder, tester, ids, how=how).tests
        sets.append(PairedRoads(folder, tuple(Pair(t.recorded, t.drives[0].test) for t in again)))
        missing += len(ids) - len(again)
    fresh, known = sets
    new, simulator = described["driver"], described["simulator"]
    return BackToBack(roads.driver, new, simulator, roads.seed, fresh, known, domain, missing)


def check_differ(old: Mapping[str, JSONValue], new: Mapping[str, JSONValue]) -> None:
    """Refuses two versions, as `frenetic.spec.part_record.describe` gives them, that are the same.

    Raises:
        CampaignError: they are.
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
    """Compares two versions of a driver on fresh random roads and on those on which one failed.

    Args:
        campaign: folder of the campaign of the old version.
        simulator: any, not yet entered.
        old: the version of the campaign.
        new: the other version.
        fresh: number of random roads.
        workers: roads driven at once.

    Raises:
        CampaignError: both versions are the same, or as for `fresh_roads`.
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
    """A campaign's driver as it was then.

    If its source was edited since, the one that the campaign keeps lies in a temporary folder
    meanwhile.

    Args:
        folder: of the campaign.
        spec: of the campaign.
        is_trusted: whether the user trusts the campaign, with the sources that it keeps.

    Raises:
        CampaignError: the source was edited, and the campaign keeps none.
        FreneticError: it is code that this user has not trusted, see `frenetic.parts.trust`.
    """
    with CampaignStore.open(folder) as store:
        sources: Any = store.fact(SOURCES)
        made = {kind: part for kind, part in spec.parts.items() if kind not in NOT_DRIVING}
        code_folder = signed_spec(store).require_trusted(
            folder, needed=made, sources=sources, is_trusted=is_trusted, optional=()
        )
    sources = sources if isinstance(sources, Mapping) else {}
    driver = spec.part("driver")
    with chdir(code_folder):
        present = sources_named(driver.name)
    is_other = not sources.items() >= present.items() or bool(sources and not present)
    if not (is_other and DRIVERS.is_own(driver.name)):
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


def _with_sources_in(place: Path, spec: Spec, folder: Path) -> Spec:
    """A spec for that place, whose driver and simulator of the user's own have their sources there.

    Args:
        place: with sources by the names under which a campaign keeps them.
        spec: of the campaign.
        folder: from which other files of the parts go.
    """
    words = {}
    for kind in ("driver", "simulator"):
        (name, options), registry = spec.part(kind), REGISTRIES[kind]
        module, _, attribute = name.rpartition(":")
        if not (module and registry.is_own(name)):
            words[kind] = part_word(*registry.absolute(name, options, folder))
            continue
        if module.endswith(".py"):
            name = f"{place / Path(module).name}:{attribute}"
        words[kind] = part_word(name, absolute_files(options, folder))
    return structs.replace(spec, **words)
