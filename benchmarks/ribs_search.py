"""MAP-Elites, CMA-MAE and CMA-ES of pyribs on our roads: peers for a bench.

    pip install ".[peers]"
    frenetic bench --strategy benchmarks/ribs_search.py:RibsSearch,algorithm=cma-mae \
        --strategy frenetic

pyribs (PyPI: ribs) is the library of quality diversity algorithms. Its archives and emitters run
here unchanged, on the terms of our own strategies: curvature values every 10 m; a road that does
not fit the map or is invalid is refused before it is driven and costs no simulation; the first 30
roads are random; every strategy gets the same evaluations. The defaults are pyribs' own, or the
best of a few lengths, batches and spreads, tried with `planner` on seeds 101 to 106.
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from typing import Any, Final

import numpy as np
from ribs.archives import GridArchive
from ribs.emitters import EvolutionStrategyEmitter, IsoLineEmitter

from frenetic._support.arrays import FloatArray
from frenetic.road import MAP_SIZE
from frenetic.search import Candidate, Evaluation, Origin
from frenetic.search.map_check import MapCheck
from frenetic.search.operator_names import RANDOM
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE
from frenetic.search.random_roads import STEP, RandomRoads
from frenetic.search.strategy import Ledger, Strategy, checked_options
from frenetic.search.variation import limit_changes
from frenetic.segments.bends import heading_range
from frenetic.segments.features import FEATURES, HEADING_BINS
from frenetic.segments.segment import REACH

ALGORITHMS: Final = ("map-elites", "cma-mae", "cma-es")
AXES: Final = ("direction_coverage", "max_curvature", "mean_speed", "mean_offset")
"""Features that span the archive, with the ranges and bins of `FEATURES`.

