"""The picture of a road from above with its drive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.patches import Polygon, Rectangle

from frenetic._support.arrays import FloatArray
from frenetic._support.words import capitalised
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import DRIVER, signal_named
from frenetic.oracle.assessment import Assessment, assess
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.report.orientation import edge_of, edges_of, turned
from frenetic.report.style import INK, MARGIN, POINT, QUIET, WIDTH, Paper
from frenetic.report.view import Box, Labels, View
from frenetic.road import Road

_MAX_POINTS: Final = 4000  # most drawn points of a path or road, ours: more are not visible

CLOSE_UP: Final = 3.2  # [in], width of the close-up, ours
HIGHEST: Final = 5.7  # [in], most height of the view from above, ours
ACROSS: Final = 26.0  # [m], width of the place that the close-up shows, ours
_THINNEST: Final = 2.0  # [points], least width of a lane with dashes and arrows, ours

_CASING: Final = "#7f8b98"
_OTHER_LANE: Final = "#d9dde3"
EGO_LANE: Final = "#c6d7ea"
ALARM: Final = "#d1232a"
COLOURS: Final[Mapping[Outcome, str]] = {
    Outcome.PASS: "#1b8a6b",
    Outcome.FAIL: ALARM,
    Outcome.INVALID: "#c98a00",
    Outcome.ERROR: "#7a5aa6",
}
OOB_COLOURS: Final = (
    "#feb72d", "#f99a3e", "#f0804e", "#e4695e", "#d5536f",
    "#8f0da4", "#7401a8", "#5601a4", "#370499", "#0d0887",
)  # fmt: skip
"""Colours of a path from half a lane outside the lane to the lane's centre, in equal steps.

The first half is outside the lane, and the jump between the halves is the lane's edge. They are
plasma's without its yellow, which would vanish on white: lightness rises evenly, so they read in
grey and with any kind of colour vision. ``report.css`` has the same.
"""
_OOB_MAP: Final = ListedColormap(OOB_COLOURS, "oob")


# A drive, judged


@dataclass(frozen=True)
class JudgedDrive:
    """A drive with its verdict and the records up to the drive's end."""

    drive: Drive
    result: Result
    distance: FloatArray  # (n,) m along the road
    oob_distance: FloatArray  # (n,) m
    xy: FloatArray  # (n, 2) m
    heading: FloatArray  # (n,) rad
    speed: FloatArray  # (n,) km/h

    def __len__(self) -> int:
        return len(self.distance)


def road_of(drive: Drive, road: Road | None) -> Road:
    """Return ``road``, or by default the road that the drive knows.

    Raises:
        ValueError: ``road`` is None, and the drive does not know its road.
    """
    driven_road = drive.road if road is None else road
    if driven_road is None:
        raise ValueError("the drive does not know its road: give it, as in plot(drive, road=road)")
    return driven_road


def look(road: Road, thing: Drive | Test) -> JudgedDrive:
    """Judge a drive for its picture; a test keeps the campaign's verdict.

    Stored records are rounded, so a drive at a limit may be judged otherwise than in the campaign.
    """
    drive = thing if isinstance(thing, Drive) else thing.drive
    assert drive is not None, "what was not driven has no picture of a drive"
    rows = drive.trajectory.to_rows()
    odd = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(odd):  # a simulator that broke may leave records without meaning at the end
        drive = replace(drive, trajectory=Trajectory.from_rows(rows[: odd[0]]))
    t = drive.trajectory
    assessment = (
        assess(road, drive)
        if len(t)
        else Assessment(0, *(np.empty(0) for _ in range(4)))  # nothing was recorded
    )
    n = len(assessment.distance)
    return JudgedDrive(
        drive=drive,
        result=judge(road, drive) if isinstance(thing, Drive) else thing.result,
        distance=assessment.distance,
        oob_distance=assessment.oob_distance,
        # Places far outside any picture are brought near enough to draw.
        xy=np.clip(np.column_stack([t.x[:n], t.y[:n]]), -1e6, 1e6),
        heading=t.heading[:n],
        speed=t.speed[:n] * 3.6,
    )


@dataclass(frozen=True)
class Focus:
    """The main record of a picture."""

    record: int
    headline: str  # of the close-up
    label: str  # beside the mark on the road
    colour: str


