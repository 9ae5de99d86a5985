"""Workers: whatever happens to them, each candidate comes back, and no process stays behind."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import pytest
from faulty import (
    STALLED,
    FarAway,
    Fault,
    FaultyDriver,
    FaultySimulator,
    Marks,
    NoDrive,
    answer_twice,
    await_go,
    close_everything,
    fork,
    fork_and_kill,
    fork_and_leave,
    give_go,
    hang,
    hang_in_c,
    kill,
    leave,
    press_ctrl_c,
    print_megabytes,
    raise_error,
    refuse_connection,
    roads,
    send_modules,
    start_process,
    start_thread,
    straight,
    sys_exit,
    write_log,
    write_nonsense,
)
from pids import LIMIT, is_running, until, until_gone

from frenetic._support import child_processes
from frenetic.campaign import RoadTester
from frenetic.campaign.log import LOG, CampaignLog
from frenetic.campaign.record import Attempt
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.campaign.workers import InProcessWorker, LocalWorkers, Workers
from frenetic.campaign.workers import local as processes
from frenetic.drivers import Driver
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.registry import DRIVERS
from frenetic.simulators import Simulator, isolated
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["marked"]

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


def events(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / LOG).read_text().splitlines()]


def await_free(workers: Workers, count: int = 1) -> None:
    deadline = time.monotonic() + LIMIT
    while workers.free < count:
        assert time.monotonic() < deadline
        assert not workers.wait(0.5)


def await_idle(workers: Workers) -> None:
    deadline = time.monotonic() + LIMIT
    while {state.state for state in workers.states().values()} != {"idle"}:
        assert time.monotonic() < deadline
        assert not workers.wait(0.5)


def drive_all(workers: Workers, samples: list[int]) -> dict[int, Attempt]:
    """Tests straight roads of so many samples, each once; their attempts by candidate."""
    waiting = roads(samples)
    done: dict[int, Attempt] = {}
    deadline = time.monotonic() + LIMIT
    while len(done) < len(samples):
        assert time.monotonic() < deadline
        while waiting and workers.free:
            workers.submit(waiting.pop(0))
        for attempt in workers.wait(0.5):
            assert attempt.candidate_id not in done
            done[attempt.candidate_id] = attempt
    return done


# What is asked of all workers


@pytest.fixture(params=["this process", "local"])
def workers_of(request: pytest.FixtureRequest, tmp_path: Path):  # type: ignore[no-untyped-def]
    """Makes workers of each kind."""

    @contextmanager
    def this_process(simulator: Simulator, driver: Driver | None = None) -> Iterator[Workers]:
        with InProcessWorker(RoadTester(simulator, driver or DummyDriver())) as workers:
            yield workers

    @contextmanager
    def several(simulator: Simulator, driver: Driver | None = None) -> Iterator[Workers]:
        with local(simulator, driver, folder=tmp_path, count=2) as workers:
            yield workers

    return this_process if request.param == "this process" else several


def test_each_road_comes_back_as_if_tested_here(workers_of, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    samples = [8, 2, 12, 40, 9, 8, 10, 11]  # some are refused
    tester = RoadTester(DummySimulator(), DummyDriver())
    with workers_of(DummySimulator()) as workers:
        attempts = drive_all(workers, samples)
    for candidate in roads(samples):
        here, there = tester.test(candidate), attempts[candidate.id]
        assert not there.worker_lost
        assert attempts[candidate.id].failure is None
        assert (there.result, there.pose) == (here.result, here.pose)
        packed = there.pack().packed
        assert packed == (None if here.trajectory is None else encode(here.trajectory))
        if packed is not None:
            assert len(decode(packed)) == len(here.trajectory or ())


def test_states_say_what_workers_do(workers_of) -> None:  # type: ignore[no-untyped-def]
    with workers_of(DummySimulator()) as workers:
        await_free(workers)
        count = len(workers.states())
        await_free(workers, count)
        assert {state.state for state in workers.states().values()} == {"idle"}
        workers.submit(straight(1))
        assert sorted(state.state for state in workers.states().values()) == sorted(
            ["driving"] + ["idle"] * (count - 1)
        )
        while not workers.wait(0.5):
            pass
        assert {state.state for state in workers.states().values()} == {"idle"}
        assert sum(state.tests for state in workers.states().values()) == 1
        assert {state.name for state in workers.states().values()} == set(workers.states())


@posix_only
@pytest.mark.parametrize("deed", [fork, fork_and_leave])
def test_forks_of_a_driver_end_with_its_drive(  # type: ignore[no-untyped-def]
    workers_of, marks: Marks, deed: Callable[[Marks], None]
) -> None:
    driver = FaultyDriver(Fault(deed, marks.folder))
    with workers_of(DummySimulator(), driver) as workers:
        attempts = drive_all(workers, [8, 9, 10, 11])
        until_gone(marks.pids())
    assert [attempts[number].result.outcome for number in range(1, 5)] == [Outcome.PASS] * 4
    assert len(marks.pids()) == 4


def test_a_second_answer_is_dropped_and_said(marks: Marks, tmp_path: Path) -> None:
    driver = FaultyDriver(Fault(answer_twice, marks.folder, times=1))
    with local(DummySimulator(), driver, folder=tmp_path) as workers:
        attempts = drive_all(workers, [8, 9, 10, 11])
    assert sorted(attempts) == [1, 2, 3, 4]
    warnings = [line["message"] for line in events(tmp_path) if line["level"] == "warning"]
    assert warnings[0] == (
        "worker 1 sent what is not counted: it answered task 1, which it does not have; does the"
        " driver fork, or write to connections that are not its own?"
    )


def test_a_simulator_that_broke_is_started_again(workers_of, marks: Marks) -> None:  # type: ignore[no-untyped-def]
    simulator = FaultySimulator(marks.folder, drive=Fault(raise_error, marks.folder, times=1))
    with workers_of(simulator) as workers:
        await_free(workers, len(workers.states()))
        workers.submit(straight(1))
        while not (attempts := workers.wait(0.5)):
            pass
        assert attempts[0].failure == STALLED
        assert "in raise_error\n" in attempts[0].traceback
        assert not attempts[0].worker_lost
        assert drive_all(workers, [8])[1].failure is None
    starts, ends = len(marks.numbers("start")), len(marks.numbers("end"))
    assert starts == ends == len(workers.states()) + 1


def test_a_simulator_that_does_not_start_is_one_line(workers_of, marks: Marks) -> None:  # type: ignore[no-untyped-def]
    simulator = FaultySimulator(marks.folder, start=Fault(refuse_connection, marks.folder))
    with (
        pytest.raises(CampaignError, match="nobody listens on port 25252") as caught,
        workers_of(simulator) as workers,
    ):
        await_free(workers)
    assert "\n" not in str(caught.value)
    assert "ConnectionRefusedError" in str(caught.value)
    assert len(marks.numbers("start")) <= 2  # a second start would be refused, too


def test_a_simulator_that_does_not_start_again_ends_the_workers(workers_of, marks: Marks) -> None:  # type: ignore[no-untyped-def]
    simulator = Ageing(marks.folder)
    done: list[Attempt] = []
    with (  # noqa: PT012
        pytest.raises(CampaignError, match="nobody listens on port 25252") as caught,
        workers_of(simulator) as workers,
    ):
        await_free(workers)
        for number in range(1, 10):
            workers.submit(straight(number))
            while not workers.free:
                done += workers.wait(0.5)
            while not done:
                done += workers.wait(0.5)
    assert "\n" not in str(caught.value)
    # What came before it has come back.
    assert done[0].failure == STALLED


class Ageing(FaultySimulator):
    """Breaks in its first drive; after that nothing starts any more."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, drive=Fault(raise_error, folder))

    def __enter__(self):  # type: ignore[no-untyped-def]
        if self.marks.are_there("broken"):
            refuse_connection(self.marks)
        return super().__enter__()

    def drive(self, road, driver):  # type: ignore[no-untyped-def]
        self.marks.make("broken")
        return super().drive(road, driver)


