"""Makes the tables and pictures of docs/bench-results.md: ``python docs/make_bench_results.py``.

Runs the benches of that page, ten repeats each: half an hour on two cores. The campaigns and pages
stay in the folder that is given, or in ``benches/published`` of the current one. Names of benches
after the folder run only these.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from frenetic import CampaignStore, EmbeddedSimulator, Planner
from frenetic.analysis import Comparison
from frenetic.analysis.failures import Failure, cluster_failures, failures_of
from frenetic.bench import Bench, Entrant, Terms
from frenetic.bench.results import write_results
from frenetic.campaign.workers import available_cores
from frenetic.drivers import Driver
from frenetic.report.comparison import draw_comparison

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "bench-results.md"
REPEATS = 10
SECONDS_PER_TEST = 36.0
THRESHOLDS = (1.0, 2.0, 3.0)  # [m]
PATH_THRESHOLD = 2.0  # [m]
PATH_STEP = 5.0  # [m]

BASELINE = "random"
ENTRANTS = (
    Entrant(name=BASELINE, spec="random", is_strategy=True),
    Entrant(name="Frenetic 2021", spec="frenetic-2021", is_strategy=True),
    Entrant(name="Frenetic", spec="frenetic", is_strategy=True),
)
ABLATIONS = tuple(
    Entrant(name=name, spec="frenetic", is_strategy=True, options=options)
    for name, options in {
        "no archive": {"use_archive": False},
        "fixed threshold": {"threshold": -0.5},
        "equal shares": {"learn_shares": False},
        "no speed model": {"predict_speeds": False},
    }.items()
)


@dataclass(frozen=True)
class Published:
    """A bench of the page."""

    name: str
    driver: Driver
    simulations: int
    entrants: tuple[Entrant, ...] = ENTRANTS


BENCHES = (
    Published("planner-200", Planner(), 200, ENTRANTS + ABLATIONS),
    Published("planner-1000", Planner(), 1000),
    Published("gentle-1000", Planner(lateral_acceleration=7.0), 1000),
)
MEASURES = (
    "distinct_per_100",
    "distinct_failures",
    "failures",
    "tests",
    "invalid_share",
    "cells",
    "competition_cells",
    "pairwise_diversity",
    "competition_sparseness",
    "simulations_to_failure",
    "generator_seconds",
)


def main(folder: Path, names: list[str]) -> None:
    """Runs the missing benches and writes their tables."""
    for published in BENCHES:
        if names and published.name not in names:
            continue
        bench = Bench(
            entrants=published.entrants,
            terms=Terms(
                simulator=EmbeddedSimulator(),
                driver=published.driver,
                budget=published.simulations * SECONDS_PER_TEST,
                seconds_per_test=SECONDS_PER_TEST,
                records="none",
            ),
            repeats=REPEATS,
            folder=folder / published.name,
        )
        resume = (bench.folder / "bench.json").exists()
        for end in bench.run(resume=resume, workers=available_cores()):
            print(published.name, end.run.entrant.name, end.run.repeat, end.ending or end.trouble)
        comparison = bench.comparison()
        print(write_results(bench, comparison, command="python docs/make_bench_results.py"))
        draw_comparison(comparison, DOCS / "images" / f"bench-{published.name}.svg")
        page = PAGE.read_text(encoding="utf-8")
        page = with_table(page, f"bench-{published.name}", table(comparison, published.entrants))
        page = with_table(page, f"pairs-{published.name}", pairs(comparison, published.entrants))
        page = with_table(page, f"distances-{published.name}", distances(bench))
        PAGE.write_text(page, encoding="utf-8")


def distances(bench: Bench) -> str:
    """Distinct failures at several thresholds, and by another distance: medians over the runs."""
    counted: dict[str, list[list[int]]] = {entrant.name: [] for entrant in bench.entrants}
    for state in bench.states():
        with CampaignStore.open(state.run.folder) as store:
            failures = failures_of(store)
        counted[state.run.entrant.name].append(
            [
                *(len(cluster_failures(failures, threshold=one)) for one in THRESHOLDS),
                distinct_paths(failures),
            ]
        )
    lines = [["distinct failures", *counted], ["---", *["---:"] * len(counted)]]
    headings = [*(f"at {one:g} m" for one in THRESHOLDS), "by dynamic time warping of the paths"]
    for k, heading in enumerate(headings):
        medians = (np.median([run[k] for run in runs]) for runs in counted.values())
        lines.append([heading, *(f"{median:g}" for median in medians)])
    return markdown(lines)


def distinct_paths(failures: list[Failure]) -> int:
    """Number of failures of which none is within `PATH_THRESHOLD` of one counted before.

    The distance is that of the driven paths over the 30 m before the place, by dynamic time
    warping: the least mean distance of points that are matched in order. It knows neither speed nor
    what lies ahead, and shares no code with `frenetic.analysis`.
    """
    kept: dict[object, list[np.ndarray]] = {}
    count = 0
    for failure in failures:
        path = _path(failure)
        others = kept.setdefault(failure.side, [])
        if all(_warped(path, other) >= PATH_THRESHOLD for other in others):
            others.append(path)
            count += 1
    return count


def _path(failure: Failure) -> np.ndarray:
    """The driven path before the place, (7, 2) in m."""
    road = failure.road[: len(failure.offsets)]
    along = np.gradient(road, axis=0)
    normal = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, np.newaxis]
    path: np.ndarray = (road + normal * failure.offsets[:, np.newaxis])[:: round(PATH_STEP / 2.5)]
    return path


def _warped(one: np.ndarray, other: np.ndarray) -> float:
    """Mean distance of two paths in m, matched in order."""
    apart = np.hypot(*(one[:, np.newaxis] - other[np.newaxis]).transpose(2, 0, 1))
    n, m = apart.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0.0
    for i in range(n):
        for j in range(m):
            least = min(total[i, j], total[i, j + 1], total[i + 1, j])
            total[i + 1, j + 1] = apart[i, j] + least
    return float(total[n, m]) / max(n, m)


def table(comparison: Comparison, entrants: tuple[Entrant, ...]) -> str:
    """A row per measure, a column per entrant: medians and quartiles."""
    names = [entrant.name for entrant in entrants]
    lines = [["median (quartiles)", *names], ["---", *["---:"] * len(names)]]
    for name in MEASURES:
        by = comparison.by(name)
        lines.append([by.measure.heading, *(by.text(group) for group in names)])
    return markdown(lines)


def pairs(comparison: Comparison, entrants: tuple[Entrant, ...]) -> str:
    """Effect sizes and corrected p against the baseline."""
    others = [entrant.name for entrant in entrants if entrant.name != BASELINE]
    lines = [["against random: A12, p", *others], ["---", *["---:"] * len(others)]]
    for name in MEASURES:
        by = comparison.by(name)
        if by.measure.more_is_better is None:
            continue
        cells = []
        for other in others:
            pair = next(p for p in by.pairs if {p.first, p.second} == {BASELINE, other})
            pair = pair if pair.first == other else pair.turned
            cells.append(f"{pair.a12:.2f}, {pair.p_corrected:.2g}")
        lines.append([by.measure.heading, *cells])
    return markdown(lines)


def markdown(lines: list[list[str]]) -> str:
    """A table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def with_table(page: str, name: str, text: str) -> str:
    """The page with a table between its marks."""
    marked = re.compile(f"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    assert len(marked.findall(page)) == 1, name
    return marked.sub(lambda found: f"{found[1]}{text}{found[2]}", page)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "benches/published"), sys.argv[2:])
