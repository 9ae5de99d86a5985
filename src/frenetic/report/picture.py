"""Pictures of roads and drives, drawn with Matplotlib.

A picture of a drive shows the road from above with the car's path coloured by oob distance, a
close-up of the decisive place, and profiles along the road underneath. The file's suffix decides
the
format: PNG, SVG or PDF. The same road and drive give the same bytes (with the same version of
Matplotlib), and a file is written completely or not at all.

Only Matplotlib's figure objects are used, never `pyplot`, so no window system is asked for and no
backend of the surrounding program changes. Matplotlib's settings are those of the whole process
while a picture is drawn: draw from one thread at a time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from frenetic.errors import FreneticError
from frenetic.outcome import Outcome
from frenetic.report.orientation import turn_of
from frenetic.report.scene import (
    ACROSS,
    ALARM,
    CLOSE_UP,
    COLOURS,
    EGO_LANE,
    HIGHEST,
    SeenDrive,
    View,
    box_of,
    draw_close_up,
    draw_colour_bar,
    draw_coloured,
    draw_key,
    draw_scale,
    draw_scene,
    focus_of,
    look,
    sane,
)
from frenetic.report.style import (
    DPI,
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
from frenetic.road import Road
from frenetic.simulators.drive import Drive

MAX_SHEET: Final = 400
"""Most pictures on one contact sheet."""


# Sizes in inches.
_GAP: Final = 0.14
_LOWEST: Final = 2.4  # the road seen from above

_PROFILES: Final[Mapping[str, str]] = {
    "oob": "oob distance (m)",
    "curvature": "curvature (1/m)",
    "speed": "speed (km/h)",
}


def draw_drive(
    road: Road,
    drive: Drive,
    path: Path,
    *,
    title: str | None = None,
    map_size: float | None = None,
) -> None:
    """Write a picture of one drive to ``path``: PNG, SVG or PDF by its suffix.

    From above: the lanes, the car's path coloured by oob distance, start, end, and where it left
    the lane, again in a close-up. Underneath, along the road: oob distance, curvature and speed. A
    drive that broke (ERROR) is shown as far as it went.

    Args:
        road: the road that was driven.
        drive: what the simulator recorded; it is judged with its own rules.
        path: where the picture goes; an existing file is replaced.
        title: headline; the outcome if None.
        map_size: m, side of the map [0, map_size]^2, whose edge is drawn where it is in sight.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        seen = look(road, drive)
        outcome = seen.result.outcome
        figure = _page(
            road,
            seen,
            title or f"Drive: {outcome}",
            seen.result.reason,
            COLOURS[outcome],
            _facts(road, seen),
            map_size,
        )
        write_figure(figure, path, form)


def draw_road(
    road: Road,
    path: Path,
    *,
    title: str | None = None,
    reason: str | None = None,
    map_size: float | None = None,
) -> None:
    """Write a picture of a road that was not driven to ``path``: PNG, SVG or PDF by its suffix.

    Args:
        road: any road, also one that is INVALID.
        path: where the picture goes; an existing file is replaced.
        title: headline; "Road" if None.
        reason: a sentence below it, such as why the road was refused.
        map_size: m, side of the map [0, map_size]^2, whose edge is drawn where it is in sight.

    Raises:
        FreneticError: another suffix, or a file that cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        colour = INK if reason is None else COLOURS[Outcome.INVALID]
        figure = _page(
            road, None, title or "Road", reason or "", colour, _road_facts(road), map_size
        )
        write_figure(figure, path, form)


def draw_gallery(
    items: Sequence[tuple[str, Road, Drive]], path: Path, *, title: str | None = None
) -> None:
    """Write a contact sheet to ``path``: many drives from above, each at its own scale.

    Args:
        items: (caption, road, drive) in reading order, 1 to 400.
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


_Fact: TypeAlias = tuple[str, str, str]  # name, value, detail


