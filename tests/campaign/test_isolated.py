"""Drives in another process: the results are the same, and a lost process has a culprit."""

from __future__ import annotations

import gc
import logging
import math
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np
import pytest
from campaigns import campaign, refused
from contents import contents
from faulty import (
    Fault,
    FaultyDriver,
    FaultySimulator,
    Marks,
    OddError,
    Straight,
    hang_in_c,
    kill,
    leave,
    refuse_connection,
)
from numba.core.registry import CPUDispatcher
from pids import LIMIT, is_running, until_gone

from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import CampaignStore, RoadTester
from frenetic.campaign.check import check_campaign
from frenetic.campaign.workers import DriveProcess, driving, is_isolable
from frenetic.drivers import (
    Controls,
    Delayed,
    Driver,
    DriveSetup,
    LimitedView,
    Noisy,
    Observation,
    Planner,
)
from frenetic.errors import (
    BREAKS_PROTOCOL,
    ENDS_ITS_PROCESS,
    GIVES_NO_CONTROLS,
    HANGS,
    IS_KILLED,
    CampaignError,
    DriverError,
    FreneticError,
    Trouble,
)
from frenetic.oracle.outcome import Outcome
from frenetic.processes.object_process import Loss, LostProcessError
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Simulator
from frenetic.simulators.blame import Blame
from frenetic.spec import Spec
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator

ROAD = Road([0.0, 0.03, 0.05, 0.0, -0.05, -0.04, 0.0, 0.0])

pytest_plugins = ["campaign_fixtures"]


class PythonPlanner(Planner):
    """The planner as a driver in Python."""


class Faulty(PythonPlanner):
    """A driver that strikes its faults when a drive begins."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        super().__init__()
        self.faults = faults

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        for fault in self.faults:
            fault.strike()


class RequiresReadyKernels(PythonPlanner):
    """A driver that fails if a kernel is compiled or loaded during its drive."""

    def reset(self, setup: DriveSetup) -> None:
        self.ready = ready_kernels()
        super().reset(setup)

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        assert ready_kernels() == self.ready
        return controls


def ready_kernels() -> set[tuple[str, str]]:
    """Name and argument types of each kernel whose machine code is loaded."""
    kernels = [value for value in gc.get_objects() if isinstance(value, CPUDispatcher)]
    return {
        (kernel.py_func.__name__, str(arguments))
        for kernel in kernels
        for arguments in kernel.signatures
    }


def test_a_campaign_in_another_process_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    """The strategy knows each result before its next proposal, in either process."""
    driver = Delayed(PythonPlanner(), seconds=0.1)
    for name, isolate in (("apart", True), ("here", False)):
        parts = {"simulator": EmbeddedSimulator(), "driver": driver, "isolate": isolate}
        campaign(tmp_path / name, 25, **parts).run()
    assert contents(tmp_path / "apart") == contents(tmp_path / "here")
    with (
        CampaignStore.open(tmp_path / "apart") as apart,
        CampaignStore.open(tmp_path / "here") as here,
    ):
        assert apart.config == here.config
        assert {test.outcome for test in apart.tests()} >= {Outcome.PASS, Outcome.FAIL}


@pytest.mark.heavy
def test_kernels_are_ready_before_a_drivers_time_starts() -> None:
    """The wall limit counts only the driver's time, also in a fresh process."""
    driver = Delayed(LimitedView(Noisy(RequiresReadyKernels())))
    with DriveProcess(RoadTester(EmbeddedSimulator(), driver)) as process:
        assert process.drive(Road([0.0] * 3)).trouble is None


def test_conditions_reach_the_other_process() -> None:
    conditions = {"friction": 0.4, "speed": 50.0, "noise": 0.3, "start": 0.5, "heading": 0.02}
    tester = RoadTester(EmbeddedSimulator(), PythonPlanner())
    with DriveProcess(tester) as process:
        usual = process.drive(ROAD).trajectory.to_rows()
        drives = [drive(ROAD, conditions) for drive in (tester.drive, process.drive)]
        assert drives[1].rules.speed_limit == 50.0
        rows = [drive.trajectory.to_rows() for drive in drives]
        np.testing.assert_array_equal(rows[0], rows[1])
        np.testing.assert_array_equal(process.drive(ROAD).trajectory.to_rows(), usual)
    wet = Terms(conditions={"friction": 0.5})
    with pytest.raises(FreneticError, match="DummySimulator cannot vary friction"):
        RoadTester(DummySimulator(), PythonPlanner(), wet)


