"""The shortest and plainest road on which a driver still fails, for the same reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from frenetic.campaign.tester import RoadTester
from frenetic.errors import FreneticError
from frenetic.oracle import STUCK, Result, assess, judge
from frenetic.outcome import Outcome
from frenetic.redrive.shrinking import Answer, Ending, Improvement, Shape, shrink
from frenetic.road import Road
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.drive import Drive

MAX_DRIVES: Final = 500
"""Drives that are spent on a road at most, unless another number is given."""
GUARD: Final = 0.02
"""By which share the curvatures of a road's neighbours differ, which have to fail as well."""
MAX_ERRORS_IN_A_ROW: Final = 10
"""Drives that may break one after the other before minimising ends."""
OPERATOR: Final = "minimise"
"""What the origin of the roads that are tried says."""


class FailureReason(StrEnum):
    """Why a drive failed. Two drives failed for the same reason if these are equal."""

    LEFT_LANE_LEFT = "left the lane to the left"
    LEFT_LANE_RIGHT = "left the lane to the right"
    STOOD_STILL = "stood still"
    RAN_OUT_OF_TIME = "ran out of time"


def failure_reason(road: Road, drive: Drive) -> FailureReason | None:
    """Why a drive of a road failed; None if it did not."""
    result = judge(road, drive)
    if result.outcome is not Outcome.FAIL:
        return None
    if result.departure is not None:
        return (
            FailureReason.LEFT_LANE_LEFT
            if result.departure.side == "left"
            else FailureReason.LEFT_LANE_RIGHT
        )
    if assess(road, drive).end == STUCK:
        return FailureReason.STOOD_STILL
    return FailureReason.RAN_OUT_OF_TIME


@dataclass(frozen=True, eq=False)
class FailedDrive:
    """A road on which a driver failed, and how."""

    shape: Shape
    road: Road
    """Where it lies on the map."""
    drive: Drive
    result: Result
    reason: FailureReason


@dataclass(frozen=True)
class MinimiseProgress:
    """How far the minimising of one road has come."""

    drives: int
    max_drives: int
    length: float
    """m, of the smallest road so far."""
    curves: int
    """Of the smallest road so far."""
    doing: str
    """The pass that is at work."""


@dataclass(frozen=True, eq=False)
class Minimised:
    """What a failing road was reduced to."""

    original: FailedDrive
    smallest: FailedDrive
    """Fails for the same reason; the original itself if nothing smaller does."""
    improvements: tuple[Improvement, ...]
    """How it came about, in order; the trials are drives, the first of them the original's."""
    drives: int
    """Spent in all."""
    ending: Ending
    """MINIMAL if no pass makes it smaller; SPENT if the drives did not suffice to find out."""
    trouble: str | None
    """Why minimising gave up, if it did: the simulator or driver broke time and again."""

    @property
    def road(self) -> Road:
        """The smallest road."""
        return self.smallest.road

    @property
    def result(self) -> Result:
        """The result of the drive on the smallest road."""
        return self.smallest.result

    @property
    def reason(self) -> FailureReason:
        """Why the drives on both roads failed."""
        return self.smallest.reason


