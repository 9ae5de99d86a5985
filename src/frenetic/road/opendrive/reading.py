"""Reading roads of an OpenDRIVE file.

What is read of a road is one lane: its width, its slopes, and its edge on the side of the road's
centre, which becomes the centre line of the road that is returned. Other lanes, road marks, signals
and objects are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.opendrive.line import (
    DIRECTION,
    DISTANCE,
    KINK,
    TOLERANCE,
    Cubic,
    Geometry,
    Polynomial,
    X,
    Y,
    backwards,
    follow,
    join,
    shifted,
    trace,
)
from frenetic.road.opendrive.writing import (
    PROFILE_CODE,
    ROAD_CODE,
    Clothoid,
    clothoids,
    elevations,
    superelevations,
    widths,
)
from frenetic.road.road import (
    MAX_COORDINATE,
    MAX_CURVATURE,
    MAX_HEADING,
    MAX_LENGTH,
    MIN_DISTANCE,
    Pose,
    Road,
)

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
MAX_NUMBER: Final = MAX_COORDINATE
"""Largest number in a file, in m or its own unit, unless another limit is given."""
SPACING: Final = 1.0
"""Distance between the places at which slopes and widths are read, in m."""
SLOPE_ERROR: Final = 1e-4
"""Largest error of a slope that is read, in m/m."""
WIDTH_ERROR: Final = 1e-3
"""Largest error of a width that is read, in m."""

_DRIVEN: Final = frozenset(
    [
        *("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane"),
        *("mwyEntry", "mwyExit", "bidirectional", "restricted", "bus", "taxi", "HOV"),
    ]
)
"""Types of lanes that a user may choose."""
_LISTED: Final = 8  # roads in a message
_SAME: Final = 1e-8  # m, rad and 1/m by which a geometry may differ from what we would write


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
        width bit for bit. Any other is at most 1 cm away from the line in the file (see
        `frenetic.road.opendrive.line`), its slopes within 0.01 % and its width within 1 mm.

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
        noted = _noted_road(element, lane)
        return _road_along(_lane_line(element, lane)) if noted is None else noted

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
        found: list[tuple[list[str], str, _LaneLine]] = []
        for given in roads.split(","):
            road_id, _, start = given.strip().partition("@")
            element = self._element(road_id)
            onward = _continuation(element, found[-1][2]) if found and not start else None
            if onward is None:
                first = _first_lane(element) if lane is None else lane
                found.append(([road_id], start, _lane_line(element, first)))
            else:
                ids, start, line = found[-1]
                found[-1] = [*ids, road_id], start, line.joined(onward)
        stretches = []
        for ids, start, line in found:
            skipped = _station(start, line.length) if start else 0.0
            stretches.append(Stretch(tuple(ids), skipped, _road_along(line.after(skipped))))
        return stretches

    def _element(self, road_id: str | None) -> Element:
        """The element of a road.

        Raises:
            RoadError: there is none of that id, or none is given and there are several.
        """
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


@dataclass(frozen=True)
class _LaneLine:
    """The inner edge of a lane in the direction of travel, and what is along it."""

    line: FloatArray
    """(n, 4) points: m along, x, y, heading."""
    along: FloatArray
    """(n, 3) width of the lane in m, height in m, slope to the right in m/m."""

    @property
    def length(self) -> float:
        return float(self.line[-1, DISTANCE])

    def after(self, start: float) -> _LaneLine:
        """The part behind ``start`` m."""
        first = int(np.searchsorted(self.line[:, DISTANCE], start - 1e-9))
        line = self.line[first:].copy()
        line[:, DISTANCE] -= line[0, DISTANCE]
        return _LaneLine(line, self.along[first:])

    def joined(self, onward: _LaneLine) -> _LaneLine:
        """It and one that starts where it ends."""
        line = onward.line.copy()
        join(self.line[-1], line)
        return _LaneLine(
            np.concatenate([self.line, line[1:]]), np.concatenate([self.along, onward.along[1:]])
        )


def _lane_line(road: Element, lane: int) -> _LaneLine:
    """The line of a lane.

    Raises:
        RoadError: there is no such lane, or the road is none that is read.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    line = trace(_geometries(road))
    places = line[:, DISTANCE]
    width, shift, slope = _lane(road, lane, places)
    for kind in ("crossfall", "shape"):
        shapes = (_cubic(one) for one in road.findall(f"lateralProfile/{kind}"))
        if any(abs(value) > LEVEL for shape in shapes for value in shape):
            raise RoadError(f"its road is shaped across ({kind}): only superelevation is read")
    height, _ = _profile(road.findall("elevationProfile/elevation"), "s", places)
    high = np.flatnonzero(np.abs(np.diff(height)) > JUMP)
    if len(high):
        raise RoadError(f"its road jumps in height {places[high[0]]:.2f} m along the road")
    lean, _ = _profile(road.findall("lateralProfile/superelevation"), "s", places)
    lean = np.tan(np.clip(lean, -1.5, 1.5))
    along = np.column_stack([width, height + shift * lean, lean])
    if np.abs(shift).max() > MIN_DISTANCE:
        line = shifted(line, shift, slope)
    if lane > 0:
        line, along = backwards(line), along[::-1] * (1.0, 1.0, -1.0)
    return _LaneLine(line, along)


