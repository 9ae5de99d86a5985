"""Whether a search finds faults that need a road and a condition, and whether estimates are right.

    python benchmarks/conditions.py search
    python benchmarks/conditions.py frequency common
    python benchmarks/conditions.py frequency rare --brute 0 --repeats 20

``search`` compares `frenetic` with `random` on six drivers in one domain. Each driver has a planted
fault that shows only on some roads in some condition. The table has the failures by that fault in
300 drives, over ten seeds, and the conditions that ``minimise`` keeps of one failure. ``frequency``
compares the estimates of `frenetic estimate` with brute force, which is very many plain drives.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from frenetic import Budget, Campaign, EmbeddedSimulator, Frenetic, Outcome, Planner, RandomSearch
from frenetic.analysis.statistics import a12, mann_whitney, rate_interval
from frenetic.campaign import CampaignStore, RoadTester
from frenetic.conditions.domain import Domain
from frenetic.drivers import Camera, Controls, Driver, Observation
from frenetic.drivers.stack import stack_of
from frenetic.drivers.wrappers import Delayed, Hasty, LimitedView
from frenetic.oracle.drive import Drive
from frenetic.plugins.vision.appearance import Worn
from frenetic.rerun.estimate import Draws, FailureRate, estimate
from frenetic.rerun.minimise import minimise_test
from frenetic.road import Road
from frenetic.search import Strategy
from frenetic.spec.terms import Terms

DOMAIN: dict[str, Any] = {
    "roads": "urban-50,length=500",
    "conditions": {
        "friction": {"low": 0.3, "high": 1.0, "mean": 0.95, "deviation": 0.13},
        "gust": {"low": -20.0, "high": 20.0, "mean": 0.0, "deviation": 6.0},
        "view": {"low": 25.0, "high": 120.0, "chance": 0.1},
        "delay": {"low": 0.0, "high": 0.3, "chance": 0.1},
        "overspeed": {"low": 0.0, "high": 25.0, "chance": 0.1},
        "load": {"low": 0.0, "high": 300.0},
        "start": {"low": -0.3, "high": 0.3},
    },
}
"""Domain of the drivers without a camera."""
CAMERA_DOMAIN: dict[str, Any] = {
    "roads": "competition",
    "conditions": {**DOMAIN["conditions"], "wear": {"low": 0.0, "high": 0.9, "chance": 0.1}},
}
"""Domain of the driver with a camera: a camera needs flat roads of one width."""
SEEDS = 10
"""Number of seeds."""


@dataclass
class World:
    """Road and conditions of a drive, for the planted fault: no real driver knows them."""

    road: Road
    simulator: EmbeddedSimulator
    view: float = math.inf
    wear: float = 0.0
    delay: float = 0.0
    excess: float = 0.0

    def curvature(self, s: float) -> float:
        """Return the curvature at distance `s` along the road, in 1/m."""
        values = self.road.curvatures
        return float(np.interp(s, self.road.step * np.arange(len(values)), values))

    def grade(self, s: float) -> float:
        """Return the grade at distance `s` along the road, in m/m."""
        values = self.road.grade
        return float(np.interp(s, values[:, 0], values[:, 1])) if len(values) else 0.0


class FaultyDriver(Planner):
    """A sound driver that steers less, or not at all, where its planted fault shows."""

    def __init__(self, fault: Callable[[World, float, float], float] | None = None) -> None:
        super().__init__(lateral_acceleration=1.8, braking=1.5, lookahead_time=1.6)
        self.fault = fault
        self.world: World | None = None

    def act(self, observation: Observation) -> Controls:
        """Return the planner's controls, with less steering where the fault shows."""
        controls = super().act(observation)
        # Full throttle in a bend turns the car on a wet road.
        controls = replace(controls, throttle=min(controls.throttle, 0.35))
        if self.fault is None or self.world is None:
            return controls
        strength = self.fault(self.world, observation.distance, observation.speed)
        lost_share = min(max(strength, 0.0), 1.0)
        return replace(controls, steering=(1.0 - lost_share) * controls.steering)


class FaultyCameraDriver(FaultyDriver):
    """A faulty driver with a camera, whose pictures show the markings."""

    camera = Camera(width=16, height=8)


class FaultSimulator(EmbeddedSimulator):
    """The embedded simulator; it tells a faulty driver its road and conditions."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Give the faulty driver its `World`, and drive."""
        world = World(road, self)
        for part in stack_of(driver):
            if isinstance(part, LimitedView):
                world.view = part.distance
            elif isinstance(part, Delayed):
                world.delay = part.seconds
            elif isinstance(part, Hasty):
                world.excess = part.excess
            elif isinstance(part, Worn):
                world.wear = next(iter(part.options.values()))
            elif isinstance(part, FaultyDriver):
                part.world = world
        return super().drive(road, driver)


def ramp(value: float, start: float, full: float) -> float:
    """Return 0 up to `start`, 1 from `full` on, and a straight line between them."""
    return min(max((value - start) / (full - start), 0.0), 1.0)


