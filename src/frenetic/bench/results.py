"""What a bench leaves beside its runs: the page and the tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from frenetic.analysis.comparing import Comparison
from frenetic.analysis.tables import write_table
from frenetic.bench.bench import Bench, RunState
from frenetic.bench.proposing import End
from frenetic.durations import format_duration
from frenetic.report.html.blocks import Fact
from frenetic.report.html.comparing import write_comparison_page

PAGE: Final = "index.html"
TABLES: Final = ("table.csv", "table.md")


def write_results(bench: Bench, comparison: Comparison, *, command: str | None = None) -> Path:
    """Writes the page and the tables into a bench's folder; returns the page.

    Args:
        bench: whose folder it is.
        comparison: of its entrants.
        command: the command line that makes the bench again.

    Raises:
        FreneticError: a file cannot be written.
    """
    for name in TABLES:
        write_table(comparison, bench.folder / name)
    names = [entrant.name for entrant in bench.entrants]
    return write_comparison_page(
        comparison,
        bench.folder / PAGE,
        title=f"Bench: {', '.join(names[:4])}{' ...' if len(names) > 4 else ''}",
        lead=f"{bench.repeats} runs of {bench.terms.simulations} simulations each.",
        facts=[*_terms(bench), *unusual_endings(bench.states())],
        command=command,
    )


def _terms(bench: Bench) -> Iterator[Fact]:
    terms = bench.terms
    counted = "counts" if terms.counts_computing else "is free"
    yield Fact(
        "virtual clock",
        f"{format_duration(terms.budget)}, of which each simulation costs"
        f" {terms.seconds_per_test:g} s; the time that a generator takes itself {counted}",
    )
    yield Fact("seeds", f"{bench.seed} to {bench.seed + bench.repeats - 1}")
    for entrant in bench.entrants:
        kind = "strategy" if entrant.is_strategy else "generator"
        options = ", ".join(f"{name}={value}" for name, value in entrant.options.items())
        yield Fact(entrant.name, f"{kind} {entrant.spec}{' with ' if options else ''}{options}")


def unusual_endings(states: Sequence[RunState]) -> list[Fact]:
    """What is to be said of runs that did not end by their budget, by entrant."""
    found: list[Fact] = []
    for name in dict.fromkeys(state.run.entrant.name for state in states):
        runs = [state for state in states if state.run.entrant.name == name]
        reasons = Counter(
            "not run" if state.ending is None else str(state.ending)
            for state in runs
            if state.ending is None or state.ending.end is not End.OVER
        )
        if reasons:
            told = "; ".join(f"{count}: {reason}" for reason, count in reasons.most_common(3))
            found.append(Fact(f"{name}, unusual ends of {len(runs)} runs", told))
        if threads := sum(state.ending.threads for state in runs if state.ending is not None):
            found.append(Fact(f"{name}, threads left running", str(threads)))
    return found
