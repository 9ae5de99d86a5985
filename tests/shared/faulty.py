"""Parts of campaigns with faults; in a module of their own, so that workers can import them."""

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
"""s after which a part that waits goes on, so that no process is left for ever."""


@dataclass(frozen=True)
class Marks:
    """Empty files in a folder, by which the processes of a test know of each other."""

    folder: Path

    def make(self, name: str) -> bool:
        """Makes a mark; returns whether it was not there."""
        try:
            (self.folder / name).touch(exist_ok=False)
        except FileExistsError:
            return False
        return True

    def are_there(self, *names: str) -> bool:
        return all((self.folder / name).exists() for name in names)

    def numbers(self, name: str) -> list[int]:
        """Of the marks called name-number, in order."""
        return sorted(int(path.name.rpartition("-")[2]) for path in self.folder.glob(f"{name}-*"))

    def pids(self) -> list[int]:
        """Of all processes that left theirs."""
        return self.numbers("pid")

    def wait_for(self, name: str) -> None:
        deadline = time.monotonic() + LIMIT
        while not self.are_there(name) and time.monotonic() < deadline:
            time.sleep(0.002)


Deed = Callable[[Marks], None]


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
"""Reason of the test in which it strikes."""


def hang(marks: Marks) -> None:
    time.sleep(LIMIT)


def hang_in_c(marks: Marks) -> None:
    """In compiled code, where no other thread of the process gets a turn."""
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
    """One that its process waits for at its end."""
    threading.Thread(target=time.sleep, args=(LIMIT,)).start()


def start_process(marks: Marks) -> None:
    child = subprocess.Popen([sys.executable, "-c", f"import time; time.sleep({10 * LIMIT})"])
    marks.make(f"pid-{child.pid}")
    child.returncode = 0  # nobody is to wait for it, nor to be warned about it


def fork_and_kill(marks: Marks) -> None:
    """Its child holds on to whatever connections it had."""
    child = os.fork()
    if child == 0:
        time.sleep(LIMIT)
        os._exit(0)
    marks.make(f"pid-{child}")
    kill(marks)


def fork(marks: Marks) -> None:
    """Both go on."""
    child = os.fork()
    if child:
        marks.make(f"pid-{child}")


def fork_and_leave(marks: Marks) -> None:
    """The child ends as Python programs do."""
    child = os.fork()
    if child == 0:
        sys.exit(0)
    marks.make(f"pid-{child}")


def answer_twice(marks: Marks) -> None:
    """From now on its process says everything twice."""
    for one in gc.get_objects():
        if isinstance(one, Connection):
            one.send_bytes = _twice(one.send_bytes)  # type: ignore[method-assign]


def _twice(send: Callable[..., None]) -> Callable[..., None]:
    def send_twice(data: bytes) -> None:
        send(data)
        send(data)

    return send_twice


def segfault(marks: Marks) -> None:
    faulthandler.disable()  # pytest's
    ctypes.string_at(0)


class OddError(BaseException):
    """No `Exception`."""


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

    for what in (resource.RLIMIT_FSIZE, resource.RLIMIT_NPROC, resource.RLIMIT_CORE):
        resource.setrlimit(what, (0, 0))


def limit_memory(marks: Marks) -> None:
    import resource  # POSIX

    resource.setrlimit(resource.RLIMIT_AS, (1, 1))
    bytearray(10**8)


def close_everything(marks: Marks) -> None:
    os.closerange(0, 256)


def close_streams(marks: Marks) -> None:
    os.closerange(0, 3)


def write_nonsense(marks: Marks) -> None:
    """To every socket that the process has."""
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
    """What happens, on which roads and how often."""

    deed: Deed
    folder: Path
    samples: int | None = None
    """Only on roads of so many samples."""
    times: int | None = None
    """So often, in all processes together."""

    def strike(self, samples: int | None = None) -> None:
        if self.samples not in (None, samples):
            return
        marks = Marks(self.folder)
        name = self.deed.__name__
        if self.times is None or any(marks.make(f"{name}-{i}") for i in range(self.times)):
            self.deed(marks)


def bend(road: Road) -> float:
    """m: the more bent a road, the worse, so that there is something to learn."""
    return 80.0 * float(abs(road.curvatures).mean())


class FaultySimulator(DummySimulator):
    """Leaves marks; faults strike when it starts, in its drives and when it ends.

    Marks: ``pid-P`` of its process, ``start-N`` and ``end-N`` for its Nth start and end in all
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
    """Returns nothing."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        return None  # type: ignore[return-value]


class FarAway(DummySimulator):
    """Records finite places that no file can hold."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        drive = super().drive(road, driver)
        rows = drive.trajectory.to_rows()
        rows[-1, 8] = 1e300  # what the driver asked for
        return Drive(type(drive.trajectory).from_rows(rows), drive.car, drive.rules)


class Uneven(DummySimulator):
    """Takes longer on some roads than on others, so that results come in another order."""

    def __init__(self, seconds: float = 0.01) -> None:
        super().__init__(bend)
        self.seconds = seconds

    def drive(self, road: Road, driver: Driver) -> Drive:
        digits = int(1e6 * float(abs(road.curvatures).sum()))
        time.sleep(self.seconds * (digits % 4) / 3)
        return super().drive(road, driver)


class FaultyDriver(DummyDriver):
    """A fault strikes at the beginning of its drives."""

    def __init__(self, fault: Fault) -> None:
        super().__init__()
        self.fault = fault

    def reset(self, setup: DriveSetup) -> None:
        self.fault.strike()


class Waiting(FaultySimulator):
    """For command lines: stays in its drives, or in its start, until the mark ``go`` is there.

    Marks: ``driving-P`` or ``starting-P`` by a process that waits.

    Args:
        folder: for the marks.
        at: where it waits, "driving" or "starting".
        after: drives of all processes together in which it does not.
        deed: what it does before that, a function of this module.
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

    def _wait(self, what: str) -> None:
        if self.at == what:
            self.marks.make(f"{what}-{os.getpid()}")
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
    """A strategy that asks for straight roads of the given numbers of samples, over and over."""

    def __init__(self, *samples: int) -> None:
        self.samples = samples
        self.told: list[Evaluation] = []
        self._ids = itertools.count(1)

    def ask(self) -> Candidate:
        number = next(self._ids)
        return straight(number, self.samples[(number - 1) % len(self.samples)])

    def tell(self, evaluation: Evaluation) -> None:
        self.told.append(evaluation)


class Forking(Straight):
    """Forks before each answer; both go on."""

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
