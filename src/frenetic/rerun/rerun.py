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

import hashlib
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Unpack

from msgspec import ValidationError, convert, to_builtins

from frenetic._support.files import require_list
from frenetic._support.json_value import JSONValue
from frenetic.analysis.failures import Failure
from frenetic.campaign.configuration import SPEC
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import SEED, as_text, without
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.parts.records import comparison_key, differences
from frenetic.parts.versions import SHORT
from frenetic.rerun.campaigns import (
    RerunOptions,
    RerunPlan,
    drive_missing,
    purpose_of,
    rerun_campaign,
    rerun_folders,
)
from frenetic.rerun.replay import DriveConditions, ReplayRoads
from frenetic.rerun.stability import Change, Repeat, Repeats, matches_json, matches_text
from frenetic.rerun.variations import Variation, draw_conditions, recorded_conditions
from frenetic.simulators.conditions import check_pair_in
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Budget, Spec
from frenetic.spec.part_record import version_notes
from frenetic.spec.part_text import part_text

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rerun:
    """Drives on the roads of a campaign's tests, all with the same parts."""

    campaign: str
    """Name of the folder of the campaign whose roads these are."""
    driver: Mapping[str, JSONValue]
    """Driver, as `frenetic.spec.part_record.describe` records it."""
    simulator: Mapping[str, JSONValue]
    """Simulator, as `frenetic.spec.part_record.describe` records it."""
    rules: Rules
    planned: int
    """Number of planned drives; Ctrl-C leaves fewer."""
    tests: tuple[Repeats, ...]
    """Repeats of each test, in the order in which the tests were chosen."""
    variations: tuple[Variation, ...] = ()
    """Ranges from which the conditions were drawn."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Conditions of every drive; each drive may have more."""
    folder: Path | None = None
    """Folder of the campaign that drove the roads; None if there was nothing to drive."""

    @property
    def drives(self) -> list[Repeat]:
        """All drives."""
        return [drive for test in self.tests for drive in test.drives]

    @property
    def missing(self) -> int:
        """Number of drives that Ctrl-C prevented."""
        return max(self.planned - len(self.drives), 0)

    @property
    def same(self) -> int:
        """Number of drives with exactly the recorded outcome and MOOBD."""
        return sum(drive.is_same for drive in self.drives)

    def count(self, change: Change) -> int:
        """Return the number of tests with a change."""
        return sum(test.change is change for test in self.tests)

    @property
    def passed(self) -> bool:
        """Whether no drive is missing and all drives passed."""
        passing = (Change.PASSES_NOW, Change.PASSES_AGAIN)
        return self.missing == 0 and all(test.change in passing for test in self.tests)

    @cached_property
    def key(self) -> str:
        """Hexadecimal digest of simulator, driver, rules and conditions."""
        rules, conditions = self.rules.as_json(), dict(self.conditions)
        parts = comparison_key(self.simulator, self.driver, rules, conditions)
        return hashlib.sha256(parts.encode()).hexdigest()[:SHORT]

    def __str__(self) -> str:
        texts = []
        for change in Change:
            tests = [test for test in self.tests if test.change is change]
            matches = matches_text(drive for test in tests for drive in test.drives)
            if tests:
                texts.append(f"{change.counted(len(tests))}{f' ({matches})' if matches else ''}")
        return ", ".join(texts)

    def as_json(self) -> dict[str, JSONValue]:
        """Return the rerun as a JSON object, without trajectories."""
        return {
            "campaign": self.campaign,
            "folder": None if self.folder is None else str(self.folder),
            "driver": dict(self.driver),
            "simulator": dict(self.simulator),
            "conditions": dict(self.conditions),
            "variations": [asdict(variation) for variation in self.variations],
            "passed": self.passed,
            "same": self.same,
            "missing": self.missing,
            "changes": {str(change): self.count(change) for change in Change},
            "matches": matches_json(self.drives),
            "tests": [test.as_json() for test in self.tests],
        }


@dataclass(frozen=True)
class _RerunPurpose:
    """Entry of a rerun's configuration, see `frenetic.rerun.campaigns.PURPOSE`."""

    digest: str
    planned: int
    variations: tuple[Variation, ...] = ()


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


