"""Pictures of roads and drives, drawn with Matplotlib.

A picture of a drive shows the road from above with the car's path coloured by oob distance, a
close-up of the decisive place, and profiles along the road underneath. The file's suffix decides
the format: PNG, SVG or PDF. The same road and drive give the same bytes (with the same version of
Matplotlib), and a file is written completely or not at all.

Only Matplotlib's figure objects are used, never `pyplot`, so no window system is asked for and no
backend of the surrounding program changes. While a picture is drawn, Matplotlib's settings
change for the whole process: draw from one thread at a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from frenetic._support.words import capitalised, oob_words, signed
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import DRIVER, LANE, signal_named
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.report.orientation import turn_of, turned
from frenetic.report.scene import (
    ACROSS,
    ALARM,
    CLOSE_UP,
    COLOURS,
    EGO_LANE,
    HIGHEST,
    Focus,
    JudgedDrive,
    box_of,
    draw_close_up,
    draw_colour_bar,
    draw_coloured,
    draw_key,
    draw_scale,
    draw_scene,
    focus_of,
    look,
)
from frenetic.report.style import (
    FAINT,
    INK,
    INNER,
    MARGIN,
    PANEL,
    POINT,
    QUIET,
    STYLE,
    WIDTH,
    Paper,
    form_of,
    one_line,
    wrapped,
    write_figure,
)
from frenetic.report.view import Box, View, size_of
from frenetic.road import Road, profile

MAX_SHEET: Final = 400
"""Most pictures on one contact sheet."""


# Sizes in inches, ours.
_GAP: Final = 0.14  # between the view from above and the close-up
_LOWEST: Final = 2.4  # least height of the view from above
_HEADING: Final = 0.3  # above a profile along the road
_BETWEEN: Final = 0.2  # between pictures of a sheet
_CAPTION: Final = 0.52  # under a picture of a sheet

_LINE: Final = "#48678a"  # lines of curvature and speed


def draw_drive(
    road: Road,
    drive: Drive | Test,
    path: Path | str,
    *,
    title: str | None = None,
) -> None:
    """Write a picture of one drive to ``path``: PNG, SVG or PDF by its suffix.

    From above: the lanes, the car's path coloured by oob distance, start, end, and where it left
    the lane, again in a close-up. Underneath, along the road: oob distance, curvature and speed. A
    drive in which the simulator broke (ERROR) is shown as far as it went.

    Args:
        road: the road that was driven.
        drive: what the simulator recorded, judged with its own rules, or a test that was driven.
        path: where the picture goes; an existing file is replaced.
        title: headline; the outcome if None.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        judged = look(road, drive)
        result = judged.result
        title = title or f"Drive: {result.outcome}"
        figure = _page(road, judged, title, result.reason, COLOURS[result.outcome])
        write_figure(figure, path, form)


def draw_test(test: Test, path: Path | str, title: str) -> None:
    """Write a picture of a test's drive to ``path``, or of its road if no drive is recorded.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    if test.drive is not None:
        draw_drive(test.road, test, path, title=title)
    else:
        draw_road(test.road, path, title=title, reason=test.reason, outcome=test.outcome)


def draw_road(
    road: Road,
    path: Path | str,
    *,
    title: str | None = None,
    reason: str | None = None,
    outcome: Outcome = Outcome.INVALID,
) -> None:
    """Write a picture of a road that was not driven to ``path``: PNG, SVG or PDF by its suffix.

    Args:
        road: any road, also one that is INVALID.
        path: where the picture goes; an existing file is replaced.
        title: headline; "Road" if None.
        reason: a sentence below it, such as why the road was refused.
        outcome: outcome of the test, for the colour.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        colour = INK if reason is None else COLOURS[outcome]
        write_figure(_page(road, None, title or "Road", reason or "", colour), path, form)


