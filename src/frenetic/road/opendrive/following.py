"""Roads that follow a lane's traced line."""

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
"""Steps of a road that follows a line, in m, in the order in which they are tried; ours."""
SAME_WIDTH: Final = 0.01
"""Largest change of a lane's width that is ignored, in m; ours."""
MIN_WIDTH: Final = 2.0
"""Width of the narrowest lane that is driven, in m; ours."""
SAMPLE_DISTANCE: Final = 1.0
"""Distance between the places at which slopes and widths are read, in m; ours."""
SLOPE_ERROR: Final = 1e-4
"""Largest error of the slopes of a road that was read, in m/m; ours."""
WIDTH_ERROR: Final = 1e-3
"""Largest error of the widths of a road that was read, in m; ours."""


def road_along(line: FloatArray) -> Road:
    """Return the road along a lane's line (n, 10), with slopes, widths and speed limits.

    Raises:
        RoadError: the lane is too narrow, or no road stays within `TOLERANCE` of the line.
    """
    length = float(line[-1, DISTANCE])
    places = np.append(np.arange(0.0, length, SAMPLE_DISTANCE), length)
    columns = line[:, WIDTH:LIMIT].T
    width, height, lean = (np.interp(places, line[:, DISTANCE], values) for values in columns)
    narrowest = int(np.argmin(width))
    lane_width = float(width[narrowest])
    if lane_width < MIN_WIDTH:
        raise RoadError(
            f"its lane is {lane_width:.2f} m wide at {places[narrowest]:.0f} m: at least"
            f" {MIN_WIDTH:g} m are needed; choose another lane, or a part of the road"
        )
    wider = width - lane_width if np.ptp(width) > SAME_WIDTH else np.zeros_like(width)
    shapes = (
        ("superelevation", lean, SLOPE_ERROR),
        ("grade", np.gradient(height, places), SLOPE_ERROR),
        ("widening", wider, WIDTH_ERROR),
    )
    profiles: dict[str, Any] = {
        name: profile.simplified(np.column_stack([places, values]), error)
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
    start = Pose(*(float(v) for v in line[0, X : HEADING + 1]))
    drawn = line[:, X:HEADING] - line[:, MOVED_X:WIDTH]  # as the file has it
    nearest, where = math.inf, 0.0
    for spacing in STEPS:
        samples = min(max(2, math.ceil(length / spacing - 1e-9)), MAX_SAMPLES - 1) + 1
        step = length / (samples - 1)
        at = np.arange(samples) * step
        x, y, heading = (np.interp(at, line[:, DISTANCE], line[:, k]) for k in (X, Y, HEADING))
        # Mean curvature around each sample: where the curvature jumps, its value at a point means
        # little.
        low, high = np.maximum(at - 0.5 * step, 0.0), np.minimum(at + 0.5 * step, length)
        turned = np.interp(high, line[:, DISTANCE], line[:, HEADING])
        turned -= np.interp(low, line[:, DISTANCE], line[:, HEADING])
        curvatures = follow_line(
            np.column_stack([x, y, heading, turned / (high - low)]),
            step,
            max(CORRECTION, 4.0 * step),
        )
        if np.abs(curvatures).max() > MAX_CURVATURE:
            continue
        road = Road(curvatures, step, start, lane_width=lane_width)
        aside = np.abs(geometry.offsets_near(road.table, road.sub_step, drawn, line[:, DISTANCE]))
        farthest = int(np.argmax(aside))
        if aside[farthest] <= TOLERANCE:
            return road
        if aside[farthest] < nearest:
            nearest, where = float(aside[farthest]), float(line[farthest, DISTANCE])
    if math.isinf(nearest):
        raise RoadError(
            f"no road can follow its line, which bends by more than {MAX_CURVATURE:g} 1/m"
        )
    raise RoadError(
        f"no road can follow its line: the nearest lies {nearest:.4f} m beside it {where:.2f} m"
        f" along, and at most {TOLERANCE:g} m is allowed"
    )
