"""A road's area."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from frenetic.bench.hosting.offered.self_driving.road_points import Node, Place, RoadPoints
from frenetic.bench.hosting.validity import validity
from frenetic.errors import FreneticError


class RoadPolygon:
    """Areas of a road and its lanes, as shapely objects that are made on use.

    Args:
        road_points: the road's middle and edges.

    Raises:
        FreneticError: From methods that need shapely, if it is not installed.

    """

    def __init__(self, road_points: RoadPoints) -> None:
        self.road_points = road_points

    @classmethod
    def from_nodes(cls, nodes: Iterable[Node]) -> RoadPolygon:
        """Return the area of a road whose nodes are x, y, height and width in m.

        Raises:
            RoadError: There are fewer than two nodes, or they are no such numbers.

        """
        return cls(RoadPoints.from_nodes(nodes))

    def is_valid(self) -> bool:
        """Return whether the road does not overlap itself.

        Of the quadrilaterals between consecutive nodes, each must be a valid polygon, two that are
        not neighbours must not touch, and neighbours must share only their common edge.
        """
        points = self.road_points
        if not points.moves:
            return False
        return not validity().overlaps_itself(np.array(points.left), np.array(points.right))

    @cached_property
    def polyline(self) -> Any:
        """The middle of the road, a LineString."""
        return shapely_geometry().LineString(self.road_points.middle)

    @cached_property
    def right_polyline(self) -> Any:
        """The middle of the right-hand lane, a LineString."""
        return _between(self.road_points.middle, self.road_points.right)

    @cached_property
    def left_polyline(self) -> Any:
        """The middle of the left-hand lane, a LineString."""
        return _between(self.road_points.left, self.road_points.middle)

    @cached_property
    def polygon(self) -> Any:
        """The road, a Polygon."""
        return _strip(self.road_points.left, self.road_points.right)

    @cached_property
    def right_polygon(self) -> Any:
        """The right-hand lane, a Polygon."""
        return _strip(self.road_points.middle, self.road_points.right)

    @cached_property
    def left_polygon(self) -> Any:
        """The left-hand lane, a Polygon."""
        return _strip(self.road_points.left, self.road_points.middle)

    @cached_property
    def polygons(self) -> list[Any]:
        """The pieces of the road between consecutive nodes, Polygons."""
        left, right = self.road_points.left, self.road_points.right
        return [_strip(left[i : i + 2], right[i : i + 2]) for i in range(len(left) - 1)]

    @property
    def num_polygons(self) -> int:
        """Number of pieces of the road."""
        return len(self.road_points.middle) - 1


def _strip(left: Sequence[Place], right: Sequence[Place]) -> Any:
    return shapely_geometry().Polygon([*left, *reversed(right)])


def _between(left: Sequence[Place], right: Sequence[Place]) -> Any:
    return shapely_geometry().LineString(0.5 * (np.array(left) + np.array(right)))


def shapely_geometry() -> Any:
    """Return the module `shapely.geometry`.

    Raises:
        FreneticError: It is not installed.

    """
    try:
        import shapely.geometry  # an extra
    except ImportError:
        raise FreneticError(
            "a generator asks for a shapely object: pip install shapely for the interpreter that"
            " runs it"
        ) from None
    return shapely.geometry