class Measuring(EmbeddedSimulator):
    """Knows its car once it has started, as one that asks another program."""

    def __enter__(self) -> Any:
        self.car = replace(self.car, width=1.5)
        return super().__enter__()


def test_the_car_is_as_the_other_process_has_measured_it() -> None:
    simulator = Measuring()
    assert simulator.car.width != 1.5
    with DriveProcess(RoadTester(simulator, PythonPlanner())):
        assert simulator.car.width == 1.5


def test_only_compiled_drives_stay_in_this_process() -> None:
    embedded = EmbeddedSimulator()
    for driver in (Planner(), Noisy(Planner()), Delayed(Noisy(Planner()))):
        assert not is_isolable(RoadTester(embedded, driver))
    for simulator, driver in (
        (embedded, PythonPlanner()),
        (embedded, Noisy(Noisy(Planner()))),
        (DummySimulator(), Planner()),
    ):
        assert is_isolable(RoadTester(simulator, driver))


@pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")
def test_a_process_that_a_driver_ends_is_replaced(marks: Marks) -> None:
    simulator = FaultySimulator(marks.folder)
    driver = FaultyDriver(Fault(leave, marks.folder, times=1))
    with DriveProcess(RoadTester(simulator, driver)) as process:
        trouble = process.drive(ROAD).trouble
        assert trouble is not None
        assert trouble.reason == "the driver's process was lost: it ended with exit code 7"
        assert process.drive(ROAD).trouble is None
    until_gone(marks.pids())
    start = Fault(refuse_connection, marks.folder)
    simulator = FaultySimulator(marks.folder, start=start)
    with (
        pytest.raises(CampaignError, match="ConnectionRefusedError: nobody listens on port"),
        DriveProcess(RoadTester(simulator, DummyDriver())),
    ):
        pass
    until_gone(marks.pids())


LOST = "the driver's process was lost: "
DEEDS = {
    ENDS_ITS_PROCESS: (leave, LOST + "it ended with exit code 7"),
    HANGS: (hang_in_c, LOST + "its drive took more than 2 s"),
    "ConnectionRefusedError": (refuse_connection, "the driver raised ConnectionRefusedError"),
}
"""Kind of fault -> what the driver does, and the reason of the failure."""


@pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")
@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.heavy), 2])
def test_a_driver_that_breaks_its_process_fails_one_test(
    marks: Marks, tmp_path: Path, workers: int
) -> None:
    strategy = Straight(8, 9, 10)
    strategy.expects_failures = True  # type: ignore[misc]  # so no failure is driven a second time
    search = campaign(
        tmp_path / "c",
        5,
        simulator=EmbeddedSimulator(),
        driver=Faulty([Fault(deed, marks.folder, times=1) for deed, _ in DEEDS.values()]),
        strategy=strategy,
        workers=workers,
        drive_limit=2.0,
    )
    search.isolate = True
    summary = search.run()
    assert (summary.failed, summary.errors) == (len(DEEDS), 0)
    with CampaignStore.open(tmp_path / "c") as store:
        failures = list(store.tests(Outcome.FAIL))
        clusters = distinct_failures(store)
    assert {cluster.ids for cluster in clusters} == {(test.id,) for test in failures}
    faults = {test.result.fault.kind: test for test in failures if test.result.fault is not None}
    for kind, (_, text) in DEEDS.items():
        test = faults[kind]
        assert test.reason.startswith(text)
        assert test.attempts == 1, "a failure of the driver is final"
        assert test.result.fault is not None
        assert test.result.fault.part == "driver"
    assert check_campaign(tmp_path / "c").findings == ()
    until_gone(marks.pids())


# Each way to break a drive


class UnreadableError(Exception):
    def __str__(self) -> str:
        raise GeneratorExit


class UnmakeableError(Exception):
    def __reduce__(self) -> Any:
        os._exit(9)


class NoNumber:
    def __float__(self) -> float:
        raise OddError("no number")

    def __repr__(self) -> str:
        raise OddError("no words")


def to_descriptors(data: bytes) -> None:
    for descriptor in range(3, 256):
        with suppress(OSError):
            os.set_blocking(descriptor, False)
            os.write(descriptor, data)


