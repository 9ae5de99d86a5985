"""Workers: each candidate gets an answer, lost processes are replaced, and none stays behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import faulty
import pytest
from campaigns import campaign, refused
from driving import (
    ProcessesContract,
    WorkersContract,
    WorkersOf,
    await_attempts,
    await_free,
    drive_all,
    drive_one,
    events,
    write_user_driver,
)
from faulty import (
    STALLED,
    Deed,
    FarAway,
    Fault,
    FaultyDriver,
    FaultySimulator,
    Marks,
    NoDrive,
    Straight,
    await_go,
    fork,
    fork_and_leave,
    hang,
    kill,
    raise_error,
    refuse_connection,
    roads,
    sys_exit,
    write_nonsense,
)
from pids import LIMIT, children, until, until_gone
from user_modules import own_modules

from frenetic.campaign import CampaignStore, RoadTester
from frenetic.campaign.check import check_campaign
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.workers import InProcessWorker, LocalWorkers, Workers
from frenetic.campaign.workers import local as local_workers
from frenetic.drivers import Driver
from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import DRIVERS
from frenetic.processes import object_process
from frenetic.processes.object_process import Loss, LostProcessError, ObjectProcess, pack, ready
from frenetic.simulators import Simulator
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["campaign_fixtures"]

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="by POSIX signals and groups")
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")


@contextmanager
def local(
    simulator: Simulator, driver: Driver | None = None, *, folder: Path, count: int = 1
) -> Iterator[LocalWorkers]:
    tester = RoadTester(simulator, driver or DummyDriver())
    with (
        CampaignLog(folder) as log,
        LocalWorkers(tester, count, drive_limit=LIMIT, log=log) as workers,
    ):
        yield workers


@contextmanager
def this_process(
    simulator: Simulator, driver: Driver | None = None, *, folder: Path
) -> Iterator[Workers]:
    tester = RoadTester(simulator, driver or DummyDriver())
    with CampaignLog(folder), InProcessWorker(tester) as workers:
        yield workers


class TestThisProcess(WorkersContract):
    @pytest.fixture
    def workers_of(self, tmp_path: Path) -> WorkersOf:
        return partial(this_process, folder=tmp_path)


class TestIsolated(WorkersContract):
    @pytest.fixture
    def workers_of(self, tmp_path: Path) -> WorkersOf:
        return partial(local, folder=tmp_path, count=1)


class TestLocal(ProcessesContract):
    @pytest.fixture
    def workers_of(self, tmp_path: Path) -> WorkersOf:
        return partial(local, folder=tmp_path, count=2)


# Deeds of simulators and drivers in their process

LOST = "worker {} was lost: "
FATAL: dict[str, tuple[str, ...]] = {
    "kill": (LOST + "it was killed by SIGKILL",),
    "fork_and_kill": (LOST + "it was killed by SIGKILL",),
    "segfault": (LOST + "it was killed by SIGSEGV",),
    "leave": (LOST + "it ended with exit code 7",),
    "sys_exit": (LOST + "SystemExit: 3 (faulty.py:",),
    "press_ctrl_c": (LOST + "KeyboardInterrupt (faulty.py:",),
    "raise_odd_error": (LOST + "OddError: so odd (faulty.py:",),
    "raise_error": (STALLED,),
    "hang_in_c": (LOST + "its drive took more than 3 s",),
    "close_everything": (LOST,),
    "write_nonsense": (LOST,),
    # Any code may be the first that asks for memory.
    "limit_memory": (LOST, "the simulator raised MemoryError"),
}
"""Deed -> possible beginnings of the reason of the one test that it costs."""
HARMLESS = (
    "change_folder",
    "change_signals",
    "replace_streams",
    "close_streams",
    "print_megabytes",
    "start_thread",
    "start_process",
    "fork",
    "fork_and_leave",
    "limit_resources",
    "answer_twice",
)


@posix_only
@pytest.mark.parametrize("deeds", [tuple(FATAL), HARMLESS], ids=["fatal", "harmless"])
def test_a_deed_in_a_drive_costs_at_most_one_test(
    tmp_path: Path, marks: Marks, deeds: Sequence[str]
) -> None:
    """Each deed strikes on one road; between these roads there are others without a deed."""
    samples = {deed: number for number, deed in enumerate(deeds, start=8)}
    faults = [Fault(getattr(faulty, deed), marks.folder, samples[deed]) for deed in deeds]
    search = campaign(
        tmp_path / "c",
        2 * len(deeds),
        strategy=Straight(*(count for deed in deeds for count in (samples[deed], 7))),
        simulator=FaultySimulator(marks.folder, drive=faults),
        drive_limit=3.0 if "hang_in_c" in deeds else LIMIT,
    )
    search.isolate = True
    state_before = Path.cwd(), sys.stdout, signal.getsignal(signal.SIGTERM)
    files_before = os.fstat(1).st_ino, os.fstat(2).st_ino
    before = set(children(os.getpid()))
    summary = search.run()
    errors = len(deeds) if deeds is not HARMLESS else 0
    with CampaignStore.open(tmp_path / "c") as store:
        tests = {deed: store.test(2 * number + 1) for number, deed in enumerate(deeds)}
    results = {deed: (test.outcome, test.reason, test.attempts) for deed, test in tests.items()}
    assert (summary.passed, summary.errors) == (2 * len(deeds) - errors, errors), results
    for deed, (outcome, reason, attempts) in results.items():
        if errors:
            assert (outcome, attempts) == (Outcome.ERROR, 2)
            assert "\n" not in reason
            assert reason.startswith(tuple(text.format(1) for text in FATAL[deed])), deed
    if not errors:  # each simulator was closed
        assert len(marks.numbers("end")) == len(events(tmp_path / "c", "worker_started"))
    assert check_campaign(tmp_path / "c").findings == ()
    assert os.getpid() not in marks.pids()
    until_gone(marks.pids())
    assert len(set(children(os.getpid())) - before) <= 2  # the servers of processes
    assert state_before == (Path.cwd(), sys.stdout, signal.getsignal(signal.SIGTERM))
    assert files_before == (os.fstat(1).st_ino, os.fstat(2).st_ino)


@posix_only
@pytest.mark.parametrize("deed", [fork, fork_and_leave, sys_exit])
def test_forks_and_exits_of_a_driver_leave_this_process_alone(
    marks: Marks, tmp_path: Path, deed: Deed
) -> None:
    driver = FaultyDriver(Fault(deed, marks.folder, times=1))
    with this_process(DummySimulator(), driver, folder=tmp_path) as workers:
        attempts = drive_all(workers, [8, 9])
    until_gone(marks.pids())
    assert ("SystemExit: 3" in str(attempts[1].failure)) is (deed is sys_exit)
    assert attempts[2].failure is None


@pytest.mark.parametrize("simulator", [NoDrive(), FarAway()])
def test_an_unusable_drive_is_a_failed_attempt(tmp_path: Path, simulator: Simulator) -> None:
    with this_process(simulator, folder=tmp_path) as workers:
        for attempt in drive_all(workers, [8, 9]).values():
            assert attempt.failure is not None
            assert attempt.result.outcome is Outcome.ERROR


class WritesNonsense:
    """An object of a worker: answers once, then writes nonsense to its descriptors."""

    def __init__(self, marks: Marks) -> None:
        self.marks = marks

    def start(self) -> None: ...

    def answer(self) -> int:
        return 7

    def spoil(self) -> None:
        write_nonsense(self.marks)
        self.marks.make("spoilt")


@posix_only
def test_answers_before_nonsense_are_received(marks: Marks) -> None:
    spoiling = ObjectProcess("it", pack(WritesNonsense(marks)))
    spoiling.start()
    spoiling.answer()
    try:
        spoiling.send("answer", limit=LIMIT, answer=int)
        spoiling.send("spoil", limit=LIMIT)
        until(lambda: marks.are_there("spoilt"), "both were called")
        assert spoiling.receive() == [7]
        assert ready([spoiling]) == [spoiling]
        with pytest.raises(
            LostProcessError, match="it broke the protocol: it is no message"
        ) as error:
            spoiling.receive()
        assert error.value.loss is Loss.BROKE_PROTOCOL
    finally:
        spoiling.kill()


@posix_only
def test_an_answer_of_another_type_breaks_the_protocol(marks: Marks) -> None:
    other = ObjectProcess("it", pack(WritesNonsense(marks)))
    other.start()
    other.answer()
    try:
        with pytest.raises(LostProcessError, match="not what was asked for: Expected `str`"):
            other.call("answer", limit=LIMIT, answer=str)
    finally:
        other.kill()


# Replaced processes


class CannotRestart(FaultySimulator):
    """Breaks in its first drive, or kills its process; later it cannot start, so many times."""

    def __init__(self, folder: Path, deed: Deed, times: int | None = None) -> None:
        super().__init__(folder, drive=Fault(deed, folder, times=1))
        self.deed = deed
        self.later = Fault(refuse_connection, folder, times=times)

    def __enter__(self) -> Any:
        if self.marks.are_there(f"{self.deed.__name__}-0"):
            self.later.strike()
        return super().__enter__()


@pytest.mark.parametrize("kind", [local, this_process])
def test_a_simulator_that_cannot_restart_ends_the_workers(
    kind: Any, marks: Marks, tmp_path: Path
) -> None:
    with (
        refused("nobody listens on port 25252"),
        kind(CannotRestart(marks.folder, raise_error), folder=tmp_path) as workers,
    ):
        for number in range(1, 10):
            assert drive_one(workers, number).failure == STALLED


class Counting(FaultySimulator):
    """Notes each of its starts and ends."""

    def __init__(self, folder: Path, drive: Fault) -> None:
        super().__init__(folder, drive=drive)
        self.calls: list[str] = []

    def __enter__(self) -> Any:
        self.calls.append("start")
        return super().__enter__()

    def __exit__(self, *_: object) -> None:
        self.calls.append("end")


def test_a_simulator_that_broke_is_ended_once_and_started_for_the_next_road(marks: Marks) -> None:
    simulator = Counting(marks.folder, drive=Fault(raise_error, marks.folder, times=1))
    host = local_workers.TesterHost(RoadTester(simulator, DummyDriver()))
    broken, whole = (host.test(candidate) for candidate in roads([8, 8]))
    assert (broken.simulator_broke, whole.simulator_broke) == (True, False)
    for _ in range(2):
        host.close()
    assert simulator.calls == ["start", "end"] * 2


def test_a_worker_that_drove_before_may_fail_to_restart_once(marks: Marks, tmp_path: Path) -> None:
    """The first road kills it; then, for instance, its port is still taken."""
    with local(CannotRestart(marks.folder, kill, times=1), folder=tmp_path) as workers:
        assert drive_one(workers).worker_lost
        assert drive_one(workers).failure is None


@posix_only
def test_candidates_that_waited_in_a_lost_worker_are_driven(marks: Marks, tmp_path: Path) -> None:
    """A worker of quick tests has several candidates at once."""
    simulator = FaultySimulator(marks.folder, drive=Fault(kill, marks.folder, samples=9, times=1))
    with local(simulator, folder=tmp_path) as workers:
        until(lambda: drive_one(workers) and workers.free > 2, "it is quick")
        for candidate in roads([9, 8, 8]):
            workers.submit(candidate)
        attempts = await_attempts(workers, 3)
    assert {a.candidate_id: a.worker_lost for a in attempts} == {1: True, 2: False, 3: False}


@linux_only
def test_workers_survive_the_end_of_the_server_that_forks_them(
    marks: Marks, tmp_path: Path
) -> None:
    with local(FaultySimulator(marks.folder), folder=tmp_path, count=2) as workers:
        await_free(workers, 2)
        (server,) = [
            child
            for child in children(os.getpid())
            if b"multiprocessing.forkserver" in Path(f"/proc/{child}/cmdline").read_bytes()
        ]
        os.kill(server, 9)
        until_gone([server])
        assert len(drive_all(workers, [8, 9, 10, 11])) == 4
        until(lambda: not workers.wait(0.1) and len(marks.pids()) == 4, "both workers are back")
    until_gone(marks.pids())


def test_workers_end_if_a_process_cannot_be_made(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: ObjectProcess) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    with local(FaultySimulator(marks.folder), folder=tmp_path) as workers:
        await_free(workers)
        monkeypatch.setattr(ObjectProcess, "start", refuse)
        (victim,) = marks.pids()
        os.kill(victim, 9)
        with refused("Resource temporarily unavailable"):
            await_free(workers, 2)
    assert events(tmp_path, "worker_lost")[0]["reason"] == "it was killed by SIGKILL"


@posix_only
def test_workers_ignore_ctrl_c(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Spawned workers, as on macOS and Windows; test_faults.py has forked ones."""
    context = multiprocessing.get_context("spawn")
    monkeypatch.setattr(object_process, "process_context", lambda _: context)
    with local(FaultySimulator(marks.folder), folder=tmp_path) as workers:
        for process in multiprocessing.active_children():
            if process.name.startswith("worker") and process.pid is not None:
                os.kill(process.pid, signal.SIGINT)  # while it starts
        await_free(workers)
        os.kill(marks.pids()[0], signal.SIGINT)
        assert drive_all(workers, [8])[1].failure is None
    assert [line["event"] for line in events(tmp_path)] == ["worker_started"]
    until_gone(marks.pids())


