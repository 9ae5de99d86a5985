"""The test of one road: fit, validate, drive, judge."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.child_processes import one_process
from frenetic._support.scalars import take_numpy_scalars
from frenetic.campaign.record import Attempt, Setting
from frenetic.drive import Drive, Trajectory
from frenetic.drivers.driver import Driver
from frenetic.errors import RoadError, Trouble
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import MAP_SIZE, MARGIN, Pose, Road, Verdict, check_validity
from frenetic.road.classes import RoadClass
from frenetic.road.road import MAX_COORDINATE, checked_lane_width
from frenetic.search.records import Candidate
from frenetic.simulators.capabilities import check_pair, check_road
from frenetic.simulators.isolated import BrokenDriveError, raised
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import check_conditions, in_conditions
from frenetic.spec import Spec, is_number, shown

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class RoadTester:
    """Tests roads, one after the other, on the same terms.

    Raises:
        DriverError: the driver cannot drive in the simulator.
        ValueError: the map is too small for its margin, or too large; the margin is negative, or a
            lane has no width that can be represented.
    """

    simulator: Simulator
    driver: Driver
    map_size: float = MAP_SIZE
    """Side of the square map into which roads are fitted, in m."""
    margin: float = MARGIN
    """Distance that a road's centre line keeps from the map's edge, in m."""
    lane_width: float = 4.0
    """Width of each lane, in m."""
    road_class: RoadClass | None = None
    """Class whose rules valid roads keep; None for the competition's."""

    @classmethod
    def on(cls, terms: Setting | Spec, simulator: Simulator, driver: Driver) -> Self:
        """The tester on given terms; raises as the class does."""
        return cls(
            simulator, driver, terms.map_size, terms.margin, terms.lane_width, terms.road_class
        )

    @property
    def terms(self) -> dict[str, Any]:
        """Its terms, as `frenetic.Campaign` takes them."""
        names = ("map_size", "margin", "lane_width", "road_class")
        return {name: getattr(self, name) for name in names}

    def __post_init__(self) -> None:
        for name in ("map_size", "margin", "lane_width"):
            if not is_number(value := getattr(self, name)):
                raise ValueError(f"{name} is {shown(value)}: a number of metres is needed")
        take_numpy_scalars(self)
        checked_lane_width(self.lane_width)
        if self.margin < 0.0:
            raise ValueError(f"margin is {self.margin:g}: a number of at least 0 is needed")
        if not self.map_size > 2.0 * self.margin:
            raise ValueError(
                f"map_size is {self.map_size:g}: more than twice the margin of"
                f" {self.margin:g} m is needed"
            )
        if self.map_size > MAX_COORDINATE:
            raise ValueError(
                f"map_size is {self.map_size:g}: at most {MAX_COORDINATE:g} m are allowed"
            )
        check_pair(self.simulator, self.driver)

    def laid(self, candidate: Candidate) -> tuple[Road | None, Verdict]:
        """Return a candidate's road as it would be driven, and whether it may be, see `fitted`.

        A road that the simulator cannot lay is invalid, too.
        """
        road, verdict = fitted(candidate, self)
        if road is not None and verdict.valid:
            try:
                check_road(self.simulator, self.driver, road)
            except RoadError as error:
                return None, Verdict(False, str(error))
        return road, verdict

    def test(self, candidate: Candidate) -> Attempt:
        """Drives a candidate's road, in its conditions, if it is one, fits the map and is valid.

        A road that the simulator cannot lay is INVALID, too.
        """
        road, verdict = self.laid(candidate)
        if road is None or not verdict.valid:
            return _refused(candidate.id, verdict.message, road.pose if road else None)
        if not candidate.conditions:
            return self._driven(candidate.id, road, self.driver)
        check_conditions(candidate.conditions)
        with in_conditions(candidate.conditions, self.simulator, self.driver) as driver:
            check_pair(self.simulator, driver)
            return self._driven(candidate.id, road, driver)

    def attempt(
        self, candidate: Candidate, worker: str | None = None, *, keep: bool = False
    ) -> Attempt:
        """Tests a candidate for a worker: timed, with a packed trajectory (see `Attempt.pack`)."""
        start = time.perf_counter()
        attempt = self.test(candidate).pack(keep=keep)
        return replace(attempt, worker=worker, seconds=time.perf_counter() - start)

    def drive(self, road: Road) -> Drive:
        """Drives a road; a simulator that raises gives a drive with trouble."""
        return self._drive(road, self.driver)[0]

    def _driven(self, candidate_id: int, road: Road, driver: Driver) -> Attempt:
        drive, broke = self._drive(road, driver)
        # A broken simulator's record may be impossible to store.
        whole = len(drive.trajectory) > 0 and bool(np.isfinite(drive.trajectory.to_rows()).all())
        trajectory = drive.trajectory if whole else None
        return Attempt(
            candidate_id,
            judge(road, drive),
            road.pose,
            trajectory,
            simulator_broke=broke,
            trouble=drive.trouble,
            driver_seconds=drive.driver_seconds,
        )

    def _drive(self, road: Road, driver: Driver) -> tuple[Drive, bool]:
        """The drive, and whether the simulator raised."""
        broke = False
        try:
            with one_process():
                drive = self.simulator.drive(road, driver)
        except BrokenDriveError as error:
            broke, drive = True, self._broken(error.trouble)
        except Exception as error:
            broke, drive = True, self._broken(raised(error, driver))
        if (trouble := drive.trouble) is not None and trouble.traceback:
            logger.debug("%s\n%s", trouble.reason, trouble.traceback)
        return drive, broke

    def _broken(self, trouble: Trouble) -> Drive:
        simulator = self.simulator
        return Drive(Trajectory.empty(), simulator.car, simulator.rules, trouble=trouble)


def _refused(candidate_id: int, reason: str, pose: Pose | None = None) -> Attempt:
    return Attempt.undriven(candidate_id, Outcome.INVALID, reason, pose)


def fitted(candidate: Candidate, terms: RoadTester | Setting) -> tuple[Road | None, Verdict]:
    """A candidate's road on the map, fitted into it or through points, and the verdict on it there.

    Returns:
        (None, invalid) if there is no road, no pose fits, or points are not valid.
    """
    points = candidate.points
    try:
        if points is None:
            road = candidate.road(terms.lane_width, road_class=terms.road_class)
            return road.placed(terms.map_size, terms.margin, terms.road_class)
        verdict = check_validity(points, terms.map_size)
        return road_through(points, terms.lane_width) if verdict.valid else None, verdict
    except RoadError as error:
        return None, Verdict(False, str(error))


def road_through(points: FloatArray, lane_width: float) -> Road:
    """The road through (N, 2) points in m, cached for a candidate that is proposed and tested.

    Raises:
        RoadError: there is none.
    """
    return _road_through(points.tobytes(), lane_width)


@lru_cache(maxsize=4)
def _road_through(points: bytes, lane_width: float) -> Road:
    return Road.from_points(np.frombuffer(points).reshape(-1, 2), lane_width=lane_width)
