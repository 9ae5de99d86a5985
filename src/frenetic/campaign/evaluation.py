"""The evaluation of a test, as a strategy is told it, live and when its campaign is resumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.record import TestRecord
from frenetic.oracle import Result, judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation, Trace
from frenetic.simulators.drive import Drive, Trajectory

_END: Final = 1e-3  # [s] after the end of a drive, for the rounding of its times


def evaluate(
    candidate: Candidate,
    road: Road | None,
    drive: Drive | None,
    *,
    budget_spent: float = 0.0,
    objective: str | Objective = MOOBD,
) -> Evaluation:
    """The evaluation of a candidate, for whoever asks and tells a strategy without a campaign.

    Args:
        candidate: from the strategy.
        road: the candidate's road as it was driven.
        drive: of that road; None if it is INVALID, so that nothing was driven.
        budget_spent: share of the budget, 0..1, after this drive.
        objective: what the strategy minimises, or its name, see `frenetic.campaign.objective`.

    Raises:
        CampaignError: the objective has no value for the drive.
        FreneticError: the objective cannot be loaded.
    """
    if road is None or drive is None:
        return Evaluation(candidate, Outcome.INVALID, None, budget_spent)
    result = judge(road, drive)
    if not result.outcome.is_driven:
        return Evaluation(candidate, result.outcome, None, budget_spent, duration=result.duration)
    minimised = objective if isinstance(objective, Objective) else Objective.load(objective)
    severity, path = minimised.severity(road, drive), drive.trajectory
    return _told(
        candidate, result, budget_spent, severity, lambda: _trace_of(road, path, result.duration)
    )


def evaluation_of(
    record: TestRecord, read_trajectory: Callable[[], Trajectory | None], objective: Objective
) -> Evaluation:
    """The evaluation of a test.

    Everything follows from what is stored, so it is the same when the campaign is resumed.

    Args:
        record: the test, with its setting.
        read_trajectory: gives its trajectory as it is stored, None if nothing was driven.
        objective: what the strategy minimises.

    Raises:
        CampaignError: the objective has no value for it.
    """
    severity = None
    if record.outcome.is_driven and objective.name != MOOBD:
        drive = replace(record, trajectory=read_trajectory()).drive
        severity = None if drive is None else objective.severity(record.road, drive)
    return _told(
        record.candidate,
        record,
        record.budget_spent,
        severity,
        lambda: _trace(record, read_trajectory()),
    )


def _told(
    candidate: Candidate,
    result: Result | TestRecord,
    budget_spent: float,
    severity: float | None,
    read_trace: Callable[[], Trace | None],
) -> Evaluation:
    departure = result.departure
    return Evaluation(
        candidate,
        result.outcome,
        result.moobd,
        budget_spent,
        place=result.moobd_distance if departure is None else departure.distance,
        side=None if departure is None else departure.side,
        duration=result.duration,
        objective=severity,
        read_trace=read_trace,
    )


def _trace(record: TestRecord, path: Trajectory | None) -> Trace | None:
    if path is None or not record.outcome.is_driven:
        return None
    return _trace_of(record.road, path, record.duration)


def _trace_of(road: Road, path: Trajectory, duration: float | None) -> Trace:
    end = np.inf if duration is None else duration + _END
    n = int(np.searchsorted(path.time, end))
    return Trace.along(road, np.column_stack((path.x[:n], path.y[:n])), path.speed[:n])
