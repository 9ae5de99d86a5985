"""Helpers that let workers drive, and the contracts that all workers keep."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from campaigns import refused
from faulty import (
    STALLED,
    Fault,
    FaultyDriver,
    FaultySimulator,
    Marks,
    await_go,
    kill,
    raise_error,
    refuse_connection,
    roads,
    straight,
    sys_exit,
    write_log,
)
from pids import LIMIT, until

from frenetic.campaign import RoadTester
from frenetic.campaign.log import LOG
from frenetic.campaign.record import Attempt
from frenetic.campaign.workers import Workers
from frenetic.campaign.workers.workers import NAME as THIS_PROCESS
from frenetic.testing import DummyDriver, DummySimulator

USER_DRIVER = """
from {helper} import STEERING
from frenetic.testing import DummyDriver

class Mine(DummyDriver):
    def __init__(self):
        super().__init__(steering=STEERING)

    def reset(self, setup):
        assert self.controls.steering == STEERING == 0.125
        open({was_there!r}, "w").close()
"""
"""Code of a user's driver, which imports another file of the same folder."""


def write_user_driver(folder: Path, name: str) -> Path:
    """Write `USER_DRIVER` and the file that it imports; return the file that a drive makes."""
    was_there = folder / "was-there"
    (folder / f"{name}_helper.py").write_text("STEERING = 0.125")
    text = USER_DRIVER.format(helper=f"{name}_helper", was_there=str(was_there))
    (folder / f"{name}.py").write_text(text)
    return was_there


def events(folder: Path, kind: str = "") -> list[dict[str, Any]]:
    """Return the lines of a campaign's log, all or one kind of event."""
    lines = [json.loads(line) for line in (folder / LOG).read_text().splitlines()]
    return [line for line in lines if kind in ("", line["event"])]


def await_free(workers: Workers, count: int = 1) -> None:
    """Wait until so many candidates can be submitted; assert that no attempt comes back."""
    deadline = time.monotonic() + LIMIT
    while workers.free < count:
        assert time.monotonic() < deadline
        assert not workers.wait(0.5)


def await_attempts(workers: Workers, count: int = 1) -> list[Attempt]:
    """Wait for so many attempts and return them."""
    attempts: list[Attempt] = []
    deadline = time.monotonic() + LIMIT
    while len(attempts) < count:
        assert time.monotonic() < deadline
        attempts += workers.wait(0.5)
    assert len(attempts) == count
    return attempts


def drive_one(workers: Workers, number: int = 1, samples: int = 8) -> Attempt:
    """Test one straight road and return its attempt."""
    await_free(workers)
    workers.submit(straight(number, samples))
    (attempt,) = await_attempts(workers)
    return attempt


def drive_all(workers: Workers, samples: list[int]) -> dict[int, Attempt]:
    """Test straight roads of so many samples, each once; return the attempts by candidate."""
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


WorkersOf: TypeAlias = Callable[..., AbstractContextManager[Workers]]
"""Function that makes workers for a simulator and a driver; they log into the test's folder."""


