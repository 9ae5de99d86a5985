"""The picture of a road from above with its drive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PolyCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.patches import Polygon, Rectangle

from frenetic._support.arrays import FloatArray
from frenetic._support.words import capitalised
from frenetic.campaign.record import Test
from frenetic.criteria.criterion import DRIVER, quantity
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Assessment, Result, assess, judge
from frenetic.report.orientation import edge_of, edges_of, turned
from frenetic.report.style import INK, MARGIN, PANEL, POINT, QUIET, WIDTH, Paper
from frenetic.road import Road

_MAX_POINTS: Final = 4000  # more of a path or road than that is not seen

# Sizes in inches.
CLOSE_UP: Final = 3.2
_THINNEST: Final = 2.0  # points, lane with room for what is painted on it
ACROSS: Final = 26.0  # m, width of what the close-up shows
HIGHEST: Final = 5.7  # the road seen from above

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


# What is seen of a drive


@dataclass(frozen=True)
class SeenDrive:
    """A drive with its verdict, cut to the records that count."""

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
    """The road of a drive: the given one, or that which the drive knows.

    Raises:
        ValueError: there is none.
    """
    found = drive.road if road is None else road
    if found is None:
        raise ValueError("the drive does not know its road: give it, as in plot(drive, road=road)")
    return found


def look(road: Road, thing: Drive | Test) -> SeenDrive:
    """A drive as its picture shows it; that of a test with the campaign's verdict.

    Stored records are rounded, and judged again a drive at a limit may end otherwise.
    """
    drive = thing if isinstance(thing, Drive) else thing.drive
    assert drive is not None, "what was not driven has no picture of a drive"
    rows = drive.trajectory.to_rows()
    odd = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(odd):  # a simulator that broke may leave records without meaning at the end
        drive = replace(drive, trajectory=Trajectory.from_rows(rows[: odd[0]]))
    t = drive.trajectory
    seen = (
        assess(road, drive)
        if len(t)
        else Assessment(0, *(np.empty(0) for _ in range(4)))  # nothing was recorded
    )
    n = len(seen.distance)
    return SeenDrive(
        drive=drive,
        result=judge(road, drive) if isinstance(thing, Drive) else thing.result,
        distance=seen.distance,
        oob_distance=seen.oob_distance,
        # What is out of any picture is brought near enough to draw.
        xy=np.clip(np.column_stack([t.x[:n], t.y[:n]]), -1e6, 1e6),
        heading=t.heading[:n],
        speed=t.speed[:n] * 3.6,
    )


@dataclass(frozen=True)
class Focus:
    """The main record of a picture."""

    record: int
    what: str  # headline of the close-up
    label: str  # beside the mark on the road
    colour: str


def focus_of(seen: SeenDrive) -> Focus | None:
    """The departure, else the end of a drive that did not pass, else the car's worst moment."""
    if not len(seen):
        return None
    result, last = seen.result, len(seen) - 1
    colour = COLOURS[result.outcome]
    if result.departure is not None:
        return Focus(last, "Departure", f"departure to the {result.departure.side}", colour)
    if result.finding is not None and result.finding.criterion != DRIVER:
        times = seen.drive.trajectory.time[: len(seen)]
        record = int(np.argmin(np.abs(times - result.finding.time)))
        words = quantity(result.finding.criterion).words
        return Focus(record, capitalised(words), words, colour)
    if result.outcome is Outcome.PASS:
        worst = int(np.argmin(seen.oob_distance))
        return Focus(worst, "Smallest oob distance", "", colour)
    return Focus(last, "Where it ended", f"ended at {seen.distance[last]:.0f} m", colour)


# The view from above


@dataclass(frozen=True)
class Box:
    """A rectangle in the turned plane, in metres."""

    low: FloatArray  # (2,) its lower left corner
    high: FloatArray  # (2,) its upper right corner

    @property
    def size(self) -> FloatArray:
        """(2,) width and height."""
        return self.high - self.low

    @property
    def flatness(self) -> float:
        """Height over width."""
        width, height = self.size
        return float(height / width)

    def holding(self, ends: FloatArray) -> Box:
        """The box around this one and another one's corners, (2, 2)."""
        return Box(np.minimum(self.low, ends[0]), np.maximum(self.high, ends[1]))


