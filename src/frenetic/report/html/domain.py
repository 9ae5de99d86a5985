"""Section of a page: how much of its operational design domain a campaign drove."""

from __future__ import annotations

from typing import Any, Final

from frenetic._support.words import capitalised, counted
from frenetic.analysis.coverage import ROADS, Cells, DomainCoverage
from frenetic.report.html.page import Block, DataBlock, Section, Table, percent, proper

LISTED: Final = 12
"""Largest number of cells without a drive that the page names; our choice."""

_SHADES: Final = (0.0, 0.02, 0.05, 0.1, 0.25)
"""Failing shares above which a cell gets the next darker shade; our choice."""
_PAIR_COLUMNS: Final = (
    "pair",
    ">cells",
    ">driven",
    ">with failures",
    ">never reached",
    ">driven share",
)


def domain_section(coverage: DomainCoverage) -> Section:
    """Return the section with a domain's cells, singly and in pairs, and cells never reached."""
    rows = [_row(cells) for cells in coverage.singles]
    blocks: list[Block] = [DataBlock("domain", {"rows": rows, "caption": _caption(coverage)})]
    if coverage.pairs:
        blocks.append(_pairs(coverage))
    if coverage.gaps:
        blocks.append(_gaps(coverage))
    lead = f"Which conditions and roads of {coverage.name} were driven. {coverage.as_text()}."
    return Section("domain", "Domain", tuple(blocks), lead)


def _row(cells: Cells) -> dict[str, Any]:
    """Return the cells of one axis for the script."""
    (axis,) = cells.axes
    cells_data = []
    for i in range(axis.cell_count):
        drives, failures = int(cells.drives[i]), int(cells.failures[i])
        text = f"{failures} of {drives} failed" if failures else f"{drives} passed"
        cells_data.append(
            {
                "range": proper(axis.text(i)),
                "text": text if drives else "never reached",
                "share": _share(float(cells.shares[i])),
                "driven": drives > 0,
                "level": sum(failures > share * drives for share in _SHADES),
            }
        )
    return {"title": capitalised(axis.title), "unit": axis.unit, "cells": cells_data}


def _caption(coverage: DomainCoverage) -> str:
    """Return the text that explains the cells."""
    text = (
        "In each cell: how many of its drives failed, redder for a larger share; and the share of"
        f" the domain that lies there, for roads as counted in {ROADS} random ones. A search goes"
        " where the driver fails, so its failures say where, not how often."
    )
    if coverage.outside:
        text += f" {counted(coverage.outside, 'drive')} outside the domain are left out."
    return text


def _pairs(coverage: DomainCoverage) -> Table:
    """Return the table of combinations of two axes, each with a link to the feature map."""
    rows, links = [], []
    for pair in coverage.pairs:
        first, second = pair.axes
        numbers = pair.count, pair.driven, pair.failed, pair.never_reached
        name = f"{first.title}, {second.title}"
        rows.append((name, *map(str, numbers), _share(pair.driven_share)))
        links.append(f"#map:{first.name}:{second.name}")
    return Table(
        _PAIR_COLUMNS,
        tuple(rows),
        "Combinations of the cells of two rows above. A pair opens in the feature map.",
        links=tuple(links),
    )


def _gaps(coverage: DomainCoverage) -> Table:
    """Return the table of the most probable cells that were never reached."""
    gaps = coverage.gaps[:LISTED]
    others = len(coverage.gaps) - len(gaps)
    return Table(
        ("never reached, most probable first", ">lies there"),
        tuple((proper(capitalised(gap.as_text())), gap.likelihood) for gap in gaps),
        f"{others} more are less probable; 'frenetic show --json' lists all." if others else "",
    )


def _share(share: float) -> str:
    """Return a share of the domain in percent, as text."""
    if share < 0.0005:
        return "under 0.1 %" if share else "0 %"
    return percent(share)
