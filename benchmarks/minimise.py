"""How much shorter and plainer failing roads become by minimising, and what minimising costs.

    python benchmarks/minimise.py [--seeds 5] [--failures 10] [--simulations 1000]
        [--max-drives 500] [--driver planner] [--json FILE]

For each seed 1 .. N, the strategy `frenetic-2021` searches in the embedded simulator, with the
default rules on the default map. Of each search, `--failures` failures are minimised, evenly spaced
in the order in which they were found. The same call prints the same figures on the same machine,
except times.

A new simulator and driver drive every minimised road once more. The benchmark ends with an error if
a minimised road does not have the failure of its original.

length share    length of the minimised road, per length of the original
difference      of the two roads' failures in m, as for distinct failures
still fails     share of the roads that fail for the same reason when something changes: all
                curvatures, the friction, the speed limit, the driver's noise (five seeds), or each
                curvature by its own value up to 0.001 1/m (five draws)
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from frenetic.analysis.clusters import THRESHOLD
from frenetic.analysis.failures import Failure
from frenetic.campaign import RoadTester
from frenetic.drivers import Driver, Noisy
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.parts.registry import DRIVERS
from frenetic.rerun.minimise import MAX_DRIVES, Minimised, StopReason, minimise
from frenetic.rerun.minimising_strategy import FailureReason
from frenetic.road import Road
from frenetic.search import Candidate, Frenetic2021
from frenetic.segments.segment import segment_of
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.simulators.embedded import compile_kernels
from frenetic.testing import converse

Change = Callable[[Road], "FailureReason | None"]
"""Function that changes something, drives a road, and returns why the drive failed."""


@dataclass(frozen=True)
class Spread:
    """Quartiles and extremes of a figure over all failures."""

    least: float
    lower: float
    """First quartile."""
    median: float
    upper: float
    """Third quartile."""
    most: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the spread of values."""
        return cls(*(float(v) for v in np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])))


@dataclass(frozen=True)
class Figures:
    """Results of minimising."""

    failures: int
    length_before: Spread
    length: Spread
    length_share: Spread
    curves_before: Spread
    curves: Spread
    drives: Spread
    seconds: Spread
    minimal: float
    """Share of the roads that no pass makes smaller."""
    difference: Spread
    """Difference of the failures of original and minimised road, in m."""
    different: int
    """Number of different minimised roads."""


