"""Pictures of roads and drives as files, drawn with Matplotlib.

A picture of a drive shows the road from above with the car's path coloured by oob distance, a
close-up of the decisive place, and profiles along the road below. The file's suffix decides the
format: PNG, SVG or PDF. The same road and drive give the same bytes (with the same version of
Matplotlib), and a file is written completely or not at all.

Only Matplotlib's figure objects are used, never `pyplot`: no window is opened, and the backend of
the surrounding program stays. While a picture is drawn, Matplotlib's settings
change for the whole process: draw from one thread at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from frenetic._support.words import capitalised, oob_words
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import DRIVER, LANE, signal_named
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.report.judged_drive import Focus, JudgedDrive, focus_of, judge_drive
from frenetic.report.orientation import turn_of, turned
from frenetic.report.profiles import draw_profiles, height_of, profiles_of
from frenetic.report.scene import (
    CLOSE_UP_SPAN,
    CLOSE_UP_WIDTH,
    MAX_VIEW_HEIGHT,
    box_of,
    draw_close_up,
    draw_key,
    draw_scale,
    draw_scene,
)
from frenetic.report.sheet import SheetItem, sheet_figure
from frenetic.report.style import (
    INK,
    INNER_WIDTH,
    MARGIN,
    OUTCOME_COLOURS,
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
from frenetic.report.view import Box, View
from frenetic.road import Road
from frenetic.segments.passing import PassingDrives

MAX_SHEET: Final = 400
"""Largest number of pictures on one contact sheet."""


# Sizes in inches, our choice.
_CLOSE_UP_GAP: Final = 0.14  # between the view from above and the close-up
_MIN_VIEW_HEIGHT: Final = 2.4  # least height of the view from above
_HEADLINE_TOP: Final = 0.42  # from the page's upper edge to the headline
_LINE_HEIGHT: Final = 0.235  # of a line below the headline
_FACTS_HEIGHT: Final = 0.74  # of the figures below the headline
_KEY_HEIGHT: Final = 0.66  # of scale and key to the colours, below the view from above
_SCALE_LENGTH: Final = 5.0  # [m] length of the scale in the close-up


def draw_drive(
    road: Road,
    drive: Drive | Test,
    path: Path | str,
    *,
    title: str | None = None,
    passing: PassingDrives | None = None,
) -> None:
    """Write a picture of one drive to ``path``: PNG, SVG or PDF by its suffix.

    The view from above shows the lanes, the car's path coloured by oob distance, start and end of
    the road, and where the car left its lane; a close-up shows that place again. Below are profiles
    along the road: oob distance, curvature and speed. A drive in which the simulator broke (ERROR)
    is shown as far as it was recorded.

    Args:
        road: the road that was driven.
        drive: the drive, which is judged with its own rules, or a test that was driven.
        path: path of the file; an existing file is replaced.
        title: headline; by default the outcome.
        passing: passing drives of the same driver, with which a mistake is compared.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        judged = judge_drive(road, drive, passing)
        result = judged.result
        title = title or f"Drive: {result.outcome}"
        figure = _page(road, judged, title, result.reason, OUTCOME_COLOURS[result.outcome])
        write_figure(figure, path, form)


def draw_test(
    test: Test, path: Path | str, title: str, passing: PassingDrives | None = None
) -> None:
    """Write a picture of a test's drive to ``path``, or of its road if no drive is recorded.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    if test.drive is not None:
        draw_drive(test.road, test, path, title=title, passing=passing)
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
        road: any road, valid or not.
        path: path of the file; an existing file is replaced.
        title: headline; by default "Road".
        reason: a sentence below the headline, such as why the road was refused.
        outcome: outcome of the test, which gives the colour if there is a reason.

    Raises:
        FreneticError: the path has another suffix, or the file cannot be written.
    """
    form = form_of(path)
    with mpl.rc_context(STYLE):
        colour = INK if reason is None else OUTCOME_COLOURS[outcome]
        write_figure(_page(road, None, title or "Road", reason or "", colour), path, form)


def draw_gallery(
    items: Sequence[SheetItem],
    path: Path | str,
    *,
    title: str | None = None,
) -> None:
    """Write a contact sheet to ``path``: many drives from above, each at its own scale.

    Args:
        items: caption, road and drive or test of each picture in reading order, 1 to 400.
        path: path of the file, PNG, SVG or PDF by its suffix; an existing file is replaced.
        title: headline; by default no headline.

    Raises:
        FreneticError: there are no items or too many, the path has another suffix, or the file
            cannot be written.
    """
    form = form_of(path)
    if not 1 <= len(items) <= MAX_SHEET:
        raise FreneticError(f"a contact sheet of {len(items)} drives: 1 to {MAX_SHEET} are allowed")
    with mpl.rc_context(STYLE):
        write_figure(sheet_figure(items, title), path, form)


Fact: TypeAlias = tuple[str, str, str]
"""Name, value, and a detail such as the place, or an empty text."""


def facts_of_drive(road: Road, judged: JudgedDrive) -> list[Fact]:
    """Return names and values of a drive to show below its headline."""
    result = judged.result
    share, distance = result.max_oob_share, result.moobd_distance
    moobd_place = "" if distance is None else f"at {distance:.0f} m"
    return [
        ("MOOBD", oob_words(result.moobd, road.lane_width), moobd_place),
        ("Largest oob share", "–" if share is None else f"{share:.0%}".replace("%", " %"), ""),
        _failure_fact(result),
        ("Duration", f"{result.duration:.1f} s", ""),
        ("Top speed", f"{judged.speed.max():.0f} km/h" if len(judged) else "–", ""),
        ("Road length", f"{road.length:.0f} m", ""),
    ]


