"""Pictures of failures in two simulators: both paths on one road."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from frenetic._support.arrays import FloatArray
from frenetic.again.rerun import Rerun, names_of
from frenetic.again.verdicts import Repeats
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Drive
from frenetic.errors import CampaignError
from frenetic.oracle import Assessment, assess, judge
from frenetic.report.failures import file_stem
from frenetic.report.orientation import turn_of, turned
from frenetic.report.scene import OOB_COLOURS, draw_colour_bar, draw_coloured
from frenetic.report.style import DPI, FAINT, INK, PANEL, QUIET, STYLE, Paper, form_of, write_figure
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

    @cached_property
    def assessed(self) -> tuple[Assessment, Assessment]:
        """Assessments of the recorded and of the other drive."""
        return assess(self.road, self.recorded), assess(self.road, self.other)


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
        figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=DPI, facecolor="white")
        page = Paper(figure, _WIDTH, _HEIGHT)
        _draw_from_above(page, (0.54, 1.2, 8.1, 4.08), pair)
        _draw_oob_distances(figure.add_axes((0.08, 0.08, 0.88, 0.17)), pair)
        figure.text(0.06, 0.96, pair.title, size=16, weight="bold", color=INK)
        for drive, name, colour, y in (
            (pair.recorded, names[0], RECORDED_COLOUR, 0.936),
            (pair.other, names[1], OTHER_COLOUR, 0.894),
        ):
            figure.text(0.06, y, name[:_LETTERS], size=9.5, weight="bold", color=colour)
            reason = judge(pair.road, drive).reason
            figure.text(0.06, y - 0.019, reason[:_LETTERS], size=9.5, color=colour)
        draw_colour_bar(page, 0.96 * _WIDTH, 5.44, 0.5 * pair.road.lane_width)
        write_figure(figure, path, form)


def draw_pairs(pairs: Sequence[Pair], path: Path, names: tuple[str, str]) -> None:
    """Writes a gallery: many roads from above with both paths, each at its own scale.

    Raises:
        FreneticError: the file cannot be written, or its suffix is not that of a picture.
    """
    form = form_of(path)
    rows = math.ceil(len(pairs) / _ACROSS)
    width, height = _ACROSS * _CELL, rows * (_TALL + 0.35) + _HEAD
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
        page = Paper(figure, width, height)
        for i, pair in enumerate(pairs):
            row, column = divmod(i, _ACROSS)
            top = _HEAD + row * (_TALL + 0.35)
            left = (column + 0.04) * _CELL
            _draw_from_above(page, (left, top + 0.1, 0.92 * _CELL, _TALL - 0.1), pair)
            page.text(left, top, pair.title, size=10, weight="bold", color=INK)
        lines = [
            Line2D([], [], **_RECORDED, label=names[0][:_LETTERS]),
            Line2D([], [], **_OTHER, label=names[1][:_LETTERS]),
        ]
        figure.legend(handles=lines, loc="upper left", frameon=False, fontsize=11)
        draw_colour_bar(page, 0.98 * width, 0.19, 0.5 * pairs[0].road.lane_width)
        write_figure(figure, path, form)


def _draw_from_above(page: Paper, box: tuple[float, float, float, float], pair: Pair) -> None:
    """Draws the road with both paths into a box: left, top, width and height in inches."""
    road, turn = pair.road, turn_of(pair.road)
    spacing = max(1.0, road.length / 2000.0)
    line, left, right = (
        turned(road.sample(spacing, side * road.lane_width), turn) for side in (0.0, 1.0, -1.0)
    )
    low, high = np.vstack([left, right]).min(axis=0), np.vstack([left, right]).max(axis=0)
    paths = [
        np.clip(turned(_path(drive, seen), turn), low - 20.0, high + 20.0)
        for drive, seen in zip((pair.recorded, pair.other), pair.assessed, strict=True)
    ]
    shown = np.vstack([low, high, *paths])
    low, high = shown.min(axis=0), shown.max(axis=0)
    # As much as fills the box.
    size = np.array(box[2:])
    middle, half = 0.5 * (low + high), 0.5 * size * max((high - low + 8.0) / size)
    (left_end, lowest), (right_end, highest) = middle - half, middle + half
    panel = page.chart(*box, (left_end, right_end), (lowest, highest))
    panel.edge.set_facecolor(PANEL)
    for edge, colour in ((left, "#d9dde3"), (right, "#c6d7ea")):
        panel.add(Polygon(np.vstack([line, edge[::-1]]), color=colour, linewidth=0.0))
    panel.line(*line.T, color="white", linewidth=1.0, linestyle=(0, (6, 5)))
    recorded, other = paths
    oob = pair.assessed[0].oob_distance
    draw_coloured(panel, recorded, recorded / panel.point, oob, 0.5 * road.lane_width, 2.4)
    panel.line(*other.T, **_OTHER, zorder=5)
    for path, colour in ((recorded, RECORDED_COLOUR), (other, OTHER_COLOUR)):
        panel.mark(path[-1], "o", markersize=5, color=colour, zorder=6)
    panel.mark(recorded[0], "s", markersize=5, color=INK, zorder=6)


def _draw_oob_distances(axes: Any, pair: Pair) -> None:
    half = 0.5 * pair.road.lane_width
    for seen, how in zip(pair.assessed, (_RECORDED, _OTHER), strict=True):
        axes.plot(seen.distance, np.maximum(seen.oob_distance, -half), **how)
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.set(xlim=(0.0, pair.road.length), ylim=(-1.05 * half, 1.05 * half), facecolor=PANEL)
    axes.set_xlabel("along the road (m)")
    axes.set_ylabel("oob distance (m)")
    axes.grid(color=FAINT, linewidth=0.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _path(drive: Drive, seen: Assessment) -> FloatArray:
    """Path up to the record that ended the drive, (n, 2) in m."""
    n = len(seen.distance)
    return np.column_stack([drive.trajectory.x[:n], drive.trajectory.y[:n]])
