"""Road points as a generator gives them, which may be anything."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import islice
from typing import Any, Final

import numpy as np

MOST_VALUES: Final = 10
"""Values that are kept of a point that is an iterator; a point of more than 2 is none anyway."""


def snapshot(points: Any) -> Any:
    """Return a list of the points that no later change of theirs changes.

    What is nothing to make a list of is returned as it is: the validity check refuses it.
    """
    return [_copied(point) for point in points] if _is_list(points) else points


def number_pairs(points: Any) -> list[tuple[float, float]] | None:
    """Return road points as pairs of finite numbers; None if they are no list of such pairs."""
    if not _is_list(points):
        return None
    pairs = []
    for point in points:
        values = _numbers(point)
        if values is None or len(values) != 2 or values[0] is None or values[1] is None:
            return None
        pairs.append((values[0], values[1]))
    return pairs


def plain_points(points: Any) -> list[list[float | None] | None]:
    """Return road points as JSON can have them; what is no finite number or list becomes None."""
    return [_numbers(point) for point in points] if _is_list(points) else []


def _copied(point: Any) -> Any:
    if not _is_list(point) or isinstance(point, tuple):
        return point
    if isinstance(point, (list, np.ndarray)):
        return point.copy()
    return tuple(islice(point, MOST_VALUES))


def _numbers(point: Any) -> list[float | None] | None:
    if not _is_list(point):
        return None
    return [_number(value) for value in islice(point, MOST_VALUES)]


def _number(value: Any) -> float | None:
    if isinstance(value, (str, bytes)) or not hasattr(value, "__float__"):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _is_list(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Iterable) and not isinstance(value, (str, bytes))
