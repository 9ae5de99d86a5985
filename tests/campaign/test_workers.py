"""Workers: whatever happens to them, each candidate comes back, and no process stays behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self

import faulty
import pytest
from campaigns import refused
from driving import (
    MINE,
    WorkersContract,
    WorkersOf,
    await_attempts,
    await_free,
    drive_all,
    drive_one,
    events,
)
from faulty import (
    STALLED,
    Deed,
    Fault,
    FaultyDriver,
    FaultySimulator,
    Marks,
    Straight,
    Stumbling,
    await_go,
    fork,
    fork_and_leave,
    give_go,
    hang,
    kill,
    raise_error,
    refuse_connection,
    roads,
    straight,
    sys_exit,
    write_log,
)
from pids import LIMIT, children, is_running, until, until_gone

from frenetic import worker
from frenetic.campaign import Budget, Campaign, CampaignStore, RoadTester
from frenetic.campaign.check import check_campaign
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.workers import InProcessWorker, LocalWorkers, Workers
from frenetic.drivers import Driver
from frenetic.errors import FreneticError
from frenetic.outcome import Outcome
from frenetic.registry import DRIVERS
from frenetic.road import Road
from frenetic.simulators import Drive, Simulator
from frenetic.testing import DummyDriver, DummySimulator
from frenetic.worker import Worker

pytest_plugins = ["campaign_fixtures"]

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="by POSIX signals and groups")
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")


@contextmanager
def local(
    simulator: Simulator,
    driver: Driver | None = None,
    *,
    folder: Path,
    count: int = 1,
    drive_limit: float = LIMIT,
) -> Iterator[LocalWorkers]:
    tester = RoadTester(simulator, driver or DummyDriver())
    with (
        CampaignLog(folder) as log,
        LocalWorkers(tester, count, drive_limit=drive_limit, log=log) as workers,
    ):
        yield workers


# What drivers do to the process that they drive in

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
    "swallow_everything": (LOST + "its drive took more than 3 s",),
    "close_everything": (LOST,),
    "write_nonsense": (LOST,),
    # Whatever asks for memory first finds none.
    "limit_memory": (LOST, "the simulator raised MemoryError"),
}
"""Reasons of the one test that they cost."""
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
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("deed", [*FATAL, *HARMLESS])
def test_a_driver_costs_at_most_its_own_test(
    tmp_path: Path, marks: Marks, deed: str, workers: int
) -> None:
    campaign = Campaign(
        strategy=Straight(8, 9, 8, 8, 8, 8),
        simulator=FaultySimulator(
            marks.folder, drive=Fault(getattr(faulty, deed), marks.folder, samples=9)
        ),
        driver=DummyDriver(),
        budget=Budget(simulations=6),
        folder=tmp_path / "c",
        workers=workers,
        drive_limit=3.0 if "took more" in FATAL.get(deed, ("",))[0] else LIMIT,
    )
    campaign.isolate = True
    here = Path.cwd(), sys.stdout, signal.getsignal(signal.SIGTERM), os.fstat(1), os.fstat(2)
    before = set(children(os.getpid()))
    summary = campaign.run()
    assert (summary.passed, summary.errors) == ((5, 1) if deed in FATAL else (6, 0))
    if deed in FATAL:
        with CampaignStore.open(tmp_path / "c") as store:
            test = store.test(2)
        assert (test.outcome, test.attempts) == (Outcome.ERROR, 2)
        assert "\n" not in test.reason
        names = range(1, workers + 1)
        assert test.reason.startswith(tuple(t.format(n) for t in FATAL[deed] for n in names))
    else:
        started = [line for line in events(tmp_path / "c") if line["event"] == "worker_started"]
        assert len(marks.numbers("end")) == len(started)  # in peace
    assert check_campaign(tmp_path / "c").findings == ()
    assert os.getpid() not in marks.pids()
    until_gone(marks.pids())
    assert len(set(children(os.getpid())) - before) <= 2  # the servers of processes
    assert here[:3] == (Path.cwd(), sys.stdout, signal.getsignal(signal.SIGTERM))
    assert [s.st_ino for s in here[3:]] == [os.fstat(1).st_ino, os.fstat(2).st_ino]


def test_what_a_worker_logs_reaches_the_log(marks: Marks, tmp_path: Path) -> None:
    driver = FaultyDriver(Fault(write_log, marks.folder, times=1))
    with local(DummySimulator(), driver, folder=tmp_path) as workers:
        drive_one(workers)
    (line,) = [line for line in events(tmp_path) if line["event"] == "log"]
    assert (line["level"], line["logger"]) == ("warning", "frenetic.driver")
    assert line["message"] == "worker 1: the road is wet"


# What is asked of all workers


@contextmanager
def this_process(simulator: Simulator, driver: Driver | None = None) -> Iterator[Workers]:
    with InProcessWorker(RoadTester(simulator, driver or DummyDriver())) as workers:
        yield workers


@pytest.fixture(params=["this process", "local"])
def workers_of(request: pytest.FixtureRequest, tmp_path: Path) -> WorkersOf:
    """Makes workers of each kind."""
    several = partial(local, folder=tmp_path, count=2)
    return this_process if request.param == "this process" else several


class TestWorkers(WorkersContract):
    pass


class Lacking(DummySimulator):
    def __enter__(self) -> Self:
        raise FreneticError('BeamNG is missing: pip install ".[beamng]"')


def test_a_missing_extra_is_told_in_its_own_words(workers_of: WorkersOf) -> None:
    with refused(r'pip install "\.\[beamng\]"'), workers_of(Lacking()) as workers:
        await_free(workers)


class Ageing(FaultySimulator):
    """Breaks in its first drive; after that nothing starts any more."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, drive=Fault(raise_error, folder))

    def __enter__(self) -> Self:
        if self.marks.are_there("broken"):
            refuse_connection(self.marks)
        return super().__enter__()

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.marks.make("broken")
        return super().drive(road, driver)


