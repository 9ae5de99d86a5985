"""The choice of operators, by the new failures that each has brought."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.search.variation import FAILURE_OPERATOR_COUNT, OPERATORS

# The values are our choice.
_POWER = 2.5  # power of an operator's share of new failures that is its chance
_ASSUMED_CHILDREN = 6.0  # children with which the count of each operator begins
_ASSUMED_FAILURES = 1.0  # new failures among these children


class OperatorChoice:
    """Draws operators: the more new failures one has brought, the more often.

    Parents that failed (``parent_failed=1``) and others (0) are counted apart.
    """

    def __init__(self) -> None:
        # Children and sums of their novelty, (2, operators), by `parent_failed` and operator.
        self._used = np.zeros((2, len(OPERATORS)))
        self._novelty = np.zeros((2, len(OPERATORS)))

    def learn(self, operator: int, novelty: float, *, parent_failed: int) -> None:
        """Learn how new the failure of a child of an operator was, 0 to 1; 0 if it passed."""
        self._used[parent_failed, operator] += 1.0
        self._novelty[parent_failed, operator] += novelty

    def draw(
        self, rng: np.random.Generator, count: int, *, parent_failed: int
    ) -> npt.NDArray[np.int64]:
        """Return the numbers of drawn operators, (count,)."""
        running_shares = self._running_shares(parent_failed)
        return np.searchsorted(running_shares, rng.random(count), side="right")

    def _running_shares(self, parent_failed: int) -> FloatArray:
        """Return the running sum of the chances of the operators, (k,), the last 1."""
        count = FAILURE_OPERATOR_COUNT if parent_failed else len(OPERATORS)
        novelty, used = self._novelty[parent_failed, :count], self._used[parent_failed, :count]
        successes = (novelty + _ASSUMED_FAILURES) / (used + _ASSUMED_CHILDREN)
        sums = np.cumsum(successes**_POWER)
        shares: FloatArray = sums / sums[-1]
        return shares
