"""The choice of parents: which places of the archive are varied."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.search.archive import FAR, Archive

# All values are ours.
_POOL_AGE = 20  # drives after which the pool is chosen anew
_RECENT = 1500  # drives from whose severities the threshold is taken
_NEAR_QUANTILE = 0.2  # of these severities, up to which a drive came near failing
_CLOSEST_QUANTILE = 0.03  # of these severities, in its place while no failure is known
_LEAST_POOL = 5  # drives in the pool while no failure is known
_NEAR_MISS_MOOBD = -0.3  # [m], below which a drive came near failing, whatever the driver
_TOURNAMENT = 24  # places of the pool of which the best one is taken
_FAILURE_WORTH = 3.0  # of a place where the car failed
NEAR_MISS_WORTH = 1.5
"""Largest worth of the severity of a place where the car did not fail."""


class ParentPool:
    """The places that may become parents: failures, and places where the car came near failing.

    Args:
        archive: All places.
        rng: Draws the places of a tournament.
        failures_first: Whether a near miss becomes a parent only where no failure stands against
            it.

    """

    def __init__(self, archive: Archive, rng: np.random.Generator, *, failures_first: bool) -> None:
        self._archive = archive
        self._rng = rng
        self._failure_worth = _FAILURE_WORTH + FAR if failures_first else _FAILURE_WORTH
        self._severities: list[float] = []
        self.lowest = math.inf
        """Lowest severity of a drive."""
        self.is_moobd = True
        """Whether severities are MOOBDs, in m."""
        self.rows: npt.NDArray[np.int64] = np.empty(0, dtype=np.int64)
        """Rows of the archive, (n,)."""
        self._end = 0  # number of drives after which the rows are too old
        self._origin, self._spread = 0.0, 1.0  # of the severities

    @property
    def drives(self) -> int:
        """Number of drives with a severity."""
        return len(self._severities)

    def learn(self, severity: float, *, is_moobd: bool) -> None:
        """Take in the severity of a drive."""
        self._severities.append(severity)
        self.lowest = min(self.lowest, severity)
        self.is_moobd = is_moobd

    def refresh(self) -> None:
        """Choose the rows anew if they are too old."""
        if self.drives < self._end:
            return
        self._end = self.drives + _POOL_AGE
        recent = np.array(self._severities[-_RECENT:])
        near, middle = (float(q) for q in np.quantile(recent, (_NEAR_QUANTILE, 0.5)))
        if not self.is_moobd:
            self._origin, self._spread = near, max(middle - near, 1e-9)
        if not self._archive.has_failures:
            share = max(_CLOSEST_QUANTILE, min(_LEAST_POOL / len(recent), 1.0))
            threshold = float(np.quantile(recent, share))
        else:
            threshold = max(near, _NEAR_MISS_MOOBD) if self.is_moobd else near
        places = self._archive.places
        self.rows = np.flatnonzero(places["has_failed"] | (places["severity"] <= threshold))

    def draw_mates(
        self, is_needed: npt.NDArray[np.bool_], room: int
    ) -> tuple[FloatArray, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Draw a place for each of k children, whose road is filled in where it is needed.

        Return curvatures, (k, room) in 1/m, numbers of values, (k,), and indices of the values
        before the places, (k,).
        """
        others = np.zeros((len(is_needed), room))
        sizes, sites = (np.zeros(len(is_needed), dtype=np.int64) for _ in range(2))
        mates = self.rows[self._rng.integers(0, len(self.rows), len(is_needed))]
        for k in np.flatnonzero(is_needed).tolist():
            mate = self._archive.candidates[mates[k]]
            sizes[k] = len(mate.curvatures)
            others[k, : sizes[k]] = mate.curvatures
            sites[k] = int(self._archive.places["distance"][mates[k]] / mate.step)
        return others, sizes, sites

    def choose(self) -> int:
        """Return the row of the best of a few places: near failing, new, and seldom used."""
        rows = self.rows[self._rng.integers(0, len(self.rows), _TOURNAMENT)]
        places = self._archive.places[rows]
        worth = np.minimum((self._origin - places["severity"]) / self._spread, NEAR_MISS_WORTH)
        if self._archive.has_failures:
            worth += np.sqrt(self._archive.squares[rows])
        worth[places["has_failed"]] = self._failure_worth
        return int(rows[np.argmax(worth - places["cost"])])
