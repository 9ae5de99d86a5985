"""Pictures of failures in two simulators: both paths on one road."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from frenetic.again.rerun import Rerun, names_of
from frenetic.again.verdicts import Repeats
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Drive
from frenetic.errors import CampaignError
from frenetic.oracle import assess, judge
from frenetic.report.failures import file_stem
from frenetic.report.orientation import turn_of
from frenetic.report.scene import (
    OOB_COLOURS,
    View,
    box_of,
    draw_colour_bar,
    draw_coloured,
    draw_surface,
    look,
    sane,
)
from frenetic.report.style import FAINT, INK, PANEL, QUIET, STYLE, Paper, form_of, write_figure
from frenetic.road import Road
from frenetic.spec import part_text

ELSEWHERE: Final = "elsewhere"
"""Folder in a campaign's folder for these pictures."""
GALLERY: Final = "gallery.png"
"""Picture in it of all of them at a glance."""
RECORDED_COLOUR, OTHER_COLOUR = OOB_COLOURS[-3], INK
"""Colours of what is said of the campaign's drive and of the other, whose lines are dashed. From
above, the campaign's path is coloured by oob distance, as in all pictures."""

_WIDTH: Final = 9.0  # inches
_HEIGHT: Final = 8.0
_ACROSS: Final = 3  # pictures in a row of a gallery
_CELL: Final = 3.4  # inches across, and
_TALL: Final = 2.3  # high: roads lie flat
_HEAD: Final = 0.9  # inches above the pictures of a gallery
_MOST: Final = 60  # pictures in a gallery
_LETTERS: Final = 110  # that fit into a line

_RECORDED: Final[dict[str, Any]] = {"color": RECORDED_COLOUR, "linewidth": 1.8}
_OTHER: Final[dict[str, Any]] = {
    "color": OTHER_COLOUR,
    "linewidth": 1.5,
    "linestyle": (0, (4, 1.5)),
}


@dataclass(frozen=True)
class Pair:
    """Two drives on one road."""

    road: Road
    recorded: Drive
    """Drive in the campaign."""
    other: Drive
    """Drive in the other simulator."""
    title: str


def write_elsewhere(store: CampaignStore, rerun: Rerun, out: Path | None = None) -> Path | None:
    """Draws the first drive of each test of a rerun, and a gallery, into a folder.

    Args:
        store: the campaign.
        rerun: of its tests, in another simulator.
        out: by default the campaign's folder.

    Returns:
        The gallery; None if nothing was driven.

    Raises:
        CampaignError: the folder cannot be made.
        FreneticError: a picture cannot be written.
    """
    names = names_of(rerun, store.config)
    folder = (out or store.folder) / pictures_of(rerun)
    pairs = {test.id: _pair(store, test) for test in rerun.tests}
    driven = {test_id: pair for test_id, pair in pairs.items() if pair is not None}
    if not driven:
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CampaignError(f"{folder} cannot be made: {error.strerror or error}") from None
    for test_id, pair in driven.items():
        draw_pair(pair, folder / f"{file_stem(test_id)}.png", names)
    draw_pairs(list(driven.values())[:_MOST], folder / GALLERY, names)
    return folder / GALLERY


def pictures_of(rerun: Rerun) -> Path:
    """The folder of a rerun's pictures, seen from the campaign's: one file per test."""
    return Path(ELSEWHERE) / f"{part_text(rerun.simulator)}-{rerun.key}"


def _pair(store: CampaignStore, test: Repeats) -> Pair | None:
    stored, other = store.test(test.id), test.drives[0].test.drive
    if stored.drive is None or other is None or not len(other.trajectory):
        return None
    return Pair(stored.road, stored.drive, other, f"Test {test.id}: {test.verdict}")


