"""Back-to-back testing: whether a new version of a driver is better than the old one.

ISTQB's glossary calls so what executes the same tests on two variants and compares the results.
Both versions drive on fresh random roads, which no search has chosen, and on those on which the old
one failed in its campaign; `frenetic.again.paired` says what the pairs show.

The fresh roads are a campaign of their own, which the old version drives, in the folder of its
campaign. Every other drive is a rerun of the campaign whose road it is.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic.again.paired import BackToBack, Pair, PairedRoads, RoadSet
from frenetic.again.rerun import drive_tests
from frenetic.again.verdicts import Repeat
from frenetic.campaign.campaign import LOOKAHEAD, SOURCES, Campaign
from frenetic.campaign.database import DATABASE
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event
from frenetic.campaign.tester import RoadTester
from frenetic.drivers import Driver, Noisy
from frenetic.drivers.driver import stack_of
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.quantities import SEED
from frenetic.search import RandomSearch
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import Conditions
from frenetic.spec import Budget, Part, Spec, describe, part_text, require_count
from frenetic.trust import NOT_DRIVING
from frenetic.versions import SHORT, comparison_key, sources_named

FRESH: Final = 200
"""Default number of fresh roads."""
FOLDER: Final = "fresh"
"""Folder, in that of the old version's campaign, of the campaigns with fresh roads."""


@dataclass(frozen=True)
class Plan:
    """The roads on which both versions are to drive; made by `plan`."""

    old: Path
    """Folder of the campaign of the old version."""
    fresh: int
    """Number of fresh roads."""
    seed: int
    """Seed of the fresh roads."""
    repeats: int
    """Number of drives of each version on each road."""
    failures: tuple[int, ...]
    """The campaign's failing tests."""

    @property
    def drives(self) -> int:
        """Number of drives of each version."""
        return self.repeats * (self.fresh + len(self.failures))


def plan(old: Path | str, *, fresh: int = FRESH, seed: int | None = None, repeats: int = 1) -> Plan:
    """Chooses the roads on which two versions drive.

    Args:
        old: folder of a campaign of the old version.
        fresh: number of fresh roads.
        seed: of the fresh roads, another than that of the campaign; the least of these by default.
        repeats: number of drives of each version on each road.

    Raises:
        CampaignError: there is no such campaign, or it is damaged.
        ValueError: an option is out of range.
    """
    for name, number in (("fresh", fresh), ("repeats", repeats)):
        require_count(name, number)
    with CampaignStore.open(old) as store:
        taken = store.config.get("seed")
        failures = tuple(sorted(test.id for test in store.tests(Outcome.FAIL)))
    if seed is None:
        seed = next(number for number in count() if number != taken)
    elif seed == taken:
        raise ValueError(
            f"seed {seed} is that of the campaign, whose random roads are not fresh: choose another"
        )
    return Plan(Path(old), fresh, seed, repeats, failures)


@contextmanager
def as_recorded(folder: Path | str, spec: Spec) -> Iterator[Spec]:
    """A campaign's spec whose driver is as it was then.

    If its source was edited since, the one that the campaign keeps lies in a temporary folder
    meanwhile.

    Args:
        folder: of the campaign.
        spec: of the campaign.

    Raises:
        CampaignError: the source was edited, and the campaign keeps none.
        FreneticError: it is code that this user has not run, see `frenetic.trust`.
    """
    with CampaignStore.open(folder) as store:
        sources: Any = store.fact(SOURCES) or {}
    place, _, name = (spec.driver.name or "").rpartition(":")
    present = sources_named(spec.driver.name or "")
    is_edited = not sources.items() >= present.items() or bool(sources and not present)
    if not is_edited:
        spec.require_trusted(folder, NOT_DRIVING)
        yield spec
        return
    if not sources:
        raise CampaignError(
            f"{folder} keeps no source of its driver {spec.driver.name!r}: bring the old version"
            " back first"
        )
    path = list(sys.path)
    with TemporaryDirectory() as temporary:
        try:
            for file, text in sources.items():
                target = (Path(temporary) / file).resolve()
                if not target.is_relative_to(Path(temporary).resolve()):
                    raise CampaignError(f"{folder} is damaged: it keeps the source of {file!r}")
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(str(text), encoding="utf-8", newline="\n")
            if place.endswith(".py"):
                place = str(Path(temporary) / Path(place).name)
            else:
                sys.path[:0] = [temporary, str(Path.cwd())]
            driver = replace(spec.driver, name=f"{place}:{name}")
            restored = replace(spec, driver=driver)
            restored.require_trusted(folder, NOT_DRIVING)
            yield restored
        finally:
            sys.path[:] = path


