"""Writing a road as an OpenDRIVE 1.7 file.

The reference line of the written road is the centre line. Where the curvature changes linearly, the
line is a ``spiral``, which in OpenDRIVE is a clothoid, so nothing is approximated. Where the
curvature stays the same, it is an ``arc`` or a ``line``. Where the curvature hardly changes,
readers fail on a spiral; then arcs that are within a micrometre of the spiral replace it. The same
road always gives the same bytes: the file has no date and no version.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.road import Road

ROAD_CODE: Final = "frenetic:road"
"""Code of the ``userData`` with the road's step and curvatures, to restore the road bit for bit."""
PROFILE_CODE: Final = "frenetic:{}"
"""Code of the ``userData`` with a profile, whose name is filled in: stations and values; for
widening, the lane's width comes first."""
ORIGIN: Final = (49.0, 8.4)
"""Default latitude and longitude of a road's (0, 0), in degrees.

Our choice: kilometres away from any border of a UTM zone or of its 100 km squares, at which maps
are cut.
"""
PROJECTION: Final = "+proj=tmerc +lat_0={} +lon_0={} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"
"""Text of ``geoReference``: the transverse Mercator projection that touches the globe at a latitude
and a longitude, which are filled in."""

_EDGE_MARK: Final = ("solid", 0.15, "none")
"""Marking of a road's edge: type, width in m, and lane changes that it allows."""
_CENTRE_MARK: Final = ("broken", 0.12, "both")
"""Marking between the lanes: type, width in m, and lane changes that it allows."""
# Readers compute a spiral from its curvature's rate of change and divide by it: CARLA and SUMO are
# off by decimetres where it is below 1e-9 1/m, and CommonRoad's reader refuses two curvatures that
# numpy.isclose takes for equal. These are twice the tolerances of numpy.isclose.
_SAME_CURVATURE: Final = 2e-8  # [1/m] difference of two curvatures that hardly differ
_SAME_SHARE: Final = 2e-5  # difference of two curvatures that hardly differ, as a share of them
_ARC_ERROR: Final = 1e-7  # [m] error of an arc that replaces a spiral, at its end; our choice
_MOST_ARCS: Final = 100  # number of arcs that replace one spiral; beyond, it stays a spiral
_STRAIGHT: Final = 1e-10  # [1/m] an arc with a smaller curvature becomes a line
_METRES_DIGITS: Final = 9  # decimals of distances and coordinates in m
_RADIANS_DIGITS: Final = 12  # decimals of headings in rad


