"""The ego lane's centre line in the car's frame, at any distances from the car."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, sine
from frenetic.road import Road
from frenetic.road.geometry import frame_at, heading_at
from frenetic.road.profile import value_at


@dataclass(frozen=True, eq=False)
class Lane:
    """The ego lane's centre line at n points, as `Observation.lane` returns it."""

    distances: FloatArray
    """Distance along the road from the car, (n,) in m: 0 beside the car, negative behind it."""
    points: FloatArray
    """Points in the car's frame, (n, 2) in m: x ahead, y to the left of the centre of mass."""
    headings: FloatArray
    """Heading of the lane minus heading of the car, (n,) in rad, positive to the left; without
    jumps by a full turn."""
    curvatures: FloatArray
    """Curvature of the lane, (n,) in 1/m, positive turns left."""
    grades: FloatArray
    """Slope along the road, (n,) in m/m, positive rises."""
    superelevations: FloatArray
    """Slope across the road, (n,) in m/m, positive falls to the right."""


def lane_of(
    road: Road,
    distance: float,
    lateral_offset: float,
    heading_error: float,
    distances: FloatArray,
) -> Lane:
    """Return the ego lane of a road, seen from a car.

    Args:
        road: the road.
        distance, lateral_offset, heading_error: the car's position in the lane, see `Observation`.
        distances: distances along the road from the car, (n,) in m.
    """
    points, headings, curvatures = _lane(
        road.table,
        road.sub_step,
        -0.5 * road.lane_width,
        float(distance),
        float(lateral_offset),
        float(heading_error),
        distances,
    )
    stations = distance + distances
    grades = value_at(road.grade, stations)
    superelevations = value_at(road.superelevation, stations)
    for values in (distances, points, headings, curvatures, grades, superelevations):
        values.setflags(write=False)
    return Lane(distances, points, headings, curvatures, grades, superelevations)


@njit(interpret_first=0.4)
def _lane(
    table: FloatArray,
    ds: float,
    offset: float,
    s: float,
    left: float,
    turned: float,
    distances: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points, headings and curvatures of a line beside the centre line, from a car.

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        offset: distance of the line to the left of the centre line, in m.
        s: distance of the car along the road, in m.
        left: distance of the car to the left of the line, in m.
        turned: heading of the car minus heading of the road, in rad.
        distances: distances from the car along the road, (n,) in m.
    """
    n = len(distances)
    points, headings, curvatures = np.empty((n, 2)), np.empty(n), np.empty(n)
    x, y, lane_c, lane_s, _ = frame_at(table, ds, s)
    x -= (offset + left) * lane_s
    y += (offset + left) * lane_c
    heading = heading_at(table, ds, s) + turned
    c, w = cosine(heading), sine(heading)
    for i in range(n):
        at = s + distances[i]
        px, py, lane_c, lane_s, kappa = frame_at(table, ds, at)
        px -= offset * lane_s + x
        py += offset * lane_c - y
        points[i, 0] = c * px + w * py
        points[i, 1] = c * py - w * px
        headings[i] = heading_at(table, ds, at) - heading
        # The parallel of an arc is an arc about the same centre. Near the centre, the curvature is
        # kept below 20 kappa.
        curvatures[i] = kappa / max(1.0 - offset * kappa, 0.05)
    return points, headings, curvatures