@pytest.mark.parametrize("simulator", [NoDrive(), FarAway()])
def test_nonsense_of_a_simulator_is_a_failed_attempt(workers_of, simulator: Simulator) -> None:  # type: ignore[no-untyped-def]
    with workers_of(simulator) as workers:
        attempts = drive_all(workers, [8, 9])
    for attempt in attempts.values():
        assert attempt.failure is not None or not attempt.worker_lost
        if attempt.failure is None:
            assert not attempt.worker_lost
            assert attempt.result.outcome is Outcome.ERROR


def test_a_driver_that_calls_sys_exit_ends_nothing_else(workers_of, marks: Marks) -> None:  # type: ignore[no-untyped-def]
    driver = FaultyDriver(Fault(sys_exit, marks.folder, times=1))
    with workers_of(DummySimulator(), driver) as workers:
        await_free(workers)
        workers.submit(straight(1))
        while not (attempts := workers.wait(0.5)):
            pass
        assert attempts[0].failure is not None
        assert "SystemExit: 3" in attempts[0].failure
        assert drive_all(workers, [8])[1].failure is None


@pytest.mark.parametrize("deed", [print_megabytes, write_log])
def test_talkative_drivers_do_no_harm(  # type: ignore[no-untyped-def]
    workers_of, marks: Marks, deed: Callable[[Marks], None], capfd: pytest.CaptureFixture[str]
) -> None:
    with workers_of(DummySimulator(), FaultyDriver(Fault(deed, marks.folder))) as workers:
        attempts = drive_all(workers, [8, 9, 10])
    assert all(attempt.failure is None for attempt in attempts.values())


