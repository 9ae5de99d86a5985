"""Study the stability of failures: drive them again as they were, with less grip and with more.

Each failure of a campaign is driven three times on its road, at its pose and in its conditions: in
the friction that it had, and with `frenetic.analysis.failure_stability.GRIP_CHANGE` less and more.
The drives are a campaign, as in a rerun: the same call continues an interrupted study, and
reads a complete one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Unpack

from msgspec import to_builtins

from frenetic._support.arrays import evenly
from frenetic._support.bounds import require_count
from frenetic._support.files import require_list
from frenetic._support.json_value import JSONValue
from frenetic.analysis.failure_stability import (
    STABILITY,
    FailureStability,
    FurtherDrive,
    Grip,
    StudiedFailure,
    cause_without_side,
)
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import condition_named, without
from frenetic.drivers import Driver
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.campaigns import DrivingOptions
from frenetic.rerun.replay import ReplayRoads, drive_replays, keep_fact, recorded_test
from frenetic.rerun.rerun import tester_on_terms
from frenetic.rerun.reruns import is_own_setup
from frenetic.simulators.conditions import Conditions, check_can_vary, check_pair_in, own_amount
from frenetic.simulators.simulator import Simulator

FRICTION: Final = "friction"
"""Name of the condition that is the grip."""


@dataclass(frozen=True)
class StabilityStudy:
    """Failures of a campaign that were driven again, all with the same parts."""

    campaign: str
    """Name of the folder of the campaign whose failures these are."""
    driver: Mapping[str, JSONValue]
    """Driver, as `frenetic.spec.part_record.describe` records it."""
    simulator: Mapping[str, JSONValue]
    """Simulator, as `frenetic.spec.part_record.describe` records it."""
    failures: tuple[StudiedFailure, ...]
    """Failures with their further drives, in the order of their ids."""
    is_own: bool
    """Whether driver, simulator, rules and conditions are the campaign's."""
    folder: Path | None = None
    """Folder of the campaign that drove the roads; None if there was nothing to drive."""

    @property
    def missing(self) -> int:
        """Number of drives that Ctrl-C prevented."""
        return sum(len(Grip) - len(failure.drives) for failure in self.failures)

    @cached_property
    def stability(self) -> FailureStability:
        """Counts of the failures that fail again and keep their cause, for all and by cause."""
        return FailureStability.of(self.failures)

    @property
    def passing_with_more_grip(self) -> list[int]:
        """Ids of the failures that pass with more grip."""
        return [failure.id for failure in self.failures if failure.passes(Grip.MORE)]

    def as_json(self) -> dict[str, JSONValue]:
        """Return the study as a JSON object."""
        return {
            "campaign": self.campaign,
            "folder": None if self.folder is None else str(self.folder),
            "driver": dict(self.driver),
            "simulator": dict(self.simulator),
            "is_own": self.is_own,
            "missing": self.missing,
            "stability": self.stability.as_json(),
            "passing_with_more_grip": list(self.passing_with_more_grip),
        }


def study_stability(
    folder: Path | str, simulator: Simulator, driver: Driver, **options: Any
) -> StabilityStudy:
    """Study the stability of a campaign's failures, on the campaign's terms.

    Args:
        folder: folder of the campaign.
        simulator: simulator of the campaign, not yet entered.
        driver: driver of the campaign.
        options: options of `study_stability_with`.

    Raises:
        CampaignError: see `study_stability_with`.
        FreneticError: see `study_stability_with`.
        ValueError: an option is out of range.
    """
    return study_stability_with(folder, tester_on_terms(folder, simulator, driver), **options)