def to_opendrive(
    road: Road,
    *,
    name: str = "road",
    speed_limit: float = 70.0,
    origin: tuple[float, float] = ORIGIN,
) -> str:
    """Return the text of an OpenDRIVE file with one road of two lanes, for right-hand traffic.

    Lane -1 is the ego lane, which leads from the road's start to its end.

    Args:
        road: the road; its id in the file is 1.
        name: name of the file and the road; characters that XML cannot hold are replaced.
        speed_limit: speed limit where the road has no limit, in km/h.
        origin: latitude and longitude in degrees (WGS 84) of the point (0, 0), for converters to
            maps that lie on the globe. There, x points east and y north.

    Raises:
        RoadError: the speed limit is not positive, or the origin is not between 80 degrees south
            and 84 degrees north.
    """
    if not (math.isfinite(speed_limit) and speed_limit > 0.0):
        raise RoadError(f"speed_limit is {speed_limit:g}: a positive number of km/h is needed")
    latitude, longitude = origin
    if not (-80.0 <= latitude <= 84.0 and -180.0 <= longitude <= 180.0):
        raise RoadError(
            f"origin is ({latitude:g}, {longitude:g}): a latitude of -80 to 84 and a longitude of"
            " -180 to 180 degrees are needed"
        )
    name = "".join(letter if letter.isprintable() else "?" for letter in name)
    widest = road.lane_width + float(road.widening[:, 1].max(initial=0.0))
    edges = [road.sample(road.sub_step, side * widest) for side in (1.0, -1.0)]
    (west, south), (east, north) = (
        [round(value, 3) for value in extreme(np.concatenate(edges), axis=0).tolist()]
        for extreme in (np.min, np.max)
    )
    root = Element("OpenDRIVE")
    header = _add(
        root,
        "header",
        revMajor="1",
        revMinor="7",
        name=name,
        version="1.0",
        north=north,
        south=south,
        east=east,
        west=west,
        vendor="Frenetic",
    )
    _add(header, "geoReference").text = PROJECTION.format(latitude, longitude)
    add_road(root, road, name, speed_limit)
    indent(root)
    text = tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def add_road(root: Element, road: Road, name: str = "", speed_limit: float = 70.0) -> Element:
    """Add the element of a road to the root, and return the element.

    Args:
        root: the root element.
        road: the road.
        name: name of the road.
        speed_limit: speed limit where the road has no limit, in km/h.
    """
    element = _add(root, "road", name=name, length=road.length, id="1", junction="-1", rule="RHT")
    limits = _limits(road, speed_limit)
    for s, limit in limits:
        _add(_add(element, "type", s=s, type="rural"), "speed", max=limit, unit="km/h")
    _add_plan(element, road)
    elevation = _add(element, "elevationProfile")
    for s, _, value, slope in _profile(road, "grade"):
        _add_cubic(elevation, "elevation", "s", s, float(road.heights(s)), value, 0.5 * slope)
    lateral = _add(element, "lateralProfile")
    if len(road.superelevation):
        for s, *piece in _profile(road, "superelevation"):
            _add_cubic(lateral, "superelevation", "s", s, *_angle_cubic(*piece))
    _add_lanes(element, road, limits)
    _add_record(element, ROAD_CODE, [road.step, *road.curvatures.tolist()])
    for kind in profile.SHAPES:
        if len(pairs := getattr(road, kind)):
            # The elements of a lane that widens everywhere do not show `lane_width`.
            width = [road.lane_width] if kind == "widening" else []
            _add_record(element, PROFILE_CODE.format(kind), [*width, *pairs.ravel().tolist()])
    return element


def _add_plan(element: Element, road: Road) -> None:
    """Add the road's centre line, as a chain of geometries."""
    plan = _add(element, "planView")
    s = 0.0
    for first, last, start, end in _pieces(road):
        x, y, heading = road.pose
        if first > 0.0:
            x, y, heading = road.pose_at(first * road.step)
            x, y = round(x, _METRES_DIGITS), round(y, _METRES_DIGITS)
            heading = round(heading, _RADIANS_DIGITS)
        length, station = (last - first) * road.step, round(s, _METRES_DIGITS)
        geometry = _add(plan, "geometry", s=station, x=x, y=y, hdg=heading, length=length)
        if start != end:
            _add(geometry, "spiral", curvStart=start, curvEnd=end)
        elif start != 0.0:
            _add(geometry, "arc", curvature=start)
        else:
            _add(geometry, "line")
        s += length


def _limits(road: Road, speed_limit: float) -> list[tuple[float, float]]:
    """Return the stations in m at which the speed limit changes, with the new limits in km/h.

    Where the road has no limit, the limit is ``speed_limit``.
    """
    if not len(road.speed_limits):
        return [(0.0, speed_limit)]
    steps = profile.piece_of(profile.LIMITS, road.speed_limits, 0.0)
    return [(s, limit or speed_limit) for s, limit in steps.tolist() if s < road.length]


def _add_lanes(element: Element, road: Road, limits: list[tuple[float, float]]) -> None:
    """Add the road's lanes: their widths, markings and speed limits.

    Args:
        element: element of the road.
        road: the road.
        limits: stations in m at which the speed limit changes, with the new limits in km/h.
    """
    lanes = _add(element, "lanes")
    _add_cubic(lanes, "laneOffset", "s", 0.0)
    section = _add(lanes, "laneSection", s=0.0)
    for side, number in (("left", 1), ("center", 0), ("right", -1)):
        kind = "driving" if number else "none"
        lane = _add(_add(section, side), "lane", id=str(number), type=kind, level="false")
        if number:
            for s, _, value, slope in _profile(road, "widening"):
                _add_cubic(lane, "width", "sOffset", s, road.lane_width + value, slope)
        mark, width, change = _EDGE_MARK if number else _CENTRE_MARK
        _add(
            lane,
            "roadMark",
            sOffset=0.0,
            type=mark,
            weight="standard",
            color="white",
            width=width,
            laneChange=change,
        )
        for s, limit in limits if number else ():
            _add(lane, "speed", sOffset=s, max=limit, unit="km/h")


