"""The strategy that drives another campaign's roads again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Final, TypeAlias

from frenetic._support.files import require_list
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import without
from frenetic.errors import CampaignError
from frenetic.road import profile
from frenetic.search.records import Candidate, Evaluation, Origin, SourceTest
from frenetic.search.strategy import Ledger, SearchEnded, Strategy
from frenetic.simulators.conditions import check_conditions

OPERATOR: Final = "again"
"""Operator in the origin of roads that are driven again."""

ByTest: TypeAlias = Sequence[Mapping[str, float]] | Mapping[int, Sequence[Mapping[str, float]]]
"""Conditions of each drive of a test: all tests alike, or by their ids."""


class Again(Strategy):
    """Proposes the roads of a campaign's tests, each once in each of some conditions.

    Args:
        campaign: its folder.
        tests: ids of the tests; they have to be driven ones.
        conditions: of each drive of a test, by the names of `frenetic.conditions`, as far as they
            differ from the test's own; all tests alike, or by their ids. By default one drive in
            the test's own conditions.
        instead: quantities of which the tests' own amounts do not count, since driver or simulator
            have others.

    Raises:
        CampaignError: there is no such campaign or test, it is damaged, or a test was not driven.
        ValueError: conditions are none.
    """

    BEHAVIOUR: Final = 1
    expects_failures: ClassVar[bool] = True

    def __init__(
        self,
        campaign: Path | str,
        tests: Iterable[int],
        conditions: ByTest = ({},),
        instead: Iterable[str] = (),
    ) -> None:
        tests = list(tests)
        by_test: dict[int, list[dict[str, float]]] = {}
        for number in tests:
            own = conditions[number] if isinstance(conditions, Mapping) else conditions
            by_test[number] = [dict(one) for one in own]
        for one in chain(*by_test.values()):
            check_conditions(one)
        with CampaignStore.open(campaign) as store:
            roads = [_driven(store, number) for number in tests]
            made_at = store.fact("created_at")
        instead = require_list("instead", instead, "quantities")
        instead = sorted(name for name in instead if any(name in one.conditions for one in roads))
        self._campaign = str(campaign)
        self.options: Mapping[str, Any] = {
            "made_at": made_at,  # the campaign may be moved, and be named from elsewhere
            "tests": tests,
            "conditions": {str(number): own for number, own in by_test.items()}
            if isinstance(conditions, Mapping)
            else [dict(one) for one in conditions],
            **({"instead": instead} if instead else {}),
        }
        drives = [
            (road, i, {**without(road.conditions, *instead), **one})
            for road in roads
            for i, one in enumerate(by_test[road.id])
        ]
        self._count = len(drives)
        self._drives = iter(drives)
        self._ledger = Ledger()

    def __len__(self) -> int:
        """Number of drives in all."""
        return self._count

    def ask(self) -> Candidate:
        """The next road; raises `SearchEnded` after the last."""
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
        """Takes the result of a candidate.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        self._ledger.settle(evaluation)


def _driven(store: CampaignStore, number: int) -> Candidate:
    test = store.test(number, with_trajectory=False)
    if not test.outcome.is_simulated:
        raise CampaignError(
            f"test {number} is {test.outcome}: only a road that was driven can be driven again"
        )
    return test.candidate
