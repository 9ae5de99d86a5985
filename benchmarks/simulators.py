"""How far MetaDrive and the embedded simulator agree on roads, and how fast they are.

    python benchmarks/simulators.py [--roads 200] [--seed 2021] [--drivers planner stanley ...]

Each driver drives two sets of valid roads in MetaDrive and in the embedded simulator with three
cars: the default car, the default car with steering that moves at once, as in MetaDrive, and a car
with the parameters of MetaDrive's car.

random    roads as the strategy `random` proposes them
failing   roads on which the driver failed in the embedded simulator with its default car, found by
          the strategy `frenetic`

The columns compare each simulator with MetaDrive:

fails     share of the roads on which the driver failed in this simulator
same      share of the roads with the same outcome in MetaDrive
kappa     Cohen's kappa of the outcomes: 0 is what chance gives, 1 is perfect; nan where a
          simulator has only one outcome
rank      Spearman's rank correlation of MOOBD
tests/s   roads driven and judged per s of CPU time, in one process

MetaDrive's own drivers follow, on half as many random roads, with their median MOOBD in m. The last
line says by how much the memory of the process grew while MetaDrive drove 100 roads.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import psutil
from scipy import stats

from frenetic._support.arrays import FloatArray
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Driver, Stanley
from frenetic.drivers.loading import load_driver
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.plugins.metadrive import MetaDriveExpert, MetaDriveIdm, MetaDriveSimulator
from frenetic.road import Road
from frenetic.search import Frenetic
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators import EmbeddedSimulator, Simulator, Vehicle
from frenetic.simulators.embedded import compile_kernels

AT_ONCE: Final = replace(Vehicle(), steering_rate=20.0, steering_lag=0.01)
"""The embedded simulator's default car with steering that moves at once, as in MetaDrive."""
REFERENCE: Final = "metadrive"
SPEEDS: Final = (30.0, 50.0, 70.0)
"""Speed of MetaDrive's IDM driver, in km/h."""
MEMORY_ROADS: Final = 100


class RoadResults(NamedTuple):
    """Results of a set of roads in a simulator."""

    failed: FloatArray
    """Failures, (n,): 1 where the driver failed, 0 where it passed."""
    moobd: FloatArray
    """MOOBDs, (n,) in m."""
    rate: float
    """Tests per s of CPU time."""


def random_roads(count: int, seed: int) -> list[Road]:
    """Return valid random roads."""
    return list(islice(RandomRoads().valid(np.random.default_rng(seed)), count))


def failing_roads(count: int, seed: int, driver: Driver) -> list[Road]:
    """Return roads on which the driver fails in the default car, found by `frenetic`."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "campaign"
        Campaign(
            strategy=Frenetic(seed=seed),
            simulator=EmbeddedSimulator(vehicle="default"),
            driver=driver,
            budget=Budget(failures=count, simulations=100 * count),
            folder=folder,
        ).run()
        with CampaignStore.open(folder) as store:
            return [test.road for test in store.tests(Outcome.FAIL, limit=count)]


def drive_all(simulator: Simulator, driver: Driver, roads: Sequence[Road]) -> RoadResults:
    """Drive and judge all roads."""
    failed, moobd = np.zeros(len(roads)), np.zeros(len(roads))
    compile_kernels()
    simulator.drive(roads[0], driver)  # loads
    begin = time.process_time()
    for i, road in enumerate(roads):
        result = judge(road, simulator.drive(road, driver))
        if result.moobd is None:
            raise SystemExit(f"road {i} could not be driven: {result.reason}")
        failed[i], moobd[i] = result.outcome is Outcome.FAIL, result.moobd
    return RoadResults(failed, moobd, len(roads) / (time.process_time() - begin))


def kappa(a: FloatArray, b: FloatArray) -> float:
    """Return Cohen's kappa of two simulators' outcomes; nan where one of them is constant."""
    if a.std() == 0.0 or b.std() == 0.0:
        return float("nan")
    agreed = float(np.mean(a == b))
    by_chance = a.mean() * b.mean() + (1.0 - a.mean()) * (1.0 - b.mean())
    return float((agreed - by_chance) / (1.0 - by_chance))


def print_own_drivers(roads: Sequence[Road]) -> None:
    """Print how MetaDrive's own drivers do on random roads."""
    idm = {f"metadrive-idm, {speed:g} km/h": MetaDriveIdm(target_speed=speed) for speed in SPEEDS}
    with MetaDriveSimulator() as simulator:
        for label, driver in {**idm, "metadrive-expert": MetaDriveExpert()}.items():
            results = drive_all(simulator, driver, roads)
            print(
                f"{label:<30}{f'{len(roads)} random':<12}fails{results.failed.mean():>7.1%}"
                f"  median MOOBD{np.median(results.moobd):>7.2f}"
            )


def memory_growth(roads: Sequence[Road]) -> float:
    """Return the MB by which the process grows while MetaDrive drives roads, after 20 drives."""
    process = psutil.Process()
    with MetaDriveSimulator() as simulator:
        for road in roads[:20]:
            simulator.drive(road, Stanley())
        before = process.memory_info().rss
        for i in range(MEMORY_ROADS):
            simulator.drive(roads[i % len(roads)], Stanley())
        return float(process.memory_info().rss - before) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--roads", type=int, default=200, help="roads of a set")
    parser.add_argument("--seed", type=int, default=2021, help="seed of both sets")
    parser.add_argument("--drivers", nargs="+", default=["planner", "stanley", "beamng-ai"])
    options = parser.parse_args()
    simulators: dict[str, AbstractContextManager[Simulator] | Simulator] = {
        "embedded": EmbeddedSimulator(vehicle="default"),
        "... steers at once": EmbeddedSimulator(vehicle=AT_ONCE),
        "... MetaDrive's car": EmbeddedSimulator(vehicle="metadrive"),
        REFERENCE: MetaDriveSimulator(),
    }
    print(
        f"{'driver':<18}{'roads':<12}{'simulator':<21}{'fails':>7}{'same':>7}{'kappa':>7}"
        f"{'rank':>7}{'tests/s':>9}"
    )
    for name in options.drivers:
        driver = load_driver(name)
        for set_name, roads in (
            ("random", random_roads(options.roads, options.seed)),
            ("failing", failing_roads(options.roads, options.seed, driver)),
        ):
            results = {}
            for label, simulator in simulators.items():
                with simulator as started:
                    results[label] = drive_all(started, driver, roads)
            reference = results[REFERENCE]
            for label, result in results.items():
                agreement = kappa(result.failed, reference.failed)
                rank = stats.spearmanr(result.moobd, reference.moobd).statistic
                print(
                    f"{name:<18}{f'{len(roads)} {set_name}':<12}{label:<21}"
                    f"{result.failed.mean():>7.1%}"
                    f"{np.mean(result.failed == reference.failed):>7.1%}"
                    f"{agreement:>7.2f}{rank:>7.2f}{result.rate:>9.1f}",
                    flush=True,
                )
    print()
    print_own_drivers(random_roads(options.roads // 2, options.seed))
    growth = memory_growth(random_roads(50, options.seed))
    print(f"\nMetaDrive: {growth:.1f} MB more memory after {MEMORY_ROADS} roads")


if __name__ == "__main__":
    main()
