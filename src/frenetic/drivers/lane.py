"""The ego lane's centre line in the car's frame, at any distances."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road import Road
from frenetic.road.geometry import frame_at, heading_at
from frenetic.road.profile import value_at


@dataclass(frozen=True, eq=False)
class Lane:
    """The ego lane's centre line as a driver sees it, by `Observation.lane`; arrays of n points."""

    distances: FloatArray
    """Distance along the road from the car, (n,) in m: 0 abreast of it, negative behind."""
    points: FloatArray
    """Points in the car's frame, (n, 2) in m: x ahead, y to the left of the centre of mass."""
    headings: FloatArray
    """Direction of the lane less the car's, (n,) in rad, positive to the left; continuous."""
    curvatures: FloatArray
    """Curvature of the lane, (n,) in 1/m, positive turns left."""
    grades: FloatArray
    """Slope along the road, (n,) in m/m, positive rises; 0 on a flat road, as below."""
    superelevations: FloatArray
    """Slope across the road, (n,) in m/m, positive falls to the right."""


def lane_of(
    road: Road,
    distance: float,
    lateral_offset: float,
    heading_error: float,
    distances: FloatArray,
) -> Lane:
    """Return the lane of a road for a car at a place in it, see `Observation`."""
    points, headings, curvatures = _lane(
        road.table,
        road.sub_step,
        -0.5 * road.lane_width,
        float(distance),
        float(lateral_offset),
        float(heading_error),
        distances,
    )
    places = distance + distances
    grades, superelevations = (
        value_at(slope, places) for slope in (road.grade, road.superelevation)
    )
    for values in (distances, points, headings, curvatures, grades, superelevations):
        values.setflags(write=False)
    return Lane(distances, points, headings, curvatures, grades, superelevations)


@njit()
def _lane(
    table: FloatArray,
    ds: float,
    offset: float,
    s: float,
    left: float,
    turned: float,
    distances: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points, headings and curvatures of a line ``offset`` m left of the centre line.

    The car is at ``s``, ``left`` m left of that line and turned by ``turned`` rad.
    """
    n = len(distances)
    points, headings, curvatures = np.empty((n, 2)), np.empty(n), np.empty(n)
    x, y, cosine, sine, _ = frame_at(table, ds, s)
    x -= (offset + left) * sine
    y += (offset + left) * cosine
    heading = heading_at(table, ds, s) + turned
    c, w = math.cos(heading), math.sin(heading)
    for i in range(n):
        at = s + distances[i]
        px, py, cosine, sine, kappa = frame_at(table, ds, at)
        px -= offset * sine + x
        py += offset * cosine - y
        points[i, 0] = c * px + w * py
        points[i, 1] = c * py - w * px
        headings[i] = heading_at(table, ds, at) - heading
        # A parallel of an arc is an arc about the same centre.
        curvatures[i] = kappa / max(1.0 - offset * kappa, 0.05)
    return points, headings, curvatures