def test_a_simulator_that_does_not_end_well_spoils_nothing(workers_of, marks: Marks) -> None:  # type: ignore[no-untyped-def]
    simulator = FaultySimulator(
        marks.folder,
        drive=Fault(raise_error, marks.folder, times=1),
        end=Fault(raise_error, marks.folder),
    )
    with workers_of(simulator) as workers:
        await_free(workers)
        workers.submit(straight(1))
        while not (attempts := workers.wait(0.5)):
            pass
        assert attempts[0].failure is not None
        assert drive_all(workers, [8, 9])[2].failure is None


# Processes


def test_a_killed_worker_is_replaced_and_its_road_comes_back(marks: Marks, tmp_path: Path) -> None:
    simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder, times=1))
    with local(simulator, folder=tmp_path) as workers:
        await_free(workers)
        workers.submit(straight(1))
        until(lambda: marks.are_there("await_go-0"), "the drive begins")
        (victim,) = marks.pids()
        os.kill(victim, 9)
        while not (attempts := workers.wait(0.5)):
            pass
        (attempt,) = attempts
        assert (attempt.candidate_id, attempt.worker_lost) == (1, True)
        assert attempt.failure == "worker 1 was lost: it was killed by SIGKILL"
        assert drive_all(workers, [8])[1].failure is None
        assert not is_running(victim)
    until_gone(marks.pids())
    assert [line["event"] for line in events(tmp_path)] == [
        "worker_started",
        "worker_lost",
        "worker_started",
    ]
    assert events(tmp_path)[1]["test"] == 1


@pytest.mark.parametrize(
    "deed", [hang, pytest.param(hang_in_c, marks=posix_only)], ids=["in Python", "in C"]
)
def test_a_worker_that_hangs_is_replaced(
    marks: Marks, tmp_path: Path, deed: Callable[[Marks], None]
) -> None:
    simulator = FaultySimulator(marks.folder, drive=Fault(deed, marks.folder, times=1))
    with local(simulator, folder=tmp_path, drive_limit=0.5) as workers:
        await_free(workers)
        workers.submit(straight(1))
        while not (attempts := workers.wait(LIMIT)):
            pass
        assert attempts[0].failure is not None
        assert "its drive took more than " in attempts[0].failure
        assert attempts[0].seconds >= 0.5
        await_free(workers)
    assert len(marks.pids()) == 2
    until_gone(marks.pids())


