"""The virtual time in which a generator's budget is spent."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

_ROUNDING: Final = 1e-12
"""Share of the budget that rounding may leave of it."""


class VirtualClock:
    """What is spent of a budget: what the bench says, which also decides whether a test still fits.

    Where computing counts, the time since the bench's last answer comes on top, until the next test
    is handed over.

    Args:
        budget: virtual s.
        counts_computing: whether the time that the generator itself takes counts.
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
        """Virtual s."""
        if self._since is None or not self._counts_computing:
            return self._settled
        return self._settled + (self._timer() - self._since)

    @property
    def remaining(self) -> float:
        """Virtual s, at least 0."""
        return 0.0 if self._ended else max(0.0, self.budget - self.spent)

    @property
    def is_over(self) -> bool:
        """Whether nothing remains.

        A remainder in which no test fits is something: the next test then ends the run.
        """
        return self.remaining <= _ROUNDING * self.budget

    def start(self) -> None:
        """Let the generator's time count from now on."""
        self._since = self._timer()

    def stop(self) -> None:
        """Let the time stand still while a test is executed."""
        self._settled = self.spent
        self._since = None

    def settle(self, spent: float) -> None:
        """Take what the bench says is spent, and start."""
        self._settled = spent
        self.start()

    def end(self) -> None:
        """Leave nothing of the budget."""
        self._ended = True
