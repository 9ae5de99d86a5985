"""The map of a sweep: at which radius and speed limit a driver fails, and by how much it passes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.conditions.condition import SPEED
from frenetic.oracle.outcome import Outcome
from frenetic.search.records import Candidate

_DIGITS: Final = 3
"""Number of significant digits by which radii are alike; a sweep has as many."""


@dataclass(frozen=True, eq=False)
class SweepMap:
    """Failures and least margins of single bends, by radius and speed limit.

    Rows of the arrays are speed limits, columns are radii.
    """

    radii: FloatArray
    """Radii of the bends, (n,) in m, ascending."""
    speeds: FloatArray
    """Speed limits, (m,) in km/h, ascending."""
    drives: npt.NDArray[np.int64]
    """Number of drives, (m, n)."""
    failures: npt.NDArray[np.int64]
    """Number of failed drives, (m, n)."""
    moobd: FloatArray
    """Lowest MOOBD, (m, n) in m: how far the car's centre stayed inside its lane; NaN where nothing
    was measured."""
    worst_tests: npt.NDArray[np.int64]
    """Id of the test with the lowest MOOBD, (m, n); 0 where nothing was measured."""

    @property
    def share(self) -> FloatArray:
        """Share of the drives that failed, (m, n); NaN where nothing was driven."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.failures / np.where(self.drives, self.drives, np.nan))

    def as_json(self) -> dict[str, Any]:
        """Return the map as a JSON object with a list of cells."""
        return {
            "radii": self.radii.tolist(),
            "speeds": self.speeds.tolist(),
            "cells": [
                {
                    "radius": float(self.radii[j]),
                    "speed": float(self.speeds[i]),
                    "drives": int(self.drives[i, j]),
                    "failures": int(self.failures[i, j]),
                    "moobd": float(self.moobd[i, j]) if self.worst_tests[i, j] else None,
                    "worst_test": int(self.worst_tests[i, j]) or None,
                }
                for i in range(len(self.speeds))
                for j in range(len(self.radii))
                if self.drives[i, j]
            ],
        }


def sweep_map(tests: Iterable[Test]) -> SweepMap | None:
    """Return the map of a campaign of single bends, such as a sweep or a rerun of its tests.

    Args:
        tests: tests of the campaign, ``store.tests()``.

    Returns:
        The map; None if nothing was driven, or if a driven road is no single bend with a speed
        limit of its own.
    """
    driven: list[tuple[float, float, Test]] = []
    for test in tests:
        if not test.outcome.is_driven:
            continue
        if (bend := bend_of(test.candidate)) is None:
            return None
        driven.append((*bend, test))
    if not driven:
        return None
    radii, columns = np.unique([radius for radius, _, _ in driven], return_inverse=True)
    speeds, rows = np.unique([speed for _, speed, _ in driven], return_inverse=True)
    shape = len(speeds), len(radii)
    drives, failures = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    moobd, worst_tests = np.full(shape, np.nan), np.zeros(shape, np.int64)
    for (_, _, test), row, column in zip(driven, rows, columns, strict=True):
        drives[row, column] += 1
        failures[row, column] += test.outcome is Outcome.FAIL
        value = test.result.moobd
        if value is not None and not value >= moobd[row, column]:
            moobd[row, column], worst_tests[row, column] = value, test.id
    return SweepMap(radii, speeds, drives, failures, moobd, worst_tests)


def bend_of(candidate: Candidate) -> tuple[float, float] | None:
    """Return the radius, in m, and the speed limit, in km/h, of a single bend.

    Returns:
        None if the road is no single bend between straights, or has no speed limit of its own.
    """
    speed = candidate.conditions.get(SPEED)
    amounts = np.abs(candidate.curvatures)
    if speed is None or len(amounts) < 3 or amounts[0] or amounts[-1] or not amounts.any():
        return None
    peak = int(amounts.argmax())
    is_to_one_side = abs(candidate.curvatures.sum()) == amounts.sum()
    rises, falls = np.diff(amounts[: peak + 1]) >= 0.0, np.diff(amounts[peak:]) <= 0.0
    if not (is_to_one_side and rises.all() and falls.all()):
        return None
    return float(f"{1.0 / amounts[peak]:.{_DIGITS}g}"), float(speed)