def read_rerun(folder: Path | str, source: Path | str) -> Rerun:
    """Return the rerun in a folder, possibly incomplete.

    Args:
        folder: folder of the campaign that drove the roads.
        source: folder of the campaign whose roads they are.

    Raises:
        CampaignError: a campaign is damaged, or ``folder`` holds no rerun.
    """
    with CampaignStore.open(folder) as store, CampaignStore.open(source) as original:
        try:
            purpose = convert(purpose_of(store), _RerunPurpose)
        except ValidationError as error:
            raise CampaignError(f"{folder} is no rerun of a campaign: {error}") from None
        recorded: dict[int, tuple[Test, Failure | None]] = {}
        drives: dict[int, list[Repeat]] = {}
        for test in sorted(store.tests(with_trajectory=True), key=lambda test: test.id):
            if test.candidate.source is None:
                raise CampaignError(f"{folder} is damaged: test {test.id} has no source")
            number = test.candidate.source.test
            if number not in recorded:
                original_test = original.test(number)
                recorded[number] = original_test, Failure.of_test(original_test)
            before, failure = recorded[number]
            failure_now = Failure.of_test(test) if failure is not None else None
            difference = (
                None if failure is None or failure_now is None else failure.difference(failure_now)
            )
            drives.setdefault(number, []).append(Repeat(before, test, difference))
        parts: Any = store.config
        setting, original_setting = store.setting, original.setting
        is_own = (
            setting.rules == original_setting.rules
            and setting.conditions == original_setting.conditions
            and not any(
                differences(kind, parts[kind], original.config.get(kind))
                for kind in ("driver", "simulator")
            )
        )
        return Rerun(
            Path(source).resolve().name,
            parts["driver"],
            parts["simulator"],
            setting.rules,
            purpose.planned,
            tuple(
                _repeats(recorded[number][0], repeats, purpose.variations, setting.rules, is_own)
                for number, repeats in drives.items()
            ),
            purpose.variations,
            setting.conditions,
            Path(folder),
        )


def _repeats(
    recorded: Test,
    drives: Sequence[Repeat],
    variations: Sequence[Variation],
    rules: Rules,
    is_own: bool,
) -> Repeats:
    """Return the drives of a test; they are the campaign's own if only varied conditions differ."""
    conditions = recorded.candidate.conditions
    varied = [variation.condition for variation in variations]
    is_own &= all(
        without(drive.conditions, *varied, SEED) == without(conditions, *varied, SEED)
        for drive in drives
    )
    ranges = tuple(
        variation.of(recorded_conditions(recorded.candidate, rules)) for variation in variations
    )
    return Repeats(recorded, tuple(drives), ranges, is_own)


def read_reruns(folder: Path | str) -> list[Rerun]:
    """Return the reruns of a campaign, interrupted ones first, the latest last.

    Raises:
        CampaignError: a rerun is damaged.
    """
    reruns = []
    for rerun_folder in rerun_folders(folder):
        with CampaignStore.open(rerun_folder) as store:
            is_rerun = "planned" in purpose_of(store)
        if is_rerun:
            reruns.append(read_rerun(rerun_folder, folder))
    return reruns


def rerun_name(rerun: Rerun, config: Mapping[str, Any]) -> str:
    """Return the name of a rerun's simulator, with driver and conditions unless the campaign's."""
    simulator = part_text(rerun.simulator, config.get("simulator"))
    driver = part_text(rerun.driver, config.get("driver"))
    if dict(rerun.conditions) != (config.get("conditions") or {}):
        words = as_text(rerun.conditions)
        simulator += f" with {words}" if words else " in the usual conditions"
    return simulator if driver == part_text(config.get("driver")) else f"{driver} in {simulator}"


def own_repeats(reruns: Iterable[Rerun]) -> list[Repeats]:
    """Return the most informative repeats of each test with a campaign's own parts.

    Repeats in varied conditions win over others, then more judged drives over fewer, then later
    reruns over earlier ones.

    Args:
        reruns: reruns in the order of `read_reruns`.
    """
    repeats = [
        test
        for rerun in reruns
        for test in rerun.tests
        if test.is_own and test.judged and test.stability is not None
    ]
    # The sort is stable, so the last of equal ones wins.
    repeats.sort(key=lambda test: (bool(test.variations), test.judged))
    return sorted({test.id: test for test in repeats}.values(), key=lambda test: test.id)


def in_other_simulators(reruns: Iterable[Rerun], config: Mapping[str, Any]) -> list[Rerun]:
    """Return the reruns in other simulators than the campaign's, merged by parts and conditions.

    The last judged drives of each test count.
    """
    merged: dict[str, Rerun] = {}
    for rerun in reruns:
        if not differences("simulator", rerun.simulator, config.get("simulator")):
            continue
        before = merged.get(rerun.key)
        tests = {} if before is None else {test.id: test for test in before.tests}
        tests |= {test.id: test for test in rerun.tests if test.judged or test.id not in tests}
        planned = max(rerun.planned, sum(len(test.drives) for test in tests.values()))
        merged[rerun.key] = replace(rerun, planned=planned, tests=tuple(tests.values()))
    return list(merged.values())