WITHOUT_FORKSERVER = """
import multiprocessing.context, sys
del multiprocessing.context.ForkServerContext
sys.modules["multiprocessing.forkserver"] = None
import frenetic.campaign.workers
"""


def test_workers_are_imported_where_there_is_no_server_that_forks() -> None:
    subprocess.run([sys.executable, "-c", WITHOUT_FORKSERVER], check=True, timeout=LIMIT)


# Ends of workers


@pytest.mark.parametrize("at", ["start", "end"])
def test_after_an_error_workers_are_killed_without_waiting(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    monkeypatch.setattr(object_process, "CLOSING_LIMIT", LIMIT)
    faults: dict[str, Any] = {at: Fault(await_go, marks.folder)}
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        local(FaultySimulator(marks.folder, **faults), folder=tmp_path) as workers,
    ):
        if at == "end":
            await_free(workers)
        until(marks.pids, "it is there")
        start = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - start < 0.5 * LIMIT
    assert not marks.numbers("end")
    until_gone(marks.pids())


@pytest.mark.parametrize("at", ["start", "end"])
def test_a_simulator_that_hangs_when_it_starts_or_ends_is_killed(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    limit = "START_LIMIT" if at == "start" else "CLOSING_LIMIT"
    monkeypatch.setattr(object_process, limit, 0.3)
    faults: dict[str, Any] = {at: Fault(hang, marks.folder)}
    given_up = refused("no worker could be started: its start took more than 0.3 s")
    with (
        given_up if at == "start" else nullcontext(),
        local(FaultySimulator(marks.folder, **faults), folder=tmp_path) as workers,
    ):
        await_free(workers)
    until_gone(marks.pids())


@pytest.mark.parametrize("started", [1, 2])
def test_an_interrupted_start_leaves_no_process(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, started: int
) -> None:
    """The start of the second process, or of the one that replaces the first."""
    original = ObjectProcess.start
    calls = 0

    def start(self: ObjectProcess) -> None:
        nonlocal calls
        calls += 1
        if calls > started:
            raise KeyboardInterrupt
        original(self)

    monkeypatch.setattr(ObjectProcess, "start", start)
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        local(FaultySimulator(marks.folder), folder=tmp_path, count=2) as workers,
    ):
        await_free(workers, 2)
        os.kill(marks.pids()[0], 9)
        while True:
            workers.wait(0.5)
    names = [process.name for process in multiprocessing.active_children()]
    assert not [name for name in names if name.startswith("worker")]
    until_gone(marks.pids())


