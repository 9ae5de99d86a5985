"""Kernels of road geometry: clothoid chains, their points, and projection onto them.

A road's curvature is linear between samples that are ``step`` apart, so its heading is a quadratic
and each piece is a clothoid. Everything here works on a *table*: the chain cut into equal
sub-steps of ``ds`` <= 1 m, aligned with the samples.

==========  =======  ==============================================================
symbol      shape    meaning
==========  =======  ==============================================================
``table``   (M, 6)   rows x [m], y [m], heading [rad], curvature [1/m], cos, sin; (M, 7) of a
                     road that widens, with the m by which it does
``ds``      scalar   m of centre line from one row to the next
``s``       scalar   m along the centre line from the road's start
``d``       scalar   m to the left of the centre line (lateral offset)
==========  =======  ==============================================================

Before its start and after its end a road continues straight along its tangent, so a car on its
first or last point stands on a lane.
"""

from __future__ import annotations

import math

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

X, Y, HEADING, CURVATURE, COS, SIN, WIDENING = range(7)
"""Columns of a table; only a road whose lanes widen has the last."""

SUB_STEP = 1.0
"""Longest sub-step of a table, in m."""
SUB_TURN = 0.5
"""Largest turn of a table's sub-step, in rad."""

# Nodes and weights of the Gauss-Legendre rule with five points on [0, 1]. On a sub-step, which
# turns by SUB_TURN at most, its error is below 1e-11 m.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
GAUSS = tuple(map(tuple, np.column_stack([0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS]).tolist()))


@njit()
def chord(heading: float, curvature: float, rate: float, u: float) -> tuple[float, float]:
    """Return the displacement (dx, dy) after ``u`` m of a clothoid from its start."""
    dx = 0.0
    dy = 0.0
    for node, weight in GAUSS:
        t = u * node
        angle = heading + t * (curvature + 0.5 * rate * t)
        dx += weight * math.cos(angle)
        dy += weight * math.sin(angle)
    return u * dx, u * dy


