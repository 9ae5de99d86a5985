"""Made-up measures of two versions of a driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from frenetic.analysis.quality import DriveQuality
from frenetic.analysis.quality_differences import PairedQuality

ROADS = 40
USUAL: Mapping[str, float] = {
    "crossing": 0.0,
    "edge_distance": 0.6,
    "rms_offset": 0.2,
    "largest_offset": 0.5,
    "rms_steering_rate": 2.0,
    "rms_lateral_jerk": 0.8,
    "mean_speed": 70.0,
}
"""Measures of the old version."""


def drives(
    conditions: str = "", fails: int = 0, roads: int = ROADS, **shifts: float
) -> PairedQuality:
    """Return drives in which the new version's measures are shifted, alike on all roads but a bit.

    In bends of 50 to 100 m the measures are shifted twice as far.

    Args:
        conditions: conditions of the drives, in words.
        fails: number of further roads on which only the new version fails.
        roads: number of roads that both pass.
        shifts: name of a measure -> new minus old.
    """
    rng = np.random.default_rng(0)
    pairs = []
    for _ in range(roads):
        old = {name: value + 0.02 * rng.normal() for name, value in USUAL.items() if value}
        old["crossing"] = 0.0
        noise = {name: 0.001 * rng.normal() for name in old if name != "crossing"}
        new, bend = (
            {
                name: value + factor * shifts.get(name, 0.0) + noise.get(name, 0.0)
                for name, value in old.items()
            }
            for factor in (1.0, 2.0)
        )
        bins: tuple[Any, ...] = (
            {"speed": {5: old}, "radius": {1: old, 5: old}},
            {"speed": {5: new}, "radius": {1: bend, 5: new}},
        )
        pairs.append((DriveQuality(old, bins[0]), DriveQuality(new, bins[1])))
    return PairedQuality(conditions, [(False, False)] * roads + [(False, True)] * fails, pairs)