def draw_gallery(
    items: Sequence[tuple[str, Road, Drive | Test | None]],
    path: Path | str,
    *,
    title: str | None = None,
) -> None:
    """Write a contact sheet to ``path``: many drives from above, each at its own scale.

    Args:
        items: (caption, road, drive or test) in reading order, 1 to 400.
        path: where the picture goes, PNG, SVG or PDF by its suffix; an existing file is replaced.
        title: headline; none if None.

    Raises:
        FreneticError: no items or too many, another suffix, or a file that cannot be written.
    """
    form = form_of(path)
    if not 1 <= len(items) <= MAX_SHEET:
        raise FreneticError(f"a contact sheet of {len(items)} drives: 1 to {MAX_SHEET} are allowed")
    with mpl.rc_context(STYLE):
        write_figure(_sheet(items, title), path, form)


Fact: TypeAlias = tuple[str, str, str]  # name, value, detail


def facts_of_drive(road: Road, judged: JudgedDrive) -> list[Fact]:
    """Return the figures of a drive."""
    result = judged.result
    moobd, share, where = result.moobd, result.max_oob_share, result.moobd_distance
    way_out, gravest = result.departure, result.finding
    departure = (
        "Departure",
        str(way_out.side) if way_out else "none" if result.outcome.is_driven else "–",
        "" if way_out is None else f"at {way_out.distance:.0f} m",
    )
    if gravest is not None and gravest.criterion not in (LANE, DRIVER):
        measure = signal_named(gravest.criterion)
        place = f"at {gravest.distance:.0f} m"
        departure = capitalised(measure.words), measure.text(gravest.value), place
    return [
        (
            "MOOBD",
            oob_words(moobd, road.lane_width),
            "" if where is None else f"at {where:.0f} m",
        ),
        ("Largest oob share", "–" if share is None else f"{share:.0%}".replace("%", " %"), ""),
        departure,
        ("Duration", f"{result.duration:.1f} s", ""),
        ("Top speed", f"{judged.speed.max():.0f} km/h" if len(judged) else "–", ""),
        ("Road length", f"{road.length:.0f} m", ""),
    ]


def facts_of_road(road: Road) -> list[Fact]:
    """Return the figures of a road."""
    sharpest = float(np.abs(road.curvatures).max())
    return [
        ("Road length", f"{road.length:.0f} m", ""),
        ("Sharpest curvature", f"{sharpest:.3f} 1/m", ""),
        ("Smallest radius", f"{1.0 / sharpest:.1f} m" if sharpest > 1e-4 else "straight", ""),
        ("Samples", f"{len(road.curvatures)}", f"every {road.step:g} m"),
    ]


_Draw: TypeAlias = Callable[[Axes, Road, JudgedDrive | None], None]
_Profile: TypeAlias = tuple[str, str, float, _Draw]  # name, title, height in inches, drawing


# --- The page --------------------------------------------------------------------------------


def _page(
    road: Road,
    judged: JudgedDrive | None,
    title: str,
    reason: str,
    colour: str,
) -> Figure:
    focus = None if judged is None else focus_of(judged)
    facts = facts_of_road(road) if judged is None else facts_of_drive(road, judged)
    lines = wrapped(reason, 118, 3)
    names = {"curvature"} if focus is None else {"oob", "curvature", "speed"}
    names |= {name for name in ("grade", "superelevation") if len(getattr(road, name))}
    profiles = [row for row in _PROFILES if row[0] in names]

    turn = turn_of(road)
    wide = box_of(road, judged, turn)
    # A picture that shows the road nearly as large needs no close-up.
    scale = float(min((INNER, HIGHEST) / wide.size))
    has_close_up = focus is not None and scale < 0.6 * CLOSE_UP / ACROSS
    main_width = INNER - (CLOSE_UP + _GAP if has_close_up else 0.0)
    main_height = float(np.clip(main_width * wide.flatness, _LOWEST, HIGHEST))

    top = 0.42 + 0.42 + 0.235 * len(lines) + 0.16
    tiles, strip = 0.74, 0.66
    below = sum(height + _HEADING for _, _, height, _ in profiles) + 0.55
    page = Paper.new(WIDTH, top + tiles + main_height + strip + below)
    _draw_headline(page, title, lines, facts, top, colour)

    # From above.
    y = top + tiles
    view = View.showing(page.axes(MARGIN, y, main_width, main_height), wide, turn)
    near = None
    if has_close_up and judged is not None and focus is not None:
        x = MARGIN + main_width + _GAP
        near = _close_up(page.axes(x, y, CLOSE_UP, main_height), turn, road, judged, focus)
    draw_scene(view, road, judged, focus, near=near)
    draw_key(page, y + main_height + 0.1, view, road, judged)

    _draw_profiles(page, road, judged, profiles, y + main_height + strip)
    return page.figure


