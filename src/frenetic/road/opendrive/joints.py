"""Joints: where a lane of one road continues a lane of another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.opendrive.ids import quoted_id, shortened
from frenetic.road.opendrive.lanes import entered_lanes, lane_line
from frenetic.road.opendrive.reference_line import KINK
from frenetic.road.opendrive.traced_line import (
    BLEND,
    DISTANCE,
    GAP,
    HEADING,
    ROUNDING,
    TOLERANCE,
    X,
    close_gaps,
    move_points,
    set_distances,
)
from frenetic.road.opendrive.xml_elements import number_of
from frenetic.road.road_values import MIN_DISTANCE

TURN: Final = math.radians(2.0)
"""Largest change of heading from the end of a road to the start of the next, in rad; ours."""


@dataclass(frozen=True)
class Joint:
    """A place where a lane could continue the lane of another road."""

    line: FloatArray
    """Line (n, 10) of the lane that could continue the other."""
    gap: float
    """Distance from the end of the lane before, in m."""
    turn: float
    """Change of heading in rad."""

    @property
    def is_joined(self) -> bool:
        """Whether the lanes are near enough to be joined."""
        return self.gap <= GAP + ROUNDING and abs(self.turn) <= TURN + ROUNDING

    @property
    def text(self) -> str:
        """Gap and change of heading in words."""
        gap = f"{100.0 * self.gap:.1f} cm" if self.gap < 1.0 else f"{self.gap:.1f} m"
        return f"{gap} and {math.degrees(abs(self.turn)):.1f} degrees"


def nearest_lane(road: Element, end: FloatArray) -> Joint | None:
    """Return the joint of the road's lane that begins nearest to the end of another lane.

    None if no lane of the road can be read.

    Args:
        road: the road that could continue the other.
        end: last row of the other lane's line.
    """
    joints = []
    for lane in entered_lanes(road):
        try:
            line = lane_line(road, int(number_of(lane, "id")))
        except RoadError:
            continue
        gap = float(np.hypot(*(line[0, X:HEADING] - end[X:HEADING])))
        turn = math.remainder(line[0, HEADING] - end[HEADING], math.tau)
        joints.append(Joint(line, gap, turn))
    return min(joints, key=lambda joint: (not joint.is_joined, joint.gap), default=None)


def joint_notes(before: Element, road: Element, joint: Joint | None) -> list[str]:
    """Return notes about a gap between two roads; empty if they meet, or are not linked."""
    if joint is None:
        return []
    names = [shortened(quoted_id(element.get("id", ""))) for element in (before, road)]
    misses = f"road {names[1]} begins {joint.text} off the end of road {names[0]}"
    if joint.is_joined:
        is_exact = joint.gap <= TOLERANCE and abs(joint.turn) <= KINK
        return [] if is_exact else [f"{misses}: joined by a blend over {2.0 * BLEND:g} m"]
    if not (_is_linked(before, road) or _is_linked(road, before)):
        return []
    limit = f"{100.0 * GAP:g} cm and {math.degrees(TURN):g} degrees"
    return [
        f"{misses}; the two are linked, but only up to {limit} are joined, so road {names[1]} is"
        " driven on its own"
    ]


def _is_linked(road: Element, other: Element) -> bool:
    """Return whether a road names another road, or its junction, as successor or predecessor."""
    ids = {"road": other.get("id", ""), "junction": other.get("junction", "-1")}
    return any(
        link.get("elementId") == ids.get(link.get("elementType", "road"))
        for link in road.findall("link/*")
        if link.tag in ("successor", "predecessor") and link.get("elementId") != "-1"
    )


def join_lines(before: FloatArray, joint: Joint) -> FloatArray:
    """Return the line (n, 10) of a lane and the lane that continues it, joined by a blend."""
    line, end = joint.line.copy(), before[-1].copy()
    gap = line[0, X:HEADING] - end[X:HEADING]
    # A blend at the joint before may have moved the end, and the line goes on from there.
    turn = math.remainder(line[0, HEADING] - end[HEADING], math.tau)
    normal = end[HEADING] + 0.5 * turn
    line[:, DISTANCE] += end[DISTANCE]
    line[:, HEADING] += end[HEADING] + turn - line[0, HEADING]
    row = len(before)
    line = np.concatenate([before, line[1:]])
    is_kink = abs(turn) > KINK
    if is_kink:
        # An arc of BLEND m on either side cuts the corner.
        p = np.clip(line[:, DISTANCE] - end[DISTANCE], -BLEND, BLEND)
        aside = turn * ((p**2 + BLEND**2) / (4.0 * BLEND) - 0.5 * np.abs(p))
        side = np.where(np.arange(len(line)) < row, 0.5, -0.5)
        slope = turn * np.where(np.abs(p) < BLEND, 0.5 * p / BLEND + side, 0.0)
        left = np.array([-math.sin(normal), math.cos(normal)])
        move_points(line, np.outer(aside, left), np.outer(slope, left))
    is_gap = float(np.hypot(*gap)) > MIN_DISTANCE
    if is_gap:
        close_gaps(line, [row], [tuple(gap.tolist())])
    if is_kink or is_gap:
        set_distances(line)
    return line
