"""The values of a drive's segment that a campaign stores: by them drives are told apart and listed.

They follow from the stored trajectory, which is rounded, not from the exact one: whoever reads the
trajectory again finds the same values, and `frenetic check` does so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.oracle.drive_assessment import Assessment
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, Side
from frenetic.search.approach import ROAD_SIZE, STATES, road_around, states_before
from frenetic.search.records import Trace
from frenetic.segments.causes import Cause, cause_of
from frenetic.segments.features import Features, features_of
from frenetic.segments.segment import Segment

SAME: Final = 1e-6
"""Largest difference of two values that another processor's rounding can make, in the value's unit;
our choice."""


@dataclass(frozen=True, eq=False)
class SegmentValues:
    """Values of a judged drive and its segment, see `frenetic.segments.segment`."""

    place: float
    """Place of the finding along the road, in m; without a finding, the place where the oob
    distance was least."""
    side: Side | None
    """Side of the finding; of a drive that passed, the side of the lane's nearer edge."""
    criterion: str | None
    """Criterion of the finding, see `frenetic.oracle.Finding`; None without a finding."""
    cause: Cause | None
    """Cause of a failure; None for a fault of the driver and for a drive that passed."""
    features: Features
    """Features of the segment."""
    slowest: float
    """Least speed of the drive once it has reached half of `fastest`, in m/s."""
    fastest: float
    """Largest speed of the drive, in m/s."""
    approach: FloatArray
    """Road around the place and states before it, (64,): `road`, `offsets` and `speeds`."""

    @classmethod
    def of(cls, segment: Segment, result: Result) -> SegmentValues:
        """Return the values of a segment.

        Args:
            segment: segment of a drive.
            result: verdict PASS or FAIL on the drive.
        """
        has_passed = result.outcome is Outcome.PASS
        assessment, place, road = segment.assessment, segment.place, segment.road
        speed = segment.drive.trajectory.speed
        trace = Trace(
            assessment.distance, assessment.lateral_offset, speed[: len(assessment.distance)]
        )
        points = road_around(road.table, road.sub_step, place)
        fastest = float(speed.max())
        return cls(
            place=place,
            side=_nearer_side(assessment) if has_passed else segment.side,
            criterion=segment.criterion,
            cause=None if has_passed or result.fault is not None else cause_of(segment),
            features=features_of(segment),
            # The car starts at rest: the slowest speed counts once it has half the largest.
            slowest=float(speed[(speed >= 0.5 * fastest).argmax() :].min()),
            fastest=fastest,
            approach=np.concatenate((points.ravel(), *states_before(trace, place))),
        )

    @property
    def are_finite(self) -> bool:
        """Whether all values are finite numbers."""
        numbers = (self.place, *self.features.values(), self.slowest, self.fastest)
        return all(map(math.isfinite, numbers)) and bool(np.isfinite(self.approach).all())

    @property
    def road(self) -> FloatArray:
        """Centre line, (19, 2) in m, every 2.5 m from 30 m before the place to 15 m after it.

        x is along the road's direction at the place, y to its left.
        """
        return self.approach[:ROAD_SIZE].reshape(-1, 2)

    @property
    def offsets(self) -> FloatArray:
        """Offset to the left of the lane's centre, (13,) in m, over the 30 m before the place."""
        return self.approach[ROAD_SIZE:-STATES]

    @property
    def speeds(self) -> FloatArray:
        """Speed, (13,) in m/s, at the same places as `offsets`."""
        return self.approach[-STATES:]

    def differences(self, other: SegmentValues) -> list[str]:
        """Return the names of the values that differ from another's by more than `SAME`."""
        names = [
            name
            for name in ("side", "criterion", "cause")
            if getattr(self, name) != getattr(other, name)
        ]
        mine, others = (
            {
                "place": values.place,
                **values.features,
                "slowest": values.slowest,
                "fastest": values.fastest,
            }
            for values in (self, other)
        )
        names += [name for name, value in mine.items() if not abs(value - others[name]) <= SAME]
        if not (np.abs(self.approach - other.approach) <= SAME).all():
            names.append("approach")
        return names


def _nearer_side(assessment: Assessment) -> Side:
    """Return the side of the lane's edge that the car came nearest to."""
    nearest = int(np.argmin(assessment.oob_distance))
    return "left" if assessment.lateral_offset[nearest] > 0.0 else "right"