def focus_of(judged: JudgedDrive) -> Focus | None:
    """Return the departure, else the end of a failed drive, else the car's worst moment."""
    if not len(judged):
        return None
    result, last = judged.result, len(judged) - 1
    colour = COLOURS[result.outcome]
    if result.departure is not None:
        return Focus(last, "Departure", f"departure to the {result.departure.side}", colour)
    if result.finding is not None and result.finding.criterion != DRIVER:
        times = judged.drive.trajectory.time[: len(judged)]
        record = int(np.argmin(np.abs(times - result.finding.time)))
        words = signal_named(result.finding.criterion).words
        return Focus(record, capitalised(words), words, colour)
    if result.outcome is Outcome.PASS:
        worst = int(np.argmin(judged.oob_distance))
        return Focus(worst, "Smallest oob distance", "", colour)
    return Focus(last, "Where it ended", f"ended at {judged.distance[last]:.0f} m", colour)


# The view from above


def box_of(road: Road, judged: JudgedDrive | None, turn: float) -> Box:
    """Return the box around road and path, of a path far astray up to 15 m from the road."""
    outline = turned(edges_of(road, max(2.0, road.length / _MAX_POINTS)), turn)
    low, high = outline.min(axis=0), outline.max(axis=0)
    if judged is not None and len(judged):
        path = np.clip(turned(judged.xy, turn), low - 15.0, high + 15.0)
        low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    around = 4.0 + 0.03 * float((high - low).max())
    return Box(low - around, high + around)


def draw_scene(
    view: View,
    road: Road,
    judged: JudgedDrive | None,
    focus: Focus | None,
    *,
    near: View | None = None,
    labelled: bool = True,
) -> None:
    """Draw the whole road from above with the drive, and a frame around what ``near`` shows."""
    draw_surface(view, road)
    spacing = max(1.0, road.length / _MAX_POINTS)
    start, end = view.at(road.sample(spacing, -0.5 * road.lane_width)[[0, -1]])
    size, width = (7.0, 1.5) if labelled else (4.5, 1.1)
    for place, marker, fill in ((start, "o", "white"), (end, "s", INK)):
        view.mark(place, marker, ms=size, mfc=fill, mec=INK, mew=width, zorder=7)

    # What labels must not hide.
    drawn = [view.at(road.sample(spacing, k * road.lane_width)) for k in (-1, -0.5, 0, 0.5, 1)]
    mark = None
    if judged is not None and focus is not None:
        _draw_path(view, judged, 0.5 * road.lane_width, 3.0 if labelled else 2.2)
        drawn.append(view.at(judged.xy))
        if labelled:
            some = _some_records(judged, focus)
            _draw_cars(view, judged, some, INK)
            _draw_cars(view, judged, [focus.record], focus.colour, zorder=6.0)
            drawn += _boxes(view, judged, [*some, focus.record])
        mark = view.at(judged.xy[[focus.record]])[0]
        if near is not None and near.scale > 2.0 * view.scale:
            corner, (across, up) = mark - near.half, 2.0 * near.half
            style: Any = {"fill": False, "ec": QUIET, "lw": 0.8, "alpha": 0.7, "zorder": 6}
            view.axes.add_artist(Rectangle(corner, across, up, **style))
            sides = np.linspace(-1.0, 1.0, 41)[:, None]
            for k in (-1.0, 1.0):
                drawn.append(mark + near.half * np.hstack([sides, np.full_like(sides, k)]))
                drawn.append(mark + near.half * np.hstack([np.full_like(sides, k), sides]))
        if judged.result.outcome is Outcome.PASS or not view.shows(mark):
            mark = None
        else:
            size, width = (15.0, 1.8) if labelled else (9.0, 1.4)
            view.mark(mark, "o", ms=size, mfc="none", mec=focus.colour, mew=width, zorder=7)
    if not labelled:
        return
    labels = Labels(view, view.points(np.vstack(drawn)))
    for place in (start, end):
        labels.keep_clear(place, 4.0)
    if focus is not None and mark is not None:
        labels.keep_clear(mark, 9.0)
        labels.put(mark, focus.label, focus.colour)
    labels.put(start, "start", INK)
    labels.put(end, "end", INK)


def draw_surface(view: View, road: Road) -> None:
    """Draw both lanes with an edge around them."""
    spacing = max(0.5, road.length / _MAX_POINTS)
    left, right = (view.at(edge_of(road, spacing, side)) for side in (1.0, -1.0))
    middle = view.at(road.sample(spacing))
    style: Any
    for edge, opposite, style in (
        (left, right, {"fc": _CASING, "ec": _CASING, "lw": 1.8, "zorder": 1.0}),
        (left, middle, {"fc": _OTHER_LANE, "ec": _OTHER_LANE, "lw": 0.3, "zorder": 1.1}),
        (middle, right, {"fc": EGO_LANE, "lw": 0.0, "zorder": 1.2}),
    ):
        view.axes.add_artist(Polygon(np.vstack([edge, opposite[::-1]]), joinstyle="round", **style))
    if road.lane_width * view.scale < _THINNEST:
        return
    width = max(0.9, 0.15 * view.scale)
    dash = max(3.0 * view.scale, 3.0) / width
    view.axes.plot(*middle.T, color="white", lw=width, zorder=1.3, dashes=(dash, dash))
    _draw_arrows(view, road)


