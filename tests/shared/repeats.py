"""Tests as campaigns record them, and drives of their roads, made up."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import MappingProxyType

import numpy as np

from frenetic.again.campaigns import FOLDER
from frenetic.again.verdicts import Repeat
from frenetic.campaign.record import Attempt, Test
from frenetic.oracle import LANE, Finding, Result, Side
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Origin
from frenetic.simulators.worlds import Conditions


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
    """A test of a straight road of 230 m; the car leaves its lane at a place, if one is given."""
    findings = () if place is None else (Finding(LANE, 1.0, 0.5, side, 5.0, place, 0.0, 0.0),)
    result = Result(outcome, reason, moobd, duration=duration, findings=findings)
    candidate = Candidate(id, np.zeros(24), 10.0, Origin("random"), conditions=dict(conditions))
    attempt = Attempt(id, result, seconds=0.25)
    return Test(candidate=candidate, attempt=attempt, told=id, budget_spent=0.5)


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
    """A drive of a test's road."""
    test = test or recorded()
    again = recorded(
        outcome,
        moobd,
        place,
        side,
        id=test.id,
        reason=reason,
        duration=duration,
        conditions=dict(conditions),
    )
    return Repeat(test, again, difference)


def forget_reruns(folder: Path) -> None:
    """Removes all campaigns that drove a campaign's roads again."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
