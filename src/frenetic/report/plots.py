"""Drawings on Matplotlib's axes, for notebooks and figures of your own.

`plot` and `plot_progress` draw on the axes that they get, or on axes of a new figure, and return
the axes. The report's pictures draw views from above with the same code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from frenetic._support.words import counted, oob_words
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.comparison import Comparison
from frenetic.campaign.record import Test
from frenetic.export.table_rows import CampaignSource, open_store
from frenetic.oracle.drive import Drive
from frenetic.report.html.comparison import group_charts
from frenetic.report.html.page import Chart
from frenetic.report.html.tests import TestSummary
from frenetic.report.html.timeline import timeline_of
from frenetic.report.judged_drive import JudgedDrive, focus_of, judge_drive, road_of
from frenetic.report.scene import box_of, draw_colour_bar, draw_scene
from frenetic.report.style import FAINT, STYLE, WIDTH, Paper, form_of, write_figure
from frenetic.report.view import View
from frenetic.road import Road

# Distinct with any kind of colour vision.
_GROUP_COLOURS: Final = (
    "#0b5fa5", "#e07b1a", "#1b8a6b", "#8a4fa0", "#b3262c", "#5c6670", "#c2a200", "#c2407f",
)  # fmt: skip
_COLOURS: Final[Mapping[str, str]] = {
    "accent": "#0b5fa5",
    "fail": "#d1232a",
    **{f"group-{i}": colour for i, colour in enumerate(_GROUP_COLOURS)},
}
"""Role of a line in a chart -> colour on paper."""

# Sizes in inches, our choice.
_AXES_WIDTH: Final = 6.5  # most width of new axes
_AXES_HEIGHT: Final = 5.5  # most height of new axes with a view from above
_CHART_HEIGHT: Final = 3.2  # height of new axes with a chart
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.65, 0.2, 0.4, 0.55  # margins of new axes
_COMPARISON_HEIGHT: Final = 7.15  # of the picture of a comparison with two rows of charts
_KEY_HEIGHT: Final = 0.45  # of the key to the colours below new axes


def plot(
    thing: Road | Drive | Test | Comparison, ax: Axes | None = None, *, road: Road | None = None
) -> Axes:
    """Draw a road or a drive from above, or the failures of compared groups over the simulations.

    A road is drawn where it lies on the map, in m; earlier drawings on the axes stay in sight. The
    path of a drive is coloured by oob distance. A test is drawn as its drive; without a drive, as
    its road. A group of campaigns is drawn as its median; a group of five or more campaigns has a
    band between the quartiles.

    Args:
        thing: what to draw.
        ax: axes to draw on; by default axes of a new figure of pyplot, which has a key to the
            colours of a drive.
        road: the driven road, for a drive that does not know it.

    Returns:
        The axes.

    Raises:
        ValueError: the drive does not know its road.
        CampaignError: the test's campaign does not record the parts that drove it.
    """
    with mpl.rc_context(STYLE):
        if isinstance(thing, Comparison):
            axes = _new_axes(_AXES_WIDTH, _CHART_HEIGHT)[0] if ax is None else ax
            draw_curves(axes, thing)
            return axes
        if isinstance(thing, Test) and thing.drive is None:
            thing = thing.road
        if isinstance(thing, Road):
            return _plot_above(thing, None, ax)
        road = thing.road if isinstance(thing, Test) else road_of(thing, road)
        return _plot_above(road, judge_drive(road, thing), ax)


def _plot_above(road: Road, judged: JudgedDrive | None, ax: Axes | None) -> Axes:
    """Draw a road and its drive where they lie on the map; earlier drawings stay in sight.

    Args:
        road: the road.
        judged: the drive; None for the road alone.
        ax: axes to draw on; None for a new figure.
    """
    box, title = box_of(road, judged, turn=0.0), f"Road, {road.length:.0f} m"
    if ax is None:
        width, height = min((_AXES_WIDTH, _AXES_HEIGHT) / box.size) * box.size
        key_height = 0.0 if judged is None else _KEY_HEIGHT
        axes, page = _new_axes(
            max(width, 0.6 * _AXES_WIDTH), max(height, 2.0), key_height=key_height
        )
        if judged is not None:
            right, y = page.width - _RIGHT, page.height - _KEY_HEIGHT + 0.1
            draw_colour_bar(page, right, y, 0.5 * road.lane_width)
    else:
        axes = ax
    if axes.has_data():
        box = box.holding(np.transpose([axes.get_xlim(), axes.get_ylim()]))
    focus = None if judged is None else focus_of(judged)
    draw_scene(View.showing(axes, box, turn=0.0), road, judged, focus)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    if judged is not None:
        moobd = judged.result.moobd
        title = str(judged.result.outcome)
        title += "" if moobd is None else f", MOOBD {oob_words(moobd, road.lane_width)}"
    axes.set_title(title, loc="left", fontsize=9.0)
    return axes


def _new_axes(width: float, height: float, *, key_height: float = 0.0) -> tuple[Axes, Paper]:
    """Return axes in a new figure with room for a key below, and the figure; sizes in inches."""
    import matplotlib.pyplot as plt  # it chooses a backend, which a user's own figure needs not

    page_width, page_height = _LEFT + width + _RIGHT, _TOP + height + _BOTTOM + key_height
    page = Paper(plt.figure(figsize=(page_width, page_height)), page_width, page_height)
    return page.axes(_LEFT, _TOP, width, height, bare=False), page


def plot_progress(campaign: CampaignSource, ax: Axes | None = None) -> Axes:
    """Draw failures and distinct failures over the simulations, as in the report.

    The dashed line shows how many failures there would be if all roads failed as often as the
    random ones; the band around it is the 95 % interval.

    Args:
        campaign: a campaign, open or not, or its folder.
        ax: axes to draw on; by default axes of a new figure of pyplot.

    Raises:
        CampaignError: there is no campaign, or it is damaged.
    """
    with open_store(campaign) as store:
        repeats = store.repeats()
        tests = [TestSummary.of(test, is_repeat=test.id in repeats) for test in store.tests()]
        chart = timeline_of(tests, distinct_failures(store))
    with mpl.rc_context(STYLE):
        axes = _new_axes(_AXES_WIDTH, _CHART_HEIGHT)[0] if ax is None else ax
        if chart is not None:
            counts = {line.name: f"{line.name}: {line.y[-1]:.0f}" for line in chart.series[:2]}
            _draw_chart(axes, chart, lambda name: counts.get(name, name))
    return axes


def draw_comparison(comparison: Comparison, path: Path | str) -> None:
    """Write a picture of a comparison to ``path``: PNG, SVG or PDF by its suffix.

    Two charts show distinct failures and failures over the simulations, and below three charts
    failures unlike each other over the radius: the median of each group, and the band between its
    quartiles.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    form = form_of(path)
    charts = group_charts(comparison)
    over_simulations, over_radius = (
        [chart for curve, chart in charts.items() if curve.is_over_radius is is_over_radius]
        for is_over_radius in (False, True)
    )
    with mpl.rc_context(STYLE):
        page = Paper.new(WIDTH, _COMPARISON_HEIGHT if over_radius else 4.2)
        for chart, left in zip(over_simulations, (0.65, 6.15), strict=True):
            axes = page.axes(left, 0.2, 4.6, 3.4, bare=False)
            _draw_groups(axes, comparison, chart)
        for chart, left in zip(over_radius, (0.65, 4.3, 7.95), strict=False):
            axes = page.axes(left, 4.35, 2.8, 2.2, bare=False)
            _draw_chart(axes, chart, None)
        write_figure(page.figure, path, form)


