"""How much of the pipeline's time budget is spent."""

from __future__ import annotations

import logging

from frenetic.competition.pipeline import Executor, seconds
from frenetic.errors import describe_error

logger = logging.getLogger(__name__)

TIME_BUDGET = "time-budget"
"""Name of the one budget that covers generating and executing tests."""


class TimeBudget:
    """The share of an executor's time budget that is spent.

    The pipeline of 2022 can also run with two budgets, for generation and for execution; then the
    larger share counts, as either ends the search.

    Args:
        executor: Tells the remaining time.
        total: s, the whole time budget where the pipeline told it; by default the executor's
            ``time_budget.time_budget``, or else what remains now.

    """

    def __init__(self, executor: Executor, total: float | None = None) -> None:
        self._executor = executor
        self._share = 0.0
        self._is_readable = True
        self.totals = self._remaining()
        """s by name of each budget."""
        known = total, getattr(getattr(executor, "time_budget", None), "time_budget", None)
        for value in known:
            told = seconds(value).get(TIME_BUDGET, 0.0)
            if told > 0.0:
                self.totals = {TIME_BUDGET: told}
                break

    def share_spent(self) -> float:
        """Return 0..1; what it was before if the executor does not tell now."""
        remaining = self._remaining()
        shares = [
            (total - remaining[name]) / total
            for name, total in self.totals.items()
            if name in remaining and total > 0.0
        ]
        if shares:
            self._share = min(max(max(shares), 0.0), 1.0)
        return self._share

    def _remaining(self) -> dict[str, float]:
        try:
            remaining = seconds(self._executor.get_remaining_time())
            reason = "it tells no number"
        except Exception as error:
            remaining, reason = {}, describe_error(error)
        if not remaining and self._is_readable:
            logger.warning("the executor does not say what time remains: %s", reason)
        self._is_readable = bool(remaining)
        return remaining