@dataclass(frozen=True)
class View:
    """Axes that show the world from above: turned, in metres."""

    axes: Axes
    turn: float  # rad counter-clockwise
    scale: float  # points per metre when it is drawn
    centre: FloatArray  # (2,) m, turned, in the middle
    half: FloatArray  # (2,) m from the middle to the edges

    @classmethod
    def showing(cls, axes: Axes, box: Box, turn: float) -> View:
        """The view of ``box``, with what else fits into the axes."""
        size = size_of(axes)
        scale = float(min(size / box.size))
        half, centre = 0.5 * size / scale, 0.5 * (box.low + box.high)
        (left, bottom), (right, top) = centre - half, centre + half
        axes.set(xlim=(left, right), ylim=(bottom, top), facecolor=PANEL)
        return cls(axes, turn, scale, centre, half)

    def at(self, points: FloatArray) -> FloatArray:
        """(n, 2) places in the axes of (n, 2) places on the map, in m."""
        return turned(points, self.turn)

    def points(self, places: FloatArray) -> FloatArray:
        """Places in the axes, (..., 2), in points from the middle."""
        found: FloatArray = (places - self.centre) * self.scale
        return found

    def places(self, points: FloatArray) -> FloatArray:
        """The reverse of `points`."""
        found: FloatArray = self.centre + points / self.scale
        return found

    def shows(self, place: FloatArray) -> bool:
        """Whether a place, (2,) in the axes, is in sight."""
        return bool((np.abs(place - self.centre) < self.half).all())

    def mark(self, place: FloatArray, marker: str, **how: Any) -> None:
        """Draws a marker at a place, (2,) in the axes."""
        self.axes.plot(*place, linestyle="none", marker=marker, **how)

    def add(self, artists: Collection) -> None:
        """Draws what changes no limits."""
        self.axes.add_collection(artists, autolim=False)


def size_of(axes: Axes) -> FloatArray:
    """(2,) width and height of axes, in points."""
    box, dpi = axes.bbox, axes.figure.dpi
    return np.array([box.width, box.height]) * POINT / dpi


def box_of(road: Road, seen: SeenDrive | None, turn: float) -> Box:
    """The box to show: the road and the path, unless the path goes far astray."""
    outline = turned(edges_of(road, max(2.0, road.length / _MAX_POINTS)), turn)
    low, high = outline.min(axis=0), outline.max(axis=0)
    if seen is not None and len(seen):
        path = np.clip(turned(seen.xy, turn), low - 15.0, high + 15.0)
        low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    around = 4.0 + 0.03 * float((high - low).max())
    return Box(low - around, high + around)


_REACHES: Final = np.array([11.0, 18.0, 28.0, 42.0, 60.0, 84.0])
_DIRECTIONS: Final = np.column_stack(
    [trig(np.arange(16) * (math.pi / 8.0)) for trig in (np.cos, np.sin)]
)


@dataclass
class _Labels:
    """Places labels in a view without hiding anything or touching each other.

    Within, all is in points from the middle of the view.
    """

    view: View
    obstacles: FloatArray  # (n, 2) of what is drawn
    size: float = 9.0
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def put(self, place: FloatArray, text: str, colour: str) -> None:
        """Write ``text`` beside a place, (2,) in the axes, with a leader if need be."""
        place = self.view.points(place)
        half = np.array([0.31 * self.size * len(text) + 2.0, 0.68 * self.size])
        # From the label's edge to the place it is the reach.
        to_edge = np.min(half / np.maximum(np.abs(_DIRECTIONS), 1e-9), axis=1)
        away = (_REACHES[:, None] + to_edge - 4.0)[:, :, None]
        centres = (place + away * _DIRECTIONS).reshape(-1, 2)
        reaches = np.repeat(_REACHES, len(_DIRECTIONS))
        i = int(np.argmin(self._costs(centres, half) + 0.25 * reaches))
        best, chosen = centres[i], reaches[i]
        low, high = best - half, best + half
        self.taken.append((*low, *high))
        if chosen > 15.0:
            near = np.clip(place, low + 1.0, high - 1.0)
            away = (near - place) / max(float(np.hypot(*(near - place))), 1e-9)
            leader = self.view.places(np.array([place + 6.0 * away, near]))
            self.view.axes.plot(*leader.T, color=colour, lw=0.7, alpha=0.7, zorder=8)
        x, y = self.view.places(best)
        self.view.axes.text(
            x, y, text, size=self.size, color=colour,
            ha="center", va="center", weight="bold", zorder=9,
        )  # fmt: skip

    def _costs(self, centres: FloatArray, half: FloatArray) -> FloatArray:
        """What labels at (n, 2) ``centres`` would hide, touch or cut off, (n,)."""
        low, high = (centres - half - 2.0)[:, None], (centres + half + 2.0)[:, None]
        frame = self.view.half * self.view.scale
        outside = np.maximum(high - frame, 0.0) + np.maximum(-frame - low, 0.0)
        covered = np.ones((len(low), len(self.obstacles)), dtype=bool)
        for axis in (0, 1):  # one after the other, in a tenth of the time
            places = np.ascontiguousarray(self.obstacles[:, axis])
            covered &= (places > low[:, :, axis]) & (places < high[:, :, axis])
        hidden = covered.sum(axis=1)
        taken = np.array(self.taken).reshape(-1, 4)
        touching = ((low < taken[:, 2:]) & (taken[:, :2] < high)).all(axis=2).sum(axis=1)
        costs: FloatArray = 100.0 * outside.sum(axis=(1, 2)) + 20.0 * hidden + 500.0 * touching
        return costs

    def keep_clear(self, place: FloatArray, half: float) -> None:
        """Let no label touch the square of 2 ``half`` points around a place, (2,) in the axes."""
        centre = self.view.points(place)
        self.taken.append((*(centre - half), *(centre + half)))


