"""Rerun: drive a campaign's roads again, also in other conditions, simulators or by other drivers.

The roads keep their places on the map and their recorded conditions. With the campaign's parts each
drive repeats exactly, unless driver or simulator is not repeatable. Conditions can vary within
ranges: friction, speed limit, the driver's noise and so on. Another driver shows which failures it
has fixed; another simulator shows which failures are the driver's.

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
    RerunOptions,
    RerunPlan,
    drive_missing,
    rerun_campaign,
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
    """Return the recorded rules of a campaign from Python, overridden by those that a spec gives.

    None for a campaign with a spec, whose rules follow from its named parts.
    """
    if store.config.get(SPEC) is not None:
        return None
    return spec.driving_spec(has_roads=True).rules_over(store.setting.rules)


def campaign_tester(store: CampaignStore, spec: Spec) -> RoadTester:
    """Return a tester for a campaign's roads; warn of parts whose version has changed.

    Args:
        store: the campaign.
        spec: the campaign's spec, possibly with other parts, rules and conditions.

    Raises:
        CampaignError: the campaign's configuration is damaged.
        FreneticError: a part cannot be made.
    """
    setting = store.setting
    terms = replace(spec.terms, map_size=setting.map_size, map_margin=setting.map_margin)
    terms = replace(terms, lane_width=setting.lane_width, road_class=setting.road_class)
    terms, rules = replace(terms, domain=setting.domain), recorded_rules(store, spec)
    tester = RoadTester.of(spec, terms, rules)
    for note in version_notes(store.config, tester.described):
        logger.warning("%s", note)
    return tester


def rerun(folder: Path | str, simulator: Simulator, driver: Driver, **options: Any) -> Rerun:
    """Drive tests of a campaign again on its terms.

    Args:
        folder: folder of the campaign.
        simulator: any simulator, not yet entered.
        driver: any driver.
        options: options of `rerun_with`, which also says what is raised.
    """
    with CampaignStore.open(folder) as store:
        tester = RoadTester(simulator, driver, store.setting.terms)
        for note in version_notes(store.config, tester.described):
            logger.warning("%s", note)
    return rerun_with(folder, tester, **options)


def rerun_with(
    folder: Path | str,
    tester: RoadTester,
    *,
    tests: Iterable[int] | None = None,
    times: int = 1,
    vary: Sequence[Variation] = (),
    seed: int = 0,
    instead: Iterable[str] = (),
    **options: Unpack[RerunOptions],
) -> Rerun:
    """Drive tests of a campaign again, each at its place on the map and in its recorded conditions.

    A varied condition has the same amounts in every test, except that a usual range lies around a
    test's recorded amount. An interrupted rerun goes on, a complete one is read.

    Args:
        folder: folder of the campaign.
        tester: drives on the campaign's terms or in other conditions; see `campaign_tester`.
        tests: ids of tests; by default all failures, the most severe first.
        times: number of drives of each test.
        vary: ranges of the varied conditions; none by default.
        seed: seed of the conditions.
        instead: conditions whose recorded amounts do not count, because simulator or driver have
            others.
        options: see `RerunOptions`.

    Raises:
        CampaignError: the campaign is damaged, a test was not driven, or see
            `frenetic.rerun.campaigns.rerun_campaign`.
        FreneticError: the simulator cannot vary a condition, or cannot lay a recorded one.
        ValueError: an option is out of range.
    """
    seed = int(seed)  # which may be numpy's
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
    # One test of those with the same conditions is checked.
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
    options: RerunOptions,
) -> Rerun:
    """Drive tests of a campaign again in the conditions given, see `ReplayRoads`.

    Args:
        folder: folder of the campaign.
        tester: drives.
        tests: ids of tests.
        conditions: conditions of each drive.
        variations: ranges from which the conditions were drawn, for the record.
        instead: conditions whose recorded amounts do not count.
        options: see `RerunOptions`.

    Raises:
        CampaignError: the campaign is damaged, a test was not driven, or see
            `frenetic.rerun.campaigns.rerun_campaign`.
        ValueError: an option is out of range.
    """
    tests = list(dict.fromkeys(tests))
    strategy = ReplayRoads(folder, tests, conditions, instead)
    simulator = tester.simulator
    if not tests:
        return Rerun(
            Path(folder).resolve().name,
            tester.described["driver"],
            tester.described["simulator"],
            simulator.rules,
            planned=0,
            tests=(),
        )
    plan = RerunPlan(
        strategy,
        Budget(simulations=len(strategy)),
        identity=strategy.options,
        purpose={"planned": len(strategy), "variations": to_builtins(tuple(variations))},
    )
    campaign = rerun_campaign(folder, plan, tester, options)
    drive_missing(campaign, options.get("on_event"))
    return read_rerun(campaign.folder, folder)