def test_a_start_that_hangs_is_given_up(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "START_LIMIT", 0.3)
    simulator = FaultySimulator(marks.folder, start=Fault(hang, marks.folder))
    with (
        pytest.raises(CampaignError, match=r"no worker could be started: its start took more"),
        local(simulator, folder=tmp_path) as workers,
    ):
        await_free(workers)
    until_gone(marks.pids())


def test_those_that_start_do_the_work_of_those_that_do_not(marks: Marks, tmp_path: Path) -> None:
    start = Fault(refuse_connection, marks.folder, times=1)
    with local(FaultySimulator(marks.folder, start=start), folder=tmp_path, count=2) as workers:
        attempts = drive_all(workers, [8, 9, 10, 11])
        assert sorted(state.state for state in workers.states().values()) == ["idle", "lost"]
    assert all(attempt.failure is None for attempt in attempts.values())


def test_a_worker_that_once_worked_gets_further_chances_to_start(
    marks: Marks, tmp_path: Path
) -> None:
    """Its first road kills it, and its next process finds the port still taken, say."""
    simulator = Stumbling(marks.folder)
    with local(simulator, folder=tmp_path) as workers:
        await_free(workers)
        workers.submit(straight(1))
        while not (attempts := workers.wait(0.5)):
            pass
        assert attempts[0].worker_lost
        assert drive_all(workers, [8])[1].failure is None


class Stumbling(FaultySimulator):
    """Kills its process in the first drive, and does not start the second time."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, drive=Fault(kill, folder, times=1))

    def __enter__(self):  # type: ignore[no-untyped-def]
        super().__enter__()
        if self.marks.numbers("start") == [1, 2]:
            refuse_connection(self.marks)
        return self


@pytest.mark.parametrize(
    ("deed", "why"),
    [
        (leave, "it ended with exit code 7"),
        (press_ctrl_c, "KeyboardInterrupt"),
        pytest.param(write_nonsense, "its connection broke", marks=posix_only),
        pytest.param(close_everything, "does the driver close file descriptors", marks=posix_only),
    ],
)
def test_a_driver_that_takes_its_worker_with_it(
    marks: Marks,
    tmp_path: Path,
    deed: Callable[[Marks], None],
    why: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    driver = FaultyDriver(Fault(deed, marks.folder, times=1))
    with local(DummySimulator(), driver, folder=tmp_path) as workers:
        await_free(workers)
        workers.submit(straight(1))
        while not (attempts := workers.wait(0.5)):
            pass
        assert attempts[0].worker_lost
        assert why in (attempts[0].failure or "")
        assert drive_all(workers, [8])[1].failure is None
    assert "Traceback" not in capfd.readouterr().err


@linux_only
def test_workers_are_forked_with_their_code() -> None:
    process, connection = child_processes.start_process(
        child_processes.process_context(), send_modules, name="any"
    )
    with connection:
        assert connection.recv() >= {processes.__name__, isolated.__name__}
    process.join()


@linux_only
def test_workers_survive_the_end_of_the_server_that_forks_them(
    marks: Marks, tmp_path: Path
) -> None:
    with local(FaultySimulator(marks.folder), folder=tmp_path, count=2) as workers:
        await_free(workers, 2)
        server = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
        os.kill(server, 9)
        until_gone([server])
        attempts = drive_all(workers, [8, 9, 10, 11])
        assert len(attempts) == 4
        await_idle(workers)
        assert len(marks.pids()) == 4
    until_gone(marks.pids())


def test_a_process_that_cannot_be_made_is_a_worker_less(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with local(FaultySimulator(marks.folder), folder=tmp_path) as workers:
        await_free(workers)

        def refuse(*_: object, **__: object) -> None:
            raise BlockingIOError(11, "Resource temporarily unavailable")

        monkeypatch.setattr(processes, "start_process", refuse)
        (victim,) = marks.pids()
        os.kill(victim, 9)
        with pytest.raises(CampaignError, match="Resource temporarily unavailable"):
            await_free(workers, 2)
    losses = [line["reason"] for line in events(tmp_path) if line["event"] == "worker_lost"]
    assert losses[0] == "it was killed by SIGKILL"
    assert all("no process for it" in str(reason) for reason in losses[1:])


@posix_only
@pytest.mark.parametrize("method", ["the usual", "spawn"])  # as on macOS and Windows
def test_ctrl_c_is_not_for_workers(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    if method == "spawn":
        monkeypatch.setattr(
            processes, "process_context", lambda _: multiprocessing.get_context("spawn")
        )
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


def test_workers_are_imported_where_there_is_no_server_that_forks(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", LIKE_WINDOWS], check=True, timeout=LIMIT)


@linux_only
def test_a_worker_whose_child_holds_its_connection_is_missed(marks: Marks, tmp_path: Path) -> None:
    """Where the system tells of ended processes, nobody has to wait for the connection's end."""
    simulator = FaultySimulator(marks.folder, drive=Fault(fork_and_kill, marks.folder, times=1))
    with local(simulator, folder=tmp_path) as workers:
        await_free(workers)
        workers.submit(straight(1))
        start = time.monotonic()
        while not (attempts := workers.wait(LIMIT)):
            pass
        assert time.monotonic() - start < 0.5 * LIMIT
        assert attempts[0].failure == "worker 1 was lost: it was killed by SIGKILL"
        assert drive_all(workers, [8])[1].failure is None


