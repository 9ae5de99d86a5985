"""A road as an OpenDRIVE 1.7 file.

Its reference line is the road's centre line. Where the curvature changes linearly, the line is a
``spiral``, which in OpenDRIVE is a clothoid, so nothing is approximated; where it stays the same,
an ``arc`` or a ``line``. Where it hardly changes, readers fail on a spiral, and arcs stand for it
that keep within a micrometre. The same road always gives the same bytes: no date, no version.
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
"""``userData`` of the road's step and curvatures, which its geometries may only come near."""
PROFILE_CODE: Final = "frenetic:{}"
"""Code of a profile in ``userData``: stations and values; for widening, the lane's width first."""
ORIGIN: Final = (49.0, 8.4)
"""Default latitude and longitude of a road's (0, 0), in degrees.

Kilometres from the next border of a UTM zone or of its 100 km squares, at which maps are cut.
"""
PROJECTION: Final = "+proj=tmerc +lat_0={} +lon_0={} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"
"""Text of ``geoReference``: the transverse Mercator projection that touches the globe there."""

_EDGE_MARK: Final = ("solid", 0.15, "none")
_CENTRE_MARK: Final = ("broken", 0.12, "both")
# Readers compute a spiral from its curvature's rate of change and divide by it: CARLA and SUMO are
# off by decimetres where it is below 1e-9 1/m, and CommonRoad's reader refuses two curvatures that
# numpy.isclose takes for equal. These are twice the tolerances of numpy.isclose.
_SAME_CURVATURE: Final = 2e-8  # 1/m
_SAME_SHARE: Final = 2e-5
_ARC_ERROR: Final = 1e-7  # m, of an arc that stands for a spiral, at its end
_MOST_ARCS: Final = 100  # for one step; beyond, no curve is one of a road, and it stays a spiral
# A nearly straight arc stays a spiral, too: its centre is far away.
_STRAIGHT: Final = 1e-10  # 1/m
_PLACE_DIGITS: Final = 9  # decimals of m
_ANGLE_DIGITS: Final = 12  # decimals of rad


def to_opendrive(
    road: Road,
    *,
    name: str = "road",
    speed_limit: float = 70.0,
    origin: tuple[float, float] = ORIGIN,
) -> str:
    """Return an OpenDRIVE file with one road of two lanes, for right-hand traffic, as text.

    Lane -1 is the ego lane, driven from the road's start to its end.

    Args:
        road: becomes road 1.
        name: of the file and the road; characters that XML cannot hold are replaced.
        speed_limit: km/h, where the road has none of its own.
        origin: latitude and longitude in degrees (WGS 84) of the point (0, 0), for converters to
            maps that lie on the globe; x points east there, y north.

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
    """Add a road's element to the root, and return it."""
    element = _add(root, "road", name=name, length=road.length, id="1", junction="-1", rule="RHT")
    limits = _limits(road, speed_limit)
    for s, limit in limits:
        _add(_add(element, "type", s=s, type="rural"), "speed", max=limit, unit="km/h")
    plan = _add(element, "planView")
    s = 0.0
    for first, last, start, end in _pieces(road):
        x, y, heading = road.pose
        if first > 0.0:
            x, y, heading = road.pose_at(first * road.step)
            x, y = round(x, _PLACE_DIGITS), round(y, _PLACE_DIGITS)
            heading = round(heading, _ANGLE_DIGITS)
        length, place = (last - first) * road.step, round(s, _PLACE_DIGITS)
        geometry = _add(plan, "geometry", s=place, x=x, y=y, hdg=heading, length=length)
        if start != end:
            _add(geometry, "spiral", curvStart=start, curvEnd=end)
        elif start != 0.0:
            _add(geometry, "arc", curvature=start)
        else:
            _add(geometry, "line")
        s += length
    elevation = _add(element, "elevationProfile")
    for s, _, value, slope in _profile(road, "grade"):
        _add_cubic(elevation, "elevation", "s", s, float(road.heights(s)), value, 0.5 * slope)
    lateral = _add(element, "lateralProfile")
    if len(road.superelevation):
        for s, *piece in _profile(road, "superelevation"):
            _add_cubic(lateral, "superelevation", "s", s, *_lean(*piece))
    _add_lanes(element, road, limits)
    _note(element, ROAD_CODE, [road.step, *road.curvatures.tolist()])
    for kind in profile.SHAPES:
        if len(pairs := getattr(road, kind)):
            # Lanes that widen everywhere do not show their own width.
            width = [road.lane_width] if kind == "widening" else []
            _note(element, PROFILE_CODE.format(kind), [*width, *pairs.ravel().tolist()])
    return element


