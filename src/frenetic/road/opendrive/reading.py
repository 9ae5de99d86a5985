"""Reading roads of an OpenDRIVE file.

One lane of a road is read: its width, its slopes, its speed limits, and its inner edge, which is
the edge on the side of the road's centre. The inner edge becomes the centre line of the returned
road. Other lanes, road marks, signals and objects are left out.

In a file, geometries have any lengths, and the curvature may jump between them. A `Road` has one
step, and its curvature is linear in between. So the edge is traced every few centimetres (`lanes`),
and a road with a sample every half metre or denser follows it (`following`). If the road is more
than `TOLERANCE` beside the edge, an error is raised.

The numbers of a file are rounded, so geometries do not quite meet: coordinates with two decimals
leave gaps of up to 1.4 cm, and headings with two decimals lead 30 cm to the side after 60 m.
Therefore geometries are turned by what the rounding of their headings allows (`reference_line`),
and gaps are blended over `BLEND` m on either side (`traced_line`). Roads that continue each other
are joined (`joints`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import profile
from frenetic.road.opendrive.following import SAMPLE_DISTANCE, road_along
from frenetic.road.opendrive.ids import QUOTING, name_in_errors, parse_ids, quoted_id, shortened
from frenetic.road.opendrive.joints import Joint, join_lines, joint_notes, nearest_lane
from frenetic.road.opendrive.lanes import (
    first_lane,
    is_drivable,
    is_level_lane,
    lane_line,
    lane_of,
    sections_of,
    speed_limits,
)
from frenetic.road.opendrive.traced_line import DISTANCE
from frenetic.road.opendrive.writing import PROFILE_CODE, ROAD_CODE, add_road
from frenetic.road.opendrive.xml_elements import number_of, parse_xml
from frenetic.road.road import Road
from frenetic.road.road_values import MAX_HEADING, Pose

_LANE_TAGS: Final = frozenset(
    [
        *("geometry", "line", "arc", "spiral", "paramPoly3", "elevation", "superelevation"),
        *("laneSection", "laneOffset", "width"),
    ]
)
"""Tags of the elements that determine where lanes run."""
_MAX_LISTED: Final = 8
"""Largest number of roads that a message lists; our choice."""
_METRES_ROUNDING: Final = 1e-9
"""Distance in m by which a computed distance may exceed a whole metre or a row; our choice."""


@dataclass(frozen=True)
class Stretch:
    """A stretch of a map: roads that continue each other, as one road."""

    ids: tuple[str, ...]
    """Ids of the roads, in the direction of travel."""
    start: float
    """Distance from the start of the first road at which the stretch begins, in m."""
    road: Road
    """The stretch, at its place in the map."""
    notes: tuple[str, ...] = ()
    """Sentences about roads of the stretch that were joined although they do not quite meet."""

    @property
    def name(self) -> str:
        """Text by which `RoadMap.stretches` returns this stretch."""
        return self.rest_name(0.0)

    def rest_name(self, distance: float) -> str:
        """Return the text by which `RoadMap.stretches` returns the rest of the stretch.

        Args:
            distance: distance along the stretch, in m; the rest begins at the next whole metre.
        """
        start = math.ceil(self.start + distance - _METRES_ROUNDING)
        first, *others = map(quoted_id, self.ids)
        return ",".join([f"{first}@{start}" if start else first, *others])


class RoadMap:
    """The roads in an OpenDRIVE file.

    Args:
        data: the file's content.

    Raises:
        RoadError: the data are no OpenDRIVE 1.x file with a road. Messages of this class begin with
            "it" for the file, so that a caller can put the file's path in front.
    """

    def __init__(self, data: bytes) -> None:
        root = parse_xml(data)
        if root.tag != "OpenDRIVE":
            raise RoadError(f"it is XML, but no OpenDRIVE: its root is <{root.tag:.40}>")
        header = root.find("header")
        major = None if header is None else header.get("revMajor")
        if major != "1":
            raise RoadError(
                f"its header says revMajor {major!r:.40}, but only OpenDRIVE 1.x is read"
            )
        # By id. A list, since a faulty file may have several roads with the same id.
        self._roads: dict[str, list[Element]] = {}
        for road in root.findall("road"):
            self._roads.setdefault(road.get("id", ""), []).append(road)
        self._count = sum(map(len, self._roads.values()))
        if not self._count:
            raise RoadError("it has no road")

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all roads."""
        return tuple(self._roads)

    @property
    def lengths(self) -> dict[str, float]:
        """Id of each drivable road outside junctions -> its length in m, the longest first."""
        lengths = {
            road_id: number_of(road, "length", 0.0, most=math.inf)
            for road_id, (road, *_) in self._roads.items()
            if road.get("junction", "-1") == "-1" and is_drivable(road)
        }
        return dict(sorted(lengths.items(), key=lambda item: -item[1]))

    def road(self, road_id: str | None = None, *, lane: int | None = None) -> Road:
        """Return a road of the map, at its place in the map.

        A road that `to_opendrive` wrote comes back bit for bit: curvatures, profiles, step, pose
        and lane width. Any other road is at most 1 cm away from the line in the file, its slopes
        have errors of at most 0.01 %, and its width of at most 1 mm.

        Args:
            road_id: id of the road; None for the map's only road.
            lane: id of the lane that becomes the ego lane, at the start of the drive. A lane on the
                left, which has a positive id, is driven in the direction opposite to the road's,
                from the road's end to its start. None for the driving lane nearest to the centre,
                on the right if there is one.

        Raises:
            RoadError: the map lacks the road or lane, or has several roads with this id, or a
                `Road` cannot represent it.
        """
        element = self._element(road_id)
        with name_in_errors(element):
            lane = first_lane(element) if lane is None else lane
            recorded = _recorded_road(element) if lane == -1 else None
            return road_along(lane_line(element, lane)) if recorded is None else recorded

    def stretches(self, roads: str, *, lane: int | None = None) -> list[Stretch]:
        """Return stretches of the map, at their places in the map.

        Args:
            roads: ids of roads, separated by commas. A road that starts where the road before ends
                is joined to it; any other road begins a new stretch. ``12@240`` begins a new
                stretch with road 12, without its first 240 m. An id with a comma, an @ or a quote
                is put in double quotes, as in JSON: ``"7,left"@20,8``. The quotes may be left out
                if the text without quotes would name a road that the map lacks, here 7.
            lane: lane of the first road of each stretch, as for `road`. A joined road continues it
                with the lane that begins where the lane before ends, at most 5 cm and 2 degrees
                off.

        Raises:
            RoadError: the map lacks a road or lane, a `Road` cannot represent it, or a start lies
                beyond the end of its stretch.
        """
        stretches = []
        for joined in self._joined_roads(roads, lane):
            with name_in_errors(*map(self._element, joined.ids)):
                skipped = 0.0
                if joined.start:
                    skipped = _parse_start(joined.start, joined.line[-1, DISTANCE])
                row = int(np.searchsorted(joined.line[:, DISTANCE], skipped - _METRES_ROUNDING))
                line = joined.line[row:].copy()
                line[:, DISTANCE] -= line[0, DISTANCE]
                road = road_along(line)
            stretches.append(Stretch(tuple(joined.ids), skipped, road, tuple(joined.notes)))
        return stretches

    def _joined_roads(self, roads: str, lane: int | None) -> list[_JoinedRoads]:
        """Return the joined roads in a text for `stretches`, each in its whole length."""
        all_joined: list[_JoinedRoads] = []
        element: Element | None = None
        for road_id, start in parse_ids(roads, self._roads):
            before, element = element, self._element(road_id)
            with name_in_errors(element):
                notes: list[str] = []
                if all_joined and before is not None and not start:
                    joint = nearest_lane(element, all_joined[-1].end)
                    notes = joint_notes(before, element, joint)
                    if joint is not None and joint.is_joined:
                        all_joined[-1].append(road_id, joint, notes)
                        continue
                line = lane_line(element, first_lane(element) if lane is None else lane)
                all_joined.append(_JoinedRoads([road_id], start, line, line[-1], notes))
        return all_joined

    def _element(self, road_id: str | None) -> Element:
        """Return the road with this id; the map's only road for None.

        Raises:
            RoadError: no road has the id, several have it, or the road has left-hand traffic.
        """
        if road_id is None and self._count == 1:
            ((road,),) = self._roads.values()
        elif road_id is None:
            raise RoadError(
                f"it has {self._count} roads; choose with --road: {self._longest_roads()}"
            )
        else:
            roads = self._roads.get(road_id, [])
            if not roads:
                quotes = (
                    f"; {QUOTING}" if any(set(name) & set(',@"') for name in self._roads) else ""
                )
                raise RoadError(
                    f"it has no road {shortened(road_id)!r}, but {self._longest_roads()}{quotes}"
                )
            if len(roads) > 1:
                raise RoadError(
                    f"it has {len(roads)} roads with the id {shortened(road_id)!r}: give each its"
                    " own"
                )
            (road,) = roads
        if road.get("rule", "RHT") != "RHT":
            raise RoadError(
                f"its rule is {road.get('rule')!r:.40}: only right-hand traffic (RHT) is read"
            )
        return road

    def _longest_roads(self) -> str:
        """Return the ids and lengths of the longest drivable roads, for a message."""
        longest = list(self.lengths.items())[:_MAX_LISTED]
        if not longest:
            return "none has a driving lane outside junctions"
        listed = [f"{shortened(quoted_id(name))} ({length:.0f} m)" for name, length in longest]
        drivable = sum(map(is_drivable, itertools.chain(*self._roads.values())))
        return ", ".join([*listed, *([".."] if drivable > len(longest) else [])])