def find_failures(seed: int, simulations: int, driver: Driver, number: int) -> list[Road]:
    """Return `number` failing roads of a search, evenly spaced in the order of finding."""
    tester = RoadTester(EmbeddedSimulator(), driver)
    failing: list[Road] = []

    def verdict(candidate: Candidate) -> tuple[Outcome, float | None]:
        result = tester.test(candidate).result
        if result.outcome is Outcome.FAIL:
            failing.append(Road(candidate.curvatures, candidate.step))
        return result.outcome, result.moobd

    converse(Frenetic2021(seed=seed), verdict, simulations)
    count = min(number, len(failing))
    return [failing[i * len(failing) // count] for i in range(count)]


def measure(
    roads: Sequence[Road], driver: Driver, max_drives: int
) -> tuple[Figures, list[Minimised]]:
    """Minimise all roads, and check each result with a new simulator."""
    tester = RoadTester(EmbeddedSimulator(), driver)
    results, seconds = [], []
    for road in roads:
        start = time.perf_counter()
        minimised = minimise(road, tester, max_drives=max_drives)
        seconds.append(time.perf_counter() - start)
        results.append(minimised)
        if not has_same_failure(minimised, EmbeddedSimulator().drive(minimised.road, driver)):
            sys.exit(f"{minimised.road.curvatures} does not have the same failure any more")
    before = [result.shapes[0] for result in results]
    after = [result.shapes[1] for result in results]
    return Figures(
        failures=len(results),
        length_before=Spread.of([shape.length for shape in before]),
        length=Spread.of([shape.length for shape in after]),
        length_share=Spread.of(
            [new.length / old.length for old, new in zip(before, after, strict=True)]
        ),
        curves_before=Spread.of([shape.curves for shape in before]),
        curves=Spread.of([shape.curves for shape in after]),
        drives=Spread.of([result.drives for result in results]),
        seconds=Spread.of(seconds),
        minimal=float(np.mean([result.stop_reason is StopReason.MINIMAL for result in results])),
        difference=Spread.of([result.difference for result in results]),
        different=len(set(after)),
    ), results


def failure_reason(road: Road, drive: Drive) -> FailureReason | None:
    """Return the reason why a drive failed; None if it passed."""
    result = judge(road, drive)
    if result.outcome is not Outcome.FAIL:
        return None
    return FailureReason.of(result.departure, result.duration, drive.rules.timeout(road.length))


def has_same_failure(minimised: Minimised, drive: Drive) -> bool:
    """Return whether a drive on the minimised road has the failure of the original."""
    before = Failure.of_test(minimised.original)
    result = judge(minimised.road, drive)
    segment = segment_of(minimised.road, drive, result.finding)
    after = Failure.of_judged(result, segment)
    is_like = before is not None and after is not None and after.difference(before) <= THRESHOLD
    return is_like and failure_reason(minimised.road, drive) is minimised.reason


def changes(make_driver: Callable[[], Driver]) -> dict[str, list[Change]]:
    """Return changes by name, each with one or several variants."""

    def reason(road: Road, simulator: EmbeddedSimulator, driver: Driver) -> FailureReason | None:
        return failure_reason(road, simulator.drive(road, driver))

    def scaled(factor: float) -> Change:
        return lambda road: reason(
            Road(factor * road.curvatures, road.step), EmbeddedSimulator(), make_driver()
        )

    def shaken(seed: int) -> Change:
        def change(road: Road) -> FailureReason | None:
            rng = np.random.default_rng(seed)
            values = road.curvatures + rng.uniform(-0.001, 0.001, len(road.curvatures))
            return reason(Road(values, road.step), EmbeddedSimulator(), make_driver())

        return change

    def simulated(simulator: EmbeddedSimulator) -> Change:
        return lambda road: reason(road, simulator, make_driver())

    def noisy(seed: int) -> Change:
        return lambda road: reason(
            road, EmbeddedSimulator(), Noisy(make_driver(), offset=0.05, heading=0.005, seed=seed)
        )

    def limited(speed: float) -> Change:
        return simulated(EmbeddedSimulator(rules=Rules(speed_limit=speed)))

    return {
        "curvatures -2 %": [scaled(0.98)],
        "curvatures +2 %": [scaled(1.02)],
        "each curvature by up to 0.001 1/m": [shaken(seed) for seed in range(5)],
        "speed limit 69 km/h": [limited(69.0)],
        "speed limit 71 km/h": [limited(71.0)],
        "noise of 0.05 m": [noisy(seed) for seed in range(5)],
        "friction -2 %": [simulated(EmbeddedSimulator(friction=0.98))],
        "friction +2 %": [simulated(EmbeddedSimulator(friction=1.02))],
    }


def still_failing(roads: Sequence[tuple[Road, FailureReason]], variants: Sequence[Change]) -> float:
    """Return the share of the drives that fail for the same reason."""
    return float(
        np.mean([variant(road) is reason for road, reason in roads for variant in variants])
    )


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5, help="number of searches")
    parser.add_argument("--failures", type=int, default=10, help="of each search")
    parser.add_argument("--simulations", type=int, default=1000, help="of each search")
    parser.add_argument("--max-drives", type=int, default=MAX_DRIVES, help="to minimise a road")
    parser.add_argument("--driver", default="planner")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()

    def make_driver() -> Driver:
        driver: Driver = DRIVERS.make(options.driver)
        return driver

    compile_kernels()
    roads = [
        road
        for seed in range(1, options.seeds + 1)
        for road in find_failures(seed, options.simulations, make_driver(), options.failures)
    ]
    figures, results = measure(roads, make_driver(), options.max_drives)

    print(f"{len(roads)} failures of {options.seeds} searches, {options.driver}\n")
    print(f"{'':16}{'least':>8}{'lower':>8}{'median':>8}{'upper':>8}{'most':>8}")
    for name in (
        "length_before", "length", "length_share", "curves_before", "curves", "drives",
        "difference", "seconds",
    ):  # fmt: skip
        spread = getattr(figures, name)
        digits = 2 if name in ("length_share", "difference", "seconds") else 0
        row = "".join(f"{value:8.{digits}f}" for value in asdict(spread).values())
        print(f"{name.replace('_', ' '):16}{row}")
    print(f"minimal {figures.minimal:.0%}, different roads {figures.different}\n")
    print(f"{'still fails with':36}{'original':>10}{'minimised':>10}")
    still_fails = {}
    for name, variants in changes(make_driver).items():
        shares = [
            still_failing([(r.original.road, r.reason) for r in results], variants),
            still_failing([(r.road, r.reason) for r in results], variants),
        ]
        still_fails[name] = shares
        print(f"{name:36}" + "".join(f"{share:10.0%}" for share in shares))
    if options.json is not None:
        document = {"figures": asdict(figures), "still_fails": still_fails}
        options.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
