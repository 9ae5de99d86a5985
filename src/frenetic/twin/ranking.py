"""A twin: a driver in a fast simulator, and which of many roads to drive first in a slow one.

The twin drives each road to its end, or until the whole car is outside its lane. Roads on which the
largest share of the car was outside come first; among equal shares, those of lowest MOOBD.

Two roads promise the same problem if their approaches to the place of departure, or of the least
oob distance, are alike as those of `frenetic.analysis.failures`: on the same side, with a
difference below its `THRESHOLD`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.failures import THRESHOLD, Failure
from frenetic.analysis.segments import segment_of
from frenetic.campaign.tester import RoadTester
from frenetic.drive import Rules
from frenetic.errors import CampaignError, reason_of
from frenetic.oracle import Side, assess, judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.spec import Spec

_WHOLE: Final = 0.999
"""Oob tolerance with which a drive ends when the whole car has left its lane."""


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
    score: tuple[float, float] | None = None
    """Largest share 0..1 of the car outside its lane, and the MOOBD in m with the other sign: the
    largest is the most promising."""
    distance: float | None = None
    """Distance along the road of the departure, or else of the least oob distance, in m."""
    side: Side | None = None
    """The side of the lane there."""
    approach: FloatArray | None = None
    """Approach to that place, (64,) in m, see `frenetic.search.approach`."""
    lane_width: float = 4.0
    """m."""

    def is_like(self, other: Prospect) -> bool:
        """Whether both promise the same problem."""
        if self.approach is None or other.approach is None or self.side != other.side:
            return False
        return float(np.linalg.norm(self.approach - other.approach)) < THRESHOLD


@dataclass(frozen=True)
class Twin:
    """A driver in a fast simulator; a context manager: within it, its simulator is there."""

    tester: RoadTester
    rules: Rules
    """The rules by which its drives are judged."""

    @classmethod
    def of(cls, spec: Spec) -> Self:
        """The twin of a spec.

        Raises:
            FreneticError: driver or simulator cannot be made.
        """
        tolerance = max(_WHOLE, spec.rules.oob_tolerance)
        to_the_end = replace(spec, rules=replace(spec.rules, oob_tolerance=tolerance))
        driver, simulator = to_the_end.make_parts(isolate=True)
        tester = RoadTester.on(spec, simulator, driver)
        return cls(tester, spec.rules)

    def __enter__(self) -> Self:
        """Starts the simulator.

        Raises:
            CampaignError: it does not start.
        """
        try:
            self.tester.simulator.__enter__()
        except Exception as error:
            raise CampaignError(f"the twin does not start: {reason_of(error)}") from error
        return self

    def __exit__(self, *raised: Any) -> None:
        """Ends the simulator."""
        self.tester.simulator.__exit__(*raised)

    def prospect(self, name: str, road: Road, *, anyway: bool = False) -> Prospect:
        """The prospect of a road.

        Args:
            name: the road's.
            road: it is moved into the map if it lies elsewhere.
            anyway: drive it where it lies, whether it is valid or not.
        """
        if not anyway:
            fitted, verdict = road.placed(
                self.tester.map_size, self.tester.margin, self.tester.road_class
            )
            if fitted is None or not verdict.valid:
                return Prospect(name, road.length, Outcome.INVALID, verdict.message)
            road = fitted
        drive = self.tester.drive(road)
        result = judge(road, replace(drive, rules=self.rules))
        if not result.outcome.is_driven or not len(drive.trajectory):
            return Prospect(name, road.length, result.outcome, result.reason)
        seen = assess(road, drive)
        segment = segment_of(road, drive, result.finding)
        failure = Failure.of(segment, id=0, moobd=0.0, is_near_miss=result.departure is None)
        return Prospect(
            name,
            road.length,
            result.outcome,
            result.reason,
            (float(seen.oob_share.max()), -float(seen.oob_distance.min())),
            segment.place,
            failure.side,
            failure.vector(),
            road.lane_width,
        )


def rank(
    prospects: Iterable[Prospect], top: int | None = None
) -> list[tuple[Prospect, int | None]]:
    """The most promising roads first; those that could not be driven come last.

    Args:
        prospects: of the roads; equal ones stay in this order.
        top: number of roads that promise different problems; all roads by default.

    Returns:
        Each with the rank, from 1 on, of the first that promises the same problem; None if that is
        itself.
    """
    ranked: list[tuple[Prospect, int | None]] = []
    first: dict[int, Prospect] = {}  # by rank
    worst = -np.inf, 0.0
    for prospect in sorted(prospects, key=lambda one: one.score or worst, reverse=True):
        like = next((number for number, one in first.items() if prospect.is_like(one)), None)
        if top is not None and (like is not None or prospect.approach is None):
            continue
        ranked.append((prospect, like))
        if like is None:
            first[len(ranked)] = prospect
        if len(ranked) == top:
            break
    return ranked
