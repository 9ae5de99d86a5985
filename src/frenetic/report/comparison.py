"""A picture of groups of campaigns: failures over simulations, and the measures of each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from frenetic._support.words import counted
from frenetic.analysis.comparison import Comparison
from frenetic.report.html.blocks import Chart
from frenetic.report.html.groups import COLOURS, group_curves, groups_of, spread_panel
from frenetic.report.style import FAINT, INK, QUIET, STYLE, WIDTH, Paper, form_of, write_figure

# Told apart with any kind of colour vision, and in grey by their order.
_GROUPS: Final = (
    "#0b5fa5", "#e07b1a", "#1b8a6b", "#8a4fa0", "#b3262c", "#5c6670", "#c2a200", "#c2407f",
)  # fmt: skip
ROLES: Final[Mapping[str, str]] = {
    "accent": "#0b5fa5",
    "fail": "#d1232a",
    **{f"group-{i}": colour for i, colour in enumerate(_GROUPS)},
}
"""Colours of a chart's lines on paper."""
assert len(_GROUPS) == COLOURS

# Sizes in inches.
_LEFT: Final = 0.75
_RIGHT: Final = 0.35
_CURVES: Final = 3.3
_ROW: Final = 0.3  # of a group in a panel
_GAP: Final = 0.3
_COLUMNS: Final = 3
_LONGEST: Final = 48  # letters of a group's name


def draw_comparison(comparison: Comparison, path: Path | str) -> None:
    """Write a picture of a comparison to ``path``: PNG, SVG or PDF by its suffix.

    On top the failures found over the simulations: each group's median, and the band between its
    quartiles. Underneath each measure: a point per campaign over a box from the first to the third
    quartile with the median in it.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        write_figure(_page(comparison), path, form)


def _page(comparison: Comparison) -> Figure:
    groups, inner = groups_of(comparison), WIDTH - _LEFT - _RIGHT
    panel = _ROW * len(groups) + 0.1
    top, legend = 0.62, 0.26 * math.ceil(len(groups) / 2)
    below = top + _CURVES + 0.55 + legend
    rows = math.ceil(len(comparison.measures) / _COLUMNS)
    page = Paper.new(WIDTH, below + rows * (panel + 1.02) + 0.1)
    page.text(_LEFT, 0.4, "Failures found over simulations", size=14, weight="bold")
    main = page.axes(_LEFT, top, inner, _CURVES, bare=False)
    draw_curves(main, comparison)
    main.legend(
        loc="upper left",
        bbox_to_anchor=(0.0, -0.14),
        ncols=2,
        frameon=False,
        fontsize=9.0,
        borderaxespad=0.0,
        handlelength=2.6,
        columnspacing=3.0,
    )
    width = (inner - (_COLUMNS - 1) * _GAP) / _COLUMNS
    for i, by in enumerate(comparison.measures):
        row, column = divmod(i, _COLUMNS)
        x, y = _LEFT + column * (width + _GAP), below + row * (panel + 1.02) + 0.55
        _draw_spreads(page.axes(x, y, width, panel, bare=False), spread_panel(by, groups))
    return page.figure


def draw_curves(axes: Axes, comparison: Comparison) -> None:
    """Draws the failures of each group over the simulations: median, and quartiles or curves."""
    *_, chart = group_curves(comparison)
    names = {}
    for name, own in comparison.groups.items():
        short = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..."
        names[name] = f"{short}, {counted(len(own), 'campaign')}"
    draw_chart(axes, chart, names)
    axes.set_ylabel("failures, median and quartiles")


def draw_chart(axes: Axes, chart: Chart, names: Mapping[str, str]) -> None:
    """Draws a chart of counts, with other names of its lines for a legend."""
    for line in chart.series:
        colour, style = ROLES[line.role], (0, (4, 2)) if line.dashed else "-"
        if line.low:
            axes.fill_between(line.x, line.low, line.high, color=colour, alpha=0.16, linewidth=0)
        for single in line.singles:
            axes.plot(line.x, single, color=colour, alpha=0.3, linewidth=0.8)
        axes.plot(
            line.x, line.y, label=names[line.name], color=colour, linestyle=style, lw=line.width,
            drawstyle="steps-post" if line.stepped else "default",
        )  # fmt: skip
    most = max(max(*line.y, *line.high, 1.0) for line in chart.series)
    axes.set_xlim(0, max(1, *(line.x[-1] for line in chart.series)))
    axes.set_ylim(-0.02 * most, 1.05 * most)  # a curve at 0 can be seen
    axes.set_xlabel(chart.x_title)
    axes.set_ylabel(chart.y_title)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10], integer=True))
    axes.grid(color=FAINT, linewidth=0.5, alpha=0.6)


def _draw_spreads(axes: Axes, panel: Mapping[str, Any]) -> None:
    """Draws a measure's values, a row for each group."""
    rows = panel["spreads"]
    for y, row in zip(reversed(range(len(rows))), rows, strict=True):
        colour, places = ROLES[row["group"]["role"]], row["places"]
        if row["box"]:
            first, median, third = row["box"]
            how: dict[str, Any] = {"facecolor": colour, "alpha": 0.16, "linewidth": 0}
            axes.add_patch(Rectangle((first, y - 0.3), third - first, 0.6, **how))
            axes.plot([median, median], [y - 0.3, y + 0.3], color=colour, linewidth=2.0)
        # Side by side where they would overlap.
        shifts = 0.2 * np.cos(np.pi * np.arange(len(places))) if len(places) > 1 else np.zeros(1)
        inside, edge = ("white", colour) if row["group"]["is_again"] else (colour, "white")
        axes.plot(
            places, y + shifts, "o", ms=3.6, mfc=inside, mec=edge, mew=0.4, alpha=0.85,
        )  # fmt: skip
    axes.set(xlim=(-6.0, 106.0), ylim=(-0.55, len(rows) - 0.45), yticks=[])
    places, texts = zip(*panel["ticks"], strict=True)
    axes.set_xticks(places, texts)
    if texts[-1] == "none":
        beside = abs(places[-1] - 7.0)
        axes.axvline(beside, color=FAINT, linewidth=0.8, linestyle=(0, (3, 3)))
    axes.spines["left"].set_visible(False)
    for points, text, colour, size, weight in (
        (21.0, panel["title"], INK, 9.5, "bold"),
        (8.0, panel["note"], QUIET, 8.0, "normal"),
    ):
        axes.annotate(
            text, (0.0, 1.0), (0.0, points), xycoords="axes fraction",
            textcoords="offset points", color=colour, size=size, weight=weight,
            annotation_clip=False,
        )  # fmt: skip
