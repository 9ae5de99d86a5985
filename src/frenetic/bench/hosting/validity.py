"""The rules of road tests, imported when a generator first needs them."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np


@cache
def validity() -> ModuleType:
    """Return the module `frenetic.road.validity`.

    Numba, which it imports, takes longer than all the rest of the process's start. A generator that
    brings a package called `frenetic` has it imported before its own.
    """
    from frenetic.road import validity  # numba takes its time

    return validity


def road_points_of(the_test: Any) -> list[list[float]] | None:
    """Return a test's road points, x, y in m; None if they are no pairs of finite numbers."""
    try:
        points = np.array(the_test.road_points, dtype=np.float64)
    except (AttributeError, TypeError, ValueError, OverflowError):
        return None
    if points.shape == (0,):
        return []
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        return None
    rows: list[list[float]] = points.tolist()
    return rows


def overlaps_not(polygon: Any) -> bool:
    """Return whether a road does not overlap itself: the pipeline's `RoadPolygon.is_valid`.

    It gives the same answer as the pipeline's own, which takes up to 5 s.
    """
    edges = polygon.road_points.left, polygon.road_points.right
    left, right = (np.array([place[:2] for place in edge], dtype=np.float64) for edge in edges)
    stands = (np.diff(0.5 * (left + right), axis=0) == 0.0).all(axis=1).any()
    return bool(not stands and not validity().overlaps_itself(left, right))
