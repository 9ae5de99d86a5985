"""A comparison as a table of text: CSV for programs, Markdown for documents."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from frenetic._support.files import write_file
from frenetic._support.words import printable, text_cell
from frenetic.analysis.comparison import Comparison
from frenetic.errors import FreneticError


def comparison_table_csv(comparison: Comparison) -> str:
    """A row per group, the best by the headline measure first, as CSV with a header.

    Columns: ``group``, ``campaigns``, then for each measure its name (the median), the same with
    ``_low`` and ``_high`` (the quartiles) and with ``_mean_rank``. A cell is empty for an event
    that never happened. Names of groups are texts as `text_cell` makes them.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    header = ["group", "campaigns"]
    for by in comparison.measures:
        name = by.measure.name
        header += [name, f"{name}_low", f"{name}_high", f"{name}_mean_rank"]
    writer.writerow(header)
    for group in comparison.headline.order:
        row = [text_cell(group), str(len(comparison.groups[group]))]
        for by in comparison.measures:
            found = by.quartiles(group)
            numbers = (found.median, found.low, found.high, by.mean_ranks[group])
            row += [_number(value) for value in numbers]
        writer.writerow(row)
    return text.getvalue()


def comparison_table_markdown(comparison: Comparison) -> str:
    """A row per group, the best by the headline measure first, as a Markdown table.

    Cells hold medians with quartiles.
    """
    titles = ["group", "campaigns", *(by.measure.heading for by in comparison.measures)]
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)]]
    for group in comparison.headline.order:
        cells = [by.text(group) for by in comparison.measures]
        lines.append([_escaped(group), str(len(comparison.groups[group])), *cells])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


FORMS: Final[Mapping[str, Callable[[Comparison], str]]] = MappingProxyType(
    {".csv": comparison_table_csv, ".md": comparison_table_markdown}
)
"""Suffix of a file -> its writer."""


def write_table(comparison: Comparison, path: Path | str) -> Path:
    """Writes a comparison as a table: CSV or Markdown by the file's suffix.

    Returns:
        The file, which replaces an older one.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    path = Path(path)
    form = FORMS.get(path.suffix.lower())
    if form is None:
        raise FreneticError(f"a table is written to {path}: the name must end with .csv or .md")
    write_file(path, form(comparison), remedy="choose another place for the table")
    return path


def _number(value: float) -> str:
    return f"{value:.10g}" if math.isfinite(value) else ""


def _escaped(text: str) -> str:
    """A text escaped so that it cannot end a cell."""
    plain = printable(" ".join(text.split()))
    return "".join(f"\\{sign}" if sign in "\\|`*_[]<>" else sign for sign in plain)