@dataclass
class _JoinedRoads:
    """Roads that continue each other, with the line of their lane."""

    ids: list[str]
    start: str
    """Text of the distance in m at which the stretch begins; empty for its whole length."""
    line: FloatArray
    """Traced line of the lane through all roads, (n, 10)."""
    end: FloatArray
    """Last row of the last road's line, before a blend moved it."""
    notes: list[str]
    """Sentences about roads that were joined although they do not quite meet."""

    def append(self, road_id: str, joint: Joint, notes: list[str]) -> None:
        """Continue the roads with another road.

        Args:
            road_id: id of the road.
            joint: lane of the road that continues the line.
            notes: notes about the joint.
        """
        self.ids.append(road_id)
        self.line = join_lines(self.line, joint)
        self.end = joint.line[-1]
        self.notes += notes


def _parse_start(text: str, length: float) -> float:
    """Return the distance in m at which a stretch begins.

    Raises:
        RoadError: the text is no number, or the number lies beyond the end of the stretch.
    """
    try:
        start = float(text)
    except ValueError:
        start = math.nan
    if not 0.0 <= start < length - SAMPLE_DISTANCE:
        raise RoadError(f"@{text[:40]} is no place on a stretch of {length:.0f} m")
    return start


def _recorded_road(element: Element) -> Road | None:
    """Return the road that `to_opendrive` recorded in the element; None without such a record.

    A record no longer counts if the geometry of the element has been changed: then the road that
    the record describes, written again, differs from the element.

    Raises:
        RoadError: the road has no lane -1, or cars do not drive on it.
    """
    if is_level_lane(lane_of(sections_of(element, "right")[0], -1)):
        return None  # `to_opendrive` writes no level lanes
    limits = speed_limits(element, -1)
    record = {note.get("code"): note.get("value", "") for note in element.findall("userData")}
    try:
        step, *curvatures = map(float, record[ROAD_CODE].split())
        numbers = {
            name: [float(value) for value in record.get(PROFILE_CODE.format(name), "").split()]
            for name in profile.SHAPES
        }
        start, width = (next(element.iter(tag)) for tag in ("geometry", "width"))
        pose = tuple(number_of(start, name, most=MAX_HEADING) for name in ("x", "y", "hdg"))
        # The width of the lane comes first in the record of its widening, see `add_road`.
        lane_width = numbers["widening"].pop(0) if numbers["widening"] else number_of(width, "a")
        profiles = {name: np.array(values).reshape(-1, 2) for name, values in numbers.items()}
        profiles[profile.LIMITS] = limits
        road = Road(curvatures, step, Pose(*pose), lane_width=lane_width, **profiles)
    except (KeyError, StopIteration, ValueError, RoadError):
        return None
    rewritten = add_road(Element("OpenDRIVE"), road)
    return road if _lane_elements(rewritten) == _lane_elements(element) else None


def _lane_elements(road: Element) -> list[tuple[str, dict[str, str]]]:
    """Return tags and attributes of the elements that determine where a road's lanes run."""
    return [(element.tag, element.attrib) for element in road.iter() if element.tag in _LANE_TAGS]
