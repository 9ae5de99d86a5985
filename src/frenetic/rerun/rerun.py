"""Rerun: a campaign's roads, driven again; again and again, otherwise, elsewhere, or by another.

The roads lie where they lay, in the conditions that a test of a domain has. With the campaign's own
parts, each drive is the same unless driver or simulator is not repeatable. Conditions vary within
given ranges: the friction of the road, the speed limit, the driver's noise and so on. Another
driver shows what is fixed, another simulator what says something of the driver.

In the same conditions a failure is *repeatable* or *not repeatable*. Where conditions vary it is
*robust* if the same failure is there in at least half of the drives and *fragile* if in less; the
whole 95 % interval must be on one side.
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
from frenetic.conditions.condition import SEED, in_words, without
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.parts.versions import SHORT, comparison_key, differences
from frenetic.rerun.campaigns import How, campaign_again, complete, driven_again, terms_of
from frenetic.rerun.replay import Again, ByTest
from frenetic.rerun.stability import Change, Repeat, Repeats, matches_json, matches_text
from frenetic.rerun.variations import Variation, draw_conditions, own_conditions
from frenetic.simulators.conditions import check_pair_in
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Budget, Spec
from frenetic.spec.part_record import part_text, version_notes

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rerun:
    """Tests of a campaign, driven again with the same parts."""

    campaign: str
    """Name of the folder of the campaign whose roads these are."""
    driver: Mapping[str, JSONValue]
    """In the form of a campaign's description, like the simulator."""
    simulator: Mapping[str, JSONValue]
    rules: Rules
    planned: int
    """Number of planned drives; Ctrl-C leaves fewer."""
    tests: tuple[Repeats, ...]
    """The tests in the order of choice."""
    variations: tuple[Variation, ...] = ()
    """Ranges from which the conditions were drawn."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Conditions of all drives, beside those of each."""
    folder: Path | None = None
    """Folder of the campaign that drove them; None if there was nothing to drive."""

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
        """Number of drives whose outcome and MOOBD are exactly as before."""
        return sum(drive.is_same for drive in self.drives)

    def count(self, change: Change) -> int:
        """Tests with this change."""
        return sum(test.change is change for test in self.tests)

    @property
    def passed(self) -> bool:
        """Whether all were driven again, and all drives passed."""
        good = (Change.PASSES_NOW, Change.PASSES_AGAIN)
        return self.missing == 0 and all(test.change in good for test in self.tests)

    @cached_property
    def key(self) -> str:
        """Digits for simulator, driver, rules and conditions."""
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
        """The rerun as a JSON object, without trajectories."""
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
class _Terms:
    """Entry of a rerun's configuration."""

    digest: str
    planned: int
    variations: tuple[Variation, ...] = ()


def unsaid_rules(store: CampaignStore, spec: Spec) -> Rules | None:
    """The rules of a campaign from Python, with those that a spec says; None for named parts."""
    if store.config.get(SPEC) is not None:
        return None
    return spec.driving_spec(has_roads=True).rules_over(store.setting.rules)


def campaign_tester(store: CampaignStore, spec: Spec) -> RoadTester:
    """Drives a campaign's roads, possibly with other parts; warns of other versions of its own.

    Args:
        store: the campaign.
        spec: its own, possibly with other parts, rules and conditions.

    Raises:
        CampaignError: the campaign's configuration is damaged.
        FreneticError: a part cannot be made.
    """
    setting = store.setting
    terms = replace(spec.terms, map_size=setting.map_size, margin=setting.margin)
    terms = replace(terms, lane_width=setting.lane_width, road_class=setting.road_class)
    terms, rules = replace(terms, domain=setting.domain), unsaid_rules(store, spec)
    tester = RoadTester.of(spec, terms, rules)
    for note in version_notes(store.config, tester.described):
        logger.warning("%s", note)
    return tester


