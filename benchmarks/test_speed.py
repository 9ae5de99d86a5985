"""Times of the parts of a road test, and tests per second of a campaign.

    pytest benchmarks/test_speed.py
    pytest benchmarks/test_speed.py --benchmark-timer=time.process_time

The second command measures CPU time, which other programs on the machine disturb less, but which
leaves out the time that a campaign waits for the disk.

Times of the parts are per road. A round goes once over a fixed set of valid random roads of 250 m.
The default driver stays in its lane on these roads, so every drive reaches the road's end. A round
gives the mean over the set; quote the least of many rounds, "Min". A campaign's round is a whole
campaign. Its tests/s are printed above the table, and the processor time per simulation that its
strategy takes to ask and tell. A command's round is a process, from start to end; its processor
time is printed, too.

No test here fails because it is slow.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from steady import Steady

from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.drivers import Noisy, Planner
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.parts.registry import STRATEGIES
from frenetic.report import draw_drive
from frenetic.road import MAP_MARGIN, MAP_SIZE, Road, check_validity, fit_to_map
from frenetic.search import Candidate, Evaluation, Origin, RandomSearch, Strategy
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE, random_curvatures
from frenetic.simulators import Drive, EmbeddedSimulator
from frenetic.simulators.embedded import compile_kernels

SEED: Final = 2021
SAMPLES: Final = 26
"""Curvature samples of a road, 10 m apart: 250 m."""
ROADS: Final = 64
"""Roads in the set."""
ROUNDS: Final = 30
"""Rounds over the set."""
PICTURES: Final = 4
"""Roads of the set that are drawn."""
SIMULATIONS: Final = 1000
"""Simulations of one campaign: the default of `frenetic run`."""
CAMPAIGNS: Final = 5
"""Rounds of a campaign."""
COMMANDS: Final = 3
"""Rounds of a command."""
STEADY_SPEED: Final = 45.0
"""Speed of the driver in Python, in km/h."""


class TimedStrategy(Strategy):
    """A wrapper that sums up the processor time of a strategy."""

    def __init__(self, strategy: Strategy) -> None:
        self._strategy = strategy
        self.seconds = 0.0
        """Processor time of all calls so far, in s."""

    def ask(self) -> Candidate | None:
        """Return the strategy's next road."""
        start = time.process_time()
        candidate = self._strategy.ask()
        self.seconds += time.process_time() - start
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        """Tell the strategy a result."""
        start = time.process_time()
        self._strategy.tell(evaluation)
        self.seconds += time.process_time() - start


class RoadTest(NamedTuple):
    """A road of the set, its drive and its result."""

    curvatures: npt.NDArray[np.float64]
    road: Road
    """The road, fitted into the map."""
    drive: Drive
    result: Result


def random_roads() -> Iterator[RoadTest]:
    """Yield valid random roads that the default driver drives to the end, always the same roads."""
    rng = np.random.default_rng(SEED)
    simulator, driver = EmbeddedSimulator(), Planner()
    while True:
        curvatures = random_curvatures(rng, SAMPLES, bound=CURVATURE_BOUND, max_change=MAX_CHANGE)
        road = Road(curvatures).fitted()
        if road is None or not road.check_validity():
            continue
        drive = simulator.drive(road, driver)
        result = judge(road, drive)
        if result.outcome is Outcome.PASS:
            yield RoadTest(curvatures, road, drive, result)


def has_to_turn(test: RoadTest) -> bool:
    """Return whether the road fits the map only when it is turned, not by moving alone."""
    motion = fit_to_map(Road(test.curvatures).road_points, MAP_SIZE, MAP_MARGIN)
    return motion is not None and motion.rotation != 0.0


@cache
def road_set() -> tuple[RoadTest, ...]:
    return tuple(itertools.islice(random_roads(), ROADS))


@cache
def turned_set() -> tuple[RoadTest, ...]:
    return tuple(itertools.islice(filter(has_to_turn, random_roads()), ROADS))


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    compile_kernels()


def per_road(
    benchmark: BenchmarkFixture,
    work: Callable[[RoadTest], object],
    roads: tuple[RoadTest, ...],
    rounds: int = ROUNDS,
) -> None:
    """Time `work`; each round goes once over the roads, and the table shows the mean per road."""
    supply = itertools.cycle(roads)
    pedantic: Callable[..., object] = benchmark.pedantic
    pedantic(lambda: work(next(supply)), rounds=rounds, iterations=len(roads), warmup_rounds=1)
    benchmark.extra_info["roads"] = len(roads)


def test_propose(benchmark: BenchmarkFixture) -> None:
    """Ask for a random road, with redraws of refused roads, and tell its result."""
    strategy = RandomSearch(seed=SEED)

    def propose(_: RoadTest) -> None:
        strategy.tell(Evaluation(strategy.ask(), Outcome.PASS, 1.0, 0.5))

    per_road(benchmark, propose, road_set())


def test_fit_with_rotation(benchmark: BenchmarkFixture) -> None:
    """Lay roads from their curvatures and fit them into the map, where moving is not enough."""

    def fit(test: RoadTest) -> None:
        assert Road(test.curvatures).fitted() is not None

    per_road(benchmark, fit, turned_set())


def test_check_validity(benchmark: BenchmarkFixture) -> None:
    """Check the points of a valid road by the competition's rules."""
    per_road(benchmark, lambda test: check_validity(test.road.road_points), road_set())


