"""Lanes of a road: their choice, and the line, width, slopes and speed limits of a lane."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.opendrive.reference_line import reference_line
from frenetic.road.opendrive.traced_line import (
    DISTANCE,
    HEADING,
    LEAN,
    LIMIT,
    MOVED_X,
    TOLERANCE,
    X,
    Y,
    set_distances,
)
from frenetic.road.opendrive.xml_elements import (
    coefficients_of,
    evaluate_cubics,
    is_true,
    number_of,
)
from frenetic.road.road_values import MAX_SPEED_LIMIT, MIN_DISTANCE, MIN_SPEED_LIMIT

LEVEL: Final = 1e-3
"""Largest coefficient of a crossfall or shape that is ignored, in m/m and higher orders; ours."""
JUMP: Final = 0.1
"""Largest step of a road's height, in m; ours."""
_DRIVEN: Final = frozenset(
    [
        *("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane"),
        *("mwyEntry", "mwyExit", "bidirectional", "restricted", "bus", "taxi", "HOV"),
    ]
)
"""Types of lanes that a user may choose."""
_UNITS: Final = {"km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609344, "m/s": 3.6}
"""Unit of a speed -> km/h; OpenDRIVE's own is m/s."""
_NO_LIMIT: Final = ("", "no limit", "undefined")
"""Texts that OpenDRIVE allows in place of a speed."""


def lane_line(road: Element, lane: int) -> FloatArray:
    """Return a traced line (n, 10) of a lane's inner edge in the direction of travel.

    Raises:
        RoadError: the road has no such lane, or its shape cannot be read.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    line = reference_line(road)
    places = line[:, DISTANCE].copy()
    course = _lane_geometry(road, lane, places)
    _check_shape(road, is_level=course.is_level_across)
    height, _ = evaluate_cubics(road.findall("elevationProfile/elevation"), "s", places)
    lean, _ = evaluate_cubics(road.findall("lateralProfile/superelevation"), "s", places)
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
        set_distances(line)
    limit = profile.steps_at(speed_limits(road, lane), places - 0.5 * np.diff(places, prepend=0.0))
    line = np.column_stack([line, course.width, height, lean, limit])
    if lane > 0:
        line = line[::-1].copy()
        line[:, DISTANCE] = line[0, DISTANCE] - line[:, DISTANCE]
        line[:, HEADING] += math.pi
        line[:, LEAN] *= -1.0
        line[1:, LIMIT] = line[:-1, LIMIT]
    return line


@dataclass(frozen=True)
class _LaneGeometry:
    """A lane's place and width at points (n,) along its road."""

    width: FloatArray
    """Width of the lane, in m."""
    shift: FloatArray
    """Distance of the lane's inner edge to the left of the reference line, in m."""
    slope: FloatArray
    """Change of the shift, in m per m along the road."""
    tilted: FloatArray
    """Part of the shift that superelevation tilts, in m: without the widths of level lanes."""
    is_level: FloatArray
    """Whether the lane is level (``level="true"``), which excludes it from superelevation."""

    @property
    def is_level_across(self) -> bool:
        """Whether everything from the reference line to the lane's outer edge is level."""
        return bool(self.is_level.all() and np.abs(self.tilted).max() <= MIN_DISTANCE)


def _lane_geometry(road: Element, lane: int, places: FloatArray) -> _LaneGeometry:
    """Return place and width of a lane at places (n,) in m along its road.

    The shift of its inner edge is the lane offset and the widths of the lanes in between.
    """
    side = 1 if lane > 0 else -1
    shift, slope = evaluate_cubics(road.findall("lanes/laneOffset"), "s", places)
    tilted, is_level = shift.copy(), np.zeros(len(places), dtype=bool)
    width = np.zeros_like(places)
    for section, element, start, end in _linked_lanes(road, lane):
        here = (start <= places) & (places < end)
        width[here], _ = _width(element, places[here] - start)
        is_level[here] = is_level_lane(element)
        for inner in range(1, abs(int(number_of(element, "id")))):
            between = lane_of(section, side * inner, is_driven=False)
            widths, slopes = _width(between, places[here] - start)
            shift[here] += side * widths
            slope[here] += side * slopes
            if not is_level_lane(between):
                tilted[here] += side * widths
    return _LaneGeometry(width, shift, slope, tilted, is_level)


def _linked_lanes(road: Element, lane: int) -> Iterator[tuple[Element, Element, float, float]]:
    """Yield each section, the lane's element in it, and the section's start and end in m.

    The lane's links lead from section to section; a lane without a link keeps its id.

    Raises:
        RoadError: a section lacks the lane, or a link leads to a lane of the other direction.
    """
    side, onward = (1, "predecessor") if lane > 0 else (-1, "successor")
    where = "left" if lane > 0 else "right"
    sections = sections_of(road, where)
    starts = [number_of(section, "s") for section in sections]
    if starts[0] > TOLERANCE:
        raise RoadError(f"it has no lanes {where} of the centre before {starts[0]:.2f} m")
    starts[0] = min(starts[0], 0.0)
    spans = list(zip(sections, starts, [*starts[1:], math.inf], strict=True))
    link: Element | None = None
    for section, start, end in spans if lane < 0 else reversed(spans):
        if link is not None:
            lane = int(number_of(link, "id"))
            if lane * side <= 0:
                raise RoadError(f"a lane leads to lane {lane}, which is driven the other way")
        element = lane_of(section, lane)
        link = element.find(f"link/{onward}")
        yield section, element, start, end


def speed_limits(road: Element, lane: int) -> FloatArray:
    """Return the speed limits of a lane, (k, 2) in m along the road and km/h; 0 for no limit.

    A lane's own limit comes before the limit of the road's type.
    """
    types = sorted(road.findall("type"), key=lambda element: number_of(element, "s", 0.0))
    of_type = [(number_of(kind, "s", 0.0), _limit(kind.find("speed"))) for kind in types]
    of_road = np.array(of_type or [(0.0, 0.0)])
    steps: dict[float, float] = {}
    for _, element, start, end in _linked_lanes(road, lane):
        speeds = sorted(
            (number_of(speed, "sOffset", 0.0), _limit(speed)) for speed in element.findall("speed")
        )
        of_lane = [(start, 0.0), *((start + offset, limit) for offset, limit in speeds)]
        stations = {start, *(s for s, _ in of_lane), *of_road[:, 0].tolist()}
        for station in stations:
            if start <= station < end:
                lane_limit = float(profile.steps_at(np.array(of_lane), station))
                steps[station] = lane_limit or float(profile.steps_at(of_road, station))
    return profile.merged(np.array(sorted(steps.items())))


def _limit(speed: Element | None) -> float:
    """Return the limit of a ``speed`` element, in km/h; 0 for no limit, or an impossible one.

    Raises:
        RoadError: the unit is unknown, or the limit is no number.
    """
    if speed is None or speed.get("max", "") in _NO_LIMIT:
        return 0.0
    unit = speed.get("unit", "m/s").strip().lower()
    if unit not in _UNITS:
        raise RoadError(f"a <speed> has unit={unit[:40]!r}: {', '.join(_UNITS)} are known")
    limit = _UNITS[unit] * number_of(speed, "max")
    return limit if MIN_SPEED_LIMIT <= limit <= MAX_SPEED_LIMIT else 0.0


def _check_shape(road: Element, *, is_level: bool) -> None:
    """Refuse a road whose cross-section is not straight where the lane lies.

    Args:
        road: the road.
        is_level: whether the lane and all between it and the reference line are level, so that only
            the height of the reference line matters.

    Raises:
        RoadError: the road has a crossfall or a shape there.
    """
    crossfalls = road.findall("lateralProfile/crossfall")
    if not is_level and any(
        np.abs(coefficients_of(element)).max() > LEVEL for element in crossfalls
    ):
        raise RoadError("it is shaped across (crossfall): only superelevation is read")
    shapes: dict[float, list[Element]] = {}
    for element in road.findall("lateralProfile/shape"):
        shapes.setdefault(number_of(element, "s"), []).append(element)
    if is_level:
        centre = [evaluate_cubics(across, "t", np.zeros(1))[0][0] for across in shapes.values()]
        is_shaped = bool(centre) and float(np.ptp(centre)) > LEVEL
    else:
        cubics = [coefficients_of(element) for across in shapes.values() for element in across]
        is_shaped = bool(np.abs(cubics).max(initial=0.0) > LEVEL)
    if is_shaped:
        raise RoadError("it is shaped across (shape): only superelevation is read")


def _width(lane: Element, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return width (n,) and its slope (n,) of a lane at places (n,) in m along its section.

    Raises:
        RoadError: the lane has borders in place of widths.
    """
    elements = lane.findall("width")
    if not elements:
        raise RoadError(
            f"its lane {lane.get('id')} has no width (borders instead of widths are not read)"
        )
    return evaluate_cubics(elements, "sOffset", places)


def sections_of(road: Element, side: str) -> list[Element]:
    """Return the lane sections that hold for a side, left or right.

    Raises:
        RoadError: the road has no lane section.
    """
    sections = road.findall("lanes/laneSection")
    if not sections:
        raise RoadError("it has no lanes")
    of_side = [
        section
        for section in sections
        if not is_true(section, "singleSide") or section.find(f"{side}/lane") is not None
    ]
    return of_side or sections


def entered_lanes(road: Element) -> list[Element]:
    """Return the lanes of the section in which they are entered, right ones before left ones."""
    right, left = sections_of(road, "right")[0], sections_of(road, "left")[-1]
    return [*right.findall("right/lane"), *left.findall("left/lane")]


def first_lane(road: Element) -> int:
    """Return the id of the driving lane nearest to the centre, on the right if possible.

    A lane for buses or the like counts only where the road has no other.

    Raises:
        RoadError: the road has no driving lane.
    """
    lanes = [
        (lane.get("type") != "driving", int(number_of(lane, "id")))
        for lane in entered_lanes(road)
        if _is_driven(lane)
    ]
    if not lanes:
        raise RoadError("it has no driving lane")
    return min(lanes, key=lambda lane: (lane[0], lane[1] > 0, abs(lane[1])))[1]


def _is_driven(lane: Element) -> bool:
    return lane.get("type") in _DRIVEN and lane.get("direction", "standard") == "standard"


def is_drivable(road: Element) -> bool:
    """Return whether a road has a lane that is driven."""
    has_lanes = road.find("lanes/laneSection") is not None
    return has_lanes and any(map(_is_driven, entered_lanes(road)))


def is_level_lane(lane: Element) -> bool:
    """Return whether a lane is excluded from superelevation."""
    return is_true(lane, "level")


def lane_of(section: Element, lane: int, *, is_driven: bool = True) -> Element:
    """Return a section's lane with this id.

    Args:
        section: the lane section.
        lane: id of the lane.
        is_driven: whether the lane has to be for cars.

    Raises:
        RoadError: the section lacks the lane, or the lane is not for cars; the message lists the
            driving lanes.
    """
    side = "right" if lane < 0 else "left"
    element = section.find(f"{side}/lane[@id='{lane}']")
    if element is not None and (not is_driven or _is_driven(element)):
        return element
    if element is None:
        problem = "is missing"
    elif element.get("type") in _DRIVEN:
        problem = "is driven against the road's rule (direction)"
    else:
        problem = f"is of type {element.get('type')!r:.40}"
    lanes = [*section.findall("right/lane"), *section.findall("left/lane")]
    ids = ", ".join(other.get("id", "")[:9] for other in lanes if _is_driven(other))
    raise RoadError(
        f"its lane {lane}, {side} of the centre, {problem} (driving lanes, to be chosen as 'lane':"
        f" {ids or 'none'})"
    )
