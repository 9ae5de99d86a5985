"""Simulators, drivers and strategies with faults, in a module that workers can import."""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import itertools
import logging
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self

import numpy as np

from frenetic.drivers import Driver, DriveSetup
from frenetic.road import Road
from frenetic.search import Candidate, Evaluation, Origin
from frenetic.search.strategy import Strategy
from frenetic.simulators import Drive, Rules
from frenetic.testing import DummyDriver, DummySimulator
from frenetic.testing.dummies import no_drift

LIMIT = 120.0
"""Seconds after which a waiting part goes on, so that no process stays forever."""


@dataclass(frozen=True)
class Marks:
    """Empty files in a folder, by which the processes of a test signal each other."""

    folder: Path

    def make(self, name: str) -> bool:
        """Make a mark; return whether it is new."""
        try:
            (self.folder / name).touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    def are_there(self, *names: str) -> bool:
        """Return whether all these marks are there."""
        return all((self.folder / name).exists() for name in names)

    def numbers(self, name: str) -> list[int]:
        """Return the numbers of the marks called name-number, in order."""
        return sorted(int(path.name.rpartition("-")[2]) for path in self.folder.glob(f"{name}-*"))

    def pids(self) -> list[int]:
        """Return the ids of all processes that left a mark ``pid-P``."""
        return self.numbers("pid")

    def wait_for(self, name: str) -> None:
        """Wait until a mark is there, at most `LIMIT` seconds."""
        deadline = time.monotonic() + LIMIT
        while not self.are_there(name) and time.monotonic() < deadline:
            time.sleep(0.002)


Deed = Callable[[Marks], None]
"""What a fault does. Its function's name is the name of its marks."""


def kill(marks: Marks) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave(marks: Marks) -> None:
    os._exit(7)


def sys_exit(marks: Marks) -> None:
    sys.exit(3)


def press_ctrl_c(marks: Marks) -> None:
    raise KeyboardInterrupt


def refuse_connection(marks: Marks) -> None:
    raise ConnectionRefusedError("nobody listens\non port 25252")


def raise_error(marks: Marks) -> None:
    raise RuntimeError("the engine stalled")


STALLED = (
    "the simulator raised RuntimeError: the engine stalled"
    f" (faulty.py:{raise_error.__code__.co_firstlineno + 1}:"
    ' raise RuntimeError("the engine stalled"))'
)
"""Reason of the test in which `raise_error` strikes."""


def hang(marks: Marks) -> None:
    time.sleep(LIMIT)


def hang_in_c(marks: Marks) -> None:
    """Hang in compiled code, where no other thread of the process gets a turn."""
    ctypes.PyDLL(None).sleep(int(LIMIT))


def start_process_and_hang(marks: Marks) -> None:
    start_process(marks)
    (hang_in_c if sys.platform == "linux" else hang)(marks)


def await_go(marks: Marks) -> None:
    marks.wait_for("go")


def print_megabytes(marks: Marks) -> None:
    for stream in (sys.stdout, sys.stderr):
        stream.write("all work and no play\n" * 200_000)


def start_thread(marks: Marks) -> None:
    """Start a thread for which the process waits at its end."""
    threading.Thread(target=time.sleep, args=(LIMIT,)).start()


def start_process(marks: Marks) -> None:
    child = subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({10 * LIMIT})"])
    marks.make(f"pid-{child.pid}")
    child.returncode = 0  # so that Python neither waits for the child nor warns about it


def fork_and_kill(marks: Marks) -> None:
    """Fork a child that keeps the connections open, then kill this process."""
    child = os.fork()
    if child == 0:
        time.sleep(LIMIT)
        os._exit(0)
    marks.make(f"pid-{child}")
    kill(marks)


def fork(marks: Marks) -> None:
    """Fork; parent and child both go on."""
    child = os.fork()
    if child:
        marks.make(f"pid-{child}")


