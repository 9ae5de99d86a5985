"""Makes the tables and pictures of docs/bench-results.md: ``python docs/make_bench_results.py``.

Runs the bench of that page, two budgets, ten repeats: some minutes on two cores. The campaigns and
pages stay in the folder that is given, or in ``benches/published`` of the current one.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from frenetic import EmbeddedSimulator, Planner
from frenetic.analysis import Comparison
from frenetic.bench import Bench, Entrant, Terms
from frenetic.bench.results import write_results
from frenetic.campaign.workers import available_cores
from frenetic.report.comparison import draw_comparison

DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "bench-results.md"
BUDGETS = (200, 1000)  # simulations
REPEATS = 10
SECONDS_PER_TEST = 36.0

BASELINE = "random"
ENTRANTS = (
    Entrant(name=BASELINE, spec="random", is_strategy=True),
    Entrant(name="Frenetic 2021", spec="frenetic-2021", is_strategy=True),
    Entrant(name="Frenetic", spec="frenetic", is_strategy=True),
    Entrant(
        name="Frenetic without repeats",
        spec="frenetic",
        is_strategy=True,
        options={"skip_repeats": True},
    ),
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


def main(folder: Path) -> None:
    """Runs the missing benches and writes their tables."""
    page = PAGE.read_text(encoding="utf-8")
    for simulations in BUDGETS:
        bench = Bench(
            entrants=ENTRANTS,
            terms=Terms(
                simulator=EmbeddedSimulator(),
                driver=Planner(),
                budget=simulations * SECONDS_PER_TEST,
                seconds_per_test=SECONDS_PER_TEST,
                records="none",
            ),
            repeats=REPEATS,
            folder=folder / str(simulations),
        )
        resume = (bench.folder / "bench.json").exists()
        for end in bench.run(resume=resume, workers=available_cores()):
            print(simulations, end.run.entrant.name, end.run.repeat, end.ending or end.trouble)
        comparison = bench.comparison()
        print(write_results(bench, comparison, command="python docs/make_bench_results.py"))
        draw_comparison(comparison, DOCS / "images" / f"bench-{simulations}.svg")
        page = with_table(page, f"bench-{simulations}", table(comparison))
        page = with_table(page, f"pairs-{simulations}", pairs(comparison))
    PAGE.write_text(page, encoding="utf-8")


def table(comparison: Comparison) -> str:
    """A row per measure, a column per entrant: medians and quartiles."""
    names = [entrant.name for entrant in ENTRANTS]
    lines = [["median (quartiles)", *names], ["---", *["---:"] * len(names)]]
    for name in MEASURES:
        by = comparison.by(name)
        lines.append([by.measure.heading, *(by.text(group) for group in names)])
    return markdown(lines)


def pairs(comparison: Comparison) -> str:
    """Effect sizes and corrected p against the baseline."""
    others = [entrant.name for entrant in ENTRANTS if entrant.name != BASELINE]
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
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "benches/published"))
