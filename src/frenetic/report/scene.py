"""The view of a road from above, with the lanes, the car's path and the car."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.patches import Polygon, Rectangle

from frenetic._support.arrays import FloatArray
from frenetic.oracle.outcome import Outcome
from frenetic.report.judged_drive import Focus, JudgedDrive
from frenetic.report.orientation import edge_of, edges_of, turned
from frenetic.report.style import INK, MARGIN, POINT, QUIET, WIDTH, Paper
from frenetic.report.view import Box, Labels, View
from frenetic.road import Road

# Sizes, our choice.
_MAX_POINTS: Final = 4000  # most drawn points of a path or a road: more are not visible
CLOSE_UP_WIDTH: Final = 3.2  # [in] width of the close-up
MAX_VIEW_HEIGHT: Final = 5.7  # [in] most height of the view from above
CLOSE_UP_SPAN: Final = 26.0  # [m] width of the part of the map that the close-up shows
_MIN_MARKED_LANE: Final = 2.0  # [points] least width of a lane that gets dashes and arrows
_MAX_ASTRAY: Final = 15.0  # [m] distance from the road up to which a path is shown

# Colours.
_ROAD_EDGE: Final = "#7f8b98"
_OTHER_LANE: Final = "#d9dde3"
EGO_LANE: Final = "#c6d7ea"
OOB_COLOURS: Final = (
    "#feb72d", "#f99a3e", "#f0804e", "#e4695e", "#d5536f",
    "#8f0da4", "#7401a8", "#5601a4", "#370499", "#0d0887",
)  # fmt: skip
"""Colours of a path from half a lane outside the lane to the lane's centre, in equal steps.

The first half is outside the lane; the jump between the halves is the lane's edge. The colours are
Matplotlib's plasma without its yellow, which would vanish on white. Lightness changes evenly, so
they can be told apart in grey and with any kind of colour vision. ``report.css`` has the same
colours.
"""
_OOB_COLOUR_MAP: Final = ListedColormap(OOB_COLOURS, "oob")


def box_of(road: Road, judged: JudgedDrive | None, turn: float) -> Box:
    """Return the box around a road and a drive's path, up to `_MAX_ASTRAY` from the road.

    Args:
        road: the road.
        judged: the drive; None for the road alone.
        turn: angle by which the picture is turned counter-clockwise, in rad.
    """
    outline = turned(edges_of(road, max(2.0, road.length / _MAX_POINTS)), turn)
    low, high = outline.min(axis=0), outline.max(axis=0)
    if judged is not None and len(judged):
        path = np.clip(turned(judged.xy, turn), low - _MAX_ASTRAY, high + _MAX_ASTRAY)
        low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    margin = 4.0 + 0.03 * float((high - low).max())  # [m]
    return Box(low - margin, high + margin)


def draw_scene(
    view: View,
    road: Road,
    judged: JudgedDrive | None,
    focus: Focus | None,
    *,
    near: View | None = None,
    labelled: bool = True,
) -> None:
    """Draw the whole road from above with the drive.

    Args:
        view: view to draw in.
        road: the road.
        judged: the drive; None for the road alone.
        focus: focus of the drive; None without records.
        near: close-up whose part of the map gets a frame; None without a close-up.
        labelled: whether to draw cars and labels, and larger marks.
    """
    draw_surface(view, road)
    spacing = max(1.0, road.length / _MAX_POINTS)
    start, end = view.at(road.sample(spacing, -0.5 * road.lane_width)[[0, -1]])
    size, width = (7.0, 1.5) if labelled else (4.5, 1.1)
    for place, marker, fill in ((start, "o", "white"), (end, "s", INK)):
        view.mark(place, marker, ms=size, mfc=fill, mec=INK, mew=width, zorder=7)

    # Points that labels must not hide: edges and centres of the lanes, the path, cars, the frame.
    drawn = [
        view.at(road.sample(spacing, share * road.lane_width)) for share in (-1, -0.5, 0, 0.5, 1)
    ]
    mark = None
    if judged is not None and focus is not None:
        _draw_path(view, judged, 0.5 * road.lane_width, 3.0 if labelled else 2.2)
        drawn.append(view.at(judged.xy))
        if labelled:
            records = _spread_records(judged, focus)
            _draw_cars(view, judged, records, INK)
            _draw_cars(view, judged, [focus.record], focus.colour, zorder=6.0)
            drawn += _boxes(view, judged, [*records, focus.record])
        mark = view.at(judged.xy[[focus.record]])[0]
        if near is not None and near.scale > 2.0 * view.scale:
            drawn += _draw_frame(view, mark, near)
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


def _draw_frame(view: View, centre: FloatArray, near: View) -> list[FloatArray]:
    """Draw a frame around what a close-up shows, and return points on the frame, (n, 2) each."""
    corner: Any = centre - near.half
    width, height = 2.0 * near.half
    style: Any = {"fill": False, "ec": QUIET, "lw": 0.8, "alpha": 0.7, "zorder": 6}
    view.axes.add_artist(Rectangle(corner, width, height, **style))
    along = np.linspace(-1.0, 1.0, 41)[:, None]
    points = []
    for side in (-1.0, 1.0):
        across = np.full_like(along, side)
        points.append(centre + near.half * np.hstack([along, across]))
        points.append(centre + near.half * np.hstack([across, along]))
    return points


def draw_surface(view: View, road: Road) -> None:
    """Draw both lanes with an edge around them, dashes between them and arrows on the ego lane."""
    spacing = max(0.5, road.length / _MAX_POINTS)
    left, right = (view.at(edge_of(road, spacing, side)) for side in (1.0, -1.0))
    middle = view.at(road.sample(spacing))
    style: Any
    for edge, opposite, style in (
        (left, right, {"fc": _ROAD_EDGE, "ec": _ROAD_EDGE, "lw": 1.8, "zorder": 1.0}),
        (left, middle, {"fc": _OTHER_LANE, "ec": _OTHER_LANE, "lw": 0.3, "zorder": 1.1}),
        (middle, right, {"fc": EGO_LANE, "lw": 0.0, "zorder": 1.2}),
    ):
        view.axes.add_artist(Polygon(np.vstack([edge, opposite[::-1]]), joinstyle="round", **style))
    if road.lane_width * view.scale < _MIN_MARKED_LANE:
        return
    width = max(0.9, 0.15 * view.scale)
    dash = max(3.0 * view.scale, 3.0) / width
    view.axes.plot(*middle.T, color="white", lw=width, zorder=1.3, dashes=(dash, dash))
    _draw_arrows(view, road)


def _draw_arrows(view: View, road: Road) -> None:
    """Draw arrows along the ego lane's centre that point in driving direction."""
    size = float(np.clip(1.3 * view.scale, 3.2, 11.0)) / view.scale
    spacing = max(130.0 / view.scale, road.length / 40.0)
    count = max(1, int(road.length / spacing))
    distances = (np.arange(count) + 0.5) * road.length / count
    arrow = size * np.array([[1.0, 0.0], [-0.8, 0.9], [-0.35, 0.0], [-0.8, -0.9]])
    polygons = []
    for distance in distances:
        x, y, heading = road.pose_at(float(distance))
        half = 0.5 * road.lane_width
        place = np.array([[x + half * math.sin(heading), y - half * math.cos(heading)]])
        polygons.append(view.at(place) + turned(arrow, heading + view.turn))
    view.add(PolyCollection(polygons, facecolor="white", edgecolor="none", zorder=1.4))


