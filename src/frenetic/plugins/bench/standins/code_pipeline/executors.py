"""The executor of a lone generator; `frenetic.plugins.bench.host` puts the bench behind it."""

from __future__ import annotations

from typing import Any


class PipelineBudget:
    """The time left, in virtual s."""

    def __init__(self, time_budget: float) -> None:
        self.time_budget = time_budget

    def get_remaining_real_time(self) -> float:
        """Return s."""
        return self.time_budget

    def get_remaining_time(self) -> dict[str, float]:
        """Return s by the budget's name."""
        return {"time-budget": self.get_remaining_real_time()}

    def is_over(self) -> bool:
        """Return whether nothing remains."""
        return self.get_remaining_real_time() == 0.0


class AbstractTestExecutor:
    """Validates tests and has them executed.

    Args:
        result_folder: where a generator may write.
        map_size: m, side of the square map.
        time_budget: s.

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
        """Return s of the budget, as its `get_remaining_time` has them."""
        return self.time_budget.get_remaining_time()

    def is_force_timeout(self) -> bool:
        """Return whether the budget's end has ended the run."""
        return self.timeout_forced
