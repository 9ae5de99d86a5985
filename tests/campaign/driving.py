"""Workers of all kinds at work, and what is asked of all of them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from faulty import (
    STALLED,
    FarAway,
    Fault,
    FaultySimulator,
    Marks,
    NoDrive,
    raise_error,
    roads,
    straight,
)
from pids import LIMIT

from frenetic.campaign import RoadTester
from frenetic.campaign.log import LOG
from frenetic.campaign.record import Attempt
from frenetic.campaign.workers import InProcessWorker, Workers
from frenetic.outcome import Outcome
from frenetic.simulators import Simulator
from frenetic.testing import DummyDriver, DummySimulator

MINE = """
from {helper} import STEERING
from frenetic.testing import DummyDriver

class Mine(DummyDriver):
    def __init__(self):
        super().__init__(steering=STEERING)

    def reset(self, setup):
        assert self.controls.steering == STEERING == 0.125
        open({was_there!r}, "w").close()
"""
"""A driver of a user's file, with another file beside it."""


def events(folder: Path) -> list[dict[str, Any]]:
    """Lines of a campaign's log."""
    return [json.loads(line) for line in (folder / LOG).read_text().splitlines()]


def await_free(workers: Workers, count: int = 1) -> None:
    """Waits until so many candidates can be submitted, while nothing comes back."""
    deadline = time.monotonic() + LIMIT
    while workers.free < count:
        assert time.monotonic() < deadline
        assert not workers.wait(0.5)


def await_attempts(workers: Workers, count: int = 1) -> list[Attempt]:
    """Waits for so many attempts."""
    attempts: list[Attempt] = []
    deadline = time.monotonic() + LIMIT
    while len(attempts) < count:
        assert time.monotonic() < deadline
        attempts += workers.wait(0.5)
    assert len(attempts) == count
    return attempts


def drive_one(workers: Workers, number: int = 1) -> Attempt:
    """Tests a straight road."""
    await_free(workers)
    workers.submit(straight(number))
    (attempt,) = await_attempts(workers)
    return attempt


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


WorkersOf: TypeAlias = Callable[[Simulator], AbstractContextManager[Workers]]


class WorkersContract:
    """What is asked of all workers; the fixture ``workers_of`` makes two, or this process."""

    def test_each_road_comes_back_as_if_tested_here(self, workers_of: WorkersOf) -> None:
        samples = [8, 2, 12, 40, 9, 8, 10, 11]  # some are refused
        tester = RoadTester(DummySimulator(), DummyDriver())
        with workers_of(DummySimulator()) as workers:
            attempts = drive_all(workers, samples)
        for candidate in roads(samples):
            here, there = tester.test(candidate).pack(), attempts[candidate.id]
            assert there.failure is None
            assert (there.result, there.pose, there.packed) == (here.result, here.pose, here.packed)

    def test_a_simulator_that_broke_is_started_again(
        self, workers_of: WorkersOf, marks: Marks
    ) -> None:
        simulator = FaultySimulator(marks.folder, drive=Fault(raise_error, marks.folder, times=1))
        with workers_of(simulator) as workers:
            await_free(workers, count := 1 if isinstance(workers, InProcessWorker) else 2)
            attempt = drive_one(workers)
            assert attempt.failure == STALLED
            assert "in raise_error\n" in attempt.traceback
            assert not attempt.worker_lost
            await_free(workers, count)
            assert drive_all(workers, [8] * 8)[8].failure is None
        assert len(marks.numbers("start")) == len(marks.numbers("end")) == count + 1

    @pytest.mark.parametrize("simulator", [NoDrive(), FarAway()])
    def test_nonsense_of_a_simulator_is_a_failed_attempt(
        self, workers_of: WorkersOf, simulator: Simulator
    ) -> None:
        with workers_of(simulator) as workers:
            for attempt in drive_all(workers, [8, 9]).values():
                assert attempt.failure is not None
                assert attempt.result.outcome is Outcome.ERROR

    def test_a_simulator_that_does_not_end_well_spoils_nothing(
        self, workers_of: WorkersOf, marks: Marks
    ) -> None:
        breaks = Fault(raise_error, marks.folder)
        once = replace(breaks, times=1)
        with workers_of(FaultySimulator(marks.folder, drive=once, end=breaks)) as workers:
            assert drive_one(workers).failure is not None
            assert drive_all(workers, [8, 9])[2].failure is None