def minimise(
    road: Road,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    guard: float = GUARD,
    on_progress: Callable[[MinimiseProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Minimised:
    """The smallest road found on which the driver fails for the same reason.

    Smaller is shorter, or as long and plainer, in the order of `frenetic.redrive.shrinking.Shape`.
    Every road that is kept is valid, was driven and failed, and so did two neighbours of it, with
    all curvatures a little smaller and a little larger: what is left is not a failure that the
    slightest change makes vanish. No road is driven twice, and nothing is left to chance.

    Args:
        road: fails.
        tester: drives roads as they were driven when it failed; its simulator has been entered.
        max_drives: the most drives that may be spent; refused roads cost none.
        guard: by which share the curvatures of the neighbours differ, at least 0 and below 1; 0
            asks for no neighbours.
        on_progress: called after every drive.
        should_stop: asked before every drive; the smallest road until then is returned.

    Raises:
        FreneticError: the road does not fail.
        ValueError: a number is out of range, or the road has other lanes than the tester.
    """
    if isinstance(max_drives, bool) or max_drives != int(max_drives) or max_drives < 1:
        raise ValueError(f"max_drives is {max_drives}: a whole number of at least 1 is needed")
    if not 0.0 <= guard < 1.0:
        raise ValueError(f"guard is {guard}: at least 0 and less than 1 is needed")
    if road.lane_width != tester.lane_width:
        raise ValueError(
            f"the road's lanes are {road.lane_width:g} m wide, those of the tester"
            f" {tester.lane_width:g} m: they have to agree"
        )
    start = Shape(tuple(road.curvatures), road.step)
    result, original = _test(tester, start, 1)
    if original is None:
        raise FreneticError(
            f"only a road that fails can be minimised; this one is {result.outcome}:"
            f" {result.reason}"
        )
    trials = _Trials(tester, original.reason)

    def report(doing: str, drives: int, smallest: Shape) -> None:
        if on_progress is not None:
            on_progress(
                MinimiseProgress(drives + 1, max_drives, smallest.length, smallest.curves, doing)
            )

    shrunk = shrink(
        start,
        trials.ask,
        max_trials=max_drives - 1,  # the original was driven
        neighbours=lambda shape: (
            (shape.scaled(1.0 - guard), shape.scaled(1.0 + guard)) if guard > 0.0 else ()
        ),
        on_trial=report,
        should_stop=lambda: trials.gave_up or (should_stop is not None and should_stop()),
    )
    return Minimised(
        original=original,
        smallest=trials.failed.get(shrunk.shape, original),
        improvements=tuple(
            replace(found, trials=found.trials + 1) for found in shrunk.improvements
        ),
        drives=shrunk.trials + 1,
        ending=shrunk.ending,
        trouble=trials.trouble if trials.gave_up else None,
    )


class _Trials:
    """Drives shapes and answers whether they fail for a given reason."""

    def __init__(self, tester: RoadTester, reason: FailureReason) -> None:
        self.failed: dict[Shape, FailedDrive] = {}
        """Those that failed for this reason."""
        self.trouble = ""
        """Why the last drive that broke did."""
        self._tester = tester
        self._reason = reason
        self._asked = 1
        self._broken = 0  # drives in a row

    @property
    def gave_up(self) -> bool:
        """Whether so many drives broke that others are not worth their while."""
        return self._broken >= MAX_ERRORS_IN_A_ROW

    def ask(self, shape: Shape) -> Answer:
        """Whether the driver fails on the shape as it did before."""
        self._asked += 1
        result, failed = _test(self._tester, shape, self._asked)
        if result.outcome is Outcome.INVALID:
            return Answer.REFUSED
        if result.outcome is Outcome.ERROR:
            self._broken += 1
            self.trouble = result.reason
        else:
            self._broken = 0
        if failed is None or failed.reason is not self._reason:
            return Answer.NO
        self.failed[shape] = failed
        return Answer.YES


def _test(tester: RoadTester, shape: Shape, number: int) -> tuple[Result, FailedDrive | None]:
    """What became of a shape, and the drive on it if it failed."""
    tested = tester.test(Candidate(number, np.array(shape.values), shape.step, Origin(OPERATOR)))
    if tested.result.outcome is not Outcome.FAIL:
        return tested.result, None
    assert tested.pose is not None
    assert tested.trajectory is not None
    road = Road(shape.values, shape.step, tested.pose, lane_width=tester.lane_width)
    drive = Drive(tested.trajectory, tester.simulator.car, tester.simulator.rules)
    reason = failure_reason(road, drive)
    assert reason is not None
    return tested.result, FailedDrive(shape, road, drive, tested.result, reason)