def _add(parent: Element, tag: str, /, **attributes: float | str) -> Element:
    """Add a child element and return it; reading its numbers gives the same floats."""
    texts = {
        key: value if isinstance(value, str) else repr(float(value) + 0.0)  # no -0.0
        for key, value in attributes.items()
    }
    return SubElement(parent, tag, texts)


def _add_cubic(
    parent: Element,
    tag: str,
    station: str,
    s: float,
    a: float = 0.0,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
) -> None:
    """Add a child element with the cubic a + b p + c p² + d p³, where p is the distance from ``s``.

    Args:
        parent: the parent element.
        tag: tag of the element.
        station: name of the attribute with ``s``.
        s: station from which the cubic holds, in m.
        a, b, c, d: coefficients of the cubic.
    """
    _add(parent, tag, **{station: s, "a": a, "b": b, "c": c, "d": d})


def _add_record(element: Element, code: str, values: list[float]) -> None:
    """Add numbers as ``userData``, from which `_recorded_road` restores the road."""
    _add(element, "userData", code=code, value=" ".join(map(repr, values)))


def _profile(road: Road, name: str) -> Iterator[tuple[float, float, float, float]]:
    """Yield start and length in m, value and slope of each linear piece of a road's profile."""
    pairs = getattr(road, name)
    inner = pairs[(pairs[:, 0] > 0.0) & (pairs[:, 0] < road.length), 0]
    stations = [0.0, *inner.tolist(), road.length]
    values = profile.value_at(pairs, stations).tolist()
    for (s, value), (end, next_value) in pairwise(zip(stations, values, strict=True)):
        yield s, end - s, value, (next_value - value) / (end - s)


def _angle_cubic(length: float, value: float, slope: float) -> tuple[float, float, float, float]:
    """Return a cubic (a, b, c, d) for the angle in rad of a linear piece of superelevation.

    OpenDRIVE has angles, a `Road` has their tangents. Angles and their slopes are exact at both
    ends of the piece.

    Args:
        length: length of the piece, in m.
        value: superelevation at its start, in m/m.
        slope: change of the superelevation along the piece, in 1/m.
    """
    end = value + slope * length
    a, b = math.atan(value), slope / (1.0 + value * value)
    rise, end_slope = math.atan(end) - a, slope / (1.0 + end * end)
    c = (3.0 * rise / length - 2.0 * b - end_slope) / length
    return a, b, c, (b + end_slope - 2.0 * rise / length) / length**2


def _pieces(road: Road) -> list[tuple[float, float, float, float]]:
    """Return a road's geometries: index of the first and the last sample, and the curvatures there.

    Each step is one spiral, but successive steps with the same curvature are one arc or line. An
    index may be a fraction, as several arcs may replace a spiral. The curvatures are in 1/m.
    """
    pieces: list[tuple[float, float, float, float]] = []
    for i, (start, end) in enumerate(pairwise(road.curvatures.tolist())):
        difference = abs(end - start)
        is_nearly_arc = difference < _SAME_CURVATURE + _SAME_SHARE * max(abs(start), abs(end))
        # An arc with the spiral's mean curvature ends with the spiral's heading, but this far
        # beside the spiral.
        aside = difference * road.step**2 / 12.0
        arcs = max(1, math.ceil(math.sqrt(aside / _ARC_ERROR)))
        if not is_nearly_arc or arcs > _MOST_ARCS:
            pieces.append((i, i + 1, start, end))
            continue
        for part in range(arcs):
            mean = start + (end - start) * (part + 0.5) / arcs
            mean = 0.0 if abs(mean) < _STRAIGHT else mean
            continues = bool(pieces) and pieces[-1][2:] == (mean, mean)
            first = pieces.pop()[0] if continues else i + part / arcs
            pieces.append((first, i + (part + 1) / arcs, mean, mean))
    return pieces
