"""How many failures a search finds, how different they are, and what it wastes.

    python benchmarks/search_quality.py [--simulations 1000] [--seeds 10] [--driver planner]
        [--strategy frenetic --strategy random] [--max-redraws N] [--json FILE]

Every strategy searches once with each of the seeds 1 .. N, in the embedded simulator with its
default rules, on the default map. Each is compared with the strategy named last, the baseline. The
same call prints the same figures on the same machine. Per search:

failures        simulations that ended in FAIL
distinct roads  failing roads that are not exactly equal: curvature values differ somewhere
different       failures whose road differs from that of every failure counted before: counted
                greedily in the order of testing, if the root mean square difference of the
                curvature along the segments, 30 m before to 30 m after the place of the failure,
                is more than 0.01 1/m from each one counted
invalid         share of the proposals that were INVALID and so not driven; our strategies draw a
                refused road again before they propose it, which --max-redraws 0 turns off
first failure   number of the test, counted with the refused ones, that failed first; one more than
                all tests where none did

A12 is Vargha and Delaney's effect size: the chance that a search of the strategy has a larger
figure than one of the baseline, ties counted half. 0.5 is no difference, 1 means that every seed
has more than every seed of the baseline, 0 that every seed has less. (More is better but for
"invalid" and "first failure".) p is that of a two-sided Mann-Whitney U test.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.stats import mannwhitneyu

from frenetic.analysis import segment_profile
from frenetic.campaign import Budget, RoadTester
from frenetic.drivers import Driver
from frenetic.errors import FreneticError
from frenetic.oracle import Result
from frenetic.outcome import Outcome
from frenetic.registry import DRIVERS, STRATEGIES
from frenetic.road import Road
from frenetic.search import Candidate, Evaluation, Strategy
from frenetic.simulators import EmbeddedSimulator

FloatArray: TypeAlias = npt.NDArray[np.float64]

FIRST_SEED: Final = 1
THRESHOLD: Final = 0.01
"""1/m, root mean square difference of curvature from which on two failures count as different."""


@dataclass(frozen=True)
class Found:
    """What one search came to; the fields after `seed` are the figures that are compared."""

    strategy: str
    seed: int
    failures: int
    distinct_roads: int
    different: int
    invalid: float
    """Share, 0..1."""
    first_failure: int


@dataclass(frozen=True)
class Spread:
    """One figure over all seeds."""

    mean: float
    least: float
    lower: float
    """First quartile."""
    median: float
    upper: float
    """Third quartile."""
    most: float

    @classmethod
    def of(cls, values: FloatArray) -> Spread:
        """The spread of (seeds,) values."""
        least, lower, median, upper, most = np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])
        return cls(
            float(values.mean()),
            float(least),
            float(lower),
            float(median),
            float(upper),
            float(most),
        )


@dataclass(frozen=True)
class Comparison:
    """One figure of a strategy against the baseline's."""

    ratio_of_means: float | None
    """None where the baseline's mean is 0."""
    a12: float
    p: float


FIGURES: Final = {
    "failures": "failures",
    "distinct_roads": "distinct roads",
    "different": "different",
    "invalid": "invalid",
    "first_failure": "first failure",
}
"""Field of `Found` -> heading."""


def search(name: str, strategy: Strategy, driver: Driver, simulations: int, seed: int) -> Found:
    """One search until its simulations are spent; nothing is stored."""
    roads = RoadTester(EmbeddedSimulator(), driver)
    budget = Budget(simulations=simulations)
    tests = driven = 0
    first: int | None = None
    exact: set[tuple[float, bytes]] = set()
    profiles: list[FloatArray] = []
    failures = 0
    while driven < simulations:
        candidate = strategy.ask()
        result = roads.test(candidate).result
        tests += 1
        driven += result.outcome is not Outcome.INVALID
        spent = budget.spent(driven, 0.0, 0)
        strategy.tell(Evaluation(candidate, result.outcome, result.moobd, spent))
        if result.outcome is Outcome.ERROR:
            raise RuntimeError(f"a drive broke: {result.reason}")
        if result.outcome is Outcome.FAIL:
            failures += 1
            first = first or tests
            exact.add((candidate.step, candidate.curvatures.tobytes()))
            profiles.append(profile(candidate, result))
    return Found(
        strategy=name,
        seed=seed,
        failures=failures,
        distinct_roads=len(exact),
        different=count_different(profiles),
        invalid=(tests - driven) / tests,
        first_failure=first or tests + 1,
    )


def profile(candidate: Candidate, result: Result) -> FloatArray:
    """Curvature around where the car left its lane or, if it did not, was furthest from it."""
    place = result.departure.distance if result.departure else result.moobd_distance
    return segment_profile(Road(candidate.curvatures, candidate.step), place or 0.0)


