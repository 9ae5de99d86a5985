"""A simulator in a process of its own, so that no driver can break the one that searches."""

from __future__ import annotations

import io
import logging
import pickle
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Final, NamedTuple, Self, TypeAlias

from frenetic._support.child_processes import (
    Failed,
    Line,
    Logged,
    ending_of,
    kill_process,
    one_process,
    process_context,
    serving,
    start_process,
)
from frenetic.drivers.driver import Driver, under_layers
from frenetic.errors import (
    CampaignError,
    FreneticError,
    describe_error,
    describe_raised,
    traceback_of,
)
from frenetic.registry import load_user_file, made_by, user_files
from frenetic.road import Road
from frenetic.simulators.capabilities import VARIABLE, capabilities
from frenetic.simulators.drive import CarBody, Drive
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.simulator import Simulator

START_LIMIT: Final = 600.0
"""Time that a simulator may take to start, in s."""
CLOSING_LIMIT: Final = 30.0
"""Time that it has to end, in s."""

_LEAVING_LIMIT: Final = 1.0  # s that the process has to leave when its simulator has ended

logger = logging.getLogger(__name__)


class BrokenDriveError(FreneticError):
    """A drive that broke the simulator or its process; the message says who did what."""

    def __init__(self, reason: str, traceback: str = "") -> None:
        super().__init__(reason)
        self.traceback = traceback


def isolated(simulator: Simulator, driver: Driver, drive_limit: float | None = None) -> Simulator:
    """The simulator, in a process of its own unless only compiled code of ours will drive.

    A driver that cannot be copied drives in this process, which a warning says.
    """
    if capabilities(simulator).drives_compiled(driver):
        return simulator
    try:
        pack((simulator, driver))
    except CampaignError as error:
        logger.warning("nothing protects this process from the driver: %s", error)
        return simulator
    return IsolatedSimulator(simulator, drive_limit=drive_limit)


