"""The executor of a hosted generator: the pipeline's own, whose tests the bench executes.

Its time is virtual.
"""

from __future__ import annotations

import inspect
import itertools
import os
import threading
import time
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NoReturn

from frenetic.bench.hosting.messages import Answer, Assignment, Parent
from frenetic.bench.hosting.validity import pairs_of

OVER: Final = 123
"""Exit code by which the pipeline ends a generator whose budget is spent."""
MOST_POINTS: Final = 10_000
"""Most road points sent to the bench; a road of more than 500 is invalid anyway."""

DRIVES: Final = Path("simulations", "beamng_executor")
"""Folder in which the pipeline leaves a folder of every drive."""
EXECUTORS: Final = "code_pipeline.executors"
"""The pipeline's module of that name."""

_TIME_BUDGET: Final = "time-budget"
_ROUNDING: Final = 1e-12  # share of the budget that rounding may leave
_NAME: Final = "hosted"


class VirtualClock:
    """The spent part of a budget of virtual s, as the bench counts it, which ends the run."""

    def __init__(self, budget: float) -> None:
        self.budget = budget
        self.spent = 0.0
        self.is_held = False
        """Whether a test is being executed that the bench has found to fit."""
        self._since: float | None = None  # when the generator began to compute

    def __deepcopy__(self, memo: dict[int, Any]) -> VirtualClock:
        return self

    def remaining(self) -> float:
        """Return virtual s, at least 0."""
        left = self.budget - self.spent
        if left <= _ROUNDING * self.budget:
            return _ROUNDING * self.budget if self.is_held else 0.0
        return left

    def start(self) -> None:
        """Measure the generator's own time from now on."""
        self._since = time.monotonic()

    def stop(self) -> float:
        """Return s of wall time since it was let go on; 0 if it never was."""
        since, self._since = self._since, None
        return 0.0 if since is None else time.monotonic() - since


class RemainingTime(float):
    """Seconds as a number, as in 2021, that also answer ``["time-budget"]`` as later ones do."""

    __slots__ = ()

    def __getitem__(self, name: str) -> float:
        if name != _TIME_BUDGET:
            raise KeyError(name)
        return float(self)


def make_executor(
    assignment: Assignment,
    parent: Parent,
    clock: VirtualClock,
    *,
    remaining_as_number: bool,
) -> Any:
    """Return an executor of the pipeline that is on the module path.

    Args:
        assignment: the terms.
        parent: the bench.
        clock: of the budget.
        remaining_as_number: whether `get_remaining_time` gives a number, as in 2021.

    """
    pipeline = import_module(EXECUTORS)
    base = pipeline.AbstractTestExecutor
    kind = type("HostedExecutor", (_Hosted, base), {"__module__": EXECUTORS})
    terms = {
        "result_folder": assignment.result_folder,
        "map_size": assignment.map_size,
        "time_budget": assignment.time_budget,
    }
    known = inspect.signature(base).parameters  # 2021 knows no folder
    executor = kind(**{name: value for name, value in terms.items() if name in known})
    budget: Any = executor.time_budget
    if hasattr(budget, "get_remaining_real_time"):  # a number in 2021
        budget.get_remaining_real_time = clock.remaining
        if remaining_as_number:
            budget.get_remaining_time = lambda: RemainingTime(clock.remaining())
    executor.map_size = assignment.map_size
    executor.oob_tolerance = assignment.oob_tolerance
    executor.speed_limit = assignment.speed_limit
    executor._join(parent, clock, assignment.seconds_per_test)
    setattr(pipeline, _NAME, executor)
    return executor


class _Hosted:
    """What the bench puts in the place of a pipeline's own methods: one test at a time."""

    stats: Any
    timeout_forced: bool

    def _join(self, parent: Parent, clock: VirtualClock, seconds_per_test: float) -> None:
        self._parent = parent
        self._clock = clock
        self._seconds_per_test = seconds_per_test
        self._lock = threading.Lock()
        self._process = os.getpid()
        self._drives = Path.cwd() / DRIVES
        self._numbers = itertools.count(1)
        self._record = import_module("self_driving.simulation_data").SimulationDataRecord
        self._test: Any = None  # that is being executed
        self._answer: Answer | None = None

    def __reduce__(self) -> str:
        """Return its name in the pipeline's module: copies of it are itself."""
        return _NAME

    def execute_test(self, the_test: Any) -> tuple[str, str, Any]:
        """Return outcome, description and records of a test; an invalid one has no records.

        Raises:
            SystemExit: The budget is spent; the test was not run and does not count.
            RuntimeError: This is a process that the generator has forked.

        """
        if os.getpid() != self._process:  # where nobody would hear the answer
            raise RuntimeError("the executor only works in the process that the bench has started")
        with self._lock:
            if self._parent.has_spoken:  # unasked: it says so when the budget is spent
                self._parent.receive()
                self._refuse()
            seconds = self._clock.stop()
            points = pairs_of(getattr(the_test, "road_points", None))
            sent = None if points is None else points[:MOST_POINTS].tolist()
            message = self._parent.ask({"kind": "test", "road_points": sent, "seconds": seconds})
            if message.get("over"):
                self._clock.start()
                self._refuse()
            answer = self._answer = Answer(**message)
            self._test, self._clock.is_held = the_test, True
            try:
                result: tuple[str, str, Any] = super().execute_test(the_test)  # type: ignore[misc]
            finally:
                self._test, self._clock.is_held = None, False
                self._clock.spent = answer.spent
                self._clock.start()
            self._correct("test_generation_real_times", seconds)
            if answer.is_executed:
                self._correct("test_execution_real_times", self._seconds_per_test)
            return result

    def validate_test(self, the_test: Any) -> tuple[bool, str]:
        """Return whether a test is valid, and if not, why; costs nothing."""
        if self._answer is not None and the_test is self._test:
            invalid = not self._answer.is_executed
            return not invalid, self._answer.description if invalid else ""
        verdict: tuple[bool, str] = super().validate_test(the_test)  # type: ignore[misc]
        return verdict

    def get_elapsed_time(self) -> float:
        """Return virtual s; the pipeline of 2021 asks for them."""
        return self._clock.budget - self._clock.remaining()

    def is_over(self) -> bool:
        """Return whether nothing remains of the budget."""
        return self._clock.remaining() == 0.0

    def store_test(self, the_test: Any) -> None:
        """Do nothing: the bench keeps the tests."""

    def _execute(self, _: Any) -> tuple[str, str, list[Any]]:
        """What the bench has answered; some generators note the name of the latest folder."""
        assert self._answer is not None
        folder = self._drives / f"sim_{next(self._numbers):05d}"
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
        size = len(self._record._fields)  # one less in 2021
        records = [
            self._record(*(tuple(v) if isinstance(v, list) else v for v in row[:size]))
            for row in self._answer.records
        ]
        return self._answer.outcome, self._answer.description, records

    def _close(self) -> None:
        """Do nothing: the bench ends the process."""

    def _correct(self, name: str, seconds: float) -> None:
        """Puts the bench's time for the last test in the place of the pipeline's."""
        if times := getattr(self.stats, name, None):
            times[-1] = seconds

    def _refuse(self) -> NoReturn:
        self._clock.spent = self._clock.budget
        self.timeout_forced = True
        raise SystemExit(OVER)
