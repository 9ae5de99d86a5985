"""Sample tests and repeats, and the tests of campaigns."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

import numpy as np

from frenetic.campaign import CampaignStore
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import LANE
from frenetic.drivers import Driver
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result, Side
from frenetic.rerun.stability import Repeat
from frenetic.road import Road
from frenetic.search import Candidate, Origin
from frenetic.simulators import Drive, EmbeddedSimulator
from frenetic.simulators.conditions import Conditions


def recorded(
    outcome: Outcome = Outcome.FAIL,
    moobd: float | None = -1.0,
    place: float | None = None,
    side: Side | None = None,
    *,
    id: int = 1,  # noqa: A002
    reason: str = "Car reached",
    duration: float | None = None,
    conditions: Conditions = MappingProxyType({}),
) -> Test:
    """Return a test of a straight road of 230 m; with a `place`, the car leaves its lane there."""
    findings = () if place is None else (Finding(LANE, 1.0, 0.5, side, 5.0, place, 0.0, 0.0),)
    result = Result(outcome, reason, moobd, duration=duration, findings=findings)
    candidate = Candidate(id, np.zeros(24), 10.0, Origin("random"), conditions=dict(conditions))
    return Test(
        candidate=candidate, result=result, result_number=id, budget_spent=0.5, seconds=0.25
    )


def redriven(
    conditions: Conditions,
    outcome: Outcome,
    moobd: float | None,
    place: float | None = None,
    side: Side | None = None,
    *,
    test: Test | None = None,
    difference: float | None = None,
    reason: str = "Car reached",
    duration: float | None = None,
) -> Repeat:
    """Return a repeat of a test, with these results."""
    test = test or recorded()
    rerun = recorded(
        outcome,
        moobd,
        place,
        side,
        id=test.id,
        reason=reason,
        duration=duration,
        conditions=dict(conditions),
    )
    return Repeat(test, rerun, difference)


def driven_in(folder: Path) -> list[Test]:
    """Return the driven tests of a campaign."""
    with CampaignStore.open(folder) as store:
        return [test for test in store.tests() if test.outcome.is_driven]


def failures_in(folder: Path) -> list[Test]:
    """Return the failures of a campaign, the most severe first."""
    with CampaignStore.open(folder) as store:
        return list(store.tests(Outcome.FAIL, order_by="moobd"))


class Counting(EmbeddedSimulator):
    """An embedded simulator that counts its drives."""

    def __init__(self, **options: object) -> None:
        super().__init__(**options)  # type: ignore[arg-type]
        self.driven = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.driven += 1
        return super().drive(road, driver)
