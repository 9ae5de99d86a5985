"""A twin: a driver in a fast simulator, which drives on where the rules end a drive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, Self

from frenetic.campaign.objective import MOOBD, Objective, evaluate
from frenetic.campaign.tester import RoadTester
from frenetic.drive import Drive, Rules
from frenetic.errors import CampaignError, reason_of
from frenetic.oracle import Result, judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation
from frenetic.spec import Spec

_WHOLE: Final = 0.999
"""Oob tolerance with which a drive ends when the whole car has left its lane."""


@dataclass(frozen=True)
class Twin:
    """A driver in a fast simulator; a context manager: within it, its simulator is there."""

    tester: RoadTester
    rules: Rules
    """The rules by which its drives are judged."""

    @classmethod
    def of(cls, spec: Spec) -> Self:
        """The twin of a spec.

        Raises:
            FreneticError: driver or simulator cannot be made.
        """
        tolerance = max(_WHOLE, spec.rules.oob_tolerance)
        to_the_end = replace(spec, rules=replace(spec.rules, oob_tolerance=tolerance))
        driver, simulator = to_the_end.make_parts(isolate=True)
        tester = RoadTester(simulator, driver, spec.map_size, spec.margin, spec.lane_width)
        return cls(tester, spec.rules)

    def __enter__(self) -> Self:
        """Starts the simulator.

        Raises:
            CampaignError: it does not start.
        """
        try:
            self.tester.simulator.__enter__()
        except Exception as error:
            raise CampaignError(f"the twin does not start: {reason_of(error)}") from error
        return self

    def __exit__(self, *raised: Any) -> None:
        """Ends the simulator."""
        self.tester.simulator.__exit__(*raised)

    def placed(self, road: Road) -> tuple[Road | None, str]:
        """A road in its place on the map; None and the reason if it is INVALID."""
        fitted, verdict = road.placed(self.tester.map_size, self.tester.margin)
        if fitted is None or not verdict.valid:
            return None, verdict.message
        return fitted, ""

    def drive(self, road: Road) -> tuple[Drive, Result]:
        """The whole drive along a road in its place, and the verdict by the rules."""
        drive = self.tester.drive(road)
        return drive, judge(road, replace(drive, rules=self.rules))

    def evaluation(
        self, candidate: Candidate, budget_spent: float, objective: str | Objective = MOOBD
    ) -> Evaluation:
        """The evaluation of a candidate, as a strategy is told it."""
        road, verdict = self.tester.fitted(candidate)
        if road is None or not verdict.valid:
            return Evaluation(candidate, Outcome.INVALID, None, budget_spent)
        drive = replace(self.tester.drive(road), rules=self.rules)
        return evaluate(candidate, road, drive, budget_spent=budget_spent, objective=objective)