# Faults: the share of its steering that a driver loses in a world, at distance s in m along the
# road, at a speed in m/s.


def grip(world: World, s: float, _: float) -> float:
    """Fault in bends on a slippery road."""
    return ramp(-world.simulator.friction, -0.68, -0.6) * (abs(world.curvature(s)) > 1.0 / 150.0)


def delayed(world: World, s: float, _: float) -> float:
    """Fault where a bend follows an opposite bend, with a delay."""
    before, after = world.curvature(max(s - 40.0, 0.0)), world.curvature(s)
    is_reversing = before * after < 0.0 and abs(after) > 1.0 / 200.0
    return ramp(world.delay, 0.2, 0.25) * is_reversing


def gusty(world: World, s: float, _: float) -> float:
    """Fault in a gust on a crest."""
    gust_at = world.simulator.gust_at
    is_crest = world.grade(s + 20.0) < world.grade(s - 20.0) - 0.002
    is_in_gust = gust_at is not None and abs(s - gust_at) < 60.0
    return ramp(abs(world.simulator.gust), 5.0, 12.0) * is_crest * is_in_gust


def foggy(world: World, s: float, speed: float) -> float:
    """Fault in bends where the car needs most of its view to brake."""
    braking = speed * speed / (2.0 * 2.5)
    return ramp(braking / world.view, 0.7, 1.0) * (abs(world.curvature(s)) > 1.0 / 150.0)


def worn(world: World, s: float, _: float) -> float:
    """Fault in left bends with worn markings."""
    return ramp(world.wear, 0.3, 0.7) * (world.curvature(s) > 1.0 / 150.0)


def hasty(world: World, s: float, _: float) -> float:
    """Fault in bends downhill, over the speed limit."""
    is_falling = world.grade(s) < -0.03
    return ramp(world.excess, 12.0, 18.0) * is_falling * (abs(world.curvature(s)) > 1.0 / 150.0)


FAULTS = {
    "grip": (grip, "friction"),
    "delay": (delayed, "delay"),
    "gust": (gusty, "gust"),
    "fog": (foggy, "view"),
    "wear": (worn, "wear"),
    "overspeed": (hasty, "overspeed"),
}
"""Name -> the fault, and the condition that it needs."""


def run_search(fault: str, strategy: type[Strategy], seed: int, drives: int) -> tuple[int, str]:
    """Return the number of failures by a fault, and the conditions that `minimise` keeps of one."""
    needs_camera = fault == "wear"
    domain = Domain.from_entries("town", CAMERA_DOMAIN if needs_camera else DOMAIN)
    driver_class = FaultyCameraDriver if needs_camera else FaultyDriver
    driver, conditions = driver_class(FAULTS[fault][0]), ""
    with TemporaryDirectory() as folder:
        Campaign(
            strategy=strategy(seed=seed, road_class=domain.road_class, domain=domain),  # type: ignore[call-arg]
            simulator=FaultSimulator(),
            driver=driver,
            budget=Budget(simulations=drives),
            folder=folder,
            max_in_flight=16,
        ).run()
        with CampaignStore.open(folder) as store:
            failed = [test for test in store.tests() if test.outcome is Outcome.FAIL]
            sound = RoadTester(FaultSimulator(), driver_class(), store.setting.terms)
            by_fault = [t for t in failed if sound.test(t.candidate).result.outcome is Outcome.PASS]
            if by_fault and strategy is Frenetic:
                tester = RoadTester(FaultSimulator(), driver, store.setting.terms)
                test = store.test(by_fault[0].id)
                conditions = minimise_test(folder, test, tester, max_drives=150).conditions_text()
    return len(by_fault), conditions


def search(seeds: int, drives: int) -> None:
    """Print for each fault how often both searches find it, and what `minimise` keeps."""
    print("fault       random  frenetic  times   A12        p  minimise says")
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for fault, (_, needed) in FAULTS.items():
            runs = {
                strategy: list(
                    pool.map(partial(run_search, fault, strategy, drives=drives), range(seeds))
                )
                for strategy in (RandomSearch, Frenetic)
            }
            few, many = ([n for n, _ in runs[strategy]] for strategy in (RandomSearch, Frenetic))
            texts = [text for _, text in runs[Frenetic] if text]
            right = sum(needed in text for text in texts)
            alone = sum(text.startswith(needed) and "," not in text for text in texts)
            times = sum(many) / max(sum(few), 1)
            print(
                f"{fault:10} {np.mean(few):7.1f} {np.mean(many):9.1f} {times:6.1f}"
                f" {a12(many, few):5.2f} {mann_whitney(many, few):8.2g}"
                f"  {needed} in {right} of {len(texts)}, alone in {alone}: {(texts or '-')[0]}",
                flush=True,
            )


