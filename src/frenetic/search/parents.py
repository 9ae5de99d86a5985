"""The choice of parents: the places of the archive from which children are made."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.search.archive import FAR, Archive

# The values are our choice.
_POOL_AGE = 20  # drives after which the pool is chosen anew; while no failure is known, 1
_RECENT_DRIVES = 1500  # last drives, from whose fitness the threshold follows
_NEAR_QUANTILE = 0.2  # quantile of these fitness values up to which a drive came near failing
_CLOSEST_QUANTILE = 0.03  # the same quantile while no failure is known
_YAWING_SHARE = 0.15  # share of parents chosen by yaw acceleration, while no failure is known
_MOST_YAWING = 5  # places of the largest yaw acceleration among which they are chosen
_MIN_POOL = 5  # least number of drives in the pool while no failure is known
_NEAR_MISS_MOOBD = -0.3  # [m] MOOBD below which a drive came near failing, whatever the driver
_TOURNAMENT_SIZE = 24  # places of the pool of which the best one is taken
_FAILURE_WORTH = 3.0  # worth of a place where the car failed
_MIN_SPREAD = 1e-9  # least scale of fitness values: equal values must not divide by 0
NEAR_MISS_WORTH = 1.5
"""Largest worth that its fitness gives a place where the car did not fail."""


class ParentPool:
    """The places that may become parents: failures, and places where the car came near failing.

    Args:
        archive: All places.
        rng: Generator that draws the places of a tournament.
        failures_first: Whether a near miss becomes a parent only if no failure is in its
            tournament.

    """

    def __init__(self, archive: Archive, rng: np.random.Generator, *, failures_first: bool) -> None:
        self._archive = archive
        self._rng = rng
        # A near miss is worth at most NEAR_MISS_WORTH + FAR.
        self._failure_worth = _FAILURE_WORTH + FAR if failures_first else _FAILURE_WORTH
        self._fitness_values: list[float] = []
        self.lowest = math.inf
        """Lowest fitness of a drive."""
        self.is_moobd = True
        """Whether fitness values are MOOBDs, in m."""
        self.rows: npt.NDArray[np.int64] = np.empty(0, dtype=np.int64)
        """Rows of the places in the archive, (n,)."""
        self._next_refresh = 0  # number of drives from which on the rows are too old
        # Fitness values are compared as (origin - fitness) / spread.
        self._origin, self._spread = 0.0, 1.0

    @property
    def drives(self) -> int:
        """Number of drives with a fitness."""
        return len(self._fitness_values)

    def learn(self, fitness: float, *, is_moobd: bool) -> None:
        """Remember the fitness of a drive."""
        self._fitness_values.append(fitness)
        self.lowest = min(self.lowest, fitness)
        self.is_moobd = is_moobd

    def progress(self, fitness: float | None) -> float:
        """Return how far a drive came towards failing, from 0 to 1, while no failure is known.

        It is the square of the share of drives so far that were further from failing. Once a
        failure is known, it is 0: then only new failures count.
        """
        if fitness is None or self._archive.has_failures:
            return 0.0
        return float((np.array(self._fitness_values) > fitness).mean()) ** 2

    def refresh(self) -> None:
        """Choose the rows anew if they are too old."""
        if self.drives < self._next_refresh:
            return
        self._next_refresh = self.drives + (_POOL_AGE if self._archive.has_failures else 1)
        recent = np.array(self._fitness_values[-_RECENT_DRIVES:])
        near, median = (float(q) for q in np.quantile(recent, (_NEAR_QUANTILE, 0.5)))
        if not self.is_moobd:
            self._origin, self._spread = near, max(median - near, _MIN_SPREAD)
        if not self._archive.has_failures:
            share = max(_CLOSEST_QUANTILE, min(_MIN_POOL / len(recent), 1.0))
            threshold = float(np.quantile(recent, share))
        else:
            threshold = max(near, _NEAR_MISS_MOOBD) if self.is_moobd else near
        places = self._archive.places
        self.rows = np.flatnonzero(places["has_failed"] | (places["fitness"] <= threshold))

    def draw_mates(
        self, is_needed: npt.NDArray[np.bool_], room: int
    ) -> tuple[FloatArray, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Draw another parent, a mate, for each of k children.

        Args:
            is_needed: Whether each child needs a mate, (k,); the rows of the others stay zeros.
            room: Largest number of values of a road.

        Returns:
            Curvatures of the mates, (k, room) in 1/m; their numbers of values, (k,); and the
            indices of the values before their places, (k,).
        """
        curvatures = np.zeros((len(is_needed), room))
        sizes, sites = (np.zeros(len(is_needed), dtype=np.int64) for _ in range(2))
        mates = self.rows[self._rng.integers(0, len(self.rows), len(is_needed))]
        for k in np.flatnonzero(is_needed).tolist():
            mate = self._archive.candidates[mates[k]]
            sizes[k] = len(mate.curvatures)
            curvatures[k, : sizes[k]] = mate.curvatures
            sites[k] = int(self._archive.places["distance"][mates[k]] / mate.step)
        return curvatures, sizes, sites

    def choose(self) -> int:
        """Return the row of the best of some random places of the pool.

        A place is better the nearer to failing, the further from the known failures and the less
        often used it is. While no failure is known, some parents are those whose car was turned
        most abruptly: it may be near sliding, although it is far from its lane's edge.
        """
        if not self._archive.has_failures and self._rng.random() < _YAWING_SHARE:
            all_places = self._archive.places
            most = np.argsort(-all_places["yaw_acceleration"], kind="stable")[:_MOST_YAWING]
            return int(most[np.argmin(all_places["cost"][most])])
        rows = self.rows[self._rng.integers(0, len(self.rows), _TOURNAMENT_SIZE)]
        places = self._archive.places[rows]
        worth = np.minimum((self._origin - places["fitness"]) / self._spread, NEAR_MISS_WORTH)
        if self._archive.has_failures:
            worth += np.sqrt(self._archive.squares[rows])
        worth[places["has_failed"]] = self._failure_worth
        return int(rows[np.argmax(worth - places["cost"])])
