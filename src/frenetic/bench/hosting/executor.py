"""The executor of a hosted generator: the pipeline's interface, with the bench behind it.

Its time is virtual.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NoReturn

from frenetic.bench.hosting.messages import Answer, Assignment, Parent
from frenetic.bench.hosting.offered.code_pipeline.executors import (
    ELSEWHERE,
    AbstractTestExecutor,
    Shared,
)
from frenetic.bench.hosting.offered.code_pipeline.tests_generation import (
    RoadTest,
    TestGenerationStatistic,
)
from frenetic.bench.hosting.offered.code_pipeline.validation import (
    WRONG_TYPE,
    TestValidator,
    points_of,
)
from frenetic.bench.hosting.offered.self_driving.simulation_data import SimulationDataRecord

OVER: Final = 123
"""Exit code by which the pipeline ends a generator whose budget is spent."""
MOST_POINTS: Final = 10_000
"""Most road points sent to the bench; a road of more than 500 is invalid anyway."""

DRIVES: Final = Path("simulations", "beamng_executor")
"""Folder in which the pipeline leaves a folder of every drive."""

_COUNTERS: Final = {"PASS": "test_passed", "FAIL": "test_failed", "ERROR": "test_in_error"}
_TIME_BUDGET: Final = "time-budget"
_ROUNDING: Final = 1e-12  # share of the budget that rounding may leave


class VirtualClock(Shared):
    """The spent part of a budget, as the bench counts it, which decides whether a test fits.

    Where computing counts, the time since the bench's last answer is added. The bench gets that
    time with the next test and adds it, too, so the spent part does not jump.

    Args:
        budget: virtual s.
        counts_computing: whether the generator's own time counts.
        timer: tells s of wall time.

    """

    def __init__(
        self,
        budget: float,
        *,
        counts_computing: bool,
        timer: Callable[[], float] = time.monotonic,
    ) -> None:
        self.budget = budget
        self._counts_computing = counts_computing
        self._timer = timer
        self._settled = 0.0
        self._since: float | None = None  # when the generator began to compute
        self._ended = False

    @property
    def spent(self) -> float:
        """Budget in virtual s."""
        return self._settled + (self._own_time() if self._counts_computing else 0.0)

    @property
    def remaining(self) -> float:
        """Virtual s, at least 0."""
        return 0.0 if self._ended else max(0.0, self.budget - self.spent)

    @property
    def is_over(self) -> bool:
        """Whether nothing remains.

        A remainder too small for a test does not count as spent: the next test then ends the run.
        """
        return self.remaining <= _ROUNDING * self.budget

    def start(self) -> None:
        """Count the generator's time from now on."""
        self._since = self._timer()

    def stop(self) -> float:
        """Stop the time while a test is executed.

        Returns:
            s of wall time since it was let go on; 0 if it never was.

        """
        seconds = self._own_time()
        if self._counts_computing:
            self._settled += seconds
        self._since = None
        return seconds

    def settle(self, spent: float) -> None:
        """Take over the bench's count, and start."""
        self._settled = spent
        self.start()

    def end(self) -> None:
        """Leave nothing of the budget."""
        self._ended = True

    def _own_time(self) -> float:
        since = self._since  # which another thread may set to None
        return 0.0 if since is None else self._timer() - since


class RemainingTime(float):
    """Seconds as a number, as in 2021, that also answer ``["time-budget"]`` as later ones do."""

    __slots__ = ()

    def __getitem__(self, name: str) -> float:
        if name != _TIME_BUDGET:
            raise KeyError(name)
        return float(self)


class TimeBudget(Shared):
    """The executor's view of the budget.

    Args:
        clock: of the budget.
        as_number: whether the remaining time is a number, as in 2021, or a dictionary.

    """

    generation_budget = None
    """There is one budget, for generating and executing together."""
    execution_budget = None

    def __init__(self, clock: VirtualClock, *, as_number: bool) -> None:
        self._clock = clock
        self._as_number = as_number
        self.time_budget = clock.budget
        """Budget in virtual s."""

    def is_over(self) -> bool:
        """Return whether nothing remains."""
        return self._clock.is_over

    def can_run_a_test(self) -> bool:
        """Return whether anything remains; a test that needs more ends the run."""
        return not self._clock.is_over

    def get_remaining_real_time(self) -> float:
        """Return virtual s, which here are the real ones."""
        return self._clock.remaining

    def get_remaining_time(self) -> Any:
        """Return virtual s: a dictionary, or a number as in 2021."""
        remaining = self._clock.remaining
        return RemainingTime(remaining) if self._as_number else {_TIME_BUDGET: remaining}


