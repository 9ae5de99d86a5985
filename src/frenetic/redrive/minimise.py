"""The shortest and plainest road on which a driver still has the same failure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from frenetic._support.interrupt import Interrupt, catch_interrupt
from frenetic.analysis.failures import THRESHOLD, Failure
from frenetic.campaign.loop import MAX_ATTEMPTS
from frenetic.campaign.record import Attempt, Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import InProcessWorker
from frenetic.drive import Drive
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle import STUCK, Result, assess, judge
from frenetic.outcome import Outcome
from frenetic.redrive.record import Match, Redrive
from frenetic.redrive.shrinking import Answer, Ending, Improvement, Shape, shrink
from frenetic.road import Road
from frenetic.search.records import Candidate, Origin
from frenetic.spec import require_count

MAX_DRIVES: Final = 500
"""Default for the most drives per road."""
GUARD: Final = 0.02
"""Share by which the curvatures of a road's neighbours differ, which must fail as well."""
MAX_ERRORS_IN_A_ROW: Final = 10
"""Consecutive broken drives after which minimising ends."""
_UNGUARDED: Final = (
    "No road was found that also fails with all curvatures {0:g} % smaller and {0:g} % larger,"
    " the original included"
)
OPERATOR: Final = "minimise"
"""Operator in the origin of the tried roads."""


class FailureReason(StrEnum):
    """Reason of a failed drive. Two drives failed for the same reason if these are equal."""

    LEFT_LANE_LEFT = "left the lane to the left"
    LEFT_LANE_RIGHT = "left the lane to the right"
    STOOD_STILL = "stood still"
    RAN_OUT_OF_TIME = "ran out of time"


def failure_reason(road: Road, drive: Drive) -> FailureReason | None:
    """Reason of a failed drive; None if it did not fail."""
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
    """A road on which a driver failed, with the failure."""

    shape: Shape
    road: Road
    """Road in its place on the map."""
    drive: Drive
    result: Result
    reason: FailureReason

    @cached_property
    def failure(self) -> Failure:
        """The part of it that tells distinct failures."""
        failure = Failure.of_drive(self.road, self.drive, self.result)
        assert failure is not None
        return failure

    def difference(self, other: FailedDrive) -> float:
        """Difference of the failures in m, as of `frenetic.analysis.failures`."""
        return self.failure.difference(other.failure)

    def is_like(self, other: FailedDrive) -> bool:
        """Whether both are the same problem: the same reason, and a cluster's difference."""
        return self.reason is other.reason and self.difference(other) <= THRESHOLD


@dataclass(frozen=True)
class MinimiseProgress:
    """Progress of minimising one road."""

    drives: int
    max_drives: int
    length: float
    """Length of the smallest road so far, in m."""
    curves: int
    """Number of curves of the smallest road so far."""
    doing: str
    """The current pass."""


@dataclass(frozen=True, eq=False)
class Minimised:
    """The result of minimising a failing road."""

    original: FailedDrive
    smallest: FailedDrive
    """The smallest road with the same failure; possibly the original."""
    improvements: tuple[Improvement, ...]
    """Its improvements, in order; the trials are drives, the first of them the original's."""
    drives: int
    """Number of all drives."""
    ending: Ending
    """MINIMAL if no pass makes it smaller; SPENT if the drives were not enough to know."""
    trouble: str | None
    """Reason for giving up, if any: the simulator or driver broke repeatedly."""
    guard: float
    """Share by which the curvatures of its neighbours differ, which fail as well; 0 without any."""
    note: str
    """Sentence that no neighbours fail as well although they should; mostly empty."""
    match: Match | None = None
    """How the original fails now, beside the failure that its campaign recorded; None without a
    campaign."""

    @property
    def difference(self) -> float:
        """Difference of the failures on both roads in m, at most that within a cluster."""
        return self.smallest.difference(self.original)

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
        """Reason why the drives on both roads failed."""
        return self.smallest.reason


