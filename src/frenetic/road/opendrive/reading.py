"""Reading roads of an OpenDRIVE file.

What is read of a road is one lane: its width, its slopes, and its edge on the side of the road's
centre, which becomes the centre line of the road that is returned. Other lanes, road marks, signals
and objects are left out.

A file's geometries have any lengths, and its curvature may jump between them; a road has one step
and a curvature that is linear in between. So the edge is traced every few centimetres and followed
by a road with a sample every half metre or denser, which is refused if it is more than `TOLERANCE`
beside it.

The numbers of a file are rounded, so geometries do not quite meet: coordinates of two decimals
leave gaps of up to 1.4 cm, headings of two decimals lead 30 cm aside after 60 m. Geometries are
turned by what the rounding of their headings allows, and gaps are blended over `BLEND` m on either
side.
"""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import geometry, profile
from frenetic.road.from_points import CORRECTION, follow_line
from frenetic.road.opendrive.writing import PROFILE_CODE, ROAD_CODE, add_road
from frenetic.road.road import (
    MAX_COORDINATE,
    MAX_CURVATURE,
    MAX_HEADING,
    MAX_LENGTH,
    MAX_SAMPLES,
    MAX_SPEED_LIMIT,
    MIN_DISTANCE,
    MIN_SPEED_LIMIT,
    Pose,
    Road,
)

TOLERANCE: Final = 0.01
"""Largest distance of a road beside the line in its file, in m."""
STEP_ASIDE: Final = 2.0 * TOLERANCE
"""Largest gap sideways between two geometries, in m; its middle is `TOLERANCE` from both."""
GAP: Final = 0.05
"""Largest gap along the road between two geometries, and largest gap between two roads, in m."""
KINK: Final = 0.01
"""Largest change of heading from the end of one geometry to the start of the next, in rad."""
TURN: Final = math.radians(2.0)
"""Largest change of heading from the end of a road to the start of the next, in rad."""
ROUNDING: Final = 1e-6
"""Error of computed gaps and turns, in m or rad: a gap of exactly `GAP` must not be refused."""
BLEND: Final = 5.0
"""Length on either side of a gap over which it is blended, in m."""
ROUNDED: Final = range(2, 5)
"""Numbers of decimals of headings that count as rounded: with fewer they are exact, with more their
error does not matter."""
STEPS: Final = (0.5, 0.25, 0.1)
"""Steps of a road that follows a line, in m; the first within `TOLERANCE` is taken."""
SPACING: Final = 0.1
"""Distance between the points of a traced line, in m."""
LEVEL: Final = 1e-3
"""Largest coefficient of a crossfall or shape that counts as none."""
JUMP: Final = 0.1
"""Largest step of a road's height, in m."""
SAME_WIDTH: Final = 0.01
"""Largest change of a lane's width that counts as none, in m."""
MIN_WIDTH: Final = 2.0
"""Width of the narrowest lane that is driven, in m."""
MAX_ELEMENTS: Final = 1_000_000
"""Most elements of a file; a map of a town has 200,000."""

