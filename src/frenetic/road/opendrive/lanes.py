"""Lanes of an OpenDRIVE road: choosing a lane, and its line, width, slopes and speed limits."""

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
"""Largest coefficient of a crossfall or shape that is ignored, in m/m and higher orders; our
choice."""
JUMP: Final = 0.1
"""Largest jump of a road's height, in m; our choice."""
_MAX_LEAN: Final = 1.5
"""Largest angle of superelevation, in rad, just below a right angle; our choice."""
_DRIVABLE_TYPES: Final = frozenset(
    [
        *("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane"),
        *("mwyEntry", "mwyExit", "bidirectional", "restricted", "bus", "taxi", "HOV"),
    ]
)
"""Types of lanes that a user may choose."""
_UNITS: Final = {"km/h": 1.0, "kmh": 1.0, "kph": 1.0, "mph": 1.609344, "m/s": 3.6}
"""Unit of a speed in a file -> its amount in km/h; OpenDRIVE's default is m/s."""
_NO_LIMIT: Final = ("", "no limit", "undefined")
"""Texts that OpenDRIVE allows in place of a speed."""


def lane_line(road: Element, lane: int) -> FloatArray:
    """Return the traced line (n, 10) of a lane's inner edge, in the direction of travel.

    Args:
        road: the road.
        lane: id of the lane, negative on the right of the road's centre.

    Raises:
        RoadError: the road has no such lane, or its shape cannot be read.
    """
    if lane == 0:
        raise RoadError("lane 0 is the centre of a road: choose a lane to drive on")
    line = reference_line(road)
    stations = line[:, DISTANCE].copy()
    lane_geometry = _lane_geometry(road, lane, stations)
    _check_shape(road, is_level=lane_geometry.is_level_across)
    height, lean = _height_and_lean(road, lane_geometry, stations)
    if np.abs(lane_geometry.shift).max() > MIN_DISTANCE:
        _shift_line(line, lane_geometry.shift, lane_geometry.slope)
    elif line[:, MOVED_X:].any():
        set_distances(line)
    # The limit of a row holds from the row before, so it is read half way between the two.
    half_way = stations - 0.5 * np.diff(stations, prepend=0.0)
    limit = profile.steps_at(speed_limits(road, lane), half_way)
    line = np.column_stack([line, lane_geometry.width, height, lean, limit])
    return _reversed(line) if lane > 0 else line


@dataclass(frozen=True)
class _LaneGeometry:
    """Position and width of a lane at stations along its road; arrays (n,)."""

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


