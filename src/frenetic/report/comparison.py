"""A picture of groups of campaigns: failures over simulations, and the measures of each."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from frenetic._support.words import counted
from frenetic.analysis.comparison import Comparison, MeasureComparison
from frenetic.analysis.metrics import curves
from frenetic.analysis.statistics import LEAST_REPEATS
from frenetic.report.style import DPI, FAINT, INK, QUIET, STYLE, WIDTH, form_of, write_figure

# Told apart with any kind of colour vision, and in grey by their order. When all are taken, they
# come again with other lines and markers.
_COLOURS: Final = ("#0b5fa5", "#e07b1a", "#1b8a6b", "#8a4fa0", "#b3262c", "#5c6670", "#c2a200")

_DASHES: Final[tuple[Any, ...]] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1.2, 1, 1.2)))
_MARKERS: Final = ("o", "s", "^", "D")

# Sizes in inches.
_LEFT: Final = 0.75
_RIGHT: Final = 0.35
_CURVES: Final = 3.3
_ROW: Final = 0.3  # of a group in a panel
_GAP: Final = 0.3
_COLUMNS: Final = 3
_STEPS: Final = (1, 2, 5, 10)  # between ticks
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
    shown = comparison.measures
    rows = math.ceil(len(shown) / _COLUMNS)
    panel = _ROW * len(comparison.groups) + 0.1
    pitch = panel + 1.02
    top, legend = 0.62, 0.26 * math.ceil(len(comparison.groups) / 2)
    height = top + _CURVES + 0.55 + legend + rows * pitch + 0.1
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white")

    def axes(x: float, y: float, width: float, tall: float) -> Any:
        """Axes by their upper left corner, in inches."""
        return figure.add_axes((x / WIDTH, 1.0 - (y + tall) / height, width / WIDTH, tall / height))

    figure.text(
        _LEFT / WIDTH,
        1.0 - 0.4 / height,
        "Failures found over simulations",
        size=14,
        weight="bold",
        color=INK,
    )
    main = axes(_LEFT, top, WIDTH - _LEFT - _RIGHT, _CURVES)
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
    width = (WIDTH - _LEFT - _RIGHT - (_COLUMNS - 1) * _GAP) / _COLUMNS
    for i, measured in enumerate(shown):
        row, column = divmod(i, _COLUMNS)
        x = _LEFT + column * (width + _GAP)
        y = top + _CURVES + 0.55 + legend + row * pitch + 0.55
        draw_measure(axes(x, y, width, panel), measured)
    return figure


def look_of(group: int) -> tuple[str, Any, str]:
    """(colour, dashes, marker) of a group, by its place."""
    turn, colour = divmod(group, len(_COLOURS))
    return _COLOURS[colour], _DASHES[turn % len(_DASHES)], _MARKERS[turn % len(_MARKERS)]


def draw_curves(axes: Any, comparison: Comparison) -> None:
    """Draws the failures of each group over the simulations: median, and quartiles or curves."""
    longest = 0
    for group, (name, campaigns) in enumerate(comparison.groups.items()):
        colour, dashes, _ = look_of(group)
        found = curves(campaigns, "failures_after")
        simulations = np.arange(found.shape[1])
        longest = max(longest, found.shape[1] - 1)
        low, median, high = np.quantile(found, (0.25, 0.5, 0.75), axis=0)
        if len(campaigns) >= LEAST_REPEATS:
            axes.fill_between(simulations, low, high, color=colour, alpha=0.16, linewidth=0)
        else:
            for curve in found:
                axes.plot(simulations, curve, color=colour, alpha=0.3, linewidth=0.8)
        label = f"{_short(name)}, {counted(len(campaigns), 'campaign')}"
        how: Any = {"color": colour, "linestyle": dashes, "linewidth": 2.0}
        axes.plot(simulations, median, label=label, **how)
    axes.set_xlim(0, max(longest, 1))
    most = max(c.failures_after[-1] for campaigns in comparison.groups.values() for c in campaigns)
    axes.set_ylim(-0.02 * max(most, 1), 1.05 * max(most, 1))  # a curve at 0 can be seen
    frame_counts(axes, "simulations", "failures, median and quartiles")


def frame_counts(axes: Any, across: str, up: str) -> None:
    """Titles, a quiet grid and whole numbers, as in every chart of counts."""
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(steps=_STEPS, integer=True))
    axes.grid(color=FAINT, linewidth=0.5, alpha=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def draw_measure(axes: Any, measured: MeasureComparison) -> None:
    """Draws a measure's values, a row for each group."""
    measure = measured.measure
    everything = [value for values in measured.values.values() for value in values]
    finite = [value for value in everything if math.isfinite(value)]
    low, high = min(finite, default=0.0), max(finite, default=1.0)
    if low == high:  # it is shown how far they are from zero
        low, high = (0.0, 1.0) if low == 0.0 else (min(low, 0.0), max(high, 0.0))
    room = 0.06 * (high - low)
    # Campaigns without a value stand behind a line, on the worse side.
    worse = -1.0 if measure.more_is_better else 1.0
    edge = low if measure.more_is_better else high
    nowhere = edge + 3.0 * worse * room
    has_none = len(finite) < len(everything)
    groups = len(measured.values)
    for row, (name, values) in enumerate(measured.values.items()):
        colour, dashes, marker = look_of(row)
        y = groups - 1 - row
        places = [value if math.isfinite(value) else nowhere for value in values]
        if len(values) >= LEAST_REPEATS:
            q = measured.quartiles(name)
            first, median, third = (
                value if math.isfinite(value) else nowhere for value in (q.low, q.median, q.high)
            )
            box = Rectangle(
                (first, y - 0.3), third - first, 0.6, facecolor=colour, alpha=0.16, linewidth=0
            )
            axes.add_patch(box)
            middle: Any = {"color": colour, "linestyle": dashes, "linewidth": 2.0}
            axes.plot([median, median], [y - 0.3, y + 0.3], **middle)
        # Side by side where they would overlap.
        shifts = 0.2 * np.cos(np.pi * np.arange(len(places)))
        axes.plot(
            np.sort(places),
            y + (shifts if len(places) > 1 else np.zeros(1)),
            linestyle="none",
            marker=marker,
            markersize=3.6,
            markerfacecolor=colour,
            markeredgecolor="white",
            markeredgewidth=0.4,
            alpha=0.85,
        )
    ends = [low, high, nowhere] if has_none else [low, high]
    axes.set_xlim(min(ends) - room, max(ends) + room)
    axes.set_ylim(-0.55, groups - 0.45)
    axes.set_yticks([])
    locator = MaxNLocator(4, steps=_STEPS, integer=measure.decimals == 0)
    lowest = low - room if low < 0.0 else max(low - room, 0.0)
    ticks = [tick for tick in locator.tick_values(low, high) if lowest <= tick <= high + room]
    axes.set_xticks(ticks)
    if has_none:
        axes.axvline(edge + 1.5 * worse * room, color=FAINT, linewidth=0.8, linestyle=(0, (3, 3)))
        axes.set_xticks([*ticks, nowhere], [*(f"{tick:g}" for tick in ticks), "none"])
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    better = "more is better" if measure.more_is_better else "less is better"
    _above(axes, 21.0, measure.heading, INK, 9.5, "bold")
    _above(axes, 8.0, f"{better}; {_finding(measured)}", QUIET, 8.0, "normal")


def _above(axes: Any, points: float, text: str, colour: str, size: float, weight: str) -> None:
    axes.annotate(
        text,
        (0.0, 1.0),
        (0.0, points),
        xycoords="axes fraction",
        textcoords="offset points",
        color=colour,
        size=size,
        weight=weight,
        annotation_clip=False,
    )


def _finding(measured: MeasureComparison) -> str:
    if len(measured.pairs) == 1:
        (pair,) = measured.pairs
        if min(pair.repeats) < LEAST_REPEATS:
            return str(pair.verdict)
        return f"A12 {pair.a12:.2f} ({pair.magnitude}), p {pair.p:.2g}"
    fewest = min(len(values) for values in measured.values.values())
    if fewest < LEAST_REPEATS:
        return "too few repeats to tell"
    shown = sum(pair.better is not None for pair in measured.pairs)
    return f"{shown} of {len(measured.pairs)} pairs differ"


def _short(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..."
