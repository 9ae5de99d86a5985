"""Navigation along a road for MetaDrive's drivers.

MetaDrive's own navigation follows maps of straight and circular lanes. This one cuts the ego lane
of any road into pieces and describes each by the arc that turns as far.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from metadrive.component.navigation_module.base_navigation import BaseNavigation
from metadrive.component.pg_space import BlockParameterSpace, Parameter
from metadrive.engine.engine_utils import get_engine

from frenetic.road import Road

EGO_LANE: Final = "ego"
"""The name of the ego lane in MetaDrive's map."""
PIECE_LENGTH: Final = 40.0
"""Approximate length of a piece, in m; MetaDrive's own maps have lanes of 40 m and more."""
STRAIGHT_RADIUS: Final = 200.0
"""Least radius of an arc that is called straight, in m."""


class Piece(NamedTuple):
    """A piece of the ego lane, with the checkpoint at its end."""

    end: float
    """Distance along the ego lane, in m."""
    x: float
    """Coordinate of the checkpoint in m, seen from the road's start, as y."""
    y: float
    """m."""
    radius: float
    """Radius in m, 0 if it is straight."""
    turn: float
    """Turn to the left in rad, 0 if it is straight."""


def pieces_of(road: Road) -> list[Piece]:
    """The ego lane cut into pieces, equally long on the centre line."""
    count = max(1, round(road.length / PIECE_LENGTH))
    offset = -0.5 * road.lane_width
    pieces = []
    end = 0.0
    for i in range(count):
        before = road.pose_at(road.length * i / count)
        after = road.pose_at(road.length * (i + 1) / count)
        turn = after.heading - before.heading
        # A parallel on the right is longer where the road turns left.
        length = road.length / count - offset * turn
        end += length
        radius = length / abs(turn) if turn else math.inf
        is_straight = radius > STRAIGHT_RADIUS
        pieces.append(
            Piece(
                end,
                after.x - offset * math.sin(after.heading) - road.pose.x,
                after.y + offset * math.cos(after.heading) - road.pose.y,
                0.0 if is_straight else radius,
                0.0 if is_straight else turn,
            )
        )
    return pieces


class RoadNavigation:
    """A car's navigation module for its road; MetaDrive makes and updates it."""

    def __init__(self, **_options: Any) -> None:
        self.current_lane: Any = None
        self.current_ref_lanes: list[Any] | None = None
        self.next_ref_lanes = None
        self._pieces: list[Piece] = []
        self._width = 0.0
        self._info = np.zeros(self.get_navigation_info_dim(), dtype=np.float32)

    @property
    def map(self) -> Any:
        """MetaDrive's map of the road."""
        return get_engine().map_manager.current_map

    @classmethod
    def get_navigation_info_dim(cls) -> int:
        """Numbers in `get_navi_info`."""
        dimension: int = BaseNavigation.get_navigation_info_dim()
        return dimension

    def get_navi_info(self) -> Any:
        """Numbers 0..1, (10,): five for the checkpoint ahead and five for the one after it."""
        return self._info

    def get_current_lane_width(self) -> float:
        """Width of the ego lane, in m."""
        return self._width

    def get_current_lateral_range(self, position: Any, engine: Any) -> float:  # noqa: ARG002
        """Distance from the left edge of the ego lane to the right one, in m."""
        return self._width

    def reset(self, vehicle: Any) -> None:  # noqa: ARG002
        """Follows the loaded road."""
        road = get_engine().map_manager.road
        self._width = road.lane_width
        self._pieces = pieces_of(road)
        self.current_lane = self.map.road_network.get_lane(EGO_LANE)
        self.current_ref_lanes = [self.current_lane]

    def update_localization(self, vehicle: Any) -> None:
        """Looks for the car's place and the checkpoints ahead of it."""
        s, _ = self.current_lane.local_coordinates(vehicle.position)
        last = len(self._pieces) - 1
        i = next((i for i, piece in enumerate(self._pieces) if piece.end > s), last)
        self._info[:5] = self._describe(self._pieces[i], vehicle)
        self._info[5:] = self._describe(self._pieces[min(i + 1, last)], vehicle)

    def _describe(self, piece: Piece, vehicle: Any) -> list[float]:
        """Five numbers 0..1, as MetaDrive's own navigation scales them."""
        reach = BaseNavigation.NAVI_POINT_DIST
        away = np.array([piece.x, piece.y]) - np.asarray(vehicle.position)
        distance = math.hypot(*away)
        if distance > reach:
            away *= reach / distance
        ahead, right = vehicle.convert_to_local_coordinates(away, 0.0)
        curve = BlockParameterSpace.CURVE
        largest = curve[Parameter.radius].max + self._width
        direction = -math.copysign(1.0, piece.turn) if piece.turn else 0.0
        angle = math.degrees(abs(piece.turn)) / curve[Parameter.angle].max
        scaled = [
            (ahead / reach + 1.0) / 2.0,
            (right / reach + 1.0) / 2.0,
            piece.radius / largest,
            (direction + 1.0) / 2.0,
            (angle + 1.0) / 2.0,
        ]
        return [min(max(value, 0.0), 1.0) for value in scaled]

    def before_reset(self) -> None:
        """Forgets the lane, which is about to be destroyed with its map."""
        self.current_lane = self.current_ref_lanes = None

    def detach_from_world(self) -> None:
        """Removes nothing: it has no part in the world."""

    def destroy(self) -> None:
        """Forgets the lane."""
        self.before_reset()
