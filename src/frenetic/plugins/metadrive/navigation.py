"""Navigation for MetaDrive's drivers along the ego lane of any road.

MetaDrive's own navigation needs maps of straight and circular lanes. This one cuts the ego lane
into pieces, and describes each piece by an arc that turns by the same angle.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from metadrive.component.navigation_module.base_navigation import BaseNavigation
from metadrive.component.pg_space import BlockParameterSpace, Parameter
from metadrive.engine.engine_utils import get_engine

from frenetic.plugins.metadrive.expert import PIECE_LENGTH, STRAIGHT_RADIUS
from frenetic.road import Road

EGO_LANE: Final = "ego"
"""Name of the ego lane in MetaDrive's map."""


class Piece(NamedTuple):
    """A piece of the ego lane, with a checkpoint at its end."""

    end: float
    """Distance of the piece's end along the ego lane, in m."""
    x: float
    """x of the checkpoint, relative to the road's first point, in m."""
    y: float
    """y of the checkpoint, relative to the road's first point, in m."""
    radius: float
    """Radius in m; 0 for a straight piece."""
    turn: float
    """Turn to the left in rad; 0 for a straight piece."""


def pieces_of(road: Road) -> list[Piece]:
    """Return the pieces of a road's ego lane, which are equally long on the road's centre line."""
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
    """Navigation module of a car, which MetaDrive makes, and updates after each step."""

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
        """Return the number of values of `get_navi_info`."""
        dimension: int = BaseNavigation.get_navigation_info_dim()
        return dimension

    def get_navi_info(self) -> Any:
        """Return five numbers 0..1 for the next checkpoint and five for the one after it, (10,)."""
        return self._info

    def get_current_lane_width(self) -> float:
        """Return the width of the ego lane, in m."""
        return self._width

    def get_current_lateral_range(self, position: Any, engine: Any) -> float:  # noqa: ARG002
        """Return the distance between the edges of the ego lane, in m."""
        return self._width

    def reset(self, vehicle: Any) -> None:  # noqa: ARG002
        """Follow the loaded road."""
        road = get_engine().map_manager.road
        self._width = road.lane_width
        self._pieces = pieces_of(road)
        self.current_lane = self.map.road_network.get_lane(EGO_LANE)
        self.current_ref_lanes = [self.current_lane]

    def update_localization(self, vehicle: Any) -> None:
        """Find the car on the ego lane, and describe the next two checkpoints."""
        s, _ = self.current_lane.local_coordinates(vehicle.position)
        last = len(self._pieces) - 1
        i = next((i for i, piece in enumerate(self._pieces) if piece.end > s), last)
        self._info[:5] = self._describe(self._pieces[i], vehicle)
        self._info[5:] = self._describe(self._pieces[min(i + 1, last)], vehicle)

    def _describe(self, piece: Piece, vehicle: Any) -> list[float]:
        """Return five numbers 0..1 of a piece, scaled as by MetaDrive's own navigation.

        They are the checkpoint's position ahead and to the side, and radius, side and angle of the
        piece.
        """
        reach = BaseNavigation.NAVI_POINT_DIST
        to_checkpoint = np.array([piece.x, piece.y]) - np.asarray(vehicle.position)
        distance = math.hypot(*to_checkpoint)
        if distance > reach:
            to_checkpoint *= reach / distance
        ahead, right = vehicle.convert_to_local_coordinates(to_checkpoint, 0.0)
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
        """Forget the lane, which is about to be destroyed with its map."""
        self.current_lane = self.current_ref_lanes = None

    def detach_from_world(self) -> None:
        """Do nothing: the module has no object in MetaDrive's world."""

    def destroy(self) -> None:
        """Forget the lane."""
        self.before_reset()