def raise_(error: BaseException) -> NoReturn:
    raise error


def steer(value: Any) -> Controls:
    return Controls(value, 0.0, 0.0)


def kill_this_process() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def kill_group() -> None:
    os.killpg(0, signal.SIGTERM)


def stop_this_process() -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


def close_and_go_on() -> None:
    """Close all descriptors, and open other files in their place."""
    os.closerange(3, 256)
    for _ in range(30):
        os.open(os.devnull, os.O_RDWR)


def cut_files() -> None:
    for descriptor in range(3, 256):
        with suppress(OSError):
            os.ftruncate(descriptor, 0)
    os._exit(7)


def flood_log() -> NoReturn:
    """Log well-formed messages for ever."""
    while True:
        logging.getLogger("frenetic.driver").warning("the road is wet")


def raises(kind: str, text: str = "") -> tuple[str, str]:
    return kind, f"the driver raised {kind}{text}"


NOTHING_USABLE = GIVES_NO_CONTROLS, "the driver returned steering = "
NOT_A_MESSAGE = BREAKS_PROTOCOL, f"{LOST}it broke the protocol: it is no message"
CLOSED = BREAKS_PROTOCOL, f"{LOST}the descriptors of its process were closed"
LATE = HANGS, "the driver did not finish its drive within 2 s"
WAYS: Final[dict[str, tuple[Callable[[], Any], tuple[str, str]]]] = {
    "a byte": (lambda: to_descriptors(b"x"), NOT_A_MESSAGE),
    "zeros": (lambda: to_descriptors(bytes(100_000)), NOT_A_MESSAGE),
    "a length of 2^62": (
        lambda: to_descriptors(b"\xff" * 4 + struct.pack("!Q", 2**62)),
        NOT_A_MESSAGE,
    ),
    "a long frame": (
        lambda: to_descriptors(b"\xf7Frn" + struct.pack("<BIII", 1, 2, 2**32 - 1, 0)),
        (BREAKS_PROTOCOL, f"{LOST}it broke the protocol: it claims 4294967295 bytes"),
    ),
    "closed 3 to 255": (lambda: os.closerange(3, 256), CLOSED),
    "closed 0 to 255": (lambda: os.closerange(0, 256), CLOSED),
    "closed and replaced": (close_and_go_on, CLOSED),
    "cut files": (cut_files, (ENDS_ITS_PROCESS, f"{LOST}it ended with exit code 7")),
    "BaseException": (lambda: raise_(BaseException("base")), raises("BaseException", ": base (")),
    "OddError": (lambda: raise_(OddError("so odd")), raises("OddError", ": so odd (")),
    "GeneratorExit": (lambda: raise_(GeneratorExit()), raises("GeneratorExit")),
    "StopIteration": (lambda: raise_(StopIteration()), raises("StopIteration")),
    "KeyboardInterrupt": (lambda: raise_(KeyboardInterrupt()), raises("KeyboardInterrupt")),
    "SystemExit": (lambda: sys.exit(0), raises("SystemExit", ": 0 (")),
    "an unreadable error": (
        lambda: raise_(UnreadableError()),
        raises("UnreadableError", ": an error without a readable text ("),
    ),
    "a long error": (lambda: raise_(ValueError("x" * 10_000_000)), raises("ValueError", ": xxx")),
    "our long error": (lambda: raise_(DriverError("x" * 10_000_000)), ("DriverError", "xxx")),
    "half a character": (lambda: raise_(ValueError("\ud800")), raises("ValueError", ": \\ud800 (")),
    "an error like a bomb": (lambda: raise_(UnmakeableError()), raises("UnmakeableError")),
    "1e300": (lambda: steer(1e300), NOTHING_USABLE),
    "nan": (lambda: steer(math.nan), NOTHING_USABLE),
    "inf": (lambda: steer(-math.inf), NOTHING_USABLE),
    "a huge number": (lambda: steer(10**5000), NOTHING_USABLE),
    "a text": (lambda: steer("0.0"), NOTHING_USABLE),
    "no number": (lambda: steer(NoNumber()), raises("OddError", ": no number (")),
    "no controls": (NoNumber, (GIVES_NO_CONTROLS, "the driver returned NoNumber instead")),
    "_exit": (lambda: os._exit(0), (ENDS_ITS_PROCESS, f"{LOST}it ended with exit code 0")),
    "SIGTERM": (kill_group, (ENDS_ITS_PROCESS, f"{LOST}it was killed by SIGTERM")),
    "SIGKILL": (kill_this_process, (IS_KILLED, f"{LOST}it was killed by SIGKILL, by itself or")),
    "sleeps": (lambda: time.sleep(LIMIT), LATE),
    "logs for ever": (flood_log, LATE),
    "SIGSTOP": (stop_this_process, (HANGS, f"{LOST}its drive took more than 4 s")),
    "no memory": (lambda: bytearray(2**62), raises("MemoryError")),
}
"""What the driver does -> its function, and the kind and the reason of the failure."""