def draw_pair(pair: Pair, path: Path, names: tuple[str, str]) -> None:
    """Writes one picture: the road from above with both paths, and both oob distances along it.

    Raises:
        FreneticError: the file cannot be written, or its suffix is not that of a picture.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        page = Paper.new(_WIDTH, _HEIGHT)
        page.text(0.54, 0.32, pair.title, size=16, weight="bold")
        for drive, name, colour, y in (
            (pair.recorded, names[0], RECORDED_COLOUR, 0.51),
            (pair.other, names[1], OTHER_COLOUR, 0.85),
        ):
            page.text(0.54, y, name[:_LETTERS], size=9.5, weight="bold", color=colour)
            reason = judge(pair.road, drive).reason
            page.text(0.54, y + 0.15, reason[:_LETTERS], size=9.5, color=colour)
        _draw_from_above(page.axes(0.54, 1.2, 8.1, 4.08), pair)
        draw_colour_bar(page, 0.96 * _WIDTH, 5.44, 0.5 * pair.road.lane_width)
        _draw_oob_distances(page.axes(0.72, 6.0, 7.92, 1.36, bare=False), pair)
        write_figure(page.figure, path, form)


def draw_pairs(pairs: Sequence[Pair], path: Path, names: tuple[str, str]) -> None:
    """Writes a gallery: many roads from above with both paths, each at its own scale.

    Raises:
        FreneticError: the file cannot be written, or its suffix is not that of a picture.
    """
    form = form_of(path)
    rows = math.ceil(len(pairs) / _ACROSS)
    with mpl.rc_context(STYLE):
        page = Paper.new(_ACROSS * _CELL, rows * (_TALL + 0.35) + _HEAD)
        for i, pair in enumerate(pairs):
            row, column = divmod(i, _ACROSS)
            top = _HEAD + row * (_TALL + 0.35)
            left = (column + 0.04) * _CELL
            _draw_from_above(page.axes(left, top + 0.1, 0.92 * _CELL, _TALL - 0.1), pair)
            page.text(left, top, pair.title, size=10, weight="bold")
        lines = [
            Line2D([], [], **_RECORDED, label=names[0][:_LETTERS]),
            Line2D([], [], **_OTHER, label=names[1][:_LETTERS]),
        ]
        page.figure.legend(handles=lines, loc="upper left", frameon=False, fontsize=11)
        draw_colour_bar(page, 0.98 * page.width, 0.19, 0.5 * pairs[0].road.lane_width)
        write_figure(page.figure, path, form)


def _draw_from_above(axes: Axes, pair: Pair) -> None:
    """Draws the road with both paths."""
    road, turn = pair.road, turn_of(pair.road)
    recorded, other = (look(road, drive) for drive in (pair.recorded, pair.other))
    box = box_of(road, recorded, turn).holding(box_of(road, other, turn).ends)
    view = View.showing(axes, box, turn)
    draw_surface(view, road)
    paths = [view.at(sane(seen.xy)) for seen in (recorded, other)]
    half = 0.5 * road.lane_width
    draw_coloured(axes, paths[0], view.scale, recorded.oob_distance, half, 2.4)
    axes.plot(*paths[1].T, **_OTHER, zorder=5)
    for path, colour in zip(paths, (RECORDED_COLOUR, OTHER_COLOUR), strict=True):
        view.mark(path[-1], "o", ms=5, color=colour, zorder=6)
    view.mark(paths[0][0], "s", ms=5, color=INK, zorder=6)


def _draw_oob_distances(axes: Axes, pair: Pair) -> None:
    half = 0.5 * pair.road.lane_width
    for drive, how in ((pair.recorded, _RECORDED), (pair.other, _OTHER)):
        seen = assess(pair.road, drive)
        axes.plot(seen.distance, np.maximum(seen.oob_distance, -half), **how)
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set(xlim=(0.0, pair.road.length), ylim=(-1.05 * half, 1.05 * half), facecolor=PANEL)
    axes.set_xlabel("along the road (m)")
    axes.set_ylabel("oob distance (m)")
    axes.grid(visible=True, color=FAINT)