COMMON: dict[str, Any] = {
    "roads": "urban-50,length=200",
    "conditions": {
        "friction": {"low": 0.1, "high": 1.0, "mean": 0.9, "deviation": 0.12},
        "gust": {"low": -40.0, "high": 40.0, "mean": 0.0, "deviation": 8.0},
        "delay": {"low": 0.0, "high": 0.4, "mean": 0.0, "deviation": 0.1},
    },
}
"""A domain with about one departure in 100 km, by conditions and roads together."""
RARE: dict[str, Any] = {
    "roads": "urban-50,length=200",
    "conditions": {
        **COMMON["conditions"],
        "friction": {"low": 0.1, "high": 0.5, "chance": 3e-5},
        "gust": {"low": -20.0, "high": 20.0, "mean": 0.0, "deviation": 4.0},
    },
}
"""A domain with about one departure in 10,000 km, by ice in 3 of 100,000 drives."""
DOMAINS = {"common": COMMON, "rare": RARE}
_CHUNK = 5000
"""Number of plain drives that a process makes at once."""


def _tester(domain: Domain) -> RoadTester:
    """Return the tester of a sound driver in a domain."""
    driver = Planner(lateral_acceleration=1.8, braking=1.5, lookahead_time=1.6)
    terms = Terms.of_class(domain.road_class, domain=domain)
    return RoadTester(EmbeddedSimulator(), driver, terms)


def _brute(seed: int, name: str) -> tuple[int, float]:
    """Return the failures and the km of a chunk of plain drives."""
    domain = Domain.from_entries(name, DOMAINS[name])
    tester = _tester(domain)
    draws = Draws(tester, drives=5 * _CHUNK, seed=10_000 + seed)
    failures, lengths = 0, []
    for _ in range(_CHUNK):  # the first fifth of all draws is plain
        candidate = draws.ask()
        assert candidate is not None
        result = tester.test(candidate).result
        failures += result.outcome is Outcome.FAIL
        distance = None if result.finding is None else result.finding.distance
        lengths.append((candidate.length if distance is None else distance) / 1000.0)
    return failures, math.fsum(lengths)


def _estimate(seed: int, name: str, drives: int) -> FailureRate:
    domain = Domain.from_entries(name, DOMAINS[name])
    with TemporaryDirectory() as folder:
        return estimate(_tester(domain), drives=drives, seed=seed, out=f"{folder}/drives")


def frequency(name: str, brute: int, repeats: int, drives: int, processes: int) -> None:
    """Print how estimates compare with brute force in a domain."""
    truth = math.nan
    with ProcessPoolExecutor(processes) as pool:
        if brute:
            begin = time.perf_counter()
            chunks = list(pool.map(partial(_brute, name=name), range(brute // _CHUNK)))
            failures, length = sum(n for n, _ in chunks), sum(km for _, km in chunks)
            truth = failures / length * 1000.0
            low, high = rate_interval(failures, length / 1000.0)
            print(f"{name}: brute force, {brute} drives, {failures} failures in {length:.0f} km")
            print(f"  {truth:.3g} departures per 1,000 km ({low:.3g} to {high:.3g}),", end=" ")
            print(f"{time.perf_counter() - begin:.0f} s", flush=True)
        estimates = list(pool.map(partial(_estimate, name=name, drives=drives), range(repeats)))
    known = [estimate for estimate in estimates if estimate.rate is not None]
    print(f"{name}: {repeats} estimates of {drives} drives, {len(known)} of them with a rate,")
    if brute:
        right = sum(estimate.low <= truth <= estimate.high for estimate in estimates)
        print(f"  {right} intervals hold the rate of brute force;")
    if known:
        rates = [estimate.rate for estimate in known if estimate.rate is not None]
        mean = float(np.mean(rates))
        width = float(np.median([math.log(e.high / max(e.low, 1e-12)) for e in known]))
        print(f"  mean {mean:.3g} per 1,000 km, median ratio of the ends {math.exp(width):.2f};")
        # Of a Poisson count n, the logarithm of the interval is about 3.92 / sqrt(n) wide.
        chance = mean / 1000.0 * known[0].length
        plain = (3.92 / width) ** 2 / chance
        print(f"  plain drives for the same width: {plain:.0f}, {plain / drives:.1f} times as many")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="command", required=True)
    searches = commands.add_parser("search", help="compare both searches on the planted faults")
    searches.add_argument("--seeds", type=int, default=SEEDS, help="number of seeds")
    searches.add_argument("--drives", type=int, default=300, help="simulations of a search")
    estimates = commands.add_parser("frequency", help="compare estimates with brute force")
    estimates.add_argument("domain", choices=DOMAINS)
    estimates.add_argument(
        "--brute", type=int, default=1_000_000, help="plain drives; 0: no brute force"
    )
    estimates.add_argument("--repeats", type=int, default=100, help="number of estimates")
    estimates.add_argument("--drives", type=int, default=5_000, help="drives of an estimate")
    estimates.add_argument("--processes", type=int, default=os.cpu_count())
    options = parser.parse_args()
    if options.command == "search":
        search(options.seeds, options.drives)
    else:
        frequency(options.domain, options.brute, options.repeats, options.drives, options.processes)


if __name__ == "__main__":
    main()