def fork_and_leave(marks: Marks) -> None:
    """Fork a child that ends as Python programs do."""
    child = os.fork()
    if child == 0:
        sys.exit(0)
    marks.make(f"pid-{child}")


def answer_twice(marks: Marks) -> None:
    """Let the process send each message twice from now on."""
    for connection in gc.get_objects():
        if isinstance(connection, Connection):
            connection.send_bytes = _twice(connection.send_bytes)  # type: ignore[method-assign]


def _twice(send: Callable[..., None]) -> Callable[..., None]:
    def send_twice(data: bytes) -> None:
        send(data)
        send(data)

    return send_twice


def segfault(marks: Marks) -> None:
    faulthandler.disable()  # pytest's
    ctypes.string_at(0)


class OddError(BaseException):
    """An error that is no `Exception`."""


def raise_odd_error(marks: Marks) -> None:
    raise OddError("so odd")


def change_folder(marks: Marks) -> None:
    gone = marks.folder / "gone"
    gone.mkdir(exist_ok=True)
    os.chdir(gone)
    gone.rmdir()


def change_signals(marks: Marks) -> None:
    for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
        signal.signal(number, signal.SIG_IGN)


def replace_streams(marks: Marks) -> None:
    for name in ("stdout", "stderr", "__stdout__", "__stderr__"):
        setattr(sys, name, None)


def limit_resources(marks: Marks) -> None:
    import resource  # POSIX

    for limit in (resource.RLIMIT_FSIZE, resource.RLIMIT_NPROC, resource.RLIMIT_CORE):
        resource.setrlimit(limit, (0, 0))


def limit_memory(marks: Marks) -> None:
    import resource  # POSIX

    resource.setrlimit(resource.RLIMIT_AS, (1, 1))
    bytearray(10**8)


def close_everything(marks: Marks) -> None:
    os.closerange(0, 256)


def close_streams(marks: Marks) -> None:
    os.closerange(0, 3)


def write_nonsense(marks: Marks) -> None:
    """Write bytes that are no message to every socket of the process."""
    for descriptor in range(3, 64):
        try:
            if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
                os.write(descriptor, b"\0\0\0\x08nonsense")
        except OSError:
            continue


def write_log(marks: Marks) -> None:
    logging.getLogger("frenetic.driver").warning("the road is %s", "wet")


@dataclass(frozen=True)
class Fault:
    """A deed, the roads on which it happens, and how often it happens."""

    deed: Deed
    folder: Path
    """Folder of the marks."""
    samples: int | None = None
    """Samples of the roads on which the fault strikes; None for all roads."""
    times: int | None = None
    """Number of strikes in all processes together; None for every time."""

    def strike(self, samples: int | None = None) -> None:
        """Do the deed if a road has the right number of samples and strikes are left."""
        if self.samples not in (None, samples):
            return
        marks = Marks(self.folder)
        name = self.deed.__name__
        if self.times is None or any(marks.make(f"{name}-{i}") for i in range(self.times)):
            self.deed(marks)


def bend(road: Road) -> float:
    """Return a drift in m that grows with the road's curvature, so that a search can learn it."""
    return 80.0 * float(abs(road.curvatures).mean())


class FaultySimulator(DummySimulator):
    """A simulator that leaves marks, and has faults at its start, in its drives and at its end.

    Marks: ``pid-P`` for its process, ``start-N`` and ``end-N`` for the Nth start and end in all
    processes together.
    """

    def __init__(
        self,
        folder: Path | str = ".",
        *,
        start: Fault | None = None,
        drive: Fault | Sequence[Fault] | None = None,
        end: Fault | None = None,
        drift: Callable[[Road], float] = bend,
        rules: Rules | None = None,
    ) -> None:
        super().__init__(drift, rules=rules)
        self.marks = Marks(Path(folder))
        self.faults = [
            (fault,) if isinstance(fault, Fault) else fault or () for fault in (start, drive, end)
        ]

    def _strike(self, k: int, samples: int | None = None) -> None:
        for fault in self.faults[k]:
            fault.strike(samples)

    def _count(self, name: str) -> None:
        next(n for n in itertools.count(1) if self.marks.make(f"{name}-{n}"))

    def __enter__(self) -> Self:
        self.marks.make(f"pid-{os.getpid()}")
        self._count("start")
        self._strike(0)
        return self

    def __exit__(self, *error: object) -> None:
        self._count("end")
        self._strike(2)

    def drive(self, road: Road, driver: Driver) -> Drive:
        self._strike(1, len(road.curvatures))
        return super().drive(road, driver)


