"""The page with a bench's results, in its folder."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from frenetic._support.option_text import part_word
from frenetic.analysis.comparison import Comparison
from frenetic.plugins.bench.bench import Bench
from frenetic.plugins.bench.presets import COLUMNS, measured
from frenetic.report.html.comparison import write_comparison_page
from frenetic.report.html.page import Block, Facts, Section, Table

PAGE: Final = "index.html"
"""Name of the page's file."""


def write_results(bench: Bench, comparison: Comparison) -> Path:
    """Write the page into a bench's folder; return its path.

    Args:
        bench: the bench.
        comparison: comparison of its entrants.

    Raises:
        FreneticError: the page cannot be written.
    """
    number = len(comparison.groups)
    return write_comparison_page(
        comparison,
        bench.folder / PAGE,
        title=f"Bench of {number} generators",
        lead=f"{bench.runs_text} each.",
        facts=_terms(bench),
        sections=list(_published(bench, comparison)),
        command=None if bench.file is None else shlex.join(["frenetic", "bench", str(bench.file)]),
    )


def _published(bench: Bench, comparison: Comparison) -> Iterator[Section]:
    """Yield a section with published figures beside the entrants', if the bench has a preset."""
    if (preset := bench.preset) is None:
        return
    columns = ("", *COLUMNS, "from")
    figures = (*measured(comparison), *preset.published)
    blocks: tuple[Block, ...] = (
        Table(
            tuple(f">{title}" if title in COLUMNS else title for title in columns),
            tuple((row.tool, *(cell or "–" for cell in row.cells), row.source) for row in figures),
            caption="Means of a run",
        ),
        Facts(preset.differences(bench.entries()), "What differs"),
        Facts(preset.sources, "Sources"),
    )
    yield Section("published", f"Beside {preset.title}", blocks, f"{preset.setting}.")


def _terms(bench: Bench) -> dict[str, str]:
    """Return name -> text of the facts about a bench: its clock, its seeds and its entrants."""
    terms = bench.terms
    facts = {
        "virtual clock": terms.clock_text,
        "seeds": f"{bench.seed} to {bench.seed + bench.repeats - 1}",
    }
    for entrant in bench.entrants:
        kind = "strategy" if entrant.is_strategy else "generator"
        facts[entrant.name] = f"{kind} {part_word(entrant.spec, entrant.options)}"
    return facts