@njit()
def _turn(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle of at most SUB_TURN, to 1e-11, by Taylor polynomials."""
    q = angle * angle
    cosine = 1.0 - q / 2.0 * (
        1.0 - q / 12.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0 * (1.0 - q / 90.0)))
    )
    sine = angle * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0))))
    return cosine, sine


@njit()
def _sub_chord(curvature: float, rate: float, u: float) -> tuple[float, float]:
    """Return `chord` in the frame of its start, over at most one sub-step, without trigonometry."""
    ahead = 0.0
    left = 0.0
    for node, weight in GAUSS:
        t = u * node
        cosine, sine = _turn(t * (curvature + 0.5 * rate * t))
        ahead += weight * cosine
        left += weight * sine
    return u * ahead, u * left


@njit()
def sub_steps(curvatures: FloatArray, step: float) -> int:
    """Return the number of sub-steps per piece that keeps them below SUB_STEP and SUB_TURN."""
    sharpest = 0.0
    for value in curvatures:
        sharpest = max(sharpest, abs(value))
    return max(1, math.ceil(max(step / SUB_STEP, step * sharpest / SUB_TURN) - 1e-9))


@njit()
def build_table(
    curvatures: FloatArray, step: float, x: float, y: float, heading: float, per_piece: int
) -> FloatArray:
    """Return a road's table from its (N,) curvatures and pose, ``per_piece`` rows per piece."""
    pieces = len(curvatures) - 1
    table = np.empty((pieces * per_piece + 1, 6))
    ds = step / per_piece
    for i in range(pieces):
        rate = (curvatures[i + 1] - curvatures[i]) / step
        start = heading
        for j in range(per_piece):
            t = j * ds
            kappa = curvatures[i] + rate * t
            theta = start + t * (curvatures[i] + 0.5 * rate * t)
            row = i * per_piece + j
            table[row, 0] = x
            table[row, 1] = y
            table[row, 2] = theta
            table[row, 3] = kappa
            table[row, 4] = math.cos(theta)
            table[row, 5] = math.sin(theta)
            ahead, left = _sub_chord(kappa, rate, ds)
            x += ahead * table[row, 4] - left * table[row, 5]
            y += ahead * table[row, 5] + left * table[row, 4]
        heading = start + 0.5 * step * (curvatures[i] + curvatures[i + 1])
    last = pieces * per_piece
    table[last, 0] = x
    table[last, 1] = y
    table[last, 2] = heading
    table[last, 3] = curvatures[pieces]
    table[last, 4] = math.cos(heading)
    table[last, 5] = math.sin(heading)
    return table


@njit()
def widening_at(table: FloatArray, ds: float, s: float) -> float:
    """Return the additional width of a lane at ``s``, in m."""
    if table.shape[1] <= 6:
        return 0.0
    last = len(table) - 1
    i = min(max(int(s / ds), 0), last - 1)
    share = min(max(s / ds - i, 0.0), 1.0)
    wider: float = table[i, 6] + share * (table[i + 1, 6] - table[i, 6])
    return wider


@njit()
def heading_at(table: FloatArray, ds: float, s: float) -> float:
    """Return the heading of the centre line at ``s``; it is straight beyond both ends."""
    last = len(table) - 1
    i = min(max(int(s / ds), 0), last - 1)
    u = min(max(s, 0.0), last * ds) - i * ds
    rate = (table[i + 1, 3] - table[i, 3]) / ds
    heading: float = table[i, 2] + u * (table[i, 3] + 0.5 * rate * u)
    return heading


@njit()
def frame_at(table: FloatArray, ds: float, s: float) -> tuple[float, float, float, float, float]:
    """Return (x, y, cosine and sine of the heading, curvature) at ``s``; straight beyond ends."""
    last = len(table) - 1
    length = last * ds
    if s < 0.0:
        row = table[0]
        return row[0] + s * row[4], row[1] + s * row[5], row[4], row[5], 0.0
    if s > length:
        row = table[last]
        u = s - length
        return row[0] + u * row[4], row[1] + u * row[5], row[4], row[5], 0.0
    i = min(int(s / ds), last - 1)
    u = s - i * ds
    rate = (table[i + 1, 3] - table[i, 3]) / ds
    ahead, left = _sub_chord(table[i, 3], rate, u)
    c, n = table[i, 4], table[i, 5]
    cosine, sine = _turn(u * (table[i, 3] + 0.5 * rate * u))
    return (
        table[i, 0] + ahead * c - left * n,
        table[i, 1] + ahead * n + left * c,
        c * cosine - n * sine,
        n * cosine + c * sine,
        table[i, 3] + rate * u,
    )


@njit()
def _refine(
    table: FloatArray, ds: float, px: float, py: float, low: int, high: int
) -> tuple[float, float]:
    """Return (s, d) of the point nearest to (px, py) among rows low..high and adjacent pieces."""
    best = low
    best_square = math.inf
    for i in range(low, high + 1):
        square = (px - table[i, 0]) ** 2 + (py - table[i, 1]) ** 2
        if square < best_square:
            best_square = square
            best = i
    last = len(table) - 1
    # The foot of the perpendicular lies within one sub-step of the nearest row, except beyond the
    # road's ends, where the line is straight and one Newton step is exact.
    least = -math.inf if best == 0 else (best - 1) * ds
    most = math.inf if best == last else (best + 1) * ds
    s = best * ds
    x, y, kappa = table[best, 0], table[best, 1], table[best, 3]
    c, n = table[best, 4], table[best, 5]
    offset = 0.0
    for _ in range(20):
        along = (px - x) * c + (py - y) * n
        offset = (py - y) * c - (px - x) * n
        # d(along)/ds = -(1 - kappa * offset); kept away from 0 where the point is near the centre
        # of the osculating circle, so that the iteration stays a descent.
        target = min(max(s + along / max(1.0 - kappa * offset, 0.1), least), most)
        move = abs(target - s)
        # Less than a nanometre is rounding; it must not carry a car off the road's start.
        if move > 1e-9:
            s = target
        # The error left after a Newton step is of the order of its square, and the offset's is that
        # of s squared.
        if move < 1e-6:
            break
        x, y, c, n, kappa = frame_at(table, ds, s)
    return s, offset


@njit()
def project_global(table: FloatArray, ds: float, px: float, py: float) -> tuple[float, float]:
    """Return (s, d) of the whole road's point that is nearest to (px, py)."""
    return project_near(table, ds, px, py, 0.0, (len(table) - 1) * ds)


@njit()
def project_near(
    table: FloatArray, ds: float, px: float, py: float, s: float, reach: float
) -> tuple[float, float]:
    """Return (s, d) of the nearest point of the road, at most about ``reach`` m from ``s``.

    Following a car this way stays on its piece of road where another piece passes close by.
    """
    last = len(table) - 1
    low = min(max(int((s - reach) / ds), 0), last)
    high = min(max(int((s + reach) / ds) + 1, 0), last)
    return _refine(table, ds, px, py, low, high)


@njit()
def track(table: FloatArray, ds: float, xy: FloatArray) -> FloatArray:
    """Return distances along and lateral offsets, (n, 2), of a path of (n, 2) positions.

    The first position is projected onto the whole road, each other one near its predecessor's
    place, as far as the path moved.
    """
    n = len(xy)
    out = np.empty((n, 2))
    s = 0.0
    for i in range(n):
        if i == 0:
            s, d = project_global(table, ds, xy[0, 0], xy[0, 1])
        else:
            moved = math.hypot(xy[i, 0] - xy[i - 1, 0], xy[i, 1] - xy[i - 1, 1])
            s, d = project_near(table, ds, xy[i, 0], xy[i, 1], s, reach_of(moved))
        out[i, 0] = s
        out[i, 1] = d
    return out


@njit()
def offsets_near(table: FloatArray, ds: float, xy: FloatArray, distances: FloatArray) -> FloatArray:
    """Return lateral offsets (n,) of points (n, 2) from the road near their distances (n,).

    Around is up to 2 m along the road.
    """
    out = np.empty(len(xy))
    for i in range(len(xy)):
        _, out[i] = project_near(table, ds, xy[i, 0], xy[i, 1], distances[i], 2.0)
    return out


@njit()
def reach_of(moved: float) -> float:
    """Return the reach of the search along the road, in m, for a car that moved ``moved`` m.

    Inside a bend the foot of the perpendicular runs faster than the car: twice as fast half way
    to the bend's centre.
    """
    return 2.0 + 2.0 * moved


@njit()
def sample_line(table: FloatArray, ds: float, distances: FloatArray, offset: float) -> FloatArray:
    """Return points (n, 2) at ``distances`` (n,), ``offset`` m left of the centre line."""
    out = np.empty((len(distances), 2))
    for i in range(len(distances)):
        x, y, cosine, sine, _ = frame_at(table, ds, distances[i])
        out[i, 0] = x - offset * sine
        out[i, 1] = y + offset * cosine
    return out
