"""Distinct failures of `frenetic` if each road has a step of its own, against 10 m for all.

    python benchmarks/own_step.py [--simulations 200 1000] [--seeds 101-106] [--steps 5 15]

A random road draws the distance between its curvature values from the range of ``--steps``; it is
as long as usual. A child has its parent's step; every fifth is also stretched, by a factor of 0.8
to 1.25. All else is `frenetic`, ordered as with ``--seed``, in the embedded simulator. The table
holds medians, and the values of all seeds.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np

from frenetic.analysis.failures import distinct_failures
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Driver, Planner
from frenetic.road import MAP_SIZE
from frenetic.search import Candidate, Frenetic
from frenetic.search.random_search import LENGTH_JITTER, MAX_LENGTH, STEP, RandomRoads
from frenetic.simulators import EmbeddedSimulator

LONGEST: Final = 1.45 * MAP_SIZE
"""Usual length of a road, in m."""
STRETCHED: Final = 0.2
"""Share of the children that get another step."""
DRIVERS: Final[tuple[tuple[str, Driver], ...]] = (
    ("`planner`", Planner()),
    ("`lateral_acceleration=7`", Planner(lateral_acceleration=7.0)),
)


class OwnStep(Frenetic):
    """`Frenetic` with a step of its own for each road, from `low` to `high` m."""

    def __init__(self, *, seed: int, low: float, high: float) -> None:
        super().__init__(seed=seed, max_length=int(LONGEST / low))
        self._low, self._high = low, high
        self._room = np.empty(int(LONGEST / low) + round(LENGTH_JITTER * STEP / low) + 6)

    def _random_road(self) -> Candidate:
        with self._step(float(self._rng.uniform(self._low, self._high))):
            return super()._random_road()

    def _child_of(self, row: int) -> Candidate | None:
        distances, old = self._archive.places["distance"], self._archive.candidates[row].step
        step = old
        if self._rng.random() < STRETCHED:
            step = min(max(old * self._rng.uniform(0.8, 1.25), self._low), self._high)
        distance = distances[row]
        distances[row] = distance * step / old
        try:
            with self._step(step):
                return super()._child_of(row)
        finally:
            distances[row] = distance

    @contextmanager
    def _step(self, step: float) -> Iterator[None]:
        """Makes roads with another step meanwhile."""
        roads = self._roads
        self._usual_length = int(LONGEST / step)
        jitter = round(LENGTH_JITTER * STEP / step)
        self._roads = RandomRoads(
            map_size=(self._usual_length + 0.5) * step,
            step=step,
            length_jitter=jitter,
            max_length=self._usual_length,
            is_valid=self._is_valid,
            max_redraws=36,
        )
        try:
            yield
        finally:
            self._roads = roads


def found(strategy: Frenetic, driver: Driver, simulations: int) -> int:
    """Distinct failures of a search."""
    with tempfile.TemporaryDirectory() as folder:
        Campaign(
            strategy=strategy,
            simulator=EmbeddedSimulator(),
            driver=driver,
            budget=Budget(simulations=simulations),
            folder=Path(folder, "c"),
            ordered=True,
        ).run()
        with CampaignStore.open(Path(folder, "c")) as store:
            return len(distinct_failures(store))


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--simulations", type=int, nargs="+", default=[200, 1000])
    parser.add_argument("--seeds", default="101-106")
    parser.add_argument("--steps", type=float, nargs=2, default=[5.0, 15.0], metavar="M")
    given = parser.parse_args()
    first, _, last = given.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    low, high = given.steps
    searches: dict[str, Callable[[int], Frenetic]] = {
        "10 m": lambda seed: Frenetic(seed=seed, max_length=MAX_LENGTH),
        f"{low:g} to {high:g} m": lambda seed: OwnStep(seed=seed, low=low, high=high),
    }
    print("| driver | simulations | step | distinct failures, median | each seed |")
    print("| --- | ---: | --- | ---: | --- |")
    for simulations in given.simulations:
        for name, driver in DRIVERS:
            for step, make in searches.items():
                values = [found(make(seed), driver, simulations) for seed in seeds]
                each = ", ".join(map(str, values))
                print(
                    f"| {name} | {simulations} | {step} | {median(values):g} | {each} |", flush=True
                )


if __name__ == "__main__":
    main()