def draw_scene(
    view: View,
    road: Road,
    seen: SeenDrive | None,
    focus: Focus | None,
    *,
    near: View | None = None,
    labelled: bool = True,
) -> None:
    """The whole road from above with the drive on it, and a frame around what ``near`` shows."""
    draw_surface(view, road)
    spacing = max(1.0, road.length / _MAX_POINTS)
    start, end = view.at(road.sample(spacing, -0.5 * road.lane_width)[[0, -1]])
    size, width = (7.0, 1.5) if labelled else (4.5, 1.1)
    for place, marker, fill in ((start, "o", "white"), (end, "s", INK)):
        view.mark(place, marker, ms=size, mfc=fill, mec=INK, mew=width, zorder=7)

    # What labels must not hide.
    drawn = [view.at(road.sample(spacing, k * road.lane_width)) for k in (-1, -0.5, 0, 0.5, 1)]
    mark = None
    if seen is not None and focus is not None:
        _draw_path(view, seen, 0.5 * road.lane_width, 3.0 if labelled else 2.2)
        drawn.append(view.at(seen.xy))
        if labelled:
            some = _some_records(seen, focus)
            _draw_cars(view, seen, some, INK)
            _draw_cars(view, seen, [focus.record], focus.colour, zorder=6.0)
            drawn += _boxes(view, seen, [*some, focus.record])
        mark = view.at(seen.xy[[focus.record]])[0]
        if near is not None and near.scale > 2.0 * view.scale:
            corner, (across, up) = mark - near.half, 2.0 * near.half
            how: Any = {"fill": False, "ec": QUIET, "lw": 0.8, "alpha": 0.7, "zorder": 6}
            view.axes.add_artist(Rectangle(corner, across, up, **how))
            sides = np.linspace(-1.0, 1.0, 41)[:, None]
            for k in (-1.0, 1.0):
                drawn.append(mark + near.half * np.hstack([sides, np.full_like(sides, k)]))
                drawn.append(mark + near.half * np.hstack([np.full_like(sides, k), sides]))
        if seen.result.outcome is Outcome.PASS or not view.shows(mark):
            mark = None
        else:
            size, width = (15.0, 1.8) if labelled else (9.0, 1.4)
            view.mark(mark, "o", ms=size, mfc="none", mec=focus.colour, mew=width, zorder=7)
    if not labelled:
        return
    labels = _Labels(view, view.points(np.vstack(drawn)))
    for place in (start, end):
        labels.keep_clear(place, 4.0)
    if focus is not None and mark is not None:
        labels.keep_clear(mark, 9.0)
        labels.put(mark, focus.label, focus.colour)
    labels.put(start, "start", INK)
    labels.put(end, "end", INK)


def draw_surface(view: View, road: Road) -> None:
    """Both lanes, with an edge around what they cover together."""
    spacing = max(0.5, road.length / _MAX_POINTS)
    left, right = (view.at(edge_of(road, spacing, side)) for side in (1.0, -1.0))
    middle = view.at(road.sample(spacing))
    how: Any
    for one, other, how in (
        (left, right, {"fc": _CASING, "ec": _CASING, "lw": 1.8, "zorder": 1.0}),
        (left, middle, {"fc": _OTHER_LANE, "ec": _OTHER_LANE, "lw": 0.3, "zorder": 1.1}),
        (middle, right, {"fc": EGO_LANE, "lw": 0.0, "zorder": 1.2}),
    ):
        view.axes.add_artist(Polygon(np.vstack([one, other[::-1]]), joinstyle="round", **how))
    if road.lane_width * view.scale < _THINNEST:
        return
    width = max(0.9, 0.15 * view.scale)
    dash = max(3.0 * view.scale, 3.0) / width
    view.axes.plot(*middle.T, color="white", lw=width, zorder=1.3, dashes=(dash, dash))
    _draw_arrows(view, road)


def _draw_arrows(view: View, road: Road) -> None:
    """Arrows on the ego lane that point in driving direction."""
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