def _draw_headline(
    page: Paper, title: str, lines: Sequence[str], facts: Sequence[Fact], top: float, colour: str
) -> None:
    """Draw title, reason and figures, which begin ``top`` inches down the page."""
    page.bar(MARGIN, 0.42, 0.07, 0.36 + 0.235 * len(lines), colour)
    page.text(MARGIN + 0.2, 0.42 + 0.29, one_line(title, 58), size=19, weight="bold")
    for i, line in enumerate(lines):
        page.text(MARGIN + 0.2, 0.42 + 0.56 + 0.235 * i, line, size=11, color=QUIET)
    for i, (name, value, detail) in enumerate(facts):
        x = MARGIN + i * INNER / 6.0
        page.text(x, top + 0.18, f"{name}, {detail}" if detail else name, size=8.5, color=QUIET)
        page.text(x, top + 0.45, value, size=14, weight="bold")


def _draw_profiles(
    page: Paper, road: Road, judged: JudgedDrive | None, profiles: Sequence[_Profile], y: float
) -> None:
    """Draw values along the road, one below the other, from ``y`` inches down the page."""
    left, width = MARGIN + 0.45, INNER - 0.45
    for name, title, height, draw in profiles:
        page.text(MARGIN, y + _HEADING - 0.08, title, size=8.5, color=QUIET)
        y += _HEADING
        axes = page.axes(left, y, width, height, bare=False, label=name)
        draw(axes, road, judged)
        axes.set_xlim(0.0, road.length)
        axes.xaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 2.5, 5, 10]))
        axes.grid(visible=True)
        axes.spines["left"].set_visible(False)
        axes.tick_params(labelbottom=name == profiles[-1][0])
        for finding in () if judged is None else judged.result.findings:
            if finding.criterion not in (LANE, DRIVER):
                axes.axvline(finding.distance, color=ALARM, lw=1.0, ls=":", zorder=2)
        if judged is not None and judged.result.departure is not None:
            at = judged.result.departure.distance
            axes.axvline(at, color=ALARM, lw=1.0, zorder=2)
            if name == profiles[0][0]:
                _mark_departure(axes, at / road.length)
        y += height
    middle = left + 0.5 * width
    page.text(middle, y + 0.335, "distance along the road (m)", size=8.5, color=QUIET, ha="center")


def _close_up(axes: Axes, turn: float, road: Road, judged: JudgedDrive, focus: Focus) -> View:
    """Draw the decisive place, and return its view."""
    page = Paper.on(axes)
    (place,) = turned(judged.xy[[focus.record]], turn)
    half = 0.5 * ACROSS * np.array([1.0, page.height / page.width])
    near = View.showing(axes, Box(place - half, place + half), turn)
    draw_close_up(near, road, judged, focus)
    behind = {"facecolor": PANEL, "edgecolor": "none", "alpha": 0.85, "pad": 2.5}
    style: dict[str, Any] = {"weight": "bold", "color": focus.colour, "bbox": behind, "zorder": 9}
    page.text(0.12, 0.24, focus.headline, size=9.5, **style)
    # In the corner where no car is.
    cars = (near.at(judged.xy) - near.centre + near.half) * near.scale
    corner = 0.5 * page.width * POINT, 0.6 * POINT
    is_taken = ((cars > -POINT) & (cars < corner)).all(axis=1).any()
    left = page.width - 5.0 * near.scale / POINT - 0.5 if is_taken else 0.12
    draw_scale(page, left, page.height - 0.14, near, 5.0)
    return near


# --- Along the road --------------------------------------------------------------------------


