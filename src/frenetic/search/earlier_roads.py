"""Roads of earlier campaigns that a search drives again."""

from __future__ import annotations

import math

import numpy as np

from frenetic.search.approach import lower_squares
from frenetic.search.archive import Archive, critical_places
from frenetic.search.parents import NEAR_MISS_WORTH
from frenetic.search.records import Candidate, Evaluation

# Both values are ours.
_ASSUMED_DRIVES = 2.0  # that count as driven again, each with a new failure, before the first is
_LEAST_SHARE = 0.5  # of earlier roads among the first roads of a search


class EarlierRoads:
    """Roads of earlier campaigns, severe and unlike each other first; no result is believed."""

    def __init__(self) -> None:
        self._archive = Archive()
        self._undriven = 0  # roads that were not proposed
        self._driven, self._novelty = 0, 0.0

    def __len__(self) -> int:
        """Return the number of roads that were not proposed."""
        return self._undriven

    @property
    def longest(self) -> int:
        """Number of values of the longest road; 0 without a road."""
        return max((len(road.curvatures) for road in self._archive.candidates), default=0)

    def add(self, evaluation: Evaluation, severity: float) -> None:
        """Add the road of an earlier drive."""
        candidate = evaluation.candidate
        worst = critical_places(evaluation, candidate, severity)[0]
        self._archive.add(candidate, worst._replace(has_failed=False))
        self._undriven += 1

    def share(self, *, is_random_phase: bool) -> float:
        """Return the share of earlier roads among the next ones, by the new failures on them."""
        share = (self._novelty + _ASSUMED_DRIVES) / (self._driven + _ASSUMED_DRIVES)
        return max(share, _LEAST_SHARE) if is_random_phase else share

    def learn(self, novelty: float) -> None:
        """Take in how new the failure on an earlier road was, 0 to 1."""
        self._driven += 1
        self._novelty += novelty

    def pop(self) -> Candidate:
        """Return the best road that was not proposed: severe, and unlike the proposed ones."""
        places, squares = self._archive.places, self._archive.squares
        worth = np.minimum(-places["severity"], NEAR_MISS_WORTH)
        worth = worth + np.sqrt(squares) - places["cost"]
        row = int(np.argmax(worth))
        places["cost"][row] = math.inf
        self._undriven -= 1
        vectors = self._archive.vectors
        lower_squares(squares, places["side"], vectors, int(places["side"][row]), vectors[row])
        return self._archive.candidates[row]
