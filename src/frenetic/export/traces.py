"""The trace of a drive: all its signals at the rate of the drive, its lane and its events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import DRIVER, LANE, signal_named
from frenetic.errors import FreneticError
from frenetic.export.column import TableColumn
from frenetic.export.trace_columns import TracedDrive, measure_columns
from frenetic.oracle.drive import CarBody, Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result
from frenetic.road import Road, profile
from frenetic.segments.causes import as_text
from frenetic.segments.evidence import evidence_of_drive

_PLACE: Final = 4  # time, x, y and heading: the columns that say when and where a car was


@dataclass(frozen=True)
class TraceEvent:
    """What happened at one moment of a drive."""

    time: float
    """Simulated time, in s."""
    name: str
    """``mistake``, the first before a failure; ``end``; or the criterion that was breached, such as
    ``lane``."""
    distance: float | None
    """Distance along the road, in m; None if it is unknown."""
    text: str
    """What happened, in words."""


@dataclass(frozen=True, eq=False)
class LaneEdges:
    """Edges of the ego lane as points on the map with their heights, each (k, 3) in m."""

    left: FloatArray
    right: FloatArray

    @classmethod
    def of(cls, road: Road, spacing: float = 1.0) -> LaneEdges:
        """Return the edges of a road's ego lane.

        Args:
            road: the road.
            spacing: largest distance of two points along the road, in m.
        """
        distances = road.distances(spacing)
        left = road.sample(spacing)
        to_right = (road.sample(spacing, -road.lane_width) - left) / road.lane_width
        width = road.lane_width + profile.value_at(road.widening, distances)
        heights = road.heights(distances)
        return cls(
            np.column_stack([left, heights]),
            np.column_stack([left + to_right * width[:, None], heights]),
        )


@dataclass(frozen=True, eq=False)
class DriveTrace:
    """All signals of a drive, from its start to the record that ended it, with its events."""

    columns: tuple[TableColumn, ...]
    """Columns: `TRACE_COLUMNS`, then the others that they name."""
    values: FloatArray
    """Values of the columns, (k, n) for n records; NaN for a missing value."""
    heights: FloatArray
    """Height of the road's centre line beside the car above its start, (n,) in m."""
    events: tuple[TraceEvent, ...]
    """Events, in the order of time."""
    lane: LaneEdges
    """Edges of the ego lane."""
    car: CarBody
    """Box of the car."""
    result: Result
    """Verdict on the drive."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Conditions of the drive."""
    plans: tuple[tuple[float, FloatArray], ...] = ()
    """Time, in s, and points, (m, 2) in m in the car's frame, of each plan of the driver."""

    def __len__(self) -> int:
        """Return the number of records."""
        return len(self.heights)

    def column(self, name: str) -> FloatArray:
        """Return the values of the column with this name, (n,).

        Raises:
            KeyError: no column has this name.
        """
        names = [column.name for column in self.columns]
        if name not in names:
            raise KeyError(f"a trace has no column {name!r}: it has {', '.join(names)}")
        values: FloatArray = self.values[names.index(name)]
        return values


def trace_of(
    road: Road,
    drive: Drive,
    result: Result,
    conditions: Mapping[str, float] = MappingProxyType({}),
) -> DriveTrace:
    """Return the trace of a drive.

    Records after the one that ended the drive are left out, and so is a record with the time of the
    record before.

    Args:
        road: the road that was driven.
        drive: the drive.
        result: verdict on the drive.
        conditions: conditions of the drive.

    Raises:
        FreneticError: the drive has no records, or a signal of another package raised an error.
    """
    drive = replace(drive, trajectory=_until_unknown(drive.trajectory))
    if not has_records(drive.trajectory):
        raise FreneticError("the drive has no records: there is nothing to trace")
    traced = TracedDrive.of(road, drive)
    columns, values = measure_columns(traced, conditions)
    return DriveTrace(
        columns=columns,
        values=values,
        heights=road.heights(traced.located.distance),
        events=_events(road, drive, result, float(traced.located.path.time[-1])),
        lane=LaneEdges.of(road),
        car=drive.car,
        result=result,
        conditions=dict(conditions),
        plans=() if drive.notes is None else tuple(drive.notes.plans()),
    )


def trace_of_test(test: Test) -> DriveTrace:
    """Return the trace of a campaign's test, from its stored trajectory.

    Raises:
        CampaignError: the campaign does not record the car.
        FreneticError: the test was not driven, or a signal of another package raised an error.
    """
    if test.drive is None or test.setting is None or not has_records(test.trajectory):
        raise FreneticError(
            f"test {test.id} is {test.outcome} and has no trajectory: there is nothing to trace"
        )
    conditions = test.setting.conditions_of(test.candidate.conditions)
    return trace_of(test.road, test.drive, test.result, conditions)


def has_records(trajectory: Trajectory | None) -> bool:
    """Return whether a trajectory has a first record whose time and place are numbers."""
    if trajectory is None or not len(trajectory):
        return False
    return bool(np.isfinite(trajectory.block[:_PLACE, 0]).all())


def _until_unknown(path: Trajectory) -> Trajectory:
    """Return the records before the first one whose time or place is no number."""
    is_known = np.isfinite(path.block[:_PLACE]).all(axis=0)
    if is_known.all():
        return path
    return Trajectory.from_rows(path.to_rows()[: int(is_known.argmin())])


def _events(road: Road, drive: Drive, result: Result, last_time: float) -> tuple[TraceEvent, ...]:
    """Return the events of a drive, in the order of time; its end comes last."""
    events = [
        TraceEvent(finding.time, finding.criterion, finding.distance, _breach_text(finding, result))
        for finding in result.findings
    ]
    if result.outcome is Outcome.FAIL:
        with np.errstate(all="ignore"):  # another simulator's records may be no numbers
            evidence = evidence_of_drive(road, drive, result)
        if evidence is not None:
            text = f"{as_text(*evidence.cause)}: {evidence.text}"
            events.append(TraceEvent(evidence.time, "mistake", evidence.place, text))
    time = last_time if result.duration is None else result.duration
    end = TraceEvent(time, "end", result.distance, f"{result.outcome}: {result.reason}")
    return (*sorted(events, key=lambda event: event.time), end)


def _breach_text(finding: Finding, result: Result) -> str:
    """Return a breach of a criterion in words."""
    if finding.criterion == DRIVER:
        return result.reason
    if finding.criterion == LANE:
        return f"leaves its lane to the {finding.side}"
    signal = signal_named(finding.criterion)
    side = f" to the {finding.side}" if finding.side else ""
    limit = f"the limit is {finding.limit:g} {signal.unit}"
    return f"{signal.words} {signal.text(finding.value)}{side}; {limit}"