def _draw_path(view: View, judged: JudgedDrive, half: float, width: float) -> None:
    """Draw the path of the car's centre of mass, coloured by oob distance.

    Args:
        view: view to draw in.
        judged: the drive.
        half: half the lane's width, in m.
        width: width of the line, in points.
    """
    places = view.at(judged.xy)
    draw_coloured(view.axes, places, view.scale, judged.oob_distance, half, width)


def draw_coloured(
    axes: Axes, places: FloatArray, scale: Any, oob: FloatArray, half: float, width: float
) -> None:
    """Draw a line coloured by oob distance.

    Args:
        axes: axes to draw on.
        places: places of the line in the axes, (n, 2).
        scale: points per unit of the axes, one number or (2,).
        oob: oob distance at each place, (n,) in m.
        half: half the lane's width, in m.
        width: width of the line, in points.
    """
    if len(places) < 2:
        return
    # Pieces shorter than 1.5 points are not visible.
    length = np.cumsum(np.hypot(*(scale * np.diff(places, axis=0, prepend=places[:1])).T))
    visible = np.unique(np.floor(length / 1.5), return_index=True)[1]
    visible = np.union1d(visible[:: math.ceil(len(visible) / _MAX_POINTS)], [len(places) - 1])
    if len(visible) < 2:
        return
    # One stroke per run of a colour: strokes that meet overlap visibly.
    places, oob = places[visible], oob[visible]
    colour_count = len(OOB_COLOURS)
    # 0 is half a lane outside the lane, 0.5 on its edge, 1 on its centre.
    inside = 0.5 + 0.25 * (oob[:-1] + oob[1:]) / half
    colours = np.clip(np.floor(colour_count * inside), 0.0, colour_count - 1.0)
    breaks = np.flatnonzero(np.diff(colours)) + 1
    first, last = np.r_[0, breaks], np.r_[breaks, len(colours)]
    line = LineCollection(
        [places[start : end + 1] for start, end in zip(first, last, strict=True)],
        cmap=_OOB_COLOUR_MAP,
        norm=Normalize(0.0, colour_count),
        linewidths=width,
        capstyle="round",
        joinstyle="round",
        zorder=4,
    )
    line.set_array(colours[first] + 0.5)
    axes.add_collection(line, autolim=False)


def _spread_records(judged: JudgedDrive, focus: Focus) -> list[int]:
    """Return up to six records at equal distances along the path, none within 8 m of the focus."""
    path = np.cumsum(np.hypot(*np.diff(judged.xy, axis=0, prepend=judged.xy[:1]).T))
    count = int(np.clip(path[-1] / 15.0, 0.0, 6.0))
    records = np.searchsorted(path, np.linspace(0.0, path[-1], count + 2)[1:-1])
    from_focus = np.hypot(*(judged.xy - judged.xy[focus.record]).T)
    return [int(record) for record in records if from_focus[record] > 8.0]


