"""The largest change of a road's curvature from value to value, while a search runs."""

from __future__ import annotations

from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray

# The values are our choice.
_SHARP_SHARE = 0.5  # share of roads that may be sharper
_ROUNDING: Final = 1e-9  # [1/m] by which a change may exceed its limit


class ChangeLimit:
    """Lets roads bend faster while no road within the usual change fails.

    Roads within the usual change come first. If none of them has failed in the last drives, half of
    the roads may change by any amount within the bound, as the competition's rules allow; all may
    if only such roads have ever failed. The next failure within the usual change ends this.

    Args:
        limits: Bound and largest change of values, (2,) in 1/m; the change is overwritten.
        sharper_after: Drives without such a failure after which roads may bend faster.
    """

    def __init__(self, limits: FloatArray, sharper_after: int) -> None:
        self._limits = limits
        self._largest_change = 2.0 * float(limits[0])  # from one bound to the other
        self.usual_change = float(limits[1])
        """Largest change of usual roads, in 1/m."""
        self._sharper_after = sharper_after
        self._last_failure = 0  # drives up to the last failure within the usual change
        self.has_failed_within = False
        """Whether a road within the usual change has failed."""
        self.is_lifted = False
        """Whether the next road may be sharper."""

    def choose(self, rng: np.random.Generator, drives: int, *, has_failures: bool) -> None:
        """Set the limit for the next road.

        Args:
            rng: Generator that draws whether the road may be sharper.
            drives: Number of drives so far.
            has_failures: Whether any road has failed.
        """
        fails_only_if_sharp = has_failures and not self.has_failed_within
        self.is_lifted = self.has_lifted(drives) and (
            fails_only_if_sharp or rng.random() < _SHARP_SHARE
        )
        self._limits[1] = self._largest_change if self.is_lifted else self.usual_change

    def has_lifted(self, drives: int) -> bool:
        """Return whether sharper roads are tried after so many drives."""
        is_limited = self.usual_change < self._largest_change
        return is_limited and drives - self._last_failure >= self._sharper_after

    def learn_failure(self, curvatures: FloatArray, drives: int) -> None:
        """Learn that a road of these curvatures, (n,) in 1/m, failed in the last of the drives."""
        if largest_change(curvatures) <= self.usual_change + _ROUNDING:
            self.has_failed_within, self._last_failure = True, drives


def largest_change(curvatures: FloatArray) -> float:
    """Return the largest change of curvatures, (n,), from value to value, in 1/m.

    The value before the first counts as 0; without values, so does the change.
    """
    return float(np.abs(np.diff(curvatures, prepend=0.0)).max(initial=0.0))
