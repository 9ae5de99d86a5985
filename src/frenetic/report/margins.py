"""A picture of a driver's margins: a bar for each quantity, from usual to failing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes

from frenetic.analysis.statistics import ValueWithInterval
from frenetic.report.style import (
    ALARM,
    FAINT,
    INK,
    QUIET,
    STYLE,
    WIDTH,
    Paper,
    form_of,
    one_line,
    write_figure,
)
from frenetic.rerun.margin_results import SHARE, ConditionMargin, Margins

# Sizes in inches, our choice.
_ROW: Final = 0.34  # height of a row
_TOP: Final = 0.95  # room above the rows
_BOTTOM: Final = 0.75  # room below the rows
_LEFT: Final = 3.45  # room for the quantities' names and usual amounts
_RIGHT: Final = 2.1  # room for the ends of the ranges and the amounts
_BAR: Final = 0.56  # height of a bar, as a share of its row
_BORNE_COLOUR: Final = "#0b5fa5"
_BEYOND_COLOUR: Final = "#a9c8e2"  # of a bar that reaches beyond the measured range
_MOST_LETTERS: Final = 100  # of the title


def draw_margins(margins: Margins, path: Path | str) -> None:
    """Write a picture of margins to ``path``: PNG, SVG or PDF by its suffix.

    A bar reaches from the usual amount at the left to the amount at which the driver begins to
    fail, as a share of the measured range; a line shows the 95 % interval, and a diamond the
    demanding road that fails first.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    form = form_of(path)
    height = _TOP + _ROW * len(margins.margins) + _BOTTOM
    with mpl.rc_context(STYLE):
        page = Paper.new(WIDTH, height)
        rows_height = _ROW * len(margins.margins)
        axes = page.axes(_LEFT, _TOP, WIDTH - _LEFT - _RIGHT, rows_height, bare=False)
        _write_headings(page, margins)
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(len(margins.margins) - 0.5, -0.5)
        axes.set_yticks([])
        axes.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["usual", "25 %", "50 %", "75 %", "100 %"])
        axes.grid(visible=True, axis="x")
        axes.spines["bottom"].set_visible(False)
        for row, margin in enumerate(margins.margins):
            _draw_row(axes, row, margin)
            _write_row(page, _TOP + _ROW * (row + 0.62), margin)
        _write_key(page, margins, height)
        write_figure(page.figure, path, form)


def _draw_row(axes: Axes, row: int, margin: ConditionMargin) -> None:
    """Draw the bar of a margin, its interval and its demanding road."""
    shares = margin.shares
    is_beyond = math.isinf(shares.value)
    colour = _BEYOND_COLOUR if is_beyond else _BORNE_COLOUR
    axes.barh(row, min(shares.value, 1.0), _BAR, color=colour, linewidth=0.0)
    if math.isfinite(shares.low):
        _draw_interval(axes, row, shares)
    if (least := margin.least) is not None and math.isfinite(least.share):
        axes.plot([least.share], [row], "D", color=ALARM, markersize=6.5, zorder=4, clip_on=False)


def _draw_interval(axes: Axes, row: int, shares: ValueWithInterval) -> None:
    """Draw an interval as a line with ends; an end beyond the range has an arrow."""
    low, high = shares.low, min(shares.high, 1.0)
    axes.plot([low, high], [row, row], color=INK, linewidth=1.3, zorder=3, clip_on=False)
    axes.plot([low], [row], "|", color=INK, markersize=7.0, zorder=3, clip_on=False)
    end = ">" if math.isinf(shares.high) else "|"
    size = 4.0 if math.isinf(shares.high) else 7.0
    axes.plot([high], [row], end, color=INK, markersize=size, zorder=3, clip_on=False)


def _write_row(page: Paper, y: float, margin: ConditionMargin) -> None:
    """Write the name of a quantity, its usual amount and its end, and where the driver fails."""
    quantity, right = margin.quantity, WIDTH - _RIGHT
    page.text(0.3, y, quantity.words, size=9.5)
    page.text(_LEFT - 0.12, y, quantity.text(quantity.usual), size=8.5, color=QUIET, ha="right")
    page.text(right + 0.12, y, quantity.text(quantity.end), size=8.5, color=QUIET)
    text = "never" if margin.amount is None else margin.amount_text()
    page.text(WIDTH - 0.3, y, text, size=9.5, weight="bold", ha="right")


def _write_headings(page: Paper, margins: Margins) -> None:
    """Write the title and the headings of the columns."""
    page.text(0.3, 0.42, one_line(margins.headline, _MOST_LETTERS), size=12.0, weight="bold")
    headings = {
        "quantity": (0.3, "left"),
        "usual": (_LEFT - 0.12, "right"),
        "end of range": (WIDTH - _RIGHT + 0.12, "left"),
        "begins to fail": (WIDTH - 0.3, "right"),
    }
    for heading, (x, alignment) in headings.items():
        page.text(x, _TOP - 0.12, heading, size=8.5, color=QUIET, ha=alignment)


def _write_key(page: Paper, margins: Margins, height: float) -> None:
    """Write what bars, lines and diamonds mean, below the rows."""
    text = (
        f"Bar: on {100.0 * (1.0 - SHARE):g} % of the roads the driver passes so far; pale: beyond"
        " the range. Line: 95 % interval."
    )
    if margins.demanding:
        text += f" Diamond: first failure on the {margins.demanding} most demanding roads."
    page.text(0.3, height - 0.2, text, size=8.5, color=QUIET)
    page.line([_LEFT, _LEFT], [_TOP, height - _BOTTOM], color=FAINT, linewidth=1.0)