def _draw_oob_distance(axes: Axes, road: Road, judged: JudgedDrive | None) -> None:
    assert judged is not None
    half = 0.5 * road.lane_width
    value = max(float(judged.oob_distance.min()), -3.0 * half)
    # The departure's label has its place on top.
    low, high = min(-0.6 * half, value - 0.65 * half), 1.55 * half
    axes.set_ylim(low, high)
    axes.set_xlim(0.0, road.length)
    axes.set_yticks([k * half for k in (-1.0, 0.0, 1.0) if k * half > low])
    axes.axhspan(low, 0.0, color="#fbeeee", zorder=0.2, lw=0.0)
    axes.axhline(0.0, color=ALARM, lw=0.8, alpha=0.6, zorder=1.5)
    scale = size_of(axes) / (road.length, high - low)
    places = np.column_stack([judged.distance, judged.oob_distance])
    draw_coloured(axes, places, scale, judged.oob_distance, half, 2.2)
    if judged.result.moobd is None:
        return
    least = int(np.argmin(judged.oob_distance))
    where, moobd = float(judged.distance[least]), float(judged.oob_distance[least])
    style: Any = {"ms": 6.0, "mfc": "white", "mec": INK, "mew": 1.4, "zorder": 6, "clip_on": False}
    axes.plot(where, max(moobd, -3.0 * half), "o", **style)
    share = where / road.length
    if judged.result.departure is not None:  # beside the departure's line
        side, dx, dy = ("left", 8.0, -8.0) if share < 0.2 else ("right", -8.0, -8.0)
    else:
        side, dx, dy = "center", 0.0, -13.0
        side = "left" if share < 0.06 else "right" if share > 0.94 else side
    axes.annotate(
        f"MOOBD {oob_words(moobd, road.lane_width)}", (where, max(moobd, -3.0 * half)), (dx, dy),
        textcoords="offset points", ha=side, va="center", size=8.5, weight="bold", zorder=6,
        annotation_clip=False,
    )  # fmt: skip


def _mark_departure(axes: Axes, share: float) -> None:
    right = share > 0.85
    axes.annotate(
        "departure", (share, 1.0), (-5.0 if right else 5.0, -3.0), xycoords="axes fraction",
        textcoords="offset points", ha="right" if right else "left", va="top", size=8.5,
        weight="bold", color=ALARM, zorder=6,
    )  # fmt: skip