def _limits(road: Road, speed_limit: float) -> list[tuple[float, float]]:
    """Return each change of the limit (m, km/h); ``speed_limit`` where the road has no limit."""
    if not len(road.speed_limits):
        return [(0.0, speed_limit)]
    steps = profile.piece_of(profile.LIMITS, road.speed_limits, 0.0)
    return [(s, limit or speed_limit) for s, limit in steps.tolist() if s < road.length]


def _add_lanes(element: Element, road: Road, limits: list[tuple[float, float]]) -> None:
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
    """Return a new child element; its numbers read back exactly."""
    texts = {
        key: value if isinstance(value, str) else repr(float(value) + 0.0)  # no -0.0
        for key, value in attributes.items()
    }
    return SubElement(parent, tag, texts)


def _add_cubic(
    parent: Element,
    tag: str,
    place: str,
    s: float,
    a: float = 0.0,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
) -> None:
    """Return a new child element with a cubic that holds from ``s`` m on."""
    _add(parent, tag, **{place: s, "a": a, "b": b, "c": c, "d": d})


def _note(element: Element, code: str, values: list[float]) -> None:
    _add(element, "userData", code=code, value=" ".join(map(repr, values)))


def _profile(road: Road, name: str) -> Iterator[tuple[float, float, float, float]]:
    """Return (start, length, value, slope) of the pieces of a profile, in m and 1/m; exact."""
    pairs = getattr(road, name)
    inner = pairs[(pairs[:, 0] > 0.0) & (pairs[:, 0] < road.length), 0]
    places = [0.0, *inner.tolist(), road.length]
    values = profile.value_at(pairs, places).tolist()
    for (s, value), (end, after) in pairwise(zip(places, values, strict=True)):
        yield s, end - s, value, (after - value) / (end - s)


def _lean(length: float, value: float, slope: float) -> tuple[float, float, float, float]:
    """Return the cubic of a piece's angle in rad, with the slopes of its ends."""
    end = value + slope * length
    a, b = math.atan(value), slope / (1.0 + value * value)
    rise, last = math.atan(end) - a, slope / (1.0 + end * end)
    c = (3.0 * rise / length - 2.0 * b - last) / length
    return a, b, c, (b + last - 2.0 * rise / length) / length**2


def _pieces(road: Road) -> list[tuple[float, float, float, float]]:
    """Return a road's geometries: first and last sample, and the curvatures there in 1/m.

    A spiral for each step, but one arc or line for several alike.
    """
    pieces: list[tuple[float, float, float, float]] = []
    for i, (start, end) in enumerate(pairwise(road.curvatures.tolist())):
        difference = abs(end - start)
        hardly = difference < _SAME_CURVATURE + _SAME_SHARE * max(abs(start), abs(end))
        # An arc of a spiral's mean curvature has its heading at the end, but is this far aside.
        aside = difference * road.step**2 / 12.0
        arcs = max(1, math.ceil(math.sqrt(aside / _ARC_ERROR)))
        if not hardly or arcs > _MOST_ARCS:
            pieces.append((i, i + 1, start, end))
            continue
        for part in range(arcs):
            mean = start + (end - start) * (part + 0.5) / arcs
            mean = 0.0 if abs(mean) < _STRAIGHT else mean
            alike = bool(pieces) and pieces[-1][2:] == (mean, mean)
            first = pieces.pop()[0] if alike else i + part / arcs
            pieces.append((first, i + (part + 1) / arcs, mean, mean))
    return pieces
