"""Evaluations of tests for strategies, while a campaign runs and when it is resumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.record import Test
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation, Trace

_TIME_ROUNDING: Final = 1e-3
"""Time after a drive's end at which a record still belongs to the drive, in s: stored times are
rounded (our choice)."""


def evaluate(
    candidate: Candidate,
    road: Road | None,
    drive: Drive | None,
    *,
    budget_spent: float = 0.0,
    objective: str | Objective = MOOBD,
) -> Evaluation:
    """Return the evaluation of a candidate, for asking and telling without a campaign.

    Args:
        candidate: candidate that the strategy proposed.
        road: the candidate's road as it was driven; None for an INVALID road.
        drive: drive along the road; None for an INVALID road, which nobody drove.
        budget_spent: spent share of the budget after this drive, from 0 to 1.
        objective: objective of the strategy, or its name, see `frenetic.campaign.objective`.

    Raises:
        CampaignError: the objective has no value for the drive.
        FreneticError: the objective cannot be loaded.
    """
    if road is None or drive is None:
        return Evaluation(candidate, Outcome.INVALID, None, budget_spent)
    result = judge(road, drive)
    if not result.outcome.is_driven:
        return Evaluation(candidate, result.outcome, None, budget_spent, duration=result.duration)
    if not isinstance(objective, Objective):
        objective = Objective.load(objective)
    fitness, path = objective.fitness(road, drive), drive.trajectory
    return _evaluation(
        candidate,
        result,
        budget_spent,
        fitness=fitness,
        place=None if fitness is None else objective.place(road, drive),
        read_trace=lambda: _trace_along(road, path, result.duration),
    )


def evaluation_of(
    test: Test, read_trajectory: Callable[[], Trajectory | None], objective: Objective
) -> Evaluation:
    """Return the evaluation of a test.

    The evaluation follows from stored values alone, so it is the same when the campaign is resumed.

    Args:
        test: the test, with its setting.
        read_trajectory: function that returns the stored trajectory, or None if nothing was driven.
        objective: objective of the strategy.

    Raises:
        CampaignError: the objective has no value for the test.
    """
    fitness = place = None
    if test.outcome.is_driven and objective.name != MOOBD:
        drive = replace(test, trajectory=read_trajectory()).drive
        if drive is not None:
            fitness = objective.fitness(test.road, drive)
            place = objective.place(test.road, drive)
    return _evaluation(
        test.candidate,
        test.result,
        test.budget_spent,
        fitness=fitness,
        place=place,
        read_trace=lambda: _trace_of(test, read_trajectory()),
    )


def _evaluation(
    candidate: Candidate,
    result: Result,
    budget_spent: float,
    *,
    fitness: float | None,
    place: float | None,
    read_trace: Callable[[], Trace | None],
) -> Evaluation:
    """Return the evaluation of a candidate with this result.

    Args:
        candidate: the candidate.
        result: verdict on its drive.
        budget_spent: spent share of the budget, from 0 to 1.
        fitness: value that the strategy minimises; None for the MOOBD.
        place: where along the road that value was reached, in m; None for the place of the MOOBD.
        read_trace: function that returns the drive's trace.
    """
    return Evaluation(
        candidate,
        result.outcome,
        result.moobd,
        budget_spent,
        finding=result.finding,
        worst_place=result.moobd_distance if place is None else place,
        duration=result.duration,
        fault=result.fault,
        objective=fitness,
        read_trace=read_trace,
    )


def _trace_of(test: Test, path: Trajectory | None) -> Trace | None:
    """Return the trace of a test's trajectory; None if nothing was driven."""
    if path is None or not test.outcome.is_driven:
        return None
    if test.segment is not None:  # its drive has been followed along the road already
        assessment, count = test.segment.assessment, _record_count(path, test.result.duration)
        if len(assessment.distance) >= count:
            distance, offset = assessment.distance[:count], assessment.lateral_offset[:count]
            return Trace(distance, offset, path.speed[:count], path)
    return _trace_along(test.road, path, test.result.duration)


def _trace_along(road: Road, path: Trajectory, duration: float | None) -> Trace:
    """Return the trace of a trajectory up to the end of its drive, which takes `duration` s."""
    n = _record_count(path, duration)
    return Trace.along(road, np.column_stack((path.x[:n], path.y[:n])), path.speed[:n], path)


def _record_count(path: Trajectory, duration: float | None) -> int:
    """Return the number of records up to the end of a drive, which takes `duration` s."""
    end = np.inf if duration is None else duration + _TIME_ROUNDING
    return int(np.searchsorted(path.time, end))
