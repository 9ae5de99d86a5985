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


class SuccessShares:
    """Draws one of several ways to make a road: the more its roads have brought, the more often.

    The chance of a way is a power of the share of successes among its roads.

    Args:
        ways: Number of ways.
        roads: Number of roads with which the count of each way begins.
        successes: Successes among these roads.
        power: The power.
    """

    def __init__(self, ways: int, *, roads: float, successes: float, power: float) -> None:
        self._roads, self._successes = np.full(ways, roads), np.full(ways, successes)
        self._power = power

    def learn(self, way: int, success: float) -> None:
        """Learn what a road brought that was made in one of the ways, from 0 to 1."""
        self._roads[way] += 1.0
        self._successes[way] += success

    def draw(self, rng: np.random.Generator, count: int) -> npt.NDArray[np.int64]:
        """Return the numbers of drawn ways, (count,)."""
        sums = np.cumsum((self._successes / self._roads) ** self._power)
        running_shares: FloatArray = sums / sums[-1]  # the last is 1
        return np.searchsorted(running_shares, rng.random(count), side="right")


class OperatorChoice:
    """Draws operators: the more new failures one has brought, the more often.

    Parents that failed (``parent_failed=1``) and others (0) are counted apart.
    """

    def __init__(self) -> None:
        self._shares = [
            SuccessShares(count, roads=_ASSUMED_CHILDREN, successes=_ASSUMED_FAILURES, power=_POWER)
            for count in (len(OPERATORS), FAILURE_OPERATOR_COUNT)
        ]

    def learn(self, operator: int, success: float, *, parent_failed: int) -> None:
        """Learn what a child of an operator brought, from 0 to 1; 0 if nothing."""
        self._shares[parent_failed].learn(operator, success)

    def draw(
        self, rng: np.random.Generator, count: int, *, parent_failed: int
    ) -> npt.NDArray[np.int64]:
        """Return the numbers of drawn operators, (count,)."""
        return self._shares[parent_failed].draw(rng, count)
