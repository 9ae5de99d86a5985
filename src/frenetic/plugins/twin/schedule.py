"""The drives of a search after which its twin is fitted, and those to which it is fitted."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

# Our choice:
FIRST_FIT_DRIVES: Final = 20
"""Number of drives after which the first fit is made."""
_DRIVES_GROWTH: Final = 1.5  # factor of the number of drives from one fit to the next
_DRIVES_OF_FIT: Final = 40  # that a fit looks at, half of them the latest ones


class FitSchedule:
    """Says when to fit, and to which drives."""

    def __init__(self) -> None:
        self._next_fit = FIRST_FIT_DRIVES  # number of drives

    def is_due(self, drives: int) -> bool:
        """Return whether to fit after this number of drives; ask after each drive."""
        if drives < self._next_fit:
            return False
        self._next_fit = math.ceil(_DRIVES_GROWTH * self._next_fit)
        return True

    @staticmethod
    def chosen(drives: int) -> list[int]:
        """Return the indices of the latest drives, and of as many spread over the earlier ones."""
        half = _DRIVES_OF_FIT // 2
        first_latest = max(drives - half, 0)
        spread = np.linspace(0, first_latest - 1, min(half, first_latest)).astype(int)
        return [*spread.tolist(), *range(first_latest, drives)]