def rerun(folder: Path | str, simulator: Simulator, driver: Driver, **options: Any) -> Rerun:
    """Drives tests of a campaign again on its terms, see `rerun_with` for the options and errors.

    Args:
        folder: of the campaign.
        simulator: any, not yet entered.
        driver: any.
        options: as for `rerun_with`.
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
    **how: Unpack[How],
) -> Rerun:
    """Drives tests of a campaign again, each where it lay on the map, in its own conditions.

    A varied quantity has the same amounts in every test, but for a usual range around a test's own
    amount. An interrupted rerun goes on, a complete one is read.

    Args:
        folder: of the campaign.
        tester: drives, on the campaign's terms or in other conditions; see `campaign_tester`.
        tests: ids; all failures by default, the most severe first.
        times: drives of each.
        vary: ranges of the varied quantities; none by default.
        seed: of the conditions.
        instead: quantities of which the tests' own amounts do not count, since simulator or driver
            have others.
        how: see `How`.

    Raises:
        CampaignError: the campaign is damaged, a test was not driven, or as for
            `frenetic.rerun.campaigns`.
        FreneticError: the simulator cannot vary one of the quantities, a test's own among them.
        ValueError: an option is out of range.
    """
    seed = int(seed)  # which may be numpy's
    instead = sorted(require_list("instead", instead, "quantities"))
    vary = require_list("vary", vary, "variations")
    vary = [
        replace(variation, is_usual=variation.is_usual and variation.quantity not in instead)
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
        road.id: without(own_conditions(road, simulator.rules), *instead) for road in candidates
    }
    # Of tests with the same quantities one stands for all.
    by_quantities = {frozenset(amounts): amounts for amounts in recorded.values()}
    for amounts in ({}, *by_quantities.values()):
        check_pair_in(terms.conditions_of({**amounts, **drawn[0]}), simulator, driver)
    conditions: ByTest = drawn
    if any(
        variation.of(amounts) != variation for variation in vary for amounts in recorded.values()
    ):
        conditions = {
            number: draw_conditions([variation.of(amounts) for variation in vary], times, seed)
            for number, amounts in recorded.items()
        }
    return drive_tests(folder, tester, tests, conditions, variations=vary, instead=instead, how=how)


def drive_tests(
    folder: Path | str,
    tester: RoadTester,
    tests: Iterable[int],
    conditions: ByTest = ({},),
    *,
    variations: Sequence[Variation] = (),
    instead: Iterable[str] = (),
    how: How,
) -> Rerun:
    """The same in given conditions, as `Again` takes them; see `rerun` for the rest."""
    tests = list(dict.fromkeys(tests))
    strategy = Again(folder, tests, conditions, instead)
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
    campaign = campaign_again(
        folder,
        strategy,
        tester,
        Budget(simulations=len(strategy)),
        what=strategy.options,
        terms={
            "planned": len(strategy),
            "variations": to_builtins(tuple(variations)),
        },
        how=how,
    )
    complete(campaign, how)
    return read_rerun(campaign.folder, folder)


def read_rerun(folder: Path | str, source: Path | str) -> Rerun:
    """The rerun in a folder, as far as it came.

    Args:
        folder: of the campaign that drove the roads.
        source: of the campaign whose roads they are.

    Raises:
        CampaignError: one of them is damaged, or roads were not driven again there.
    """
    with CampaignStore.open(folder) as store, CampaignStore.open(source) as original:
        try:
            terms = convert(terms_of(store), _Terms)
        except ValidationError as error:
            raise CampaignError(f"{folder} is no rerun of a campaign: {error}") from None
        recorded: dict[int, tuple[Test, Failure | None]] = {}
        drives: dict[int, list[Repeat]] = {}
        for test in sorted(store.tests(with_trajectory=True), key=lambda test: test.id):
            if test.candidate.source is None:
                raise CampaignError(f"{folder} is damaged: test {test.id} has no source")
            number = test.candidate.source.test
            if number not in recorded:
                own = original.test(number)
                recorded[number] = own, Failure.of_test(own)
            before, failure = recorded[number]
            again = Failure.of_test(test) if failure is not None else None
            difference = None if failure is None or again is None else failure.difference(again)
            drives.setdefault(number, []).append(Repeat(before, test, difference))
        parts: Any = store.config
        setting, own_setting = store.setting, original.setting
        is_alike = setting.rules == own_setting.rules
        is_own = (
            is_alike
            and setting.conditions == own_setting.conditions
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
            terms.planned,
            tuple(
                _repeats(recorded[number][0], repeats, terms.variations, setting.rules, is_own)
                for number, repeats in drives.items()
            ),
            terms.variations,
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
    """The drives of a test, and whether they differ from its campaign's in the variations alone."""
    conditions = recorded.candidate.conditions
    varied = [variation.quantity for variation in variations]
    is_own &= all(
        without(drive.conditions, *varied, SEED) == without(conditions, *varied, SEED)
        for drive in drives
    )
    ranges = tuple(
        variation.of(own_conditions(recorded.candidate, rules)) for variation in variations
    )
    return Repeats(recorded, tuple(drives), ranges, is_own)


def read_reruns(folder: Path | str) -> list[Rerun]:
    """The reruns of a campaign, interrupted ones first, the latest last.

    Raises:
        CampaignError: one of them is damaged.
    """
    found = []
    for place in driven_again(folder):
        with CampaignStore.open(place) as store:
            is_rerun = "planned" in terms_of(store)
        if is_rerun:
            found.append(read_rerun(place, folder))
    return found


def name_of(rerun: Rerun, config: Mapping[str, Any]) -> str:
    """Name of a rerun's simulator, with its driver and conditions if not the campaign's."""
    there = part_text(rerun.simulator, config.get("simulator"))
    driver = part_text(rerun.driver, config.get("driver"))
    if dict(rerun.conditions) != (config.get("conditions") or {}):
        words = in_words(rerun.conditions)
        there += f" with {words}" if words else " in the usual conditions"
    return there if driver == part_text(config.get("driver")) else f"{driver} in {there}"


def own_repeats(reruns: Iterable[Rerun]) -> list[Repeats]:
    """The most informative repeats of each test with a campaign's own parts.

    Those with variations are preferred to those without, those with more judged drives to others,
    and later ones to earlier ones.

    Args:
        reruns: as `read_reruns` gives them.
    """
    own = [
        test
        for one in reruns
        for test in one.tests
        if test.is_own and test.judged and test.stability is not None
    ]
    own.sort(key=lambda test: (bool(test.variations), test.judged))  # stable: the last one counts
    return sorted({test.id: test for test in own}.values(), key=lambda test: test.id)


def elsewhere(reruns: Iterable[Rerun], config: Mapping[str, Any]) -> list[Rerun]:
    """The reruns in other simulators than the campaign's, one of each simulator, driver and rules.

    Of a test's drives with these, the last judged ones count.
    """
    found: dict[object, Rerun] = {}
    for one in reruns:
        if not differences("simulator", one.simulator, config.get("simulator")):
            continue
        before = found.get(one.key)
        tests = {} if before is None else {test.id: test for test in before.tests}
        tests |= {test.id: test for test in one.tests if test.judged or test.id not in tests}
        merged = tuple(tests.values())
        planned = max(one.planned, sum(len(test.drives) for test in merged))
        found[one.key] = replace(one, planned=planned, tests=merged)
    return list(found.values())
