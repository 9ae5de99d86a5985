"""The virtual time in which a generator's budget is spent."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from frenetic.bench.hosting.offered.code_pipeline.executors import Shared

_ROUNDING: Final = 1e-12
"""Share of the budget that rounding may leave."""


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
