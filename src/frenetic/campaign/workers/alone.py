"""A process that drives single roads, so that no driver can end the process that asks for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Self, TypeAlias

from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.local import is_isolable
from frenetic.errors import CampaignError, Trouble
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.notes import DriverNotes
from frenetic.processes.object_process import LostProcessError, ObjectProcess, pack
from frenetic.road import Road
from frenetic.simulators.blame import Blame, trouble_of_error, trouble_of_lost_process
from frenetic.simulators.capabilities import capabilities

Driving: TypeAlias = Callable[[Road, Mapping[str, float]], Drive]
"""Function that drives a road in conditions."""


@contextmanager
def driving(tester: RoadTester, *, isolate: bool = False) -> Iterator[Driving]:
    """Start a tester's simulator, and yield the function that drives a road in it.

    Args:
        tester: tester whose driver and simulator drive.
        isolate: whether to drive in another process, unless only compiled code of ours drives.

    Raises:
        CampaignError: the simulator does not start in the other process.
    """
    if isolate and is_isolable(tester):
        with DriveProcess(tester) as process:
            yield process.drive
    else:
        with tester.simulator:
            yield tester.drive


class DriveProcess:
    """A process that drives roads, one after the other.

    A driver that ends the process, hangs, closes files or changes the folder does no other harm:
    its drive has a trouble, and the next drive has a new process.

    Args:
        tester: tester that drives in the process; its parts are made by their names, or copied.
        drive_limit: wall time in s after which a drive counts as hanging; by default 1.5 times the
            simulator's ``wall_limit``, plus 10 s.

    Raises:
        CampaignError: driver or simulator cannot be copied.
    """

    def __init__(self, tester: RoadTester, *, drive_limit: float | None = None) -> None:
        able = capabilities(tester.simulator)
        self._tester = tester
        self._limit = able.drive_limit if drive_limit is None else drive_limit
        self._blame = Blame.of(tester.simulator, tester.driver)
        self._process = ObjectProcess(
            "the driver's process", pack(_DriveHost(tester)), able.preloads
        )
        self._is_started = False

    def __enter__(self) -> Self:
        """Start the process and the simulator in it.

        Raises:
            CampaignError: the process does not start.
        """
        try:
            self._process.start(CarBody)
            car: CarBody = self._process.answer()
        except LostProcessError as error:
            self._process.kill()
            raise CampaignError(trouble_of_lost_process(error).reason) from None
        except BaseException:
            self._process.kill()
            raise
        if self._tester.simulator.car != car:  # a simulator measures its car when it starts
            self._tester.simulator.car = car
        self._is_started = True
        return self

    def __exit__(self, *_: object) -> None:
        """End the simulator, or kill its process if it still drives.

        Raises:
            CampaignError: the simulator raised when it ended.
        """
        self._is_started = False
        try:
            self._process.close()
        except LostProcessError as error:
            raise CampaignError(trouble_of_lost_process(error).reason) from None

    def drive(self, road: Road, conditions: Mapping[str, float] = MappingProxyType({})) -> Drive:
        """Drive a road in conditions; an error ends the drive, which then has a trouble.

        Raises:
            CampaignError: the process was lost, and another does not start.
        """
        if not self._is_started:
            self.__enter__()
        try:
            drive: _RoadlessDrive = self._process.call(
                "drive", road, dict(conditions), limit=self._limit, answer=_RoadlessDrive
            )
        except LostProcessError as error:
            self._process.kill()
            self._is_started = False
            trouble = trouble_of_lost_process(error, self._blame.fault(error))
            drive = _RoadlessDrive(
                self._tester.simulator.car, self._tester.simulator.rules, trouble
            )
        return drive.along(road)


@dataclass(frozen=True)
class _RoadlessDrive:
    """A `Drive` without its road, which the asking process knows."""

    car: CarBody = field(default_factory=CarBody)
    rules: Rules = field(default_factory=Rules)
    trouble: Trouble | None = None
    trajectory: Trajectory = field(default_factory=Trajectory.empty)
    has_road: bool = False
    driver_seconds: float = 0.0
    notes: DriverNotes | None = None

    def along(self, road: Road) -> Drive:
        """Return the drive along a road."""
        return Drive(
            self.trajectory,
            self.car,
            self.rules,
            road if self.has_road else None,
            self.trouble,
            self.driver_seconds,
            notes=self.notes,
        )


class _DriveHost:
    """The object in the other process: a tester that drives."""

    def __init__(self, tester: RoadTester) -> None:
        self._tester = tester

    def start(self) -> CarBody:
        self._tester.simulator.__enter__()
        return self._tester.simulator.car

    def drive(self, road: Road, conditions: dict[str, float]) -> _RoadlessDrive:
        simulator = self._tester.simulator
        try:
            drive = self._tester.drive(road, conditions)
        except BaseException as error:  # including SystemExit
            return _RoadlessDrive(
                simulator.car, simulator.rules, trouble_of_error(error, self._tester.driver)
            )
        return _RoadlessDrive(
            drive.car,
            drive.rules,
            drive.trouble,
            drive.trajectory,
            drive.road is not None,
            drive.driver_seconds,
            drive.notes,
        )

    def close(self) -> None:
        self._tester.simulator.__exit__(None, None, None)