def test_a_simulator_that_does_not_start_again_ends_the_workers(
    workers_of: WorkersOf, marks: Marks
) -> None:
    with refused("nobody listens on port 25252"), workers_of(Ageing(marks.folder)) as workers:
        assert drive_one(workers).failure == STALLED
        for number in range(2, 10):
            drive_one(workers, number)


# One worker, here


@posix_only
@pytest.mark.parametrize("deed", [fork, fork_and_leave, sys_exit])
def test_forks_and_exits_of_a_driver_end_nothing_else(marks: Marks, deed: Deed) -> None:
    driver = FaultyDriver(Fault(deed, marks.folder, times=1))
    with this_process(DummySimulator(), driver) as workers:
        attempts = drive_all(workers, [8, 9])
    until_gone(marks.pids())
    assert ("SystemExit: 3" in str(attempts[1].failure)) is (deed is sys_exit)
    assert attempts[2].failure is None


def test_this_process_ends_only_what_it_started(marks: Marks) -> None:
    simulator = FaultySimulator(marks.folder, start=Fault(raise_error, marks.folder))
    with refused("the engine stalled"), this_process(simulator):
        pass
    assert (len(marks.numbers("start")), len(marks.numbers("end"))) == (1, 0)


# How processes are replaced


def test_a_killed_worker_is_replaced_and_its_road_comes_back(marks: Marks, tmp_path: Path) -> None:
    simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder, times=1))
    with local(simulator, folder=tmp_path) as workers:
        await_free(workers)
        workers.submit(straight(1))
        until(lambda: marks.are_there("await_go-0"), "the drive begins")
        (victim,) = marks.pids()
        os.kill(victim, 9)
        (attempt,) = await_attempts(workers)
        assert (attempt.candidate_id, attempt.worker_lost) == (1, True)
        assert attempt.failure == "worker 1 was lost: it was killed by SIGKILL"
        assert drive_all(workers, [8])[1].failure is None
        assert not is_running(victim)
    until_gone(marks.pids())
    lines = events(tmp_path)
    assert [e["event"] for e in lines] == ["worker_started", "worker_lost", "worker_started"]
    assert lines[1]["test"] == 1


