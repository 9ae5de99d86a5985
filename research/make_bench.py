"""Make the tables and pictures of research/bench.md: ``python research/make_bench.py``.

The command runs all benches of that page, or the named benches: about two hours on two cores. Each
run is a campaign in `--folder`, as `frenetic bench` makes it. Stop the command and give it again,
and it continues: it keeps complete runs with today's versions of strategy, driver, simulator and
rules.
"""

from __future__ import annotations

import argparse
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic import Campaign, CampaignStore
from frenetic._support.option_text import part_word
from frenetic.analysis import Comparison
from frenetic.analysis.clusters import cluster_failures
from frenetic.analysis.comparison import MeasureComparison, PairComparison, compare
from frenetic.analysis.comparison_text import p_text
from frenetic.analysis.failures import Failure, failures_of
from frenetic.campaign.database import DATABASE
from frenetic.campaign.workers import available_cores
from frenetic.plugins.bench import Entrant
from frenetic.report.plots import draw_comparison
from frenetic.spec import Spec
from frenetic.spec.part_record import changed_parts

HERE: Final = Path(__file__).resolve().parent
PAGE: Final = HERE / "bench.md"
PEERS: Final = HERE.parent / "benchmarks" / "ribs_search.py"
STEADY: Final = HERE.parent / "benchmarks" / "steady.py"
SEEDS: Final = range(1, 21)
"""Seeds on which nothing was tuned: strategies were tuned on seeds 101 to 124 and 201 to 206."""
THRESHOLDS: Final = (1.0, 2.0, 3.0)
"""Differences from which two failures are distinct, in m."""
PATH_THRESHOLD: Final = 2.0
"""Distance from which two driven paths are distinct, in m."""
PATH_STEP: Final = 5.0
"""Distance between the compared points of a driven path, in m."""
OFFSET_STEP: Final = 2.5
"""Distance between the offsets of a `Failure`, in m."""


def _strategy(name: str, spec: str, **options: Any) -> Entrant:
    return Entrant(name=name, spec=spec, is_strategy=True, options=options)


def _peer(name: str, algorithm: str) -> Entrant:
    return _strategy(name, f"{PEERS}:RibsSearch", algorithm=algorithm)


RANDOM: Final = _strategy("random", "random")
LISTING_1: Final = _strategy("Frenetic 2021", "frenetic-2021")
OURS: Final = _strategy("Frenetic", "frenetic")
MAP_ELITES: Final = _peer("MAP-Elites", "map-elites")
CMA_MAE: Final = _peer("CMA-MAE", "cma-mae")
ENTRANTS: Final = (RANDOM, LISTING_1, OURS, MAP_ELITES, CMA_MAE)
EXPLOITATION: Final = (
    _strategy("lowest first", "frenetic-2021", threshold=2.0),
    _peer("CMA-ES", "cma-es"),
)


@dataclass(frozen=True)
class PageBench:
    """A bench of the page."""

    name: str
    simulations: int
    entrants: tuple[Entrant, ...] = ENTRANTS
    drive: Mapping[str, Any] = field(default_factory=dict)
    """Entries of a spec that say how roads are driven."""
    seeds: Sequence[int] = SEEDS
    is_main: bool = False
    """Whether the page has a picture of the bench, and distinct failures by other distances."""

    def campaign(self, entrant: Entrant, seed: int, folder: Path) -> Campaign:
        """Return the campaign of an entrant with a seed; its folder is within `folder`."""
        strategy = part_word(entrant.spec, entrant.options)
        run_entries = {"strategy": strategy, "seed": seed, "simulations": self.simulations}
        spec = Spec.of(self.drive, run_entries)
        return Campaign.of(spec, folder=folder / self.name / entrant.name / str(seed), workers=1)


def _driver(name: str, **options: Any) -> dict[str, Any]:
    return {"driver": part_word(name, options)}


