"""The array type of all packages, arrays that grow, and indices that spread evenly."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""Float64 array; docstrings give the shape."""

_GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


def with_room(rows: npt.NDArray[Any], used: int) -> npt.NDArray[Any]:
    """Return the rows, with more room if all are used."""
    while used >= len(rows):
        rows = np.concatenate((rows, np.empty_like(rows)))
    return rows


def evenly(number: int, most: int) -> npt.NDArray[np.int64]:
    """Return indices of at most `most` evenly spaced items: first, last, and some between."""
    places = np.linspace(0, number - 1, min(number, most)).round()
    return np.unique(places.astype(np.int64))


def spread(number: int, most: int) -> npt.NDArray[np.int64]:
    """Return indices of at most `most` items, nearly evenly spaced; few change as items grow.

    The items of the lowest rank are chosen. The ranks, multiples of the golden ratio modulo 1,
    spread evenly over any part of the items.
    """
    if number <= most:
        return np.arange(number)
    ranks = np.arange(number) * _GOLDEN_RATIO % 1.0
    return np.sort(np.argpartition(ranks, most)[:most])
