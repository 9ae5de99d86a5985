"""Testing one road: fit, validate, drive, judge."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.store import TestRecord
from frenetic.campaign.trajectory_codec import encode
from frenetic.drivers.driver import Driver
from frenetic.errors import RoadError, describe_error
from frenetic.oracle import Result, judge
from frenetic.outcome import Outcome
from frenetic.road import MAP_SIZE, MARGIN, Pose, Road, check_validity
from frenetic.search.records import Candidate
from frenetic.simulators.drive import Drive, Trajectory
from frenetic.simulators.simulator import Simulator, check_pair

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Tested:
    """What became of one road."""

    __test__: ClassVar[bool] = False  # not a test class, whatever a test runner may think

    result: Result
    """Of an INVALID road: only outcome and reason."""
    pose: Pose | None
    """Where on the map the road starts; None if it fits nowhere."""
    trajectory: Trajectory | None
    """None if nothing was driven, or if it is packed."""
    packed: bytes | None = None
    """The trajectory as `encode` gives it: small enough to travel between processes."""
    simulator_broke: bool = False
    """Whether it was the simulator that broke, so that another attempt may go better."""

    def pack(self) -> Tested:
        """The same with a packed trajectory."""
        if self.trajectory is None:
            return self
        return replace(self, trajectory=None, packed=encode(self.trajectory))

    def record(
        self,
        candidate: Candidate,
        *,
        told: int,
        budget_spent: float,
        seconds: float,
        attempts: int = 1,
        worker: str | None = None,
        elapsed: float | None = None,
    ) -> TestRecord:
        """The test as a campaign keeps it; ``seconds`` of wall time were spent on it."""
        result, departure = self.result, self.result.departure
        driven = self.trajectory is not None or self.packed is not None
        return TestRecord(
            candidate=candidate,
            told=told,
            outcome=result.outcome,
            reason=result.reason,
            budget_spent=budget_spent,
            pose=self.pose,
            moobd=result.moobd,
            max_oob_share=result.max_oob_share,
            duration=result.duration if driven else None,
            moobd_distance=result.moobd_distance,
            departure_time=departure.time if departure else None,
            departure_distance=departure.distance if departure else None,
            departure_x=departure.x if departure else None,
            departure_y=departure.y if departure else None,
            departure_side=departure.side if departure else None,
            seconds=seconds,
            attempts=attempts,
            worker=worker,
            elapsed=elapsed,
            trajectory=self.trajectory,
        )


@dataclass(frozen=True)
class RoadTester:
    """Tests roads, one after the other, always in the same way.

    Raises:
        DriverError: the driver cannot drive in the simulator.
        ValueError: the map is too small for its margin.
    """

    simulator: Simulator
    driver: Driver
    map_size: float = MAP_SIZE
    """m, side of the square map into which roads are fitted."""
    margin: float = MARGIN
    """m that a road's centre line keeps from the map's edge."""
    lane_width: float = 4.0
    """m, of each lane."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.map_size) and self.map_size > 2.0 * self.margin >= 0.0):
            raise ValueError(
                f"map_size is {self.map_size:g}: more than twice the margin of"
                f" {self.margin:g} m is needed"
            )
        check_pair(self.simulator, self.driver)

    def test(self, candidate: Candidate) -> Tested:
        """Drives a candidate's road if it is one, fits the map and is valid."""
        if candidate.points is not None:
            return self._test_points(candidate.points)
        try:
            road = Road(candidate.curvatures, candidate.step, lane_width=self.lane_width)
        except RoadError as error:
            return self._refused(str(error), None)
        fitted, verdict = road.placed(self.map_size, self.margin)
        if fitted is None or not verdict.valid:
            return self._refused(verdict.message, fitted.pose if fitted else None)
        return self._driven(fitted)

    def _test_points(self, points: FloatArray) -> Tested:
        """Drives the road through points where they lie, if they are valid."""
        try:
            verdict = check_validity(points, self.map_size)
            if not verdict.valid:
                return self._refused(verdict.message, None)
            road = road_through(points, self.lane_width)
        except RoadError as error:
            return self._refused(str(error), None)
        return self._driven(road)

    def test_placed(self, road: Road) -> Tested:
        """Drives a road where it lies if it is valid there."""
        verdict = road.check_validity(self.map_size)
        return self._driven(road) if verdict.valid else self._refused(verdict.message, road.pose)

    def drive(self, road: Road) -> Drive:
        """Drives a road as it is; a simulator that raises makes a drive with an error."""
        return self._drive(road)[0]

    def _driven(self, road: Road) -> Tested:
        drive, broke = self._drive(road)
        # What a broken simulator recorded may be nothing that can be stored.
        whole = len(drive.trajectory) > 0 and bool(np.isfinite(drive.trajectory.to_rows()).all())
        trajectory = drive.trajectory if whole else None
        return Tested(judge(road, drive), road.pose, trajectory, simulator_broke=broke)

    def _drive(self, road: Road) -> tuple[Drive, bool]:
        """The drive, and whether the simulator raised."""
        try:
            return self.simulator.drive(road, self.driver), False
        except Exception as error:
            logger.debug("the simulator broke", exc_info=True)
            reason = f"the simulator raised {describe_error(error)}"
            nothing = Trajectory.empty()
            return Drive(nothing, self.simulator.car, self.simulator.rules, error=reason), True

    @staticmethod
    def _refused(reason: str, pose: Pose | None) -> Tested:
        return Tested(_undriven(Outcome.INVALID, reason), pose, None)


def road_through(points: FloatArray, lane_width: float) -> Road:
    """The road through (N, 2) points in m, found once for a candidate that is proposed and tested.

    Raises:
        RoadError: there is none.
    """
    return _road_through(points.tobytes(), lane_width)


@lru_cache(maxsize=4)
def _road_through(points: bytes, lane_width: float) -> Road:
    return Road.from_points(np.frombuffer(points).reshape(-1, 2), lane_width=lane_width)


def untested(outcome: Outcome, reason: str) -> Tested:
    """What is left of a candidate that was not tested: dropped, or lost in every attempt."""
    return Tested(_undriven(outcome, reason), None, None)


def _undriven(outcome: Outcome, reason: str) -> Result:
    return Result(outcome, reason, None, None, None, 0.0, None)