BENCHES: Final = (
    PageBench("planner-200", 200, ENTRANTS, is_main=True),
    PageBench("planner-1000", 1000, is_main=True),
    PageBench(
        "gentle-1000",
        1000,
        ENTRANTS,
        drive=_driver("planner", lateral_acceleration=7.0),
        is_main=True,
    ),
    PageBench(
        "careful-1000",
        1000,
        (RANDOM, LISTING_1, OURS, CMA_MAE, *EXPLOITATION),
        _driver("planner", lateral_acceleration=6.0),
    ),
    PageBench("stanley-200", 200, ENTRANTS, _driver("stanley")),
    PageBench("stanley-1000", 1000, (RANDOM, LISTING_1, OURS), _driver("stanley")),
    PageBench("steady-200", 200, ENTRANTS, _driver(f"{STEADY}:Steady", speed=48.0)),
    PageBench(
        "metadrive-200",
        200,
        (RANDOM, LISTING_1, OURS),
        _driver("metadrive-idm", target_speed=46.0) | {"simulator": "metadrive"},
        seeds=SEEDS[:10],
    ),
    PageBench("planner-5000", 5000, (RANDOM, LISTING_1, OURS), seeds=SEEDS[:10]),
)
COLUMNS: Final = {
    "distinct_failures": "distinct failures",
    "failures": "failures",
    "cells": "cells",
    "unlike_roads": "unlike roads",
    "simulations_to_failure": "first failure",
    "min_moobd": "lowest MOOBD",
    "competition_sparseness": "competition's sparseness",
    "valid_share": "valid",
}
"""Name of a measure -> heading of its column in the table of medians."""
COMPARED: Final = (
    "distinct_failures",
    "cells",
    "unlike_roads",
    "simulations_to_failure",
    "min_moobd",
)
"""Measures in the table that compares our search with the other entrants."""


def main() -> None:
    """Run the missing campaigns, then write the tables of the complete benches."""
    options = _options()
    chosen = [bench for bench in BENCHES if not options.names or bench.name in options.names]
    if not options.tables:
        runs = [
            Run(bench, entrant, seed, options.folder)
            for bench in chosen
            for entrant in bench.entrants
            if not options.entrant or entrant.name in options.entrant
            for seed in bench.seeds
        ]
        with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
            for message in pool.map(complete, runs):
                print(message, flush=True)
    for bench in chosen:
        groups = complete_groups(bench, options.folder)
        if {RANDOM.name, LISTING_1.name, OURS.name} <= set(groups):
            write_tables(bench, groups)
    write_table("verdicts", verdicts(PAGE.read_text(encoding="utf-8")))


@dataclass(frozen=True)
class Run:
    """A campaign of an entrant with a seed."""

    bench: PageBench
    entrant: Entrant
    seed: int
    folder: Path
    """Folder of all benches."""

    def __str__(self) -> str:
        return f"{self.bench.name}, {self.entrant.name}, seed {self.seed}"


def complete(run: Run) -> str:
    """Run a campaign, unless it is complete and of today's versions; return what was done."""
    campaign = run.bench.campaign(run.entrant, run.seed, run.folder)
    if is_complete(campaign):
        return f"{run}: kept"
    if campaign.folder.exists():
        shutil.rmtree(campaign.folder)
    summary = campaign.run()
    assert summary.simulations == run.bench.simulations, summary.ended
    return f"{run}: {summary.failed} failures in {summary.seconds:.1f} s"


def is_complete(campaign: Campaign) -> bool:
    """Return whether the campaign's folder holds the whole campaign, with the same parts."""
    if not (campaign.folder / DATABASE).exists():
        return False
    with CampaignStore.open(campaign.folder) as store:
        config, facts = store.config, store.facts
    return "finished_at" in facts and not changed_parts(config, campaign.configuration())