class WorkersContract:
    """Tests that all workers pass; a subclass's fixture ``workers_of`` makes the workers."""

    COUNT = 1
    """Workers."""

    def test_workers_give_the_results_that_this_process_gives(self, workers_of: WorkersOf) -> None:
        samples = [8, 2, 12, 40, 9, 8, 10, 11]  # some are refused
        tester = RoadTester(DummySimulator(), DummyDriver())
        with workers_of(DummySimulator()) as workers:
            attempts = drive_all(workers, samples)
        for candidate in roads(samples):
            expected, attempt = tester.test(candidate).pack(), attempts[candidate.id]
            assert attempt.failure is None
            assert (attempt.result, attempt.pose, attempt.packed) == (
                expected.result,
                expected.pose,
                expected.packed,
            )

    def test_a_broken_simulator_is_restarted(self, workers_of: WorkersOf, marks: Marks) -> None:
        simulator = FaultySimulator(marks.folder, drive=Fault(raise_error, marks.folder, times=1))
        with workers_of(simulator) as workers:
            await_free(workers, self.COUNT)
            attempt = drive_one(workers)
            assert attempt.failure == STALLED
            assert attempt.trouble is not None
            assert "in raise_error\n" in attempt.trouble.traceback
            assert not attempt.worker_lost
            await_free(workers, self.COUNT)
            assert drive_all(workers, [8] * 8)[8].failure is None
        assert len(marks.numbers("start")) == len(marks.numbers("end")) == self.COUNT + 1

    def test_a_simulator_that_does_not_start_is_a_one_line_error(
        self, workers_of: WorkersOf, marks: Marks
    ) -> None:
        simulator = FaultySimulator(marks.folder, start=Fault(refuse_connection, marks.folder))
        with (
            refused("ConnectionRefusedError: nobody listens on port 25252"),
            workers_of(simulator) as workers,
        ):
            await_free(workers)
        assert len(marks.numbers("start")) == self.COUNT  # further ones would be refused, too
        assert not marks.numbers("end")

    def test_an_error_at_a_simulators_end_does_not_stop_the_drives(
        self, workers_of: WorkersOf, marks: Marks
    ) -> None:
        breaks_always = Fault(raise_error, marks.folder)
        breaks_once = replace(breaks_always, times=1)
        with workers_of(
            FaultySimulator(marks.folder, drive=breaks_once, end=breaks_always)
        ) as workers:
            assert drive_one(workers).failure is not None
            assert drive_all(workers, [8, 9])[2].failure is None

    def test_messages_of_a_driver_reach_the_log_of_the_campaign(
        self, workers_of: WorkersOf, marks: Marks, tmp_path: Path
    ) -> None:
        driver = FaultyDriver(Fault(write_log, marks.folder, times=1))
        with workers_of(DummySimulator(), driver) as workers:
            worker = drive_one(workers).worker
        (line,) = events(tmp_path, "log")
        assert (line["level"], line["logger"]) == ("warning", "frenetic.driver")
        assert line["message"].endswith("the road is wet")
        assert line["message"].startswith(f"{worker}: ") is (worker != THIS_PROCESS)


class ProcessesContract(WorkersContract):
    """Tests that two workers in processes pass."""

    COUNT = 2

    def test_a_lost_worker_costs_one_attempt_and_is_replaced(
        self, workers_of: WorkersOf, marks: Marks, tmp_path: Path
    ) -> None:
        faults = [Fault(kill, marks.folder, 9, times=1), Fault(sys_exit, marks.folder, 10, times=1)]
        with workers_of(FaultySimulator(marks.folder, drive=faults)) as workers:
            for number, samples in enumerate([9, 10], start=1):
                await_free(workers, 2)
                attempt = drive_one(workers, number, samples)
                assert (attempt.candidate_id, attempt.worker_lost) == (number, True)
                assert f"{attempt.worker} was lost: " in str(attempt.failure)
                assert ("SystemExit: 3 (faulty.py:" in str(attempt.failure)) is (samples == 10)
                lost = events(tmp_path, "worker_lost")[-1]
                assert (lost["test"], lost["message"]) == (number, attempt.failure)
            await_free(workers, 2)
            assert all(
                attempt.failure is None for attempt in drive_all(workers, [8, 9, 10]).values()
            )
        assert len(events(tmp_path, "worker_lost")) == 2

    def test_a_driver_that_cannot_be_copied_is_a_one_line_error(
        self, workers_of: WorkersOf
    ) -> None:
        driver = DummyDriver()
        driver.lock = threading.Lock()  # type: ignore[attr-defined]
        with refused("cannot be (copied|sent) to"), workers_of(DummySimulator(), driver):
            pass

    def test_after_an_error_workers_end_without_waiting_for_drives(
        self, workers_of: WorkersOf, marks: Marks
    ) -> None:
        simulator = FaultySimulator(marks.folder, drive=Fault(await_go, marks.folder, times=2))
        with pytest.raises(KeyboardInterrupt), workers_of(simulator) as workers:  # noqa: PT012
            await_free(workers, 2)
            workers.submit(straight(1))
            workers.submit(straight(2))
            until(lambda: len(marks.numbers("await_go")) == 2, "both drive")
            start = time.monotonic()
            raise KeyboardInterrupt
        assert time.monotonic() - start < 0.5 * LIMIT
        assert not marks.numbers("end")
        marks.make("go")
