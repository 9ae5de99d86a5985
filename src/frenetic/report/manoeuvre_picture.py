"""Pictures of manoeuvres: what the road asks, and what the car does."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from frenetic.manoeuvres import Graph, ManoeuvreResult
from frenetic.manoeuvres.sines import MINUS_3_DB
from frenetic.report.style import (
    ALARM,
    FAINT,
    INK,
    MARGIN,
    OUTCOME_COLOURS,
    QUIET,
    STYLE,
    WIDTH,
    Paper,
    form_of,
    one_line,
    write_figure,
)

# Sizes in inches, our choice.
_HEAD_HEIGHT: Final = 0.85  # of headline and facts
_GRAPH_HEIGHT: Final = 2.1
_GRAPH_GAP: Final = 0.55  # below each graph, for its axis
_LEFT: Final = 0.95  # of the graphs
_GRAPHS_WIDTH: Final = 6.4
_LINE_HEIGHT: Final = 0.27  # of a quantity

_REFERENCES: Final = frozenset({"road", "lane", "geometric angle", MINUS_3_DB})
"""Names of lines that the car's lines are compared with."""
_CAR_COLOUR: Final = "#0b5fa5"
_LONGEST_TITLE: Final = 70
"""Largest number of letters of the headline; our choice."""
_LONGEST_REASON: Final = 46
"""Largest number of letters of a reason beside the graphs; our choice."""
_LONGEST_LINE: Final = 110
"""Largest number of letters of a line of text; our choice."""


def draw_manoeuvre(result: ManoeuvreResult, path: Path | str, *, title: str = "") -> None:
    """Write a picture of a driven manoeuvre to ``path``: PNG, SVG or PDF by its suffix.

    The graphs show what the road asks and what the car does; beside them are the quantities.

    Args:
        result: the driven manoeuvre.
        path: path of the file; an existing file is replaced.
        title: headline; by default the manoeuvre and the outcome.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    form = form_of(path)
    graphs, quantities = result.measures.graphs, result.measures.quantities
    graphs_height = len(graphs) * (_GRAPH_HEIGHT + _GRAPH_GAP)
    height = _HEAD_HEIGHT + max(graphs_height, len(quantities) * 2 * _LINE_HEIGHT) + 0.1
    with mpl.rc_context(STYLE):
        page = Paper.new(WIDTH, height)
        verdict = result.result
        colour = OUTCOME_COLOURS[verdict.outcome]
        headline = one_line(title or f"{result.manoeuvre.name}: {verdict.outcome}", _LONGEST_TITLE)
        page.text(MARGIN, 0.42, headline, size=15.0, weight="bold", color=colour)
        reason = one_line(verdict.reason, _LONGEST_LINE)
        page.text(MARGIN, 0.68, reason, size=9.0, color=QUIET)
        y = _HEAD_HEIGHT
        for graph in graphs:
            axes = page.axes(_LEFT, y, _GRAPHS_WIDTH, _GRAPH_HEIGHT, bare=False)
            _draw_graph(axes, graph)
            y += _GRAPH_HEIGHT + _GRAPH_GAP
        _write_quantities(page, result)
        write_figure(page.figure, path, form)


def _draw_graph(axes: Axes, graph: Graph) -> None:
    """Draw the lines of a graph, with a legend if there are several."""
    for line in graph.lines:
        if line.name in _REFERENCES:
            axes.plot(line.x, line.y, color=QUIET, ls=(0, (4.0, 3.0)), lw=1.4, label=line.name)
        else:
            marker = "o" if graph.is_logarithmic else ""
            axes.plot(line.x, line.y, color=_CAR_COLOUR, lw=1.6, marker=marker, label=line.name)
    if graph.is_logarithmic:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(mpl.ticker.NullLocator())
    else:
        axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    axes.set_xlabel(graph.x_title)
    axes.set_ylabel(graph.y_title)
    axes.grid(visible=True)
    if len(graph.lines) > 1:
        axes.legend(loc="best", frameon=False, fontsize=8.5)


def _write_quantities(page: Paper, result: ManoeuvreResult) -> None:
    """Write the quantities beside the graphs, each with its unit or why it was not measured."""
    left, y = _LEFT + _GRAPHS_WIDTH + 0.35, _HEAD_HEIGHT + 0.12
    for quantity in result.measures.quantities:
        name = f"{quantity.name.replace('_', ' ')}, {quantity.of}"
        page.text(left, y, name, size=8.5, color=QUIET)
        y += 0.75 * _LINE_HEIGHT
        is_measured = quantity.value is not None
        text = f"{quantity.text} {quantity.unit}".replace("-", "−") if is_measured else ""
        page.text(
            left,
            y,
            one_line(text or quantity.reason, _LONGEST_REASON),
            size=11.0 if is_measured else 8.5,
            color=INK if is_measured else ALARM,
        )
        y += 1.15 * _LINE_HEIGHT
