"""The test of one road: fit, validate, drive, judge."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, chdir, nullcontext
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import JSONValue
from frenetic.campaign.record import Attempt
from frenetic.drivers.driver import Driver
from frenetic.drivers.loading import with_wrappers
from frenetic.drivers.noting import NotingDriver, drive_notes
from frenetic.errors import FreneticError, RoadError, Trouble
from frenetic.oracle.drive import Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.parts.construction import Construction
from frenetic.parts.registry import SIMULATORS
from frenetic.processes.forks import one_process
from frenetic.road import Road, Verdict, check_validity
from frenetic.road.road import placed_road
from frenetic.search.records import Candidate
from frenetic.simulators.blame import trouble_of_error
from frenetic.simulators.capabilities import capabilities, check_pair, check_road
from frenetic.simulators.conditions import check_conditions, check_pair_in, in_conditions
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Spec
from frenetic.spec.part_record import describe, sources_of
from frenetic.spec.terms import DriveSetting, Terms

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class RoadTester:
    """A tester of roads: driver and simulator with the terms on which they drive.

    When a tester is pickled for another process, parts with names are made anew there by their
    names. Other parts are copied, and so is an installed simulator with ``prepare``, which keeps
    what it has measured.

    Raises:
        DriverError: the driver cannot drive in the simulator.
        FreneticError: the simulator cannot be put into the conditions.
    """

    simulator: Simulator
    driver: Driver
    terms: Terms = field(default_factory=Terms)
    """Map, lanes, roads and conditions of the drives."""
    spec: Spec | None = None
    """Spec that names driver and simulator; None for objects from Python."""
    folder: Path | None = None
    """Folder in which parts with names were made, and to which names of files are relative; by
    default the current folder."""
    keeps_notes: bool = False
    """Whether `drive` keeps what the driver is told, notes and plans, as `Drive.notes`."""

    @classmethod
    def of(cls, spec: Spec, terms: Terms | None = None, rules: Rules | None = None) -> RoadTester:
        """Return the tester with the driver and the simulator of a spec.

        Args:
            spec: spec that names driver and simulator.
            terms: terms of the drives; by default the terms of the spec.
            rules: rules of the drives; by default the rules of the spec.

        Raises:
            FreneticError: a part cannot be made, or the simulator cannot be put into the
                conditions.
            ValueError: the terms are out of range.
        """
        driver, simulator = spec.make_driver(), spec.make_simulator(rules)
        return cls(simulator, driver, spec.terms if terms is None else terms, spec)

    def __post_init__(self) -> None:
        if self.spec is not None and self.folder is None:
            object.__setattr__(self, "folder", Path.cwd())
        check_pair_in(self.terms.conditions, self.simulator, self.driver)

    def __reduce__(self) -> tuple[Any, ...]:
        if self.spec is None:
            parts = self.simulator, self.driver, self.terms, None, None, self.keeps_notes
            return RoadTester, parts
        is_users = SIMULATORS.is_own(self.spec.part("simulator").name)
        # What `prepare` has measured takes long, so an installed simulator is copied with it.
        is_copied = not is_users and hasattr(self.simulator, "prepare")
        simulator = self.simulator if is_copied else None
        rules = self.simulator.rules
        terms = self.spec, self.terms, rules, self.folder
        return _remake_tester, (*terms, simulator, self.keeps_notes)

    @property
    def setting(self) -> DriveSetting:
        """Terms of the drives, with the simulator's rules and car."""
        terms: dict[str, Any] = {
            item.name: getattr(self.terms, item.name) for item in fields(Terms)
        }
        return DriveSetting(**terms, rules=self.simulator.rules, car=self.simulator.car)

    @property
    def drives_compiled(self) -> bool:
        """Whether only compiled code of ours drives, which needs no process of its own."""
        driver = with_wrappers(self.driver, self.terms.conditions)
        return capabilities(self.simulator).drives_compiled(driver)

    @property
    def drives_side_by_side(self) -> bool:
        """Whether `test_many` drives many roads at once."""
        return self.drives_compiled and capabilities(self.simulator).drive_compiled is not None

    @property
    def described(self) -> Mapping[str, dict[str, JSONValue]]:
        """Records of driver and simulator, see `frenetic.spec.part_record.describe`."""
        parts = {"driver": self.driver, "simulator": self.simulator}
        with self.in_folder():
            return {kind: describe(part, self._construction(kind)) for kind, part in parts.items()}

    @property
    def sources(self) -> dict[str, str]:
        """Sources of driver and simulator, as far as they are the user's: file name -> text."""
        with self.in_folder():
            driver = sources_of(self.driver, self._construction("driver"))
            return driver | sources_of(self.simulator, self._construction("simulator"))

    def in_folder(self) -> AbstractContextManager[None]:
        """Return a context in which the folder of the parts is the current folder."""
        return nullcontext() if self.folder is None else chdir(self.folder)

    def _construction(self, kind: str) -> Construction | None:
        return None if self.spec is None else self.spec.construction(kind)

    def fit_road(self, candidate: Candidate) -> tuple[Road | None, Verdict]:
        """Return a candidate's road as it would be driven, and whether it is valid, see `fitted`.

        A road that the simulator cannot build is invalid, too.
        """
        road, verdict = fitted(candidate, self.terms)
        if road is not None and verdict.valid:
            try:
                check_road(self.simulator, self.driver, road)
            except RoadError as error:
                return None, Verdict(False, str(error))
        return road, verdict

    def test(self, candidate: Candidate) -> Attempt:
        """Drive a candidate's road in the candidate's conditions, and judge the drive.

        A road that does not fit the map, is not valid, or cannot be built by the simulator is
        INVALID, and nothing is driven.
        """
        road, verdict = self.fit_road(candidate)
        if road is None or not verdict.valid:
            return self._refusal(candidate, road, verdict)
        conditions = self.terms.conditions_of(candidate.conditions)
        if not conditions:
            return self._drive_and_judge(candidate.id, road, self.driver)
        check_conditions(candidate.conditions)
        with in_conditions(conditions, self.simulator, self.driver) as driver:
            check_pair(self.simulator, driver)
            return self._drive_and_judge(candidate.id, road, driver)

    def test_many(self, candidates: Sequence[Candidate], *, threads: int = 1) -> list[Attempt]:
        """Test candidates as `test` does, and drive their roads side by side.

        Args:
            candidates: the candidates.
            threads: number of threads that drive.
        """
        attempts: dict[int, Attempt] = {}
        driven: list[Candidate] = []
        roads: list[Road] = []
        for candidate in candidates:
            road, verdict = self.fit_road(candidate)
            if road is None or not verdict.valid:
                attempts[candidate.id] = self._refusal(candidate, road, verdict)
                continue
            if candidate.conditions:
                check_conditions(candidate.conditions)
            driven.append(candidate)
            roads.append(road)
        conditions = [candidate.conditions for candidate in driven]
        drives = self.drive_many(roads, conditions, threads=threads)
        for candidate, road, drive in zip(driven, roads, drives, strict=True):
            attempts[candidate.id] = self._judged(candidate.id, road, drive)
        return [attempts[candidate.id] for candidate in candidates]

    def drive_many(
        self,
        roads: Sequence[Road],
        conditions: Sequence[Mapping[str, float]],
        *,
        threads: int = 1,
    ) -> Sequence[Drive]:
        """Drive roads side by side, each in the conditions of the terms and its own.

        Args:
            roads: the roads.
            conditions: conditions of each drive.
            threads: number of threads that drive.

        Raises:
            FreneticError: the simulator does not drive side by side, or cannot be put into the
                conditions.
        """
        able = capabilities(self.simulator)
        if able.compiled_drive is None or able.drive_compiled is None:
            raise FreneticError("the simulator drives one road at a time")
        drives = []
        for road, drive_conditions in zip(roads, conditions, strict=True):
            all_conditions = self.terms.conditions_of(drive_conditions)
            if not all_conditions:
                drives.append(able.compiled_drive(road, self.driver))
                continue
            with in_conditions(all_conditions, self.simulator, self.driver) as driver:
                check_pair(self.simulator, driver)
                drives.append(able.compiled_drive(road, driver))
        return able.drive_compiled(drives, threads=threads)

    def attempt(
        self, candidate: Candidate, worker: str | None = None, *, keep_exact: bool = False
    ) -> Attempt:
        """Test a candidate; return the attempt with its time and a packed trajectory.

        Args:
            candidate: the candidate.
            worker: name of the worker; None if the caller adds it.
            keep_exact: whether the attempt has the exact trajectory, too.
        """
        start = time.perf_counter()
        attempt = self.test(candidate).pack(keep_exact=keep_exact)
        seconds = time.perf_counter() - start
        return replace(attempt, worker=worker, seconds=seconds, road=None)

    def drive(self, road: Road, conditions: Mapping[str, float] = MappingProxyType({})) -> Drive:
        """Drive a road in conditions; if the simulator raises, the drive has a trouble."""
        conditions = self.terms.conditions_of(conditions)
        bare = NotingDriver(self.driver) if self.keeps_notes else self.driver
        with in_conditions(conditions, self.simulator, bare) as driver:
            drive = self._drive(road, driver)[0]
            return replace(drive, notes=drive_notes(driver)) if self.keeps_notes else drive

    @staticmethod
    def _refusal(candidate: Candidate, road: Road | None, verdict: Verdict) -> Attempt:
        """Return the attempt at a candidate whose road was refused."""
        pose = road.pose if road else None
        return Attempt.undriven(candidate.id, Outcome.INVALID, verdict.message, pose)

    def _drive_and_judge(self, candidate_id: int, road: Road, driver: Driver) -> Attempt:
        """Drive a road and return the attempt with the verdict."""
        drive, simulator_broke = self._drive(road, driver)
        return self._judged(candidate_id, road, drive, simulator_broke=simulator_broke)

    @staticmethod
    def _judged(
        candidate_id: int, road: Road, drive: Drive, *, simulator_broke: bool = False
    ) -> Attempt:
        """Return the attempt with the verdict on a drive."""
        path = drive.trajectory
        # A broken simulator's trajectory may hold numbers that cannot be stored.
        is_storable = len(path) > 0 and bool(np.isfinite(path.block).all())
        return Attempt(
            candidate_id,
            judge(road, drive),
            road.pose,
            path if is_storable else None,
            simulator_broke=simulator_broke,
            trouble=drive.trouble,
            driver_seconds=drive.driver_seconds,
            road=road,
        )

    def _drive(self, road: Road, driver: Driver) -> tuple[Drive, bool]:
        """Return the drive, and whether the simulator raised."""
        simulator_broke = False
        try:
            with one_process():
                drive = self.simulator.drive(road, driver)
            if not isinstance(drive, Drive):
                raise TypeError(
                    f"its drive gave {type(drive).__name__}: a frenetic.Drive is needed"
                )
        except Exception as error:
            simulator_broke, drive = True, self._empty_drive(trouble_of_error(error, driver))
        if (trouble := drive.trouble) is not None and trouble.traceback:
            logger.debug("%s\n%s", trouble.reason, trouble.traceback)
        return drive, simulator_broke

    def _empty_drive(self, trouble: Trouble) -> Drive:
        """Return the drive without a record that ended by a trouble."""
        simulator = self.simulator
        return Drive(Trajectory.empty(), simulator.car, simulator.rules, trouble=trouble)