@posix_only
def test_candidates_that_waited_in_a_lost_worker_are_driven(marks: Marks, tmp_path: Path) -> None:
    """A worker of quick tests has several at once."""
    simulator = FaultySimulator(marks.folder, drive=Fault(kill, marks.folder, samples=9, times=1))
    with local(simulator, folder=tmp_path) as workers:
        until(lambda: drive_one(workers) and workers.free > 2, "it is quick")
        for candidate in roads([9, 8, 8]):
            workers.submit(candidate)
        attempts = await_attempts(workers, 3)
    assert {a.candidate_id: a.worker_lost for a in attempts} == {1: True, 2: False, 3: False}


def test_a_start_that_hangs_is_given_up(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "START_LIMIT", 0.3)
    simulator = FaultySimulator(marks.folder, start=Fault(hang, marks.folder))
    with (
        refused(r"no worker could be started: its start took more"),
        local(simulator, folder=tmp_path) as workers,
    ):
        await_free(workers)
    until_gone(marks.pids())


def test_those_that_start_do_the_work_of_those_that_do_not(marks: Marks, tmp_path: Path) -> None:
    start = Fault(refuse_connection, marks.folder, times=1)
    with local(FaultySimulator(marks.folder, start=start), folder=tmp_path, count=2) as workers:
        attempts = drive_all(workers, [8, 9, 10, 11])
    assert {attempt.worker for attempt in attempts.values()} < {"worker 1", "worker 2"}
    assert all(attempt.failure is None for attempt in attempts.values())


def test_a_worker_that_once_worked_gets_further_chances_to_start(
    marks: Marks, tmp_path: Path
) -> None:
    """Its first road kills it, and its next process finds the port still taken, say."""
    with local(Stumbling(marks.folder), folder=tmp_path) as workers:
        assert drive_one(workers).worker_lost
        assert drive_one(workers).failure is None


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
        until(lambda: not workers.wait(0.1) and len(marks.pids()) == 4, "both are there again")
    until_gone(marks.pids())


def test_a_process_that_cannot_be_made_is_a_worker_less(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: Worker) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    with local(FaultySimulator(marks.folder), folder=tmp_path) as workers:
        await_free(workers)
        monkeypatch.setattr(Worker, "start", refuse)
        (victim,) = marks.pids()
        os.kill(victim, 9)
        with refused("Resource temporarily unavailable"):
            await_free(workers, 2)
    losses = [line["reason"] for line in events(tmp_path) if line["event"] == "worker_lost"]
    assert losses[0] == "it was killed by SIGKILL"


