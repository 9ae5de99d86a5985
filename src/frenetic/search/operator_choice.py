"""The choice of operators, by the new failures of each."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.search.variation import OF_FAILURES, OPERATORS

# All values are ours.
_POWER = 2.5  # of an operator's share of new failures
_ASSUMED_CHILDREN, _ASSUMED_FAILURES = 6.0, 1.0  # of each operator before its first child


class OperatorChoice:
    """Shares of the operators, counted apart for parents that failed and for others."""

    def __init__(self) -> None:
        # By whether the parent had failed, and operator:
        self._used = np.zeros((2, len(OPERATORS)))
        self._novelty = np.zeros((2, len(OPERATORS)))

    def learn(self, operator: int, novelty: float, *, parent_failed: int) -> None:
        """Take in how new the failure on a child's road was, 0 to 1."""
        self._used[parent_failed, operator] += 1.0
        self._novelty[parent_failed, operator] += novelty

    def draw(
        self, rng: np.random.Generator, count: int, *, parent_failed: int
    ) -> npt.NDArray[np.int64]:
        """Return the numbers of drawn operators, (count,)."""
        shares = self._running_shares(parent_failed)
        return np.searchsorted(shares, rng.random(count), side="right")

    def _running_shares(self, parent_failed: int) -> FloatArray:
        """Return the running sum of the shares of the operators, (k,), the last 1."""
        count = OF_FAILURES if parent_failed else len(OPERATORS)
        novelty, used = self._novelty[parent_failed, :count], self._used[parent_failed, :count]
        successes = (novelty + _ASSUMED_FAILURES) / (used + _ASSUMED_CHILDREN)
        sums = np.cumsum(successes**_POWER)
        shares: FloatArray = sums / sums[-1]
        return shares
