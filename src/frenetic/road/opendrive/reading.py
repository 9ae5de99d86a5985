"""Reading roads of an OpenDRIVE file.

What is read of a road is one lane: its width, its slopes, and its edge on the side of the road's
centre, which becomes the centre line of the road that is returned. Other lanes, road marks, signals
and objects are left out.

A file's geometries have any lengths, and its curvature may jump between them; a road has one step
and a curvature that is linear in between. So the edge is traced every few centimetres and followed
by a road with a sample every half metre or denser, which is refused if it is more than `TOLERANCE`
away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.geometry import build_table, sub_steps
from frenetic.road.opendrive.writing import PROFILE_CODE, ROAD_CODE, add_road
from frenetic.road.recovery import CORRECTION, follow_line
from frenetic.road.road import (
    MAX_COORDINATE,
    MAX_CURVATURE,
    MAX_HEADING,
    MAX_LENGTH,
    MAX_SAMPLES,
    MAX_SPEED_LIMIT,
    MIN_DISTANCE,
    Pose,
    Road,
)

TOLERANCE: Final = 0.01
"""Largest distance of a road from the line in its file, and largest gap in that line, in m."""
KINK: Final = 0.01
"""Largest change of heading from the end of one geometry to the start of the next, in rad."""
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
_UNITS: Final = {"km/h": 1.0, "mph": 1.609344, "m/s": 3.6}
"""Unit of a speed -> km/h; OpenDRIVE's own is m/s."""
_NO_LIMIT: Final = ("", "no limit", "undefined")
"""Texts in place of a speed."""
_LISTED: Final = 8  # roads or lanes in a message
_PLACES: Final = 1.0  # m between the places at which slopes and widths are read
_SLOPE_ERROR, _WIDTH_ERROR = 1e-4, 1e-3  # m/m and m

# Columns of a traced line, one row per point.
DISTANCE, X, Y, HEADING, WIDTH, HEIGHT, LEAN, LIMIT = range(8)
# The limit is that of the way from the row before.


