"""The box that a road has to stay in."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from frenetic.bench.hosting.offered.self_driving.road_polygon import RoadPolygon, shapely_geometry


class RoadBoundingBox:
    """A rectangle that tells what meets its boundary.

    Args:
        bbox_size: least x, least y, largest x and largest y in m.

    Raises:
        FreneticError: From every method, if shapely is not installed.

    """

    def __init__(self, bbox_size: tuple[float, float, float, float]) -> None:
        self.bbox_size = bbox_size

    @cached_property
    def bbox(self) -> Any:
        """The rectangle, a Polygon."""
        return shapely_geometry().box(*self.bbox_size)

    def get_vertices(self) -> list[Any]:
        """Return the four corners, Points."""
        return [shapely_geometry().Point(place) for place in self._corners()]

    def get_sides(self) -> list[Any]:
        """Return the four sides, LineStrings."""
        corners = self._corners()
        return [shapely_geometry().LineString([corners[i - 1], corners[i]]) for i in range(4)]

    def contains(self, other: RoadPolygon) -> bool:
        """Return whether all of a road lies in the rectangle."""
        return bool(self.bbox.contains(other.polygon))

    def intersects_boundary(self, other: Any) -> bool:
        """Return whether a shapely object meets the rectangle's boundary."""
        return bool(other.intersects(self.bbox.boundary))

    def intersects_sides(self, point: Any) -> bool:
        """Return whether a shapely object meets one of the sides."""
        return any(point.intersects(side) for side in self.get_sides())

    def intersects_vertices(self, point: Any) -> bool:
        """Return whether a shapely object meets one of the corners."""
        return any(point.intersects(corner) for corner in self.get_vertices())

    def _corners(self) -> list[tuple[float, float]]:
        left, bottom, right, top = self.bbox_size
        return [(left, bottom), (right, bottom), (right, top), (left, top)]
