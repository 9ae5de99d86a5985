"""Drives that a twin is to follow: their offset and speed at fixed positions along the road."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, TypeVar

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.oracle.drive import Drive
from frenetic.oracle.drive_assessment import Assessment
from frenetic.road import Road

T = TypeVar("T")

GRID: Final = 2.0
"""Distance along the road between two positions at which drives are compared, in m."""
MIN_POSITIONS: Final = 4
"""Fewest positions of a drive that can be compared; our choice."""
_STRESSED_POSITIONS: Final = 15  # up to the largest offset, which weigh more: 30 m, our choice
_MIN_RUNS: Final = 5  # with which runs count as independent, rather than roads; our choice


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedDrive:
    """A drive that a twin is to follow."""

    road: Road
    states: FloatArray
    """Offsets left of the ego lane's centre in m and speeds in m/s every `GRID`, (2, n)."""
    conditions: Mapping[str, int | float] = field(default_factory=dict)
    failed: bool = False
    run: str = ""
    """Name of the run that drove it, such as one campaign."""

    def until(self, offset: float) -> RecordedDrive:
        """Return the drive up to the first position where the car is further off than this, in m.

        At least `MIN_POSITIONS` positions stay.
        """
        beyond = np.flatnonzero(np.abs(self.states[0]) > offset)
        end = max(int(beyond[0]) + 1, MIN_POSITIONS) if len(beyond) else None
        return replace(self, states=self.states[:, :end])

    @cached_property
    def weight_roots(self) -> FloatArray:
        """Square roots of the positions' weights, (n,); they multiply differences.

        Half of the weight is spread evenly over all positions. The other half is spread over the 15
        positions up to the largest offset, or over fewer if it comes sooner. The weights of offset
        and speed together add up to 1.
        """
        n = self.states.shape[1]
        end = int(np.argmax(np.abs(self.states[0]))) + 1
        stressed = min(end, _STRESSED_POSITIONS)
        shares = np.full(n, 1.0 / n)
        shares[end - stressed : end] += 1.0 / stressed
        # The shares add up to 2 for the offset, and to 2 for the speed.
        roots: FloatArray = np.sqrt(0.25 * shares)
        return roots


def on_grid(distance: FloatArray, offset: FloatArray, speed: FloatArray) -> FloatArray:
    """Return offset and speed every `GRID` m from the road's start, (2, n)."""
    # Where the car went backwards, only records of a new furthest distance count.
    furthest = np.maximum.accumulate(distance)
    is_new = np.concatenate(([True], np.diff(furthest) > 0.0))
    positions = GRID * np.arange(math.floor(furthest[-1] / GRID) + 1)
    return np.array(
        [np.interp(positions, furthest[is_new], column[is_new]) for column in (offset, speed)]
    )


def states_of(drive: Drive, assessment: Assessment) -> FloatArray:
    """Return offset and speed every `GRID` m of a drive that was assessed, (2, n)."""
    return on_grid(
        assessment.distance,
        assessment.lateral_offset,
        drive.trajectory.speed[: len(assessment.distance)],
    )


def thinned(drives: Sequence[T], count: int) -> Sequence[T]:
    """Return evenly spaced drives: ``count`` to nearly twice as many, or all if they are fewer."""
    return drives[:: max(len(drives) // count, 1)]


def group_labels(drives: Sequence[RecordedDrive]) -> IntArray:
    """Return each drive's independent group, (n,): its run, or the drive itself if runs are few."""
    runs, labels = np.unique([drive.run for drive in drives], return_inverse=True)
    return labels.astype(np.int64) if len(runs) >= _MIN_RUNS else np.arange(len(drives))