def study_stability_with(
    folder: Path | str,
    tester: RoadTester,
    *,
    tests: Iterable[int] | None = None,
    most: int | None = None,
    instead: Iterable[str] = (),
    **options: Unpack[DrivingOptions],
) -> StabilityStudy:
    """Study the stability of a campaign's failures.

    The campaign keeps the counts of its largest study as a fact, which `frenetic show`, the report
    and comparisons read. A study with other parts or conditions than the campaign's, or in a folder
    of its own (``out``), leaves no fact.

    Args:
        folder: folder of the campaign.
        tester: drives on the campaign's terms, see `frenetic.rerun.rerun.campaign_tester`.
        tests: ids of failed tests; by default all failures, without repeated roads.
        most: most failures to drive, evenly spaced among the tests; None for all.
        instead: conditions whose recorded amounts are ignored, because the simulator or the driver
            has other amounts of these conditions.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: the campaign is damaged, a test did not fail, or see
            `frenetic.rerun.campaigns.driving_campaign`.
        FreneticError: the simulator cannot vary the friction, does not say its friction, or cannot
            have a little less or more; or it lacks a recorded condition.
        ValueError: an option is out of range.
    """
    instead = sorted(require_list("instead", instead, "conditions"))
    check_can_vary(tester.simulator, [FRICTION])
    with CampaignStore.open(folder) as store:
        ids = _chosen(store, tests, most)
        candidates = [store.test(number, with_trajectory=False).candidate for number in ids]
        is_own = is_own_setup(tester.described, tester.setting, store)
    recorded = {road.id: without(road.conditions, *instead) for road in candidates}
    is_own = is_own and all(recorded[road.id] == road.conditions for road in candidates)
    conditions = {number: _in_each_grip(amounts, tester) for number, amounts in recorded.items()}
    # Of tests with the same conditions, whatever their amounts, one is checked.
    for amounts in {frozenset(amounts): amounts for amounts in recorded.values()}.values():
        check_pair_in(tester.terms.conditions_of(amounts), tester.simulator, tester.driver)
    studied, driving_folder = (
        _drive(folder, tester, ReplayRoads(folder, ids, conditions, instead), options)
        if ids
        else ((), None)
    )
    study = StabilityStudy(
        Path(folder).resolve().name,
        tester.described["driver"],
        tester.described["simulator"],
        studied,
        is_own,
        driving_folder,
    )
    has_all = bool(ids) or tests is None
    if is_own and has_all and not study.missing and options.get("out") is None:
        _keep(folder, study.stability)
    return study


def _chosen(store: CampaignStore, tests: Iterable[int] | None, most: int | None) -> Sequence[int]:
    """Return the ids of the failures to drive. See `study_stability_with` for the arguments."""
    if tests is None:
        ids = [test.id for test in store.tests(Outcome.FAIL, with_repeats=False)]
    else:
        ids = list(dict.fromkeys(require_list("tests", tests, "ids of tests")))
        for number in ids:
            outcome = store.test(number, with_trajectory=False).outcome
            if outcome is not Outcome.FAIL:
                raise CampaignError(f"test {number} is {outcome}: only failures are studied")
    return ids if most is None else [ids[i] for i in evenly(len(ids), require_count("most", most))]


def _in_each_grip(recorded: Conditions, tester: RoadTester) -> list[dict[str, float]]:
    """Return what differs from a test's conditions in the drive in each grip.

    Args:
        recorded: conditions that the test recorded.
        tester: the tester, which has the friction unless the test recorded it.

    Raises:
        FreneticError: the simulator does not say its friction, or a friction is not allowed.
    """
    friction = tester.terms.conditions_of(recorded).get(FRICTION)
    if friction is None:
        friction = own_amount(tester.simulator, FRICTION)
    if friction is None:
        raise FreneticError(
            f"{type(tester.simulator).__name__} does not say its friction: set it, as in"
            f" --with {FRICTION}=1"
        )
    drives: list[dict[str, float]] = []
    for grip in Grip:
        try:
            amount = condition_named(FRICTION).require(friction * grip.factor)
        except ValueError as error:
            raise FreneticError(f"a failure cannot be driven {grip}: {error}") from None
        drives.append({} if grip is Grip.AGAIN else {FRICTION: amount})
    return drives


def _drive(
    folder: Path | str, tester: RoadTester, strategy: ReplayRoads, options: DrivingOptions
) -> tuple[tuple[StudiedFailure, ...], Path]:
    """Make the drives of a study that are missing; return the failures and the drives' folder."""
    driving_folder = drive_replays(folder, tester, strategy, STABILITY, options)
    drives: dict[int, dict[Grip, FurtherDrive]] = {
        number: {} for number in strategy.options["tests"]
    }
    with CampaignStore.open(driving_folder) as store:
        for test in store.tests(with_segments=True):
            grip = tuple(Grip)[test.candidate.repeat]
            drive = FurtherDrive(test.outcome, cause_without_side(test))
            drives[recorded_test(store, test)][grip] = drive
    with CampaignStore.open(folder) as original:
        causes = {
            test.id: cause_without_side(test)
            for test in original.tests(Outcome.FAIL, with_segments=drives)
        }
    numbers = sorted(drives)
    studied = tuple(StudiedFailure(number, causes[number], drives[number]) for number in numbers)
    return studied, driving_folder


def _keep(folder: Path | str, stability: FailureStability) -> None:
    """Keep the counts of a study as a fact of its campaign, unless a larger study left them.

    If the campaign cannot be written, for example because it is searching, a warning is logged.
    """
    fact: JSONValue = to_builtins(stability)
    with CampaignStore.open(folder) as store:
        known = FailureStability.read(store.facts)
        is_kept = store.facts.get(STABILITY) == fact
    if is_kept or (known is not None and known.total.failures > stability.total.failures):
        return
    warning = "the campaign does not show its stability: %s; then repeat the study"
    keep_fact(folder, STABILITY, fact, warning=warning)
