"""The order in which to drive roads in a slow simulator, from drives in a fast one.

A *twin*, a driver in a fast simulator, drives each road to its end, or until the whole car is
outside its lane. Roads on which the largest share of the car was outside come first; among equal
shares, those of lowest MOOBD.

Two roads promise the same problem if their approaches to the place of departure, or of the least
oob distance, are alike as those of `frenetic.analysis.failures`: on the same side, with a
difference below its `THRESHOLD`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.failures import THRESHOLD, Failure
from frenetic.analysis.segments import segment_of
from frenetic.oracle import Side, assess
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.twin import twin


@dataclass(frozen=True, eq=False)
class Prospect:
    """The drive of the twin on one road, and what it promises."""

    name: str
    length: float
    """Length of the road, in m."""
    outcome: Outcome
    """PASS or FAIL by the rules; INVALID or ERROR if the road was not driven to any end."""
    reason: str
    """The reason, in one sentence."""
    max_oob_share: float | None = None
    """Largest share 0..1 of the car outside its lane."""
    moobd: float | None = None
    """Minimum oob distance, in m."""
    distance: float | None = None
    """Distance along the road of the departure, or else of the least oob distance, in m."""
    side: Side | None = None
    """The side of the lane there."""
    approach: FloatArray | None = None
    """Approach to that place, (64,) in m, see `frenetic.search.approach`."""

    def order(self) -> tuple[bool, float, float]:
        """Its place among others: the least comes first."""
        if self.max_oob_share is None or self.moobd is None:
            return True, 0.0, 0.0
        return False, -self.max_oob_share, self.moobd

    def is_like(self, other: Prospect) -> bool:
        """Whether both promise the same problem."""
        if self.approach is None or other.approach is None or self.side != other.side:
            return False
        return float(np.linalg.norm(self.approach - other.approach)) < THRESHOLD


@dataclass(frozen=True)
class RankedRoad:
    """A road in its order."""

    rank: int
    """1 is the first."""
    prospect: Prospect
    like: int | None
    """Rank of the first road that promises the same problem, None if this is the first."""


class Twin(twin.Twin):
    """A twin that ranks roads."""

    def prospect(self, name: str, road: Road, *, anyway: bool = False) -> Prospect:
        """The prospect of a road.

        Args:
            name: the road's.
            road: it is moved into the map if it lies elsewhere.
            anyway: drive it where it lies, whether it is valid or not.
        """
        if not anyway:
            fitted, reason = self.placed(road)
            if fitted is None:
                return Prospect(name, road.length, Outcome.INVALID, reason)
            road = fitted
        drive, result = self.drive(road)
        if not result.outcome.is_driven:
            return Prospect(name, road.length, result.outcome, result.reason)
        seen = assess(road, drive)
        segment = segment_of(road, drive, result.departure)
        failure = Failure.of(segment, id=0, moobd=0.0, is_near_miss=result.departure is None)
        return Prospect(
            name,
            road.length,
            result.outcome,
            result.reason,
            float(seen.oob_share.max()),
            float(seen.oob_distance.min()),
            segment.place,
            failure.side,
            failure.vector(),
        )


def rank(prospects: Iterable[Prospect], top: int | None = None) -> list[RankedRoad]:
    """The most promising roads first; those that could not be driven come last.

    Args:
        prospects: of the roads; equal ones stay in this order.
        top: number of roads that promise different problems; all roads by default.

    Raises:
        ValueError: ``top`` is below 1.
    """
    if top is not None and top < 1:
        raise ValueError(f"top is {top}: at least 1 is needed")
    ranked: list[RankedRoad] = []
    first: list[RankedRoad] = []
    for prospect in sorted(prospects, key=Prospect.order):
        like = next((one.rank for one in first if prospect.is_like(one.prospect)), None)
        if top is not None and (like is not None or prospect.approach is None):
            continue
        ranked.append(RankedRoad(len(ranked) + 1, prospect, like))
        if like is None:
            first.append(ranked[-1])
        if len(ranked) == top:
            break
    return ranked