def _draw_arrows(view: View, road: Road) -> None:
    """Draw arrows on the ego lane that point in driving direction."""
    size = float(np.clip(1.3 * view.scale, 3.2, 11.0)) / view.scale
    apart = max(130.0 / view.scale, road.length / 40.0)
    count = max(1, int(road.length / apart))
    distances = (np.arange(count) + 0.5) * road.length / count
    shape = size * np.array([[1.0, 0.0], [-0.8, 0.9], [-0.35, 0.0], [-0.8, -0.9]])
    polygons = []
    for s in distances:
        x, y, heading = road.pose_at(float(s))
        half = 0.5 * road.lane_width
        place = np.array([[x + half * math.sin(heading), y - half * math.cos(heading)]])
        polygons.append(view.at(place) + turned(shape, heading + view.turn))
    view.add(PolyCollection(polygons, facecolor="white", edgecolor="none", zorder=1.4))


def _draw_path(view: View, judged: JudgedDrive, half: float, width: float) -> None:
    """Draw the path of the car's centre of mass, coloured by oob distance."""
    places = view.at(judged.xy)
    draw_coloured(view.axes, places, view.scale, judged.oob_distance, half, width)


def draw_coloured(
    axes: Axes, places: FloatArray, scale: Any, oob: FloatArray, half: float, width: float
) -> None:
    """Draw a line coloured by oob distance.

    Args:
        axes: to draw on.
        places: (n, 2) in the axes.
        scale: points per unit of the axes, one number or (2,).
        oob: (n,) oob distance in m.
        half: half a lane, in m.
        width: of the line, in points.
    """
    if len(places) < 2:
        return
    # Pieces shorter than 1.5 points are not visible.
    walked = np.cumsum(np.hypot(*(scale * np.diff(places, axis=0, prepend=places[:1])).T))
    some = np.unique(np.floor(walked / 1.5), return_index=True)[1]
    some = np.union1d(some[:: math.ceil(len(some) / _MAX_POINTS)], [len(places) - 1])
    if len(some) < 2:
        return
    # One stroke per run of a colour: strokes that meet overlap visibly.
    places, oob = places[some], oob[some]
    steps = len(OOB_COLOURS)
    inside = 0.5 + 0.25 * (oob[:-1] + oob[1:]) / half  # 0 half a lane outside, 1 on its centre
    shades = np.clip(np.floor(steps * inside), 0.0, steps - 1.0)
    breaks = np.flatnonzero(np.diff(shades)) + 1
    first, last = np.r_[0, breaks], np.r_[breaks, len(shades)]
    line = LineCollection(
        [places[a : b + 1] for a, b in zip(first, last, strict=True)],
        cmap=_OOB_MAP,
        norm=Normalize(0.0, steps),
        linewidths=width,
        capstyle="round",
        joinstyle="round",
        zorder=4,
    )
    line.set_array(shades[first] + 0.5)
    axes.add_collection(line, autolim=False)


def _some_records(judged: JudgedDrive, focus: Focus) -> list[int]:
    """Return a few records at equal distances, none within 8 m of the main record."""
    driven = np.cumsum(np.hypot(*np.diff(judged.xy, axis=0, prepend=judged.xy[:1]).T))
    count = int(np.clip(driven[-1] / 15.0, 0.0, 6.0))
    some = np.searchsorted(driven, np.linspace(0.0, driven[-1], count + 2)[1:-1])
    away = np.hypot(*(judged.xy - judged.xy[focus.record]).T)
    return [int(i) for i in some if away[i] > 8.0]


def _boxes(view: View, judged: JudgedDrive, records: Sequence[int]) -> list[FloatArray]:
    """Return the car's box at each record: corners clockwise from the left rear, (4, 2) points."""
    car = judged.drive.car
    x = car.centre_ahead + car.length * np.array([-0.5, 0.5, 0.5, -0.5])
    corners = np.column_stack([x, car.width * np.array([0.5, 0.5, -0.5, -0.5])])
    return [view.at(judged.xy[i] + turned(corners, judged.heading[i])) for i in records]


