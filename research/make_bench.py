"""Make the tables and pictures of research/bench.md: ``python research/make_bench.py``.

The command runs all benches of that page, or the named benches: about two hours on two cores. Each
run is a campaign in `--folder`, as `frenetic bench` makes it. Stop the command and give it again,
and it continues: it keeps complete runs with today's versions of strategy, driver, simulator and
rules.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from frenetic import Campaign, CampaignStore
from frenetic._support.option_text import part_word
from frenetic.analysis import Comparison
from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.comparison import PairComparison, compare
from frenetic.analysis.comparison_text import p_text
from frenetic.analysis.spaces import SPACES
from frenetic.campaign.database import DATABASE
from frenetic.campaign.workers import available_cores
from frenetic.plugins.bench import Entrant
from frenetic.report.plots import draw_comparison
from frenetic.spec import Spec
from frenetic.spec.part_record import changed_parts

HERE: Final = Path(__file__).resolve().parent
PAGE: Final = HERE / "bench.md"
TABLES: Final = HERE / "bench-tables.md"
BENCHMARKS: Final = HERE.parent / "benchmarks"
PEERS: Final = BENCHMARKS / "ribs_search.py"
CLIMBERS: Final = BENCHMARKS / "climbers.py"
DRIVERS: Final = BENCHMARKS / "bench_drivers.py"
FORESIGHT_DRIVERS: Final = BENCHMARKS / "foresight_drivers.py"
SEEDS: Final = range(1, 21)
"""Seeds on which nothing was tuned, see the page."""
ANY_CHANGE: Final = 0.14
"""Change of the curvature from value to value that allows any change within the bound, in 1/m."""
USUAL_LENGTH: Final = 29
"""Usual number of values of a road of `frenetic`, which the other entrants have, too."""
NEVER: Final = 10**9
"""Number of drives that no run has."""


def _strategy(name: str, spec: str, **options: Any) -> Entrant:
    return Entrant(name=name, spec=spec, is_strategy=True, options=options)


RANDOM: Final = _strategy("random", "random", usual_length=USUAL_LENGTH)
LISTING_1: Final = _strategy("Frenetic 2021", "frenetic-2021", usual_length=USUAL_LENGTH)
OURS: Final = _strategy("Frenetic", "frenetic", sharper_after=NEVER)
LIKELY: Final = _strategy("Frenetic, likely", "frenetic", likely=True, sharper_after=NEVER)
CMA_ES: Final = _strategy("CMA-ES", f"{CLIMBERS}:CmaEs")
ENTRANTS: Final = (
    RANDOM,
    LISTING_1,
    OURS,
    LIKELY,
    _strategy("(1+1)-ES", f"{CLIMBERS}:OnePlusOne"),
    CMA_ES,
    _strategy("MAP-Elites", f"{PEERS}:RibsSearch", algorithm="map-elites"),
    _strategy("CMA-MAE", f"{PEERS}:RibsSearch", algorithm="cma-mae"),
)
"""Entrants with the same bounds on the curvature and on its change."""
UNBOUND: Final = (
    _strategy("Frenetic, any change", "frenetic", max_change=ANY_CHANGE),
    _strategy("(1+1)-ES, any change", f"{CLIMBERS}:OnePlusOne", max_change=ANY_CHANGE),
    _strategy("CMA-ES, any change", f"{CLIMBERS}:CmaEs", max_change=ANY_CHANGE),
)
"""Entrants whose curvature may change by any amount: they are compared among themselves."""


@dataclass(frozen=True)
class PageBench:
    """A bench of the page."""

    name: str
    simulations: int
    entrants: tuple[Entrant, ...]
    drive: Mapping[str, Any]
    """Entries of a spec that say how roads are driven."""
    seeds: Sequence[int] = SEEDS

    def campaign(self, entrant: Entrant, seed: int, folder: Path) -> Campaign:
        """Return the campaign of an entrant with a seed; its folder is within `folder`."""
        strategy = part_word(entrant.spec, entrant.options)
        run_entries = {"strategy": strategy, "seed": seed, "simulations": self.simulations}
        spec = Spec.of(self.drive, run_entries)
        return Campaign.of(spec, folder=folder / self.name / entrant.name / str(seed), workers=1)


def _driver(name: str, **options: Any) -> dict[str, Any]:
    return {"driver": part_word(name, options)}


def _benches(
    simulations: int,
    drives: Mapping[str, Mapping[str, Any]],
    entrants: tuple[Entrant, ...] = ENTRANTS,
) -> list[PageBench]:
    return [
        PageBench(f"{name}-{simulations}", simulations, entrants, drive)
        for name, drive in drives.items()
    ]


CHOOSING: Final = {
    "planner": _driver("planner"),
    "planner-7": _driver("planner", lateral_acceleration=7.0),
    "planner-6.5": _driver("planner", lateral_acceleration=6.5),
    "stanley-4": _driver("stanley", lateral_acceleration=4.0),
    "lqr": _driver(f"{DRIVERS}:Lqr"),
    "late-braker": _driver(f"{FORESIGHT_DRIVERS}:Pursuit", braking=6.0, lateral=7.0),
}
"""Drivers that chose settings of our search, on other seeds."""
JUDGING: Final = {
    "stanley-gain-3": _driver("stanley", offset_gain=3.0),
    "beamng-ai-1": _driver("beamng-ai", aggression=1.0),
    "rate-limited": _driver(f"{DRIVERS}:RateLimitedPursuit"),
    "feedforward": _driver(f"{FORESIGHT_DRIVERS}:Feedforward", lateral=6.0),
}
"""Drivers that chose nothing."""
SLOW_JUDGING: Final = {
    "highway-env": _driver("highway-env"),
    "metadrive": _driver("metadrive-idm", target_speed=46.0) | {"simulator": "metadrive"},
}
"""Drivers that chose nothing, of 0.1 s a drive and more."""
FAST: Final = CHOOSING | JUDGING
ANY_CHANGE_ALSO: Final = ("planner", "planner-7", "stanley-4", "beamng-ai-1", "rate-limited")
"""Drivers that also drive roads whose curvature may change by any amount."""
BENCHES: Final = (
    *(
        bench
        for name, drive in FAST.items()
        for bench in _benches(200, {name: drive}, ENTRANTS + UNBOUND * (name in ANY_CHANGE_ALSO))
    ),
    *(replace(bench, seeds=SEEDS[:10]) for bench in _benches(40, SLOW_JUDGING)),
    *_benches(1000, {"planner": FAST["planner"]}),
)
COLUMNS: Final = {
    "simulations_to_failure": "first failure",
    "failures": "failures",
    "distinct_failures": "distinct",
    **{
        f"{space}_{radius}": f"{space} {radius.replace('_', '.')}"
        for space in SPACES
        for radius in ("0_5", "1", "2")
    },
    "cells": "cells",
    "competition_sparseness": "sparseness",
    "min_moobd": "lowest MOOBD",
}
"""Name of a measure -> heading of its column."""
TABLES_HEAD: Final = """\
# All tables of the bench