def complete_groups(bench: PageBench, folder: Path) -> dict[str, list[Path]]:
    """Return the folders of all runs by entrant, for entrants all of whose runs are complete."""
    groups = {}
    for entrant in bench.entrants:
        campaigns = [bench.campaign(entrant, seed, folder) for seed in bench.seeds]
        if all(map(is_complete, campaigns)):
            groups[entrant.name] = [campaign.folder for campaign in campaigns]
        else:
            print(f"{bench.name}, {entrant.name}: not complete")
    return groups


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    known = [bench.name for bench in BENCHES]
    entrants = sorted({entrant.name for bench in BENCHES for entrant in bench.entrants})
    parser.add_argument(
        "names", nargs="*", metavar="BENCH", help=f"{', '.join(known)}; all by default"
    )
    parser.add_argument(
        "--folder", type=Path, default=Path("benches/published"), help="folder of all runs"
    )
    parser.add_argument("--workers", type=int, default=available_cores(), help="runs at once")
    parser.add_argument(
        "--entrant",
        action="append",
        choices=entrants,
        help="run only this entrant; may be repeated",
    )
    parser.add_argument("--tables", action="store_true", help="run nothing, only write the tables")
    options = parser.parse_args()
    if unknown := set(options.names) - set(known):
        parser.error(f"no bench is called {', '.join(sorted(unknown))}: {', '.join(known)}")
    return options


# Tables


def write_tables(bench: PageBench, groups: Mapping[str, Sequence[Path]]) -> None:
    """Write the tables of a bench, and the picture of a main bench."""
    compared = compare(groups)
    for note in compared.notes:
        print(f"{bench.name}: {note}")
    tables = {"bench": table(compared), "pairs": pairs(compared)}
    if bench.is_main:
        draw_comparison(compared, HERE / "images" / f"bench-{bench.name}.svg")
        tables["distances"] = distances({name: groups[name] for name in compared.groups})
    for kind, text in tables.items():
        write_table(f"{kind}-{bench.name}", text)


def table(comparison: Comparison) -> str:
    """Return the table of medians and quartiles: a row per entrant, a column per measure."""
    names = [name for name in COLUMNS if name in telling_measures(comparison)]
    rows = {
        group: [group, *(comparison.by(name).text(group) for name in names)]
        for group in comparison.groups
    }
    return markdown(
        [
            ["median (quartiles)", *(COLUMNS[name] for name in names)],
            ["---", *["---:"] * len(names)],
            *rows.values(),
        ]
    )


def pairs(comparison: Comparison) -> str:
    """Return the table of verdict, A12 and corrected p of our search against each entrant."""
    names = [name for name in COMPARED if name in telling_measures(comparison)]
    lines = [
        ["Frenetic against", *(COLUMNS[name] for name in names)],
        ["---", *["---"] * len(names)],
    ]
    for other in comparison.groups:
        if other != OURS.name:
            comparisons = (comparison.by(name) for name in names)
            lines.append([other, *(_pair_text(_pair(by, other)) for by in comparisons)])
    return markdown(lines)


def verdicts(page: str) -> str:
    """Return the table of verdicts against random roads and Listing 1, from the page's tables."""
    lines = [["bench", "against", *(COLUMNS[name] for name in COMPARED)]]
    lines.append(["---"] * len(lines[0]))
    for bench in BENCHES:
        marked = re.search(f"<!-- pairs-{bench.name} -->\n(.*?)<!-- end -->", page, re.DOTALL)
        rows = [line.strip("| ").split(" | ") for line in marked[1].splitlines()] if marked else []
        for row in rows:
            if row[0] in (RANDOM.name, LISTING_1.name):
                verdict_of = {
                    head: cell.partition(" (")[0] for head, cell in zip(rows[0], row, strict=True)
                }
                cells = (verdict_of.get(COLUMNS[name], "") for name in COMPARED)
                lines.append([bench.name, row[0], *cells])
    return markdown(lines)


