"""The gain of more workers, and the cost of storing.

    python benchmarks/workers.py
    python benchmarks/workers.py --workers 1 2 4 8 --simulations 5000
    python benchmarks/workers.py --pools

Campaigns of the same seed run with each number of workers, in turns. One worker runs in the
campaign's process, more workers run in processes of their own. The driver is the planner called
from Python, since the workers of a built-in driver are threads. All campaigns do the same work:
`random` proposes the same roads for any number of workers, and `frenetic` always has 16 roads in
flight. The time runs from the first ready worker to the last result; the time to start stands
beside it. The second ratio is the median of the ratios within a round.

The second table gives the share of this time that one worker spends on storing.

``--pools`` drives the same random roads with our local workers and with Python's own pools.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from frenetic.campaign import Budget, Campaign, CampaignStore, Event, RoadTester
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.workers import Attempt, LocalWorkers
from frenetic.drivers import Planner
from frenetic.parts.registry import STRATEGIES
from frenetic.search import Candidate
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.embedded import compile_kernels

SEED = 2021
STRATEGIES_MEASURED = ("random", "frenetic")

R = TypeVar("R")


class CalledPlanner(Planner):
    """The planner, called from Python."""


class CampaignTime(NamedTuple):
    """Tests and times of a campaign."""

    tests: int
    seconds: float
    """Time from the first ready worker to the last result, in s."""
    starting: float
    """Time before the first worker was ready, in s."""

    @property
    def rate(self) -> float:
        """Tests per second."""
        return self.tests / self.seconds


def measure(strategy: str, workers: int, simulations: int) -> CampaignTime:
    """Run a campaign, and return its times."""
    marks: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(
            strategy=STRATEGIES.make(strategy, seed=SEED),
            simulator=EmbeddedSimulator(),
            driver=CalledPlanner(),
            budget=Budget(simulations=simulations),
            folder=Path(folder) / "campaign",
            workers=workers,
            max_in_flight=16,
        )
        last = 0.0

        def note(event: Event) -> None:
            nonlocal last
            last = time.perf_counter()
            if event.kind == "started":
                marks.append(last)

        begin = time.perf_counter()
        summary = campaign.run(on_event=note)
    return CampaignTime(summary.tests, last - marks[0], marks[0] - begin)


class StoringTime:
    """Sum of the time spent in the methods of a campaign's store that write."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, method: Callable[..., R]) -> Callable[..., R]:
        """Return the method, with its time added to the sum."""

        def call(*arguments: Any, **options: Any) -> R:
            begin = time.perf_counter()
            try:
                return method(*arguments, **options)
            finally:
                self.seconds += time.perf_counter() - begin

        return call


def storing_share(strategy: str, simulations: int) -> float:
    """Return the share of a campaign's time that its store takes to write."""
    storing = StoringTime()
    names = ("add_candidate", "add_result", "write")
    methods = {name: getattr(CampaignStore, name) for name in names}
    try:
        for name, method in methods.items():
            setattr(CampaignStore, name, storing.timed(method))
        campaign_time = measure(strategy, 1, simulations)
    finally:
        for name, method in methods.items():
            setattr(CampaignStore, name, method)
    return storing.seconds / campaign_time.seconds


def attempts_of_local_workers(
    tester: RoadTester, candidates: Sequence[Candidate], count: int
) -> Iterator[Attempt | None]:
    """Yield None when all workers are ready, then the attempts of our local workers."""
    waiting = list(reversed(candidates))
    returned = 0
    with (
        tempfile.TemporaryDirectory() as folder,
        CampaignLog(Path(folder)) as log,
        LocalWorkers(tester, count, drive_limit=60.0, log=log) as workers,
    ):
        while not workers.free:
            workers.wait(1.0)
        yield None
        while returned < len(candidates):
            while waiting and workers.free:
                workers.submit(waiting.pop())
            attempts = workers.wait(1.0)
            returned += len(attempts)
            yield from attempts


worker_tester: RoadTester
"""The tester of this process, if it is a process of a pool."""


