"""Orientation of a road, the same in all pictures."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road import Road, profile

_SPACING: Final = 4.0  # [m], between points of an edge, ours
_MOST_POINTS: Final = 2000  # points of an edge, ours
_TURNS: Final = np.radians(np.arange(-90.0, 90.0))  # [rad], tried angles


def turned(points: FloatArray, turn: float) -> FloatArray:
    """Turn points, (n, 2), counter-clockwise around the origin by ``turn`` rad."""
    c, s = math.cos(turn), math.sin(turn)
    result: FloatArray = points @ np.array([[c, s], [-s, c]])
    return result


def edge_of(road: Road, spacing: float, side: float) -> FloatArray:
    """Return points of a road's outer edge, left (side 1) or right (side -1), (n, 2) in m.

    The points are about ``spacing`` m apart.
    """
    if not len(road.widening):
        return road.sample(spacing, side * road.lane_width)
    middle, beside = road.sample(spacing), road.sample(spacing, side)
    widths = road.lane_width + profile.value_at(road.widening, road.distances(spacing))
    points: FloatArray = middle + widths[:, None] * (beside - middle)
    return points


def edges_of(road: Road, spacing: float) -> FloatArray:
    """Return points of both outer edges of a road, about ``spacing`` m apart, (n, 2) in m."""
    return np.vstack([edge_of(road, spacing, side) for side in (1.0, -1.0)])


def turn_of(road: Road) -> float:
    """Return the angle in rad by which pictures turn a road counter-clockwise, 0 <= angle < 2 pi.

    The road lies as flat as it can, and its end is right of its start. The angle depends on the
    road alone, so a road looks alike in all pictures, whatever their shape and whoever drove.
    """
    spacing = max(_SPACING, road.length / _MOST_POINTS)
    heights = np.ptp(edges_of(road, spacing) @ np.vstack([np.sin(_TURNS), np.cos(_TURNS)]), axis=0)
    flat = float(_TURNS[int(np.argmin(heights))])
    start, end = turned(np.array([road.pose_at(s)[:2] for s in (0.0, road.length)]), flat)
    return (flat if start[0] <= end[0] else flat + math.pi) % (2.0 * math.pi)
