"""Reading an OpenDRIVE file that holds a single road.

What is read is one lane, by default lane -1, the innermost one on the right: its width, and its
edge on the side of the road's centre, which becomes the centre line of the road that is returned.
Other lanes, road marks, signals and objects are left out. Anything that would make another road (a
junction, a slope, a lane of changing width) is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.opendrive.line import (
    SPACING,
    Cubic,
    Geometry,
    Polynomial,
    backwards,
    follow,
    shifted,
    trace,
)
from frenetic.road.opendrive.writing import ROAD_CODE, Clothoid, clothoids
from frenetic.road.road import (
    MAX_COORDINATE,
    MAX_CURVATURE,
    MAX_HEADING,
    MAX_LENGTH,
    MIN_DISTANCE,
    Pose,
    Road,
)

FLAT: Final = 0.01
"""Largest rise or fall of a flat road, and largest change of a lane's width, in m."""
LEVEL: Final = 1e-3
"""Largest lean of a level road to a side, in rad."""
MAX_ELEMENTS: Final = 200_000
"""Most elements of a file; a road has two per geometry."""
MAX_NUMBER: Final = MAX_COORDINATE
"""Largest number in a file, in m or its own unit, unless another limit is given."""

_SAME: Final = 1e-8  # m, rad and 1/m by which a geometry may differ from what we would write


def from_opendrive(data: bytes, *, lane: int = -1) -> Road:
    """The road in an OpenDRIVE file.

    A file that `to_opendrive` wrote gives the same road: curvatures, step, pose and lane width bit
    for bit. Of any other file, the road is at most 1 cm away from the line in it; see
    `frenetic.road.opendrive.line`.

    Args:
        data: the file's content.
        lane: id of the lane that becomes the ego lane, where its drive begins. One on the left (a
            positive id) is driven against the road, from its end to its start.

    Raises:
        RoadError: it is no such file, or the road in it has something that a `Road` has not; the
            message does not name the file.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    road = _single_road(_parse(data))
    geometries = _geometries(road)
    length = sum(geometry.length for geometry in geometries)
    places = np.linspace(0.0, length, max(2, math.ceil(length / SPACING)) + 1)
    _require_flat(road, places)
    width, shift, _ = _lane(road, lane, places)
    if not np.ptp(width) <= FLAT:
        raise RoadError(
            f"its lane {lane} is {width.min():.3g} to {width.max():.3g} m wide: only a lane of"
            " constant width is read"
        )
    lane_width = float(width[0])
    is_shifted = np.abs(shift).max() > MIN_DISTANCE
    if lane < 0 and not is_shifted:
        noted = _noted_road(road, geometries, lane_width)
        if noted is not None:
            return noted
    line = trace(geometries)
    if is_shifted:
        _, shift, slope = _lane(road, lane, line[:, 0])
        line = shifted(line, shift, slope)
    return follow(backwards(line) if lane > 0 else line, lane_width)


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
                f"it has more than {MAX_ELEMENTS} elements: no file of a single road is that large"
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


def _single_road(root: Element) -> Element:
    if root.tag != "OpenDRIVE":
        raise RoadError(f"it is XML, but no OpenDRIVE: its root is <{root.tag:.40}>")
    header = root.find("header")
    major = None if header is None else header.get("revMajor")
    if major != "1":
        raise RoadError(f"its header says revMajor {major!r:.40}, but only OpenDRIVE 1.x is read")
    roads = root.findall("road")
    if len(roads) != 1 or root.find("junction") is not None:
        raise RoadError(
            f"it has {len(roads)} roads and {len(root.findall('junction'))} junctions: a file with"
            " a single road is read"
        )
    (road,) = roads
    if road.get("rule", "RHT") != "RHT":
        raise RoadError(
            f"its rule is {road.get('rule')!r:.40}: only right-hand traffic (RHT) is read"
        )
    return road


def _require_flat(road: Element, places: FloatArray) -> None:
    height, _ = _profile(road.findall("elevationProfile/elevation"), "s", places)
    if np.ptp(height) > FLAT:
        raise RoadError("its road rises or falls (elevation): only a flat road is read")
    for kind in ("superelevation", "crossfall"):
        lean, _ = _profile(road.findall(f"lateralProfile/{kind}"), "s", places)
        if np.abs(lean).max() > LEVEL:
            raise RoadError(f"its road leans to a side ({kind}): only a level road is read")
    if any(any(_cubic(shape)) for shape in road.findall("lateralProfile/shape")):
        raise RoadError("its road is not level across (shape): only a level road is read")


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


def _lane_of(section: Element, lane: int, *, is_driven: bool = True) -> Element:
    """A section's lane with an id, which is a driving lane for right-hand traffic if it is driven.

    Raises:
        RoadError: there is none; the message lists the driving lanes.
    """
    side = "right" if lane < 0 else "left"
    element = section.find(f"{side}/lane[@id='{lane}']")
    if element is None:
        what = "is missing"
    elif is_driven and element.get("type") != "driving":
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


def _noted_road(road: Element, geometries: Sequence[Geometry], lane_width: float) -> Road | None:
    """The road that `to_opendrive` noted, if the geometries are still those of it."""
    note = road.find(f"userData[@code='{ROAD_CODE}']")
    drawn = [geometry for geometry in geometries if isinstance(geometry, Clothoid)]
    if note is None or len(drawn) < len(geometries):
        return None
    try:
        step, *values = map(float, note.get("value", "").split())
        noted = Road(values, step, Pose(*drawn[0][:3]), lane_width=lane_width)
    except (ValueError, RoadError):
        return None
    ours = clothoids(noted)
    same = len(ours) == len(drawn) and np.allclose(ours, drawn, rtol=0.0, atol=_SAME)
    return noted if same else None


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
