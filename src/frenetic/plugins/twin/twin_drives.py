"""Drives of the driver under test in the twin's car, in this process or in another.

The driver is the twin's own: it is made by its name, as in a campaign, or is a copy. Code that is
not Frenetic's drives in another process, which protects this one, as in a campaign.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any, Final, NamedTuple

from frenetic.campaign.tester import RoadTester
from frenetic.drivers.driver import Driver
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.drive import Trajectory
from frenetic.plugins.twin.twin_simulator import TwinSimulator
from frenetic.processes.object_process import LostProcessError, ObjectProcess, pack
from frenetic.road import Road
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.spec import Spec
from frenetic.spec.terms import Terms

_MOST_LOSSES: Final = 3
"""Number of lost processes after which the twin drives no more; our choice."""


class UnsuitableDriverError(FreneticError):
    """The driver under test cannot drive in the twin's car; the message says why."""


class TwinJob(NamedTuple):
    """A road that the twin is to drive."""

    road: Road
    conditions: dict[str, Any]
    """Conditions of this drive alone."""


@dataclass(frozen=True)
class DrivenRoad:
    """A road that the twin has driven."""

    trajectory: Trajectory = field(default_factory=Trajectory.empty)
    trouble: str = ""
    """Reason why the drive did not end by the rules; empty if it did."""


class TwinHost:
    """The driver under test in the twin's car.

    Args:
        spec: spec that names the driver; None if ``driver`` has no name.
        driver: a driver without a name, which is copied for another process.
        simulator: simulator with the twin's car.
        terms: terms of the drives.
    """

    def __init__(
        self, spec: Spec | None, driver: Driver | None, simulator: TwinSimulator, terms: Terms
    ) -> None:
        self._spec = spec
        self._driver = driver
        self._simulator = simulator
        self._terms = terms
        self._folder = Path.cwd()

    def start(self) -> None:
        """Make the driver in a process of its own, see `make_driver`."""
        os.chdir(self._folder)
        self.make_driver()

    def make_driver(self) -> None:
        """Make the driver.

        Raises:
            FreneticError: the driver cannot be made, or cannot drive in the embedded simulator.
        """
        if self._spec is not None:
            self._driver = self._spec.make_driver()
        assert self._driver is not None
        compile_kernels()
        self._tester = RoadTester(self._simulator, self._driver, self._terms)

    def drive(self, car: Vehicle, jobs: Sequence[TwinJob]) -> list[DrivenRoad]:
        """Drive roads with a car."""
        self._simulator.vehicle = car
        if self._tester.drives_side_by_side:
            drives = self._tester.drive_many(
                [job.road for job in jobs], [job.conditions for job in jobs]
            )
            return [DrivenRoad(drive.trajectory) for drive in drives]
        return [self._drive(job) for job in jobs]

    def _drive(self, job: TwinJob) -> DrivenRoad:
        """Drive a road."""
        try:
            drive = self._tester.drive(job.road, job.conditions)
        except FreneticError as error:
            return DrivenRoad(trouble=str(error))
        trouble = "" if drive.trouble is None else drive.trouble.reason
        return DrivenRoad(drive.trajectory, trouble)

    def close(self) -> None:
        """End nothing."""


class TwinDrives:
    """The drives of a twin; its process, if there is one, ends with this object.

    Args:
        host: the driver in the twin's car, which is not started yet.
        is_compiled: whether only compiled code of Frenetic's drives, which needs no process.
        limit: wall time in s after which a drive counts as hanging.

    Raises:
        UnsuitableDriverError: the driver cannot be made or copied, or cannot drive in the embedded
            simulator.
    """

    def __init__(self, host: TwinHost, *, is_compiled: bool, limit: float) -> None:
        self._limit = limit
        self._losses = 0
        self._process: ObjectProcess | None = None
        self._host = host
        try:
            if is_compiled:
                host.make_driver()
                return
            self._process = ObjectProcess("the twin's process", pack(host))
            # At the exit, multiprocessing joins its processes: this one has to end before.
            Finalize(self, self._process.kill, exitpriority=0)
            self._start(self._process)
        except (FreneticError, CampaignError, LostProcessError, OSError, EOFError) as error:
            if self._process is not None:
                self._process.kill()
            raise UnsuitableDriverError(str(error)) from None

    def _start(self, process: ObjectProcess) -> None:
        """Start the process and wait until the driver is made."""
        process.start()
        process.answer()

    @property
    def is_over(self) -> bool:
        """Whether the driver ended its process or hung so often that it drives no more."""
        return self._losses >= _MOST_LOSSES

    def drive(self, car: Vehicle, jobs: Sequence[TwinJob]) -> list[DrivenRoad]:
        """Drive roads with a car; a road that loses the process has a trouble."""
        if self._process is None:
            return self._host.drive(car, jobs)
        trouble = "the driver ended its process or hung too often"
        if not self.is_over:
            try:
                return self._call(self._process, car, jobs)
            except LostProcessError as error:
                self._note_loss(self._process)
                trouble = str(error)
        if len(jobs) == 1 or self.is_over:
            return [DrivenRoad(trouble=trouble) for _ in jobs]
        return [self.drive(car, [job])[0] for job in jobs]  # to find the road that loses it

    def _call(
        self, process: ObjectProcess, car: Vehicle, jobs: Sequence[TwinJob]
    ) -> list[DrivenRoad]:
        """Drive roads in the other process.

        Raises:
            LostProcessError: the process was lost.
        """
        limit = self._limit * len(jobs)
        drives: list[DrivenRoad] = process.call(
            "drive", car, list(jobs), limit=limit, answer=list[DrivenRoad]
        )
        if len(drives) != len(jobs):
            raise CampaignError("the twin's process answered with another number of drives")
        return drives

    def _note_loss(self, process: ObjectProcess) -> None:
        """Count a lost process, and start another unless there were too many."""
        self._losses += 1
        process.kill()
        if not self.is_over:
            try:
                self._start(process)
            except (LostProcessError, OSError, EOFError):
                process.kill()
                self._losses = _MOST_LOSSES
