"""Makes the tables and pictures of research/bench.md: ``python research/make_bench.py``.

Runs the benches of that page, or those named, ten repeats each: about an hour on two cores. Each
run is a campaign in `--folder`, the same as `frenetic bench` makes. The command can be stopped and
given again: complete runs are kept as long as strategy, driver, simulator and rules are of the same
versions.
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
from frenetic._support.words import part_word
from frenetic.analysis import Comparison
from frenetic.analysis.clusters import cluster_failures
from frenetic.analysis.comparison import MeasureComparison, PairComparison, compare, p_text
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
"""Seeds that chose nothing: strategies were tuned on seeds 101 to 124 and 201 to 206."""
THRESHOLDS: Final = (1.0, 2.0, 3.0)  # [m]
PATH_THRESHOLD: Final = 2.0  # [m]
PATH_STEP: Final = 5.0  # [m]


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
class Published:
    """A bench of the page."""

    name: str
    simulations: int
    entrants: tuple[Entrant, ...] = ENTRANTS
    drive: Mapping[str, Any] = field(default_factory=dict)
    """Entries of a spec that say how roads are driven."""
    seeds: Sequence[int] = SEEDS
    is_main: bool = False
    """Whether it has a picture, and distinct failures are counted by other distances, too."""

    def campaign(self, entrant: Entrant, seed: int, folder: Path) -> Campaign:
        """A run of an entrant; its folder is within `folder`."""
        strategy = part_word(entrant.spec, entrant.options)
        own = {"strategy": strategy, "seed": seed, "simulations": self.simulations}
        spec = Spec.of(self.drive, own)
        return Campaign.of(spec, folder=folder / self.name / entrant.name / str(seed), workers=1)


def _driver(name: str, **options: Any) -> dict[str, Any]:
    return {"driver": part_word(name, options)}


BENCHES: Final = (
    Published("planner-200", 200, ENTRANTS, is_main=True),
    Published("planner-1000", 1000, is_main=True),
    Published(
        "gentle-1000",
        1000,
        ENTRANTS,
        drive=_driver("planner", lateral_acceleration=7.0),
        is_main=True,
    ),
    Published(
        "careful-1000",
        1000,
        (RANDOM, LISTING_1, OURS, CMA_MAE, *EXPLOITATION),
        _driver("planner", lateral_acceleration=6.0),
    ),
    Published("stanley-200", 200, ENTRANTS, _driver("stanley")),
    Published("stanley-1000", 1000, (RANDOM, LISTING_1, OURS), _driver("stanley")),
    Published("steady-200", 200, ENTRANTS, _driver(f"{STEADY}:Steady", speed=48.0)),
    Published(
        "metadrive-200",
        200,
        (RANDOM, LISTING_1, OURS),
        _driver("metadrive-idm", target_speed=46.0) | {"simulator": "metadrive"},
        seeds=SEEDS[:10],
    ),
    Published("planner-5000", 5000, (RANDOM, LISTING_1, OURS), seeds=SEEDS[:10]),
)
SHOWN: Final = {
    "distinct_failures": "distinct failures",
    "failures": "failures",
    "cells": "cells",
    "unlike_roads": "unlike roads",
    "simulations_to_failure": "first failure",
    "min_moobd": "lowest MOOBD",
    "competition_sparseness": "competition's sparseness",
    "valid_share": "valid",
}
"""Name of a measure -> heading of its column."""
COMPARED: Final = (
    "distinct_failures",
    "cells",
    "unlike_roads",
    "simulations_to_failure",
    "min_moobd",
)


def main() -> None:
    """Runs what is missing and writes the tables of what is complete."""
    options = _options()
    chosen = [one for one in BENCHES if not options.names or one.name in options.names]
    if not options.tables:
        runs = [
            Run(published, entrant, seed, options.folder)
            for published in chosen
            for entrant in published.entrants
            if not options.entrant or entrant.name in options.entrant
            for seed in published.seeds
        ]
        with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
            for done in pool.map(complete, runs):
                print(done, flush=True)
    for published in chosen:
        groups = complete_groups(published, options.folder)
        if {RANDOM.name, LISTING_1.name, OURS.name} <= set(groups):
            write_tables(published, groups)
    write_table("verdicts", verdicts(PAGE.read_text(encoding="utf-8")))


@dataclass(frozen=True)
class Run:
    """A run of an entrant."""

    published: Published
    entrant: Entrant
    seed: int
    folder: Path
    """Of all benches."""

    def __str__(self) -> str:
        return f"{self.published.name}, {self.entrant.name}, seed {self.seed}"


def complete(run: Run) -> str:
    """Makes a run's campaign unless it is there, complete and of today's versions."""
    campaign = run.published.campaign(run.entrant, run.seed, run.folder)
    if is_complete(campaign):
        return f"{run}: kept"
    if campaign.folder.exists():
        shutil.rmtree(campaign.folder)
    summary = campaign.run()
    assert summary.simulations == run.published.simulations, summary.ended
    return f"{run}: {summary.failed} failures in {summary.seconds:.1f} s"


def is_complete(campaign: Campaign) -> bool:
    """Whether its folder holds the whole campaign, with the same parts."""
    if not (campaign.folder / DATABASE).exists():
        return False
    with CampaignStore.open(campaign.folder) as store:
        config, facts = store.config, store.facts
    return "finished_at" in facts and not changed_parts(config, campaign.configuration())


def complete_groups(published: Published, folder: Path) -> dict[str, list[Path]]:
    """Name of each entrant with all its runs -> their folders."""
    groups = {}
    for entrant in published.entrants:
        campaigns = [published.campaign(entrant, seed, folder) for seed in published.seeds]
        if all(map(is_complete, campaigns)):
            groups[entrant.name] = [campaign.folder for campaign in campaigns]
        else:
            print(f"{published.name}, {entrant.name}: not complete")
    return groups


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    known = [published.name for published in BENCHES]
    entrants = sorted({entrant.name for published in BENCHES for entrant in published.entrants})
    parser.add_argument("names", nargs="*", metavar="BENCH", help=f"of {', '.join(known)}; all")
    parser.add_argument("--folder", type=Path, default=Path("benches/published"))
    parser.add_argument("--workers", type=int, default=available_cores(), help="runs at once")
    parser.add_argument(
        "--entrant", action="append", choices=entrants, help="run only this one; may be repeated"
    )
    parser.add_argument("--tables", action="store_true", help="run nothing, write the tables")
    options = parser.parse_args()
    if unknown := set(options.names) - set(known):
        parser.error(f"no bench is called {', '.join(sorted(unknown))}: {', '.join(known)}")
    return options


# Tables


def write_tables(published: Published, groups: Mapping[str, Sequence[Path]]) -> None:
    """Writes the tables of a bench, and the picture of a main one."""
    compared = compare(groups)
    for note in compared.notes:
        print(f"{published.name}: {note}")
    tables = {"bench": table(compared), "pairs": pairs(compared)}
    if published.is_main:
        draw_comparison(compared, HERE / "images" / f"bench-{published.name}.svg")
        tables["distances"] = distances({name: groups[name] for name in compared.groups})
    for kind, text in tables.items():
        write_table(f"{kind}-{published.name}", text)


def table(comparison: Comparison) -> str:
    """A row per entrant, a column per measure: medians and quartiles."""
    names = [name for name in SHOWN if name in telling_of(comparison)]
    rows = {
        group: [group, *(comparison.by(name).text(group) for name in names)]
        for group in comparison.groups
    }
    return markdown(
        [
            ["median (quartiles)", *(SHOWN[name] for name in names)],
            ["---", *["---:"] * len(names)],
            *rows.values(),
        ]
    )


def pairs(comparison: Comparison) -> str:
    """Verdict, effect size and corrected p of our search against each other entrant."""
    names = [name for name in COMPARED if name in telling_of(comparison)]
    lines = [
        ["Frenetic against", *(SHOWN[name] for name in names)],
        ["---", *["---"] * len(names)],
    ]
    for other in comparison.groups:
        if other != OURS.name:
            by = (comparison.by(name) for name in names)
            lines.append([other, *(_said(_pair(one, other)) for one in by)])
    return markdown(lines)


def verdicts(page: str) -> str:
    """Verdicts on our search against random roads and Listing 1, from the tables of the page."""
    lines = [["bench", "against", *(SHOWN[name] for name in COMPARED)]]
    lines.append(["---"] * len(lines[0]))
    for published in BENCHES:
        marked = re.search(f"<!-- pairs-{published.name} -->\n(.*?)<!-- end -->", page, re.DOTALL)
        rows = [line.strip("| ").split(" | ") for line in marked[1].splitlines()] if marked else []
        for row in rows:
            if row[0] in (RANDOM.name, LISTING_1.name):
                said = {
                    head: cell.partition(" (")[0] for head, cell in zip(rows[0], row, strict=True)
                }
                cells = (said.get(SHOWN[name], "") for name in COMPARED)
                lines.append([published.name, row[0], *cells])
    return markdown(lines)


def telling_of(comparison: Comparison) -> set[str]:
    """Measures that tell something: not alike in all runs, and the lowest MOOBD where few fail."""
    names = {
        by.measure.name
        for by in comparison.measures
        if len({value for values in by.values.values() for value in values}) > 1
    }
    often = comparison.by("failures").quartiles(RANDOM.name).median > 0
    return names - {"min_moobd"} if often else names


def _pair(by: MeasureComparison, other: str) -> PairComparison:
    """Our search against another entrant."""
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


def _said(pair: PairComparison) -> str:
    return f"{_verdict(pair)} ({pair.a12:.2f}, {p_text(pair.p_corrected)})"


def distances(folders: Mapping[str, Sequence[Path]]) -> str:
    """Distinct failures at several thresholds, and by another distance: medians over the runs."""
    headings = [*(f"at {one:g} m" for one in THRESHOLDS), "by warping of the paths"]
    lines = [["distinct failures", *headings], ["---", *["---:"] * len(headings)]]
    for name, found in folders.items():
        medians = np.median([list(_counted(folder)) for folder in found], axis=0)
        lines.append([name, *(f"{median:g}" for median in medians)])
    return markdown(lines)


def _counted(folder: Path) -> Iterator[int]:
    with CampaignStore.open(folder) as store:
        failures = failures_of(store)
    for threshold in THRESHOLDS:
        yield len(cluster_failures(failures, threshold=threshold))
    yield distinct_paths(failures)


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
    mean: float = float(total[n, m]) / max(n, m)
    return mean


def markdown(lines: list[list[str]]) -> str:
    """A table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def write_table(name: str, text: str) -> None:
    """Puts a text between its marks on the page."""
    page = PAGE.read_text(encoding="utf-8")
    marked = re.compile(f"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    assert len(marked.findall(page)) == 1, name
    page = marked.sub(lambda found: f"{found[1]}{text}{found[2]}", page)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