# How they end


@pytest.mark.parametrize("deed", [start_thread, start_process])
def test_what_a_driver_started_ends_with_its_worker(
    marks: Marks,
    tmp_path: Path,
    deed: Callable[[Marks], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(processes, "CLOSING_LIMIT", LIMIT)
    driver = FaultyDriver(Fault(deed, marks.folder, times=1))
    with local(FaultySimulator(marks.folder), driver, folder=tmp_path) as workers:
        drive_all(workers, [8, 9])
        start = time.monotonic()
    assert time.monotonic() - start < 0.5 * LIMIT
    assert len(marks.numbers("end")) == 1  # in peace
    assert len(marks.pids()) == (2 if deed is start_process else 1)
    until_gone(marks.pids())


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
    # It could go on only when the other worker had ended, and then it ended in peace.
    assert len(marks.numbers("end")) == 2
    until_gone(marks.pids())


def test_after_an_error_nobody_is_waited_for(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "CLOSING_LIMIT", LIMIT)
    simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder))
    start = time.monotonic()
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        local(simulator, folder=tmp_path, count=2) as workers,
    ):
        await_free(workers, 2)
        start = time.monotonic()
        workers.submit(straight(1))
        workers.submit(straight(2))
        raise KeyboardInterrupt
    assert time.monotonic() - start < 0.5 * LIMIT
    until_gone(marks.pids())


def test_a_simulator_that_still_starts_is_not_waited_for(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "CLOSING_LIMIT", LIMIT)
    simulator = FaultySimulator(marks.folder, start=Fault(await_go, marks.folder))
    start = time.monotonic()
    with local(simulator, folder=tmp_path, count=2):
        until(lambda: len(marks.pids()) == 2, "both begin to start")
    assert time.monotonic() - start < 0.5 * LIMIT
    until_gone(marks.pids())


def test_a_simulator_that_does_not_end_is_killed(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "CLOSING_LIMIT", 0.3)
    simulator = FaultySimulator(marks.folder, end=Fault(hang, marks.folder))
    with local(simulator, folder=tmp_path, count=2) as workers:
        await_free(workers, 2)
    until_gone(marks.pids())