def _boxes(view: View, judged: JudgedDrive, records: Sequence[int]) -> list[FloatArray]:
    """Return the car's box at each record: (4, 2) corners in the axes, clockwise from left rear."""
    car = judged.drive.car
    x = car.centre_ahead + car.length * np.array([-0.5, 0.5, 0.5, -0.5])
    corners = np.column_stack([x, car.width * np.array([0.5, 0.5, -0.5, -0.5])])
    return [
        view.at(judged.xy[record] + turned(corners, judged.heading[record])) for record in records
    ]


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
    """Draw the car's box at some records, with a line where the windscreen is.

    Args:
        view: view to draw in.
        judged: the drive.
        records: indices of the records.
        colour: colour of the lines.
        width: width of the lines, in points.
        zorder: drawing order, see Matplotlib.
        fill: opacity of the colour inside the box; 0 for a translucent white.
    """
    boxes = _boxes(view, judged, records)
    windscreens = [  # at 0.7 of the car's length from the rear
        np.array([0.3 * left_rear + 0.7 * left_front, 0.7 * right_front + 0.3 * right_rear])
        for left_rear, left_front, right_front, right_rear in boxes
    ]
    inside = (*to_rgb(colour), fill) if fill else (1.0, 1.0, 1.0, 0.35)
    view.add(PolyCollection(boxes, ec=colour, facecolor=inside, linewidths=width, zorder=zorder))
    view.add(LineCollection(windscreens, colors=colour, linewidths=width, zorder=zorder))


def draw_close_up(view: View, road: Road, judged: JudgedDrive, focus: Focus) -> None:
    """Draw the surroundings of the focus, large enough to see the car on its lane."""
    draw_surface(view, road)
    _draw_path(view, judged, 0.5 * road.lane_width, 4.0)
    # Cars a little more than a car's length apart, backward and forward from the focus.
    from_focus = np.abs(judged.distance - judged.distance[focus.record])
    spacing = 1.35 * judged.drive.car.length
    records = []
    for direction in (-1, 1):
        record, next_distance = focus.record, spacing
        while 0 <= record < len(judged) and from_focus[record] < 2.0 * CLOSE_UP_SPAN:
            if from_focus[record] >= next_distance:
                records.append(record)
                next_distance = from_focus[record] + spacing
            record += direction
    _draw_cars(view, judged, records, INK)
    _draw_cars(view, judged, [focus.record], focus.colour, width=1.8, zorder=6.0, fill=0.22)
    place = view.at(judged.xy[[focus.record]])[0]
    view.mark(place, "o", ms=4.5, color=focus.colour, zorder=7)


def draw_key(page: Paper, y: float, view: View, road: Road, judged: JudgedDrive | None) -> None:
    """Draw scale, axes of the map and the key to the colours, from ``y`` inches down the page."""
    # The longest scale of 1, 2 or 5 times a power of ten that takes at most 130 points.
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
    """Draw the key to a path's colours.

    Args:
        page: page to draw on.
        right: right end of the key, in inches from the page's left edge.
        y: upper edge of the key, in inches down the page.
        half: half the lane's width, in m.
    """
    width = 3.2  # [in]
    left = right - width
    ends = np.linspace(-half, half, len(OOB_COLOURS) + 1)
    tip = -half - 0.04 * 2.0 * half  # of the arrow that stands for all lower values
    bar = page.axes(left, y, width, 0.11, xlim=(tip, half), ylim=(0.0, 1.0), facecolor="none")
    shapes = [[(tip, 0.5), (-half, 0.0), (-half, 1.0)]]
    shapes += [
        [(start, 0.0), (end, 0.0), (end, 1.0), (start, 1.0)] for start, end in pairwise(ends)
    ]
    colours = [OOB_COLOURS[0], *OOB_COLOURS]
    bar.add_collection(
        PolyCollection(shapes, facecolors=colours, edgecolors="none", antialiaseds=False)
    )
    bar.plot((0.0, 0.0), (0.0, 1.0), color=INK, lw=1.2)
    for value, text, alignment in (
        (-half, f"−{half:g}", "center"),
        (0.0, "0 lane edge", "center"),
        (half, f"{half:g} lane centre", "right"),
    ):
        x = left + width * (value - tip) / (half - tip)
        page.text(x, y + 0.15, text, size=8.5, color=QUIET, ha=alignment, va="top")
    page.text(left - 0.15, y + 0.1, "oob distance (m)", size=8.5, color=QUIET, ha="right")


def draw_scale(page: Paper, x: float, y: float, view: View, metres: float) -> None:
    """Draw a line as long as ``metres`` in a view; it begins ``x``, ``y`` inches into the page."""
    length = metres * view.scale / POINT
    page.line([x, x, x + length, x + length], [y - 0.06, y, y, y - 0.06], color=QUIET, lw=1.2)
    page.text(x + length + 0.08, y, f"{metres:g} m", size=8.5, color=QUIET)