# Copies of parts


class Unpicklable(DummyDriver):
    """Raises when it is unpickled."""

    def __setstate__(self, state: object) -> None:
        raise ValueError("Unpicklable\nstays at home")


def test_a_driver_that_cannot_be_unpickled_is_refused_in_one_line(tmp_path: Path) -> None:
    with (
        refused(r"no worker could be started: .*Unpicklable"),
        local(DummySimulator(), Unpicklable(), folder=tmp_path) as workers,
    ):
        await_free(workers)


def test_a_driver_from_a_users_file_drives_in_a_worker(tmp_path: Path) -> None:
    was_there = write_user_driver(tmp_path, "mine")
    with own_modules():
        driver = DRIVERS.make(f"{tmp_path / 'mine.py'}:Mine")
        with local(DummySimulator(), driver, folder=tmp_path) as workers:
            assert drive_all(workers, [8])[1].failure is None
        assert was_there.exists()
        # Without the file, a worker says that it is missing.
        (tmp_path / "mine.py").unlink()
        with (
            refused(r"there is no file .*mine\.py"),
            local(DummySimulator(), driver, folder=tmp_path) as workers,
        ):
            await_free(workers)


UNGUARDED = """
from frenetic import Budget, Campaign, RandomSearch
from frenetic.campaign.workers import local as processes
from frenetic.errors import CampaignError
from frenetic.testing import DummyDriver, DummySimulator
processes.MAX_STARTS = 1
try:
    Campaign(
        strategy=RandomSearch(seed=1), simulator=DummySimulator(), driver=DummyDriver(),
        budget=Budget(simulations=5), folder="campaign", workers=2,
    ).run()
except CampaignError as error:
    if __name__ == "__main__":
        print(error)
    raise SystemExit(1)
"""


def test_a_script_without_a_main_guard_gets_a_hint(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
    )
    assert done.returncode == 1
    assert "no worker could be started: it ended with exit code 1" in done.stdout
    assert 'if __name__ == "__main__":' in done.stdout
    assert done.stdout.count("\n") == 1
