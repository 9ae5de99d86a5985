"""Pictures on Matplotlib's axes, for notebooks and figures of your own.

Each draws on the given axes, or on those of a new figure, and returns them. What is seen from above
is drawn by the same code as in the report's pictures.
"""

from __future__ import annotations

import math
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from frenetic._support.words import counted, signed
from frenetic.analysis.comparison import Comparison
from frenetic.analysis.failures import Clusters, distinct_failures, nearest_misses
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Drive
from frenetic.export.tables import Place, opened
from frenetic.report.comparison import draw_chart, draw_curves
from frenetic.report.html.tests import TestSummary
from frenetic.report.html.timeline import EXPECTED, timeline_of
from frenetic.report.picture import draw_sheet, sheet_row
from frenetic.report.scene import (
    SeenDrive,
    View,
    box_of,
    draw_colour_bar,
    draw_scene,
    focus_of,
    look,
    road_of,
)
from frenetic.report.style import STYLE, Paper
from frenetic.road import Road

SHEET: Final = 12
"""Default number of failures that `plot_failures` draws."""

# Sizes in inches.
_WIDE: Final = 6.5  # new axes
_TALL: Final = 5.5
_LEFT, _RIGHT, _TOP, _BOTTOM, _KEY = 0.65, 0.2, 0.4, 0.55, 0.45  # around them


def plot(
    thing: Road | Drive | Test | Comparison,
    ax: Axes | None = None,
    *,
    road: Road | None = None,
    map_size: float | None = None,
) -> Axes:
    """Draws a road or a drive from above, or the failures of compared groups over the simulations.

    A road lies on the axes in metres of the map; what they show already stays in sight. A drive's
    path is coloured by oob distance. A test is drawn as its drive, or else as its road. A group of
    five campaigns or more has its median and the band between its quartiles.

    Args:
        thing: to draw.
        ax: axes to draw on; those of a new figure of pyplot's if None, of a drive with a key to the
            colours.
        road: that was driven, for a drive that does not know it.
        map_size: m, side of the map [0, map_size]^2, whose edge is drawn.

    Returns:
        The axes.

    Raises:
        ValueError: the drive does not know its road.
        CampaignError: the test's campaign does not record with what it was driven.
    """
    with mpl.rc_context(STYLE):
        if isinstance(thing, Comparison):
            axes = _new_axes(_WIDE, 3.2)[0] if ax is None else ax
            draw_curves(axes, thing)
            axes.legend(loc="upper left", frameon=False, fontsize=8.5)
            return axes
        if isinstance(thing, Test) and thing.drive is None:
            thing = thing.road
        if isinstance(thing, Road):
            return _plot_above(thing, None, ax, map_size)
        road = thing.road if isinstance(thing, Test) else road_of(thing, road)
        return _plot_above(road, look(road, thing), ax, map_size)


def _plot_above(
    road: Road, seen: SeenDrive | None, ax: Axes | None, map_size: float | None
) -> Axes:
    """A road and its drive where they lie on the map; what the axes show already stays in sight."""
    box, title = box_of(road, seen, 0.0), f"Road, {road.length:.0f} m"
    if ax is None:
        width, height = min((_WIDE, _TALL) / box.size) * box.size
        key = 0.0 if seen is None else _KEY
        axes, page = _new_axes(max(width, 0.6 * _WIDE), max(height, 2.0), key=key)
        if seen is not None:
            right, y = page.width - _RIGHT, page.height - _KEY + 0.1
            draw_colour_bar(page, right, y, 0.5 * road.lane_width)
    else:
        axes = ax
    if axes.has_data():
        box = box.holding(np.transpose([axes.get_xlim(), axes.get_ylim()]))
    focus = None if seen is None else focus_of(seen)
    draw_scene(View.showing(axes, box, 0.0), road, seen, focus, map_size)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    if seen is not None:
        moobd = seen.result.moobd
        title = f"{seen.result.outcome}{'' if moobd is None else f', MOOBD {signed(moobd)} m'}"
    axes.set_title(title, loc="left", fontsize=9.0)
    return axes


