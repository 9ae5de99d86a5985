"""Tests per second of a whole search loop: Frenetic against freneticlib 1.0.

    python benchmarks/peer.py [--simulations 250] [--rounds 5] [--seed 1] [--peer-python PATH]

freneticlib (PyPI) is the published library of the same algorithm. It runs with the settings of its
own example: `BicycleExecutor` (a kinematic bicycle with a PID driver, 10 records per simulated
second), roads of 30 +- 5 values 10 m apart, one fifth of the simulations random, then mutation and
crossover. As in the example, freneticlib validates no road and writes nothing to disk. Its log is
switched off.

Frenetic runs a `Campaign` with the strategy `frenetic-2021`, the embedded simulator and the default
driver: every road is fitted into the map and checked by the competition's rules, and every test
goes into the campaign's database with its trajectory. Frenetic runs on two maps: on the default map
of 200 m, where roads have 20 +- 5 values, and on a map of 300 m, where roads are as long as those
of freneticlib's example.

Each measurement runs in a process of its own, in turns; each round has another seed. The table
shows the best and the median round by wall time, and the best round by CPU time. Importing and
compiling happen before the clock starts. A rate is simulations per time, so refused roads cost
Frenetic time but do not count. Frenetic's drives end where the car has left its lane, freneticlib's
drives always at the road's end.

freneticlib comes with the extra `benchmarks`. If freneticlib is in another environment, name that
environment's Python by --peer-python.
"""

from __future__ import annotations

import argparse
import json
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Final

PEER: Final = "freneticlib"
PEER_VERSION: Final = "1.0"
MISSING: Final = 3
"""Exit status of a measurement whose library is not installed."""
WARM_UP: Final = 5
"""Simulations before the clock starts."""


@dataclass(frozen=True)
class SearchTime:
    """Times of a search."""

    simulations: int
    wall: float
    """Wall time, in s."""
    cpu: float
    """CPU time, in s."""
    road_length: float
    """Mean length of all driven roads, in m."""


@dataclass(frozen=True)
class Contestant:
    """A search library with its settings."""

    name: str
    run: Callable[[int, int], SearchTime]
    """Run a search: (simulations, seed) -> its times."""


def measure(search: Callable[[], tuple[int, float]]) -> SearchTime:
    """Time a search, which returns its number of simulations and mean road length."""
    wall, cpu = time.perf_counter(), time.process_time()
    simulations, length = search()
    return SearchTime(simulations, time.perf_counter() - wall, time.process_time() - cpu, length)