class IsolatedSimulator:
    """A simulator in a process of its own, with a copy of the driver.

    A driver that kills the process, hangs, closes its files or moves to another folder harms
    nothing else: its drive is a broken one with a reason, and the next drive has a new process. All
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
        self._child: _Child | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "simulator_inside":
            raise AttributeError(name)
        return getattr(self.simulator_inside, name)

    def __setattr__(self, name: str, value: object) -> None:
        if name in VARIABLE:
            setattr(self.simulator_inside, name, value)
        else:
            super().__setattr__(name, value)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_child": None}

    def __enter__(self) -> Self:
        """Starts the process and the simulator in it.

        Raises:
            FreneticError: it does not start, or cannot be copied.
        """
        self._child = _Child(self.simulator_inside)
        try:
            compile_kernels()  # meanwhile: roads are checked here
            car = self._child.await_start()
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
        if self._child is not None:
            try:
                self._child.dismiss()
            finally:
                self._kill()

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road.

        Raises:
            BrokenDriveError: the driver or the simulator broke the process.
            FreneticError: the driver cannot be copied, or the simulator does not start again.
        """
        if self._child is None:
            self.__enter__()
        assert self._child is not None
        try:
            return self._child.drive(road, driver, self._drive_limit)
        except BrokenDriveError:
            if self._child.is_driving:  # it is lost; otherwise the simulator is there to be ended
                self._kill()
            raise

    def _kill(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.kill()


class _Child:
    """The process, as its parent sees it."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        able = capabilities(simulator)
        self._variable = able.variable
        self._numbers = 0  # of drives
        self.is_driving = False
        self._last: Driver | None = None  # whom it has
        self._own: Driver | None = None  # the same, without layers
        self._process: BaseProcess
        self._connection: Connection
        self._process, self._connection = start_process(
            process_context(able.preloads),
            _serve,
            user_files(),
            pack(simulator),
            name="simulator",
        )

    def await_start(self) -> CarBody:
        """Waits until the simulator has started; the box of its car."""
        message = self._hear(START_LIMIT, "start")
        if not isinstance(message, _Started):
            raise BrokenDriveError("the simulator's process said something else than that it is up")
        return message.car

    def drive(self, road: Road, driver: Driver, limit: float) -> Drive:
        """A drive."""
        payload = b""
        if driver is not self._last:
            payload = pack(driver, known=self._own)
            self._last, self._own = driver, under_layers(driver)
        values = {name: getattr(self._simulator, name) for name in self._variable}
        self._numbers += 1
        self.is_driving = True
        task = _Task(self._numbers, road, values, payload)
        with suppress(OSError):  # it has died, as will be heard
            self._connection.send_bytes(pickle.dumps(task))
        while True:
            message = self._hear(limit, "drive")
            if isinstance(message, _Done) and message.number == self._numbers:
                break
            logger.warning("the driver's process sent what is not counted: does the driver fork?")
        self.is_driving = False
        if isinstance(message.drive, Drive):
            return message.drive
        raise BrokenDriveError(*message.drive)

    def _hear(self, limit: float, what: str) -> _Message:
        """The next message that is not for the log, within a limit in s."""
        deadline = time.monotonic() + limit
        while True:
            heard = wait(
                [self._connection, self._process.sentinel], max(0.0, deadline - time.monotonic())
            )
            if not heard:
                why = f"its {what} took more than {limit:.3g} s"
                raise BrokenDriveError(f"the driver's process was lost: {why}")
            try:
                if self._connection not in heard and not self._connection.poll():
                    raise EOFError
                # It comes from our own process, so it may be unpickled.
                message: _Message | Logged = pickle.loads(self._connection.recv_bytes())  # noqa: S301
            except Exception:  # its end, or nonsense that a driver has written there
                self._process.join(_LEAVING_LIMIT)
                why = ending_of(self._process.exitcode)
                raise BrokenDriveError(f"the driver's process was lost: {why}") from None
            match message:
                case Logged(level, name, text):
                    logging.getLogger(name).log(level, "%s", text)
                case Failed(reason, trace):
                    raise BrokenDriveError(reason, trace)
                case _:
                    return message

    def dismiss(self) -> None:
        """Lets the simulator end, if it does not drive."""
        if self.is_driving or not self._process.is_alive():
            return
        with suppress(OSError):
            self._connection.send_bytes(pickle.dumps(None))
        try:
            self._hear(CLOSING_LIMIT, "end")
        except BrokenDriveError as error:
            if error.traceback:
                raise
        # Not for a driver's threads and processes, which may never end.
        self._process.join(_LEAVING_LIMIT)

    def kill(self) -> None:
        """Kills the process with all that it has started."""
        kill_process(self._process)
        self._process.join()
        self._process.close()
        self._connection.close()


# The work of the process


class _Task(NamedTuple):
    """A road to drive."""

    number: int
    road: Road
    values: dict[str, Any]
    """Attributes of the simulator that may be set between two drives."""
    driver: bytes
    """The driver, empty for that of the last drive."""


class _Started(NamedTuple):
    """The simulator has started."""

    car: CarBody


class _Done(NamedTuple):
    """A drive has ended."""

    number: int
    drive: Drive | tuple[str, str]
    """The drive, or who broke it, with a traceback."""


_Message: TypeAlias = _Started | _Done | Failed


def _serve(connection: Connection, files: Sequence[str], packed: bytes) -> None:
    """Drives the roads from the connection until it ends or a None comes."""
    with serving(connection, pickle.dumps) as line:
        for file in files:
            load_user_file(file)
        with unpack(packed) as simulator:
            _drive_all(line, simulator)


def _drive_all(line: Line, simulator: Simulator) -> None:
    line.send(pickle.dumps(_Started(simulator.car)))
    driver: Driver | None = None
    own: Driver | None = None
    # It comes from our own parent, so it may be unpickled.
    while (data := line.receive()) is not None and (task := pickle.loads(data)) is not None:  # noqa: S301
        if task.driver:
            driver = unpack(task.driver, known=own)
            own = under_layers(driver)
        assert driver is not None
        for name, value in task.values.items():
            if getattr(simulator, name) != value:
                setattr(simulator, name, value)
        drive: Drive | tuple[str, str]
        try:
            with one_process():
                drive = simulator.drive(task.road, driver)
        except BaseException as error:  # a SystemExit, say
            drive = f"the simulator raised {describe_raised(error)}", traceback_of(error)
        line.send(pickle.dumps(_Done(task.number, drive)))


# Copies of drivers and simulators for other processes


def pack(part: object, known: object = None) -> bytes:
    """A part as bytes for a process that has loaded the user's files.

    What cannot be pickled, such as a loaded network, is made anew there, if it was made by name.

    Args:
        part: a driver, a simulator, or what holds them.
        known: a part of it that the other process has already.

    Raises:
        CampaignError: it cannot be copied.
    """
    try:
        return _pickled(part, known, by_name=False)
    except Exception as error:
        with_names = _or_none(part, known)
        if with_names is None:
            raise CampaignError(
                "the driver or simulator cannot be copied to another process"
                f" ({describe_error(error)}): define it in a module of its own, or drive it in this"
                " process, with a Campaign of objects and one worker"
            ) from error
        return with_names


def unpack(data: bytes, known: object = None) -> Any:
    """The part in bytes from `pack`; any error for other bytes."""
    return _Unpickler(data, known).load()


def _or_none(part: object, known: object) -> bytes | None:
    try:
        return _pickled(part, known, by_name=True)
    except Exception:
        return None


def _pickled(part: object, known: object, *, by_name: bool) -> bytes:
    file = io.BytesIO()
    _Pickler(file, known, by_name).dump(part)
    return file.getvalue()


class _Pickler(pickle.Pickler):
    """Leaves out a known part, and writes the names of others."""

    def __init__(self, file: io.BytesIO, known: object, by_name: bool) -> None:
        super().__init__(file)
        self._known = known
        self._by_name = by_name

    def persistent_id(self, part: object) -> str | None:
        return "known" if part is self._known and part is not None else None

    def reducer_override(self, part: object) -> Any:
        made = made_by(part) if self._by_name else None
        if made is None:
            return NotImplemented
        return partial(made.factory, **made.arguments), ()


class _Unpickler(pickle.Unpickler):
    """Puts the known part in its place; the bytes come from our own process."""

    def __init__(self, data: bytes, known: object) -> None:
        super().__init__(io.BytesIO(data))
        self._known = known

    def persistent_load(self, pid: str) -> object:  # noqa: ARG002 - there is one
        return self._known
