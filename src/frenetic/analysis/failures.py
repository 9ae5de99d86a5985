"""Failures: road and drive before the place of departure, as they are compared and described.

Two failures are laid over each other so that the places and directions of the road where the car
left its lane coincide; `frenetic.search.approach` defines their *difference* in metres. The road
further than 15 m ahead does not count: the car never got there, and with it the clusters of a
campaign and of its half were less alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.bends import place_text
from frenetic.analysis.causes import Cause, Kind, as_text, cause_of
from frenetic.analysis.segments import Segment, segment_of_test
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.criteria.criterion import EDGE_DISTANCE
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, Side
from frenetic.road import LANE_WIDTH
from frenetic.search.approach import (
    ROAD_SIZE,
    STATES,
    as_vector,
    road_around,
    states_before,
)
from frenetic.search.records import Trace

_SLOWS: Final = 3.0  # [m/s] least loss of speed up to the place that is mentioned; ours


@dataclass(frozen=True, eq=False)
class Failure:
    """Part of a failure that is compared: road and drive, relative to the place of departure."""

    id: int
    """Id of the test."""
    moobd: float
    """Minimum oob distance, in m."""
    side: Side | None
    """Side of the lane on which the car left; None if it failed without leaving."""
    curvatures: FloatArray
    """Curvatures of the whole road, (n,) in 1/m."""
    step: float
    """Distance between two curvatures, in m."""
    place: float
    """Place of the departure, in m along the road."""
    road: FloatArray
    """Centre line, (19, 2) in m, every 2.5 m from 30 m before the place to 15 m after it: x ahead,
    y to the left of the road at the place."""
    offsets: FloatArray
    """Lateral offset to the left, (13,) in m, every 2.5 m over the 30 m before the place."""
    speeds: FloatArray
    """Speeds, (13,) in m/s, at the same places as `offsets`."""
    is_near_miss: bool = False
    """Whether the test passed. Then the place is where its MOOBD is, on the side of that edge."""
    lane_width: float = LANE_WIDTH
    """Width of the lane, in m."""
    fault: Fault | None = None
    """Fault of the driver that ended the drive. Without records, all arrays hold zeros."""
    cause: Cause | None = None
    """Cause of the failure; None for a fault or a near miss."""
    criterion: str | None = None
    """Criterion that the drive exceeded, see `frenetic.oracle.Finding`; None if it stood still."""

    @classmethod
    def of(
        cls,
        segment: Segment,
        *,
        id: int,  # noqa: A002
        moobd: float,
        is_near_miss: bool = False,
        fault: Fault | None = None,
    ) -> Failure:
        """Return the failure of a failed test, or the near miss of a passing one."""
        road, place, assessment = segment.road, segment.place, segment.assessment
        speed = segment.drive.trajectory.speed[: len(assessment.distance)]
        side = segment.side
        if is_near_miss:
            nearest = int(np.argmin(assessment.oob_distance))
            side = "left" if assessment.lateral_offset[nearest] > 0.0 else "right"
        return cls(
            id,
            moobd,
            side,
            road.curvatures,
            road.step,
            place,
            road_around(road.table, road.sub_step, place),
            *states_before(Trace(assessment.distance, assessment.lateral_offset, speed), place),
            is_near_miss,
            road.lane_width,
            fault,
            None if is_near_miss or fault is not None else cause_of(segment),
            segment.criterion,
        )

    @classmethod
    def of_segment(
        cls,
        segment: Segment | None,
        result: Result,
        id: int = 0,  # noqa: A002
    ) -> Failure | None:
        """Return the failure of a drive that was judged FAIL.

        None without records, unless a fault ended the drive.
        """
        fault = result.fault
        if segment is not None:
            return cls.of(segment, id=id, moobd=result.moobd or 0.0, fault=fault)
        if fault is None:
            return None
        line, states = np.zeros((ROAD_SIZE // 2, 2)), np.zeros(STATES)
        return cls(id, 0.0, None, np.zeros(2), 1.0, 0.0, line, states, states, fault=fault)

    @classmethod
    def of_test(cls, record: Test) -> Failure | None:
        """Return the failure of a stored test; None if it did not fail or has no trajectory."""
        if record.outcome is not Outcome.FAIL:
            return None
        return cls.of_segment(segment_of_test(record), record.result, record.id)

    def difference(self, other: Failure) -> float:
        """Return the difference from another failure in m, whatever the sides."""
        return float(np.linalg.norm(self.vector() - other.vector()))

    def vector(self) -> FloatArray:
        """Return the vector of the failure, (64,) in m, whose distances are the differences."""
        return as_vector(self.road, self.offsets, self.speeds)


def failures_of(store: CampaignStore, limit: int | None = None) -> list[Failure]:
    """Return the failures of a campaign, the most severe first, at most ``limit`` of them.

    A repeated road counts once, see `CampaignStore.repeats`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    records = store.tests(Outcome.FAIL, "moobd", limit, with_trajectory=True, with_repeats=False)
    return [failure for failure in map(Failure.of_test, records) if failure is not None]


def describe_drive(segment: Segment, result: Result) -> str:
    """Describe a drive in one phrase; return an empty text unless it passed or failed.

    Args:
        segment: segment of the drive.
        result: verdict on the drive.
    """
    if result.outcome is Outcome.PASS:
        return describe(Failure.of(segment, id=0, moobd=result.moobd or 0.0, is_near_miss=True))
    failure = Failure.of_segment(segment, result) if result.outcome is Outcome.FAIL else None
    return "" if failure is None else describe(failure)


def describe(failure: Failure) -> str:
    """Describe a failure in one phrase: ``leaves to the left 10 m behind a ..., at 41 km/h``."""
    if failure.fault is not None:
        return str(failure.fault)
    event = "fails in its lane" if failure.side is None else f"leaves to the {failure.side}"
    if failure.cause is not None and failure.cause.kind is Kind.EXCEEDS:
        event = as_text(Kind.EXCEEDS, None, failure.cause.criterion)
    if failure.criterion == EDGE_DISTANCE:
        event = f"comes too near to the {failure.side} edge"
    if failure.is_near_miss:
        beyond = "crosses" if failure.moobd < 0.0 else "comes nearest to"
        event = f"{beyond} the {failure.side} edge"
    # A car that has spun round may slide backwards.
    fastest, now = failure.speeds.max() * 3.6, max(failure.speeds[-1], 0.0) * 3.6
    speed = f"at {now:.0f} km/h"
    if fastest - now > _SLOWS * 3.6:
        speed = f"slowing from {fastest:.0f} to {now:.0f} km/h"
    place = place_text(failure.curvatures, failure.step, failure.place)
    return f"{event} {place}, {speed}"
