"""Failures and near misses: road and drive around their places, to be compared and described.

Two failures are moved and turned so that the places where the car left its lane, and the road's
directions there, coincide; `frenetic.search.approach` defines their *difference* in metres. Of the
road after the place only 15 m count: after a departure the car drives no further, and with 30 m the
clusters of a campaign and the clusters of half of its failures agree less (research/measures.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.criteria.criterion import EDGE_DISTANCE
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, Side
from frenetic.road import LANE_WIDTH
from frenetic.search.approach import ROAD_SIZE, STATES, as_vector
from frenetic.segments.bends import place_text
from frenetic.segments.causes import Cause, Kind, as_text
from frenetic.segments.segment import Segment
from frenetic.segments.values import SegmentValues

_KM_H: Final = 3.6  # km/h in 1 m/s
_MENTIONED_SLOWING: Final = 3.0  # [m/s] least loss of speed that is mentioned (our choice)


@dataclass(frozen=True, eq=False)
class Failure:
    """A failed test or a near miss, with the road and the drive around its place.

    Any passed test counts as a near miss, see `is_near_miss`. A drive that a fault of the driver
    ended may have no records, see `fault`.
    """

    id: int
    """Id of the test."""
    moobd: float
    """Least distance of the car's centre to the edge of its lane, in m, negative outside the lane;
    0 if it was not measured."""
    side: Side | None
    """Side on which the car left its lane, or to which the value of another finding points; None
    for a finding without sides, and without a finding."""
    curvatures: FloatArray
    """Curvatures of the whole road, (n,) in 1/m."""
    step: float
    """Distance between two curvatures, in m."""
    place: float
    """Distance along the road to the finding, in m, usually to where the car left its lane; without
    a finding, to where the car came nearest to the edge."""
    road: FloatArray
    """Centre line, (19, 2) in m, every 2.5 m from 30 m before the place to 15 m after it: x along
    the road's direction at the place, y to its left."""
    offsets: FloatArray
    """Offset to the left of the lane's centre, (13,) in m, every 2.5 m over the 30 m before the
    place."""
    speeds: FloatArray
    """Speeds, (13,) in m/s, at the same places as `offsets`."""
    is_near_miss: bool = False
    """Whether the test passed. Then the place is where the oob distance was least, and `side` is
    the side of the nearer edge of the lane."""
    lane_width: float = LANE_WIDTH
    """Width of the lane, in m."""
    fault: Fault | None = None
    """Fault of the driver that ended the drive; None if no fault ended it. If the drive has no
    records, all arrays hold zeros, and so does `vector`."""
    cause: Cause | None = None
    """Cause of the failure; None for a fault or a near miss."""
    criterion: str | None = None
    """Criterion of the finding, see `frenetic.oracle.Finding`; None without a finding."""

    @classmethod
    def of_judged(
        cls,
        result: Result,
        segment: Segment | None,
        id: int = 0,  # noqa: A002
    ) -> Failure | None:
        """Return the failure of a drive that was judged FAIL, or the near miss of a PASS.

        Args:
            result: verdict on the drive.
            segment: segment of the drive; None if the drive has no records.
            id: id of the test.

        Returns:
            None if the drive was not judged, or has no records and no fault ended it.
        """
        if not result.outcome.is_driven:
            return None
        if segment is None:
            return None if result.fault is None else cls._of_fault(result.fault, id)
        road = segment.road
        values = SegmentValues.of(segment, result)
        return cls._of_values(id, result, values, road.curvatures, road.step, road.lane_width)

    @classmethod
    def of_driven(cls, test: Test) -> Failure | None:
        """Return the failure of a stored test that failed, or the near miss of a test that passed.

        The test was read with its trajectory or with the values of its segment.

        Returns:
            None if the drive was not judged, or has no records and no fault ended it.

        Raises:
            CampaignError: the campaign does not record how the road was driven.
        """
        result, values = test.result, test.segment_values
        if not result.outcome.is_driven:
            return None
        if values is None:
            return None if result.fault is None else cls._of_fault(result.fault, test.id)
        candidate = test.candidate
        return cls._of_values(
            test.id, result, values, candidate.curvatures, candidate.step, test.lane_width
        )

    @classmethod
    def _of_values(
        cls,
        id: int,  # noqa: A002
        result: Result,
        values: SegmentValues,
        curvatures: FloatArray,
        step: float,
        lane_width: float,
    ) -> Failure:
        """Return the failure of a judged drive with records."""
        return cls(
            id=id,
            moobd=result.moobd or 0.0,
            side=values.side,
            curvatures=curvatures,
            step=step,
            place=values.place,
            road=values.road,
            offsets=values.offsets,
            speeds=values.speeds,
            is_near_miss=result.outcome is Outcome.PASS,
            lane_width=lane_width,
            fault=result.fault,
            cause=values.cause,
            criterion=values.criterion,
        )

    @classmethod
    def _of_fault(cls, fault: Fault, id: int) -> Failure:  # noqa: A002
        """Return the failure of a drive without records: zeros stand for the missing values."""
        return cls(
            id=id,
            moobd=0.0,
            side=None,
            curvatures=np.zeros(2),
            step=1.0,
            place=0.0,
            road=np.zeros((ROAD_SIZE // 2, 2)),
            offsets=np.zeros(STATES),
            speeds=np.zeros(STATES),
            fault=fault,
        )

    @classmethod
    def of_test(cls, test: Test) -> Failure | None:
        """Return the failure of a stored test; None if the test did not fail, see `of_judged`."""
        if test.outcome is not Outcome.FAIL:
            return None
        return cls.of_driven(test)

    def difference(self, other: Failure) -> float:
        """Return the difference from another failure in m; the sides of the lane do not count.

        It means nothing if a failure has no records: two such failures differ by 0 m. Compare their
        faults instead.
        """
        return float(np.linalg.norm(self.vector() - other.vector()))

    def vector(self) -> FloatArray:
        """Return the failure as a vector, (64,) in m; zeros if the drive has no records.

        The distance between the vectors of two failures is the difference of the failures.
        """
        return as_vector(self.road, self.offsets, self.speeds)


def failures_of(store: CampaignStore, limit: int | None = None) -> list[Failure]:
    """Return the failures of a campaign, the most severe first, at most ``limit`` of them.

    A repeated road counts once, see `CampaignStore.repeats`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    tests = store.tests(Outcome.FAIL, "moobd", limit, with_segments=True, with_repeats=False)
    return [failure for failure in map(Failure.of_test, tests) if failure is not None]


def describe_drive(segment: Segment, result: Result) -> str:
    """Return a drive in one phrase; an empty text unless the drive passed or failed.

    Args:
        segment: segment of the drive.
        result: verdict on the drive.
    """
    failure = Failure.of_judged(result, segment)
    return "" if failure is None else describe(failure)


def describe(failure: Failure) -> str:
    """Return a failure or near miss in one phrase.

    For example: ``leaves to the left on a straight, at 41 km/h``.
    """
    if failure.fault is not None:
        return str(failure.fault)
    fastest = failure.speeds.max() * _KM_H
    last = max(failure.speeds[-1], 0.0) * _KM_H  # a car that has spun round may slide backwards
    speed = f"at {last:.0f} km/h"
    if fastest - last > _MENTIONED_SLOWING * _KM_H:
        speed = f"slowing from {fastest:.0f} to {last:.0f} km/h"
    place = place_text(failure.curvatures, failure.step, failure.place)
    return f"{_event(failure)} {place}, {speed}"


def _event(failure: Failure) -> str:
    """Return what the car did at the place of a failure that is no fault, or of a near miss."""
    if failure.is_near_miss:
        # A car that crosses the edge passes as long as it stays within the tolerance.
        verb = "crosses" if failure.moobd < 0.0 else "comes nearest to"
        return f"{verb} the {failure.side} edge"
    if failure.criterion == EDGE_DISTANCE:
        return f"comes too near to the {failure.side} edge"
    if failure.cause is not None and failure.cause.kind is Kind.EXCEEDS:
        return as_text(Kind.EXCEEDS, None, failure.cause.criterion)
    if failure.side is None:
        return "fails in its lane"
    return f"leaves to the {failure.side}"
