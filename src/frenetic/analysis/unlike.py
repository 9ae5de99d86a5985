"""Numbers of failures that are unlike each other, at every radius.

Average linkage joins the failures of a campaign step by step, the least different first; sides of
the lane are not told apart. At a radius the clusters count whose root mean square difference from
each other is larger. Equal failures count once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.analysis.linkage import BATCH, different_rows, join_differences

MOST_LINKED: Final = BATCH
"""Largest number of a campaign's failures that are linked; of more failures, so many are taken
evenly."""


@dataclass(frozen=True, eq=False)
class UnlikeFailures:
    """Numbers of failures that are unlike each other, in one space."""

    different: int
    """Number of failures that are not equal to another."""
    joins: FloatArray
    """Root mean square differences at which two clusters are joined, (different - 1,) ascending."""

    @classmethod
    def of(cls, vectors: FloatArray) -> Self:
        """Return the numbers for failures with these (n, m) vectors; n may be 0."""
        if not len(vectors):
            return cls(0, np.empty(0))
        different, _ = different_rows(vectors)
        return cls(len(different), join_differences(different))

    def unlike_at(self, radius: float) -> int:
        """Return the number of failures that are unlike each other at a radius of at least 0."""
        return int(self.unlike_over(np.array([radius]))[0])

    def unlike_over(self, radii: FloatArray) -> IntArray:
        """Return the numbers of failures that are unlike each other at (k,) radii, (k,)."""
        counts: IntArray = self.different - np.searchsorted(self.joins, radii, side="right")
        return counts
