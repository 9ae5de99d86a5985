"""Stand-in for the pipeline's executors, for a generator outside a clone of the pipeline.

`frenetic.plugins.bench.host` derives the executor whose tests the bench executes.
"""

from __future__ import annotations

from typing import Any


class PipelineBudget:
    """The time budget; the host replaces the methods that return the time left."""

    def __init__(self, time_budget: float) -> None:
        self.time_budget = time_budget

    def get_remaining_real_time(self) -> float:
        """Return the virtual time left, in s."""
        return self.time_budget

    def get_remaining_time(self) -> dict[str, float]:
        """Return name of the budget -> virtual time left, in s."""
        return {"time-budget": self.get_remaining_real_time()}

    def is_over(self) -> bool:
        """Return whether the budget is spent."""
        return self.get_remaining_real_time() == 0.0


class AbstractTestExecutor:
    """Base of an executor; a subclass has `validate_test` and `_execute`.

    Args:
        result_folder: folder into which a generator may write.
        map_size: side of the square map, in m.
        time_budget: time budget, in s.

    """

    road_visualizer = None
    timeout_forced = False

    def __init__(self, result_folder: str, map_size: float, time_budget: float) -> None:
        self.result_folder = result_folder
        self.map_size = map_size
        self.time_budget = PipelineBudget(time_budget)

    def execute_test(self, the_test: Any) -> tuple[str, str, list[Any]]:
        """Return outcome, description and records of a test; an invalid one has no records."""
        is_valid, description = self.validate_test(the_test)  # type: ignore[attr-defined]
        if hasattr(the_test, "set_validity"):
            the_test.set_validity(is_valid, description)
        if not is_valid:
            return "INVALID", description, []
        outcome, description, records = self._execute(the_test)  # type: ignore[attr-defined]
        the_test.test_outcome, the_test.description = outcome, description
        the_test.execution_data = records
        return outcome, description, records

    def get_remaining_time(self) -> Any:
        """Return what `PipelineBudget.get_remaining_time` returns."""
        return self.time_budget.get_remaining_time()

    def is_force_timeout(self) -> bool:
        """Return whether the run has ended since the budget was spent."""
        return self.timeout_forced
