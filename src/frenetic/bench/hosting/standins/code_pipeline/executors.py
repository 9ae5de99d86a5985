"""The executor that a generator is given."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import Any, Final

from .tests_generation import RoadTest, TestGenerationStatistic
from .validation import TestValidator

_COUNTERS: Final = {"PASS": "test_passed", "FAIL": "test_failed"}


class Budget:
    """The time left; `frenetic.bench.hosting.executor` says how much that is.

    Args:
        time_budget: s.

    """

    generation_budget = None
    """There is one budget, for generating and executing together."""
    execution_budget = None

    def __init__(self, time_budget: float) -> None:
        self.time_budget = time_budget

    def get_remaining_real_time(self) -> float:
        """Return s."""
        return self.time_budget

    def get_remaining_time(self) -> dict[str, float]:
        """Return s by the budget's name."""
        return {"time-budget": self.get_remaining_real_time()}

    def can_run_a_test(self) -> bool:
        """Return whether anything remains; a test that needs more ends the run."""
        return self.get_remaining_real_time() > 0.0

    def is_over(self) -> bool:
        """Return whether nothing remains."""
        return not self.can_run_a_test()


class AbstractTestExecutor(ABC):
    """Validates tests, has them executed and counts their outcomes.

    Args:
        result_folder: where a generator may write.
        map_size: m, side of the square map.
        time_budget: s.

    """

    road_visualizer = None
    timeout_forced = False

    def __init__(self, result_folder: str, map_size: float, time_budget: float) -> None:
        self.result_folder = result_folder
        self.time_budget = Budget(time_budget)
        self.test_validator = TestValidator(map_size)
        self.stats = TestGenerationStatistic()
        self.start_generation_time = time.perf_counter()

    def execute_test(self, the_test: Any) -> tuple[str, str, list[Any]]:
        """Return outcome, description and records of a test; an invalid one has no records."""
        stats = self.stats
        stats.test_generation_real_times.append(time.perf_counter() - self.start_generation_time)
        stats.test_generated += 1
        is_valid, description = self.validate_test(the_test)
        if isinstance(the_test, RoadTest):
            the_test.set_validity(is_valid, description)
        outcome, records = "INVALID", list[Any]()
        if is_valid:
            stats.test_valid += 1
            outcome, description, records = self._execute(the_test)
            the_test.test_outcome = outcome
            the_test.description = description
            the_test.execution_data = records
            stats.test_execution_real_times.append(0.0)
            if records:
                stats.test_execution_simulation_times.append(records[-1].timer)
            counter = _COUNTERS.get(outcome, "test_in_error")
            setattr(stats, counter, getattr(stats, counter) + 1)
            stats.obes += description.startswith("Car drove out of the lane ")
        else:
            stats.test_invalid += 1
        self.start_generation_time = time.perf_counter()
        return outcome, description, records

    def validate_test(self, the_test: Any) -> tuple[bool, str]:
        """Return whether a test is valid, and if not, why; costs nothing."""
        return self.test_validator.validate_test(the_test)

    def is_over(self) -> bool:
        """Return whether nothing remains of the budget."""
        return self.time_budget.is_over()

    def get_remaining_time(self) -> Any:
        """Return s of the budget, as its `get_remaining_time` has them."""
        return self.time_budget.get_remaining_time()

    def get_stats(self) -> TestGenerationStatistic:
        """Return the counts so far."""
        return self.stats

    def is_force_timeout(self) -> bool:
        """Return whether the budget's end has ended the run."""
        return self.timeout_forced

    def close(self) -> None:
        """Release what the executor holds."""
        self._close()

    @abstractmethod
    def _execute(self, the_test: Any) -> tuple[str, str, list[Any]]:
        """Execute a valid test."""

    @abstractmethod
    def _close(self) -> None:
        """Release what the executor holds."""