def _facts(road: Road, seen: SeenDrive) -> list[_Fact]:
    result = seen.result
    moobd, share, where = result.moobd, result.max_oob_share, result.moobd_distance
    left = result.departure
    return [
        (
            "MOOBD",
            "–" if moobd is None else f"{_signed(moobd, 2)} m",
            "" if where is None else f"at {where:.0f} m",
        ),
        ("Largest oob share", "–" if share is None else f"{share:.0%}".replace("%", " %"), ""),
        (
            "Departure",
            "none"
            if left is None and result.outcome.is_driven
            else "–"
            if left is None
            else left.side,
            "" if left is None else f"at {left.distance:.0f} m",
        ),
        ("Duration", f"{result.duration:.1f} s", ""),
        ("Top speed", f"{seen.speed.max():.0f} km/h" if len(seen) else "–", ""),
        ("Road length", f"{road.length:.0f} m", ""),
    ]


def _road_facts(road: Road) -> list[_Fact]:
    sharpest = float(np.abs(road.curvatures).max())
    return [
        ("Road length", f"{road.length:.0f} m", ""),
        ("Sharpest curvature", f"{sharpest:.3f} 1/m", ""),
        ("Smallest radius", f"{1.0 / sharpest:.1f} m" if sharpest > 1e-4 else "straight", ""),
        ("Samples", f"{len(road.curvatures)}", f"every {road.step:g} m"),
    ]


def _signed(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "−")


# --- The page --------------------------------------------------------------------------------


