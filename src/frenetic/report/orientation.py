"""Orientation of roads in pictures, and the points of their edges."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road import Road, profile

_EDGE_SPACING: Final = 4.0  # [m] between points of an edge; our choice
_MAX_EDGE_POINTS: Final = 2000  # points of an edge; our choice
_TRIED_TURNS: Final = np.radians(np.arange(-90.0, 90.0))  # [rad], degree by degree


def turned(points: FloatArray, turn: float) -> FloatArray:
    """Return points, (n, 2), turned counter-clockwise around the origin by ``turn`` rad."""
    cosine, sine = math.cos(turn), math.sin(turn)
    result: FloatArray = points @ np.array([[cosine, sine], [-sine, cosine]])
    return result


def edge_of(road: Road, spacing: float, side: float) -> FloatArray:
    """Return points of an outer edge of a road, (n, 2) in m.

    Args:
        road: the road.
        spacing: approximate distance between two points, in m.
        side: 1 for the left edge, -1 for the right edge.
    """
    if not len(road.widening):
        return road.sample(spacing, side * road.lane_width)
    centre_line, one_metre_out = road.sample(spacing), road.sample(spacing, side)
    widths = road.lane_width + profile.value_at(road.widening, road.distances(spacing))
    points: FloatArray = centre_line + widths[:, None] * (one_metre_out - centre_line)
    return points


def edges_of(road: Road, spacing: float) -> FloatArray:
    """Return points of both outer edges of a road, about ``spacing`` m apart, (n, 2) in m."""
    return np.vstack([edge_of(road, spacing, side) for side in (1.0, -1.0)])


def turn_of(road: Road) -> float:
    """Return the angle by which pictures turn a road counter-clockwise, in rad, 0 <= angle < 2 pi.

    The turned road takes the least height, and its end is right of its start. The angle depends on
    the road alone, so the road looks alike in all pictures and with all drivers.
    """
    spacing = max(_EDGE_SPACING, road.length / _MAX_EDGE_POINTS)
    heights = np.ptp(
        edges_of(road, spacing) @ np.vstack([np.sin(_TRIED_TURNS), np.cos(_TRIED_TURNS)]), axis=0
    )
    flat = float(_TRIED_TURNS[int(np.argmin(heights))])
    start, end = turned(
        np.array([road.pose_at(distance)[:2] for distance in (0.0, road.length)]), flat
    )
    return (flat if start[0] <= end[0] else flat + math.pi) % (2.0 * math.pi)
