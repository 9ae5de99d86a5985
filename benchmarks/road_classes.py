"""Failures of drivers on the roads of each class, and what roads of a class cost.

    python benchmarks/road_classes.py [--seeds 10] [--simulations 200] [--workers 2]

Every driver drives at the class's speed limit. Each cell of the first table is the mean over the
seeds: failures, and distinct failures in brackets. The second table gives times per metre of road:
to draw a random road, place it on its map and check it there; and the own time of the search
`frenetic`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from frenetic import (
    Budget,
    Campaign,
    Driver,
    EmbeddedSimulator,
    Frenetic,
    Planner,
    RandomSearch,
    Rules,
    Stanley,
)
from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.road.classes import RoadClass, classes
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators.embedded import compile_kernels
from frenetic.spec import COMPETITION

README = Path(__file__).parents[1] / "README.md"
STRATEGIES = {"random": RandomSearch, "frenetic": Frenetic}


def readme_driver() -> Driver:
    """Return the driver that README shows."""
    code = README.read_text(encoding="utf-8").split("# file: my_driver.py\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    exec(code, names)
    driver: Driver = names["MyDriver"]()
    return driver


SLIPPERY = "planner, friction 0.3"
CASES: dict[str, tuple[Callable[[], Driver], dict[str, Any]]] = {
    "planner, aggression 1": (Planner, {}),
    "planner, aggression 1.3": (partial(Planner, aggression=1.3), {}),
    "planner, aggression 1.6": (partial(Planner, aggression=1.6), {}),
    "stanley": (Stanley, {}),
    "README's driver": (readme_driver, {}),
    "planner, friction 0.45": (Planner, {"friction": 0.45}),
    SLIPPERY: (Planner, {"friction": 0.3}),
    "stanley, steering lag 0.3 s": (Stanley, {"steering_lag": 0.3}),
}
"""Name -> the driver, and the options of the simulator."""


def search(
    name: str, case: str, strategy: str, seed: int, simulations: int
) -> tuple[int, int, float]:
    """Return failures and distinct failures of a search, and its own time in µs per m of road."""
    road_class = None if name == COMPETITION else RoadClass.of(name)
    driver, simulator = CASES[case]
    with TemporaryDirectory() as temporary:
        rules = Rules() if road_class is None else Rules(speed_limit=road_class.speed_limit)
        campaign = Campaign(
            strategy=STRATEGIES[strategy](seed=seed, road_class=road_class),
            simulator=EmbeddedSimulator(rules=rules, **simulator),
            driver=driver(),
            budget=Budget(simulations=simulations),
            folder=Path(temporary) / "campaign",
            max_in_flight=16,
        )
        seconds = campaign.run().strategy_seconds
        with CampaignStore.open(campaign.folder) as store:
            metres = sum(test.road.length for test in store.tests())
            failures = store.by_outcome()[Outcome.FAIL]
            return failures, len(distinct_failures(store)), 1e6 * seconds / metres


def micros_per_metre(road_class: RoadClass | None, count: int = 300) -> float:
    """Return the time to draw a road, place it on its map and check it there, in µs per metre."""
    map_size = 200.0 if road_class is None else road_class.map_size
    roads = RandomRoads(map_size=map_size, max_redraws=0, road_class=road_class)
    rng = np.random.default_rng(1)
    metres, seconds = 0.0, 0.0
    for _ in range(count):
        start = time.perf_counter()
        values = roads.draw(rng)
        if road_class is None:
            road = Road(values, roads.step)
        else:
            profiles = road_class.profiles(values, roads.step)
            road = Road(values, roads.step, lane_width=road_class.lane_width, **profiles)
        road.placed(map_size, road_class=road_class)
        seconds += time.perf_counter() - start
        metres += road.length
    return 1e6 * seconds / metres


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument("--simulations", type=int, default=200, help="of a search")
    parser.add_argument("--workers", type=int, default=2, help="searches at once")
    options = parser.parse_args()
    seeds = range(1, options.seeds + 1)
    cells = list(product(CASES, classes(), STRATEGIES, seeds))
    with ProcessPoolExecutor(options.workers) as pool:
        tasks = [
            pool.submit(search, name, case, strategy, seed, options.simulations)
            for case, name, strategy, seed in cells
        ]
        results = dict(zip(cells, (task.result() for task in tasks), strict=True))
    print(f"| driver | search | {' | '.join(classes())} |\n|---|---|{'---|' * len(classes())}")
    for case, strategy in product(CASES, STRATEGIES):
        row = []
        for name in classes():
            runs = [results[case, name, strategy, s] for s in seeds]
            failures, distinct, _ = np.mean(runs, axis=0)
            row.append(f"{failures:.1f} ({distinct:.1f})")
        print(f"| {case} | {strategy} | {' | '.join(row)} |")
    print("\n| roads | draw, place, check (µs/m) | search (µs/m) |\n|---|---|---|")
    for name in (COMPETITION, *classes()):
        road_class = None if name == COMPETITION else RoadClass.of(name)
        compile_kernels()
        micros_per_metre(road_class, 20)  # compiles what only road classes use
        searched = search(name, SLIPPERY, "frenetic", 1, 300)[2]
        print(f"| {name} | {micros_per_metre(road_class):.2f} | {searched:.2f} |")


if __name__ == "__main__":
    main()