def _continuation(road: Element, before: _LaneLine) -> _LaneLine | None:
    """The lane of a road that begins where a lane ends; None if there is none."""
    for section, side in ((0, "right"), (-1, "left")):
        sections = road.findall("lanes/laneSection")
        for element in sections[section].findall(f"{side}/lane") if sections else ():
            try:
                line = _lane_line(road, int(_number(element, "id")))
            except RoadError:
                continue
            gap = np.hypot(*(line.line[0, X : Y + 1] - before.line[-1, X : Y + 1]))
            turn = math.remainder(line.line[0, DIRECTION] - before.line[-1, DIRECTION], math.tau)
            if gap <= TOLERANCE and abs(turn) <= KINK:
                return line
    return None


def _station(text: str, length: float) -> float:
    """The m along its roads at which a stretch begins.

    Raises:
        RoadError: it is none.
    """
    try:
        start = float(text)
    except ValueError:
        start = math.nan
    if not 0.0 <= start < length - SPACING:
        raise RoadError(f"@{text[:40]} is no place on a stretch of {length:.0f} m")
    return start


def _road_along(lane: _LaneLine) -> Road:
    """The road of a lane's line.

    Raises:
        RoadError: its lane is too narrow, or no road stays near it.
    """
    places = np.append(np.arange(0.0, lane.length, SPACING), lane.length)
    width, height, lean = (np.interp(places, lane.line[:, DISTANCE], v) for v in lane.along.T)
    narrowest = int(np.argmin(width))
    lane_width = float(width[narrowest])
    if lane_width < MIN_WIDTH:
        raise RoadError(
            f"its lane is {lane_width:.2f} m wide at {places[narrowest]:.0f} m: at least"
            f" {MIN_WIDTH:g} m are needed; choose another lane, or a part of the road"
        )
    wider = width - lane_width if np.ptp(width) > SAME_WIDTH else np.zeros_like(width)
    columns = (
        ("superelevation", lean, SLOPE_ERROR),
        ("grade", np.gradient(height, places), SLOPE_ERROR),
        ("widening", wider, WIDTH_ERROR),
    )
    profiles: dict[str, Any] = {
        name: profile.simplified(np.column_stack([places, values]), error)
        for name, values, error in columns
        if np.abs(values).max() > error
    }
    return replace(follow(lane.line, lane_width), **profiles)


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
    element: Element, name: str, default: float | None = None, *, most: float = MAX_NUMBER
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


def _cubic(element: Element, suffix: str = "") -> Cubic:
    """The coefficients of a polynomial; missing ones are 0."""
    a, b, c, d = (_number(element, name + suffix, 0.0) for name in "abcd")
    return a, b, c, d