class NoDrive(DummySimulator):
    """A simulator whose drives return None."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        return None  # type: ignore[return-value]


class FarAway(DummySimulator):
    """A simulator that records a finite value that no file can hold."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        drive = super().drive(road, driver)
        rows = drive.trajectory.to_rows()
        rows[-1, 8] = 1e300  # what the driver asked for
        return Drive(type(drive.trajectory).from_rows(rows), drive.car, drive.rules)


class Uneven(DummySimulator):
    """A simulator that takes longer on some roads, so that results come in another order."""

    def __init__(self, seconds: float = 0.01) -> None:
        super().__init__(bend)
        self.seconds = seconds

    def drive(self, road: Road, driver: Driver) -> Drive:
        digits = int(1e6 * float(abs(road.curvatures).sum()))
        time.sleep(self.seconds * (digits % 4) / 3)
        return super().drive(road, driver)


class FaultyDriver(DummyDriver):
    """A driver with a fault that strikes at the beginning of its drives."""

    def __init__(self, fault: Fault) -> None:
        super().__init__()
        self.fault = fault

    def reset(self, setup: DriveSetup) -> None:
        self.fault.strike()


class Waiting(FaultySimulator):
    """A simulator that waits in its drives, or at its start, until the mark ``go`` is there.

    A waiting process makes the mark ``driving-P`` or ``starting-P``. The options are text and
    numbers, for command lines.

    Args:
        folder: folder of the marks.
        at: where the simulator waits, "driving" or "starting".
        after: number of drives, of all processes together, that do not wait.
        deed: name of a function of this module that is called before waiting.
    """

    def __init__(
        self,
        folder: str,
        *,
        at: str = "driving",
        after: int = 0,
        deed: str = "",
        rules: Rules | None = None,
    ) -> None:
        # Without failures, since their pictures would take a while.
        super().__init__(Path(folder), drift=no_drift, rules=rules)
        self.at = at
        self.after = after
        self.deed = deed

    def _wait(self, stage: str) -> None:
        if self.at == stage:
            self.marks.make(f"{stage}-{os.getpid()}")
            if self.deed:
                globals()[self.deed](self.marks)
            self.marks.wait_for("go")

    def __enter__(self) -> Self:
        super().__enter__()
        self._wait("starting")
        return self

    def drive(self, road: Road, driver: Driver) -> Drive:
        if not any(self.marks.make(f"free-{i}") for i in range(self.after)):
            self._wait("driving")
        return super().drive(road, driver)


class Straight(Strategy):
    """A strategy that proposes straight roads of these numbers of samples, over and over."""

    def __init__(self, *samples: int) -> None:
        self.samples = samples
        self._ids = itertools.count(1)

    def ask(self) -> Candidate:
        number = next(self._ids)
        return straight(number, self.samples[(number - 1) % len(self.samples)])

    def tell(self, evaluation: Evaluation) -> None:
        pass


class Forking(Straight):
    """A strategy that forks before each road; parent and child both go on."""

    def __init__(self, folder: Path, *samples: int) -> None:
        super().__init__(*samples)
        self.marks = Marks(folder)

    def ask(self) -> Candidate:
        fork(self.marks)
        return super().ask()


def straight(number: int, samples: int = 8) -> Candidate:
    return Candidate(number, np.zeros(samples), 10.0, Origin("straight"))


def roads(samples: Sequence[int]) -> list[Candidate]:
    return [straight(number, count) for number, count in enumerate(samples, start=1)]