def prepare_worker(tester: RoadTester) -> None:
    """Load the kernels and store the tester, in a process of a pool."""
    global worker_tester
    compile_kernels()
    worker_tester = tester


def attempt_in_worker(candidate: Candidate) -> Attempt:
    """Test a candidate, in a process of a pool."""
    return worker_tester.attempt(candidate)


def attempts_of_executor(
    tester: RoadTester, candidates: Sequence[Candidate], count: int
) -> Iterator[Attempt | None]:
    """Yield None when all is ready, then the attempts of a `ProcessPoolExecutor`."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, prepare_worker, (tester,)) as executor:
        list(executor.map(attempt_in_worker, candidates[: 2 * count]))
        yield None
        for future in as_completed(executor.submit(attempt_in_worker, c) for c in candidates):
            yield future.result()


def attempts_of_pool(
    tester: RoadTester, candidates: Sequence[Candidate], count: int
) -> Iterator[Attempt | None]:
    """Yield None when all is ready, then the attempts of a `multiprocessing.Pool`."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(count, prepare_worker, (tester,)) as pool:
        pool.map(attempt_in_worker, candidates[: 2 * count], 1)
        yield None
        yield from pool.imap_unordered(attempt_in_worker, candidates)


def compare_pools(count: int, simulations: int, rounds: int) -> None:
    """Drive the same roads with each kind of worker; print rates and this process's cost."""
    strategy = STRATEGIES.make("random", seed=SEED)
    candidates = [strategy.ask() for _ in range(simulations)]
    tester = RoadTester(EmbeddedSimulator(), Planner())
    print(f"{'workers':<22}{'roads/s, best':>14}{'ms of this process per road':>30}")
    for name, attempts_of in (
        ("ours", attempts_of_local_workers),
        ("ProcessPoolExecutor", attempts_of_executor),
        ("multiprocessing.Pool", attempts_of_pool),
    ):
        rates, costs = [], []
        for _ in range(rounds):
            attempts = attempts_of(tester, candidates, count)
            next(attempts)
            start, cpu_start = time.perf_counter(), time.process_time()
            roads = sum(1 for _ in attempts)
            cpu_seconds = time.process_time() - cpu_start
            assert roads == simulations
            rates.append(simulations / (time.perf_counter() - start))
            costs.append(1e3 * cpu_seconds / simulations)
        print(f"{name:<22}{max(rates):>14.0f}{min(costs):>30.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="numbers of workers")
    parser.add_argument("--simulations", type=int, default=3000, help="of a campaign")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--pools", action="store_true", help="compare with Python's own pools")
    options = parser.parse_args()
    compile_kernels()
    if options.pools:
        compare_pools(max(options.workers), options.simulations, options.rounds)
        return
    print(
        f"{'strategy':<10}{'workers':>8}{'tests/s, best':>15}{'ratio':>7}{'median':>9}{'ratio':>7}"
        f"{'starting':>10}"
    )
    for strategy in STRATEGIES_MEASURED:
        rounds = [
            {n: measure(strategy, n, options.simulations) for n in options.workers}
            for _ in range(options.rounds)
        ]
        first = options.workers[0]
        for n in options.workers:
            rates = [results[n].rate for results in rounds]
            best = max(results[first].rate for results in rounds)
            # The ratio of a round: the machine may be slower in another round.
            ratio = statistics.median(results[n].rate / results[first].rate for results in rounds)
            starting = min(results[n].starting for results in rounds)
            print(
                f"{strategy:<10}{n:>8}{max(rates):>15.0f}{max(rates) / best:>7.2f}"
                f"{statistics.median(rates):>9.0f}{ratio:>7.2f}{starting:>8.2f} s"
            )
    print(f"\n{'strategy':<10}{'share of storing, one worker':>30}")
    for strategy in STRATEGIES_MEASURED:
        shares = [storing_share(strategy, options.simulations) for _ in range(options.rounds)]
        print(f"{strategy:<10}{min(shares):>18.1%} to {max(shares):.1%}")


if __name__ == "__main__":
    main()
