"""Reading an OpenDRIVE file that holds a single road, or a chain of roads that are linked.

What is read is one lane, by default lane -1, the innermost one on the right: its width, and its
edge on the side of the road's centre, which becomes the centre line of the road that is returned.
Other lanes, road marks, signals and objects are left out. Anything that would make another road (a
junction, a slope, a lane of changing width) is refused.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from frenetic.errors import RoadError
from frenetic.road.opendrive.chain import (
    Stretch,
    driven_stretches,
    driving_lane,
    lane_ids,
    lane_of,
    sections_of,
)
from frenetic.road.opendrive.elements import MAX_NUMBER, number, parse_xml
from frenetic.road.opendrive.line import (
    Clothoid,
    Cubic,
    Geometry,
    Offset,
    Polynomial,
    are_of_road,
    backwards,
    exact_road,
    follow,
    joined,
    stacked,
    trace,
)
from frenetic.road.opendrive.writing import CURVATURES_CODE, STEP_CODE
from frenetic.road.road import (
    MAX_COORDINATE,
    MAX_CURVATURE,
    MAX_HEADING,
    MAX_LENGTH,
    MAX_SAMPLES,
    MIN_DISTANCE,
    Pose,
    Road,
)

FLAT: Final = 0.01
"""Largest rise or fall of a flat road, and largest change of a lane's width, in m."""
LEVEL: Final = 1e-3
"""Largest lean of a level road to a side, in rad."""


def from_opendrive(data: bytes, *, lane: int = -1) -> Road:
    """The road in an OpenDRIVE file.

    A file that `to_opendrive` wrote gives the same road: curvatures, step, pose and lane width bit
    for bit. Of any other file, the road is at most 1 cm away from the line in it; see
    `frenetic.road.opendrive.line`.

    Args:
        data: the file's content.
        lane: which lane becomes the ego lane, by its id where the first road starts. One on the
            left (a positive id) is driven against the road, from its end to its start.

    Raises:
        RoadError: it is no such file, or the road in it has something that a `Road` has not; the
            message does not name the file.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    stretches = driven_stretches(_roads(parse_xml(data)), backwards=lane > 0)
    _require_flat([stretch.road for stretch in stretches])
    lanes = lane_ids(stretches, lane)
    lane_width = _ego_lane_width(stretches, lanes)
    parts = [
        (_geometries(stretch.road), _offsets(stretch.road, ids))
        for stretch, ids in zip(stretches, lanes, strict=True)
    ]
    length = sum(geometry.length for geometries, _ in parts for geometry in geometries)
    if length > MAX_LENGTH:
        raise RoadError(f"its road is longer than the {MAX_LENGTH:.0f} m that can be read")
    as_drawn = not any(stretch.backwards for stretch in stretches)
    if as_drawn and not any(offsets for _, offsets in parts):
        geometries = [geometry for pieces, _ in parts for geometry in pieces]
        first, single = stretches[0].road, len(stretches) == 1
        exact = _noted_road(first, geometries, lane_width) if single else None
        exact = exact or exact_road(geometries, _step(first) if single else None, lane_width)
        if exact is not None:
            return exact
    lines = [trace(geometries, offsets) for geometries, offsets in parts]
    driven = [
        backwards(line) if stretch.backwards else line
        for stretch, line in zip(stretches, lines, strict=True)
    ]
    return follow(joined(driven), lane_width)


def _roads(root: Element) -> list[Element]:
    """The roads of a file that has no junction."""
    if root.tag != "OpenDRIVE":
        raise RoadError(f"it is XML, but no OpenDRIVE: its root is <{root.tag:.40}>")
    header = root.find("header")
    major = None if header is None else header.get("revMajor")
    if major != "1":
        raise RoadError(f"its header says revMajor {major!r:.40}, but only OpenDRIVE 1.x is read")
    junctions, roads = root.findall("junction"), root.findall("road")
    if junctions:
        raise RoadError(
            "it has a junction: only a file with a single road, or a chain of them, is read"
        )
    if not roads:
        raise RoadError("it has 0 roads: a single road, or a chain of linked ones, is read")
    for road in roads:
        if road.get("junction", "-1") != "-1":
            raise RoadError("its road belongs to a junction: only a road on its own is read")
        if road.get("rule", "RHT") != "RHT":
            raise RoadError(
                f"its rule is {road.get('rule')!r:.40}: only right-hand traffic (RHT) is read"
            )
    return roads


def _noted_road(road: Element, geometries: list[Geometry], lane_width: float) -> Road | None:
    """The road whose curvatures `to_opendrive` noted, if the geometries still follow it."""
    step = _step(road)
    notes = [n for n in road.findall("userData") if n.get("code") == CURVATURES_CODE]
    if step is None or not notes:
        return None
    try:
        values = [float(text) for text in notes[0].get("value", "").split()]
        noted = Road(values, step, geometries[0].pose, lane_width=lane_width)
    except (ValueError, RoadError):
        return None
    return noted if are_of_road(geometries, noted) else None


def _step(road: Element) -> float | None:
    """The step that `to_opendrive` noted, if any."""
    for note in road.findall("userData"):
        if note.get("code") == STEP_CODE:
            step = number(note, "value")
            return step if step > 0.0 else None
    return None


def _cubic(element: Element, suffix: str = "", *, most: float = MAX_NUMBER) -> Cubic:
    """The coefficients of a polynomial; missing ones are 0."""
    a, b, c, d = (number(element, name + suffix, 0.0, most=most) for name in "abcd")
    return a, b, c, d


def _range(cubic: Cubic, span: float) -> tuple[float, float]:
    """Least and largest value, to a hundredth, of a polynomial from 0 to ``span``."""
    with np.errstate(all="ignore"):
        values = np.polynomial.Polynomial(cubic)(np.linspace(0.0, max(span, 0.0), 101))
    return float(values.min()), float(values.max())


def _stretches(
    elements: Sequence[Element], name: str, end: float
) -> Iterator[tuple[Element, float]]:
    """Elements that each hold from their ``name`` (m) to the next one's, and for how many m."""
    places = [number(element, name) for element in elements]
    for element, (here, following) in zip(
        elements, itertools.pairwise([*places, end]), strict=True
    ):
        yield element, following - here