@dataclass(frozen=True)
class VersionDrives:
    """The drives of one version on the planned roads."""

    driver: Mapping[str, JSONValue]
    """The driver as a campaign describes it."""
    simulator: Mapping[str, JSONValue]
    fresh: Path
    """Folder of the campaign with the fresh roads."""
    roads: Mapping[RoadSet, tuple[Test, ...]]
    """The tests whose roads these are, the fresh ones first."""
    drives: Mapping[RoadSet, Mapping[int, tuple[Repeat, ...]]]
    """Test -> its drives, as many as are planned."""
    missing: int
    """Number of drives that Ctrl-C prevented."""


@dataclass(frozen=True)
class Driving:
    """How a version drives."""

    simulator: Simulator
    """That of the campaign, not yet entered."""
    driver: Driver
    workers: int = 1
    """Number of roads driven at once, as for `Campaign`."""
    drive_limit: float | None = None
    """Wall time in s, likewise."""
    on_event: Callable[[Event], object] | None = None
    """Called with each event of the campaigns that drive, see `Campaign.run`."""


def drive_old(plan: Plan, driving: Driving, spec: Spec | None = None) -> VersionDrives:
    """Lets the old version drive on the planned roads, and makes the fresh ones.

    Args:
        plan: the roads.
        driving: the old version.
        spec: names of the old campaign's parts, for the record of the fresh roads.

    Raises:
        CampaignError: a campaign is damaged, a folder cannot be written, no worker can be started,
            or only broken drives come.
        ValueError: an option is out of range.
    """
    return _VersionDriver(plan, driving).drive_old(spec)


def drive_new(plan: Plan, driving: Driving, old: VersionDrives) -> VersionDrives:
    """Lets the new version drive on the planned roads, after the old one.

    Errors are those of `drive_old`, and a `CampaignError` if both versions are the same.
    """
    version = _VersionDriver(plan, driving)
    check_differ(old.driver, version.driver)
    return version.drive_new(old)


def check_differ(old: Mapping[str, JSONValue], new: Mapping[str, JSONValue]) -> None:
    """Refuses two versions, as `frenetic.spec.describe` gives them, that are the same.

    Raises:
        CampaignError: they are.
    """
    if comparison_key(old) == comparison_key(new):
        raise CampaignError(
            f"both versions are the same, {part_text(old)}: keep each in a file of its own, or give"
            " them other options"
        )


def pair_up(plan: Plan, old: VersionDrives, new: VersionDrives) -> BackToBack:
    """Compares what two versions drove, without the roads that one of them lacks after Ctrl-C."""
    sets = []
    for chosen, records in old.roads.items():
        ours, theirs = old.drives[chosen], new.drives[chosen]
        pairs = (
            Pair(record, ours[record.id], theirs[record.id])
            for record in records
            if record.id in ours and record.id in theirs
        )
        folder = old.fresh if chosen is RoadSet.FRESH else plan.old
        sets.append(PairedRoads(chosen, folder, tuple(pairs), plan.repeats))
    return BackToBack(old.driver, new.driver, old.simulator, plan.seed, tuple(sets))


def back_to_back(
    campaign: Path | str,
    simulator: Simulator,
    old: Driver,
    new: Driver,
    *,
    fresh: int = FRESH,
    seed: int | None = None,
    repeats: int = 1,
    workers: int = 1,
    drive_limit: float | None = None,
) -> BackToBack:
    """Compares two versions of a driver, see `plan` and `Driving` for arguments and errors."""
    chosen = plan(campaign, fresh=fresh, seed=seed, repeats=repeats)
    first = drive_old(chosen, Driving(simulator, old, workers, drive_limit))
    second = drive_new(chosen, Driving(simulator, new, workers, drive_limit), first)
    return pair_up(chosen, first, second)