def run_peer(simulations: int, seed: int) -> SearchTime:
    """Run a search of freneticlib with the settings of its example."""
    from freneticlib.core.core import FreneticCore
    from freneticlib.core.mutation.crossovers import ChooseRandomCrossoverOperator
    from freneticlib.core.mutation.mutators import FreneticMutator
    from freneticlib.core.objective import MaxObjective
    from freneticlib.executors.bicycle.bicycleexecutor import BicycleExecutor
    from freneticlib.frenetic import Frenetic
    from freneticlib.representations.kappa_representation import FixStepKappaRepresentation
    from freneticlib.stopcriteria.counter import CountingStop
    from freneticlib.utils.random import reset_rng

    if (installed := version(PEER)) != PEER_VERSION:
        raise RuntimeError(f"{PEER} {installed} is installed, {PEER_VERSION} is needed")
    logging.disable(logging.CRITICAL)
    step = 10.0

    def search(total: int) -> tuple[int, float]:
        reset_rng(seed)
        roads = FixStepKappaRepresentation(length=30, variation=5, step=step)
        objective = MaxObjective(feature="distance_from_center", per_simulation_aggregator="max")
        core = FreneticCore(
            representation=roads,
            objective=objective,
            mutator=FreneticMutator(),
            crossover=ChooseRandomCrossoverOperator(size=20),
        )
        executor = BicycleExecutor(representation=roads, objective=objective)
        Frenetic(core, executor, CountingStop(n_random=total // 5, n_total=total)).start()
        lengths = [(len(values) - 1) * step for values in core.history.test]
        return len(lengths), sum(lengths) / len(lengths)

    search(WARM_UP)
    return measure(lambda: search(simulations))


def run_ours(map_size: float) -> Callable[[int, int], SearchTime]:
    """Return a function that runs a campaign of Frenetic, on a map of `map_size` m."""

    def run(simulations: int, seed: int) -> SearchTime:
        from frenetic import (
            Budget,
            Campaign,
            CampaignStore,
            EmbeddedSimulator,
            Frenetic2021,
            Planner,
        )
        from frenetic.simulators.embedded import compile_kernels

        def campaign(total: int, folder: Path) -> Campaign:
            return Campaign(
                strategy=Frenetic2021(seed=seed, map_size=map_size, max_redraws=10),
                simulator=EmbeddedSimulator(),
                driver=Planner(),
                budget=Budget(simulations=total),
                folder=folder,
            )

        compile_kernels()
        with tempfile.TemporaryDirectory() as folder:
            campaign(WARM_UP, Path(folder) / "warm-up").run()
            search_time = measure(
                lambda: (campaign(simulations, Path(folder) / "run").run().simulations, 0.0)
            )
            with CampaignStore.open(Path(folder) / "run") as store:
                lengths = [
                    (len(test.candidate.curvatures) - 1) * test.candidate.step
                    for test in store.tests()
                    if test.outcome.is_driven
                ]
        return replace(search_time, road_length=sum(lengths) / len(lengths))

    return run


CONTESTANTS: Final = (
    Contestant(f"{PEER} {PEER_VERSION}", run_peer),
    Contestant("frenetic, 200 m map", run_ours(200.0)),
    Contestant("frenetic, 300 m map", run_ours(300.0)),
)


def measure_in_process(index: int, python: str, simulations: int, seed: int) -> SearchTime:
    """Measure a contestant in a process of the interpreter `python`.

    Raises:
        RuntimeError: the interpreter or the library is missing, or the search ended with an error.
    """
    name = CONTESTANTS[index].name
    command = [python, __file__, "--measure", str(index)]
    command += ["--simulations", str(simulations), "--seed", str(seed)]
    try:
        completed = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise RuntimeError(f"cannot start {python}: {error.strerror or error}") from None
    if completed.returncode:
        lines = completed.stderr.strip().splitlines() or [f"exit status {completed.returncode}"]
        is_missing = completed.returncode == MISSING
        raise RuntimeError(lines[-1] if is_missing else f"{name} failed: {lines[-1]}")
    return SearchTime(**json.loads(completed.stdout))


def measure_here(index: int, simulations: int, seed: int) -> int:
    """Measure a contestant in this process, and print the times as JSON."""
    try:
        search_time = CONTESTANTS[index].run(simulations, seed)
    except ModuleNotFoundError as error:
        peer_remedy = 'pip install -e ".[benchmarks]", or --peer-python PATH'
        remedy = "pip install -e ." if index else peer_remedy
        print(f"{error.name} is not installed for {sys.executable}: {remedy}", file=sys.stderr)
        return MISSING
    print(json.dumps(asdict(search_time)))
    return 0


def report(rounds: list[list[SearchTime]]) -> None:
    """Print the rates of all contestants, and their ratios to the peer's rate."""
    columns = {
        "best": [max(run.simulations / run.wall for run in runs) for runs in rounds],
        "median": [median(run.simulations / run.wall for run in runs) for runs in rounds],
        "CPU best": [max(run.simulations / run.cpu for run in runs) for runs in rounds],
    }
    print(f"\n{'tests/s':<22}" + "".join(f"{name:>10}{'ratio':>7}" for name in columns), end="")
    print(f"{'mean road':>12}")
    for index, (contestant, runs) in enumerate(zip(CONTESTANTS, rounds, strict=True)):
        cells = [f"{rate[index]:>10.1f}{rate[index] / rate[0]:>7.1f}" for rate in columns.values()]
        length = sum(run.road_length for run in runs) / len(runs)
        print(f"{contestant.name:<22}" + "".join(cells) + f"{length:>10.0f} m")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--simulations", type=int, default=250, help="of each search")
    parser.add_argument("--rounds", type=int, default=5, help="searches of each contestant")
    parser.add_argument("--seed", type=int, default=1, help="of the first round")
    parser.add_argument(
        "--peer-python", default=sys.executable, metavar="PATH", help="Python with freneticlib"
    )
    parser.add_argument("--measure", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.simulations < WARM_UP or options.rounds < 1 or options.seed < 0:
        parser.error(
            f"--simulations must be at least {WARM_UP}, --rounds at least 1, --seed at least 0"
        )
    if options.measure is not None:
        return measure_here(options.measure, options.simulations, options.seed)

    rounds: list[list[SearchTime]] = [[] for _ in CONTESTANTS]
    print(f"{options.simulations} simulations each; tests/s of wall time")
    for number in range(options.rounds):
        for index, contestant in enumerate(CONTESTANTS):
            python = options.peer_python if index == 0 else sys.executable
            seed = options.seed + number
            try:
                search_time = measure_in_process(index, python, options.simulations, seed)
            except RuntimeError as error:
                print(f"peer: {error}", file=sys.stderr)
                return 2
            rounds[index].append(search_time)
            rate = search_time.simulations / search_time.wall
            print(f"  round {number + 1}  {contestant.name:<22}{rate:>8.1f}", flush=True)
    report(rounds)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