`python research/make_bench.py` wrote this page; [the bench](bench.md) says what it shows. Each
driver has three tables: medians and quartiles of 20 runs of each search; the same of the searches
whose curvature may change by any amount; and `frenetic` against each other search within the same
bounds: `+` better, `-` worse, `=` no difference shown, A12 and, in brackets, p after Holm's
correction for all pairs of searches and all measures. Last come the curves.
"""


def main() -> None:
    """Run the missing campaigns, then write the tables and pictures of the complete benches."""
    options = _options()
    if not options.tables:
        chosen = [bench for bench in BENCHES if not options.names or bench.name in options.names]
        runs = [
            Run(bench, entrant, seed, options.folder)
            for bench in chosen
            for entrant in bench.entrants
            for seed in bench.seeds
        ]
        with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
            for message in pool.map(complete, runs):
                print(message, flush=True)
    results = {}
    for bench in BENCHES:
        groups = complete_groups(bench, options.folder)
        if len(groups) < len(bench.entrants):
            print(f"{bench.name}: not complete, so its tables are left out")
            continue
        results[bench.name] = Result.of(groups)
        draw_comparison(results[bench.name].bound, HERE / "images" / f"bench-{bench.name}.svg")
    TABLES.write_text(all_tables(results), encoding="utf-8")
    for name, text in {
        "behind": behind(results),
        "first-failures": first_failures(results),
        "verdicts": verdicts(results),
    }.items():
        write_table(name, text)


@dataclass(frozen=True)
class Result:
    """Comparisons of the complete runs of a bench."""

    bound: Comparison
    """Comparison of the entrants with the same bounds."""
    unbound: Comparison | None
    """Comparison of the entrants whose curvature may change by any amount; None without them."""

    @classmethod
    def of(cls, groups: Mapping[str, Sequence[Path]]) -> Self:
        """Compare the campaigns of each entrant."""
        unbound = {entrant.name for entrant in UNBOUND}
        of_unbound = {name: folders for name, folders in groups.items() if name in unbound}
        of_bound = {name: folders for name, folders in groups.items() if name not in unbound}
        return cls(compare(of_bound), compare(of_unbound) if of_unbound else None)


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
    return groups


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    known = [bench.name for bench in BENCHES]
    parser.add_argument(
        "names", nargs="*", metavar="BENCH", help=f"{', '.join(known)}; all by default"
    )
    parser.add_argument(
        "--folder", type=Path, default=Path("benches/published"), help="folder of all runs"
    )
    parser.add_argument("--workers", type=int, default=available_cores(), help="runs at once")
    parser.add_argument("--tables", action="store_true", help="run nothing, only write the tables")
    options = parser.parse_args()
    if unknown := set(options.names) - set(known):
        parser.error(f"no bench is called {', '.join(sorted(unknown))}: {', '.join(known)}")
    return options


# Tables


def all_tables(results: Mapping[str, Result]) -> str:
    """Return the page of all tables and pictures."""
    parts = [TABLES_HEAD]
    for bench, result in results.items():
        parts.append(f"## {title_of(bench)}\n\n{medians(result.bound)}")
        if result.unbound is not None:
            parts.append(medians(result.unbound))
        parts.append(pairs(result.bound))
        parts.append(f"![Failures over simulations and over radius](images/bench-{bench}.svg)\n")
    return "\n".join(parts)


def title_of(bench: str) -> str:
    """Return the title of a bench: its driver, and the number of simulations of a run."""
    page_bench = next(known for known in BENCHES if known.name == bench)
    driver = str(page_bench.drive["driver"]).replace(f"{HERE.parent}/", "")
    return f"`{driver}`, {page_bench.simulations} simulations"


def medians(comparison: Comparison) -> str:
    """Return the table of medians and quartiles: a row per entrant, a column per measure."""
    rows = [
        [group, *(comparison.by(name).text(group) for name in COLUMNS), kilometres(campaigns)]
        for group, campaigns in comparison.groups.items()
    ]
    head = ["median (quartiles)", *COLUMNS.values(), "km driven"]
    return markdown([head, ["---", *["---:"] * (len(head) - 1)], *rows])


def kilometres(campaigns: Sequence[CampaignMeasures]) -> str:
    """Return the median length that campaigns drove, in km."""
    return f"{np.median([0.001 * campaign.counts.driven_metres for campaign in campaigns]):.0f}"


def pairs(comparison: Comparison) -> str:
    """Return the table of verdict, A12 and corrected p of our search against each entrant."""
    lines = [["Frenetic against", *COLUMNS.values()], ["---"] * (len(COLUMNS) + 1)]
    for other in comparison.groups:
        if other != OURS.name:
            compared = (pair_with(comparison, name, other) for name in COLUMNS)
            lines.append([other, *map(_pair_text, compared)])
    return markdown(lines)


def behind(results: Mapping[str, Result]) -> str:
    """Return the table of measures by which an entrant with the same bounds is better than ours."""
    lines = [["driver", "who is ahead", "by"], ["---"] * 3]
    for bench, result in results.items():
        for other in result.bound.groups:
            if other in (OURS.name, LIKELY.name):
                continue
            ahead = []
            for name, heading in COLUMNS.items():
                pair = pair_with(result.bound, name, other)
                if pair.better == other:
                    by = result.bound.by(name)
                    ahead.append(f"{heading} {by.median(OURS.name)} to {by.median(other)}")
            if ahead:
                lines.append([bench, other, "; ".join(ahead)])
    return markdown(lines)


def first_failures(results: Mapping[str, Result]) -> str:
    """Return the table of first failures: ours, and those of the best baseline with the bounds."""
    head = ["driver", "Frenetic", "found in", "best baseline", "its first failure", "found in"]
    lines = [[*head, "goal"], ["---", *["---:"] * 2, "---", *["---:"] * 2, "---"]]
    for bench, result in results.items():
        if bench.endswith("-1000"):  # it begins as the bench of 200
            continue
        by = result.bound.by("simulations_to_failure")
        rivals = [name for name in by.values if name not in (OURS.name, LIKELY.name)]
        rival = min(rivals, key=lambda name: (by.quartiles(name).median, by.positions[name]))
        failing = {name: sum(map(math.isfinite, by.values[name])) for name in (OURS.name, rival)}
        goal = 1.2 * by.quartiles(rival).median + 3.0
        is_met = by.quartiles(OURS.name).median <= goal and failing[OURS.name] >= failing[rival]
        runs = len(by.values[OURS.name])
        texts = {name: [by.median(name), f"{failing[name]} of {runs}"] for name in failing}
        goal_text = "met" if is_met else "missed"
        lines.append([bench, *texts[OURS.name], rival, *texts[rival], goal_text])
    return markdown(lines)


def verdicts(results: Mapping[str, Result]) -> str:
    """Return the table of drivers on which ours is better, alike and worse, for each measure."""
    others = [entrant.name for entrant in ENTRANTS if entrant.name != OURS.name]
    lines = [["Frenetic against", *COLUMNS.values()], ["---"] * (len(COLUMNS) + 1)]
    for other in others:
        cells = []
        for name in COLUMNS:
            counts = Counter(
                _verdict(pair_with(result.bound, name, other)) for result in results.values()
            )
            cells.append(" ".join(f"{counts[verdict]}" for verdict in ("+", "=", "-")))
        lines.append([other, *cells])
    return markdown(lines)


def pair_with(comparison: Comparison, measure: str, other: str) -> PairComparison:
    """Return the comparison of our search, as the first of the pair, with another entrant."""
    pairs = comparison.by(measure).pairs
    pair = next(p for p in pairs if {p.first, p.second} == {OURS.name, other})
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
        return "="
    return "+" if pair.better == pair.first else "-"


def _pair_text(pair: PairComparison) -> str:
    return f"{_verdict(pair)} {pair.a12:.2f} ({p_text(pair.p_corrected)})"


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