def draw_curves(axes: Axes, comparison: Comparison) -> None:
    """Draw each group's curve of distinct failures over the simulations."""
    _draw_groups(axes, comparison, next(iter(group_charts(comparison).values())))


def _draw_groups(axes: Axes, comparison: Comparison, chart: Chart) -> None:
    """Draw a chart of a comparison, with a legend that gives the numbers of campaigns."""
    groups = comparison.groups
    _draw_chart(axes, chart, lambda name: f"{name}, {counted(len(groups[name]), 'campaign')}")


def _draw_chart(axes: Axes, chart: Chart, name_of: Callable[[str], str] | None) -> None:
    """Draw a chart of counts.

    Args:
        axes: axes to draw on.
        chart: the chart.
        name_of: function of a line's name that returns the line's text in the legend; None for no
            legend.
    """
    for line in chart.series:
        colour, style = _COLOURS[line.role], (0, (4, 2)) if line.dashed else "-"
        if line.low:
            axes.fill_between(line.x, line.low, line.high, color=colour, alpha=0.16, linewidth=0)
        for single in line.singles:
            axes.plot(line.x, single, color=colour, alpha=0.3, linewidth=0.8)
        label = line.name if name_of is None else name_of(line.name)
        axes.plot(
            line.x, line.y, label=label, color=colour, linestyle=style, lw=line.width,
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
    if name_of is not None:
        axes.legend(loc="upper left", frameon=False, fontsize=8.5)