class Wayward(PythonPlanner):
    """Misbehaves in one way per drive, in `reset` or in `act`.

    The system may have sent a SIGKILL, so the driver kills its process in a second drive, too.
    """

    def __init__(self, folder: Path, ways: Sequence[str], moment: str) -> None:
        super().__init__()
        self.marks, self.ways, self.moment = Marks(folder), ways, moment

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        deeds = [
            f"{way}{suffix}" for way in self.ways for suffix in ("", "~")[: 1 + (way == "SIGKILL")]
        ]
        self.way = next((deed for deed in deeds if self.marks.make(deed)), "").rstrip("~")
        if self.way and self.moment == "reset":
            WAYS[self.way][0]()

    def act(self, observation: Observation) -> Controls:
        if self.way and observation.time > 0.4:
            answer: Controls = WAYS[self.way][0]()
            return answer
        return super().act(observation)


@pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")
@pytest.mark.parametrize(
    ("moment", "workers"),
    [
        ("act", 1),
        pytest.param("act", 2, marks=pytest.mark.heavy),
        pytest.param("reset", 1, marks=pytest.mark.heavy),
    ],
)
def test_each_way_to_break_a_drive_is_a_failure_of_the_driver(
    marks: Marks, tmp_path: Path, moment: str, workers: int
) -> None:
    """The campaign goes on, and its other drives are as usual."""
    strategy = Straight(8)
    strategy.expects_failures = True  # type: ignore[misc]  # so no failure is driven a second time
    # After a SIGKILL the road is driven again, maybe by another worker.
    ways = [way for way in WAYS if workers == 1 or way != "SIGKILL"]
    search = campaign(
        tmp_path / "c",
        len(ways) + 16,  # more than a worker has in advance while another hangs
        simulator=EmbeddedSimulator(wall_limit=2.0),
        driver=Wayward(marks.folder, ways, moment),
        strategy=strategy,
        workers=workers,
        drive_limit=4.0,
    )
    search.isolate = True
    summary = search.run()
    with CampaignStore.open(tmp_path / "c") as store:
        tests = list(store.tests())
    failures = [test for test in tests if test.outcome is Outcome.FAIL]
    assert summary.errors == 0, [test.reason for test in tests if test.outcome is Outcome.ERROR]
    faults = [(test.result.fault.kind, test.reason) for test in failures if test.result.fault]
    for name in ways:
        _, (kind, text) = WAYS[name]
        match = next((f for f in faults if f[0] == kind and f[1].startswith(text)), None)
        assert match is not None, (name, faults)
        assert len(match[1]) < 3000
        faults.remove(match)
    assert faults == []
    assert sorted({test.attempts for test in failures}) == ([1, 2] if workers == 1 else [1])
    assert len({test.moobd for test in tests if test.outcome is Outcome.PASS}) == 1
    assert check_campaign(tmp_path / "c").findings == ()


@pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_process_that_is_killed_once_changes_no_result(
    marks: Marks, tmp_path: Path, workers: int
) -> None:
    """The system may have killed it, so the road is driven again."""
    search = campaign(
        tmp_path / "c",
        3,
        simulator=EmbeddedSimulator(),
        driver=Faulty([Fault(kill, marks.folder, times=1)]),
        strategy=Straight(8),
        workers=workers,
    )
    search.isolate = True
    assert search.run().passed == 3
    with CampaignStore.open(tmp_path / "c") as store:
        assert sorted(test.attempts for test in store.tests()) == [1, 1, 2]