@posix_only
@pytest.mark.parametrize("method", ["the usual", "spawn"])  # as on macOS and Windows
def test_ctrl_c_is_not_for_workers(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    if method == "spawn":
        context = multiprocessing.get_context("spawn")
        monkeypatch.setattr(worker, "process_context", lambda _: context)
    with local(FaultySimulator(marks.folder), folder=tmp_path, count=2) as workers:
        for process in multiprocessing.active_children():
            if process.name.startswith("worker") and process.pid is not None:
                os.kill(process.pid, signal.SIGINT)  # before it has got anywhere
        await_free(workers, 2)
        for pid in marks.pids():
            os.kill(pid, signal.SIGINT)
        assert drive_all(workers, [8])[1].failure is None
    assert [line["event"] for line in events(tmp_path)] == ["worker_started"] * 2
    until_gone(marks.pids())


LIKE_WINDOWS = """
import multiprocessing.context, sys
del multiprocessing.context.ForkServerContext
sys.modules["multiprocessing.forkserver"] = None
import frenetic.campaign.workers
"""


def test_workers_are_imported_where_there_is_no_server_that_forks() -> None:
    subprocess.run([sys.executable, "-c", LIKE_WINDOWS], check=True, timeout=LIMIT)


# How they end


def test_what_runs_is_finished_unless_there_is_an_error(marks: Marks, tmp_path: Path) -> None:
    simulator = FaultySimulator(
        marks.folder,
        drive=Fault(await_go, marks.folder, times=1),
        end=Fault(give_go, marks.folder),
    )
    with local(simulator, folder=tmp_path, count=2) as workers:
        await_free(workers, 2)
        workers.submit(straight(1))
        until(lambda: marks.are_there("await_go-0"), "the drive begins")
    until_gone(marks.pids())


@pytest.mark.parametrize("at", ["start", "drive", "end"])
def test_after_an_error_nobody_is_waited_for(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    monkeypatch.setattr(worker, "CLOSING_LIMIT", LIMIT)
    faults: dict[str, Any] = {at: Fault(await_go, marks.folder)}
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        local(FaultySimulator(marks.folder, **faults), folder=tmp_path, count=2) as workers,
    ):
        if at != "start":
            await_free(workers, 2)
        if at == "drive":
            workers.submit(straight(1))
            workers.submit(straight(2))
        until(lambda: len(marks.pids()) == 2, "both are there")
        start = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - start < 0.5 * LIMIT
    assert not marks.numbers("end")
    until_gone(marks.pids())


def test_a_simulator_that_does_not_end_is_killed(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "CLOSING_LIMIT", 0.3)
    simulator = FaultySimulator(marks.folder, end=Fault(hang, marks.folder))
    with local(simulator, folder=tmp_path, count=2) as workers:
        await_free(workers, 2)
    until_gone(marks.pids())


@pytest.mark.parametrize("started", [0, 1, 2])
def test_an_interrupted_start_leaves_nobody(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, started: int
) -> None:
    """Of the first, the second, or the one that replaces the first."""
    original = Worker.start
    calls = 0

    def start(self: Worker) -> None:
        nonlocal calls
        calls += 1
        if calls > started:
            raise KeyboardInterrupt
        original(self)

    monkeypatch.setattr(Worker, "start", start)
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


# What is copied into them


def test_a_driver_that_cannot_be_pickled_is_one_line(tmp_path: Path) -> None:
    driver = DummyDriver()
    driver.reset = lambda setup: None  # type: ignore[method-assign]
    with (
        refused("cannot be copied to another process"),
        local(DummySimulator(), driver, folder=tmp_path),
    ):
        pass


def test_a_driver_that_cannot_be_made_again_is_one_line(tmp_path: Path) -> None:
    with (
        refused(r"no worker could be started: .*Untravelled"),
        local(DummySimulator(), Untravelled(), folder=tmp_path) as workers,
    ):
        await_free(workers)


class Untravelled(DummyDriver):
    """Does not survive the journey."""

    def __setstate__(self, state: object) -> None:
        raise ValueError("Untravelled\nstays at home")


def test_a_driver_from_a_users_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "helper.py").write_text("STEERING = 0.125")
    (tmp_path / "mine.py").write_text(
        MINE.format(helper="helper", was_there=str(tmp_path / "was-there"))
    )
    driver = DRIVERS.make(f"{tmp_path / 'mine.py'}:Mine")
    try:
        with local(DummySimulator(), driver, folder=tmp_path, count=2) as workers:
            assert drive_all(workers, [8])[1].failure is None
        assert (tmp_path / "was-there").exists()
        # The file has gone meanwhile: a worker says so.
        (tmp_path / "mine.py").unlink()
        with (
            refused(r"there is no file .*mine\.py"),
            local(DummySimulator(), driver, folder=tmp_path) as workers,
        ):
            await_free(workers)
    finally:  # workers of other tests are not to look for it
        del sys.modules[type(driver).__module__]


UNGUARDED = """
from frenetic import Budget, Campaign, RandomSearch
from frenetic.campaign.workers import local as processes
from frenetic.errors import CampaignError
from frenetic.testing import DummyDriver, DummySimulator
processes.STARTS = 1
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


def test_a_script_without_a_guard_is_told_what_it_lacks(tmp_path: Path) -> None:
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