def telling_measures(comparison: Comparison) -> set[str]:
    """Return the measures that differ between runs; lowest MOOBD only if random roads pass."""
    names = {
        by.measure.name
        for by in comparison.measures
        if len({value for values in by.values.values() for value in values}) > 1
    }
    do_random_roads_fail = comparison.by("failures").quartiles(RANDOM.name).median > 0
    return names - {"min_moobd"} if do_random_roads_fail else names


def _pair(by: MeasureComparison, other: str) -> PairComparison:
    """Return the comparison of our search, as the first of the pair, with another entrant."""
    pair = next(p for p in by.pairs if {p.first, p.second} == {OURS.name, other})
    if pair.first == OURS.name:
        return pair
    return replace(
        pair,
        first=pair.second,
        second=pair.first,
        a12=1.0 - pair.a12,
        repeats=pair.repeats[::-1],
    )


def _verdict(pair: PairComparison) -> str:
    if pair.better is None:
        return "cannot tell"
    return "better" if pair.better == pair.first else "worse"


def _pair_text(pair: PairComparison) -> str:
    return f"{_verdict(pair)} ({pair.a12:.2f}, {p_text(pair.p_corrected)})"


def distances(folders: Mapping[str, Sequence[Path]]) -> str:
    """Return the table of distinct failures by other thresholds and by paths: medians of runs."""
    headings = [*(f"at {threshold:g} m" for threshold in THRESHOLDS), "by warping of the paths"]
    lines = [["distinct failures", *headings], ["---", *["---:"] * len(headings)]]
    for name, runs in folders.items():
        medians = np.median([list(_distinct_counts(folder)) for folder in runs], axis=0)
        lines.append([name, *(f"{median:g}" for median in medians)])
    return markdown(lines)


def _distinct_counts(folder: Path) -> Iterator[int]:
    """Yield the distinct failures of a run by each threshold, then by paths."""
    with CampaignStore.open(folder) as store:
        failures = failures_of(store)
    for threshold in THRESHOLDS:
        yield len(cluster_failures(failures, threshold=threshold))
    yield distinct_paths(failures)


def distinct_paths(failures: list[Failure]) -> int:
    """Return the number of failures whose paths are at least `PATH_THRESHOLD` m apart.

    A failure counts if its path is that far from the path of every failure that was counted before.
    The distance of two driven paths, over the 30 m before the departure, is by dynamic time
    warping: the least mean distance of points that are matched in order. This distance ignores
    speed and the road ahead, and shares no code with `frenetic.analysis`.
    """
    paths_by_side: dict[object, list[np.ndarray]] = {}
    for failure in failures:
        path = _path(failure)
        paths = paths_by_side.setdefault(failure.side, [])
        if all(_path_distance(path, other) >= PATH_THRESHOLD for other in paths):
            paths.append(path)
    return sum(map(len, paths_by_side.values()))


def _path(failure: Failure) -> np.ndarray:
    """Return the driven path before the departure, (7, 2) in m."""
    road = failure.road[: len(failure.offsets)]
    along = np.gradient(road, axis=0)
    normal = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, np.newaxis]
    points = road + normal * failure.offsets[:, np.newaxis]
    path: np.ndarray = points[:: round(PATH_STEP / OFFSET_STEP)]
    return path


def _path_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the mean distance of two paths in m, with points matched in order."""
    apart = np.hypot(*(first[:, np.newaxis] - second[np.newaxis]).transpose(2, 0, 1))
    n, m = apart.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0.0
    for i in range(n):
        for j in range(m):
            least = min(total[i, j], total[i, j + 1], total[i + 1, j])
            total[i + 1, j + 1] = apart[i, j] + least
    mean: float = float(total[n, m]) / max(n, m)
    return mean


def markdown(lines: list[list[str]]) -> str:
    """Return lines of cells as a Markdown table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def write_table(name: str, text: str) -> None:
    """Put a table between its marks on the page."""
    page = PAGE.read_text(encoding="utf-8")
    marked = re.compile(f"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    assert len(marked.findall(page)) == 1, name
    page = marked.sub(lambda block: f"{block[1]}{text}{block[2]}", page)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
