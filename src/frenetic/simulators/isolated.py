"""A simulator in a process of its own, so that no driver can end the one that searches."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Any, Final, Literal, Self

from frenetic.drive import CarBody, Drive, Rules, Trajectory
from frenetic.drivers.driver import Driver, is_of_driver, stack_of, under_layers
from frenetic.errors import (
    BREAKS_PROTOCOL,
    ENDS_ITS_PROCESS,
    HANGS,
    IS_KILLED,
    CampaignError,
    Fault,
    FreneticError,
    Trouble,
    describe_raised,
)
from frenetic.quantities import attributes
from frenetic.recipe import Named
from frenetic.road import Road
from frenetic.simulators.capabilities import bare, capabilities
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.simulator import Simulator
from frenetic.worker import START_LIMIT, Loss, LostWorkerError, Worker, pack, unpack

_FAULTS: Final = {
    Loss.LATE: HANGS,
    Loss.ENDED: ENDS_ITS_PROCESS,
    Loss.KILLED: IS_KILLED,
    Loss.BROKE_PROTOCOL: BREAKS_PROTOCOL,
}
"""How a process was lost during a drive -> kind of the fault of the driver that did it."""
_OUR_PURE_SIMULATORS: Final = ("frenetic.simulators.", "frenetic.testing.")
"""Beginnings of the names of modules whose simulators run no code but ours."""

logger = logging.getLogger(__name__)


class BrokenDriveError(FreneticError):
    """A drive in which the simulator or its process broke; the message says who did what."""

    def __init__(self, trouble: Trouble) -> None:
        super().__init__(trouble.reason)
        self.trouble = trouble


def raised(error: BaseException, driver: Driver) -> Trouble:
    """Return the trouble that an error in a simulator's ``drive`` makes, possibly the driver's."""
    part: Literal["driver", "simulator"]
    part = "driver" if is_of_driver(error, driver) else "simulator"
    return Trouble.of(error, part, f"the {part} raised {describe_raised(error)}")


@dataclass(frozen=True)
class Blame:
    """Which losses of a process during a drive are the driver's doing, even if it was not asked.

    A process that ends or hangs while the driver is asked does so by the driver; at other times,
    where the simulator is code of ours alone and the driver is not. A process breaks the protocol
    by the only code in it that is not ours.
    """

    losses: frozenset[Loss]

    @classmethod
    def of(cls, simulator: Simulator, driver: Driver) -> Self:
        """The driver's doings in the process of a simulator."""
        simulator = bare(simulator)
        home = "" if isinstance(simulator, Named) else type(simulator).__module__
        if all(_is_ours(part) for part in stack_of(driver)) or not home.startswith("frenetic."):
            return cls(frozenset())
        if home.startswith(_OUR_PURE_SIMULATORS):
            return cls(frozenset(_FAULTS))
        return cls(frozenset({Loss.BROKE_PROTOCOL}))

    def fault(self, error: LostWorkerError) -> Fault | None:
        """The driver's fault, if the process was lost by what the driver did."""
        kind = _FAULTS.get(error.loss)
        was_asked = error.is_drivers_turn and error.loss is not Loss.BROKE_PROTOCOL
        is_drivers = was_asked or error.loss in self.losses
        return Fault("driver", kind) if kind is not None and is_drivers else None


def _is_ours(part: object) -> bool:
    return not isinstance(part, Named) and type(part).__module__.partition(".")[0] == "frenetic"


def lost_process(error: LostWorkerError, fault: Fault | None = None) -> Trouble:
    """Return the trouble of a drive whose process was lost.

    Args:
        error: how the process was lost.
        fault: the driver's, if the driver lost the process.
    """
    if error.trouble.traceback:
        return replace(error.trouble, fault=fault)
    doubt = ", by itself or by the system, as where memory is short"
    loss = f"the driver's process was lost: {error}{doubt * (error.loss is Loss.KILLED)}"
    return Trouble(loss, fault=fault)


def isolated(simulator: Simulator, driver: Driver, drive_limit: float | None = None) -> Simulator:
    """The simulator, in a process of its own unless only compiled code of ours will drive.

    A driver that cannot be copied drives in this process, which a warning says.
    """
    if capabilities(simulator).drives_compiled(driver):
        return simulator
    try:
        pack((simulator, driver))
    except CampaignError as error:
        if is_named(simulator, driver):
            raise
        logger.warning("nothing protects this process from the driver: %s", error)
        return simulator
    return IsolatedSimulator(simulator, drive_limit=drive_limit)


def is_named(simulator: Simulator, driver: Driver) -> bool:
    """Whether one of them is a user's own that only other processes make."""
    return any(isinstance(part, Named) for part in (simulator, under_layers(driver)))