def test_drive(benchmark: BenchmarkFixture) -> None:
    """Drive 250 m with the default driver in the embedded simulator."""
    simulator, driver = EmbeddedSimulator(), Planner()
    per_road(benchmark, lambda test: simulator.drive(test.road, driver), road_set())


def test_drive_in_python(benchmark: BenchmarkFixture) -> None:
    """Drive 250 m with README's driver in Python, which acts 20 times a second."""
    simulator, driver = EmbeddedSimulator(), Steady(STEADY_SPEED)
    per_road(benchmark, lambda test: simulator.drive(test.road, driver), road_set(), rounds=3)


def test_noisy_drive_in_python(benchmark: BenchmarkFixture) -> None:
    """Drive as `test_drive_in_python` does, with errors about the driver's position."""
    simulator, driver = EmbeddedSimulator(), Noisy(Steady(STEADY_SPEED))
    per_road(benchmark, lambda test: simulator.drive(test.road, driver), road_set(), rounds=3)


def test_judge(benchmark: BenchmarkFixture) -> None:
    """Judge a drive."""
    per_road(benchmark, lambda test: judge(test.road, test.drive), road_set())


def test_store(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """Store a candidate and its result, with the trajectory, in one durable transaction."""
    ids = itertools.count(1)
    with CampaignStore.create(tmp_path / "campaign", {}) as store:

        def save(test: RoadTest) -> None:
            number = next(ids)
            candidate = Candidate(number, test.curvatures, test.road.step, Origin("random"))
            store.add_candidate(candidate)
            store.add_result(record(test, candidate, number))

        per_road(benchmark, save, road_set())


def record(test: RoadTest, candidate: Candidate, number: int) -> Test:
    """Return the record of a road test."""
    return Test(
        candidate=candidate,
        result=test.result,
        pose=test.road.pose,
        trajectory=test.drive.trajectory,
        result_number=number,
        budget_spent=0.5,
        seconds=0.001,
    )


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_picture(benchmark: BenchmarkFixture, tmp_path: Path, suffix: str) -> None:
    """Draw a drive from above with its profiles, into a file."""
    path = tmp_path / f"picture{suffix}"

    def draw(test: RoadTest) -> None:
        draw_drive(test.road, test.drive, path)

    per_road(benchmark, draw, road_set()[:PICTURES], rounds=3)


@pytest.mark.parametrize("name", ["frenetic", "frenetic-2021", "random"])
def test_campaign(
    benchmark: BenchmarkFixture,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
) -> None:
    """Run the whole loop: propose, fit, validate, drive, judge, store, tell."""
    folders = (tmp_path / str(k) for k in itertools.count())
    proposing: list[float] = []  # ms per simulation

    def run() -> int:
        strategy = TimedStrategy(STRATEGIES.make(name, seed=SEED))
        summary = Campaign(
            strategy=strategy,
            simulator=EmbeddedSimulator(),
            driver=Planner(),
            budget=Budget(simulations=SIMULATIONS),
            folder=next(folders),
        ).run()
        proposing.append(1e3 * strategy.seconds / SIMULATIONS)
        return summary.tests

    pedantic: Callable[..., int] = benchmark.pedantic
    tests = pedantic(run, rounds=CAMPAIGNS, warmup_rounds=1)
    if benchmark.stats is None:  # --benchmark-disable
        return
    stats = benchmark.stats.stats
    best, median = tests / stats.min, tests / stats.median
    benchmark.extra_info["tests_per_second"] = {"best": best, "median": median}
    benchmark.extra_info["proposing_ms"] = min(proposing)
    with capsys.disabled():
        print(
            f"\n{name}: {best:.0f} tests/s at best, {median:.0f} in the median"
            f" of {CAMPAIGNS} campaigns of {tests} tests; proposing takes {min(proposing):.2f} ms"
            " of processor time per simulation at best"
        )


@pytest.mark.parametrize("name", ["frenetic", "random"])
def test_command(
    benchmark: BenchmarkFixture, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Run `frenetic run` in a process of its own: search, causes, files, gallery and report."""
    folders = (tmp_path / str(k) for k in itertools.count())
    seconds: list[float] = []
    run = partial(command_cpu, "--strategy", name, "--simulations", str(SIMULATIONS))
    pedantic: Callable[..., object] = benchmark.pedantic
    pedantic(lambda: seconds.append(run("--out", str(next(folders)))), rounds=COMMANDS)
    with capsys.disabled():
        print(f"\n{name}: the command takes {min(seconds):.1f} s of processor time at best")


def test_first_command(
    benchmark: BenchmarkFixture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Run the first command on a machine, with one simulation: nothing is compiled for it."""
    seconds: list[float] = []
    cache = tmp_path / "kernels"
    run = partial(command_cpu, "--simulations", "1", "--out", str(tmp_path / "one"), cache=cache)
    pedantic: Callable[..., object] = benchmark.pedantic
    pedantic(lambda: seconds.append(run()), rounds=1)
    with capsys.disabled():
        print(f"\nthe first command takes {seconds[0]:.1f} s of processor time")


def command_cpu(*options: str, cache: Path | None = None) -> float:
    """Return the processor time of a `frenetic run` and of the processes that it ends, in s."""
    more = {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-m", "frenetic", "run", "--seed", str(SEED), *options]
    before = os.times()
    subprocess.run(command, check=True, capture_output=True, env=os.environ | more)
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])  # user and system time of children
