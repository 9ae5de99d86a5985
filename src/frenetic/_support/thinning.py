"""Some of many."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def evenly(number: int, most: int) -> npt.NDArray[np.int64]:
    """Which of so many are kept if there is room for `most`: the first, the last, and between."""
    places = np.linspace(0, number - 1, min(number, most)).round()
    return np.unique(places.astype(np.int64))