def _require_flat(roads: Sequence[Element]) -> None:
    heights = [
        value
        for road in roads
        for element, span in _stretches(
            road.findall("elevationProfile/elevation"), "s", number(road, "length")
        )
        for value in _range(_cubic(element), span)
    ]
    if heights and not max(heights) - min(heights) <= FLAT:
        raise RoadError("its road rises or falls (elevation): only a flat road is read")
    for road in roads:
        for kind in ("superelevation", "crossfall"):
            elements = road.findall(f"lateralProfile/{kind}")
            for element, span in _stretches(elements, "s", number(road, "length")):
                low, high = _range(_cubic(element), span)
                if not max(-low, high) <= LEVEL:
                    raise RoadError(f"its road leans to a side ({kind}): only a level road is read")
        if any(any(_cubic(shape)) for shape in road.findall("lateralProfile/shape")):
            raise RoadError("its road is not level across (shape): only a level road is read")


def _ego_lane_width(stretches: Sequence[Stretch], lanes: Sequence[Sequence[int]]) -> float:
    """Width of the ego lane in m, which must be a driving lane of constant width."""
    widths: list[float] = []
    for stretch, ids in zip(stretches, lanes, strict=True):
        sections = sections_of(stretch.road)
        spans = _stretches(sections, "s", number(stretch.road, "length"))
        for lane, (section, span) in zip(ids, spans, strict=True):
            element = driving_lane(section, lane)
            for cubic, _, length in _widths(element, span):
                widths.extend(_range(cubic, length))
    if not max(widths) - min(widths) <= FLAT:
        raise RoadError(
            f"its lane {lanes[0][0]} is {min(widths):.3g} to {max(widths):.3g} m wide: only a lane"
            " of constant width is read"
        )
    return widths[0]


