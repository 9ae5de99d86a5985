"""The road that follows a lane's traced line."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import geometry, profile
from frenetic.road.from_points import CORRECTION, follow_line
from frenetic.road.opendrive.traced_line import (
    DISTANCE,
    HEADING,
    HEIGHT,
    LEAN,
    LIMIT,
    MOVED_X,
    TOLERANCE,
    WIDTH,
    X,
    Y,
)
from frenetic.road.road import Road
from frenetic.road.road_values import MAX_CURVATURE, MAX_SAMPLES, Pose

STEPS: Final = (0.5, 0.25, 0.1)
"""Steps of a road that follows a line, in m, in the order in which they are tried; our choice."""
SAME_WIDTH: Final = 0.01
"""Largest change of a lane's width that is ignored, in m; our choice."""
MIN_WIDTH: Final = 2.0
"""Width of the narrowest lane that is driven, in m; our choice."""
SAMPLE_DISTANCE: Final = 1.0
"""Distance between the stations at which slopes and widths are read, in m; our choice."""
SLOPE_ERROR: Final = 1e-4
"""Largest error of the slopes of a road that was read, in m/m; our choice."""
WIDTH_ERROR: Final = 1e-3
"""Largest error of the widths of a road that was read, in m; our choice."""
_STEPS_ROUNDING: Final = 1e-9
"""Number of steps by which a computed number may exceed a whole number; our choice."""


def road_along(line: FloatArray) -> Road:
    """Return the road along a lane's traced line (n, 10), with slopes, widths and speed limits.

    Raises:
        RoadError: the lane is too narrow, or no road stays within `TOLERANCE` of the line.
    """
    length = float(line[-1, DISTANCE])
    stations = np.append(np.arange(0.0, length, SAMPLE_DISTANCE), length)
    width, height, lean = (
        np.interp(stations, line[:, DISTANCE], line[:, column]) for column in (WIDTH, HEIGHT, LEAN)
    )
    narrowest = int(np.argmin(width))
    lane_width = float(width[narrowest])
    if lane_width < MIN_WIDTH:
        raise RoadError(
            f"its lane is {lane_width:.2f} m wide at {stations[narrowest]:.0f} m: at least"
            f" {MIN_WIDTH:g} m are needed; choose another lane, or a part of the road"
        )
    widening = width - lane_width if np.ptp(width) > SAME_WIDTH else np.zeros_like(width)
    shapes = (
        ("superelevation", lean, SLOPE_ERROR),
        ("grade", np.gradient(height, stations), SLOPE_ERROR),
        ("widening", widening, WIDTH_ERROR),
    )
    profiles: dict[str, Any] = {
        name: profile.simplified(np.column_stack([stations, values]), error)
        for name, values, error in shapes
        if np.abs(values).max() > error
    }
    if line[1:, LIMIT].any():
        steps = np.column_stack([line[:-1, DISTANCE], line[1:, LIMIT]])
        profiles[profile.LIMITS] = profile.merged(steps)
    return replace(_flat_road(line, lane_width), **profiles)


def _flat_road(line: FloatArray, lane_width: float) -> Road:
    """Return the flat road along a traced line, with the first of `STEPS` that is near enough.

    Raises:
        RoadError: no road stays within `TOLERANCE` of the line.
    """
    length = float(line[-1, DISTANCE])
    start = Pose(*(float(value) for value in line[0, X : HEADING + 1]))
    drawn = line[:, X:HEADING] - line[:, MOVED_X:WIDTH]  # the positions in the file
    least_offset, station = math.inf, 0.0  # of the nearest road at its farthest point
    for spacing in STEPS:
        pieces = min(max(2, math.ceil(length / spacing - _STEPS_ROUNDING)), MAX_SAMPLES - 1)
        curvatures = _curvatures_along(line, pieces)
        if np.abs(curvatures).max() > MAX_CURVATURE:
            continue
        road = Road(curvatures, length / pieces, start, lane_width=lane_width)
        offsets = np.abs(geometry.offsets_near(road.table, road.sub_step, drawn, line[:, DISTANCE]))
        farthest = int(np.argmax(offsets))
        if offsets[farthest] <= TOLERANCE:
            return road
        if offsets[farthest] < least_offset:
            least_offset, station = float(offsets[farthest]), float(line[farthest, DISTANCE])
    if math.isinf(least_offset):
        raise RoadError(
            f"no road can follow its line, which bends by more than {MAX_CURVATURE:g} 1/m"
        )
    raise RoadError(
        f"no road can follow its line: the nearest lies {least_offset:.4f} m beside it"
        f" {station:.2f} m along, and at most {TOLERANCE:g} m is allowed"
    )


def _curvatures_along(line: FloatArray, pieces: int) -> FloatArray:
    """Return the curvatures (pieces + 1,) in 1/m of a road that follows a traced line."""
    distances, headings = line[:, DISTANCE], line[:, HEADING]
    length = float(distances[-1])
    step = length / pieces
    samples = np.arange(pieces + 1) * step
    x, y, heading = (np.interp(samples, distances, line[:, column]) for column in (X, Y, HEADING))
    # The mean curvature over a step around each sample: where the curvature jumps, its value at a
    # single point says little.
    low, high = np.maximum(samples - 0.5 * step, 0.0), np.minimum(samples + 0.5 * step, length)
    turns = np.interp(high, distances, headings) - np.interp(low, distances, headings)
    curvatures: FloatArray = follow_line(
        np.column_stack([x, y, heading, turns / (high - low)]), step, max(CORRECTION, 4.0 * step)
    )
    return curvatures
