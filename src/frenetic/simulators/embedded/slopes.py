"""The road's plane under the car: its tilt, and how gravity pulls and loads a car in it.

The road's height over the map is the centre line's height, and rises to the left by the
superelevation e. A car is in the plane that touches the road under its centre of mass. Symbols:

    ======== ===============================================================
    p, q     the height's gradient there, ahead of the car and to its left
    H        the height's second derivatives there, (2, 2) in 1/m
    S, N     sqrt(1 + p²) and sqrt(1 + p² + q²)
    v_x, v_y speed and lateral speed in the plane, in m/s
    r        yaw rate in the plane, in rad/s
    u        velocity on the map, (2,) in m/s
    g        acceleration of gravity, in m/s²
    ======== ===============================================================

- Gravity pulls by -g p / S ahead and by -g q / (N S) to the left.
- The load on the tyres per mass is (g + u H u) / N: less on a crest, more in a dip and in a bend
  that is banked to its inside.
- u = (v_x / S - v_y p q / (N S), v_y S / N), and the heading turns by r S² / N - q (H u)_x / N².

That is exact for a mass that slides on the road. The car's rolling and pitching are left out.
"""

from __future__ import annotations

import math
from typing import Final

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, hypotenuse, sine
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
"""Least load per weight, on a crest where a real car would take off: this one stays on the road;
our choice."""


@njit(error_model="numpy")
def _height_at(
    table: FloatArray, ds: float, slopes: FloatArray, s: float, d: float
) -> tuple[float, float, float, float]:
    """Return the height's derivatives along the road (s) and across it (d): z_s, z_d, z_ss, z_sd.

    Args:
        table, ds: The road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`.
        s: Distance along the road, in m.
        d: Distance to the left of the centre line, in m.

    """
    # Superelevation e, grade and curvature kappa at s, and their rates of change along the road;
    # before and after the road nothing changes.
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
    shrunk = max(1.0 - kappa * d, 0.05)  # length of the parallel at d per length of the centre line
    grade = (grade + e_rate * d) / shrunk
    z_ss = ((grade_rate + grade * kappa_rate * d) / shrunk - e * kappa) / shrunk
    z_sd = (e_rate + grade * kappa) / shrunk
    return grade, e, z_ss, z_sd


@njit(error_model="numpy")
def on_slopes(
    p: FloatArray,
    table: FloatArray,
    ds: float,
    slopes: FloatArray,
    state: FloatArray,
    s: float,
    seconds: float,
) -> tuple[FloatArray, float]:
    """Return a car's parameters on the slopes under it, and its distance along the road in m.

    Args:
        p: `Vehicle.to_array()`.
        table, ds: The road, see `frenetic.road.geometry`.
        slopes: `Road.slopes`, not of a flat road.
        state: (7,) state of the car.
        s: Distance of the car along the road a short time ago, in m.
        seconds: Time for which the parameters hold, in s; the slopes are taken in its middle.

    """
    v_x, v_y = state[SPEED], state[LATERAL_SPEED]
    reach = reach_of(0.1 * hypotenuse(v_x, v_y))
    s, d = project_near(table, ds, state[X], state[Y], s, reach)
    turned = state[HEADING] - heading_at(table, ds, s)

    # Place and direction of the car when half the time has passed.
    half = 0.5 * seconds
    kappa = frame_at(table, ds, s)[4]
    along = v_x * cosine(turned) - v_y * sine(turned)
    along /= max(1.0 - kappa * d, 0.05)
    middle = s + half * along
    d += half * (v_x * sine(turned) + v_y * cosine(turned))
    turned += half * (state[YAW_RATE] - kappa * along)
    c, w = cosine(turned), sine(turned)

    grade, e, z_ss, z_sd = _height_at(table, ds, slopes, middle, d)

    # Gradient in the car's frame, and gravity's pull.
    ahead, left = grade * c + e * w, e * c - grade * w
    length, norm = math.sqrt(1.0 + ahead * ahead), math.sqrt(1.0 + ahead * ahead + left * left)
    ground = p.copy()
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
