"""Evenly spaced selections."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def evenly(number: int, most: int) -> npt.NDArray[np.int64]:
    """Indices of at most `most` evenly spaced items: the first, the last, and some between."""
    places = np.linspace(0, number - 1, min(number, most)).round()
    return np.unique(places.astype(np.int64))
