"""The rules of road tests, imported when a generator first needs them."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from frenetic._support.arrays import FloatArray


@cache
def validity() -> ModuleType:
    """Return the module `frenetic.road.validity`.

    Numba, which it imports, takes longer than all the rest of the process's start. A generator that
    brings a package called `frenetic` has it imported before its own.
    """
    from frenetic.road import validity  # numba takes its time

    return validity


def pairs_of(points: Any) -> FloatArray | None:
    """Return road points as (N, 2) m; None if they are no pairs of finite numbers."""
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    if array.shape == (0,):
        return np.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2 or not np.isfinite(array).all():
        return None
    return array


def overlaps_not(polygon: Any) -> bool:
    """Return whether a road does not overlap itself: the pipeline's `RoadPolygon.is_valid`.

    It gives the same answer as the pipeline's own, which takes up to 5 s.
    """
    edges = polygon.road_points.left, polygon.road_points.right
    left, right = (np.array([place[:2] for place in edge], dtype=np.float64) for edge in edges)
    stands = (np.diff(0.5 * (left + right), axis=0) == 0.0).all(axis=1).any()
    return bool(not stands and not validity().overlaps_itself(left, right))
