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
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from frenetic._support.arrays import FloatArray
from frenetic.errors import FreneticError
from frenetic.oracle import Assessment, Result, assess, judge
from frenetic.outcome import Outcome
from frenetic.report.style import DPI, FAINT, INK, PANEL, QUIET, STYLE, form_of, write_figure
from frenetic.road import Road
from frenetic.simulators.drive import Drive, Trajectory

MAX_SHEET: Final = 400
"""Most pictures on one contact sheet."""

_POINT: Final = 72.0  # points per inch; lines and letters are measured in points
_MAX_POINTS: Final = 4000  # more of a path or road than that is not seen

# Sizes in inches.
_WIDTH: Final = 11.0
_MARGIN: Final = 0.45
_INNER: Final = _WIDTH - 2.0 * _MARGIN
_CLOSE_UP: Final = 3.2
_GAP: Final = 0.14
_ACROSS: Final = 26.0  # m, width of what the close-up shows
_LOWEST, _HIGHEST = 2.4, 5.7  # the road seen from above

_CASING: Final = "#7f8b98"
_OTHER_LANE: Final = "#d9dde3"
_EGO_LANE: Final = "#c6d7ea"
_ALARM: Final = "#d1232a"
_COLOURS: Final[Mapping[Outcome, str]] = {
    Outcome.PASS: "#1b8a6b",
    Outcome.FAIL: _ALARM,
    Outcome.INVALID: "#c98a00",
    Outcome.ERROR: "#7a5aa6",
}
# Plasma without its yellow, which would vanish on white: blue in the lane, pink on its edge, orange
# outside. Lightness rises evenly, so it reads in grey and with any kind of colour vision.
_OOB_MAP: Final = LinearSegmentedColormap.from_list(
    "oob", mpl.colormaps["plasma"](np.linspace(0.84, 0.0, 128))
)

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
        seen = _look(road, drive)
        outcome = seen.result.outcome
        figure = _page(
            road,
            seen,
            title or f"Drive: {outcome}",
            seen.result.reason,
            _COLOURS[outcome],
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
        colour = INK if reason is None else _COLOURS[Outcome.INVALID]
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


# --- What is drawn: a drive seen from its road -----------------------------------------------


@dataclass(frozen=True)
class _Seen:
    """A drive with its verdict, cut to the records that count."""

    drive: Drive
    result: Result
    distance: FloatArray  # (n,) m along the road
    oob_distance: FloatArray  # (n,) m
    xy: FloatArray  # (n, 2) m
    heading: FloatArray  # (n,) rad
    speed: FloatArray  # (n,) km/h
    time: FloatArray  # (n,) s

    def __len__(self) -> int:
        return len(self.time)


def _look(road: Road, drive: Drive) -> _Seen:
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
    return _Seen(
        drive=drive,
        result=judge(road, drive),
        distance=seen.distance,
        oob_distance=seen.oob_distance,
        xy=np.column_stack([t.x[:n], t.y[:n]]),
        heading=t.heading[:n],
        speed=t.speed[:n] * 3.6,
        time=t.time[:n],
    )


@dataclass(frozen=True)
class _Focus:
    """The main record of a picture."""

    record: int
    what: str  # headline of the close-up
    label: str  # beside the mark on the road
    colour: str


def _focus(seen: _Seen) -> _Focus | None:
    """The departure, else the end of a drive that did not pass, else the car's worst moment."""
    if not len(seen):
        return None
    result, last = seen.result, len(seen) - 1
    colour = _COLOURS[result.outcome]
    if result.departure is not None:
        return _Focus(last, "Departure", f"departure to the {result.departure.side}", colour)
    if result.outcome is Outcome.PASS:
        worst = int(np.argmin(seen.oob_distance))
        return _Focus(worst, "Smallest oob distance", "", colour)
    return _Focus(last, "Where it ended", f"ended at {seen.distance[last]:.0f} m", colour)


_Fact: TypeAlias = tuple[str, str, str]  # name, value, detail


def _facts(road: Road, seen: _Seen) -> list[_Fact]:
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
    seen: _Seen | None,
    title: str,
    reason: str,
    colour: str,
    facts: Sequence[_Fact],
    map_size: float | None,
) -> Figure:
    focus = None if seen is None else _focus(seen)
    lines = _wrapped(reason, 118, 3)
    profiles = ["oob", "curvature", "speed"] if focus is not None else ["curvature"]
    heights = {"oob": 1.35, "curvature": 0.85, "speed": 0.85}

    turn = _best_turn(road)
    wide = _box(road, seen, turn)
    # A road that is shown that large needs no close-up.
    shown = min(_INNER / wide.width, _HIGHEST / wide.height)
    closer = focus is not None and shown < 0.6 * _CLOSE_UP / _ACROSS
    main_width = _INNER - (_CLOSE_UP + _GAP if closer else 0.0)
    main_height = float(np.clip(main_width * wide.height / wide.width, _LOWEST, _HIGHEST))

    top = 0.42 + 0.42 + 0.235 * len(lines) + 0.16
    tiles = 0.74
    strip = 0.66
    heading = 0.3
    below = sum(heights[name] + heading for name in profiles) + 0.55
    height = top + tiles + main_height + strip + below
    page = _Paper(Figure(figsize=(_WIDTH, height), dpi=DPI, facecolor="white"), _WIDTH, height)

    # Headline.
    page.bar(_MARGIN, 0.42, 0.07, 0.36 + 0.235 * len(lines), colour)
    page.text(_MARGIN + 0.2, 0.42 + 0.29, _one_line(title, 58), size=19, weight="bold")
    for i, line in enumerate(lines):
        page.text(_MARGIN + 0.2, 0.42 + 0.56 + 0.235 * i, line, size=11, color=QUIET)
    for i, (name, value, detail) in enumerate(facts):
        x = _MARGIN + i * _INNER / 6.0
        name = f"{name}, {detail}" if detail else name
        page.text(x, top + 0.18, name, size=8.5, color=QUIET)
        page.text(x, top + 0.45, value, size=14, weight="bold")

    # From above.
    y = top + tiles
    view = _View.showing(wide, turn, main_width, main_height)
    main = page.panel(_MARGIN, y, view)
    near = None
    if closer and seen is not None and focus is not None:
        near = view.zoomed(_sane(seen.xy[focus.record]), _ACROSS, _CLOSE_UP, main_height)
        x = _MARGIN + main_width + _GAP
        _draw_close_up(page.panel(x, y, near), near, road, seen, focus)
        page.text(
            x + 0.12, y + 0.24, focus.what, size=9.5, weight="bold", color=focus.colour,
            bbox={"facecolor": PANEL, "edgecolor": "none", "alpha": 0.85, "pad": 2.5},
        )  # fmt: skip
        _draw_scale(page, x + 0.12, y + main_height - 0.14, near, 5.0)
    _draw_scene(main, view, road, seen, focus, map_size, near=near)
    _draw_key(page, y + main_height + 0.1, view, road, seen, map_size)

    # Along the road.
    y += main_height + strip
    for name in profiles:
        last = name == profiles[-1]
        page.text(_MARGIN, y + heading - 0.08, _PROFILES[name], size=8.5, color=QUIET)
        y += heading
        axes = page.axes(_MARGIN + 0.45, y, _INNER - 0.45, heights[name])
        _style_profile(axes, road, labelled=last)
        if name == "curvature":
            _draw_curvature(axes, road)
        elif seen is not None and focus is not None:
            if name == "oob":
                _draw_oob_distance(axes, road, seen)
            else:
                _draw_speed(axes, seen)
        if seen is not None and seen.result.departure is not None:
            axes.axvline(seen.result.departure.distance, color=_ALARM, lw=1.0, zorder=2)
            if name == profiles[0]:
                _mark_departure(axes, road, seen.result.departure.distance)
        y += heights[name]
    return page.figure