def _widths(lane: Element, span: float) -> Iterator[tuple[Cubic, float, float]]:
    """Width of a lane in a section of ``span`` m: each polynomial, from where, for how many m."""
    elements = lane.findall("width")
    if not elements:
        raise RoadError(
            f"its lane {lane.get('id')} has no width (borders instead of widths are not read)"
        )
    for element, length in _stretches(elements, "sOffset", span):
        yield _cubic(element), number(element, "sOffset"), length


def _offsets(road: Element, lanes: Sequence[int]) -> list[Offset]:
    """Shifts of the ego lane's edge towards the centre, empty if there are none.

    That is the lane offset and the widths of the lanes in between.

    Args:
        road: an element of the file.
        lanes: (sections,) the ego lane's id in each of the road's sections.
    """
    end = number(road, "length")
    elements = road.findall("lanes/laneOffset")
    ranges = [_range(_cubic(element), span) for element, span in _stretches(elements, "s", end)]
    shifts = [Offset(number(element, "s"), _cubic(element)) for element in elements]
    if all(max(-low, high) <= MIN_DISTANCE for low, high in ranges):
        shifts = []
    layers = [shifts] if shifts else []
    most = max(abs(lane) for lane in lanes)
    for inner in range(1, most):
        layer: list[Offset] = []
        sections = _stretches(sections_of(road), "s", end)
        for lane, (section, span) in zip(lanes, sections, strict=True):
            start, side = number(section, "s"), math.copysign(1.0, lane)
            if inner >= abs(lane):
                layer.append(Offset(start, (0.0, 0.0, 0.0, 0.0)))
                continue
            between = lane_of(section, int(side) * inner)
            for cubic, offset, _ in _widths(between, span):
                a, b, c, d = (side * coefficient for coefficient in cubic)
                layer.append(Offset(start + offset, (a, b, c, d)))
        layers.append(layer)
    return stacked(layers)


def _geometries(road: Element) -> list[Geometry]:
    """The geometries of the reference line that have a length, in their order."""
    geometries: list[Geometry] = []
    total = 0.0
    elements = road.findall("planView/geometry")
    if len(elements) > MAX_SAMPLES:
        raise RoadError(f"its road has {len(elements)} geometries: at most {MAX_SAMPLES} are read")
    for element in elements:
        length = number(element, "length", most=math.inf)
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
    x, y = (number(element, name, most=math.inf) for name in "xy")
    pose = Pose(x, y, number(element, "hdg", most=MAX_HEADING))
    if max(abs(pose.x), abs(pose.y)) > MAX_COORDINATE:
        raise RoadError(
            f"a <geometry> starts at ({pose.x:g}, {pose.y:g}): at most {MAX_COORDINATE:g} m from"
            " the origin are read"
        )
    shapes = list(element)
    shape = shapes[0] if shapes else element
    if shape.tag == "line":
        return Clothoid(pose, length, 0.0, 0.0)
    if shape.tag == "arc":
        curvature = number(shape, "curvature")
        return _not_too_sharp(Clothoid(pose, length, curvature, curvature))
    if shape.tag == "spiral":
        start, end = number(shape, "curvStart"), number(shape, "curvEnd")
        return _not_too_sharp(Clothoid(pose, length, start, end))
    if shape.tag == "poly3":
        return Polynomial(pose, length, (0.0, 1.0, 0.0, 0.0), _cubic(shape, most=math.inf), None)
    if shape.tag == "paramPoly3":
        last = length if shape.get("pRange") == "arcLength" else 1.0
        # Too large ones give a line that leaves every map, which is refused as such.
        ahead, left = (_cubic(shape, axis, most=math.inf) for axis in "UV")
        return Polynomial(pose, length, ahead, left, last)
    known = "line, arc, spiral, poly3 and paramPoly3"
    raise RoadError(
        f"a <geometry> holds {shape.tag[:40] if shapes else 'nothing'}: {known} are read"
    )


def _not_too_sharp(clothoid: Clothoid) -> Clothoid:
    sharpest = max(abs(clothoid.start), abs(clothoid.end))
    if sharpest > MAX_CURVATURE:
        raise RoadError(
            f"a <geometry> has a curvature of {sharpest:g} 1/m: at most {MAX_CURVATURE:g} are read"
        )
    return clothoid