class _VersionDriver:
    """Lets a version drive on the planned roads, one set after the other."""

    def __init__(self, plan: Plan, driving: Driving) -> None:
        self._plan = plan
        self._driving = driving
        self.driver = describe(driving.driver)
        self.simulator = describe(driving.simulator)
        self._parts = comparison_key(self.driver, self.simulator)
        self._done = 0
        self._interrupted = False

    def drive_old(self, spec: Spec | None) -> VersionDrives:
        fresh = self._make_fresh(spec)
        roads = _planned_roads(self._plan, fresh)
        own = {record.id: (_recorded(record),) for record in roads[RoadSet.FRESH]}
        return self._drive(fresh, roads, own)

    def drive_new(self, old: VersionDrives) -> VersionDrives:
        return self._drive(old.fresh, old.roads, {})

    def _make_fresh(self, spec: Spec | None) -> Path:
        """Makes the campaign with the fresh roads, or goes on with it."""
        plan, driving = self._plan, self._driving
        with CampaignStore.open(plan.old) as store:
            setting = store.setting
        key = hashlib.sha256(self._parts.encode()).hexdigest()[:SHORT]
        folder = plan.old / FOLDER / f"seed-{plan.seed}-{key}"
        exists, done = (folder / DATABASE).exists(), 0
        if exists:
            with CampaignStore.open(folder) as store:
                done = store.counts().simulations
        if done < plan.fresh:
            budget = Budget(simulations=plan.fresh)
            campaign = Campaign(
                strategy=RandomSearch(seed=plan.seed, map_size=setting.map_size),
                simulator=driving.simulator,
                driver=driving.driver,
                budget=budget,
                folder=folder,
                map_size=setting.map_size,
                margin=setting.margin,
                lane_width=setting.lane_width,
                workers=driving.workers,
                drive_limit=driving.drive_limit,
                ordered=True,
            )
            if spec is not None:
                campaign.named = replace(
                    spec,
                    strategy=Part("random"),
                    seed=plan.seed,
                    budget=budget,
                    lookahead=LOOKAHEAD,
                    cluster=None,
                )
            search = campaign.resume if exists else campaign.run
            summary = search(on_event=driving.on_event)
            self._interrupted = summary.interrupted
            done = summary.simulations
        self._done = min(done, plan.fresh)
        return folder

    def _drive(
        self,
        fresh: Path,
        roads: Mapping[RoadSet, tuple[Test, ...]],
        driven: Mapping[int, tuple[Repeat, ...]],
    ) -> VersionDrives:
        """Drives on all roads, but for the first drives on the fresh ones that are ``driven``."""
        plan = self._plan
        conditions = _conditions(self._driving.driver, plan.repeats)
        drives = {}
        for chosen, records in roads.items():
            is_fresh = chosen is RoadSet.FRESH
            folder, first = (fresh, driven) if is_fresh else (plan.old, {})
            rest = conditions[1:] if first else conditions
            found = self._drive_in(folder, records, rest)
            drives[chosen] = {i: first.get(i, ()) + own for i, own in found.items()}
        missing = plan.drives - self._done
        return VersionDrives(self.driver, self.simulator, fresh, roads, drives, missing)

    def _drive_in(
        self, folder: Path, records: Sequence[Test], conditions: Sequence[Conditions]
    ) -> dict[int, tuple[Repeat, ...]]:
        """Drives tests of a campaign, each in all conditions, unless such drives are stored."""
        driving = self._driving
        # A road whose worker was lost lies nowhere: nobody can drive it again.
        placed = [record for record in records if record.attempt.pose is not None]
        found: dict[int, tuple[Repeat, ...]] = {
            record.id: () for record in records if record.attempt.pose is None or not conditions
        }
        self._done += len(conditions) * (len(records) - len(placed))
        if not conditions:
            return found
        if not placed or self._interrupted:
            return found
        with CampaignStore.open(folder) as store:
            setting = store.setting
        # Not `campaign_tester`, which warns of another version than the campaign's.
        terms = setting.map_size, setting.margin, setting.lane_width
        rerun = drive_tests(
            folder,
            RoadTester(driving.simulator, driving.driver, *terms),
            [record.id for record in placed],
            conditions,
            how={
                "workers": driving.workers,
                "drive_limit": driving.drive_limit,
                "on_event": driving.on_event,
            },
        )
        self._done += len(rerun.drives)
        self._interrupted = rerun.missing > 0
        whole = {one.id: one.drives for one in rerun.tests if len(one.drives) == len(conditions)}
        return found | whole


def _planned_roads(plan: Plan, fresh: Path) -> dict[RoadSet, tuple[Test, ...]]:
    """The tests whose roads are planned, the fresh ones first."""
    with CampaignStore.open(plan.old) as store:
        failing = tuple(store.test(i, with_trajectory=False) for i in plan.failures)
    return {RoadSet.FRESH: _fresh_records(fresh, plan.fresh), RoadSet.OLD: failing}


def _fresh_records(folder: Path, number: int) -> tuple[Test, ...]:
    """The first fresh roads, those of failures with their drives."""
    with CampaignStore.open(folder) as store:
        driven = [record for record in store.tests() if record.outcome.is_simulated]
        driven.sort(key=lambda record: record.id)
        return tuple(
            store.test(record.id) if record.outcome is Outcome.FAIL else record
            for record in driven[:number]
        )


def _recorded(record: Test) -> Repeat:
    """The campaign's own drive of a test."""
    return Repeat(record, record)


def _conditions(driver: Driver, repeats: int) -> tuple[Conditions, ...]:
    """Conditions of the repeats: with noise each has its own errors, the same for both versions."""
    noise = None
    for layer in stack_of(driver):
        if isinstance(layer, Noisy):
            noise = layer.offset
    if noise is None:
        return ({},) * repeats
    return ({}, *({"noise": noise, SEED: number} for number in range(1, repeats)))
