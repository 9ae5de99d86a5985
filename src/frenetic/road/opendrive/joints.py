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
"""Largest change of heading from the end of a road to the start of the next, in rad; our choice."""


@dataclass(frozen=True)
class Joint:
    """A lane that could continue the lane of another road."""

    line: FloatArray
    """Traced line (n, 10) of the lane."""
    gap: float
    """Distance from the end of the other lane to the start of this lane, in m."""
    turn: float
    """Change of heading from the end of the other lane to the start of this lane, in rad."""

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
    """Return the lane of a road that could continue a lane best; None if no lane can be read.

    Lanes that are near enough to be joined come first, then the nearest start.

    Args:
        road: the road.
        end: last row of the traced line of the lane to be continued, (10,).
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
    """Return notes about a gap between two roads; empty if they meet, or if they are not linked.

    Args:
        before: the first road.
        road: the road that could continue it.
        joint: the lane of the second road that continues the first road best, if any.
    """
    if joint is None:
        return []
    first_id, second_id = (
        shortened(quoted_id(element.get("id", ""))) for element in (before, road)
    )
    gap = f"road {second_id} begins {joint.text} off the end of road {first_id}"
    if joint.is_joined:
        is_exact = joint.gap <= TOLERANCE and abs(joint.turn) <= KINK
        return [] if is_exact else [f"{gap}: joined by a blend over {2.0 * BLEND:g} m"]
    if not (_is_linked(before, road) or _is_linked(road, before)):
        return []
    limit = f"{100.0 * GAP:g} cm and {math.degrees(TURN):g} degrees"
    return [
        f"{gap}; the two are linked, but only up to {limit} are joined, so road {second_id} is"
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
    """Return the traced line (n, 10) of a lane and the lane that continues it, joined by a blend.

    Args:
        before: traced line of the lane, (m, 10).
        joint: the lane that continues it.
    """
    line, end = joint.line.copy(), before[-1].copy()
    # Gap and turn are computed again: a blend at the joint before may have moved the end.
    gap = line[0, X:HEADING] - end[X:HEADING]
    turn = math.remainder(line[0, HEADING] - end[HEADING], math.tau)
    normal = end[HEADING] + 0.5 * turn
    line[:, DISTANCE] += end[DISTANCE]
    line[:, HEADING] += end[HEADING] + turn - line[0, HEADING]
    row = len(before)
    line = np.concatenate([before, line[1:]])
    is_kink = abs(turn) > KINK
    if is_kink:
        # Cut the corner by an arc over BLEND m on either side: move each point by `aside` along the
        # middle of the two normals.
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