def _draw_cars(
    view: View,
    judged: JudgedDrive,
    records: Sequence[int],
    colour: str,
    *,
    width: float = 0.9,
    zorder: float = 5.0,
    fill: float = 0.0,
) -> None:
    """Draw the car's box at some records, with a line where the windscreen is."""
    boxes = _boxes(view, judged, records)
    screens = [np.array([0.3 * b[0] + 0.7 * b[1], 0.7 * b[2] + 0.3 * b[3]]) for b in boxes]
    inside = (*to_rgb(colour), fill) if fill else (1.0, 1.0, 1.0, 0.35)
    view.add(PolyCollection(boxes, ec=colour, facecolor=inside, linewidths=width, zorder=zorder))
    view.add(LineCollection(screens, colors=colour, linewidths=width, zorder=zorder))


def draw_close_up(view: View, road: Road, judged: JudgedDrive, focus: Focus) -> None:
    """Draw the main record's place large enough to see the car on the lane."""
    draw_surface(view, road)
    _draw_path(view, judged, 0.5 * road.lane_width, 4.0)
    # Boxes a little more than a car apart, backward and forward from the main record.
    away = np.abs(judged.distance - judged.distance[focus.record])
    step = 1.35 * judged.drive.car.length
    chosen = []
    for direction in (-1, 1):
        i, due = focus.record, step
        while 0 <= i < len(judged) and away[i] < 2.0 * ACROSS:
            if away[i] >= due:
                chosen.append(i)
                due = away[i] + step
            i += direction
    _draw_cars(view, judged, chosen, INK)
    _draw_cars(view, judged, [focus.record], focus.colour, width=1.8, zorder=6.0, fill=0.22)
    place = view.at(judged.xy[[focus.record]])[0]
    view.mark(place, "o", ms=4.5, color=focus.colour, zorder=7)


def draw_key(page: Paper, y: float, view: View, road: Road, judged: JudgedDrive | None) -> None:
    """Draw scale, axes of the map and the key to the colours below the view."""
    metres = 10.0 ** math.floor(math.log10(130.0 / view.scale))
    metres *= max(k for k in (1, 2, 5) if k * metres * view.scale <= 130.0)
    x = MARGIN
    draw_scale(page, x, y + 0.24, view, metres)
    x += metres * view.scale / POINT + 0.85
    for name, angle in (("x", view.turn), ("y", view.turn + math.pi / 2.0)):
        dx, dy = 0.15 * math.cos(angle), -0.15 * math.sin(angle)
        page.line([x, x + dx], [y + 0.24, y + 0.24 + dy], color=QUIET, lw=1.1)
        beside = x + 1.55 * dx, y + 0.24 + 1.55 * dy
        page.text(*beside, name, size=8, color=QUIET, ha="center", va="center")
    if judged is not None and len(judged):
        draw_colour_bar(page, WIDTH - MARGIN, y + 0.07, 0.5 * road.lane_width)


def draw_colour_bar(page: Paper, right: float, y: float, half: float) -> None:
    """Draw the key to a path's colours up to ``right``; ``half`` is half a lane, in m."""
    width, pointed = 3.2, 0.04
    left = right - width
    ends = np.linspace(-half, half, len(OOB_COLOURS) + 1)
    tip = -half - pointed * 2.0 * half
    bar = page.axes(left, y, width, 0.11, xlim=(tip, half), ylim=(0.0, 1.0), facecolor="none")
    shapes = [[(tip, 0.5), (-half, 0.0), (-half, 1.0)]]
    shapes += [[(a, 0.0), (b, 0.0), (b, 1.0), (a, 1.0)] for a, b in pairwise(ends)]
    colours = [OOB_COLOURS[0], *OOB_COLOURS]
    bar.add_collection(
        PolyCollection(shapes, facecolors=colours, edgecolors="none", antialiaseds=False)
    )
    bar.plot((0.0, 0.0), (0.0, 1.0), color=INK, lw=1.2)
    for at, text, side in (
        (-half, f"−{half:g}", "center"),
        (0.0, "0 lane edge", "center"),
        (half, f"{half:g} lane centre", "right"),
    ):
        x = left + width * (at - tip) / (half - tip)
        page.text(x, y + 0.15, text, size=8.5, color=QUIET, ha=side, va="top")
    page.text(left - 0.15, y + 0.1, "oob distance (m)", size=8.5, color=QUIET, ha="right")


def draw_scale(page: Paper, x: float, y: float, view: View, metres: float) -> None:
    """Draw a line as long as ``metres`` are in a view."""
    length = metres * view.scale / POINT
    page.line([x, x, x + length, x + length], [y - 0.06, y, y, y - 0.06], color=QUIET, lw=1.2)
    page.text(x + length + 0.08, y, f"{metres:g} m", size=8.5, color=QUIET)
