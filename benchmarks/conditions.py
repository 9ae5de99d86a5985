"""Whether a search of roads and conditions finds joint faults, and whether estimates are right.

    python benchmarks/conditions.py search
    python benchmarks/conditions.py frequency common
    python benchmarks/conditions.py frequency rare --brute 0 --repeats 20

``search`` compares `frenetic` with `random` on six drivers, each with a fault that needs a road and
a condition, in one domain: failures by that fault in 300 drives, over ten seeds; and what
``minimise`` says of one. ``frequency`` compares estimates with brute force.
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
from frenetic.drivers.driver import stack_of
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
BY_CAMERA: dict[str, Any] = {
    "roads": "competition",
    "conditions": {**DOMAIN["conditions"], "wear": {"low": 0.0, "high": 0.9, "chance": 0.1}},
}
"""The same on flat roads, which a camera sees; it sees no lane's end."""
SEEDS = range(10)


@dataclass
class World:
    """What a planted driver is in, which no real one is told."""

    road: Road
    simulator: EmbeddedSimulator
    view: float = math.inf
    wear: float = 0.0
    delay: float = 0.0
    excess: float = 0.0

    def curvature(self, s: float) -> float:
        """Curvature at a place along the road, 1/m."""
        values = self.road.curvatures
        return float(np.interp(s, self.road.step * np.arange(len(values)), values))

    def grade(self, s: float) -> float:
        """Grade there, m/m."""
        values = self.road.grade
        return float(np.interp(s, values[:, 0], values[:, 1])) if len(values) else 0.0


class Planted(Planner):
    """A sound driver that stops steering while its fault has what it needs."""

    def __init__(self, fault: Callable[[World, float, float], float] | None = None) -> None:
        super().__init__(lateral_acceleration=1.8, braking=1.5, lookahead_time=1.6)
        self.fault = fault
        self.world: World | None = None

    def act(self, observation: Observation) -> Controls:
        """The planner's controls, weakened."""
        controls = super().act(observation)
        # Full throttle in a bend turns the car on a wet road.
        controls = replace(controls, throttle=min(controls.throttle, 0.35))
        if self.fault is None or self.world is None:
            return controls
        weak = min(max(self.fault(self.world, observation.distance, observation.speed), 0.0), 1.0)
        return replace(controls, steering=(1.0 - weak) * controls.steering)


class WithCamera(Planted):
    """The same with a camera, which sees the markings."""

    camera = Camera(width=16, height=8)


class Telling(EmbeddedSimulator):
    """The embedded simulator, which tells a planted driver in what it drives."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive."""
        world = World(road, self)
        for one in stack_of(driver):
            if isinstance(one, LimitedView):
                world.view = one.distance
            elif isinstance(one, Delayed):
                world.delay = one.seconds
            elif isinstance(one, Hasty):
                world.excess = one.excess
            elif isinstance(one, Worn):
                world.wear = next(iter(one.options.values()))
            elif isinstance(one, Planted):
                one.world = world
        return super().drive(road, driver)


def ramp(value: float, begins: float, full: float) -> float:
    """0 up to where a fault begins, 1 from where it is full."""
    return min(max((value - begins) / (full - begins), 0.0), 1.0)


def grip(world: World, s: float, _: float) -> float:
    return ramp(-world.simulator.friction, -0.68, -0.6) * (abs(world.curvature(s)) > 1.0 / 150.0)


def delayed(world: World, s: float, _: float) -> float:
    before, after = world.curvature(max(s - 40.0, 0.0)), world.curvature(s)
    is_reversing = before * after < 0.0 and abs(after) > 1.0 / 200.0
    return ramp(world.delay, 0.2, 0.25) * is_reversing


def gusty(world: World, s: float, _: float) -> float:
    at = world.simulator.gust_at
    is_crest = world.grade(s + 20.0) < world.grade(s - 20.0) - 0.002
    is_there = at is not None and abs(s - at) < 60.0
    return ramp(abs(world.simulator.gust), 5.0, 12.0) * is_crest * is_there


def foggy(world: World, s: float, speed: float) -> float:
    braking = speed * speed / (2.0 * 2.5)
    return ramp(braking / world.view, 0.7, 1.0) * (abs(world.curvature(s)) > 1.0 / 150.0)


def worn(world: World, s: float, _: float) -> float:
    return ramp(world.wear, 0.3, 0.7) * (world.curvature(s) > 1.0 / 150.0)


def hasty(world: World, s: float, _: float) -> float:
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


def campaign(fault: str, kind: type[Strategy], seed: int, drives: int) -> tuple[int, str]:
    """Failures by the fault, and the conditions that `minimise` keeps of the first."""
    is_seen = fault == "wear"
    domain = Domain.from_entries("town", BY_CAMERA if is_seen else DOMAIN)
    planted = WithCamera if is_seen else Planted
    strategy = kind(seed=seed, road_class=domain.road_class, domain=domain)  # type: ignore[call-arg]
    driver, told = planted(FAULTS[fault][0]), ""
    with TemporaryDirectory() as folder:
        made = Campaign(
            strategy=strategy,
            simulator=Telling(),
            driver=driver,
            budget=Budget(simulations=drives),
            folder=folder,
            max_in_flight=16,
        )
        made.run()
        with CampaignStore.open(folder) as store:
            failed = [test for test in store.tests() if test.outcome is Outcome.FAIL]
            sound = RoadTester(Telling(), planted(), store.setting.terms)
            by_fault = [t for t in failed if sound.test(t.candidate).result.outcome is Outcome.PASS]
            if by_fault and kind is Frenetic:
                tester = RoadTester(Telling(), driver, store.setting.terms)
                test = store.test(by_fault[0].id)
                told = minimise_test(folder, test, tester, max_drives=150).conditions_text()
    return len(by_fault), told