def _draw_curvature(axes: Axes, road: Road, _: JudgedDrive | None) -> None:
    reach = max(0.0125, 1.25 * float(np.abs(road.curvatures).max()))
    axes.set_ylim(-reach, reach)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    places = np.arange(len(road.curvatures)) * road.step
    axes.fill_between(places, road.curvatures, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(places, road.curvatures, color=_LINE, lw=1.4, zorder=3)
    for share, text, va in ((0.95, "left", "top"), (0.05, "right", "bottom")):
        axes.text(1.004, share, text, size=7.5, color=QUIET, va=va, transform=axes.transAxes)


def _draw_speed(axes: Axes, road: Road, judged: JudgedDrive | None) -> None:
    assert judged is not None
    limits = judged.drive.rules.speed_limits_on(road)
    places = [*limits[:, 0], road.length]
    limit = float(limits[-1, 1])
    low, high = float(judged.speed.min()), float(judged.speed.max())
    axes.set_ylim(min(0.0, low), 1.15 * max(float(limits[:, 1].max()), high))
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    if len(limits) == 1:
        axes.axhline(limit, color=QUIET, lw=0.8, dashes=(4.0, 3.0), zorder=1.5)
    else:
        axes.stairs(limits[:, 1], places, baseline=None, color=QUIET, lw=0.8, ls=(0, (4.0, 3.0)))
    axes.text(1.004 * road.length, limit, "limit", size=7.5, color=QUIET, va="center")
    axes.plot(judged.distance, judged.speed, color=_LINE, lw=1.4, zorder=3)


def _draw_height(axes: Axes, road: Road, _: JudgedDrive | None) -> None:
    """Draw the height, and write the grade in the middle of every eighth of the road."""
    places = road.distances()
    heights = road.heights(places)
    low, high = float(heights.min()), float(heights.max())
    reach = max(high - low, 1.0)
    low -= 0.55 * reach  # room for the grades
    axes.set_ylim(low, high + 0.15 * reach)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    axes.fill_between(places, heights, low, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.plot(places, heights, color=_LINE, lw=1.4, zorder=3)
    middles = road.length * (np.arange(8) + 0.5) / 8.0
    for place, grade in zip(middles, profile.value_at(road.grade, middles), strict=True):
        axes.text(
            place, 0.08, f"{'+' if grade > 0.0 else ''}{signed(100.0 * grade, 1)} %", size=7.5,
            color=QUIET, ha="center", transform=axes.get_xaxis_transform(), zorder=5,
        )  # fmt: skip


def _draw_superelevation(axes: Axes, road: Road, _: JudgedDrive | None) -> None:
    places = road.distances()
    slopes = 100.0 * profile.value_at(road.superelevation, places)
    most = max(0.1, round(float(np.abs(slopes).max()), 1))
    axes.set_ylim(-1.3 * most, 1.3 * most)
    axes.set_yticks([-most, 0.0, most])
    axes.fill_between(places, slopes, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(places, slopes, color=_LINE, lw=1.4, zorder=3)


_PROFILES: Final[Sequence[_Profile]] = (
    ("oob", "oob distance (m)", 1.35, _draw_oob_distance),
    ("curvature", "curvature (1/m)", 0.85, _draw_curvature),
    ("superelevation", "superelevation (%), + falls to the right", 0.6, _draw_superelevation),
    ("grade", "height (m), with the grade", 0.85, _draw_height),
    ("speed", "speed (km/h)", 0.85, _draw_speed),
)
"""Values along the road, from top to bottom."""


# --- The contact sheet -----------------------------------------------------------------------


def _sheet(items: Sequence[tuple[str, Road, Drive | Test | None]], title: str | None) -> Figure:
    columns = int(np.clip(math.ceil(math.sqrt(1.2 * len(items))), 1, 8))
    columns = max(columns, min(len(items), 3))
    top = 1.1 if title else 0.65
    rows = math.ceil(len(items) / columns)
    page = Paper.new(WIDTH, top + rows * sheet_row(INNER, columns) + 0.25)
    if title:
        page.text(MARGIN, 0.68, one_line(title, 60), size=19, weight="bold")
    draw_colour_bar(page, WIDTH - MARGIN, top - 0.45, 0.5 * items[0][1].lane_width)
    draw_sheet(page, items, columns, left=MARGIN, top=top, width=INNER)
    return page.figure


def sheet_row(width: float, columns: int) -> float:
    """Return the height of a row of ``columns`` pictures with captions on a sheet, in inches."""
    return _sheet_picture(width, columns) / 1.5 + _CAPTION  # roads lie flat


def _sheet_picture(width: float, columns: int) -> float:
    return (width - _BETWEEN * (columns - 1)) / columns


def draw_sheet(
    page: Paper,
    items: Sequence[tuple[str, Road, Drive | Test | None]],
    columns: int,
    *,
    left: float,
    top: float,
    width: float,
) -> None:
    """Draw (caption, road, drive) from above in reading order; sizes are in inches of the page."""
    picture = _sheet_picture(width, columns)
    height = picture / 1.5
    letters = int(picture / 0.088)
    for k, (text, road, drive) in enumerate(items):
        row, column = divmod(k, columns)
        x = left + column * (picture + _BETWEEN)
        y = top + row * sheet_row(width, columns)
        is_driven = drive is not None and (isinstance(drive, Drive) or drive.drive is not None)
        judged = look(road, drive) if drive is not None and is_driven else None
        turn = turn_of(road)
        view = View.showing(page.axes(x, y, picture, height), box_of(road, judged, turn), turn)
        focus = None if judged is None else focus_of(judged)
        draw_scene(view, road, judged, focus, labelled=False)
        page.text(x, y + height + 0.17, one_line(text, letters), size=9, weight="bold")
        line = f"{road.length:.0f} m"
        if judged is not None:
            result = judged.result
            moobd = result.moobd
            line = (
                f"{result.outcome}, {line}"
                if moobd is None
                else f"{line}, MOOBD {oob_words(moobd, road.lane_width)}"
            )
        page.text(x, y + height + 0.33, line, size=8, color=QUIET)