def _new_axes(width: float, height: float, *, key: float = 0.0) -> tuple[Axes, Paper]:
    """Axes of so many inches in a new figure, with room for a key below; and the figure's page."""
    import matplotlib.pyplot as plt  # which chooses a backend: only for who wants a new figure

    wide, tall = _LEFT + width + _RIGHT, _TOP + height + _BOTTOM + key
    page = Paper(plt.figure(figsize=(wide, tall)), wide, tall)
    return page.axes(_LEFT, _TOP, width, height, bare=False), page


# Campaigns


def failures_to_show(
    store: CampaignStore, number: int, limit: int | None = None
) -> tuple[str, list[tuple[str, Road, Test]]]:
    """A title, and the most severe distinct failures with their captions; else near misses.

    Args:
        store: of the campaign.
        number: most drives.
        limit: most failures to compare; the usual number if None.
    """
    counts = store.counts()
    failed = counts.failed
    found = distinct_failures(store) if limit is None else distinct_failures(store, limit)
    title = _distinct_in_words(found, failed)
    if len(found) > number:
        title += f"; the {number} most severe"
    if not failed:
        found = nearest_misses(store, number)
        title = counts.broken or "No failure"
        title += "; the nearest misses" if found else ""
    items = []
    for cluster in found.clusters[:number]:
        test = store.test(cluster.most_severe)
        if test.drive is not None:
            more = f", {len(cluster) - 1} more like it" if len(cluster) > 1 else ""
            items.append((f"Test {test.id}{more}", test.road, test))
    return title, items


def _distinct_in_words(found: Clusters, failed: int) -> str:
    among = (
        counted(failed, "failure")
        if found.failures >= failed
        else f"the {found.failures} most severe of {failed} failures"
    )
    return f"{counted(len(found), 'distinct failure')} among {among}"


def plot_failures(campaign: Place, ax: Axes | None = None, *, number: int = SHEET) -> Axes:
    """Draws the most severe distinct failures from above; the nearest misses if nothing failed.

    Args:
        campaign: with the failures, or its folder.
        ax: axes to draw on; a sheet fills them.
        number: most drives to draw, one of each distinct failure.

    Raises:
        CampaignError: there is no campaign, or it is damaged.
    """
    with opened(campaign) as store, mpl.rc_context(STYLE):
        title, items = failures_to_show(store, number)
        axes = ax
        if axes is None:
            columns = min(max(len(items), 1), 4)
            rows = max(math.ceil(len(items) / columns), 1)
            axes, _ = _new_axes(2.2 * columns, rows * sheet_row(2.2 * columns, columns))
        page = Paper.on(axes)
        axes.set_axis_off()
        axes.set_title(title, loc="left", fontsize=9.0)
        draw_sheet(page, items, _columns(page, len(items)), left=0.0, top=0.0, width=page.width)
    return axes


def _columns(page: Paper, number: int) -> int:
    """The fewest columns in which so many pictures of a sheet fit on a page."""
    for columns in range(1, number):
        if math.ceil(number / columns) * sheet_row(page.width, columns) <= 1.001 * page.height:
            return columns
    return max(number, 1)


def plot_progress(campaign: Place, ax: Axes | None = None) -> Axes:
    """Draws failures and distinct failures over the simulations, as the report does.

    Dashed: how many there would be if all roads were like those of the random phase, with bands of
    what is not known of it (95 %).

    Raises:
        CampaignError: there is no campaign, or it is damaged.
    """
    with opened(campaign) as store:
        charts, _ = timeline_of([*map(TestSummary.of, store.tests())], distinct_failures(store))
    with mpl.rc_context(STYLE):
        axes = _new_axes(_WIDE, 3.2)[0] if ax is None else ax
        if charts:
            chart = charts["simulations"]
            names = {
                line.name: line.name.replace(f" {EXPECTED}", f", {EXPECTED}")
                if line.dashed
                else f"{line.name}: {line.y[-1]:.0f}"
                for line in chart.series
            }
            draw_chart(axes, chart, names)
            axes.legend(loc="upper left", frameon=False, fontsize=8.5)
    return axes