@pytest.mark.parametrize(
    ("simulator", "driver", "loss", "is_asked", "is_drivers"),
    [
        (EmbeddedSimulator(), PythonPlanner(), Loss.ENDED, False, True),
        (EmbeddedSimulator(), PythonPlanner(), Loss.BROKE_PROTOCOL, False, True),
        (EmbeddedSimulator(), Noisy(PythonPlanner()), Loss.LATE, False, True),
        (EmbeddedSimulator(), PythonPlanner(), Loss.RAISED, True, False),
        (EmbeddedSimulator(), Planner(), Loss.KILLED, False, False),
        (FaultySimulator(), PythonPlanner(), Loss.ENDED, False, False),
        (FaultySimulator(), PythonPlanner(), Loss.LATE, True, True),
        (FaultySimulator(), PythonPlanner(), Loss.BROKE_PROTOCOL, True, False),
    ],
)
def test_a_lost_process_is_blamed_on_the_part_that_is_not_ours(
    simulator: Simulator, driver: Driver, loss: Loss, is_asked: bool, is_drivers: bool
) -> None:
    error = LostProcessError(Trouble("it was lost"), loss, is_drivers_turn=is_asked)
    fault = Blame.of(simulator, driver).fault(error)
    assert (fault is not None) is is_drivers


CHILDREN: Final[dict[str, dict[str, Any]]] = {
    "with a session of its own": {"start_new_session": True},
    "with all descriptors": {"close_fds": False},
    "without an environment": {"start_new_session": True, "env": {}},
}


class StartsChild(PythonPlanner):
    """Starts a child in its first drive, whose own child outlives it; then it may leave."""

    def __init__(self, folder: Path, kind: str, leaves: bool) -> None:
        super().__init__()
        self.marks, self.kind, self.leaves = Marks(folder), kind, leaves

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        if self.marks.make("child"):
            sleeping = [sys.executable, "-c", f"import time; time.sleep({10 * LIMIT})"]
            code = (
                f"import subprocess; print(subprocess.Popen({sleeping}, start_new_session=True,"
                " stdout=subprocess.DEVNULL).pid)"
            )
            options = CHILDREN[self.kind]
            child = subprocess.Popen(
                [sys.executable, "-c", code], stdout=subprocess.PIPE, **options
            )
            assert child.stdout is not None
            self.marks.make(f"pid-{int(child.stdout.readline())}")
            child.wait()
            if self.leaves:
                os._exit(7)


@pytest.mark.skipif(sys.platform != "linux", reason="by Linux's ways to find descendants")
@pytest.mark.parametrize("leaves", [False, True])
@pytest.mark.parametrize("kind", CHILDREN)
def test_processes_that_a_driver_starts_end_with_its_process(
    marks: Marks, kind: str, leaves: bool
) -> None:
    driver = StartsChild(marks.folder, kind, leaves)
    with DriveProcess(RoadTester(EmbeddedSimulator(), driver)) as process:
        if leaves:
            trouble = process.drive(ROAD).trouble
            assert trouble is not None
            assert "it ended with exit code 7" in trouble.reason
            assert not any(is_running(pid) for pid in marks.pids())
        assert process.drive(ROAD).trouble is None
    assert len(marks.pids()) == 1
    assert not any(is_running(pid) for pid in marks.pids())


class Uncopyable(DummyDriver):
    """A driver that cannot be pickled, like a driver with an open session."""

    def __init__(self) -> None:
        super().__init__()
        self.session = lambda: None


def test_a_driver_that_cannot_be_copied_is_made_by_its_name_or_drives_in_this_process(
    caplog: pytest.LogCaptureFixture,
) -> None:
    parts = {"driver": f"{__name__}:Uncopyable", "simulator": "frenetic.testing:DummySimulator"}
    for conditions in ({}, {"noise": 0.1}):
        named = RoadTester.of(Spec.of(parts, {"with": conditions}))
        assert is_isolable(named)
        with driving(named, isolate=True) as drive:
            assert drive(ROAD, {}).trouble is None
    assert not caplog.text
    tester = RoadTester(DummySimulator(), Uncopyable())
    assert not is_isolable(tester)
    assert "nothing protects this process from the driver" in caplog.text
    with driving(tester, isolate=True) as drive:
        assert drive(ROAD, {}).trouble is None
    with refused("be copied"):
        DriveProcess(tester)
