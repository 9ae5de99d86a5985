"""Pictures of a drive beside a recorded drive: each signal along the road, twice."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import MaxNLocator

from frenetic.recordings.comparison import SHOWN, RecordingComparison
from frenetic.report.style import (
    ALARM,
    FAINT,
    INNER_WIDTH,
    MARGIN,
    QUIET,
    STYLE,
    WIDTH,
    Paper,
    form_of,
    one_line,
    write_figure,
)

# Sizes in inches, our choice.
_HEAD_HEIGHT: Final = 0.95
_TITLE_HEIGHT: Final = 0.3  # above a graph
_GRAPH_HEIGHT: Final = 1.05
_AXIS_HEIGHT: Final = 0.55  # below the last graph
_LONGEST_TITLE: Final = 70
"""Largest number of letters of the headline; our choice."""
_DRIVEN_COLOUR: Final = "#0b5fa5"


def draw_recording(comparison: RecordingComparison, path: Path | str, *, title: str) -> None:
    """Write a picture of a drive beside a recorded drive to ``path``: PNG, SVG or PDF.

    Args:
        comparison: both drives.
        path: path of the file; an existing file is replaced.
        title: headline.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    form = form_of(path)
    signals = [signal for signal in comparison.recorded if signal != "time"]
    height = _HEAD_HEIGHT + len(signals) * (_TITLE_HEIGHT + _GRAPH_HEIGHT) + _AXIS_HEIGHT
    with mpl.rc_context(STYLE):
        page = Paper.new(WIDTH, height)
        page.text(MARGIN, 0.45, one_line(title, _LONGEST_TITLE), size=15.0, weight="bold")
        page.text(MARGIN, 0.75, "driven", size=9.5, weight="bold", color=_DRIVEN_COLOUR)
        recorded = one_line(f"recorded: {comparison.recording.name}", _LONGEST_TITLE)
        page.text(MARGIN + 0.8, 0.75, recorded, size=9.5, weight="bold", color=ALARM)
        left, width, y = MARGIN + 0.45, INNER_WIDTH - 0.45, _HEAD_HEIGHT
        for signal in signals:
            shown = SHOWN[signal]
            name = f"{shown.text} ({shown.unit})" if shown.unit else shown.text
            page.text(MARGIN, y + _TITLE_HEIGHT - 0.08, name, size=8.5, color=QUIET)
            y += _TITLE_HEIGHT
            axes = page.axes(left, y, width, _GRAPH_HEIGHT, bare=False, label=signal)
            driven, measured = comparison.driven[signal], comparison.recorded[signal]
            axes.plot(comparison.distances, measured, color=ALARM, lw=1.4, zorder=3)
            axes.plot(comparison.distances, driven, color=_DRIVEN_COLOUR, lw=1.4, zorder=4)
            if np.nanmin(measured) < 0.0 < np.nanmax(measured):
                axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
            axes.set_xlim(comparison.distances[0], comparison.distances[-1])
            axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
            axes.grid(visible=True)
            axes.tick_params(labelbottom=signal == signals[-1])
            y += _GRAPH_HEIGHT
        middle = left + 0.5 * width
        text = "distance along the road (m)"
        page.text(middle, y + 0.335, text, size=8.5, color=QUIET, ha="center")
        write_figure(page.figure, path, form)