def minimise(
    road: Road,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    guard: float = GUARD,
    on_progress: Callable[[MinimiseProgress], None] | None = None,
    on_smaller: Callable[[int, FailedDrive], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Minimised:
    """The smallest road found with the same failure.

    Smaller is shorter, or as long and plainer, in the order of `frenetic.redrive.shrinking.Shape`.
    Every kept road is valid, was driven and has the failure (see `FailedDrive.is_like`), and so did
    two neighbours of it, with all curvatures a little smaller and a little larger: the failure
    survives a slight change. Where those of the original do not fail, roads are kept without such
    neighbours until one with them is found. No road is driven twice, and the result is
    deterministic.

    Args:
        road: fails.
        tester: drives roads on the terms of the failure; its simulator has been entered.
        max_drives: most drives to spend; refused roads cost none.
        guard: share by which the curvatures of the neighbours differ, at least 0 and below 1; 0
            requires no neighbours.
        on_progress: called after every drive.
        on_smaller: called with the drives so far and the original, then with every smaller road.
        should_stop: asked before every drive; the smallest road so far is then returned.

    Raises:
        FreneticError: the road does not fail.
        ValueError: a number is out of range, or the road has other lanes than the tester.
    """
    max_drives = require_count("max_drives", max_drives)
    if not 0.0 <= guard < 1.0:
        raise ValueError(f"guard is {guard}: at least 0 and less than 1 is needed")
    if road.lane_width != tester.lane_width:
        raise ValueError(
            f"the road's lanes are {road.lane_width:g} m wide, those of the tester"
            f" {tester.lane_width:g} m: they have to agree"
        )
    start = Shape(tuple(road.curvatures), road.step)
    with catch_interrupt(None) as interrupt:
        trials = _Trials(tester, interrupt)
        result = trials.drive(start)
        if result is None:
            raise KeyboardInterrupt  # before anything was found
        if result.outcome is not Outcome.FAIL:
            raise FreneticError(
                f"only a road that fails can be minimised; this one is {result.outcome}:"
                f" {result.reason}"
            )
        original = trials.failed[start]
        if on_smaller is not None:
            on_smaller(1, original)

        def better(found: Improvement) -> None:
            if on_smaller is not None:
                on_smaller(found.trials + 1, trials.failed[found.shape])

        def report(doing: str, drives: int, smallest: Shape) -> None:
            if on_progress is not None:
                length, curves = smallest.length, smallest.curves
                on_progress(MinimiseProgress(drives + 1, max_drives, length, curves, doing))

        shrunk = shrink(
            start,
            trials.ask,
            max_trials=max_drives - 1,  # the original was driven
            neighbours=lambda shape: (
                (shape.scaled(1.0 - guard), shape.scaled(1.0 + guard)) if guard > 0.0 else ()
            ),
            place=None if result.departure is None else result.departure.distance,
            on_trial=report,
            on_better=better,
            should_stop=lambda: trials.gave_up or (should_stop is not None and should_stop()),
        )
    return Minimised(
        original=original,
        smallest=trials.failed[shrunk.shape],
        improvements=tuple(
            replace(found, trials=found.trials + 1) for found in shrunk.improvements
        ),
        drives=shrunk.trials + 1,
        ending=shrunk.ending,
        trouble=trials.trouble if trials.gave_up else None,
        guard=guard if shrunk.is_guarded else 0.0,
        note="" if shrunk.is_guarded else _UNGUARDED.format(100.0 * guard),
    )


def minimise_test(
    folder: Path | str,
    record: Test,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    guard: float = GUARD,
    on_progress: Callable[[MinimiseProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> Minimised:
    """Minimises a campaign's failing road, and says whether it still fails as recorded.

    Args:
        folder: of the campaign.
        record: the test.
        tester: as for `minimise`, like the other arguments.
        max_drives: see there.
        guard: see there.
        on_progress: see there.
        should_stop: see there.

    Raises:
        CampaignError: the campaign's database is damaged.
        FreneticError: as for `minimise`.
        ValueError: likewise.
    """
    with CampaignStore.open(folder) as campaign:
        recorded = Failure.of_test(campaign.test(record.id))
    minimised = minimise(
        record.road,
        tester,
        max_drives=max_drives,
        guard=guard,
        on_progress=on_progress,
        should_stop=should_stop,
    )
    original = minimised.original
    attempt = replace(record.attempt, result=original.result)
    difference = None if recorded is None else recorded.difference(original.failure)
    again = Redrive(record, replace(record, attempt=attempt), difference)
    return replace(minimised, match=again.match)


class _Trials:
    """Drives shapes and answers whether they fail like the first."""

    def __init__(self, tester: RoadTester, interrupt: Interrupt) -> None:
        self.failed: dict[Shape, FailedDrive] = {}
        """Those with the same failure, the first one first."""
        self.trouble = ""
        """Reason of the last broken drive."""
        self._tester = tester
        self._worker = InProcessWorker(tester, is_entered=True, packs=False)
        self._interrupt = interrupt
        self._asked = 0
        self._broken = 0  # drives in a row

    @property
    def gave_up(self) -> bool:
        """Whether too many drives broke for going on."""
        return self._broken >= MAX_ERRORS_IN_A_ROW

    def ask(self, shape: Shape) -> Answer | None:
        """Whether the driver fails on the shape like on the first; None after Ctrl-C."""
        result = self.drive(shape)
        if result is None:
            return None
        if result.outcome is Outcome.INVALID:
            return Answer.REFUSED
        return Answer.YES if shape in self.failed else Answer.NO

    def drive(self, shape: Shape) -> Result | None:
        """Result of a drive on the shape; None after Ctrl-C."""
        if self._interrupt.requested:
            return None
        self._asked += 1
        road = Candidate(self._asked, np.array(shape.values), shape.step, Origin(OPERATOR))
        try:
            for _ in range(MAX_ATTEMPTS):
                self._worker.submit(road)
                (attempt,) = self._worker.wait(0.0)
                if attempt.failure is None:
                    break
        except CampaignError as error:  # the simulator does not start again
            attempt = Attempt.undriven(self._asked, Outcome.ERROR, str(error))
            self._broken = MAX_ERRORS_IN_A_ROW
        result = attempt.result
        if result.outcome is Outcome.ERROR:
            self._broken += 1
            self.trouble = result.reason
        elif result.outcome is not Outcome.INVALID:
            self._broken = 0
        if result.outcome is Outcome.FAIL:
            self._keep(shape, attempt)
        return result

    def _keep(self, shape: Shape, attempt: Attempt) -> None:
        """Keeps a failed drive if it failed like the first."""
        assert attempt.pose is not None
        assert attempt.trajectory is not None
        tester = self._tester
        road = Road(shape.values, shape.step, attempt.pose, lane_width=tester.lane_width)
        drive = Drive(attempt.trajectory, tester.simulator.car, tester.simulator.rules)
        reason = failure_reason(road, drive)
        assert reason is not None
        failed = FailedDrive(shape, road, drive, attempt.result, reason)
        if not self.failed or failed.is_like(next(iter(self.failed.values()))):
            self.failed[shape] = failed