class HostedExecutor(Shared, AbstractTestExecutor):
    """Has tests executed by the bench, one at a time, from any thread.

    Args:
        assignment: the terms.
        parent: the bench.
        remaining_as_number: whether `get_remaining_time` gives a number, as in 2021.
        timer: tells s of wall time.

    """

    def __init__(
        self,
        assignment: Assignment,
        parent: Parent,
        *,
        remaining_as_number: bool,
        timer: Callable[[], float] = time.monotonic,
    ) -> None:
        self._parent = parent
        self._seconds_per_test = assignment.seconds_per_test
        self._clock = VirtualClock(
            assignment.time_budget, counts_computing=assignment.counts_computing, timer=timer
        )
        self._timer = timer
        self._lock = threading.Lock()
        self._was_ended = False
        self._process = os.getpid()
        self._drives = Path.cwd() / DRIVES
        self._numbers = itertools.count(1)
        self.map_size = assignment.map_size
        self.oob_tolerance = assignment.oob_tolerance
        self.speed_limit = assignment.speed_limit
        self.result_folder = assignment.result_folder
        self.time_budget = TimeBudget(self._clock, as_number=remaining_as_number)
        self.stats = TestGenerationStatistic()
        self.test_validator = TestValidator(assignment.map_size)
        self.road_visualizer = None
        self.start_generation_time: float | None = timer()

    def start(self) -> None:
        """Let the budget begin."""
        self._clock.start()
        self.start_generation_time = self._timer()

    def stop(self) -> float:
        """Stop the time for good; return s since the bench last got any."""
        return self._clock.stop()

    @property
    def has_spent_the_budget(self) -> bool:
        """Whether nothing remains, or a test was refused because it no longer fitted."""
        return self._was_ended or self._clock.is_over

    def execute_test(self, the_test: Any) -> tuple[str, str, list[SimulationDataRecord]]:
        """Return outcome, description and records of a test; an invalid one has no records.

        Raises:
            SystemExit: The budget is spent; the test was not run and does not count.
            RuntimeError: This is a process that the generator has forked.

        """
        if os.getpid() != self._process:  # where nobody would hear the answer
            raise RuntimeError(ELSEWHERE)
        with self._lock:
            points = points_of(the_test)
            if self._parent.has_spoken:  # unasked: it says so when the budget is spent
                self._parent.receive()
                self._refuse()
            seconds = self._clock.stop()
            sent = None if points is None else points[:MOST_POINTS]
            message = self._parent.ask({"kind": "test", "road_points": sent, "seconds": seconds})
            if message.get("over"):
                self._clock.start()
                self._refuse()
            answer = Answer(**message)
            if points is None:
                answer = replace(answer, description=WRONG_TYPE)
            records = [_record(row) for row in answer.records]
            if isinstance(the_test, RoadTest):
                _note(the_test, answer, records)
            self._count(answer, seconds)
            if answer.is_executed:
                self._leave_folder()
            self._clock.settle(answer.spent)
            self.start_generation_time = self._timer()
            return answer.outcome, answer.description, records

    def validate_test(self, the_test: Any) -> tuple[bool, str]:
        """Return whether a test is valid, and if not, why; costs nothing."""
        return self.test_validator.validate_test(the_test)

    def is_over(self) -> bool:
        """Return whether nothing remains of the budget."""
        return self._clock.is_over

    def get_remaining_time(self) -> Any:
        """Return virtual s: a dictionary with ``time-budget``, or a number as in 2021."""
        return self.time_budget.get_remaining_time()

    def get_stats(self) -> TestGenerationStatistic:
        """Return the counts so far."""
        return self.stats

    def is_force_timeout(self) -> bool:
        """Return False: no test is made to time out here."""
        return False

    def close(self) -> None:
        """Do nothing: the bench ends the process."""

    def _refuse(self) -> NoReturn:
        self._was_ended = True
        self._clock.end()
        raise SystemExit(OVER)

    def _count(self, answer: Answer, generation_time: float) -> None:
        """Adds a test to `stats`.

        The generator shares and may replace them: a value that cannot be counted stays as it is.
        """
        names = ["test_generated", "test_valid" if answer.is_executed else "test_invalid"]
        if answer.outcome in _COUNTERS:
            names.append(_COUNTERS[answer.outcome])
        if answer.description.startswith("Car drove out of the lane "):
            names.append("obes")
        times = {"test_generation_real_times": generation_time}
        if answer.is_executed:
            times["test_execution_real_times"] = self._seconds_per_test
            times["test_execution_simulation_times"] = answer.simulated
        for name in names:
            with suppress(Exception):
                setattr(self.stats, name, getattr(self.stats, name) + 1)
        for name, seconds in times.items():
            with suppress(Exception):
                getattr(self.stats, name).append(seconds)

    def _leave_folder(self) -> None:
        """Leaves a drive's folder; some generators note the name of the latest."""
        with suppress(OSError):
            number = next(self._numbers)
            (self._drives / f"sim_{number:05d}").mkdir(parents=True, exist_ok=True)


def _note(test: RoadTest, answer: Answer, records: list[SimulationDataRecord]) -> None:
    """Writes what became of a test into it."""
    test.set_validity(answer.is_executed, "" if answer.is_executed else answer.description)
    if answer.is_executed:
        test.execution_data = records
        test.test_outcome = answer.outcome
        test.description = answer.description
        vars(test).pop("features", None)  # of an earlier drive


def _record(row: list[Any]) -> SimulationDataRecord:
    values: list[Any] = [tuple(v) if isinstance(v, list) else v for v in row]
    return SimulationDataRecord(*values)
