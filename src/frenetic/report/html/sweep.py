"""Section of a page: the map of a sweep over radius and speed limit."""

from __future__ import annotations

import math
from typing import Any, Final

from frenetic._support.words import counted, oob_words
from frenetic.analysis.bend_map import SweepMap
from frenetic.report.html.page import DataBlock, Section, proper

SHADES: Final = 7
"""Number of shades of failing shares, as ``--severity-0`` to 6 in ``report.css``."""

# Sizes in units of the drawing, our choice.
_CELL_WIDTH, _CELL_HEIGHT = 76.0, 42.0
_LEFT, _BOTTOM = 62.0, 46.0  # room for the labels of the axes


def sweep_section(swept: SweepMap, lane_width: float) -> Section:
    """Return the section with the map of a sweep.

    Args:
        swept: the map.
        lane_width: width of the lane, in m.
    """
    rows, columns = swept.drives.shape
    width, height = _LEFT + columns * _CELL_WIDTH, rows * _CELL_HEIGHT + _BOTTOM
    data: dict[str, Any] = {
        "width": width,
        "height": height,
        "cell_width": _CELL_WIDTH - 2.0,
        "cell_height": _CELL_HEIGHT - 2.0,
        "cells": [
            _cell(swept, row, column, lane_width)
            for row in range(rows)
            for column in range(columns)
            if swept.drives[row, column]
        ],
        "radii": [
            (_LEFT + (column + 0.5) * _CELL_WIDTH, f"{radius:g}")
            for column, radius in enumerate(swept.radii)
        ],
        "speeds": [(_middle(swept, row), f"{speed:g}") for row, speed in enumerate(swept.speeds)],
        "left": _LEFT,
        "bottom": rows * _CELL_HEIGHT,
        "shades": SHADES,
        "caption": (
            "In each cell: the share of its drives that fails, which the colour shows, too, and the"
            " lowest MOOBD in m, which is how far the car's centre stayed inside its lane"
            f" ({0.5 * lane_width:g} m is the middle, less than 0 is outside). A cell opens its"
            " worst drive."
        ),
    }
    drives, failures = int(swept.drives.sum()), int(swept.failures.sum())
    lead = f"{counted(failures, 'failure')} of {counted(drives, 'drive')} on single bends."
    return Section("sweep", "Radius and speed", (DataBlock("sweepMap", data),), lead)


def _middle(swept: SweepMap, row: int) -> float:
    """Return the height of a row's middle in the drawing; the highest speed is on top."""
    return (len(swept.speeds) - 1 - row + 0.5) * _CELL_HEIGHT


def _cell(swept: SweepMap, row: int, column: int, lane_width: float) -> dict[str, Any]:
    """Return a cell of the map for the template."""
    drives, failures = int(swept.drives[row, column]), int(swept.failures[row, column])
    moobd = float(swept.moobd[row, column])
    is_measured = math.isfinite(moobd)
    margin = f", MOOBD {oob_words(moobd, lane_width)}" if is_measured else ""
    title = (
        f"{swept.radii[column]:g} m, {swept.speeds[row]:g} km/h:"
        f" {failures} of {counted(drives, 'drive')} failed{margin}"
    )
    return {
        "x": _LEFT + column * _CELL_WIDTH,
        "y": _middle(swept, row) - 0.5 * _CELL_HEIGHT,
        "shade": min(int(SHADES * failures / drives), SHADES - 1) if failures else None,
        "share": f"{100.0 * failures / drives:.0f}\u00a0%",
        "moobd": proper(f"{moobd:.2f}") if is_measured else "",
        "title": proper(title),
        "test": int(swept.worst_tests[row, column]),
    }
