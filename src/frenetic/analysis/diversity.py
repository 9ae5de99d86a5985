"""Few, different failures out of many."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from frenetic.arrays import FloatArray
from frenetic.road import Road

SEGMENT: Final = 30.0
"""m of road before and after the place of a failure that describe it."""
_SPACING: Final = 2.0


def segment_profile(road: Road, place: float) -> FloatArray:
    """(31,) 1/m, curvature every 2 m from 30 m before to 30 m after ``place`` m along the road."""
    offsets = np.arange(-SEGMENT, SEGMENT + 0.5 * _SPACING, _SPACING)
    return road.curvature_at(place + offsets)


def most_different(
    profiles: Sequence[FloatArray], severities: Sequence[float], number: int
) -> list[int]:
    """Indices of ``number`` failures, first the most severe, then whichever differs most from all.

    Farthest-first traversal (T. F. Gonzalez, 1985) with the root mean square difference of the
    profiles; equally different ones go to the more severe, then to the earlier.

    Args:
        profiles: (k,) each, all of one length, see `segment_profile`.
        severities: larger is worse, one per profile.
        number: how many to choose; fewer come back if there are fewer.
    """
    if not profiles or number < 1:
        return []
    stacked = np.asarray(profiles, dtype=np.float64)
    severity = np.asarray(severities, dtype=np.float64)
    chosen = [int(np.argmax(severity))]
    nearest = np.full(len(stacked), np.inf)
    while len(chosen) < min(number, len(stacked)):
        difference = np.sqrt(((stacked - stacked[chosen[-1]]) ** 2).mean(axis=1))
        nearest = np.minimum(nearest, difference)
        nearest[chosen] = -1.0
        chosen.append(int(np.lexsort((-severity, -nearest))[0]))
    return chosen