class IsolatedSimulator:
    """A simulator in a process of its own, with a copy of the driver.

    A driver that kills the process, hangs, closes its files or moves to another folder harms
    nothing else: that drive raises `BrokenDriveError`, and the next drive has a new process. All
    else is as in the simulator itself, whose attributes it has; the same drives come out. A driver
    is copied before its first drive, so changing it later has no effect.

    Args:
        simulator: not entered; it must be picklable, or named (see `frenetic.registry`).
        drive_limit: s of wall time after which a drive counts as hanging; by default half as long
            again as the simulator's own ``wall_limit``, and 10 s.
    """

    def __init__(self, simulator: Simulator, *, drive_limit: float | None = None) -> None:
        self.simulator_inside = simulator
        self._drive_limit = drive_limit or capabilities(simulator).drive_limit
        self._worker: Worker | None = None
        self._last: Driver | None = None  # whom the process has
        self._own: Driver | None = None  # the same, without layers

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "simulator_inside":
            raise AttributeError(name)
        return getattr(self.simulator_inside, name)

    def __setattr__(self, name: str, value: object) -> None:
        if name in attributes():
            setattr(self.simulator_inside, name, value)
        else:
            super().__setattr__(name, value)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_worker": None, "_last": None, "_own": None}

    def __enter__(self) -> Self:
        """Starts the process and the simulator in it.

        Raises:
            FreneticError: it does not start, or cannot be copied.
        """
        able = capabilities(self.simulator_inside)
        self._worker = Worker(
            "the driver's process", pack(_Held(self.simulator_inside)), able.preloads
        )
        self._last = self._own = None
        try:
            self._worker.start(CarBody)
            compile_kernels()  # meanwhile: roads are checked here
            car: CarBody = self._worker.answer()
        except LostWorkerError as error:
            self._kill()
            raise BrokenDriveError(lost_process(error)) from None
        except BaseException:
            self._kill()
            raise
        if self.simulator_inside.car != car:  # measured there
            self.simulator_inside.car = car
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends the simulator, or kills its process if it still drives."""
        worker, self._worker = self._worker, None
        if worker is not None:
            try:
                worker.close()
            except LostWorkerError as lost:
                raise BrokenDriveError(lost_process(lost)) from None

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road.

        Raises:
            BrokenDriveError: the driver or the simulator ended the process.
            FreneticError: the driver cannot be copied, or the simulator does not start again.
        """
        if self._worker is None:
            self.__enter__()
        assert self._worker is not None
        packed = b""
        if driver is not self._last:
            own = under_layers(driver)
            packed = pack((driver, own), known=self._own)
            self._last, self._own = driver, own
        variable = capabilities(self.simulator_inside).variable
        values = {name: getattr(self.simulator_inside, name) for name in variable}
        try:
            if packed:
                self._worker.call("take", packed, limit=START_LIMIT)
            answer: _DriveAnswer = self._worker.call(
                "drive", road, values, limit=self._drive_limit, answer=_DriveAnswer
            )
        except LostWorkerError as error:
            self._kill()
            fault = Blame.of(self.simulator_inside, driver).fault(error)
            raise BrokenDriveError(lost_process(error, fault)) from None
        if answer.trajectory is None:
            raise BrokenDriveError(answer.trouble or Trouble("the drive has no record"))
        return answer.drive(answer.trajectory, road)

    def _kill(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.kill()


@dataclass(frozen=True, kw_only=True)
class _DriveAnswer:
    """Answer of the process: a `Drive`, or the error that broke it."""

    trajectory: Trajectory | None = None
    car: CarBody = field(default_factory=CarBody)
    rules: Rules = field(default_factory=Rules)
    trouble: Trouble | None = None
    has_road: bool = False
    driver_seconds: float = 0.0

    @classmethod
    def of(cls, drive: Drive) -> Self:
        """The answer with a drive."""
        return cls(
            trajectory=drive.trajectory,
            car=drive.car,
            rules=drive.rules,
            trouble=drive.trouble,
            has_road=drive.road is not None,
            driver_seconds=drive.driver_seconds,
        )

    def drive(self, trajectory: Trajectory, road: Road) -> Drive:
        """The drive along the road."""
        return Drive(
            trajectory,
            self.car,
            self.rules,
            road if self.has_road else None,
            self.trouble,
            self.driver_seconds,
        )


class _Held:
    """The simulator in the process, and the driver of the last drive."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._driver: Driver | None = None
        self._own: Driver | None = None

    def start(self) -> CarBody:
        self._simulator.__enter__()
        return self._simulator.car

    def take(self, driver: bytes) -> None:
        """Makes the driver of the next drives."""
        self._driver, self._own = unpack(driver, known=self._own)

    def drive(self, road: Road, values: dict[str, Any]) -> _DriveAnswer:
        """The drive, or the error that ended it."""
        assert self._driver is not None
        for name, value in values.items():
            if getattr(self._simulator, name) != value:
                setattr(self._simulator, name, value)
        try:
            drive = self._simulator.drive(road, self._driver)
            if not isinstance(drive, Drive):
                raise TypeError(f"drive returned {type(drive).__name__} instead of a Drive")
        except BaseException as error:  # a SystemExit, say
            return _DriveAnswer(trouble=raised(error, self._driver))
        return _DriveAnswer.of(drive)

    def close(self) -> None:
        self._simulator.__exit__(None, None, None)