In place of the standard deviation of steering, a feature of the published map, stands the mean
speed: evaluations give strategies offsets and speeds, but no steering.
"""
REFUSED: Final = -1e3
"""Objective of a road that is not driven, in m."""
MOST_BATCHES: Final = 50
"""Number of fully refused batches after which a random road is proposed."""


class RibsSearch(Strategy):
    """A `Strategy` that lets pyribs choose the roads.

    The solution is a fixed number of curvature values, and the objective is the negative MOOBD. The
    behaviour is the features around the place where the car left its lane, or came nearest to
    leaving it.

    ``map-elites`` keeps the worst road of each cell, and moves it towards another road with noise;
    ``cma-mae`` adapts a distribution to roads that improve a soft archive; ``cma-es`` adapts a
    distribution to the objective alone, which is pure exploitation.

    Args:
        seed: a whole number of at least 0.
        map_size: side of the square map, in m.
        algorithm: an entry of `ALGORITHMS`.
        values: number of curvature values of a road.
        axes: features that span the archive, separated by commas.
        random_roads: number of random roads at the start.
        batch: number of roads between two updates; 0 for the usual number of CMA-ES.
        iso_sigma: standard deviation of MAP-Elites' noise, in 1/m.
        line_sigma: standard deviation of MAP-Elites' move towards another road, as a share.
        sigma: first standard deviation of CMA-ES, in 1/m.
        learning_rate: learning rate of the thresholds of CMA-MAE's archive, 0..1.
        threshold_min: objective from which CMA-MAE's archive takes roads, in m.
        max_change: largest change of the curvature from value to value, in 1/m. A solution that
            changes by more stays as it is for pyribs; the road that is driven keeps the change.
    """

    def __init__(
        self,
        *,
        seed: int,
        map_size: float = MAP_SIZE,
        algorithm: str = "map-elites",
        values: int = 29,
        axes: str = ",".join(AXES),
        random_roads: int = 30,
        batch: int = 0,
        iso_sigma: float = 0.01,
        line_sigma: float = 0.2,
        sigma: float = 0.02,
        learning_rate: float = 0.1,
        threshold_min: float = -2.0,
        max_change: float = MAX_CHANGE,
    ) -> None:
        self.options = checked_options(locals(), RibsSearch.__init__)
        if algorithm not in ALGORITHMS:
            raise ValueError(f"algorithm must be one of {', '.join(ALGORITHMS)}, got {algorithm!r}")
        self._axes = tuple(FEATURES[name] for name in axes.split(","))
        self._map_check = MapCheck(map_size, None)
        self._max_change = max_change
        self._roads = RandomRoads(
            map_size=map_size,
            length_jitter=0,
            usual_length=values,
            max_change=max_change,
            is_valid=self._map_check,
            max_redraws=100,
        )
        seeds = np.random.SeedSequence(seed).generate_state(3)
        self._rng = np.random.default_rng(seeds[0])
        self._algorithm = algorithm
        self._settings: dict[str, Any] = {
            "batch_size": batch or 4 + int(3.0 * math.log(values)),
            "bounds": [(-CURVATURE_BOUND, CURVATURE_BOUND)] * values,
            "seed": int(seeds[1]),
        }
        self._iso_line = iso_sigma, line_sigma
        self._sigma = sigma
        soft: dict[str, Any] = {"learning_rate": learning_rate, "threshold_min": threshold_min}
        self._archive = GridArchive(
            solution_dim=values,
            dims=[axis.bins for axis in self._axes],
            ranges=[(axis.low, axis.high) for axis in self._axes],
            seed=int(seeds[2]),
            **(soft if algorithm == "cma-mae" else {}),
        )
        self._emitter: Any = None
        self._first_roads = random_roads
        self._driven = 0
        self._best: tuple[float, FloatArray] | None = None
        self._ledger = Ledger()
        self._batch = _Batch(np.empty((0, values)), len(self._axes), max_change)
        self._waiting: deque[int] = deque()
        """Rows of the batch that are not proposed yet."""
        self._rows: dict[int, tuple[_Batch, int]] = {}
        """Id of an outstanding candidate -> its batch and row."""

    def keep_map_margin(self, map_margin: float) -> None:
        """Takes only roads for valid that keep so many m from the map's edge."""
        self._map_check.keep_map_margin(map_margin)

    def ask(self) -> Candidate:
        """Return the next road: random at first, and while results of a batch are missing."""
        if self._driven >= self._first_roads and not self._waiting and not self._rows:
            self._next_batch()
        if not self._waiting:
            return self._ledger.issue(self._roads.draw(self._rng), STEP, Origin(RANDOM))
        row = self._waiting.popleft()
        candidate = self._ledger.issue(self._batch.roads[row], STEP, Origin(self._algorithm))
        self._rows[candidate.id] = self._batch, row
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: the candidate is not outstanding, or MOOBD or budget share is not finite.
        """
        candidate = self._ledger.settle(evaluation)
        batch, row = self._rows.pop(candidate.id, (None, 0))
        if evaluation.outcome.is_driven and evaluation.fitness is not None:
            self._driven += 1
            objective, measures = -evaluation.fitness, self._behaviour(evaluation, candidate)
            if self._best is None or objective > self._best[0]:
                self._best = objective, candidate.curvatures
            if batch is None:
                self._archive.add_single(candidate.curvatures, objective, measures)
            else:
                batch.objective[row], batch.measures[row] = objective, measures
        if batch is not None and not self._waiting and not self._rows:
            self._learn(batch)

    def _next_batch(self) -> None:
        """Let the emitter draw batches until a batch has a road that may be driven."""
        if self._emitter is None:
            self._emitter = self._new_emitter()
        for _ in range(MOST_BATCHES):
            with warnings.catch_warnings():  # pyribs warns of tight bounds
                warnings.simplefilter("ignore", UserWarning)
                solutions = np.asarray(self._emitter.ask())
            self._batch = _Batch(solutions, len(self._axes), self._max_change)
            self._waiting.extend(
                row for row, road in enumerate(self._batch.roads) if self._map_check(road, STEP)
            )
            if self._waiting:
                return
            self._learn(self._batch)

    def _new_emitter(self) -> Any:
        if self._algorithm == "map-elites":
            iso_sigma, line_sigma = self._iso_line
            return IsoLineEmitter(
                self._archive,
                iso_sigma=iso_sigma,
                line_sigma=line_sigma,
                x0=self._best_road,
                **self._settings,
            )
        return EvolutionStrategyEmitter(
            self._archive,
            x0=self._best_road,
            sigma0=self._sigma,
            ranker="imp" if self._algorithm == "cma-mae" else "obj",
            selection_rule="mu",
            restart_rule="basic",
            **self._settings,
        )

    @property
    def _best_road(self) -> FloatArray:
        return np.zeros(self._archive.solution_dim) if self._best is None else self._best[1]

    def _learn(self, batch: _Batch) -> None:
        """Add the driven roads to the archive, and tell the emitter the results of all roads."""
        driven = np.flatnonzero(batch.objective > REFUSED)
        info = {
            "status": np.zeros(len(batch.objective), dtype=np.int32),
            "value": batch.objective.copy(),
        }
        if len(driven):
            added = self._archive.add(
                batch.roads[driven], batch.objective[driven], batch.measures[driven]
            )
            for name, values in info.items():
                values[driven] = added[name]
        if not self._archive.empty:
            self._emitter.tell(batch.solutions, batch.objective, batch.measures, info)

    def _behaviour(self, evaluation: Evaluation, candidate: Candidate) -> FloatArray:
        """Return the features around the place, as `frenetic.segments.features` defines them."""
        length = (len(candidate.curvatures) - 1) * STEP
        place = evaluation.place or 0.0
        start, end = max(place - REACH, 0.0), min(place + REACH, length)
        samples = np.arange(len(candidate.curvatures)) * STEP
        inner = samples[(samples > start) & (samples < end)]
        distances = np.concatenate([[start], inner, [end]])
        curvatures = np.interp(distances, samples, candidate.curvatures)
        features = {
            "max_curvature": float(np.abs(curvatures).max()),
            "direction_coverage": _direction_coverage(distances, curvatures),
        }
        if evaluation.trace is not None:
            trace = evaluation.trace
            inside = (trace.distance >= start) & (trace.distance <= end)
            inside[np.argmin(np.abs(trace.distance - place))] = True
            offset, speed = trace.lateral_offset[inside], trace.speed[inside]
            features |= {
                "mean_speed": float(speed.mean()),
                "std_speed": float(speed.std()),
                "mean_offset": float(offset.mean()),
                "extreme_offset": float(offset[np.argmax(np.abs(offset))]),
            }
        return np.array([features.get(axis.name, 0.0) for axis in self._axes])


class _Batch:
    """Roads that an emitter draws together, and their results."""

    def __init__(self, solutions: FloatArray, measures: int, max_change: float) -> None:
        self.solutions = solutions
        self.roads = solutions.copy()
        """Solutions with changes of at most `max_change`, in 1/m."""
        for road in self.roads:
            limit_changes(road, 0, max_change)
        self.objective = np.full(len(solutions), REFUSED)
        self.measures = np.zeros((len(solutions), measures))


def _direction_coverage(distances: FloatArray, curvatures: FloatArray) -> float:
    """Return the share of heading bins that a road covers."""
    width = 2.0 * math.pi / HEADING_BINS
    least, most = heading_range(distances, curvatures)
    first, last = math.ceil(least / width - 0.5), math.floor(most / width + 0.5)
    return min(last - first + 1, HEADING_BINS) / HEADING_BINS