def _failure_fact(result: Result) -> Fact:
    """Return the gravest finding by a criterion; without one the departure, if there is one."""
    gravest, departure = result.finding, result.departure
    if gravest is not None and gravest.criterion not in (LANE, DRIVER):
        signal = signal_named(gravest.criterion)
        place = f"at {gravest.distance:.0f} m"
        return capitalised(signal.words), signal.text(gravest.value), place
    if departure is not None:
        return "Departure", str(departure.side), f"at {departure.distance:.0f} m"
    return "Departure", "none" if result.outcome.is_driven else "–", ""


def facts_of_road(road: Road) -> list[Fact]:
    """Return names and values of a road to show below its headline."""
    sharpest = float(np.abs(road.curvatures).max())
    return [
        ("Road length", f"{road.length:.0f} m", ""),
        ("Sharpest curvature", f"{sharpest:.3f} 1/m", ""),
        ("Smallest radius", f"{1.0 / sharpest:.1f} m" if sharpest > 1e-4 else "straight", ""),
        ("Samples", f"{len(road.curvatures)}", f"every {road.step:g} m"),
    ]


def _page(
    road: Road,
    judged: JudgedDrive | None,
    title: str,
    reason: str,
    colour: str,
) -> Figure:
    """Return a page with headline, views from above and profiles.

    Args:
        road: the road.
        judged: the drive; None for the road alone.
        title: headline.
        reason: text below the headline; empty without one.
        colour: colour of the bar beside the headline.
    """
    focus = None if judged is None else focus_of(judged)
    facts = facts_of_road(road) if judged is None else facts_of_drive(road, judged)
    lines = wrapped(reason, 118, 3)
    profiles = profiles_of(road, judged)

    turn = turn_of(road)
    box = box_of(road, judged, turn)
    # A picture that shows the road nearly as large needs no close-up.
    scale = float(min((INNER_WIDTH, MAX_VIEW_HEIGHT) / box.size))
    has_close_up = focus is not None and scale < 0.6 * CLOSE_UP_WIDTH / CLOSE_UP_SPAN
    main_width = INNER_WIDTH - (CLOSE_UP_WIDTH + _CLOSE_UP_GAP if has_close_up else 0.0)
    main_height = float(np.clip(main_width * box.flatness, _MIN_VIEW_HEIGHT, MAX_VIEW_HEIGHT))

    facts_top = _HEADLINE_TOP + 0.42 + _LINE_HEIGHT * len(lines) + 0.16
    y = facts_top + _FACTS_HEIGHT
    page = Paper.new(WIDTH, y + main_height + _KEY_HEIGHT + height_of(profiles))
    _draw_headline(page, title, lines, facts, facts_top, colour)

    view = View.showing(page.axes(MARGIN, y, main_width, main_height), box, turn)
    near = None
    if has_close_up and judged is not None and focus is not None:
        x = MARGIN + main_width + _CLOSE_UP_GAP
        near = _close_up(page.axes(x, y, CLOSE_UP_WIDTH, main_height), turn, road, judged, focus)
    draw_scene(view, road, judged, focus, near=near)
    draw_key(page, y + main_height + 0.1, view, road, judged)

    draw_profiles(page, road, judged, profiles, y + main_height + _KEY_HEIGHT)
    return page.figure


def _draw_headline(
    page: Paper, title: str, lines: Sequence[str], facts: Sequence[Fact], y: float, colour: str
) -> None:
    """Draw title and reason, and the facts, which begin ``y`` inches down the page."""
    page.bar(MARGIN, _HEADLINE_TOP, 0.07, 0.36 + _LINE_HEIGHT * len(lines), colour)
    left, top = MARGIN + 0.2, _HEADLINE_TOP
    page.text(left, top + 0.29, one_line(title, 58), size=19, weight="bold")
    for i, line in enumerate(lines):
        page.text(left, top + 0.56 + _LINE_HEIGHT * i, line, size=11, color=QUIET)
    for i, (name, value, detail) in enumerate(facts):
        x = MARGIN + i * INNER_WIDTH / 6.0
        page.text(x, y + 0.18, f"{name}, {detail}" if detail else name, size=8.5, color=QUIET)
        page.text(x, y + 0.45, value, size=14, weight="bold")


def _close_up(axes: Axes, turn: float, road: Road, judged: JudgedDrive, focus: Focus) -> View:
    """Draw the surroundings of a drive's focus in axes, and return the view."""
    page = Paper.on(axes)
    (place,) = turned(judged.xy[[focus.record]], turn)
    half = 0.5 * CLOSE_UP_SPAN * np.array([1.0, page.height / page.width])
    near = View.showing(axes, Box(place - half, place + half), turn)
    draw_close_up(near, road, judged, focus)
    backdrop = {"facecolor": PANEL, "edgecolor": "none", "alpha": 0.85, "pad": 2.5}
    style: dict[str, Any] = {"weight": "bold", "color": focus.colour, "bbox": backdrop, "zorder": 9}
    page.text(0.12, 0.24, focus.headline, size=9.5, **style)
    # The scale is on the left, or on the right if the path passes the lower left corner.
    path = (near.at(judged.xy) - near.centre + near.half) * near.scale
    corner = 0.5 * page.width * POINT, 0.6 * POINT
    is_taken = ((path > -POINT) & (path < corner)).all(axis=1).any()
    left = page.width - _SCALE_LENGTH * near.scale / POINT - 0.5 if is_taken else 0.12
    draw_scale(page, left, page.height - 0.14, near, _SCALE_LENGTH)
    return near
