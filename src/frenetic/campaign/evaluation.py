"""The evaluation of a test, as a strategy is told it, live and when its campaign is resumed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.record import TestRecord
from frenetic.search.records import Evaluation, Trace
from frenetic.simulators.drive import Trajectory

_END: Final = 1e-3  # [s] after the end of a drive, for the rounding of its times


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
    departure = record.departure
    return Evaluation(
        record.candidate,
        record.outcome,
        record.moobd,
        record.budget_spent,
        place=record.moobd_distance if departure is None else departure.distance,
        side=None if departure is None else departure.side,
        duration=record.duration,
        objective=severity,
        read_trace=lambda: _trace(record, read_trajectory()),
    )


def _trace(record: TestRecord, path: Trajectory | None) -> Trace | None:
    if path is None or not record.outcome.is_driven:
        return None
    end = np.inf if record.duration is None else record.duration + _END
    n = int(np.searchsorted(path.time, end))
    return Trace.along(record.road, np.column_stack((path.x[:n], path.y[:n])), path.speed[:n])
