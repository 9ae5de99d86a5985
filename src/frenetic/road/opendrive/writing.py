"""A road as an OpenDRIVE 1.7 file.

Its reference line is the road's centre line. Where the curvature changes linearly, the line is a
``spiral``, which in OpenDRIVE is a clothoid, so nothing is approximated; where it stays the same,
an ``arc`` or a ``line``. Where it hardly changes, readers fail on a spiral, and arcs stand for it
that keep within a micrometre. The same road always gives the same bytes: no date, no version.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.road import Pose, Road

STEP_CODE: Final = "frenetic:step"
"""``userData`` that tells the road's step, which merged lines and arcs do not show."""
CURVATURES_CODE: Final = "frenetic:curvatures"
"""``userData`` that tells the road's curvatures, in a file whose geometries only come near them."""
ORIGIN: Final = (49.0, 8.4)
"""Latitude and longitude of a road's (0, 0), in degrees, unless others are given.

Kilometres from the next border of a UTM zone or of its 100 km squares, at which maps are cut.
"""
PROJECTION: Final = "+proj=tmerc +lat_0={} +lon_0={} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m"
"""Text of ``geoReference``: the transverse Mercator projection that touches the globe there."""
EDGE_MARK: Final = 0.15  # m, width of the solid line at each edge
CENTRE_MARK: Final = 0.12  # m, width of the broken line in the middle

# Readers compute a spiral from its curvature's rate of change and divide by it: CARLA and SUMO are
# off by decimetres where it is below 1e-9 1/m, and CommonRoad's reader refuses two curvatures that
# numpy.isclose takes for equal. These are twice the tolerances of numpy.isclose.
_SAME_CURVATURE: Final = 2e-8  # 1/m
_SAME_SHARE: Final = 2e-5
_ARC_ERROR: Final = 1e-7  # m, of an arc that stands for a spiral, at its end
_MOST_ARCS: Final = 100  # for one step; beyond, no curve is one of a road, and it stays a spiral
# Likewise a nearly straight arc and its centre far away.
_STRAIGHT: Final = 1e-10  # 1/m
_PLACE_DIGITS: Final = 9  # decimals of m
_ANGLE_DIGITS: Final = 12  # decimals of rad


@dataclass(frozen=True)
class _Piece:
    """Stretch of the road that is one geometry, in samples, of which parts count."""

    first: float
    last: float
    start: float
    """Curvature at its start, in 1/m."""
    end: float
    """Curvature at its end, in 1/m."""


def to_opendrive(
    road: Road,
    *,
    name: str = "road",
    speed_limit: float = 70.0,
    shoulder: float = 0.0,
    origin: tuple[float, float] = ORIGIN,
) -> str:
    """The text of an OpenDRIVE file with one road of two lanes, for right-hand traffic.

    Lane -1 is the ego lane, driven from the road's start to its end.

    Args:
        road: becomes road 1, without elevation.
        name: of the file and the road; characters that XML cannot hold are replaced.
        speed_limit: km/h.
        shoulder: m of paved ground beyond each lane, for simulators in which a car falls beyond the
            lanes; 0 for none.
        origin: latitude and longitude in degrees (WGS 84) of the point (0, 0), for converters to
            maps that lie on the globe; x points east there, y north.

    Raises:
        RoadError: the speed limit is not positive, the shoulder is negative, or the origin is not
            between 80 degrees south and 84 degrees north.
    """
    if not (math.isfinite(speed_limit) and speed_limit > 0.0):
        raise RoadError(f"speed_limit is {speed_limit:g}: a positive number of km/h is needed")
    if not (math.isfinite(shoulder) and shoulder >= 0.0):
        raise RoadError(f"shoulder is {shoulder:g}: 0 or a positive number of metres is needed")
    latitude, longitude = origin
    if not (-80.0 <= latitude <= 84.0 and -180.0 <= longitude <= 180.0):
        raise RoadError(
            f"origin is ({latitude:g}, {longitude:g}): a latitude of -80 to 84 and a longitude of"
            " -180 to 180 degrees are needed"
        )
    name = "".join(letter if letter.isprintable() else "?" for letter in name)
    root = ElementTree.Element("OpenDRIVE")
    header = _add_header(root, road, name, shoulder)
    _add(header, "geoReference").text = PROJECTION.format(latitude, longitude)
    element = _add(
        root,
        "road",
        name=name,
        length=road.length,
        id="1",
        junction="-1",
        rule="RHT",
    )
    kind = _add(element, "type", s=0.0, type="rural")
    _add(kind, "speed", max=speed_limit, unit="km/h")
    pieces = _pieces(road)
    _add_plan_view(element, road, pieces)
    profile = _add(element, "elevationProfile")
    _add(profile, "elevation", s=0.0, **_constant(0.0))
    _add(element, "lateralProfile")
    _add_lanes(element, road.lane_width, speed_limit, shoulder)
    _add(element, "userData", code=STEP_CODE, value=road.step)
    if not _is_exact(road, pieces):
        noted = " ".join(map(repr, road.curvatures.tolist()))
        _add(element, "userData", code=CURVATURES_CODE, value=noted)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _add(
    parent: ElementTree.Element, tag: str, /, **attributes: float | str
) -> ElementTree.Element:
    """A new child; its numbers read back exactly."""
    texts = {
        key: value if isinstance(value, str) else repr(float(value) + 0.0)  # no -0.0
        for key, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, texts)