def _profile(
    elements: Sequence[Element], name: str, places: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values (n,) and slopes (n,) of piecewise cubics at places (n,) in m along the road.

    Each element's cubic holds from its ``name`` on, in m; before the first all is 0.
    """
    elements = sorted(elements, key=lambda element: _number(element, name))
    starts = np.array([0.0, *(_number(element, name) for element in elements)])
    cubics = np.array([(0.0, 0.0, 0.0, 0.0), *map(_cubic, elements)])
    rows = np.searchsorted(starts[1:], places, side="right")
    p = places - starts[rows]
    a, b, c, d = cubics[rows].T
    return a + p * (b + p * (c + p * d)), b + p * (2.0 * c + p * 3.0 * d)


def _lane(
    road: Element, lane: int, places: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Width of a lane at places (n,) in m along the road, shift of its inner edge, slope of that.

    The shift, in m to the left of the reference line, is the lane offset and the widths of the
    lanes in between. From section to section the lane's own links are followed; where it has none,
    its id stays.
    """
    sections = road.findall("lanes/laneSection")
    if not sections:
        raise RoadError("its road has no lanes")
    side, onward = (1, "predecessor") if lane > 0 else (-1, "successor")
    starts = [_number(section, "s") for section in sections]
    spans = list(zip(sections, starts, [*starts[1:], math.inf], strict=True))
    shift, slope = _profile(road.findall("lanes/laneOffset"), "s", places)
    width = np.zeros_like(places)
    link: Element | None = None
    for section, start, end in spans if lane < 0 else reversed(spans):
        if link is not None:
            lane = int(_number(link, "id"))
            if lane * side <= 0:
                raise RoadError(f"a lane leads to lane {lane}, which is driven the other way")
        element = _lane_of(section, lane)
        link = element.find(f"link/{onward}")
        here = (start <= places) & (places < end)
        width[here], _ = _width(element, places[here] - start)
        for inner in range(1, abs(lane)):
            between = _lane_of(section, side * inner, is_driven=False)
            widths, slopes = _width(between, places[here] - start)
            shift[here] += side * widths
            slope[here] += side * slopes
    return width, shift, slope


def _width(lane: Element, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Width of a lane at places (n,) in m along its section, and its slope."""
    elements = lane.findall("width")
    if not elements:
        raise RoadError(
            f"its lane {lane.get('id')} has no width (borders instead of widths are not read)"
        )
    return _profile(elements, "sOffset", places)


def _first_lane(road: Element) -> int:
    """Id of the driving lane nearest to the centre, where it is entered; on the right if possible.

    Raises:
        RoadError: there is none.
    """
    sections = road.findall("lanes/laneSection")
    if not sections:
        raise RoadError("its road has no lanes")
    kinds: tuple[frozenset[str], ...] = (frozenset(["driving"]), _DRIVEN)
    for driven in kinds:
        for section, side in ((sections[0], "right"), (sections[-1], "left")):
            ids = [
                int(_number(lane, "id"))
                for lane in section.findall(f"{side}/lane")
                if lane.get("type") in driven and lane.get("direction", "standard") == "standard"
            ]
            if ids:
                return min(ids, key=abs)
    raise RoadError("its road has no driving lane")


def _lane_of(section: Element, lane: int, *, is_driven: bool = True) -> Element:
    """A section's lane with an id, which is for cars and right-hand traffic if it is driven.

    Raises:
        RoadError: there is none; the message lists the driving lanes.
    """
    side = "right" if lane < 0 else "left"
    element = section.find(f"{side}/lane[@id='{lane}']")
    if element is None:
        what = "is missing"
    elif is_driven and element.get("type") not in _DRIVEN:
        what = f"is of type {element.get('type')!r:.40}: a driving lane is needed there"
    elif is_driven and element.get("direction", "standard") != "standard":
        what = "is driven against the road's rule (direction)"
    else:
        return element
    lanes = [*section.findall("right/lane"), *section.findall("left/lane")]
    ids = [other.get("id", "")[:9] for other in lanes if other.get("type") == "driving"]
    text = f"its lane {lane}, {side} of the centre, {what}"
    if not ids:
        raise RoadError(text)
    raise RoadError(f"{text} (driving lanes, to be chosen as 'lane': {', '.join(ids[:8])})")


def _noted_road(road: Element, lane: int) -> Road | None:
    """The road that `to_opendrive` noted, if what is drawn is still that."""
    geometries = _geometries(road)
    drawn = [geometry for geometry in geometries if isinstance(geometry, Clothoid)]
    sections = road.findall("lanes/laneSection")
    if lane != -1 or len(sections) != 1 or len(drawn) < len(geometries):
        return None
    _lane_of(sections[0], lane)
    widths_drawn = road.findall("lanes/laneSection/right/lane[@id='-1']/width")
    try:
        step, *values = _noted(road, ROAD_CODE)
        pairs = {name: _noted(road, PROFILE_CODE.format(name)) for name in profile.NAMES}
        widening = pairs["widening"]
        lane_width = widening.pop(0) if widening else _cubic(widths_drawn[0])[0]
        profiles = {name: np.array(one).reshape(-1, 2) for name, one in pairs.items()}
        noted = Road(values, step, Pose(*drawn[0][:3]), lane_width=lane_width, **profiles)
    except (IndexError, ValueError, RoadError):
        return None
    elevation = road.findall("elevationProfile/elevation")
    leaning = road.findall("lateralProfile/superelevation")
    shapes: tuple[tuple[Sequence[Sequence[float]], Sequence[Sequence[float]]], ...] = (
        (clothoids(noted), drawn),
        (elevations(noted), _cubics(elevation, "s")),
        (superelevations(noted), _cubics(leaning, "s")),
        (widths(noted), _cubics(widths_drawn, "sOffset")),
        ([(0.0,) * 5], _cubics(road.findall("lanes/laneOffset"), "s")),
    )
    same = all(
        len(ours) == len(theirs) and np.allclose(ours, theirs, rtol=0.0, atol=_SAME)
        for ours, theirs in shapes
    )
    return noted if same else None


def _noted(road: Element, code: str) -> list[float]:
    """The numbers of a note; none if there is no such note."""
    note = road.find(f"userData[@code='{code}']")
    return [] if note is None else [float(value) for value in note.get("value", "").split()]


def _cubics(elements: Sequence[Element], start: str) -> list[tuple[float, ...]]:
    return [(_number(one, start), *_cubic(one)) for one in elements]


def _geometries(road: Element) -> list[Geometry]:
    """The geometries of the reference line that have a length, in their order."""
    geometries: list[Geometry] = []
    total = 0.0
    for element in road.findall("planView/geometry"):
        length = _number(element, "length", most=math.inf)
        if length < 0.0:
            raise RoadError(f"a <geometry> has length {length:g}: a positive number is needed")
        total += length
        if total > MAX_LENGTH:
            raise RoadError(f"its road is longer than the {MAX_LENGTH:.0f} m that can be read")
        if length > MIN_DISTANCE:
            geometries.append(_geometry(element, length))
    if not geometries:
        raise RoadError("its road has no geometry")
    return geometries


def _geometry(element: Element, length: float) -> Geometry:
    pose = Pose(
        _number(element, "x"), _number(element, "y"), _number(element, "hdg", most=MAX_HEADING)
    )
    shape = next(iter(element), element)
    if shape.tag == "line":
        return Clothoid(*pose, length, 0.0, 0.0)
    if shape.tag == "arc":
        curvature = _number(shape, "curvature", most=MAX_CURVATURE)
        return Clothoid(*pose, length, curvature, curvature)
    if shape.tag == "spiral":
        start, end = (_number(shape, name, most=MAX_CURVATURE) for name in ("curvStart", "curvEnd"))
        return Clothoid(*pose, length, start, end)
    if shape.tag == "paramPoly3":
        last = length if shape.get("pRange") == "arcLength" else 1.0
        return Polynomial(pose, length, _cubic(shape, "U"), _cubic(shape, "V"), last)
    raise RoadError(
        f"a <geometry> holds {'nothing' if shape is element else shape.tag[:40]}: line, arc,"
        " spiral and paramPoly3 are read"
    )
