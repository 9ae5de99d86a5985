"""Drives of another campaign's roads: the strategy that proposes them, and studies made of them."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Final, TypeAlias

from frenetic._support.files import require_list
from frenetic._support.json_value import JSONValue
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import without
from frenetic.errors import CampaignError
from frenetic.rerun.campaigns import DrivingOptions, DrivingPlan, drive_missing, driving_campaign
from frenetic.road import profile
from frenetic.search.records import Candidate, Evaluation, Origin, SourceTest
from frenetic.search.strategy import Ledger, SearchEnded, Strategy
from frenetic.simulators.conditions import check_conditions
from frenetic.spec import Budget

logger = logging.getLogger(__name__)

OPERATOR: Final = "replay"
"""Operator in the origin of roads that are driven again."""

DriveConditions: TypeAlias = (
    Sequence[Mapping[str, float]] | Mapping[int, Sequence[Mapping[str, float]]]
)
"""Conditions of the drives of a test, one mapping for each drive: the same for all tests, or by the
tests' ids."""


class ReplayRoads(Strategy):
    """Strategy that proposes the roads of a campaign's tests, once in each of several conditions.

    Args:
        campaign: folder of the campaign.
        tests: ids of the campaign's tests, which must have been driven.
        conditions: condition -> amount for each drive of a test, where the drive differs from the
            test's recorded conditions. By default one drive in the recorded conditions.
        instead: conditions whose recorded amounts are ignored, because the driver or the simulator
            has other amounts of these conditions.

    Raises:
        CampaignError: the campaign or a test does not exist, the campaign is damaged, or a test was
            not driven.
        ValueError: a condition is unknown or not a finite number.
    """

    BEHAVIOUR: Final = 1
    expects_failures: ClassVar[bool] = True

    def __init__(
        self,
        campaign: Path | str,
        tests: Iterable[int],
        conditions: DriveConditions = ({},),
        instead: Iterable[str] = (),
    ) -> None:
        tests = list(tests)
        by_test: dict[int, list[dict[str, float]]] = {}
        for test in tests:
            test_conditions = conditions[test] if isinstance(conditions, Mapping) else conditions
            by_test[test] = [dict(amounts) for amounts in test_conditions]
        for amounts in chain(*by_test.values()):
            check_conditions(amounts)
        with CampaignStore.open(campaign) as store:
            roads = [_driven_candidate(store, test) for test in tests]
            created_at = store.fact("created_at")
        instead = require_list("instead", instead, "conditions")
        instead = sorted(name for name in instead if any(name in road.conditions for road in roads))
        self._campaign = str(campaign)
        self.options: Mapping[str, Any] = {
            "made_at": created_at,  # identifies the campaign, whose path may change
            "tests": tests,
            "conditions": {str(test): amounts for test, amounts in by_test.items()}
            if isinstance(conditions, Mapping)
            else [dict(amounts) for amounts in conditions],
            **({"instead": instead} if instead else {}),
        }
        drives = [
            (road, repeat, {**without(road.conditions, *instead), **amounts})
            for road in roads
            for repeat, amounts in enumerate(by_test[road.id])
        ]
        self._count = len(drives)
        self._drives = iter(drives)
        self._ledger = Ledger()

    def __len__(self) -> int:
        """Return the number of drives that are proposed in all."""
        return self._count

    def ask(self) -> Candidate:
        """Return the next road.

        Raises:
            SearchEnded: all roads were proposed.
        """
        drive = next(self._drives, None)
        if drive is None:
            raise SearchEnded("every road was driven again")
        road, repeat, conditions = drive
        return self._ledger.issue(
            road.curvatures,
            road.step,
            Origin(OPERATOR),
            road.points,
            conditions=conditions,
            repeat=repeat,
            source=SourceTest(self._campaign, road.id),
            **{name: getattr(road, name) for name in profile.NAMES},
        )

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result of a candidate.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        self._ledger.settle(evaluation)


def _driven_candidate(store: CampaignStore, number: int) -> Candidate:
    """Return the candidate of a test.

    Raises:
        CampaignError: the test was not driven.
    """
    test = store.test(number, with_trajectory=False)
    if not test.outcome.is_simulated:
        raise CampaignError(
            f"test {number} is {test.outcome}: only a road that was driven can be driven again"
        )
    return test.candidate


def recorded_test(store: CampaignStore, test: Test) -> int:
    """Return the id of the recorded test whose road a test of a campaign drives again.

    Raises:
        CampaignError: the test does not say which.
    """
    if test.candidate.source is None:
        raise CampaignError(f"{store.folder} is damaged: test {test.id} has no source")
    return test.candidate.source.test


def drive_replays(
    folder: Path | str,
    tester: RoadTester,
    roads: ReplayRoads,
    purpose: str,
    options: DrivingOptions,
) -> Path:
    """Make the drives of a study that are missing, and return the folder of its campaign.

    Args:
        folder: folder of the campaign whose tests are studied.
        tester: drives the roads.
        roads: all drives of the study.
        purpose: name of the study, in the configuration of its campaign.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: see `frenetic.rerun.campaigns.driving_campaign`.
    """
    plan = DrivingPlan(
        roads,
        Budget(simulations=len(roads)),
        identity=roads.options,
        purpose={purpose: True},
    )
    campaign = driving_campaign(folder, plan, tester, options)
    drive_missing(campaign, options.get("on_event"))
    return campaign.folder


def keep_fact(folder: Path | str, name: str, fact: JSONValue, *, warning: str) -> None:
    """Keep what a study found as a fact of its campaign.

    If the campaign cannot be written, for example because it is searching, the warning is logged,
    in which ``%s`` stands for the reason.
    """
    try:
        with CampaignStore.open(folder, readonly=False) as store:
            store.keep(**{name: fact})
    except CampaignError as error:
        logger.warning(warning, error)