def _constant(value: float) -> dict[str, float]:
    """The coefficients of a polynomial that is the same everywhere."""
    return {"a": value, "b": 0.0, "c": 0.0, "d": 0.0}


def _add_header(
    root: ElementTree.Element, road: Road, name: str, shoulder: float
) -> ElementTree.Element:
    reach = road.lane_width + shoulder
    edges: list[FloatArray] = [road.sample(road.sub_step, side * reach) for side in (1.0, -1.0)]
    east, north = (round(max(float(e[:, k].max()) for e in edges), 3) for k in (0, 1))
    west, south = (round(min(float(e[:, k].min()) for e in edges), 3) for k in (0, 1))
    return _add(
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


def hardly_differ(start: float, end: float) -> bool:
    """Whether two curvatures are such that readers fail on a spiral from one to the other."""
    return abs(end - start) < _SAME_CURVATURE + _SAME_SHARE * max(abs(start), abs(end))


def _pieces(road: Road) -> list[_Piece]:
    """The geometries of a road: a spiral for each step, but one arc or line for several alike."""
    pieces: list[_Piece] = []
    for i, (start, end) in enumerate(itertools.pairwise(road.curvatures.tolist())):
        # An arc of a spiral's mean curvature has its heading at the end, but is this far aside.
        aside = abs(end - start) * road.step**2 / 12.0
        arcs = max(1, math.ceil(math.sqrt(aside / _ARC_ERROR)))
        if not hardly_differ(start, end) or arcs > _MOST_ARCS:
            pieces.append(_Piece(i, i + 1, start, end))
            continue
        for part in range(arcs):
            mean = start + (end - start) * (part + 0.5) / arcs
            mean = 0.0 if abs(mean) < _STRAIGHT else mean
            before = pieces[-1] if pieces else None
            last = i + (part + 1) / arcs
            if before is not None and before.start == before.end == mean:
                pieces[-1] = _Piece(before.first, last, mean, mean)
            else:
                pieces.append(_Piece(i + part / arcs, last, mean, mean))
    return pieces


def _is_exact(road: Road, pieces: list[_Piece]) -> bool:
    """Whether the pieces have just the road's curvatures."""
    values = road.curvatures
    ends = np.array([(piece.first, piece.last, piece.start, piece.end) for piece in pieces])
    samples = np.arange(len(values))
    return all(
        np.array_equal(np.interp(ends[:, place], samples, values), ends[:, value])
        for place, value in ((0, 2), (1, 3))
    )


def _add_plan_view(element: ElementTree.Element, road: Road, pieces: list[_Piece]) -> None:
    plan = _add(element, "planView")
    for piece in pieces:
        x, y, heading = road.pose_at(piece.first * road.step)
        pose = Pose(round(x, _PLACE_DIGITS), round(y, _PLACE_DIGITS), round(heading, _ANGLE_DIGITS))
        if piece.first == 0:
            pose = road.pose
        geometry = _add(
            plan,
            "geometry",
            s=round(piece.first * road.step, _PLACE_DIGITS),
            x=pose.x,
            y=pose.y,
            hdg=pose.heading,
            length=(piece.last - piece.first) * road.step,
        )
        if piece.start != piece.end:
            _add(geometry, "spiral", curvStart=piece.start, curvEnd=piece.end)
        elif piece.start != 0.0:
            _add(geometry, "arc", curvature=piece.start)
        else:
            _add(geometry, "line")


def _add_lanes(
    element: ElementTree.Element, lane_width: float, speed_limit: float, shoulder: float
) -> None:
    lanes = _add(element, "lanes")
    _add(lanes, "laneOffset", s=0.0, **_constant(0.0))
    section = _add(lanes, "laneSection", s=0.0)
    for side, sign in (("left", 1), ("center", 0), ("right", -1)):
        group = _add(section, side)
        if sign == 0:
            centre = _add(group, "lane", id="0", type="none", level="false")
            _add_mark(centre, "broken", CENTRE_MARK)
            continue
        numbers = (1, 2) if shoulder > 0.0 else (1,)
        # Lanes are listed from left to right.
        for number in numbers if sign < 0 else reversed(numbers):
            is_ours = number == 1
            lane = _add(
                group,
                "lane",
                id=str(sign * number),
                type="driving" if is_ours else "shoulder",
                level="false",
            )
            _add(lane, "width", sOffset=0.0, **_constant(lane_width if is_ours else shoulder))
            _add_mark(lane, "solid" if is_ours else "none", EDGE_MARK)
            if is_ours:
                _add(lane, "speed", sOffset=0.0, max=speed_limit, unit="km/h")


def _add_mark(lane: ElementTree.Element, kind: str, width: float) -> None:
    _add(
        lane,
        "roadMark",
        sOffset=0.0,
        type=kind,
        weight="standard",
        color="white",
        width=width,
        laneChange="both" if kind == "broken" else "none",
    )
