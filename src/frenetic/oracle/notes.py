"""What a driver was told in a drive, and what it noted then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray

OBSERVED: Final[Mapping[str, str]] = MappingProxyType(
    {
        "time": "s",
        "lateral_offset": "m",
        "heading_error": "rad",
        "speed": "m/s",
        "yaw_rate": "rad/s",
        "steering": "rad",
        "speed_limit": "m/s",
    }
)
"""Attribute of an observation that is kept -> its unit, in the order of `DriverNotes.observed`; the
time comes first."""


def _no_rows(width: int) -> FloatArray:
    return np.empty((0, width))


@dataclass(frozen=True, eq=False)
class DriverNotes:
    """What a driver was told at each of its decisions, and what it noted and planned then.

    The driver was told what its sensors said, with the errors of conditions such as noise.
    """

    observed: FloatArray = field(default_factory=lambda: _no_rows(len(OBSERVED)))
    """Values of `OBSERVED`, (n, 7) in SI units, for n decisions."""
    names: tuple[str, ...] = ()
    """Names of the numbers that the driver noted."""
    noted: FloatArray = field(default_factory=lambda: _no_rows(0))
    """The numbers, (n, k); NaN where a number was not noted."""
    plan_lengths: tuple[int, ...] = ()
    """Number of points of each decision's plan; empty if the driver never showed one."""
    plan_points: FloatArray = field(default_factory=lambda: _no_rows(2))
    """Points of all plans, one plan after the other, (m, 2) in m in the frame of the car: x ahead,
    y to the left."""

    def at(self, times: FloatArray) -> FloatArray:
        """Return the rows of `observed` and `noted` that held at some times, (len(times), 7 + k).

        A decision holds until the next. Times before the first decision have its row.
        """
        rows = np.hstack([self.observed, self.noted])
        if not len(rows):
            return np.full((len(times), rows.shape[1]), np.nan)
        decisions = np.searchsorted(self.observed[:, 0], times + _ROUNDING, side="right") - 1
        return rows[np.maximum(decisions, 0)]

    def plans(self) -> list[tuple[float, FloatArray]]:
        """Return time, in s, and points, (m, 2) in m in the car's frame, of each shown plan."""
        ends = np.cumsum(self.plan_lengths, dtype=int)
        return [
            (float(row[0]), self.plan_points[end - length : end])
            for row, length, end in zip(self.observed, self.plan_lengths, ends, strict=False)
            if length
        ]


_ROUNDING: Final = 1e-6  # [s] by which the time of a record may be too early
