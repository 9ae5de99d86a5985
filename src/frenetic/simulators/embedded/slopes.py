"""The road's plane under the car: how it is tilted, and what of gravity acts in it and across it.

The road's height over the map is its centre line's; to the left it rises by the superelevation e.
A car lies in the plane that touches the road under its centre of mass. With the height's gradient
there, p ahead of the car and q to the left, its second derivatives H, S = sqrt(1 + p²),
N = sqrt(1 + p² + q²), the speeds v_x, v_y and the yaw rate r in the plane and the velocity u on the
map,

- gravity pulls by -g p / S ahead and by -g q / (N S) to the left,
- the load on the tyres per mass is (g + u H u) / N: a crest takes some, a dip and a bend that is
  banked to its inside give some, and
- u = (v_x / S - v_y p q / (N S), v_y S / N), and the heading turns by r S² / N - q (H u)_x / N².

That is exact for a mass that slides on the road; the car's own rolling and pitching take no part.
"""

from __future__ import annotations

import math
from typing import Final

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road.classes import GRAVITY
from frenetic.road.geometry import CURVATURE, frame_at, heading_at, project_near, reach_of
from frenetic.simulators.embedded.single_track import (
    HEADING,
    LATERAL_SPEED,
    SPEED,
    YAW_RATE,
    X,
    Y,
    on_map,
)
from frenetic.simulators.embedded.vehicle import (
    ACROSS,
    AHEAD,
    IS_TILTED,
    LEAST_ACCELERATION,
    LEFT,
    MOST_ACCELERATION,
    PULL_AHEAD,
    PULL_LEFT,
    ROLLING_DRAG,
    SKEW,
    TURN,
    TWIST,
)

LEAST_LOAD: Final = 1e-6
"""Least load per weight, on a crest where a car would take off; here it stays on the road."""


@njit(error_model="numpy")
def _height_at(
    table: FloatArray, ds: float, slopes: FloatArray, s: float, d: float
) -> tuple[float, float, float, float]:
    """Return the height's derivatives along the road (s) and across it (d): z_s, z_d, z_ss, z_sd.

    Args:
        table, ds: The road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`.
        s: m along the road.
        d: m to the left of the centre line.

    """
    # The road there, and its rates along it; beyond its ends nothing changes.
    last = len(slopes) - 1
    i = min(max(int(s / ds), 0), last - 1)
    t = min(max(s / ds - i, 0.0), 1.0)
    e_rate = (slopes[i + 1, 0] - slopes[i, 0]) / ds
    grade_rate = (slopes[i + 1, 1] - slopes[i, 1]) / ds
    kappa_rate = (table[i + 1, CURVATURE] - table[i, CURVATURE]) / ds
    e = slopes[i, 0] + t * ds * e_rate
    grade = slopes[i, 1] + t * ds * grade_rate
    kappa = table[i, CURVATURE] + t * ds * kappa_rate
    if not 0.0 <= s <= last * ds:
        e_rate = grade_rate = kappa_rate = kappa = 0.0

    # Gradient and second derivatives of the height at d.
    shrunk = max(1.0 - kappa * d, 0.05)  # of a metre of centre line
    grade = (grade + e_rate * d) / shrunk
    z_ss = ((grade_rate + grade * kappa_rate * d) / shrunk - e * kappa) / shrunk
    z_sd = (e_rate + grade * kappa) / shrunk
    return grade, e, z_ss, z_sd


@njit(error_model="numpy")
def lay(
    p: FloatArray,
    table: FloatArray,
    ds: float,
    slopes: FloatArray,
    state: FloatArray,
    s: float,
    seconds: float,
) -> tuple[FloatArray, float]:
    """Return a car's parameters on the road under it, and its place along the road in m.

    Args:
        p: `Vehicle.to_array()`.
        table, ds: The road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`, not of a flat road.
        state: (7,).
        s: m, a place of the car some time ago.
        seconds: s for which the parameters hold; slopes are taken in the middle of them.

    """
    v_x, v_y = state[SPEED], state[LATERAL_SPEED]
    reach = reach_of(0.1 * math.hypot(v_x, v_y))
    s, d = project_near(table, ds, state[X], state[Y], s, reach)
    turned = state[HEADING] - heading_at(table, ds, s)

    # Place and direction of the car when half the time has passed.
    half = 0.5 * seconds
    kappa = frame_at(table, ds, s)[4]
    along = v_x * math.cos(turned) - v_y * math.sin(turned)
    along /= max(1.0 - kappa * d, 0.05)
    middle = s + half * along
    d += half * (v_x * math.sin(turned) + v_y * math.cos(turned))
    turned += half * (state[YAW_RATE] - kappa * along)
    c, w = math.cos(turned), math.sin(turned)

    grade, e, z_ss, z_sd = _height_at(table, ds, slopes, middle, d)

    # Gradient in the car's frame, and gravity's pull.
    ahead, left = grade * c + e * w, e * c - grade * w
    length, norm = math.sqrt(1.0 + ahead * ahead), math.sqrt(1.0 + ahead * ahead + left * left)
    ground = p.copy()
    ground[IS_TILTED] = 1.0
    ground[PULL_AHEAD] = -GRAVITY * ahead / length
    ground[PULL_LEFT] = -GRAVITY * left / (norm * length)
    ground[AHEAD] = 1.0 / length
    ground[SKEW] = ahead * left / (norm * length)
    ground[LEFT] = length / norm
    ground[TURN] = length * length / norm
    u_ahead, u_left, _ = on_map(v_x, v_y, 0.0, ground)
    u_s, u_d = u_ahead * c - u_left * w, u_ahead * w + u_left * c
    bend_s, bend_d = z_ss * u_s + z_sd * u_d, z_sd * u_s
    ground[TWIST] = -left * (bend_s * c + bend_d * w) / (norm * norm)
    load = (GRAVITY + u_s * bend_s + u_d * bend_d) / (GRAVITY * norm)
    load = max(load, LEAST_LOAD)
    for k in (ACROSS, ROLLING_DRAG, LEAST_ACCELERATION, MOST_ACCELERATION):
        ground[k] *= load
    return ground, s
