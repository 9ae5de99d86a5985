"""CPU time of a drive with its verdict: one road after the other, and many roads side by side.

    python benchmarks/side_by_side.py [--roads 400]

The roads are random roads of 250 m, valid or not, and the drives end where the rules end them. The
benchmark prints the least CPU time of several rounds, per drive; on several threads it prints the
wall time, too. It checks that all drives are the same, bit for bit.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from frenetic import BeamngAi, Driver, EmbeddedSimulator, Noisy, Planner, Road, Stanley, judge
from frenetic.campaign.workers.workers import available_cores
from frenetic.drivers.loading import with_wrappers
from frenetic.errors import RoadError
from frenetic.search.operators import random_curvatures
from frenetic.simulators import Drive

SEED: Final = 11
SAMPLES: Final = 26
"""Curvature samples of a road, 10 m apart: 250 m."""
ROUNDS: Final = 5
BATCH: Final = 16
"""Number of roads that a search has in flight."""
DRIVERS: Final[dict[str, Driver]] = {
    "planner": Planner(),
    "stanley": Stanley(),
    "beamng-ai": BeamngAi(),
    "planner with noise": Noisy(Planner()),
    "steering that errs": with_wrappers(Planner(), {"steering_gain": 0.95, "steering_rate": 0.4}),
    "sensors that err": with_wrappers(Planner(), {"lateral_bias": 0.1, "heading_dropout": 0.2}),
}


def random_roads(count: int) -> list[Road]:
    """Return random roads of `SAMPLES` curvature samples."""
    rng = np.random.default_rng(SEED)
    roads: list[Road] = []
    while len(roads) < count:
        try:
            roads.append(Road(random_curvatures(rng, SAMPLES)))
        except RoadError:
            continue
    return roads


def least_time(
    drive: Callable[[], Sequence[Drive]], roads: Sequence[Road]
) -> tuple[float, float, Sequence[Drive]]:
    """Return the least CPU and wall time of a drive with its verdict, in us, and the drives."""
    processor, wall = [], []
    for _ in range(ROUNDS):
        start, start_wall = time.process_time(), time.perf_counter()
        drives = drive()
        for road, road_drive in zip(roads, drives, strict=True):
            judge(road, road_drive)
        processor.append(time.process_time() - start)
        wall.append(time.perf_counter() - start_wall)
    return 1e6 * min(processor) / len(roads), 1e6 * min(wall) / len(roads), drives


def drive_all(
    simulator: EmbeddedSimulator,
    roads: Sequence[Road],
    driver: Driver,
    at_once: int,
    threads: int,
) -> Sequence[Drive]:
    """Drive along all roads, so many at once and on so many threads."""
    batches = [roads[i : i + at_once] for i in range(0, len(roads), at_once)]
    return [
        drive for batch in batches for drive in simulator.drive_many(batch, driver, threads=threads)
    ]


def main() -> None:
    """Print a line for each driver and way to drive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--roads", type=int, default=400)
    roads = random_roads(parser.parse_args().roads)
    simulator, cores = EmbeddedSimulator(), available_cores()
    ways = {
        "one after the other": (1, 1),
        f"{BATCH} side by side": (BATCH, 1),
        "all side by side": (len(roads), 1),
        f"all, {cores} threads": (len(roads), cores),
    }
    for name, driver in DRIVERS.items():
        alone: Sequence[Drive] = ()
        for way, (at_once, threads) in ways.items():
            drive = partial(drive_all, simulator, roads, driver, at_once, threads)
            drive()  # compiles the kernels
            processor, wall, drives = least_time(drive, roads)
            alone = alone or drives
            for first, other in zip(alone, drives, strict=True):
                rows, other_rows = first.trajectory.to_rows(), other.trajectory.to_rows()
                assert np.array_equal(rows, other_rows), "the drives are not the same"
            print(f"{name:20} {way:22} {processor:7.0f} us CPU {wall:7.0f} us wall", flush=True)


if __name__ == "__main__":
    main()
