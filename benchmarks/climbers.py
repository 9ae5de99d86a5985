"""A (1+1) evolution strategy and CMA-ES on our roads: simple peers for a bench.

    pip install ".[peers]"
    frenetic bench --strategy benchmarks/climbers.py:OnePlusOne \
        --strategy benchmarks/climbers.py:CmaEs --strategy frenetic

They minimise the MOOBD, and begin anew where they no longer get on or the car has left its lane by
far. They drive on the terms of our own strategies: curvature values every 10 m within the bound and
the largest change of the paper; a road that does not fit the map or is invalid is refused before
it is driven and costs no simulation. The defaults are the best of a few lengths and spreads, see
`research/bench.md`.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Final

import numpy as np
from cmaes import CMA
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Count, Positive
from frenetic.road import MAP_SIZE
from frenetic.search import Candidate, Evaluation, Origin
from frenetic.search.map_check import MapCheck
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE
from frenetic.search.random_roads import STEP
from frenetic.search.strategy import Ledger, Strategy, checked_options
from frenetic.search.variation import limit_changes

Values = Annotated[int, Meta(ge=5, le=1000)]
MUTATED: Final = "mutated"
"""Operator of roads of the (1+1) evolution strategy."""
SAMPLED: Final = "sampled"
"""Operator of roads of CMA-ES."""
START: Final = 0.03
"""Largest absolute value of the roads from which a climber starts, in 1/m."""
MOST_REFUSED: Final = 200
"""Number of refused roads after which a climber begins anew."""
FAR_OUTSIDE: Final = -2.0
"""MOOBD below which the (1+1) evolution strategy begins anew, in m."""
GROWTH: Final = 1.5
"""Factor of the spread after a success; after a failure it falls by the fourth root (Rechenberg's
rule of one fifth)."""
REFUSED: Final = 3.0
"""MOOBD that CMA-ES is told of a refused road, in m: worse than any drive's."""


class Climber(Strategy):
    """What both climbers share: which of their samples may be driven, and as which roads."""

    def __init__(self, seed: int, map_size: float, max_change: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._ledger = Ledger()
        self._map_check = MapCheck(map_size, None)
        self._max_change = max_change
        self._begin()

    def keep_map_margin(self, map_margin: float) -> None:
        """Refuse roads that come nearer than `map_margin` m to the map's edge."""
        self._map_check.keep_map_margin(map_margin)

    @abstractmethod
    def _begin(self) -> None:
        """Begin anew from a random road."""

    @abstractmethod
    def _sample(self) -> FloatArray:
        """Return a sample, (n,) in 1/m, which may exceed the bound and the largest change."""

    def _learn_refusal(self, sample: FloatArray) -> None:
        """Learn that the road of a sample is refused."""

    def _drivable(self) -> tuple[FloatArray, FloatArray]:
        """Return a sample and its road, (n,) in 1/m each, which keeps bound and largest change.

        The road may be driven, unless the map and the rules refuse nearly all.
        """
        for drawn in range(1, 10 * MOST_REFUSED):
            sample = self._sample()
            road = np.clip(sample, -CURVATURE_BOUND, CURVATURE_BOUND)
            limit_changes(road, 0, self._max_change)
            if self._map_check(road, STEP):
                break
            self._learn_refusal(sample)
            if drawn % MOST_REFUSED == 0:
                self._begin()
        return sample, road


class OnePlusOne(Climber):
    """A `Strategy`: one parent, whose mutant replaces it where its MOOBD is not higher.

    Args:
        seed: a whole number of at least 0.
        map_size: side of the square map, in m.
        values: number of curvature values of a road.
        sigma: first standard deviation of a mutation, in 1/m.
        stall: mutants without success after which a new parent is drawn.
        max_change: largest change of the curvature from value to value, in 1/m.
    """

    def __init__(
        self,
        *,
        seed: int,
        map_size: float = MAP_SIZE,
        values: Values = 29,
        sigma: Positive = 0.02,
        stall: Count = 40,
        max_change: Positive = MAX_CHANGE,
    ) -> None:
        self.options = checked_options(locals(), OnePlusOne.__init__)
        self._values, self._first_sigma, self._stall = values, sigma, stall
        super().__init__(seed, map_size, max_change)

    def _begin(self) -> None:
        self._parent = self._rng.uniform(-START, START, self._values)
        self._least, self._sigma, self._failures = np.inf, self._first_sigma, 0

    def ask(self) -> Candidate:
        """Return a mutant of the parent that may be driven."""
        _, road = self._drivable()
        return self._ledger.issue(road, STEP, Origin(MUTATED))

    def _sample(self) -> FloatArray:
        mutant: FloatArray = self._parent + self._sigma * self._rng.normal(size=self._values)
        return mutant

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: the candidate is not outstanding, or MOOBD or budget share is not finite.
        """
        candidate, fitness = self._ledger.settle(evaluation), evaluation.fitness
        if fitness is None:
            return
        if fitness <= self._least:
            self._parent, self._least = candidate.curvatures, fitness
            self._sigma, self._failures = self._sigma * GROWTH, 0
        else:
            self._sigma, self._failures = self._sigma * GROWTH**-0.25, self._failures + 1
        if self._failures > self._stall or self._least < FAR_OUTSIDE:
            self._begin()


class CmaEs(Climber):
    """A `Strategy`: the CMA-ES of the package cmaes, begun anew where it has converged.

    Args:
        seed: a whole number of at least 0.
        map_size: side of the square map, in m.
        values: number of curvature values of a road.
        sigma: first standard deviation, in 1/m.
        max_change: largest change of the curvature from value to value, in 1/m.
    """

    def __init__(
        self,
        *,
        seed: int,
        map_size: float = MAP_SIZE,
        values: Values = 29,
        sigma: Positive = 0.02,
        max_change: Positive = MAX_CHANGE,
    ) -> None:
        self.options = checked_options(locals(), CmaEs.__init__)
        self._values, self._sigma = values, sigma
        self._samples: dict[int, FloatArray] = {}  # of outstanding candidates
        super().__init__(seed, map_size, max_change)

    def _begin(self) -> None:
        self._results: list[tuple[FloatArray, float]] = []
        self._cma = CMA(
            mean=self._rng.uniform(-START, START, self._values),
            sigma=self._sigma,
            bounds=np.tile([-CURVATURE_BOUND, CURVATURE_BOUND], (self._values, 1)),
            seed=int(self._rng.integers(2**31)),
        )

    def ask(self) -> Candidate:
        """Return a sampled road that may be driven."""
        sample, road = self._drivable()
        candidate = self._ledger.issue(road, STEP, Origin(SAMPLED))
        self._samples[candidate.id] = sample
        return candidate

    def _sample(self) -> FloatArray:
        sample: FloatArray = self._cma.ask()
        return sample

    def _learn_refusal(self, sample: FloatArray) -> None:
        self._learn(sample, REFUSED)

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: the candidate is not outstanding, or MOOBD or budget share is not finite.
        """
        candidate, fitness = self._ledger.settle(evaluation), evaluation.fitness
        self._learn(self._samples.pop(candidate.id), REFUSED if fitness is None else fitness)

    def _learn(self, sample: FloatArray, fitness: float) -> None:
        """Tell CMA-ES a population of results when it is complete."""
        self._results.append((sample, fitness))
        if len(self._results) == self._cma.population_size:
            self._cma.tell(self._results)
            self._results = []
            if self._cma.should_stop():
                self._begin()
