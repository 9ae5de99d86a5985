"""Rerun: drive a campaign's roads again, also in other conditions, simulators or by other drivers.

The roads keep their poses on the map and their recorded conditions. With the campaign's parts each
drive repeats exactly, unless driver or simulator is not repeatable. Conditions, such as friction,
speed limit or the driver's noise, can vary within ranges. A rerun with another driver shows which
failures that driver does not have; a rerun in another simulator shows which failures do not depend
on the simulator.

In the recorded conditions a failure is *repeatable* or *not repeatable*. In varied conditions it is
*robust* if at least half of the drives show it and *fragile* if fewer do; the whole 95 % interval
must be on one side.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from msgspec import to_builtins

from frenetic._support.files import require_list
from frenetic.campaign.configuration import SPEC
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import without
from frenetic.drivers import Driver
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.campaigns import (
    DrivingOptions,
    DrivingPlan,
    drive_missing,
    driving_campaign,
)
from frenetic.rerun.replay import DriveConditions, ReplayRoads
from frenetic.rerun.reruns import Rerun, read_rerun
from frenetic.rerun.variations import Variation, draw_conditions, recorded_conditions
from frenetic.simulators.conditions import check_pair_in
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Budget, Spec
from frenetic.spec.part_record import version_notes

logger = logging.getLogger(__name__)


def recorded_rules(store: CampaignStore, spec: Spec) -> Rules | None:
    """Return the rules for roads of a campaign that Python code began, None for other campaigns.

    A campaign of the command line keeps a spec, from which its rules follow. A campaign of Python
    code keeps only its rules: the spec's rules, where it sets any, replace them.

    Args:
        store: the campaign.
        spec: spec for driving the roads.
    """
    if store.config.get(SPEC) is not None:
        return None
    return spec.driving_spec(roads_are_given=True).rules_over(store.setting.rules)


def campaign_tester(store: CampaignStore, spec: Spec) -> RoadTester:
    """Return a tester for a campaign's roads, and warn of parts whose version has changed.

    Args:
        store: the campaign.
        spec: spec of the campaign, or one with other parts, rules and conditions.

    Raises:
        CampaignError: the campaign's configuration is damaged.
        FreneticError: a part cannot be made.
    """
    setting = store.setting
    terms = replace(
        spec.terms,
        map_size=setting.map_size,
        map_margin=setting.map_margin,
        lane_width=setting.lane_width,
        road_class=setting.road_class,
        domain=setting.domain,
    )
    tester = RoadTester.of(spec, terms, recorded_rules(store, spec))
    _warn_of_versions(store, tester)
    return tester


def tester_on_terms(folder: Path | str, simulator: Simulator, driver: Driver) -> RoadTester:
    """Return a tester on a campaign's terms, and warn of parts whose version has changed.

    Raises:
        CampaignError: the campaign does not exist or is damaged.
        FreneticError: the driver cannot drive in the simulator in the campaign's conditions.
    """
    with CampaignStore.open(folder) as store:
        tester = RoadTester(simulator, driver, store.setting.terms)
        _warn_of_versions(store, tester)
    return tester


def _warn_of_versions(store: CampaignStore, tester: RoadTester) -> None:
    """Warn of each part of a tester whose version is not the one that a campaign recorded."""
    for note in version_notes(store.config, tester.described):
        logger.warning("%s", note)


def rerun(folder: Path | str, simulator: Simulator, driver: Driver, **options: Any) -> Rerun:
    """Drive tests of a campaign again on its terms.

    Args:
        folder: folder of the campaign.
        simulator: any simulator, not yet entered.
        driver: any driver.
        options: options of `rerun_with`.

    Raises:
        CampaignError: see `rerun_with`.
        FreneticError: see `rerun_with`.
        ValueError: an option is out of range.
    """
    return rerun_with(folder, tester_on_terms(folder, simulator, driver), **options)


def rerun_with(
    folder: Path | str,
    tester: RoadTester,
    *,
    tests: Iterable[int] | None = None,
    times: int = 1,
    vary: Sequence[Variation] = (),
    seed: int = 0,
    instead: Iterable[str] = (),
    **options: Unpack[DrivingOptions],
) -> Rerun:
    """Drive tests of a campaign again, each at its pose on the map and in its recorded conditions.

    A varied condition has the same amounts in every test. Only a condition that varies in its usual
    range does so around the amount that the test recorded. The same call continues an interrupted
    rerun, and reads a complete one.

    Args:
        folder: folder of the campaign.
        tester: drives on the campaign's terms or in other conditions, see `campaign_tester`.
        tests: ids of tests; by default all failures, the lowest MOOBD first.
        times: number of drives of each test.
        vary: ranges of the varied conditions; none by default.
        seed: seed of the conditions.
        instead: conditions whose recorded amounts are ignored, because the simulator or the driver
            has other amounts of these conditions.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: the campaign is damaged, a test was not driven, or see
            `frenetic.rerun.campaigns.driving_campaign`.
        FreneticError: the simulator cannot vary a condition, or lacks a recorded condition.
        ValueError: an option is out of range.
    """
    seed = int(seed)  # a numpy integer cannot be stored as JSON
    instead = sorted(require_list("instead", instead, "conditions"))
    vary = require_list("vary", vary, "variations")
    vary = [
        replace(variation, is_usual=variation.is_usual and variation.condition not in instead)
        for variation in vary
    ]
    drawn = draw_conditions(vary, times, seed)
    with CampaignStore.open(folder) as store:
        if tests is None:
            failed = store.tests(Outcome.FAIL, order_by="moobd", with_repeats=False)
            tests = [test.id for test in failed]
        tests = require_list("tests", tests, "ids of tests")
        candidates = [store.test(number, with_trajectory=False).candidate for number in tests]
    simulator, driver, terms = tester.simulator, tester.driver, tester.terms
    recorded = {
        road.id: without(recorded_conditions(road, simulator.rules), *instead)
        for road in candidates
    }
    # Of tests with the same conditions, whatever their amounts, one is checked.
    by_conditions = {frozenset(amounts): amounts for amounts in recorded.values()}
    for amounts in ({}, *by_conditions.values()):
        check_pair_in(terms.conditions_of({**amounts, **drawn[0]}), simulator, driver)
    conditions: DriveConditions = drawn
    if any(
        variation.of(amounts) != variation for variation in vary for amounts in recorded.values()
    ):
        conditions = {
            number: draw_conditions([variation.of(amounts) for variation in vary], times, seed)
            for number, amounts in recorded.items()
        }
    return drive_tests(
        folder, tester, tests, conditions, variations=vary, instead=instead, options=options
    )


def drive_tests(
    folder: Path | str,
    tester: RoadTester,
    tests: Iterable[int],
    conditions: DriveConditions = ({},),
    *,
    variations: Sequence[Variation] = (),
    instead: Iterable[str] = (),
    options: DrivingOptions,
) -> Rerun:
    """Drive tests of a campaign again, in certain conditions.

    Args:
        folder: folder of the campaign.
        tester: drives the roads.
        tests: ids of tests; an id that is repeated counts once.
        conditions: conditions of each drive, see `ReplayRoads`.
        variations: ranges from which the conditions were drawn, which are only recorded.
        instead: conditions whose recorded amounts are ignored.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: the campaign is damaged, a test was not driven, or see
            `frenetic.rerun.campaigns.driving_campaign`.
        ValueError: an option is out of range.
    """
    strategy = ReplayRoads(folder, dict.fromkeys(tests), conditions, instead)
    if not len(strategy):
        return Rerun(
            Path(folder).resolve().name,
            tester.described["driver"],
            tester.described["simulator"],
            tester.simulator.rules,
            planned=0,
            tests=(),
        )
    return read_rerun(drive_roads(folder, tester, strategy, variations, options), folder)


def drive_roads(
    folder: Path | str,
    tester: RoadTester,
    strategy: ReplayRoads,
    variations: Sequence[Variation],
    options: DrivingOptions,
) -> Path:
    """Drive roads of a campaign again, and return the folder of the drives without reading them.

    Args:
        folder: folder of the campaign.
        tester: drives the roads.
        strategy: proposes one road or more of the campaign.
        variations: ranges from which the conditions were drawn, which are only recorded.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: see `frenetic.rerun.campaigns.driving_campaign`.
        ValueError: an option is out of range.
    """
    plan = DrivingPlan(
        strategy,
        Budget(simulations=len(strategy)),
        identity=strategy.options,
        purpose={"planned": len(strategy), "variations": to_builtins(tuple(variations))},
    )
    campaign = driving_campaign(folder, plan, tester, options)
    drive_missing(campaign, options.get("on_event"))
    return campaign.folder