@dataclass(frozen=True)
class Stretch:
    """A stretch of a map's roads, one after the other."""

    ids: tuple[str, ...]
    """Of the roads."""
    start: float
    """m along the first road, or beyond it, at which the stretch begins."""
    road: Road

    @property
    def name(self) -> str:
        """The text for `RoadMap.stretches` that gives it."""
        return self.behind(0.0)

    def behind(self, place: float) -> str:
        """The text of what is left behind a place in m along it, from the next whole metre on."""
        start = math.ceil(self.start + place - 1e-9)
        first, *others = self.ids
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
        self._roads = {road.get("id", "")[:40]: road for road in root.findall("road")}
        if not self._roads:
            raise RoadError("it has no road")

    @property
    def lengths(self) -> dict[str, float]:
        """Id of each road that is not within a junction -> its length in m, the longest first."""
        lengths = {
            road_id: _number(road, "length", 0.0, most=math.inf)
            for road_id, road in self._roads.items()
            if road.get("junction", "-1") == "-1"
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
        lane = _first_lane(element) if lane is None else lane
        noted = _noted_road(element) if lane == -1 else None
        return _followed(_lane_line(element, lane)) if noted is None else noted

    def stretches(self, roads: str, *, lane: int | None = None) -> list[Stretch]:
        """Stretches of it, where they lie.

        Args:
            roads: ids of roads with commas. A road that starts where the one before ends continues
                that; another one begins a stretch of its own. ``12@240`` begins 240 m along the
                stretch that road 12 begins.
            lane: of the first road of each stretch, as for `road`. Another road continues it with
                the lane that begins where the lane before ends.

        Raises:
            RoadError: as for `road`, or a stretch is not as long.
        """
        found: list[tuple[list[str], str, FloatArray]] = []
        for given in roads.split(","):
            road_id, _, start = given.strip().partition("@")
            element = self._element(road_id)
            onward = _continuation(element, found[-1][2]) if found and not start else None
            if onward is None:
                first = _first_lane(element) if lane is None else lane
                found.append(([road_id], start, _lane_line(element, first)))
            else:
                ids, start, line = found[-1]
                found[-1] = [*ids, road_id], start, _joined([line, onward])
        stretches = []
        for ids, start, line in found:
            skipped = _station(start, line[-1, DISTANCE]) if start else 0.0
            rest = line[np.searchsorted(line[:, DISTANCE], skipped - 1e-9) :].copy()
            rest[:, DISTANCE] -= rest[0, DISTANCE]
            stretches.append(Stretch(tuple(ids), skipped, _followed(rest)))
        return stretches

    def _element(self, road_id: str | None) -> Element:
        road = next(iter(self._roads.values())) if road_id is None else self._roads.get(road_id)
        if road is None or (road_id is None and len(self._roads) > 1):
            longest = list(self.lengths.items())[:_LISTED]
            listed = ", ".join(f"{name} ({length:.0f} m)" for name, length in longest)
            listed += ", .." if len(self._roads) > len(longest) else ""
            if road_id is None:
                count = len(self._roads)
                raise RoadError(f"it has {count} roads, to be chosen as 'road': {listed}")
            raise RoadError(f"it has no road {road_id!r:.40}, but {listed}")
        if road.get("rule", "RHT") != "RHT":
            raise RoadError(
                f"its rule is {road.get('rule')!r:.40}: only right-hand traffic (RHT) is read"
            )
        return road


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
    """(n, 4) points of a road's reference line: the first columns of a traced line.

    Raises:
        RoadError: there is a gap or a kink between two geometries, or one cannot be read.
    """
    parts = []
    total = 0.0
    for element in road.findall("planView/geometry"):
        length = _number(element, "length", most=math.inf)
        if length < 0.0:
            raise RoadError(f"a <geometry> has length {length:g}: a positive number is needed")
        total += length
        if total > MAX_LENGTH:
            raise RoadError(f"its road is longer than the {MAX_LENGTH:.0f} m that can be read")
        if length > MIN_DISTANCE:
            parts.append(_traced(element, length))
    if not parts:
        raise RoadError("its road has no geometry")
    return _joined(parts)


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
    pieces = max(sub_steps(curvatures, length), math.ceil(length / SPACING))
    table = build_table(curvatures, length, x, y, heading, pieces)
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


def _joined(parts: Sequence[FloatArray]) -> FloatArray:
    """Lines one after the other; distances and headings go on.

    Raises:
        RoadError: one does not begin where the one before ends.
    """
    parts = [parts[0], *(part.copy() for part in parts[1:])]
    for before, part in pairwise(parts):
        end, place = before[-1], f"{before[-1, DISTANCE]:.2f} m along the road"
        gap, turn = _apart(end, part[0])
        if gap > TOLERANCE:
            raise RoadError(
                f"the reference line jumps by {gap:.3f} m {place}: at most {TOLERANCE:g} m is"
                " mended"
            )
        if abs(turn) > KINK:
            raise RoadError(
                f"the reference line has a kink of {math.degrees(turn):.1f} degrees {place}: a"
                " road has none"
            )
        part[:, DISTANCE] += end[DISTANCE]
        part[:, HEADING] += turn - (part[0, HEADING] - end[HEADING])
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def _apart(end: FloatArray, start: FloatArray) -> tuple[float, float]:
    """The gap between two points in m, and the change of heading in rad."""
    turn = math.remainder(start[HEADING] - end[HEADING], math.tau)
    return math.hypot(start[X] - end[X], start[Y] - end[Y]), turn


# Lanes


def _lane_line(road: Element, lane: int) -> FloatArray:
    """(n, 8) the inner edge of a lane in the direction of travel, and what is along it.

    Raises:
        RoadError: there is no such lane, or the road is none that is read.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    line = _reference_line(road)
    places = line[:, DISTANCE].copy()
    width, shift, slope = _lane(road, lane, places)
    for kind in ("crossfall", "shape"):
        if any(np.abs(_cubic(one)).max() > LEVEL for one in road.findall(f"lateralProfile/{kind}")):
            raise RoadError(f"its road is shaped across ({kind}): only superelevation is read")
    height, _ = _profile(road.findall("elevationProfile/elevation"), "s", places)
    high = np.flatnonzero(np.abs(np.diff(height)) > JUMP)
    if len(high):
        raise RoadError(f"its road jumps in height {places[high[0]]:.2f} m along the road")
    lean, _ = _profile(road.findall("lateralProfile/superelevation"), "s", places)
    lean = np.tan(np.clip(lean, -1.5, 1.5))
    if np.abs(shift).max() > MIN_DISTANCE:
        heading = line[:, HEADING].copy()
        ahead = 1.0 - shift * np.gradient(heading, places)
        if ahead.min() <= 0.0:
            raise RoadError("its lanes are shifted beyond the centre of a bend, where no road is")
        line[:, X] -= shift * np.sin(heading)
        line[:, Y] += shift * np.cos(heading)
        line[:, HEADING] += np.arctan2(slope, ahead)
        line[1:, DISTANCE] = np.cumsum(np.hypot(np.diff(line[:, X]), np.diff(line[:, Y])))
    limit = profile.steps_at(_limits(road, lane), places - 0.5 * np.diff(places, prepend=0.0))
    line = np.column_stack([line, width, height + shift * lean, lean, limit])
    if lane > 0:
        line = line[::-1].copy()
        line[:, DISTANCE] = line[0, DISTANCE] - line[:, DISTANCE]
        line[:, HEADING] += math.pi
        line[:, LEAN] *= -1.0
        line[1:, LIMIT] = line[:-1, LIMIT]
    return line


def _lane(
    road: Element, lane: int, places: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Width of a lane at places (n,) in m along the road, shift of its inner edge, slope of that.

    The shift, in m to the left of the reference line, is the lane offset and the widths of the
    lanes in between.
    """
    side = 1 if lane > 0 else -1
    shift, slope = _profile(road.findall("lanes/laneOffset"), "s", places)
    width = np.zeros_like(places)
    for section, element, start, end in _along(road, lane):
        here = (start <= places) & (places < end)
        width[here], _ = _width(element, places[here] - start)
        for inner in range(1, abs(int(_number(element, "id")))):
            between = _lane_of(section, side * inner, is_driven=False)
            widths, slopes = _width(between, places[here] - start)
            shift[here] += side * widths
            slope[here] += side * slopes
    return width, shift, slope


def _along(road: Element, lane: int) -> Iterator[tuple[Element, Element, float, float]]:
    """Each section with its lane that a lane leads to, and where it begins and ends, in m.

    From section to section the lane's own links are followed; where it has none, its id stays.

    Raises:
        RoadError: a section has no such lane.
    """
    sections = _sections(road)
    side, onward = (1, "predecessor") if lane > 0 else (-1, "successor")
    starts = [_number(section, "s") for section in sections]
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
    said = [(_number(one, "s", 0.0), _limit(one.find("speed"))) for one in types]
    of_road = np.array(said or [(0.0, 0.0)])
    steps: dict[float, float] = {}
    for _, element, start, end in _along(road, lane):
        speeds = sorted(element.findall("speed"), key=lambda one: _number(one, "sOffset", 0.0))
        places = [(start + _number(one, "sOffset", 0.0), _limit(one)) for one in speeds]
        of_lane = np.array([(start, 0.0), *places])
        stations = {start, *of_lane[:, 0].tolist(), *of_road[:, 0].tolist()}
        for station in sorted(place for place in stations if start <= place < end):
            own = float(profile.steps_at(of_lane, station))
            steps[station] = own or float(profile.steps_at(of_road, station))
    return profile.merged(np.array(sorted(steps.items())))


def _limit(speed: Element | None) -> float:
    """The limit that a ``speed`` says, in km/h; 0 for none.

    Raises:
        RoadError: it is in another unit, or no speed.
    """
    if speed is None or speed.get("max", "") in _NO_LIMIT:
        return 0.0
    unit = speed.get("unit", "m/s")
    if unit not in _UNITS:
        raise RoadError(f"a <speed> has unit={unit[:40]!r}: {', '.join(_UNITS)} are known")
    limit = _UNITS[unit] * _number(speed, "max", most=MAX_SPEED_LIMIT)
    if not 0.0 <= limit <= MAX_SPEED_LIMIT:
        raise RoadError(
            f"a <speed> has max={speed.get('max')!r:.40}: 0 to {MAX_SPEED_LIMIT:g} km/h are needed"
        )
    return limit


def _width(lane: Element, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Width of a lane at places (n,) in m along its section, and its slope."""
    elements = lane.findall("width")
    if not elements:
        raise RoadError(
            f"its lane {lane.get('id')} has no width (borders instead of widths are not read)"
        )
    return _profile(elements, "sOffset", places)


def _sections(road: Element) -> list[Element]:
    sections = road.findall("lanes/laneSection")
    if not sections:
        raise RoadError("its road has no lanes")
    return sections


def _entered(road: Element) -> list[Element]:
    """The lanes where they are entered: those on the right, then those on the left."""
    sections = _sections(road)
    return [*sections[0].findall("right/lane"), *sections[-1].findall("left/lane")]


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
        raise RoadError("its road has no driving lane")
    return min(lanes, key=lambda lane: (lane[0], lane[1] > 0, abs(lane[1])))[1]


def _continuation(road: Element, before: FloatArray) -> FloatArray | None:
    """The lane of a road that begins where a lane ends; None if there is none."""
    for lane in _entered(road):
        try:
            line = _lane_line(road, int(_number(lane, "id")))
        except RoadError:
            continue
        gap, turn = _apart(before[-1], line[0])
        if gap <= TOLERANCE and abs(turn) <= KINK:
            return line
    return None


def _is_driven(lane: Element) -> bool:
    return lane.get("type") in _DRIVEN and lane.get("direction", "standard") == "standard"


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
    """The road along a lane's line (n, 8).

    Raises:
        RoadError: its lane is too narrow, or no road stays near it.
    """
    length = float(line[-1, DISTANCE])
    places = np.append(np.arange(0.0, length, _PLACES), length)
    columns = line[:, WIDTH:LIMIT].T
    width, height, lean = (np.interp(places, line[:, DISTANCE], v) for v in columns)
    narrowest = int(np.argmin(width))
    lane_width = float(width[narrowest])
    if lane_width < MIN_WIDTH:
        raise RoadError(
            f"its lane is {lane_width:.2f} m wide at {places[narrowest]:.0f} m: at least"
            f" {MIN_WIDTH:g} m are needed; choose another lane, or a part of the road"
        )
    wider = width - lane_width if np.ptp(width) > SAME_WIDTH else np.zeros_like(width)
    shapes = (
        ("superelevation", lean, _SLOPE_ERROR),
        ("grade", np.gradient(height, places), _SLOPE_ERROR),
        ("widening", wider, _WIDTH_ERROR),
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
    away = math.inf
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
        away = float(np.hypot(road.points[:, 0] - x, road.points[:, 1] - y).max())
        if away <= TOLERANCE:
            return road
    raise RoadError(
        f"no road can follow its line: the nearest is {away:.3g} m away somewhere, and at most"
        f" {TOLERANCE:g} m are allowed"
    )


def _noted_road(element: Element) -> Road | None:
    """The road that `to_opendrive` noted, if it still draws it so.

    Raises:
        RoadError: its lane -1 is not for cars.
    """
    _lane_of(_sections(element)[0], -1)
    notes = {note.get("code"): note.get("value", "") for note in element.findall("userData")}
    limits = _limits(element, -1)
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