@pytest.mark.parametrize("started", [0, 1])
def test_an_interrupted_beginning_leaves_nobody(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, started: int
) -> None:
    original = child_processes.start_process
    calls = 0

    def start(*arguments: Any, **options: Any) -> object:
        nonlocal calls
        calls += 1
        if calls > started:
            raise KeyboardInterrupt
        return original(*arguments, **options)

    monkeypatch.setattr(processes, "start_process", start)
    simulator = FaultySimulator(marks.folder, start=Fault(await_go, marks.folder))
    with pytest.raises(KeyboardInterrupt), local(simulator, folder=tmp_path, count=2):
        pass
    assert not children()
    until_gone(marks.pids())


def children() -> list[str]:
    """Names of the workers for which this process would wait at its end."""
    names = (process.name for process in multiprocessing.active_children())
    return [name for name in names if name.startswith("worker")]


def test_an_interrupted_replacement_leaves_nobody(
    marks: Marks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (  # noqa: PT012
        pytest.raises(KeyboardInterrupt),
        local(FaultySimulator(marks.folder), folder=tmp_path, count=2) as workers,
    ):
        await_free(workers, 2)

        def interrupted(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(processes, "start_process", interrupted)
        os.kill(marks.pids()[0], 9)
        while True:
            workers.wait(0.5)
    assert not children()
    until_gone(marks.pids())


# What is copied into them


def test_a_driver_that_cannot_be_pickled_is_one_line(tmp_path: Path) -> None:
    driver = DummyDriver()
    driver.reset = lambda setup: None  # type: ignore[method-assign]
    with (
        pytest.raises(CampaignError, match="cannot be copied to another process") as caught,
        local(DummySimulator(), driver, folder=tmp_path),
    ):
        pass
    assert "\n" not in str(caught.value)
    assert "with a Campaign of objects and one worker" in str(caught.value)


def test_a_driver_that_cannot_be_made_again_is_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(CampaignError, match=r"no worker could be started: .*Untravelled") as caught,
        local(DummySimulator(), Untravelled(), folder=tmp_path) as workers,
    ):
        await_free(workers)
    assert "\n" not in str(caught.value)


class Untravelled(DummyDriver):
    """Does not survive the journey."""

    def __setstate__(self, state: object) -> None:
        raise ValueError("Untravelled\nstays at home")


MINE = """
from helper import STEERING
from frenetic.testing import DummyDriver

class Mine(DummyDriver):
    def __init__(self):
        super().__init__(steering=STEERING)

    def reset(self, setup):
        assert self.controls.steering == STEERING == 0.125
        open({folder!r} + "/was-there", "w").close()
"""


def test_a_driver_from_a_users_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "helper.py").write_text("STEERING = 0.125")
    (tmp_path / "mine.py").write_text(MINE.format(folder=str(tmp_path)))
    driver = DRIVERS.make(f"{tmp_path / 'mine.py'}:Mine")
    try:
        with local(DummySimulator(), driver, folder=tmp_path, count=2) as workers:
            assert drive_all(workers, [8])[1].failure is None
        assert (tmp_path / "was-there").exists()
        # The file has gone meanwhile: a worker says so.
        (tmp_path / "mine.py").unlink()
        with (
            pytest.raises(CampaignError, match=r"there is no file .*mine\.py"),
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


# One worker, here


def test_this_process_ends_only_what_it_started(marks: Marks) -> None:
    simulator = FaultySimulator(marks.folder, start=Fault(raise_error, marks.folder))
    with (
        pytest.raises(CampaignError, match="the engine stalled"),
        InProcessWorker(RoadTester(simulator, DummyDriver())),
    ):
        pass
    assert (len(marks.numbers("start")), len(marks.numbers("end"))) == (1, 0)


def test_a_missing_extra_is_told_in_its_own_words(workers_of) -> None:  # type: ignore[no-untyped-def]
    with (
        pytest.raises(CampaignError, match=r'pip install "frenetic-roads\[beamng\]"'),
        workers_of(Lacking()) as workers,
    ):
        await_free(workers)


class Lacking(DummySimulator):
    def __enter__(self):  # type: ignore[no-untyped-def]
        raise FreneticError('BeamNG is missing: pip install "frenetic-roads[beamng]"')
