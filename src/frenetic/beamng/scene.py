"""A road for BeamNG.tech: nodes of decal roads on flat ground, and the place of the car."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road import Pose, Road

LEVELS: Final = {"tech_ground": 0.0, "smallgrid": 0.0, "gridmap_v2": 100.0}
"""Levels with room for a flat map -> m, height of their ground."""
MARKING_WIDTH: Final = 0.15
"""Width of the lines along the road's edges, in m."""
DROP: Final = 0.2
"""Distance above the ground at which the car is put, in m; it settles before the drive begins."""
WIDEST_AI_LANE: Final = 6.3
"""Least width of a lane that BeamNG.AI takes for two, in m."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A road on flat ground and a car at its beginning."""

    centre: FloatArray
    """The centre line at 2 m or denser, (n, 2) in m."""
    edges: tuple[FloatArray, FloatArray]
    """Left and right edge marking, (n, 2) in m each."""
    width: float
    """Width of the road, in m: two lanes."""
    ground: float
    """Height of the ground, in m."""
    start: tuple[float, float]
    """Place of the car's position, which need not be its middle, in m."""
    heading: float
    """Heading of the car at the start, in rad."""

    def nodes(self, line: FloatArray) -> list[tuple[float, float, float]]:
        """A line as nodes on the ground."""
        return [(float(x), float(y), self.ground) for x, y in line]

    @property
    def position(self) -> tuple[float, float, float]:
        """Place of the car's position, a little above the ground."""
        return (*self.start, self.ground + DROP)

    @property
    def rotation(self) -> tuple[float, float, float, float]:
        """The car's rotation as a quaternion (x, y, z, w), which faces -y unless it is turned."""
        half = 0.5 * math.atan2(-math.cos(self.heading), -math.sin(self.heading))
        return 0.0, 0.0, math.sin(half), math.cos(half)


def scene_of(road: Road, ground: float, ahead: float, left: float) -> Scene:
    """A road with the middle of the car on the ego lane's centre at its first point.

    Args:
        road: has the same place on the map and in BeamNG.tech.
        ground: m, height of the ground.
        ahead, left: m by which the middle of the car's box lies ahead and left of its position.
    """
    x, y, heading = ego_start(road)
    c, s = math.cos(heading), math.sin(heading)
    inset = road.lane_width - MARKING_WIDTH
    return Scene(
        centre=road.road_points,
        edges=(road.sample(offset=inset), road.sample(offset=-inset)),
        width=2.0 * road.lane_width,
        ground=ground,
        start=(x - ahead * c + left * s, y - ahead * s - left * c),
        heading=heading,
    )


def ego_start(road: Road) -> Pose:
    """Place of the car's middle at the start of a drive."""
    pose = road.pose_at(0.0)
    half = 0.5 * road.lane_width
    return Pose(
        pose.x + half * math.sin(pose.heading), pose.y - half * math.cos(pose.heading), pose.heading
    )


def open_field() -> Road:
    """A straight road on which a car is measured."""
    return Road(np.zeros(13), pose=Pose(40.0, 100.0, 0.0))