def _draw_path(view: View, seen: SeenDrive, half: float, width: float) -> None:
    """The path of the car's centre of mass, coloured by oob distance."""
    places = view.at(seen.xy)
    draw_coloured(view.axes, places, view.scale, seen.oob_distance, half, width)


def draw_coloured(
    axes: Axes, places: FloatArray, scale: Any, oob: FloatArray, half: float, width: float
) -> None:
    """A line coloured by oob distance.

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
    # Shorter pieces than 1.5 points are not seen.
    walked = np.cumsum(np.hypot(*(scale * np.diff(places, axis=0, prepend=places[:1])).T))
    some = np.unique(np.floor(walked / 1.5), return_index=True)[1]
    some = np.union1d(some[:: math.ceil(len(some) / _MAX_POINTS)], [len(places) - 1])
    if len(some) < 2:
        return
    # One stroke per run of (nearly) one colour: strokes that meet overlap, which shows.
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


def _some_records(seen: SeenDrive, focus: Focus) -> list[int]:
    """A few records at equal distances, none near to the one that the picture is about."""
    driven = np.cumsum(np.hypot(*np.diff(seen.xy, axis=0, prepend=seen.xy[:1]).T))
    count = int(np.clip(driven[-1] / 15.0, 0.0, 6.0))
    some = np.searchsorted(driven, np.linspace(0.0, driven[-1], count + 2)[1:-1])
    away = np.hypot(*(seen.xy - seen.xy[focus.record]).T)
    return [int(i) for i in some if away[i] > 8.0]


def _boxes(view: View, seen: SeenDrive, records: Sequence[int]) -> list[FloatArray]:
    """The car's box at some records: corners from the left rear clockwise, (4, 2) points each."""
    car = seen.drive.car
    x = car.centre_ahead + car.length * np.array([-0.5, 0.5, 0.5, -0.5])
    corners = np.column_stack([x, car.width * np.array([0.5, 0.5, -0.5, -0.5])])
    return [view.at(seen.xy[i] + turned(corners, seen.heading[i])) for i in records]


def _draw_cars(
    view: View,
    seen: SeenDrive,
    records: Sequence[int],
    colour: str,
    *,
    width: float = 0.9,
    zorder: float = 5.0,
    fill: float = 0.0,
) -> None:
    """The boxes of the car at some records, with a line where the windscreen is."""
    boxes = _boxes(view, seen, records)
    screens = [np.array([0.3 * b[0] + 0.7 * b[1], 0.7 * b[2] + 0.3 * b[3]]) for b in boxes]
    inside = (*to_rgb(colour), fill) if fill else (1.0, 1.0, 1.0, 0.35)
    view.add(PolyCollection(boxes, ec=colour, facecolor=inside, linewidths=width, zorder=zorder))
    view.add(LineCollection(screens, colors=colour, linewidths=width, zorder=zorder))


def draw_close_up(view: View, road: Road, seen: SeenDrive, focus: Focus) -> None:
    """The place that the picture is about, large enough to see the car on the lane."""
    draw_surface(view, road)
    _draw_path(view, seen, 0.5 * road.lane_width, 4.0)
    # Boxes a little more than a car apart, back and forth from the one that matters.
    away = np.abs(seen.distance - seen.distance[focus.record])
    step = 1.35 * seen.drive.car.length
    chosen = []
    for direction in (-1, 1):
        i, due = focus.record, step
        while 0 <= i < len(seen) and away[i] < 2.0 * ACROSS:
            if away[i] >= due:
                chosen.append(i)
                due = away[i] + step
            i += direction
    _draw_cars(view, seen, chosen, INK)
    _draw_cars(view, seen, [focus.record], focus.colour, width=1.8, zorder=6.0, fill=0.22)
    place = view.at(seen.xy[[focus.record]])[0]
    view.mark(place, "o", ms=4.5, color=focus.colour, zorder=7)


def draw_key(page: Paper, y: float, view: View, road: Road, seen: SeenDrive | None) -> None:
    """Below the view: scale, axes of the map, and what the colours mean."""
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
    if seen is not None and len(seen):
        draw_colour_bar(page, WIDTH - MARGIN, y + 0.07, 0.5 * road.lane_width)


def draw_colour_bar(page: Paper, right: float, y: float, half: float) -> None:
    """Key to the colours of a path up to ``right``; ``half`` is half a lane, in m."""
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
    """A line as long as so many metres are in a view."""
    length = metres * view.scale / POINT
    page.line([x, x, x + length, x + length], [y - 0.06, y, y, y - 0.06], color=QUIET, lw=1.2)
    page.text(x + length + 0.08, y, f"{metres:g} m", size=8.5, color=QUIET)