@dataclass(frozen=True)
class _Paper:
    """A figure with positions in inches from the upper left corner."""

    figure: Figure
    width: float
    height: float

    def text(self, x: float, y: float, text: str, *, size: float, **how: Any) -> Any:
        how.setdefault("va", "baseline")
        return self.figure.text(
            x / self.width, 1.0 - y / self.height, text, size=size, parse_math=False, **how
        )

    def axes(self, x: float, y: float, width: float, height: float) -> Any:
        return self.figure.add_axes(
            (
                x / self.width,
                1.0 - (y + height) / self.height,
                width / self.width,
                height / self.height,
            )
        )

    def bar(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        self.figure.add_artist(
            Rectangle(
                (x / self.width, 1.0 - (y + height) / self.height),
                width / self.width,
                height / self.height,
                facecolor=colour,
                edgecolor="none",
            )
        )

    def line(self, xs: Sequence[float], ys: Sequence[float], **how: Any) -> None:
        self.figure.add_artist(
            Line2D([x / self.width for x in xs], [1.0 - y / self.height for y in ys], **how)
        )

    def panel(self, x: float, y: float, view: _View) -> Any:
        """Axes whose data are points (1/72 inch) from their centre, for what a view shows."""
        axes = self.axes(x, y, view.width / _POINT, view.height / _POINT)
        axes.set_facecolor(PANEL)
        axes.set_xlim(-view.width / 2.0, view.width / 2.0)
        axes.set_ylim(-view.height / 2.0, view.height / 2.0)
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_visible(False)
        return axes


def _printable(text: str) -> str:
    """``text`` on one line, without characters that a picture file cannot hold."""
    return "".join(c for c in " ".join(text.split()) if c.isprintable())


def _one_line(text: str, most: int) -> str:
    text = _printable(text)
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def _wrapped(text: str, width: int, most: int) -> list[str]:
    return textwrap.wrap(_printable(text), width, max_lines=most, placeholder=" …")


# --- The view from above ---------------------------------------------------------------------


@dataclass(frozen=True)
class _Box:
    """A rectangle in the turned plane, in metres."""

    x: float  # of its centre
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class _View:
    """The mapping of metres to points on paper: turned, moved, scaled."""

    turn: float  # rad counter-clockwise
    x: float  # m, turned, in the middle of the view
    y: float
    scale: float  # points per metre
    width: float  # points
    height: float  # points

    @classmethod
    def showing(cls, box: _Box, turn: float, width: float, height: float) -> _View:
        """The view of ``width`` x ``height`` inches in which ``box`` fits."""
        scale = _POINT * min(width / box.width, height / box.height)
        return cls(turn, box.x, box.y, scale, width * _POINT, height * _POINT)

    def at(self, points: FloatArray) -> FloatArray:
        """(n, 2) points on paper of (n, 2) places in m."""
        return self.scale * (_turned(points, self.turn) - (self.x, self.y))

    def shows(self, place: FloatArray) -> bool:
        """Whether (2,) ``place``, points on paper, is in sight."""
        return bool(2.0 * abs(place[0]) < self.width and 2.0 * abs(place[1]) < self.height)

    def zoomed(self, place: FloatArray, across: float, width: float, height: float) -> _View:
        """The view of ``width`` x ``height`` inches, ``across`` m wide, around (2,) ``place``."""
        ((x, y),) = _turned(place[None], self.turn)
        return _View(self.turn, x, y, _POINT * width / across, width * _POINT, height * _POINT)


def _turned(points: FloatArray, turn: float) -> FloatArray:
    c, s = math.cos(turn), math.sin(turn)
    result: FloatArray = points @ np.array([[c, s], [-s, c]])
    return result


def _sane(places: FloatArray) -> FloatArray:
    """Places, (n, 2) in m, with those out of any picture brought near enough to draw."""
    return np.clip(places, -1e6, 1e6)


def _outline(road: Road, spacing: float = 2.0) -> FloatArray:
    """The road's outer edges, (n, 2) in m."""
    spacing = max(spacing, road.length / _MAX_POINTS)
    return np.vstack(
        [road.sample(spacing, road.lane_width), road.sample(spacing, -road.lane_width)]
    )


def _best_turn(road: Road) -> float:
    """Angle by which the map is turned on paper, in rad: 0 unless that wastes paper.

    A long and narrow road, upright or aslant, is laid down, driven from left to right.
    """
    outline = _outline(road, 4.0)

    def size(turn: float) -> tuple[float, float, float]:
        w, h = np.ptp(_turned(outline, turn), axis=0)
        return min((_INNER - _CLOSE_UP) / w, _HIGHEST / h), w, h

    scale = size(0.0)[0]
    turns = np.radians(np.arange(-90.0, 90.0, 3.0))
    best = max(turns, key=lambda turn: size(turn)[0])
    flat = min(turns, key=lambda turn: size(turn)[2])
    _, long, narrow = size(flat)
    if long > 4.0 * narrow:
        best = flat
    elif size(best)[0] < 1.4 * scale:
        return 0.0
    start, end = _turned(np.array([road.pose_at(0.0)[:2], road.pose_at(road.length)[:2]]), best)
    return float(best) if start[0] <= end[0] else float(best) + math.pi


def _box(road: Road, seen: _Seen | None, turn: float) -> _Box:
    """The box to show: the road and the path, unless the path goes far astray."""
    outline = _turned(_outline(road), turn)
    low, high = outline.min(axis=0), outline.max(axis=0)
    if seen is not None and len(seen):
        path = np.clip(_turned(seen.xy, turn), low - 15.0, high + 15.0)
        low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    around = 4.0 + 0.03 * float((high - low).max())
    x, y = (low + high) / 2.0
    width, height = high - low + 2.0 * around
    return _Box(float(x), float(y), float(width), float(height))


@dataclass
class _Labels:
    """Places labels in a panel without hiding anything or touching each other."""

    axes: Any
    view: _View
    obstacles: FloatArray  # (n, 2) points on paper
    size: float = 9.0
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    def put(self, place: FloatArray, text: str, colour: str) -> None:
        """Write ``text`` beside (2,) ``place`` (points on paper), with a leader if need be."""
        half = np.array([0.31 * self.size * len(text) + 2.0, 0.68 * self.size])
        best, chosen, cheapest = place, 0.0, math.inf
        for reach in (11.0, 18.0, 28.0, 42.0, 60.0, 84.0):
            for angle in np.arange(16) * (math.pi / 8.0):
                direction = np.array([math.cos(angle), math.sin(angle)])
                # From the label's edge to the place it is reach.
                to_edge = min(
                    h / abs(d) for h, d in zip(half, direction, strict=True) if abs(d) > 1e-9
                )
                centre = place + (reach + to_edge - 4.0) * direction
                cost = self._cost(centre, half) + 0.25 * reach
                if cost < cheapest:
                    best, cheapest, chosen = centre, cost, reach
        low, high = best - half, best + half
        self.taken.append((*low, *high))
        if chosen > 15.0:
            near = np.clip(place, low + 1.0, high - 1.0)
            away = (near - place) / max(float(np.hypot(*(near - place))), 1e-9)
            tip = place + 6.0 * away
            self.axes.plot(
                [tip[0], near[0]], [tip[1], near[1]], color=colour, lw=0.7, alpha=0.7, zorder=8
            )
        self.axes.text(
            *best, text, size=self.size, color=colour, ha="center", va="center", weight="bold",
            parse_math=False, zorder=9,
        )  # fmt: skip

    def _cost(self, centre: FloatArray, half: FloatArray) -> float:
        low, high = centre - half - 2.0, centre + half + 2.0
        frame = np.array([self.view.width, self.view.height]) / 2.0
        outside = np.maximum(high - frame, 0.0) + np.maximum(-frame - low, 0.0)
        hidden = ((self.obstacles > low) & (self.obstacles < high)).all(axis=1).sum()
        touching = sum(
            low[0] < b[2] and b[0] < high[0] and low[1] < b[3] and b[1] < high[1]
            for b in self.taken
        )
        return float(100.0 * outside.sum() + 20.0 * hidden + 500.0 * touching)

    def keep_clear(self, centre: FloatArray, half: float) -> None:
        """Let no label touch the square of 2 ``half`` points around (2,) ``centre``."""
        self.taken.append((*(centre - half), *(centre + half)))


def _draw_scene(
    axes: Any,
    view: _View,
    road: Road,
    seen: _Seen | None,
    focus: _Focus | None,
    map_size: float | None,
    *,
    near: _View | None = None,
    labelled: bool = True,
) -> None:
    """The whole road from above with the drive on it, and a frame around what ``near`` shows."""
    _draw_map_edge(axes, view, map_size)
    _draw_surface(axes, view, road)
    spacing = max(1.0, road.length / _MAX_POINTS)
    start, end = view.at(road.sample(spacing, -0.5 * road.lane_width)[[0, -1]])
    size, width = (7.0, 1.5) if labelled else (4.5, 1.1)
    for place, marker, fill in ((start, "o", "white"), (end, "s", INK)):
        axes.plot(*place, marker, ms=size, mfc=fill, mec=INK, mew=width, zorder=7)

    # What labels must not hide.
    drawn = [view.at(road.sample(spacing, k * road.lane_width)) for k in (-1, -0.5, 0, 0.5, 1)]
    mark = None
    if seen is not None and focus is not None:
        _draw_path(axes, view, seen, 0.5 * road.lane_width, 3.0 if labelled else 2.2)
        drawn.append(view.at(_sane(seen.xy)))
        if labelled:
            some = _some_records(seen, focus)
            _draw_cars(axes, view, seen, some, INK)
            _draw_cars(axes, view, seen, [focus.record], focus.colour, zorder=6.0)
            drawn += _boxes(view, seen, [*some, focus.record])
        mark = view.at(_sane(seen.xy[[focus.record]]))[0]
        if near is not None and near.scale > 2.0 * view.scale:
            half = 0.5 * np.array([near.width, near.height]) * view.scale / near.scale
            axes.add_patch(
                Rectangle(
                    mark - half, *(2.0 * half), fill=False, ec=QUIET, lw=0.8, alpha=0.7, zorder=6
                )
            )  # fmt: skip
            sides = np.linspace(-1.0, 1.0, 41)[:, None]
            for k in (-1.0, 1.0):
                drawn.append(mark + half * np.hstack([sides, np.full_like(sides, k)]))
                drawn.append(mark + half * np.hstack([np.full_like(sides, k), sides]))
        if seen.result.outcome is Outcome.PASS or not view.shows(mark):
            mark = None
        else:
            size, width = (15.0, 1.8) if labelled else (9.0, 1.4)
            axes.plot(*mark, "o", ms=size, mfc="none", mec=focus.colour, mew=width, zorder=7)
    if not labelled:
        return
    labels = _Labels(axes, view, np.vstack(drawn))
    for place in (start, end):
        labels.keep_clear(place, 4.0)
    if focus is not None and mark is not None:
        labels.keep_clear(mark, 9.0)
        labels.put(mark, focus.label, focus.colour)
    labels.put(start, "start", INK)
    labels.put(end, "end", INK)


def _draw_surface(axes: Any, view: _View, road: Road) -> None:
    """Both lanes, drawn as wide lines, which stay correct in bends and crossings."""
    lane, scale = road.lane_width, view.scale
    spacing = max(0.5, road.length / _MAX_POINTS)

    def strip(offset: float, width: float, colour: str, zorder: float, **how: Any) -> None:
        axes.plot(
            *view.at(road.sample(spacing, offset)).T, color=colour, lw=width, zorder=zorder,
            solid_capstyle="butt", dash_capstyle="butt", solid_joinstyle="round", **how,
        )  # fmt: skip

    strip(0.0, 2.0 * lane * scale + 1.8, _CASING, 1.0)
    strip(0.0, 2.0 * lane * scale, _OTHER_LANE, 1.1)
    strip(-0.5 * lane, lane * scale, _EGO_LANE, 1.2)
    width = max(0.9, 0.15 * scale)
    dash = max(3.0 * scale, 3.0) / width
    strip(0.0, width, "white", 1.3, dashes=(dash, dash))
    _draw_arrows(axes, view, road)


def _draw_arrows(axes: Any, view: _View, road: Road) -> None:
    """Arrows on the ego lane that point in driving direction."""
    size = float(np.clip(1.3 * view.scale, 3.2, 11.0))
    apart = max(130.0 / view.scale, road.length / 40.0)
    count = max(1, int(road.length / apart))
    distances = (np.arange(count) + 0.5) * road.length / count
    shape = size * np.array([[1.0, 0.0], [-0.8, 0.9], [-0.35, 0.0], [-0.8, -0.9]])
    polygons = []
    for s in distances:
        x, y, heading = road.pose_at(float(s))
        half = 0.5 * road.lane_width
        place = np.array([[x + half * math.sin(heading), y - half * math.cos(heading)]])
        polygons.append(view.at(place) + _turned(shape, heading + view.turn))
    axes.add_collection(
        PolyCollection(polygons, facecolor="white", edgecolor="none", zorder=1.4), autolim=False
    )


def _draw_path(axes: Any, view: _View, seen: _Seen, half: float, width: float) -> None:
    """The path of the car's centre of mass, coloured by oob distance."""
    places = view.at(_sane(seen.xy))
    _add_coloured(axes, places, places, seen.oob_distance, half, width)


def _add_coloured(
    axes: Any, places: FloatArray, on_paper: FloatArray, oob: FloatArray, half: float, width: float
) -> None:
    """A line through (n, 2) ``places``, which are (n, 2) ``on_paper`` in points."""
    if len(places) < 2:
        return
    # Pieces shorter than 1.5 points are invisible.
    walked = np.cumsum(np.hypot(*np.diff(on_paper, axis=0, prepend=on_paper[:1]).T))
    some = np.unique(np.floor(walked / 1.5), return_index=True)[1]
    some = np.union1d(some[:: math.ceil(len(some) / _MAX_POINTS)], [len(places) - 1])
    if len(some) < 2:
        return
    # One stroke per run of (nearly) one colour: overlapping ends of strokes would show.
    places, oob = places[some], oob[some]
    shades = np.round(24.0 * np.clip(0.5 * (oob[:-1] + oob[1:]) / half, -1.0, 1.0))
    breaks = np.flatnonzero(np.diff(shades)) + 1
    first, last = np.r_[0, breaks], np.r_[breaks, len(shades)]
    line = LineCollection(
        [places[a : b + 1] for a, b in zip(first, last, strict=True)],
        cmap=_OOB_MAP,
        norm=Normalize(-1.0, 1.0),
        linewidths=width,
        capstyle="round",
        joinstyle="round",
        zorder=4,
    )
    line.set_array(shades[first] / 24.0)
    axes.add_collection(line, autolim=False)


def _some_records(seen: _Seen, focus: _Focus) -> list[int]:
    """A few records at equal distances, none near the picture's main one."""
    driven = np.cumsum(np.hypot(*np.diff(_sane(seen.xy), axis=0, prepend=seen.xy[:1]).T))
    count = int(np.clip(driven[-1] / 15.0, 0.0, 6.0))
    some = np.searchsorted(driven, np.linspace(0.0, driven[-1], count + 2)[1:-1])
    away = np.hypot(*(seen.xy - seen.xy[focus.record]).T)
    return [int(i) for i in some if away[i] > 8.0]


def _boxes(view: _View, seen: _Seen, records: Sequence[int]) -> list[FloatArray]:
    """The car's box at some records: corners from the left rear clockwise, (4, 2) points each."""
    car = seen.drive.car
    x = car.centre_ahead + car.length * np.array([-0.5, 0.5, 0.5, -0.5])
    corners = np.column_stack([x, car.width * np.array([0.5, 0.5, -0.5, -0.5])])
    return [view.at(_sane(seen.xy[i]) + _turned(corners, seen.heading[i])) for i in records]


def _draw_cars(
    axes: Any,
    view: _View,
    seen: _Seen,
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
    axes.add_collection(
        PolyCollection(boxes, ec=colour, facecolor=inside, linewidths=width, zorder=zorder),
        autolim=False,
    )
    axes.add_collection(
        LineCollection(screens, colors=colour, linewidths=width, zorder=zorder), autolim=False
    )


def _draw_map_edge(axes: Any, view: _View, map_size: float | None) -> None:
    if map_size is not None:
        edge = view.at(_map_edge(map_size))
        axes.plot(*edge.T, color=QUIET, lw=1.0, dashes=(5.0, 3.0), alpha=0.8, zorder=0.5)


def _map_edge(map_size: float) -> FloatArray:
    """Points all around the map, (n, 2) in m."""
    along = np.linspace(0.0, map_size, 201)
    near, far = np.zeros_like(along), np.full_like(along, map_size)
    x = np.concatenate([along, far, along[::-1], near])
    y = np.concatenate([near, along, far, along[::-1]])
    return np.column_stack([x, y])


def _draw_close_up(axes: Any, view: _View, road: Road, seen: _Seen, focus: _Focus) -> None:
    """The picture's main place, large enough to see the car on the lane."""
    _draw_surface(axes, view, road)
    _draw_path(axes, view, seen, 0.5 * road.lane_width, 4.0)
    # Boxes a little more than a car apart, back and forth from the main one.
    away = np.abs(seen.distance - seen.distance[focus.record])
    step = 1.35 * seen.drive.car.length
    chosen = []
    for direction in (-1, 1):
        i, due = focus.record, step
        while 0 <= i < len(seen) and away[i] < 2.0 * _ACROSS:
            if away[i] >= due:
                chosen.append(i)
                due = away[i] + step
            i += direction
    _draw_cars(axes, view, seen, chosen, INK)
    _draw_cars(axes, view, seen, [focus.record], focus.colour, width=1.8, zorder=6.0, fill=0.22)
    axes.plot(
        *view.at(_sane(seen.xy[[focus.record]]))[0], "o", ms=4.5, color=focus.colour, zorder=7
    )  # fmt: skip


def _draw_key(
    page: _Paper, y: float, view: _View, road: Road, seen: _Seen | None, map_size: float | None
) -> None:
    """Below the view: scale, axes of the map, and what the colours mean."""
    metres = 10.0 ** math.floor(math.log10(130.0 / view.scale))
    metres *= max(k for k in (1, 2, 5) if k * metres * view.scale <= 130.0)
    x = _MARGIN
    _draw_scale(page, x, y + 0.24, view, metres)
    x += metres * view.scale / _POINT + 0.85
    for name, angle in (("x", view.turn), ("y", view.turn + math.pi / 2.0)):
        dx, dy = 0.15 * math.cos(angle), -0.15 * math.sin(angle)
        page.line([x, x + dx], [y + 0.24, y + 0.24 + dy], color=QUIET, lw=1.1)
        page.text(
            x + 1.55 * dx,
            y + 0.24 + 1.55 * dy,
            name,
            size=8,
            color=QUIET,
            ha="center",
            va="center",
        )
    if map_size is not None and any(view.shows(place) for place in view.at(_map_edge(map_size))):
        x += 0.65
        page.line([x, x + 0.36], [y + 0.2, y + 0.2], color=QUIET, lw=1.0, dashes=(5.0, 3.0))
        page.text(x + 0.45, y + 0.24, "edge of the map", size=8.5, color=QUIET)
    if seen is not None and len(seen):
        width = 3.2
        bar = page.axes(_WIDTH - _MARGIN - width, y + 0.07, width, 0.11)
        half = 0.5 * road.lane_width
        _colour_bar(bar, half)
        page.text(
            _WIDTH - _MARGIN - width - 0.15,
            y + 0.17,
            "oob distance (m)",
            size=8.5,
            color=QUIET,
            ha="right",
        )


def _colour_bar(axes: Any, half: float) -> None:
    axes.figure.colorbar(
        ScalarMappable(Normalize(-half, half), _OOB_MAP),
        cax=axes,
        orientation="horizontal",
        extend="min",
        extendfrac=0.04,
        ticks=[-half, 0.0, half],
    ).outline.set_visible(False)
    axes.tick_params(length=0.0, pad=3.0)
    labels = axes.set_xticklabels([f"−{half:g}", "0 lane edge", f"{half:g} lane centre"])
    labels[-1].set_horizontalalignment("right")


def _draw_scale(page: _Paper, x: float, y: float, view: _View, metres: float) -> None:
    length = metres * view.scale / _POINT
    page.line([x, x, x + length, x + length], [y - 0.06, y, y, y - 0.06], color=QUIET, lw=1.2)
    page.text(x + length + 0.08, y, f"{metres:g} m", size=8.5, color=QUIET)


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


def _draw_oob_distance(axes: Any, road: Road, seen: _Seen) -> None:
    half = 0.5 * road.lane_width
    least = int(np.argmin(seen.oob_distance))
    value = max(float(seen.oob_distance[least]), -3.0 * half)
    low = min(-0.6 * half, value - 0.65 * half)
    axes.set_ylim(low, 1.55 * half)  # the departure's label has its place on top
    axes.axhspan(low, 0.0, color="#fbeeee", zorder=0.2, lw=0.0)
    axes.axhline(0.0, color=_ALARM, lw=0.8, alpha=0.6, zorder=1.5)
    axes.set_yticks([k * half for k in (-1.0, 0.0, 1.0) if k * half > low])
    places = np.column_stack([seen.distance, seen.oob_distance])
    on_paper = places * (_POINT * _INNER / road.length, _POINT * 1.35 / (1.55 * half - low))
    _add_coloured(axes, places, on_paper, seen.oob_distance, half, 2.2)
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
        color=_ALARM,
        zorder=6,
    )


def _draw_curvature(axes: Any, road: Road) -> None:
    places = np.arange(len(road.curvatures)) * road.step
    reach = max(0.0125, 1.25 * float(np.abs(road.curvatures).max()))
    axes.set_ylim(-reach, reach)
    axes.fill_between(places, road.curvatures, color=_EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(places, road.curvatures, color="#48678a", lw=1.4, zorder=3)
    for y, text, va in ((0.95, "left", "top"), (0.05, "right", "bottom")):
        axes.text(1.004, y, text, transform=axes.transAxes, size=7.5, color=QUIET, va=va, ha="left")


def _draw_speed(axes: Any, seen: _Seen) -> None:
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
    width = (_INNER - 0.2 * (columns - 1)) / columns
    height = min(0.9 * width, _HIGHEST)
    top, caption = 1.1 if title else 0.65, 0.52
    total = top + rows * (height + caption) + 0.25
    page = _Paper(Figure(figsize=(_WIDTH, total), dpi=DPI, facecolor="white"), _WIDTH, total)
    if title:
        page.text(_MARGIN, 0.68, _one_line(title, 60), size=19, weight="bold")
    bar = page.axes(_WIDTH - _MARGIN - 3.2, top - 0.45, 3.2, 0.11)
    _colour_bar(bar, 0.5 * items[0][1].lane_width)
    page.text(
        _WIDTH - _MARGIN - 3.35, top - 0.35, "oob distance (m)", size=8.5, color=QUIET, ha="right"
    )
    letters = int(width / 0.088)
    for k, (text, road, drive) in enumerate(items):
        row, column = divmod(k, columns)
        x = _MARGIN + column * (width + 0.2)
        y = top + row * (height + caption)
        seen = _look(road, drive)
        turn = _best_turn(road)  # as in the drive's own picture
        view = _View.showing(_box(road, seen, turn), turn, width, height)
        _draw_scene(page.panel(x, y, view), view, road, seen, _focus(seen), None, labelled=False)
        page.text(x, y + height + 0.17, _one_line(text, letters), size=9, weight="bold")
        page.text(x, y + height + 0.33, _sheet_line(road, seen), size=8, color=QUIET)
    return page.figure


def _sheet_line(road: Road, seen: _Seen) -> str:
    result = seen.result
    if result.moobd is None:
        return f"{result.outcome}, {road.length:.0f} m"
    return f"{road.length:.0f} m, MOOBD {_signed(result.moobd, 2)} m"


# --- The file --------------------------------------------------------------------------------