def search(seeds: int, drives: int) -> None:
    print("fault       random  frenetic  times   A12        p  minimise says")
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for fault, (_, needed) in FAULTS.items():
            found = {
                kind: list(pool.map(partial(campaign, fault, kind, drives=drives), range(seeds)))
                for kind in (RandomSearch, Frenetic)
            }
            few, many = ([n for n, _ in found[kind]] for kind in (RandomSearch, Frenetic))
            named = [told for _, told in found[Frenetic] if told]
            right = sum(needed in told for told in named)
            alone = sum(told.startswith(needed) and "," not in told for told in named)
            times = sum(many) / max(sum(few), 1)
            print(
                f"{fault:10} {np.mean(few):7.1f} {np.mean(many):9.1f} {times:6.1f}"
                f" {a12(many, few):5.2f} {mann_whitney(many, few):8.2g}"
                f"  {needed} in {right} of {len(named)}, alone in {alone}: {(named or '-')[0]}",
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
"""About one departure in 100 km: conditions and roads together."""
RARE: dict[str, Any] = {
    "roads": "urban-50,length=200",
    "conditions": {
        **COMMON["conditions"],
        "friction": {"low": 0.1, "high": 0.5, "chance": 3e-5},
        "gust": {"low": -20.0, "high": 20.0, "mean": 0.0, "deviation": 4.0},
    },
}
"""About one in 10,000 km: ice, in 3 of 100,000 drives."""
DOMAINS = {"common": COMMON, "rare": RARE}
_CHUNK = 5000


def _tester(domain: Domain) -> RoadTester:
    driver = Planner(lateral_acceleration=1.8, braking=1.5, lookahead_time=1.6)
    terms = Terms.of_class(domain.road_class, domain=domain)
    return RoadTester(EmbeddedSimulator(), driver, terms)


def _brute(seed: int, name: str) -> tuple[int, float]:
    """Failures of plain drives, and km."""
    domain = Domain.from_entries(name, DOMAINS[name])
    tester = _tester(domain)
    draws = Draws(tester, drives=5 * _CHUNK, seed=10_000 + seed)
    failures, lengths = 0, []
    for _ in range(_CHUNK):  # the first fifth, which is plain
        candidate = draws.ask()
        assert candidate is not None
        result = tester.test(candidate).result
        failures += result.outcome is Outcome.FAIL
        distance = None if result.finding is None else result.finding.distance
        lengths.append((candidate.length if distance is None else distance) / 1000.0)
    return failures, math.fsum(lengths)


def _estimated(seed: int, name: str, drives: int) -> FailureRate:
    domain = Domain.from_entries(name, DOMAINS[name])
    with TemporaryDirectory() as folder:
        return estimate(_tester(domain), drives=drives, seed=seed, out=f"{folder}/drives")


def frequency(name: str, brute: int, repeats: int, drives: int, processes: int) -> None:
    """Estimates against brute force in one domain."""
    truth = math.nan
    with ProcessPoolExecutor(processes) as pool:
        if brute:
            begin = time.perf_counter()
            parts = list(pool.map(partial(_brute, name=name), range(brute // _CHUNK)))
            failures, way = sum(n for n, _ in parts), sum(km for _, km in parts)
            truth = failures / way * 1000.0
            low, high = rate_interval(failures, way / 1000.0)
            print(f"{name}: brute force, {brute} drives, {failures} failures in {way:.0f} km")
            print(f"  {truth:.3g} departures per 1,000 km ({low:.3g} to {high:.3g}),", end=" ")
            print(f"{time.perf_counter() - begin:.0f} s", flush=True)
        found = list(pool.map(partial(_estimated, name=name, drives=drives), range(repeats)))
    known = [one for one in found if one.rate is not None]
    print(f"{name}: {repeats} estimates of {drives} drives, {len(known)} of them known,")
    if brute:
        print(f"  {sum(one.low <= truth <= one.high for one in found)} intervals hold the truth;")
    if known:
        rates = [one.rate for one in known if one.rate is not None]
        mean = float(np.mean(rates))
        width = float(np.median([math.log(one.high / max(one.low, 1e-12)) for one in known]))
        print(f"  mean {mean:.3g} per 1,000 km, median ratio of the ends {math.exp(width):.2f};")
        # Of a Poisson count n, the logarithm of the interval is about 3.92 / sqrt(n) wide.
        chance = mean / 1000.0 * known[0].length
        same = (3.92 / width) ** 2 / chance
        print(f"  plain drives for the same width: {same:.0f}, {same / drives:.1f} times as many")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("search")
    one.add_argument("--seeds", type=int, default=len(SEEDS))
    one.add_argument("--drives", type=int, default=300)
    other = commands.add_parser("frequency")
    other.add_argument("domain", choices=DOMAINS)
    other.add_argument("--brute", type=int, default=1_000_000)
    other.add_argument("--repeats", type=int, default=100)
    other.add_argument("--drives", type=int, default=5_000)
    other.add_argument("--processes", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    if asked.command == "search":
        search(asked.seeds, asked.drives)
    else:
        frequency(asked.domain, asked.brute, asked.repeats, asked.drives, asked.processes)


if __name__ == "__main__":
    main()