def _remake_tester(
    spec: Spec,
    terms: Terms,
    rules: Rules,
    folder: Path,
    simulator: Simulator | None,
    keeps_notes: bool,
) -> RoadTester:
    """Return the tester of parts with names, made in another process; None makes the simulator."""
    os.chdir(folder)  # a driver in this process may have changed to another folder
    if simulator is None:
        return replace(RoadTester.of(spec, terms, rules), keeps_notes=keeps_notes)
    return RoadTester(simulator, spec.make_driver(), terms, spec, folder, keeps_notes)


def fitted(candidate: Candidate, terms: Terms) -> tuple[Road | None, Verdict]:
    """Return a candidate's road on the map, and whether it is valid there.

    The road is None if the values describe no road, the road fits nowhere, or points are invalid.
    """
    points = candidate.points
    try:
        if points is None:
            if terms.road_class is None and not candidate.has_profiles:
                return placed_road(
                    candidate.curvatures,
                    candidate.step,
                    terms.lane_width,
                    terms.map_size,
                    terms.map_margin,
                )
            road = candidate.road(terms.lane_width, road_class=terms.road_class)
            return road.placed(terms.map_size, terms.map_margin, terms.road_class)
        verdict = check_validity(points, terms.map_size)
        return road_through(points, terms.lane_width) if verdict.valid else None, verdict
    except RoadError as error:
        return None, Verdict(False, str(error))


def road_through(points: FloatArray, lane_width: float) -> Road:
    """Return the road through (N, 2) points in m; the last roads are cached.

    A search checks a candidate's road before it is tested, so each road is needed twice.

    Raises:
        RoadError: no road leads through the points.
    """
    return _road_through(points.tobytes(), lane_width)


@lru_cache(maxsize=4)  # roads (our choice)
def _road_through(points: bytes, lane_width: float) -> Road:
    return Road.from_points(np.frombuffer(points).reshape(-1, 2), lane_width=lane_width)