_DRIVEN: Final = frozenset(
    [
        *("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane"),
        *("mwyEntry", "mwyExit", "bidirectional", "restricted", "bus", "taxi", "HOV"),
    ]
)
"""Types of lanes that a user may choose."""
_DRAWN: Final = frozenset(
    [
        *("geometry", "line", "arc", "spiral", "paramPoly3", "elevation", "superelevation"),
        *("laneSection", "laneOffset", "width"),
    ]
)
"""Elements that say where lanes run."""
_UNITS: Final = {"km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609344, "m/s": 3.6}
"""Unit of a speed -> km/h; OpenDRIVE's own is m/s."""
_NO_LIMIT: Final = ("", "no limit", "undefined")
"""Texts in place of a speed."""
_LISTED: Final = 8  # roads or lanes in a message
_PLACES: Final = 1.0  # m between the places at which slopes and widths are read
SLOPE_ERROR: Final = 1e-4
"""Largest error of the slopes of a road that was read, in m/m."""
WIDTH_ERROR: Final = 1e-3
"""Largest error of the widths of a road that was read, in m."""

_PLAIN_ID: Final = re.compile(r'[^\s,@"]([^,@"]*[^\s,@"])?')  # needs no quotes
_NAMED: Final = re.compile(r'\s*("(?:[^"\\]|\\.)*"|[^,@"]*)(?:@([^,]*))?\s*(,|$)')
_MOST_LETTERS: Final = 80  # of an id in a message
_QUOTED: Final = "an id with a comma, an @ or a quote stands in double quotes"

# Columns of a traced line, one row per point. (MOVED_X, MOVED_Y) is how far the blends of gaps
# between a road's geometries have moved the point, in m. LIMIT is the speed limit on the way from
# the row before, in km/h.
DISTANCE, X, Y, HEADING, MOVED_X, MOVED_Y, WIDTH, HEIGHT, LEAN, LIMIT = range(10)


@dataclass(frozen=True)
class Stretch:
    """A stretch of a map's roads, one after the other."""

    ids: tuple[str, ...]
    """Of the roads."""
    start: float
    """m along the first road, or beyond it, at which the stretch begins."""
    road: Road
    notes: tuple[str, ...] = ()
    """Sentences about roads of it that do not quite meet."""

    @property
    def name(self) -> str:
        """The text for `RoadMap.stretches` that gives it."""
        return self.behind(0.0)

    def behind(self, place: float) -> str:
        """The text of what is left behind a place in m along it, from the next whole metre on."""
        start = math.ceil(self.start + place - 1e-9)
        first, *others = map(quoted_id, self.ids)
        return ",".join([f"{first}@{start}" if start else first, *others])


class RoadMap:
    """The roads in an OpenDRIVE file.

    Args:
        data: the file's content.

    Raises:
        RoadError: it is no such file; no message names the file.
    """

    def __init__(self, data: bytes) -> None:
        root = _parse(data)
        if root.tag != "OpenDRIVE":
            raise RoadError(f"it is XML, but no OpenDRIVE: its root is <{root.tag:.40}>")
        header = root.find("header")
        major = None if header is None else header.get("revMajor")
        if major != "1":
            raise RoadError(
                f"its header says revMajor {major!r:.40}, but only OpenDRIVE 1.x is read"
            )
        self._roads: dict[str, list[Element]] = {}  # by id, which should be of one road only
        for road in root.findall("road"):
            self._roads.setdefault(road.get("id", ""), []).append(road)
        self._count = sum(map(len, self._roads.values()))
        if not self._count:
            raise RoadError("it has no road")

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all roads."""
        return tuple(self._roads)

    @property
    def lengths(self) -> dict[str, float]:
        """Id of each drivable road outside junctions -> its length in m, the longest first."""
        lengths = {
            road_id: _number(road, "length", 0.0, most=math.inf)
            for road_id, (road, *_) in self._roads.items()
            if road.get("junction", "-1") == "-1" and _is_drivable(road)
        }
        return dict(sorted(lengths.items(), key=lambda item: -item[1]))

    def road(self, road_id: str | None = None, *, lane: int | None = None) -> Road:
        """A road of it, where it lies.

        One that `to_opendrive` wrote is the same road: curvatures, profiles, step, pose and lane
        width bit for bit. Any other is at most 1 cm away from the line in the file, its slopes
        within 0.01 % and its width within 1 mm.

        Args:
            road_id: of the road; None for the only one.
            lane: id of the lane that becomes the ego lane, where its drive begins. One on the left
                (a positive id) is driven against the road, from its end to its start. None: the
                driving lane nearest to the centre, one on the right if there is one.

        Raises:
            RoadError: there is no such road or lane, or it has something that a `Road` has not.
        """
        element = self._element(road_id)
        with _naming(element):
            lane = _first_lane(element) if lane is None else lane
            noted = _noted_road(element) if lane == -1 else None
            return _followed(_lane_line(element, lane)) if noted is None else noted

    def stretches(self, roads: str, *, lane: int | None = None) -> list[Stretch]:
        """Stretches of it, where they lie.

        Args:
            roads: ids of roads with commas. A road that starts where the one before ends continues
                that; another one begins a stretch of its own. ``12@240`` begins 240 m along the
                stretch that road 12 begins. An id with a comma, an @ or a quote stands in double
                quotes, as in JSON: ``"7,left"@20,8``. It needs none if the map has no road 7.
            lane: of the first road of each stretch, as for `road`. Another road continues it with
                the lane that begins where the lane before ends, at most 5 cm and 2 degrees off.

        Raises:
            RoadError: as for `road`, or a stretch is not as long.
        """
        runs: list[_Run] = []
        element: Element | None = None
        for road_id, start in self._parsed(roads):
            before, element = element, self._element(road_id)
            with _naming(element):
                notes: list[str] = []
                if runs and before is not None and not start:
                    joint = _nearest_lane(element, runs[-1].end)
                    notes = _joint_notes(before, element, joint)
                    if joint is not None and joint.is_joined:
                        runs[-1].ids.append(road_id)
                        runs[-1].line = _joined_roads(runs[-1].line, joint)
                        runs[-1].end = joint.line[-1]
                        runs[-1].notes += notes
                        continue
                first = _first_lane(element) if lane is None else lane
                line = _lane_line(element, first)
                runs.append(_Run([road_id], start, line, line[-1], notes))
        stretches = []
        for run in runs:
            with _naming(*map(self._element, run.ids)):
                skipped = _station(run.start, run.line[-1, DISTANCE]) if run.start else 0.0
                row = int(np.searchsorted(run.line[:, DISTANCE], skipped - 1e-9))
                line = run.line[row:].copy()
                line[:, DISTANCE] -= line[0, DISTANCE]
                road = _followed(line)
            stretches.append(Stretch(tuple(run.ids), skipped, road, tuple(run.notes)))
        return stretches

    def _parsed(self, text: str) -> list[tuple[str, str]]:
        """The roads in a text for `stretches`: their ids, each with the text of m behind its @.

        Raises:
            RoadError: a quote has no end, or something stands behind it.
        """
        names = []
        place = 0
        is_last = False
        while not is_last:
            name = _NAMED.match(text, place)
            if name is None:
                if text.strip() in self._roads:
                    return [(text.strip(), "")]
                raise RoadError(f"{_short(text)!r} is not ID[@METRES][,ID..]: {_QUOTED}")
            road_id, start, comma = name[1].strip(), name[2] or "", name[3]
            if road_id.startswith('"'):
                try:
                    road_id = str(json.loads(road_id, strict=False))
                except ValueError as error:
                    raise RoadError(f"{_short(road_id)} cannot be read: {error}") from None
            names.append((road_id, start))
            place, is_last = name.end(), not comma
        if text.strip() in self._roads and any(name not in self._roads for name, _ in names):
            return [(text.strip(), "")]
        return names

    def _element(self, road_id: str | None) -> Element:
        """The only road, or that with an id.

        Raises:
            RoadError: there is none, or there are several.
        """
        if road_id is None and self._count == 1:
            ((road,),) = self._roads.values()
        elif road_id is None:
            raise RoadError(f"it has {self._count} roads; choose with --road: {self._listed()}")
        else:
            roads = self._roads.get(road_id, [])
            if not roads:
                quotes = (
                    f"; {_QUOTED}" if any(set(name) & set(',@"') for name in self._roads) else ""
                )
                raise RoadError(f"it has no road {_short(road_id)!r}, but {self._listed()}{quotes}")
            if len(roads) > 1:
                raise RoadError(
                    f"it has {len(roads)} roads with the id {_short(road_id)!r}: give each its own"
                )
            (road,) = roads
        if road.get("rule", "RHT") != "RHT":
            raise RoadError(
                f"its rule is {road.get('rule')!r:.40}: only right-hand traffic (RHT) is read"
            )
        return road

    def _listed(self) -> str:
        """The longest drivable roads, for a message."""
        longest = list(self.lengths.items())[:_LISTED]
        if not longest:
            return "none has a driving lane outside junctions"
        listed = [f"{_short(quoted_id(name))} ({length:.0f} m)" for name, length in longest]
        drivable = sum(map(_is_drivable, itertools.chain(*self._roads.values())))
        return ", ".join([*listed, *([".."] if drivable > len(longest) else [])])


def quoted_id(road_id: str) -> str:
    """A road's id as a text for `RoadMap.stretches` has it, in double quotes if it needs them."""
    if road_id.isprintable() and _PLAIN_ID.fullmatch(road_id):
        return road_id
    return json.dumps(road_id, ensure_ascii=not road_id.isprintable())


def _short(text: str) -> str:
    """A text for a message, without its middle if it is long."""
    return text if len(text) <= _MOST_LETTERS else f"{text[: _MOST_LETTERS - 22]}..{text[-20:]}"


@contextmanager
def _naming(*roads: Element) -> Iterator[None]:
    """Names the roads in errors."""
    try:
        yield
    except RoadError as error:
        names = _short(",".join(quoted_id(road.get("id", "")) for road in roads))
        raise RoadError(f"road {names}: {error}") from None


# XML


class _Tree(ElementTree.TreeBuilder):
    """A tree of elements without anything harmful.

    A document type is refused, and with it every entity: those that expand to gigabytes (the
    "billion laughs"), and those that would be fetched from elsewhere.
    """

    elements = 0

    def doctype(self, *_: object) -> None:
        raise RoadError("it has a document type (DOCTYPE), which no OpenDRIVE file needs")

    def start(self, tag: str, attrs: dict[str, str], /) -> Element:
        self.elements += 1
        if self.elements > MAX_ELEMENTS:
            raise RoadError(
                f"it has more than {MAX_ELEMENTS} elements: take the part of the map that you need"
            )
        return super().start(tag.rpartition("}")[2], attrs)  # any namespace


def _parse(data: bytes) -> Element:
    """The root element.

    Raises:
        RoadError: no well-formed XML, a document type, or too many elements.
    """
    try:
        return ElementTree.XML(data, ElementTree.XMLParser(target=_Tree()))  # noqa: S314 - no DTD
    except ElementTree.ParseError as error:
        raise RoadError(f"it is not XML: {error}") from None
    except RoadError:
        raise
    except (LookupError, ValueError):
        raise RoadError("it is not XML in an encoding that can be read: save it as UTF-8") from None


def _number(
    element: Element, name: str, default: float | None = None, *, most: float = MAX_COORDINATE
) -> float:
    """A number among an element's attributes, at most ``most`` in either direction.

    Raises:
        RoadError: it is missing and there is no default, it is no finite number, or too large.
    """
    text = element.get(name)
    if text is None:
        if default is None:
            raise RoadError(f"a <{element.tag}> has no '{name}'")
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= most:
        raise RoadError(
            f"a <{element.tag}> has {name}={text[:40]!r}: a number of at most {most:g} in either"
            " direction is needed"
        )
    return value


def _cubic(element: Element, suffix: str = "") -> list[float]:
    """The coefficients a, b, c, d of a polynomial; missing ones are 0."""
    return [_number(element, name + suffix, 0.0) for name in "abcd"]


def _profile(
    elements: Sequence[Element], name: str, places: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values (n,) and slopes (n,) of piecewise cubics at places (n,) in m along the road.

    Each element's cubic holds from its ``name`` on, in m; before the first all is 0.
    """
    elements = sorted(elements, key=lambda element: _number(element, name))
    starts = np.array([0.0, *(_number(element, name) for element in elements)])
    cubics = np.array([[0.0] * 4, *map(_cubic, elements)])
    rows = np.searchsorted(starts[1:], places, side="right")
    p = places - starts[rows]
    a, b, c, d = cubics[rows].T
    return a + p * (b + p * (c + p * d)), b + p * (2.0 * c + p * 3.0 * d)


# The reference line


def _reference_line(road: Element) -> FloatArray:
    """(n, 6) points of a road's reference line: the first columns of a traced line.

    Raises:
        RoadError: there is a gap or a kink between two geometries, or one cannot be read.
    """
    parts, headings = [], []
    total = 0.0
    for element in road.findall("planView/geometry"):
        length = _number(element, "length", most=math.inf)
        if length < 0.0:
            raise RoadError(f"a <geometry> has length {length:g}: a positive number is needed")
        total += length
        if total > MAX_LENGTH:
            raise RoadError(f"it is longer than the {MAX_LENGTH:.0f} m that can be read")
        if length > MIN_DISTANCE:
            parts.append(_traced(element, length))
            headings.append(element.get("hdg", "").strip())
    if not parts:
        raise RoadError("it has no geometry")
    error = _heading_error(headings)
    if error:
        parts = _turned_to_meet(parts, error)
    line, rows, gaps = _concatenated(parts, KINK + 2.0 * error)
    return np.column_stack([line, _close_gaps(line, rows, gaps)])


def _heading_error(headings: Sequence[str]) -> float:
    """Largest error of headings that are rounded to a few decimals, in rad; 0 for any others."""
    decimals = max(len(heading.partition(".")[2]) for heading in headings)
    return 0.5 * 0.1**decimals if decimals in ROUNDED else 0.0


def _turned_to_meet(parts: Sequence[FloatArray], most: float) -> list[FloatArray]:
    """Lines (n, 4) turned about their starts, by at most ``most`` rad, so that each meets the next.

    The last one, which no line follows, is turned to the heading at which it is reached.
    """
    turned: list[FloatArray] = []
    for i, part in enumerate(parts):
        if i + 1 < len(parts):
            (x, y), (next_x, next_y) = (
                end - part[0, X:HEADING]
                for end in (part[-1, X:HEADING], parts[i + 1][0, X:HEADING])
            )
            angle = math.atan2(x * next_y - y * next_x, x * next_x + y * next_y)
        else:
            reached = turned[-1][-1, HEADING] if turned else part[0, HEADING]
            angle = math.remainder(reached - part[0, HEADING], math.tau)
        angle = min(max(angle, -most), most)
        c, s = math.cos(angle), math.sin(angle)
        x, y = (part[:, X:HEADING] - part[0, X:HEADING]).T
        place = part[0, X:HEADING] + np.column_stack([c * x - s * y, s * x + c * y])
        turned.append(np.column_stack([part[:, DISTANCE], place, part[:, HEADING] + angle]))
    return turned


def _traced(element: Element, length: float) -> FloatArray:
    """(n, 4) points of a geometry."""
    x, y = _number(element, "x"), _number(element, "y")
    heading = _number(element, "hdg", most=MAX_HEADING)
    shape = next(iter(element), element)
    if shape.tag == "paramPoly3":
        return _polynomial(shape, length, x, y, heading)
    names = {
        "line": (),
        "arc": ("curvature", "curvature"),
        "spiral": ("curvStart", "curvEnd"),
    }.get(shape.tag)
    if names is None:
        raise RoadError(
            f"a <geometry> holds {'nothing' if shape is element else shape.tag[:40]}: line, arc,"
            " spiral and paramPoly3 are read"
        )
    bend = [_number(shape, name, most=MAX_CURVATURE) for name in names]
    curvatures = np.array(bend or [0.0, 0.0])
    pieces = max(geometry.sub_steps(curvatures, length), math.ceil(length / SPACING))
    table = geometry.build_table(curvatures, length, x, y, heading, pieces)
    return np.column_stack([np.linspace(0.0, length, pieces + 1), table[:, :3]])


def _polynomial(shape: Element, length: float, x: float, y: float, heading: float) -> FloatArray:
    """(n, 4) points of a ``paramPoly3``, whose places are cubic polynomials of a parameter."""
    last = length if shape.get("pRange") == "arcLength" else 1.0
    u, v = (np.polynomial.Polynomial(_cubic(shape, axis)) for axis in "UV")  # ahead, to the left
    p = np.linspace(0.0, last, max(8, math.ceil(length / SPACING)) + 1)
    middle = 0.5 * (p[1:] + p[:-1])
    speed, between = (np.hypot(u.deriv()(at), v.deriv()(at)) for at in (p, middle))
    # Simpson's rule between the parameters.
    pieces = (speed[1:] + 4.0 * between + speed[:-1]) * np.diff(p) / 6.0
    distance = np.concatenate([[0.0], np.cumsum(pieces)])
    if not abs(float(distance[-1]) - length) <= 0.1 + 0.01 * length:
        raise RoadError(
            f"a polynomial geometry is {distance[-1]:.4g} m long, not {length:g} m as its 'length'"
            " says"
        )
    if speed.min() < 1e-3 * speed.max():
        raise RoadError("a polynomial geometry has a cusp, which no road can follow")
    c, s = math.cos(heading), math.sin(heading)
    direction = heading + np.unwrap(np.arctan2(v.deriv()(p), u.deriv()(p)))
    return np.column_stack([distance, x + u(p) * c - v(p) * s, y + u(p) * s + v(p) * c, direction])


def _concatenated(
    parts: Sequence[FloatArray], kink: float
) -> tuple[FloatArray, list[int], list[tuple[float, float]]]:
    """Lines (n, 4) one after the other; distances and headings go on.

    Args:
        parts: the lines.
        kink: rad, largest change of heading from one to the next.

    Returns:
        The line, with the row behind each gap, and the gap there in m.

    Raises:
        RoadError: one does not begin where the one before ends.
    """
    parts = [parts[0], *(part.copy() for part in parts[1:])]
    row = len(parts[0])
    rows, gaps = [], []
    for before, part in pairwise(parts):
        end, place = before[-1], f"{before[-1, DISTANCE]:.2f} m along the road"
        dx, dy = (part[0, X:HEADING] - end[X:HEADING]).tolist()
        turn = math.remainder(part[0, HEADING] - end[HEADING], math.tau)
        c, s = math.cos(end[HEADING] + 0.5 * turn), math.sin(end[HEADING] + 0.5 * turn)
        along, aside = dx * c + dy * s, dy * c - dx * s
        if abs(along) > GAP + ROUNDING:
            raise RoadError(
                f"the reference line jumps by {abs(along):.3f} m {place}: at most {GAP:g} m along"
                " it is mended"
            )
        if abs(aside) > STEP_ASIDE + ROUNDING:
            raise RoadError(
                f"the reference line jumps sideways by {abs(aside):.3f} m {place}: at most"
                f" {STEP_ASIDE:g} m is mended"
            )
        if abs(turn) > kink + ROUNDING:
            raise RoadError(
                f"the reference line has a kink of {math.degrees(turn):.1f} degrees {place}: a"
                " road has none"
            )
        if math.hypot(dx, dy) > MIN_DISTANCE:
            rows.append(row)
            gaps.append((dx, dy))
        row += len(part) - 1
        part[:, DISTANCE] += end[DISTANCE]
        part[:, HEADING] += turn - (part[0, HEADING] - end[HEADING])
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])]), rows, gaps


def _close_gaps(
    line: FloatArray, rows: Sequence[int], gaps: Sequence[tuple[float, float]]
) -> FloatArray:
    """Move the points of a line (n, >= 4) so that its gaps are closed.

    The sum of the gaps behind a point is a staircase along the line. Each point moves to where the
    mean of the staircase over `BLEND` m on either side, weighted by a triangle, puts it. So the
    line is as smooth there as a road whose curvature jumps by gap / BLEND^2. The time does not
    depend on how dense the gaps are.

    Args:
        line: is changed: places and headings.
        rows: of the first point behind each gap.
        gaps: (x, y) in m from the end before it to the start behind it.

    Returns:
        How far the points moved, (n, 2) in m.
    """
    if not len(rows):
        return np.zeros((len(line), 2))
    stations = line[:, DISTANCE]
    knots = np.concatenate([stations[:1], stations[np.array(rows) - 1]])
    sums = np.concatenate([[(0.0, 0.0)], np.cumsum(gaps, axis=0)])
    # The staircase, constant from knot to knot, and its first and second integral at the knots.
    spans = np.diff(knots)[:, None]
    first = np.concatenate([[(0.0, 0.0)], np.cumsum(spans * sums[:-1], axis=0)])
    pieces = spans * (first[:-1] + 0.5 * spans * sums[:-1])
    second = np.concatenate([[(0.0, 0.0)], np.cumsum(pieces, axis=0)])

    def integrals(places: FloatArray) -> FloatArray:
        k = np.maximum(np.searchsorted(knots, places, side="right") - 1, 0)
        p = (places - knots[k])[:, None]
        return np.stack([first[k] + p * sums[k], second[k] + p * (first[k] + 0.5 * p * sums[k])])

    before, here, behind = (integrals(stations + shift) for shift in (-BLEND, 0.0, BLEND))
    slope, mean = (before - 2.0 * here + behind) / BLEND**2
    moved: FloatArray = mean - sums[np.searchsorted(rows, np.arange(len(line)), side="right")]
    _move(line, moved, slope)
    return moved


def _move(line: FloatArray, moved: FloatArray, slope: FloatArray) -> None:
    """Move the points of a line (n, >= 4) by (n, 2) m, which changes by (n, 2) m per m along it."""
    c, s = np.cos(line[:, HEADING]), np.sin(line[:, HEADING])
    line[:, X:HEADING] += moved
    line[:, HEADING] += np.arctan2(
        c * slope[:, 1] - s * slope[:, 0], 1.0 + c * slope[:, 0] + s * slope[:, 1]
    )


def _measure(line: FloatArray) -> None:
    """Set the distances of a line (n, >= 4) to its length so far, in m."""
    chords = np.hypot(*np.diff(line[:, X:HEADING], axis=0).T)
    arcs = chords * (1.0 + np.diff(line[:, HEADING]) ** 2 / 24.0)
    line[:, DISTANCE] = np.concatenate([[0.0], np.cumsum(arcs)])


# Roads one after the other


@dataclass
class _Run:
    """Roads that continue each other."""

    ids: list[str]
    start: str
    """Text of the m at which the stretch begins; empty for none."""
    line: FloatArray
    end: FloatArray
    """Last row of the last road's line before a blend moved it."""
    notes: list[str]


@dataclass(frozen=True)
class _Joint:
    """Where a lane would continue another one."""

    line: FloatArray
    """(n, 10) of the lane that would continue the other."""
    gap: float
    """m from the end of the lane before."""
    turn: float
    """Change of heading in rad."""

    @property
    def is_joined(self) -> bool:
        """Whether a blend may join them."""
        return self.gap <= GAP + ROUNDING and abs(self.turn) <= TURN + ROUNDING

    @property
    def text(self) -> str:
        """How far the two lanes miss each other."""
        gap = f"{100.0 * self.gap:.1f} cm" if self.gap < 1.0 else f"{self.gap:.1f} m"
        return f"{gap} and {math.degrees(abs(self.turn)):.1f} degrees"


def _nearest_lane(road: Element, end: FloatArray) -> _Joint | None:
    """The lane of a road that begins nearest to the end of one; None if none can be driven."""
    joints = []
    for lane in _entered(road):
        try:
            line = _lane_line(road, int(_number(lane, "id")))
        except RoadError:
            continue
        gap = float(np.hypot(*(line[0, X:HEADING] - end[X:HEADING])))
        turn = math.remainder(line[0, HEADING] - end[HEADING], math.tau)
        joints.append(_Joint(line, gap, turn))
    return min(joints, key=lambda joint: (not joint.is_joined, joint.gap), default=None)


def _joint_notes(before: Element, road: Element, joint: _Joint | None) -> list[str]:
    """Note that a road misses the end of the road named before it; none if it meets that end."""
    if joint is None:
        return []
    names = [_short(quoted_id(element.get("id", ""))) for element in (before, road)]
    misses = f"road {names[1]} begins {joint.text} off the end of road {names[0]}"
    if joint.is_joined:
        is_exact = joint.gap <= TOLERANCE and abs(joint.turn) <= KINK
        return [] if is_exact else [f"{misses}: joined by a blend over {2.0 * BLEND:g} m"]
    if not (_is_linked(before, road) or _is_linked(road, before)):
        return []
    limit = f"{100.0 * GAP:g} cm and {math.degrees(TURN):g} degrees"
    return [
        f"{misses}; the two are linked, but only up to {limit} are joined, so road {names[1]} is"
        " driven on its own"
    ]


def _is_linked(road: Element, other: Element) -> bool:
    """Whether a road names another one, or its junction, as its successor or predecessor."""
    ids = {"road": other.get("id", ""), "junction": other.get("junction", "-1")}
    return any(
        link.get("elementId") == ids.get(link.get("elementType", "road"))
        for link in road.findall("link/*")
        if link.tag in ("successor", "predecessor") and link.get("elementId") != "-1"
    )


def _joined_roads(before: FloatArray, joint: _Joint) -> FloatArray:
    """A lane's line (n, 10) and the one that continues it, joined by a blend."""
    line, end = joint.line.copy(), before[-1].copy()
    gap = line[0, X:HEADING] - end[X:HEADING]
    # A blend at the joint before may have moved the end, and the line goes on from there.
    turn = math.remainder(line[0, HEADING] - end[HEADING], math.tau)
    normal = end[HEADING] + 0.5 * turn
    line[:, DISTANCE] += end[DISTANCE]
    line[:, HEADING] += end[HEADING] + turn - line[0, HEADING]
    row = len(before)
    line = np.concatenate([before, line[1:]])
    is_kink = abs(turn) > KINK
    if is_kink:
        # An arc of BLEND m on either side cuts the corner.
        p = np.clip(line[:, DISTANCE] - end[DISTANCE], -BLEND, BLEND)
        aside = turn * ((p**2 + BLEND**2) / (4.0 * BLEND) - 0.5 * np.abs(p))
        side = np.where(np.arange(len(line)) < row, 0.5, -0.5)
        slope = turn * np.where(np.abs(p) < BLEND, 0.5 * p / BLEND + side, 0.0)
        left = np.array([-math.sin(normal), math.cos(normal)])
        _move(line, np.outer(aside, left), np.outer(slope, left))
    is_gap = float(np.hypot(*gap)) > MIN_DISTANCE
    if is_gap:
        _close_gaps(line, [row], [tuple(gap.tolist())])
    if is_kink or is_gap:
        _measure(line)
    return line


# Lanes


def _lane_line(road: Element, lane: int) -> FloatArray:
    """(n, 10) the inner edge of a lane in the direction of travel, and what is along it.

    Raises:
        RoadError: there is no such lane, or the road is none that is read.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    line = _reference_line(road)
    places = line[:, DISTANCE].copy()
    course = _course(road, lane, places)
    _check_shape(road, is_level=course.is_level_across)
    height, _ = _profile(road.findall("elevationProfile/elevation"), "s", places)
    lean, _ = _profile(road.findall("lateralProfile/superelevation"), "s", places)
    lean = np.tan(np.clip(lean, -1.5, 1.5))
    height += course.tilted * lean
    high = np.flatnonzero(np.abs(np.diff(height)) > JUMP)
    if len(high):
        raise RoadError(f"it jumps in height {places[high[0]]:.2f} m along the road")
    lean = np.where(course.is_level, 0.0, lean)
    shift = course.shift
    if np.abs(shift).max() > MIN_DISTANCE:
        heading = line[:, HEADING].copy()
        ahead = 1.0 - shift * np.gradient(heading, places)
        if ahead.min() <= 0.0:
            raise RoadError("its lanes are shifted beyond the centre of a bend, where no road is")
        line[:, X] -= shift * np.sin(heading)
        line[:, Y] += shift * np.cos(heading)
        line[:, HEADING] += np.arctan2(course.slope, ahead)
        line[1:, DISTANCE] = np.cumsum(np.hypot(np.diff(line[:, X]), np.diff(line[:, Y])))
    elif line[:, MOVED_X:].any():
        _measure(line)
    limit = profile.steps_at(_limits(road, lane), places - 0.5 * np.diff(places, prepend=0.0))
    line = np.column_stack([line, course.width, height, lean, limit])
    if lane > 0:
        line = line[::-1].copy()
        line[:, DISTANCE] = line[0, DISTANCE] - line[:, DISTANCE]
        line[:, HEADING] += math.pi
        line[:, LEAN] *= -1.0
        line[1:, LIMIT] = line[:-1, LIMIT]
    return line


@dataclass(frozen=True)
class _Course:
    """A lane at places (n,) along its road."""

    width: FloatArray
    """m."""
    shift: FloatArray
    """Of the lane's inner edge, in m to the left of the reference line."""
    slope: FloatArray
    """Of the shift, in m per m along the road."""
    tilted: FloatArray
    """Part of the shift that superelevation tilts, in m: all but lanes that are level."""
    is_level: FloatArray
    """Whether the lane is level (``level="true"``), which excludes it from superelevation."""

    @property
    def is_level_across(self) -> bool:
        """Whether everything from the reference line to the lane's outer edge is level."""
        return bool(self.is_level.all() and np.abs(self.tilted).max() <= MIN_DISTANCE)


def _course(road: Element, lane: int, places: FloatArray) -> _Course:
    """A lane at places (n,) in m along its road.

    The shift of its inner edge is the lane offset and the widths of the lanes in between.
    """
    side = 1 if lane > 0 else -1
    shift, slope = _profile(road.findall("lanes/laneOffset"), "s", places)
    tilted, is_level = shift.copy(), np.zeros(len(places), dtype=bool)
    width = np.zeros_like(places)
    for section, element, start, end in _along(road, lane):
        here = (start <= places) & (places < end)
        width[here], _ = _width(element, places[here] - start)
        is_level[here] = _is_level(element)
        for inner in range(1, abs(int(_number(element, "id")))):
            between = _lane_of(section, side * inner, is_driven=False)
            widths, slopes = _width(between, places[here] - start)
            shift[here] += side * widths
            slope[here] += side * slopes
            if not _is_level(between):
                tilted[here] += side * widths
    return _Course(width, shift, slope, tilted, is_level)


def _along(road: Element, lane: int) -> Iterator[tuple[Element, Element, float, float]]:
    """Each section with the lane that a lane leads to there, and its start and end in m.

    From section to section the lane's own links are followed; where it has none, its id stays.

    Raises:
        RoadError: a section has no such lane.
    """
    side, onward = (1, "predecessor") if lane > 0 else (-1, "successor")
    where = "left" if lane > 0 else "right"
    sections = _sections(road, where)
    starts = [_number(section, "s") for section in sections]
    if starts[0] > TOLERANCE:
        raise RoadError(f"it has no lanes {where} of the centre before {starts[0]:.2f} m")
    starts[0] = min(starts[0], 0.0)
    spans = list(zip(sections, starts, [*starts[1:], math.inf], strict=True))
    link: Element | None = None
    for section, start, end in spans if lane < 0 else reversed(spans):
        if link is not None:
            lane = int(_number(link, "id"))
            if lane * side <= 0:
                raise RoadError(f"a lane leads to lane {lane}, which is driven the other way")
        element = _lane_of(section, lane)
        link = element.find(f"link/{onward}")
        yield section, element, start, end


def _limits(road: Element, lane: int) -> FloatArray:
    """Speed limits of a lane, (k, 2) in m along the road and km/h; 0 where none is said.

    A lane's own limit comes before that of the road's type.
    """
    types = sorted(road.findall("type"), key=lambda element: _number(element, "s", 0.0))
    of_type = [(_number(kind, "s", 0.0), _limit(kind.find("speed"))) for kind in types]
    of_road = np.array(of_type or [(0.0, 0.0)])
    steps: dict[float, float] = {}
    for _, element, start, end in _along(road, lane):
        speeds = sorted(
            (_number(speed, "sOffset", 0.0), _limit(speed)) for speed in element.findall("speed")
        )
        of_lane = [(start, 0.0), *((start + offset, limit) for offset, limit in speeds)]
        stations = {start, *(s for s, _ in of_lane), *of_road[:, 0].tolist()}
        for station in stations:
            if start <= station < end:
                lane_limit = float(profile.steps_at(np.array(of_lane), station))
                steps[station] = lane_limit or float(profile.steps_at(of_road, station))
    return profile.merged(np.array(sorted(steps.items())))


def _limit(speed: Element | None) -> float:
    """The limit that a ``speed`` says, in km/h; 0 for none, or one that no road has.

    Raises:
        RoadError: it has another unit, or is no number.
    """
    if speed is None or speed.get("max", "") in _NO_LIMIT:
        return 0.0
    unit = speed.get("unit", "m/s").strip().lower()
    if unit not in _UNITS:
        raise RoadError(f"a <speed> has unit={unit[:40]!r}: {', '.join(_UNITS)} are known")
    limit = _UNITS[unit] * _number(speed, "max")
    return limit if MIN_SPEED_LIMIT <= limit <= MAX_SPEED_LIMIT else 0.0


def _check_shape(road: Element, *, is_level: bool) -> None:
    """Refuse a road whose cross-section is not straight where the lane lies.

    Args:
        road: the road.
        is_level: whether the lane and all between it and the reference line are level, so that only
            the height of the reference line matters.

    Raises:
        RoadError: it has a crossfall or a shape.
    """
    crossfalls = road.findall("lateralProfile/crossfall")
    if not is_level and any(np.abs(_cubic(element)).max() > LEVEL for element in crossfalls):
        raise RoadError("it is shaped across (crossfall): only superelevation is read")
    shapes: dict[float, list[Element]] = {}
    for element in road.findall("lateralProfile/shape"):
        shapes.setdefault(_number(element, "s"), []).append(element)
    if is_level:
        centre = [_profile(across, "t", np.zeros(1))[0][0] for across in shapes.values()]
        is_shaped = bool(centre) and float(np.ptp(centre)) > LEVEL
    else:
        cubics = [_cubic(element) for across in shapes.values() for element in across]
        is_shaped = bool(np.abs(cubics).max(initial=0.0) > LEVEL)
    if is_shaped:
        raise RoadError("it is shaped across (shape): only superelevation is read")


def _width(lane: Element, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Width of a lane at places (n,) in m along its section, and its slope."""
    elements = lane.findall("width")
    if not elements:
        raise RoadError(
            f"its lane {lane.get('id')} has no width (borders instead of widths are not read)"
        )
    return _profile(elements, "sOffset", places)


def _sections(road: Element, side: str) -> list[Element]:
    """The lane sections that hold for a side, left or right.

    Raises:
        RoadError: there are none on either side.
    """
    sections = road.findall("lanes/laneSection")
    if not sections:
        raise RoadError("it has no lanes")
    of_side = [
        section
        for section in sections
        if not _is_true(section, "singleSide") or section.find(f"{side}/lane") is not None
    ]
    return of_side or sections


def _entered(road: Element) -> list[Element]:
    """The lanes where they are entered: those on the right, then those on the left."""
    right, left = _sections(road, "right")[0], _sections(road, "left")[-1]
    return [*right.findall("right/lane"), *left.findall("left/lane")]


def _first_lane(road: Element) -> int:
    """Id of the lane nearest to the centre, where it is entered; on the right if possible.

    One for buses or the like is taken where there is no other.

    Raises:
        RoadError: there is none.
    """
    lanes = [
        (lane.get("type") != "driving", int(_number(lane, "id")))
        for lane in _entered(road)
        if _is_driven(lane)
    ]
    if not lanes:
        raise RoadError("it has no driving lane")
    return min(lanes, key=lambda lane: (lane[0], lane[1] > 0, abs(lane[1])))[1]


def _is_driven(lane: Element) -> bool:
    return lane.get("type") in _DRIVEN and lane.get("direction", "standard") == "standard"


def _is_drivable(road: Element) -> bool:
    """Whether a road has a lane that is driven."""
    has_lanes = road.find("lanes/laneSection") is not None
    return has_lanes and any(map(_is_driven, _entered(road)))


def _is_level(lane: Element) -> bool:
    return _is_true(lane, "level")


def _is_true(element: Element, name: str) -> bool:
    """Whether an attribute says true; a missing one does not."""
    return element.get(name, "").strip().lower() in ("true", "1")


def _lane_of(section: Element, lane: int, *, is_driven: bool = True) -> Element:
    """A section's lane with an id, which is for cars if it is driven.

    Raises:
        RoadError: there is none; the message lists the driving lanes.
    """
    side = "right" if lane < 0 else "left"
    element = section.find(f"{side}/lane[@id='{lane}']")
    if element is not None and (not is_driven or _is_driven(element)):
        return element
    if element is None:
        what = "is missing"
    elif element.get("type") in _DRIVEN:
        what = "is driven against the road's rule (direction)"
    else:
        what = f"is of type {element.get('type')!r:.40}"
    lanes = [*section.findall("right/lane"), *section.findall("left/lane")]
    ids = ", ".join(one.get("id", "")[:9] for one in lanes if _is_driven(one))
    raise RoadError(
        f"its lane {lane}, {side} of the centre, {what} (driving lanes, to be chosen as 'lane':"
        f" {ids or 'none'})"
    )


def _station(text: str, length: float) -> float:
    """The m along its roads at which a stretch begins.

    Raises:
        RoadError: it is none.
    """
    try:
        start = float(text)
    except ValueError:
        start = math.nan
    if not 0.0 <= start < length - _PLACES:
        raise RoadError(f"@{text[:40]} is no place on a stretch of {length:.0f} m")
    return start


# The road


def _followed(line: FloatArray) -> Road:
    """The road along a lane's line (n, 10).

    Raises:
        RoadError: its lane is too narrow, or no road stays near it.
    """
    length = float(line[-1, DISTANCE])
    places = np.append(np.arange(0.0, length, _PLACES), length)
    columns = line[:, WIDTH:LIMIT].T
    width, height, lean = (np.interp(places, line[:, DISTANCE], values) for values in columns)
    narrowest = int(np.argmin(width))
    lane_width = float(width[narrowest])
    if lane_width < MIN_WIDTH:
        raise RoadError(
            f"its lane is {lane_width:.2f} m wide at {places[narrowest]:.0f} m: at least"
            f" {MIN_WIDTH:g} m are needed; choose another lane, or a part of the road"
        )
    wider = width - lane_width if np.ptp(width) > SAME_WIDTH else np.zeros_like(width)
    shapes = (
        ("superelevation", lean, SLOPE_ERROR),
        ("grade", np.gradient(height, places), SLOPE_ERROR),
        ("widening", wider, WIDTH_ERROR),
    )
    profiles: dict[str, Any] = {
        name: profile.simplified(np.column_stack([places, values]), error)
        for name, values, error in shapes
        if np.abs(values).max() > error
    }
    if line[1:, LIMIT].any():
        steps = np.column_stack([line[:-1, DISTANCE], line[1:, LIMIT]])
        profiles[profile.LIMITS] = profile.merged(steps)
    return replace(_flat(line, lane_width), **profiles)


def _flat(line: FloatArray, lane_width: float) -> Road:
    """The flat road along a traced line.

    Raises:
        RoadError: no road stays within `TOLERANCE` of it.
    """
    length = float(line[-1, DISTANCE])
    start = Pose(*(float(v) for v in line[0, X : HEADING + 1]))
    drawn = line[:, X:HEADING] - line[:, MOVED_X:WIDTH]  # as the file has it
    nearest, where = math.inf, 0.0
    for spacing in STEPS:
        samples = min(max(2, math.ceil(length / spacing - 1e-9)), MAX_SAMPLES - 1) + 1
        step = length / (samples - 1)
        at = np.arange(samples) * step
        x, y, heading = (np.interp(at, line[:, DISTANCE], line[:, k]) for k in (X, Y, HEADING))
        # The mean curvature around each sample: where the curvature jumps, its value at the sample
        # says little.
        low, high = np.maximum(at - 0.5 * step, 0.0), np.minimum(at + 0.5 * step, length)
        turned = np.interp(high, line[:, DISTANCE], line[:, HEADING])
        turned -= np.interp(low, line[:, DISTANCE], line[:, HEADING])
        curvatures = follow_line(
            np.column_stack([x, y, heading, turned / (high - low)]),
            step,
            max(CORRECTION, 4.0 * step),
        )
        if np.abs(curvatures).max() > MAX_CURVATURE:
            continue
        road = Road(curvatures, step, start, lane_width=lane_width)
        aside = np.abs(geometry.offsets_near(road.table, road.sub_step, drawn, line[:, DISTANCE]))
        farthest = int(np.argmax(aside))
        if aside[farthest] <= TOLERANCE:
            return road
        if aside[farthest] < nearest:
            nearest, where = float(aside[farthest]), float(line[farthest, DISTANCE])
    if math.isinf(nearest):
        raise RoadError(
            f"no road can follow its line, which bends by more than {MAX_CURVATURE:g} 1/m"
        )
    raise RoadError(
        f"no road can follow its line: the nearest lies {nearest:.4f} m beside it {where:.2f} m"
        f" along, and at most {TOLERANCE:g} m is allowed"
    )


def _noted_road(element: Element) -> Road | None:
    """The road that `to_opendrive` noted, if it still draws it so.

    Raises:
        RoadError: its lane -1 is not for cars.
    """
    if _is_level(_lane_of(_sections(element, "right")[0], -1)):
        return None  # unlike what `to_opendrive` writes
    limits = _limits(element, -1)
    notes = {note.get("code"): note.get("value", "") for note in element.findall("userData")}
    try:
        step, *values = map(float, notes[ROAD_CODE].split())
        pairs = {
            name: [float(value) for value in notes.get(PROFILE_CODE.format(name), "").split()]
            for name in profile.SHAPES
        }
        start, width = (next(element.iter(tag)) for tag in ("geometry", "width"))
        pose = tuple(_number(start, name, most=MAX_HEADING) for name in ("x", "y", "hdg"))
        lane_width = pairs["widening"].pop(0) if pairs["widening"] else _number(width, "a")
        profiles = {name: np.array(one).reshape(-1, 2) for name, one in pairs.items()}
        profiles[profile.LIMITS] = limits
        noted = Road(values, step, Pose(*pose), lane_width=lane_width, **profiles)
    except (KeyError, StopIteration, ValueError, RoadError):
        return None
    return noted if _drawn(add_road(Element("OpenDRIVE"), noted)) == _drawn(element) else None


def _drawn(element: Element) -> list[tuple[str, dict[str, str]]]:
    """All that says where a road's lanes run."""
    return [(one.tag, one.attrib) for one in element.iter() if one.tag in _DRAWN]
