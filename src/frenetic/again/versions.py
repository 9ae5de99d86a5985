"""Back-to-back testing: whether a new version of a driver is better than the old one.

ISTQB's glossary calls so what executes the same tests on two variants and compares the results.
Both versions drive on fresh random roads, which no search has chosen, in conditions of the
campaign's domain if it has one, and on those on which the old one failed in its campaign;
`frenetic.again.paired` says what the pairs show.

The fresh roads are a campaign of their own, which the old version drives, in the folder ``again``
of its campaign. Every other drive is a rerun of the campaign whose road it is.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic.again.campaigns import How, campaign_again, complete
from frenetic.again.paired import BackToBack, Pair, PairedRoads, RoadSet
from frenetic.again.rerun import drive_tests
from frenetic.again.strategy import ByTest
from frenetic.again.verdicts import Repeat
from frenetic.campaign.campaign import SOURCES, Campaign
from frenetic.campaign.counts import key_of
from frenetic.campaign.record import Test
from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.campaign.summary import Event
from frenetic.campaign.tester import RoadTester
from frenetic.domain import Domain
from frenetic.drivers import Driver, Noisy
from frenetic.drivers.driver import stack_of
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.quantities import SEED
from frenetic.search import RandomSearch
from frenetic.search.random_search import RANDOM
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import Conditions
from frenetic.spec import Budget, Part, Spec, describe, part_text, require_count
from frenetic.trust import NOT_DRIVING
from frenetic.versions import comparison_key, sources_named

FRESH: Final = 200
"""Default number of fresh roads."""


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
    drives: Mapping[RoadSet, Mapping[int, tuple[Repeat, ...]]]
    """Test -> its drives, as many as are planned; the fresh roads first."""
    missing: int
    """Number of drives that Ctrl-C prevented."""


def drive(
    plan: Plan,
    simulator: Simulator,
    driver: Driver,
    old: VersionDrives | None = None,
    *,
    spec: Spec | None = None,
    workers: int = 1,
    on_event: Callable[[Event], object] | None = None,
) -> VersionDrives:
    """Lets a version drive on the planned roads, unless its drives are stored.

    Args:
        plan: the roads.
        simulator: that of the campaign, not yet entered.
        driver: the version.
        old: what the old version drove; None for the old version itself, which makes the fresh
            roads.
        spec: names of the old campaign's parts, for the record of the fresh roads.
        workers: number of roads driven at once, as for `Campaign`.
        on_event: called with each event of the campaigns that drive, see `Campaign.run`.

    Raises:
        CampaignError: both versions are the same, a campaign is damaged, a folder cannot be
            written, no worker can be started, or only broken drives come.
        ValueError: an option is out of range.
    """
    described = describe(driver), describe(simulator)
    how: How = {"workers": workers, "on_event": on_event}
    with CampaignStore.open(plan.old) as store:
        setting = store.setting
    # Not `campaign_tester`, which warns of another version than the campaign's.
    tester = RoadTester.on(setting, simulator, driver)
    missing, is_interrupted = plan.drives, False
    if old is None:
        campaign = _fresh_campaign(plan, tester, setting.domain, spec, how)
        fresh = campaign.folder
        if _simulations(campaign) < plan.fresh:
            complete(campaign, how)
        done = _simulations(campaign)
        missing, is_interrupted = missing - min(done, plan.fresh), done < plan.fresh
    else:
        check_differ(old.driver, described[0])
        fresh = old.fresh
    tests = _fresh_tests(fresh, plan.fresh)
    first = {test.id: (Repeat(test, test),) for test in tests} if old is None else {}
    drives = {}
    for roads, folder, ids, own in (
        (RoadSet.FRESH, fresh, [test.id for test in tests], first),
        (RoadSet.OLD, plan.old, plan.failures, {}),
    ):
        rest = plan.repeats - bool(own)
        found: dict[int, tuple[Repeat, ...]] = {} if rest else dict.fromkeys(ids, ())
        if rest and ids and not is_interrupted:
            by_test = {
                number: _conditions(driver, plan.repeats, one)[-rest:]
                for number, one in _own_conditions(folder, ids).items()
            }
            first_of, *others = by_test.values()
            is_alike = all(one == first_of for one in others)
            conditions: ByTest = first_of if is_alike else by_test
            rerun = drive_tests(folder, tester, ids, conditions, how=how)
            missing -= len(rerun.drives)
            is_interrupted = rerun.missing > 0
            found = {one.id: one.drives for one in rerun.tests if len(one.drives) == rest}
        drives[roads] = {number: own.get(number, ()) + again for number, again in found.items()}
    return VersionDrives(*described, fresh, drives, missing)


def _fresh_campaign(
    plan: Plan, tester: RoadTester, domain: Domain | None, spec: Spec | None, how: How
) -> Campaign:
    """The campaign with the fresh roads, possibly driven."""
    budget = Budget(simulations=plan.fresh)
    strategy = RandomSearch(
        seed=plan.seed, map_size=tester.map_size, road_class=tester.road_class, domain=domain
    )
    what, terms = ["fresh", plan.seed], {"fresh": True}
    campaign = campaign_again(plan.old, strategy, tester, budget, what=what, terms=terms, how=how)
    if spec is not None:
        more: Any = {"seed": plan.seed, "budget": budget, "cluster": None}
        campaign.named = replace(spec, strategy=Part("random"), **more)
    return campaign


def _simulations(campaign: Campaign) -> int:
    """Number of stored drives."""
    if not (campaign.folder / DATABASE).exists():
        return 0
    with CampaignStore.open(campaign.folder) as store:
        return store.counts().simulations


def _fresh_tests(folder: Path, number: int) -> list[Test]:
    """The first fresh roads, those of failures with their drives."""
    with CampaignStore.open(folder) as store:
        driven = [test for test in store.tests() if test.outcome.is_simulated]
        driven.sort(key=lambda test: test.id)
        return [
            store.test(test.id) if test.outcome is Outcome.FAIL else test
            for test in driven[:number]
        ]


def check_differ(old: Mapping[str, JSONValue], new: Mapping[str, JSONValue]) -> None:
    """Refuses two versions, as `frenetic.spec.describe` gives them, that are the same.

    Raises:
        CampaignError: they are.
    """
    if comparison_key(old) == comparison_key(new):
        raise CampaignError(
            f"both versions are the same, {part_text(old)}: edit its file, which the campaign keeps"
            " as it was, or give it other options"
        )


def pair_up(plan: Plan, old: VersionDrives, new: VersionDrives) -> BackToBack:
    """Compares what two versions drove, without the roads that one of them lacks after Ctrl-C."""
    sets = []
    for roads, ours in old.drives.items():
        theirs = new.drives[roads]
        pairs = (
            Pair(own[0].recorded, own, theirs[number])
            for number, own in ours.items()
            if number in theirs
        )
        folder = old.fresh if roads is RoadSet.FRESH else plan.old
        sets.append(PairedRoads(roads, folder, tuple(pairs), plan.repeats))
    with CampaignStore.open(plan.old) as store:
        domain = store.setting.domain
    return BackToBack(old.driver, new.driver, old.simulator, plan.seed, tuple(sets), domain)


def on_shared_roads(old: Path, new: Path) -> BackToBack | None:
    """Compares the drivers of two campaigns on the random roads that both drove; drives nothing.

    None if drivers are the same or all else is not: simulator, rules and lanes.

    Args:
        old: folder of a campaign of the old version.
        new: folder of one of the new version, best with the same seed.

    Raises:
        CampaignError: one of them is damaged.
    """
    configs, drives = [], []
    for folder in (old, new):
        with CampaignStore.open(folder) as store:
            configs.append((store.config, store.setting))
            drives.append(
                {
                    key_of(test.candidate): test
                    for test in store.tests()
                    if test.outcome.is_simulated and test.candidate.origin.operator == RANDOM
                }
            )
    (ours, setting), (theirs, other) = configs
    is_same = setting == other and ours.get("simulator") == theirs.get("simulator")
    driver: Any = ours.get("driver")
    new_driver: Any = theirs.get("driver")
    if driver == new_driver or not is_same:
        return None
    pairs = tuple(
        Pair(test, (Repeat(test, test),), (Repeat(test, drives[1][key]),))
        for key, test in drives[0].items()
        if key in drives[1] and drives[1][key].candidate.conditions == test.candidate.conditions
    )
    simulator: Any = ours.get("simulator")
    seed: Any = ours.get("seed")
    sets = (PairedRoads(RoadSet.SHARED, old, pairs, 1),)
    return BackToBack(driver, new_driver, simulator, seed, sets, setting.domain)


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
) -> BackToBack:
    """Compares two versions of a driver, see `plan` and `drive` for arguments and errors."""
    chosen = plan(campaign, fresh=fresh, seed=seed, repeats=repeats)
    first = drive(chosen, simulator, old, workers=workers)
    return pair_up(chosen, first, drive(chosen, simulator, new, first, workers=workers))


def _conditions(
    driver: Driver, repeats: int, own: Conditions = MappingProxyType({})
) -> tuple[Conditions, ...]:
    """Conditions of the repeats of a test: with what is random each has its own errors.

    They are the same for both versions.

    Args:
        driver: with its layers.
        repeats: number of drives.
        own: conditions of the test.
    """
    noise: dict[str, float] = {}
    for layer in stack_of(driver):
        if isinstance(layer, Noisy) and "noise" not in own:
            noise = {"noise": layer.offset}
    if not noise and SEED not in own:
        return ({},) * repeats
    first = int(own.get(SEED, 0))
    return ({}, *({**noise, SEED: first + number} for number in range(1, repeats)))


def _own_conditions(folder: Path, tests: Iterable[int]) -> dict[int, Conditions]:
    with CampaignStore.open(folder) as store:
        return {
            number: store.test(number, with_trajectory=False).candidate.conditions
            for number in tests
        }
