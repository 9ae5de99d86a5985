"""The types of arrays of numbers, arrays that grow, and choices of evenly spaced indices."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""Float64 array; docstrings give the shape."""
IntArray = npt.NDArray[np.int64]
"""Int64 array; docstrings give the shape."""

_GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0
"""Number whose multiples modulo 1 spread evenly, however many there are."""


def with_room(rows: npt.NDArray[Any], used: int) -> npt.NDArray[Any]:
    """Return the rows with room for one more, doubled in number if all are used.

    Args:
        rows: array whose first axis grows.
        used: number of rows that are used.
    """
    while used >= len(rows):
        rows = np.concatenate((rows, np.empty_like(rows)))
    return rows


def evenly(number: int, most: int) -> npt.NDArray[np.int64]:
    """Return the indices of at most `most` of `number` items: the first, the last, evenly between.

    Args:
        number: number of items.
        most: largest number of indices.
    """
    indices = np.linspace(0, number - 1, min(number, most)).round()
    return np.unique(indices.astype(np.int64))


def spread(number: int, most: int) -> npt.NDArray[np.int64]:
    """Return the indices of at most `most` items; few of them change when items are added.

    Each item has a rank, a multiple of the golden ratio modulo 1, and the items of the lowest ranks
    are chosen. Ranks spread evenly over any part of the items, so the chosen items nearly do, too.

    Args:
        number: number of items.
        most: largest number of indices.
    """
    if number <= most:
        return np.arange(number)
    ranks = np.arange(number) * _GOLDEN_RATIO % 1.0
    return np.sort(np.argpartition(ranks, most)[:most])