def _page(
    road: Road,
    seen: SeenDrive | None,
    title: str,
    reason: str,
    colour: str,
    facts: Sequence[_Fact],
    map_size: float | None,
) -> Figure:
    focus = None if seen is None else focus_of(seen)
    lines = wrapped(reason, 118, 3)
    profiles = ["oob", "curvature", "speed"] if focus is not None else ["curvature"]
    heights = {"oob": 1.35, "curvature": 0.85, "speed": 0.85}

    turn = turn_of(road)
    wide = box_of(road, seen, turn)
    # A road that is shown that large already needs no close-up.
    shown = min(INNER / wide.width, HIGHEST / wide.height)
    closer = focus is not None and shown < 0.6 * CLOSE_UP / ACROSS
    main_width = INNER - (CLOSE_UP + _GAP if closer else 0.0)
    main_height = float(np.clip(main_width * wide.height / wide.width, _LOWEST, HIGHEST))

    top = 0.42 + 0.42 + 0.235 * len(lines) + 0.16
    tiles = 0.74
    strip = 0.66
    heading = 0.3
    below = sum(heights[name] + heading for name in profiles) + 0.55
    height = top + tiles + main_height + strip + below
    page = Paper(Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white"), WIDTH, height)

    # Headline.
    page.bar(MARGIN, 0.42, 0.07, 0.36 + 0.235 * len(lines), colour)
    page.text(MARGIN + 0.2, 0.42 + 0.29, one_line(title, 58), size=19, weight="bold")
    for i, line in enumerate(lines):
        page.text(MARGIN + 0.2, 0.42 + 0.56 + 0.235 * i, line, size=11, color=QUIET)
    for i, (name, value, detail) in enumerate(facts):
        x = MARGIN + i * INNER / 6.0
        name = f"{name}, {detail}" if detail else name
        page.text(x, top + 0.18, name, size=8.5, color=QUIET)
        page.text(x, top + 0.45, value, size=14, weight="bold")

    # From above.
    y = top + tiles
    view = View.showing(wide, turn, main_width, main_height)
    main = page.panel(MARGIN, y, view.width, view.height)
    near = None
    if closer and seen is not None and focus is not None:
        near = view.zoomed(sane(seen.xy[focus.record]), ACROSS, CLOSE_UP, main_height)
        x = MARGIN + main_width + _GAP
        draw_close_up(page.panel(x, y, near.width, near.height), near, road, seen, focus)
        page.text(
            x + 0.12, y + 0.24, focus.what, size=9.5, weight="bold", color=focus.colour,
            bbox={"facecolor": PANEL, "edgecolor": "none", "alpha": 0.85, "pad": 2.5},
        )  # fmt: skip
        # In the corner where no car is.
        middle = 0.5 * np.array([near.width, near.height])
        cars = near.at(sane(seen.xy)) + middle
        in_corner = (cars > -POINT) & (cars < (middle[0], 0.6 * POINT))
        is_taken = in_corner.all(axis=1).any()
        left = CLOSE_UP - 5.0 * near.scale / POINT - 0.5 if is_taken else 0.12
        draw_scale(page, x + left, y + main_height - 0.14, near, 5.0)
    draw_scene(main, view, road, seen, focus, map_size, near=near)
    draw_key(page, y + main_height + 0.1, view, road, seen, map_size)

    # Along the road.
    y += main_height + strip
    for name in profiles:
        last = name == profiles[-1]
        page.text(MARGIN, y + heading - 0.08, _PROFILES[name], size=8.5, color=QUIET)
        y += heading
        axes = page.axes(MARGIN + 0.45, y, INNER - 0.45, heights[name])
        _style_profile(axes, road, labelled=last)
        if name == "curvature":
            _draw_curvature(axes, road)
        elif seen is not None and focus is not None:
            if name == "oob":
                _draw_oob_distance(axes, road, seen)
            else:
                _draw_speed(axes, seen)
        if seen is not None and seen.result.departure is not None:
            axes.axvline(seen.result.departure.distance, color=ALARM, lw=1.0, zorder=2)
            if name == profiles[0]:
                _mark_departure(axes, road, seen.result.departure.distance)
        y += heights[name]
    return page.figure


# --- Along the road --------------------------------------------------------------------------


def _style_profile(axes: Any, road: Road, *, labelled: bool) -> None:
    axes.set_xlim(0.0, road.length)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(length=0.0, labelbottom=labelled)
    axes.grid(True, color="#e8ebef", lw=0.7)
    axes.set_axisbelow(True)
    axes.xaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    if labelled:
        axes.set_xlabel("distance along the road (m)", size=8.5)


def _draw_oob_distance(axes: Any, road: Road, seen: SeenDrive) -> None:
    half = 0.5 * road.lane_width
    least = int(np.argmin(seen.oob_distance))
    value = max(float(seen.oob_distance[least]), -3.0 * half)
    low = min(-0.6 * half, value - 0.65 * half)
    axes.set_ylim(low, 1.55 * half)  # the departure's label has its place on top
    axes.axhspan(low, 0.0, color="#fbeeee", zorder=0.2, lw=0.0)
    axes.axhline(0.0, color=ALARM, lw=0.8, alpha=0.6, zorder=1.5)
    axes.set_yticks([k * half for k in (-1.0, 0.0, 1.0) if k * half > low])
    places = np.column_stack([seen.distance, seen.oob_distance])
    on_paper = places * (POINT * INNER / road.length, POINT * 1.35 / (1.55 * half - low))
    draw_coloured(axes, places, on_paper, seen.oob_distance, half, 2.2)
    if seen.result.moobd is None:
        return
    where = float(seen.distance[least])
    axes.plot(where, value, "o", ms=6.0, mfc="white", mec=INK, mew=1.4, zorder=6, clip_on=False)
    text = f"MOOBD {_signed(float(seen.oob_distance[least]), 2)} m"
    share = where / road.length
    if seen.result.departure is not None:  # beside the departure's line
        side, dx, dy = ("left", 8.0, -8.0) if share < 0.2 else ("right", -8.0, -8.0)
    else:
        side, dx, dy = "center", 0.0, -13.0
        side = "left" if share < 0.06 else "right" if share > 0.94 else side
    axes.annotate(
        text,
        (where, value),
        (dx, dy),
        textcoords="offset points",
        ha=side,
        va="center",
        size=8.5,
        weight="bold",
        zorder=6,
    )


def _mark_departure(axes: Any, road: Road, distance: float) -> None:
    right = distance > 0.85 * road.length
    axes.annotate(
        "departure",
        (distance, 1.0),
        (-5.0 if right else 5.0, -3.0),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        ha="right" if right else "left",
        va="top",
        size=8.5,
        weight="bold",
        color=ALARM,
        zorder=6,
    )


def _draw_curvature(axes: Any, road: Road) -> None:
    places = np.arange(len(road.curvatures)) * road.step
    reach = max(0.0125, 1.25 * float(np.abs(road.curvatures).max()))
    axes.set_ylim(-reach, reach)
    axes.fill_between(places, road.curvatures, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(places, road.curvatures, color="#48678a", lw=1.4, zorder=3)
    for y, text, va in ((0.95, "left", "top"), (0.05, "right", "bottom")):
        axes.text(1.004, y, text, transform=axes.transAxes, size=7.5, color=QUIET, va=va, ha="left")


def _draw_speed(axes: Any, seen: SeenDrive) -> None:
    limit = seen.drive.rules.speed_limit
    axes.set_ylim(min(0.0, float(seen.speed.min())), 1.15 * max(limit, float(seen.speed.max())))
    axes.axhline(limit, color=QUIET, lw=0.8, dashes=(4.0, 3.0), zorder=1.5)
    axes.annotate(
        "limit",
        (1.004, limit),
        xycoords=("axes fraction", "data"),
        size=7.5,
        color=QUIET,
        va="center",
    )
    axes.plot(seen.distance, seen.speed, color="#48678a", lw=1.4, zorder=3)


# --- The contact sheet -----------------------------------------------------------------------


def _sheet(items: Sequence[tuple[str, Road, Drive]], title: str | None) -> Figure:
    columns = int(np.clip(math.ceil(math.sqrt(1.2 * len(items))), 1, 8))
    columns = max(columns, min(len(items), 3))
    rows = math.ceil(len(items) / columns)
    width = (INNER - 0.2 * (columns - 1)) / columns
    height = width / 1.5  # roads lie flat
    top, caption = 1.1 if title else 0.65, 0.52
    total = top + rows * (height + caption) + 0.25
    page = Paper(Figure(figsize=(WIDTH, total), dpi=DPI, facecolor="white"), WIDTH, total)
    if title:
        page.text(MARGIN, 0.68, one_line(title, 60), size=19, weight="bold")
    bar = page.axes(WIDTH - MARGIN - 3.2, top - 0.45, 3.2, 0.11)
    draw_colour_bar(bar, 0.5 * items[0][1].lane_width)
    page.text(
        WIDTH - MARGIN - 3.35, top - 0.35, "oob distance (m)", size=8.5, color=QUIET, ha="right"
    )
    letters = int(width / 0.088)
    for k, (text, road, drive) in enumerate(items):
        row, column = divmod(k, columns)
        x = MARGIN + column * (width + 0.2)
        y = top + row * (height + caption)
        seen = look(road, drive)
        turn = turn_of(road)
        view = View.showing(box_of(road, seen, turn), turn, width, height)
        frame = page.panel(x, y, view.width, view.height)
        draw_scene(frame, view, road, seen, focus_of(seen), None, labelled=False)
        page.text(x, y + height + 0.17, one_line(text, letters), size=9, weight="bold")
        page.text(x, y + height + 0.33, _sheet_line(road, seen), size=8, color=QUIET)
    return page.figure


def _sheet_line(road: Road, seen: SeenDrive) -> str:
    result = seen.result
    if result.moobd is None:
        return f"{result.outcome}, {road.length:.0f} m"
    return f"{road.length:.0f} m, MOOBD {_signed(result.moobd, 2)} m"