def count_different(profiles: Sequence[FloatArray]) -> int:
    """How many profiles differ by more than `THRESHOLD` from every one counted before."""
    counted: list[FloatArray] = []
    for one in profiles:
        if counted:
            difference = np.sqrt(((np.array(counted) - one) ** 2).mean(axis=1))
            if difference.min() <= THRESHOLD:
                continue
        counted.append(one)
    return len(counted)


def compare(values: FloatArray, baseline: FloatArray) -> Comparison:
    """Effect size and test of one figure, see this module's text."""
    larger = (values[:, None] > baseline).mean()
    equal = (values[:, None] == baseline).mean()
    everything = np.concatenate([values, baseline])
    # Without any difference there is nothing to rank.
    alike = bool((everything == everything[0]).all())
    p = 1.0 if alike else float(mannwhitneyu(values, baseline, alternative="two-sided").pvalue)
    mean = float(baseline.mean())
    return Comparison(float(values.mean()) / mean if mean else None, float(larger + equal / 2), p)


def column(found: Sequence[Found], strategy: str, figure: str) -> FloatArray:
    """(seeds,) one figure of one strategy."""
    return np.array(
        [getattr(one, figure) for one in found if one.strategy == strategy], dtype=float
    )


def in_words(figure: str, value: float) -> str:
    """A figure as the tables show it."""
    return f"{value:.1%}" if figure == "invalid" else f"{value:.4g}"


def print_searches(found: Sequence[Found]) -> None:
    print(f"\n{'strategy':<12}{'seed':>5}" + "".join(f"{name:>16}" for name in FIGURES.values()))
    for one in found:
        cells = [in_words(figure, getattr(one, figure)) for figure in FIGURES]
        print(f"{one.strategy:<12}{one.seed:>5}" + "".join(f"{cell:>16}" for cell in cells))


def print_spread(found: Sequence[Found], names: Sequence[str]) -> None:
    parts = [part.name for part in fields(Spread)]
    print(f"\n{'':<28}" + "".join(f"{part:>9}" for part in parts))
    for figure, heading in FIGURES.items():
        for name in names:
            spread = Spread.of(column(found, name, figure))
            cells = [in_words(figure, getattr(spread, part)) for part in parts]
            print(f"{heading:<16}{name:<12}" + "".join(f"{cell:>9}" for cell in cells))


def print_comparison(found: Sequence[Found], name: str, baseline: str) -> None:
    print(f"\n{name} against {baseline}: {'ratio of means':>18}{'A12':>8}{'p':>11}")
    for figure, heading in FIGURES.items():
        c = compare(column(found, name, figure), column(found, baseline, figure))
        ratio = "-" if c.ratio_of_means is None else f"{c.ratio_of_means:.2f}"
        indent = len(f"{name} against {baseline}: ")
        print(f"{heading:<{indent}}{ratio:>18}{c.a12:>8.3f}{c.p:>11.2g}")


def write_json(
    path: Path, options: argparse.Namespace, found: Sequence[Found], names: Sequence[str]
) -> None:
    baseline = names[-1]
    record = {
        "simulations": options.simulations,
        "driver": options.driver,
        "max_redraws": options.max_redraws,
        "threshold": THRESHOLD,
        "searches": [asdict(one) for one in found],
        "spread": {
            name: {f: asdict(Spread.of(column(found, name, f))) for f in FIGURES} for name in names
        },
        "against": {
            name: {
                f: asdict(compare(column(found, name, f), column(found, baseline, f)))
                for f in FIGURES
            }
            for name in names[:-1]
        },
        "baseline": baseline,
    }
    path.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--simulations", type=int, default=1000, help="of each search")
    parser.add_argument("--seeds", type=int, default=10, help="searches of each strategy")
    parser.add_argument("--driver", default="planner")
    parser.add_argument(
        "--strategy", action="append", metavar="S", help="may be repeated; the last is the baseline"
    )
    parser.add_argument("--max-redraws", type=int, metavar="N", help="option of the strategies")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there, too")
    options = parser.parse_args()
    if options.simulations < 1 or options.seeds < 1:
        parser.error("--simulations and --seeds of at least 1 are needed")
    names = list(dict.fromkeys(options.strategy or ["frenetic", "random"]))
    more = {} if options.max_redraws is None else {"max_redraws": options.max_redraws}
    print(f"{options.simulations} simulations per search, driver {options.driver}", flush=True)
    found = []
    try:
        for name in names:
            for seed in range(FIRST_SEED, FIRST_SEED + options.seeds):
                strategy = STRATEGIES.make(name, seed=seed, **more)
                driver = DRIVERS.make(options.driver)
                found.append(search(name, strategy, driver, options.simulations, seed))
    except (FreneticError, RuntimeError) as error:
        print(f"search_quality: {error}", file=sys.stderr)
        return 2
    print_searches(found)
    print_spread(found, names)
    for name in names[:-1]:
        print_comparison(found, name, names[-1])
    if options.json is not None:
        try:
            write_json(options.json, options, found, names)
        except OSError as error:
            print(f"search_quality: cannot write {options.json}: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
