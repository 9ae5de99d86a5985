"""A road as an OpenDRIVE 1.7 file.

Its reference line is the road's centre line. Where the curvature changes linearly, the line is a
``spiral``, which in OpenDRIVE is a clothoid, so nothing is approximated; where it stays the same,
an ``arc`` or a ``line``. The same road always gives the same bytes: no date, no version.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.road import Pose, Road

STEP_CODE: Final = "frenetic:step"
"""``userData`` that tells the road's step, which merged lines and arcs do not show."""
EDGE_MARK: Final = 0.15  # m, width of the solid line at each edge
CENTRE_MARK: Final = 0.12  # m, width of the broken line in the middle

# Readers compute a spiral from its curvature's rate of change and divide by it: CARLA and SUMO are
# off by decimetres where it is nearly zero. An arc in its place is off by less than a micrometre.
_SAME_CURVATURE: Final = 1e-9  # 1/m
# Likewise a nearly straight arc and its centre far away.
_STRAIGHT: Final = 1e-10  # 1/m
_PLACE_DIGITS: Final = 9  # decimals of m
_ANGLE_DIGITS: Final = 12  # decimals of rad


@dataclass(frozen=True)
class _Piece:
    """Steps of the road from sample ``first`` to sample ``last`` that are one geometry."""

    first: int
    last: int
    start: float
    """Curvature, in 1/m."""
    end: float
    """1/m."""


def to_opendrive(
    road: Road, *, name: str = "road", speed_limit: float = 70.0, shoulder: float = 0.0
) -> str:
    """The text of an OpenDRIVE file with one road of two lanes, for right-hand traffic.

    Lane -1 is the ego lane, driven from the road's start to its end.

    Args:
        road: becomes road 1, without elevation.
        name: of the file and the road; characters that XML cannot hold are replaced.
        speed_limit: km/h.
        shoulder: m of paved ground beyond each lane, for simulators in which a car falls beyond the
            lanes; 0 for none.

    Raises:
        RoadError: the speed limit is not positive, or the shoulder is negative.
    """
    if not (math.isfinite(speed_limit) and speed_limit > 0.0):
        raise RoadError(f"speed_limit is {speed_limit:g}: a positive number of km/h is needed")
    if not (math.isfinite(shoulder) and shoulder >= 0.0):
        raise RoadError(f"shoulder is {shoulder:g}: 0 or a positive number of metres is needed")
    name = "".join(letter if letter.isprintable() else "?" for letter in name)
    root = ElementTree.Element("OpenDRIVE")
    _add_header(root, road, name, shoulder)
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
    _add_plan_view(element, road)
    profile = _add(element, "elevationProfile")
    _add(profile, "elevation", s=0.0, **_constant(0.0))
    _add(element, "lateralProfile")
    _add_lanes(element, road.lane_width, speed_limit, shoulder)
    _add(element, "userData", code=STEP_CODE, value=road.step)
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


def _add_header(root: ElementTree.Element, road: Road, name: str, shoulder: float) -> None:
    reach = road.lane_width + shoulder
    edges: list[FloatArray] = [road.sample(road.sub_step, side * reach) for side in (1.0, -1.0)]
    east, north = (round(max(float(e[:, k].max()) for e in edges), 3) for k in (0, 1))
    west, south = (round(min(float(e[:, k].min()) for e in edges), 3) for k in (0, 1))
    _add(
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


def _pieces(road: Road) -> list[_Piece]:
    """The geometries of a road: a spiral for each step, but one arc or line for several alike."""
    pieces: list[_Piece] = []
    for i, (start, end) in enumerate(itertools.pairwise(road.curvatures.tolist())):
        if abs(end - start) < _SAME_CURVATURE:
            mean = 0.5 * (start + end)
            start = end = 0.0 if abs(mean) < _STRAIGHT else mean
            before = pieces[-1] if pieces else None
            if before is not None and before.start == before.end == start:
                pieces[-1] = _Piece(before.first, i + 1, start, end)
                continue
        pieces.append(_Piece(i, i + 1, start, end))
    return pieces


def _add_plan_view(element: ElementTree.Element, road: Road) -> None:
    plan = _add(element, "planView")
    points, headings = road.points.tolist(), road.headings.tolist()
    for piece in _pieces(road):
        (x, y), heading = points[piece.first], headings[piece.first]
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