def _height_and_lean(
    road: Element, lane_geometry: _LaneGeometry, stations: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the height of a lane's inner edge in m, and its slope across in m/m, (n,) each.

    Raises:
        RoadError: the height jumps.
    """
    height, _ = evaluate_cubics(road.findall("elevationProfile/elevation"), "s", stations)
    angle, _ = evaluate_cubics(road.findall("lateralProfile/superelevation"), "s", stations)
    lean = np.tan(np.clip(angle, -_MAX_LEAN, _MAX_LEAN))
    height += lane_geometry.tilted * lean
    jumps = np.flatnonzero(np.abs(np.diff(height)) > JUMP)
    if len(jumps):
        raise RoadError(f"it jumps in height {stations[jumps[0]]:.2f} m along the road")
    return height, np.where(lane_geometry.is_level, 0.0, lean)


def _shift_line(line: FloatArray, shift: FloatArray, slope: FloatArray) -> None:
    """Move a reference line to the left, in place.

    Args:
        line: the line, (n, 6).
        shift: distance to the left at each point, (n,) in m.
        slope: change of the shift, (n,) in m per m along the line.

    Raises:
        RoadError: a point moves beyond the centre of a bend.
    """
    heading = line[:, HEADING].copy()
    # Length of the moved line per length of the line, along the line.
    ahead = 1.0 - shift * np.gradient(heading, line[:, DISTANCE])
    if ahead.min() <= 0.0:
        raise RoadError("its lanes are shifted beyond the centre of a bend, where no road is")
    line[:, X] -= shift * np.sin(heading)
    line[:, Y] += shift * np.cos(heading)
    line[:, HEADING] += np.arctan2(slope, ahead)
    line[1:, DISTANCE] = np.cumsum(np.hypot(np.diff(line[:, X]), np.diff(line[:, Y])))


def _reversed(line: FloatArray) -> FloatArray:
    """Return a traced line (n, 10) in the opposite direction."""
    line = line[::-1].copy()
    line[:, DISTANCE] = line[0, DISTANCE] - line[:, DISTANCE]
    line[:, HEADING] += math.pi
    line[:, LEAN] *= -1.0
    line[1:, LIMIT] = line[:-1, LIMIT]  # a limit holds from the row before
    return line


def _lane_geometry(road: Element, lane: int, stations: FloatArray) -> _LaneGeometry:
    """Return position and width of a lane at stations (n,) in m along its road.

    The shift of its inner edge is the sum of the lane offset and the widths of the lanes between
    the reference line and the lane.
    """
    side = 1 if lane > 0 else -1
    shift, slope = evaluate_cubics(road.findall("lanes/laneOffset"), "s", stations)
    tilted, is_level = shift.copy(), np.zeros(len(stations), dtype=bool)
    width = np.zeros_like(stations)
    for section, element, start, end in _linked_lanes(road, lane):
        here = (start <= stations) & (stations < end)
        width[here], _ = _width(element, stations[here] - start)
        is_level[here] = is_level_lane(element)
        for inner in range(1, abs(int(number_of(element, "id")))):
            between = lane_of(section, side * inner, is_driven=False)
            widths, slopes = _width(between, stations[here] - start)
            shift[here] += side * widths
            slope[here] += side * slopes
            if not is_level_lane(between):
                tilted[here] += side * widths
    return _LaneGeometry(width, shift, slope, tilted, is_level)


def _linked_lanes(road: Element, lane: int) -> Iterator[tuple[Element, Element, float, float]]:
    """Yield each lane section, the lane's element in it, and the section's start and end in m.

    The sections come in the direction of travel. The lane's links lead from section to section; a
    lane without a link keeps its id.

    Raises:
        RoadError: a section lacks the lane, or a link leads to a lane of the other direction.
    """
    side, onward = (1, "predecessor") if lane > 0 else (-1, "successor")
    side_name = "left" if lane > 0 else "right"
    sections = sections_of(road, side_name)
    starts = [number_of(section, "s") for section in sections]
    if starts[0] > TOLERANCE:
        raise RoadError(f"it has no lanes {side_name} of the centre before {starts[0]:.2f} m")
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

    Where the lane has a limit, it replaces the limit of the road's type.
    """
    types = sorted(road.findall("type"), key=lambda element: number_of(element, "s", 0.0))
    type_limits = [(number_of(kind, "s", 0.0), _limit(kind.find("speed"))) for kind in types]
    road_limits = np.array(type_limits or [(0.0, 0.0)])
    limits: dict[float, float] = {}  # by station
    for _, element, start, end in _linked_lanes(road, lane):
        speeds = sorted(
            (number_of(speed, "sOffset", 0.0), _limit(speed)) for speed in element.findall("speed")
        )
        lane_limits = [(start, 0.0), *((start + offset, limit) for offset, limit in speeds)]
        stations = {start, *(s for s, _ in lane_limits), *road_limits[:, 0].tolist()}
        for station in stations:
            if start <= station < end:
                lane_limit = float(profile.steps_at(np.array(lane_limits), station))
                limits[station] = lane_limit or float(profile.steps_at(road_limits, station))
    return profile.merged(np.array(sorted(limits.items())))


def _limit(speed: Element | None) -> float:
    """Return the limit of a ``speed`` element, in km/h; 0 for no limit, or an impossible limit.

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


def _width(lane: Element, distances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the width of a lane and its change along the road, (n,) each in m and m/m.

    Args:
        lane: the lane's element.
        distances: distances along the lane's section, (n,) in m.

    Raises:
        RoadError: the lane has borders in place of widths.
    """
    elements = lane.findall("width")
    if not elements:
        raise RoadError(
            f"its lane {lane.get('id')} has no width (borders instead of widths are not read)"
        )
    return evaluate_cubics(elements, "sOffset", distances)


def sections_of(road: Element, side: str) -> list[Element]:
    """Return the lane sections that describe a side of a road, ``left`` or ``right``.

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
    """Return the lanes at whose start a car enters the road: right lanes, then left lanes.

    Right lanes begin in the first section. Left lanes, which lead the other way, begin in the last.
    """
    right, left = sections_of(road, "right")[0], sections_of(road, "left")[-1]
    return [*right.findall("right/lane"), *left.findall("left/lane")]


def first_lane(road: Element) -> int:
    """Return the id of the driving lane nearest to the centre, on the right if there is one.

    A lane of another type that cars may use, such as a bus lane, counts only if the road has no
    driving lane.

    Raises:
        RoadError: the road has no driving lane.
    """
    lanes = [lane for lane in entered_lanes(road) if _is_driven(lane)]
    if not lanes:
        raise RoadError("it has no driving lane")

    def rank(lane: Element) -> tuple[bool, bool, int]:
        lane_id = int(number_of(lane, "id"))
        return lane.get("type") != "driving", lane_id > 0, abs(lane_id)

    return int(number_of(min(lanes, key=rank), "id"))


def _is_driven(lane: Element) -> bool:
    """Return whether cars drive on a lane, in its standard direction."""
    return lane.get("type") in _DRIVABLE_TYPES and lane.get("direction", "standard") == "standard"


def is_drivable(road: Element) -> bool:
    """Return whether a road has a lane on which cars drive."""
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
        is_driven: whether cars have to drive on the lane.

    Raises:
        RoadError: the section lacks the lane, or cars do not drive on it; the message lists the
            driving lanes.
    """
    side = "right" if lane < 0 else "left"
    element = section.find(f"{side}/lane[@id='{lane}']")
    if element is not None and (not is_driven or _is_driven(element)):
        return element
    if element is None:
        problem = "is missing"
    elif element.get("type") in _DRIVABLE_TYPES:
        problem = "is driven against the road's rule (direction)"
    else:
        problem = f"is of type {element.get('type')!r:.40}"
    lanes = [*section.findall("right/lane"), *section.findall("left/lane")]
    ids = ", ".join(other.get("id", "")[:9] for other in lanes if _is_driven(other))
    raise RoadError(
        f"its lane {lane}, {side} of the centre, {problem} (driving lanes, to be chosen as 'lane':"
        f" {ids or 'none'})"
    )
