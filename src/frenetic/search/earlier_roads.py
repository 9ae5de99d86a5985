"""Roads of earlier campaigns that a search drives again."""

from __future__ import annotations

import math

import numpy as np

from frenetic.search.approach import lower_squares
from frenetic.search.archive import Archive, critical_places
from frenetic.search.parents import NEAR_MISS_WORTH
from frenetic.search.records import Candidate, Evaluation

# The values are our choice.
_ASSUMED_DRIVES = 2.0  # earlier roads with which the count begins, each with a new failure
_LEAST_SHARE = 0.5  # least share of earlier roads among the roads of the random phase


class EarlierRoads:
    """Roads of earlier campaigns that wait to be driven again.

    Severe roads that are unlike the roads before them come first. Earlier results order the roads,
    but do not count as results.
    """

    def __init__(self) -> None:
        self._archive = Archive()
        self._waiting = 0  # number of roads that were not proposed
        self._driven, self._novelty = 0, 0.0  # roads driven again, and the sum of their novelty

    def __len__(self) -> int:
        """Return the number of roads that were not proposed."""
        return self._waiting

    @property
    def longest(self) -> int:
        """Number of values of the longest road; 0 without a road."""
        return max((len(road.curvatures) for road in self._archive.candidates), default=0)

    def add(self, evaluation: Evaluation, fitness: float) -> None:
        """Add the road of an earlier drive."""
        candidate = evaluation.candidate
        worst = critical_places(evaluation, candidate, fitness)[0]
        # Not as a failure: `squares` shall hold differences from proposed roads, see `pop`.
        self._archive.add(candidate, worst._replace(has_failed=False))
        self._waiting += 1

    def share(self, *, is_random_phase: bool) -> float:
        """Return the share of earlier roads among the next roads, by the new failures on them."""
        share = (self._novelty + _ASSUMED_DRIVES) / (self._driven + _ASSUMED_DRIVES)
        return max(share, _LEAST_SHARE) if is_random_phase else share

    def learn(self, novelty: float) -> None:
        """Learn how new the failure on an earlier road was, 0 to 1; 0 if it passed."""
        self._driven += 1
        self._novelty += novelty

    def pop(self) -> Candidate:
        """Return the best road that was not proposed: severe, and unlike the proposed roads."""
        places, squares = self._archive.places, self._archive.squares
        worth = np.minimum(-places["fitness"], NEAR_MISS_WORTH)
        worth = worth + np.sqrt(squares) - places["cost"]
        row = int(np.argmax(worth))
        places["cost"][row] = math.inf  # never again
        self._waiting -= 1
        vectors = self._archive.vectors
        lower_squares(squares, places["side"], vectors, int(places["side"][row]), vectors[row])
        return self._archive.candidates[row]
