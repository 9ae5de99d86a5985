"""Kernels of road geometry: clothoid chains, their points, and projection onto them.

A road's curvature is linear between samples that are ``step`` m apart, so its heading is quadratic
in between and each piece is a clothoid. The kernels work on a *table*: the chain cut into equal
sub-steps of at most 1 m, such that each sample is a row.

==========  =======  ==============================================================
symbol      shape    meaning
==========  =======  ==============================================================
``table``   (M, 6)   x [m], y [m], heading [rad], curvature [1/m], cosine and sine of the
                     heading; (M, 7) if the road widens: also a lane's widening [m]
``ds``      scalar   length of centre line from a row to the next [m]
``s``       scalar   distance along the centre line from the road's start [m]
``d``       scalar   distance to the left of the centre line, the lateral offset [m]
==========  =======  ==============================================================

Before its start and after its end a road continues straight, so a car at the first or last point
stands on a lane as a whole.
"""

from __future__ import annotations

import math

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, hypotenuse, sine

X, Y, HEADING, CURVATURE, COS, SIN, WIDENING = range(7)
"""Columns of a table; only the table of a road that widens has the last."""

SUB_STEP = 1.0
"""Longest sub-step of a table, in m; our choice."""
SUB_TURN = 0.5
"""Largest turn of a table's sub-step, in rad; our choice."""
_MIN_REACH = 2.0
"""Distance along the road within which every point is projected, in m; our choice."""


def _gauss_rule(points: int) -> tuple[tuple[float, float], ...]:
    """Return nodes and weights of a Gauss-Legendre rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    return tuple(zip((0.5 * (nodes + 1.0)).tolist(), (0.5 * weights).tolist(), strict=True))


GAUSS = _gauss_rule(5)
"""Nodes and weights for a sub-step: the error is below 1e-11 m, since it turns by SUB_TURN at most.
"""
_GAUSS_SMALL_TURN = _gauss_rule(3)
"""Nodes and weights for a sub-step that turns by `_SMALL_TURN` at most: as exact."""
_SMALL_TURN = 0.1
"""Largest small turn, in rad; our choice: the sub-steps of ordinary roads turn by less."""


@njit()
def chord(heading: float, curvature: float, rate: float, u: float) -> tuple[float, float]:
    """Return the displacement (dx, dy) after ``u`` m of a clothoid from its start, in m.

    Args:
        heading: heading at the start, in rad.
        curvature: curvature at the start, in 1/m.
        rate: change of the curvature, in 1/m per m.
        u: length, in m.
    """
    dx = 0.0
    dy = 0.0
    for node, weight in GAUSS:
        t = u * node
        angle = heading + t * (curvature + 0.5 * rate * t)
        dx += weight * cosine(angle)
        dy += weight * sine(angle)
    return u * dx, u * dy


@njit(error_model="numpy", force_inline=True)
def _turn(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle of at most SUB_TURN, to 1e-11, by Taylor polynomials."""
    q = angle * angle
    c = 1.0 + q * (
        -1.0 / 2.0
        + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40320.0 + q * (-1.0 / 3628800.0))))
    )
    n = 1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * (1.0 / 362880.0))))
    return c, angle * n


@njit(error_model="numpy")
def _sub_chord(curvature: float, rate: float, u: float) -> tuple[float, float]:
    """Return the displacement (ahead, left) after ``u`` m of a clothoid, in the frame of its start.

    The same as `chord` with heading 0, without trigonometric functions; for at most one sub-step.
    """
    ahead = 0.0
    left = 0.0
    if abs(u) * (abs(curvature) + abs(0.5 * rate * u)) <= _SMALL_TURN:
        for node, weight in _GAUSS_SMALL_TURN:
            t = u * node
            angle = t * (curvature + 0.5 * rate * t)
            q = angle * angle
            ahead += weight * (1.0 + q * (-1.0 / 2.0 + q * (1.0 / 24.0 - q * (1.0 / 720.0))))
            left += weight * (angle * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0))))
        return u * ahead, u * left
    for node, weight in GAUSS:
        t = u * node
        c, n = _turn(t * (curvature + 0.5 * rate * t))
        ahead += weight * c
        left += weight * n
    return u * ahead, u * left


@njit(interpret_first=0.1)
def sub_steps(curvatures: FloatArray, step: float) -> int:
    """Return the number of sub-steps in each step that keeps to SUB_STEP and SUB_TURN."""
    sharpest = 0.0
    for value in curvatures:
        sharpest = max(sharpest, abs(value))
    return max(1, math.ceil(max(step / SUB_STEP, step * sharpest / SUB_TURN) - 1e-9))


@njit(interpret_first=0.6)
def build_table(
    curvatures: FloatArray, step: float, x: float, y: float, heading: float, per_piece: int
) -> FloatArray:
    """Return the table of a road.

    Args:
        curvatures: the road's curvatures, (N,) in 1/m.
        step: distance between two curvatures, in m.
        x, y, heading: pose of the first curvature, in m, m and rad.
        per_piece: number of sub-steps in each step, from `sub_steps`.
    """
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
            table[row, X] = x
            table[row, Y] = y
            table[row, HEADING] = theta
            table[row, CURVATURE] = kappa
            table[row, COS] = cosine(theta)
            table[row, SIN] = sine(theta)
            ahead, left = _sub_chord(kappa, rate, ds)
            x += ahead * table[row, COS] - left * table[row, SIN]
            y += ahead * table[row, SIN] + left * table[row, COS]
        heading = start + 0.5 * step * (curvatures[i] + curvatures[i + 1])
    last = pieces * per_piece
    table[last, X] = x
    table[last, Y] = y
    table[last, HEADING] = heading
    table[last, CURVATURE] = curvatures[pieces]
    table[last, COS] = cosine(heading)
    table[last, SIN] = sine(heading)
    return table


@njit(error_model="numpy")
def widening_at(table: FloatArray, ds: float, s: float) -> float:
    """Return the additional width of a lane at ``s``, in m."""
    if table.shape[1] <= WIDENING:
        return 0.0
    last = len(table) - 1
    i = min(max(int(s / ds), 0), last - 1)
    share = min(max(s / ds - i, 0.0), 1.0)
    wider: float = table[i, WIDENING] + share * (table[i + 1, WIDENING] - table[i, WIDENING])
    return wider


@njit(error_model="numpy", force_inline=True, interpret_first=0.1)
def heading_at(table: FloatArray, ds: float, s: float) -> float:
    """Return the heading of the centre line at ``s``, in rad; beyond both ends it is straight."""
    last = len(table) - 1
    i = min(max(int(s / ds), 0), last - 1)
    u = min(max(s, 0.0), last * ds) - i * ds
    rate = (table[i + 1, CURVATURE] - table[i, CURVATURE]) / ds
    heading: float = table[i, HEADING] + u * (table[i, CURVATURE] + 0.5 * rate * u)
    return heading


@njit(error_model="numpy", interpret_first=0.1)
def headings_at(table: FloatArray, ds: float, distances: FloatArray) -> FloatArray:
    """Return `heading_at` of several distances along the road, (n,)."""
    headings = np.empty(len(distances))
    for i in range(len(distances)):
        headings[i] = heading_at(table, ds, distances[i])
    return headings


@njit(error_model="numpy", interpret_first=0.2)
def frame_at(table: FloatArray, ds: float, s: float) -> tuple[float, float, float, float, float]:
    """Return x, y, cosine and sine of the heading, and the curvature of the centre line at ``s``.

    Beyond both ends the line is straight.
    """
    last = len(table) - 1
    length = last * ds
    if s < 0.0:
        row = table[0]
        return row[X] + s * row[COS], row[Y] + s * row[SIN], row[COS], row[SIN], 0.0
    if s > length:
        row = table[last]
        u = s - length
        return row[X] + u * row[COS], row[Y] + u * row[SIN], row[COS], row[SIN], 0.0
    i = min(int(s / ds), last - 1)
    u = s - i * ds
    rate = (table[i + 1, CURVATURE] - table[i, CURVATURE]) / ds
    ahead, left = _sub_chord(table[i, CURVATURE], rate, u)
    c, n = table[i, COS], table[i, SIN]
    turned_c, turned_n = _turn(u * (table[i, CURVATURE] + 0.5 * rate * u))
    return (
        table[i, X] + ahead * c - left * n,
        table[i, Y] + ahead * n + left * c,
        c * turned_c - n * turned_n,
        n * turned_c + c * turned_n,
        table[i, CURVATURE] + rate * u,
    )


@njit(error_model="numpy", force_inline=True)
def _refine(
    table: FloatArray, ds: float, px: float, py: float, low: int, high: int
) -> tuple[float, float]:
    """Return (s, d) of the centre line's point nearest to (px, py).

    The nearest of the rows from ``low`` to ``high`` is found first, then the nearest point on the
    sub-steps beside that row, by Newton's method.
    """
    best = low
    best_square = math.inf
    for i in range(low, high + 1):
        dx, dy = px - table[i, X], py - table[i, Y]
        square = dx * dx + dy * dy
        if square < best_square:
            best_square = square
            best = i
    last = len(table) - 1
    # The foot of the perpendicular lies within one sub-step of the nearest row, except beyond the
    # road's ends, where the line is straight and one Newton step is exact.
    least = -math.inf if best == 0 else (best - 1) * ds
    most = math.inf if best == last else (best + 1) * ds
    s = best * ds
    x, y, kappa = table[best, X], table[best, Y], table[best, CURVATURE]
    c, n = table[best, COS], table[best, SIN]
    offset = 0.0
    for _ in range(20):
        along = (px - x) * c + (py - y) * n
        offset = (py - y) * c - (px - x) * n
        # d(along)/ds = -(1 - kappa * offset); kept away from 0 where the point is near the centre
        # of the osculating circle, so that the iteration stays a descent.
        move = min(max(s + along / max(1.0 - kappa * offset, 0.1), least), most) - s
        # A move below a nanometre is rounding; it must not put a car before the road's start.
        if abs(move) > 1e-9:
            s += move
        # After a Newton step, the error of s is of the order of the step squared times the change
        # of curvature. The offset from the osculating circle has an error of the third order.
        if abs(move) < 1e-4:
            offset -= 0.5 * kappa * along * move
            break
        x, y, c, n, kappa = frame_at(table, ds, s)
    return s, offset


@njit(error_model="numpy", force_inline=True)
def project_global(table: FloatArray, ds: float, px: float, py: float) -> tuple[float, float]:
    """Return (s, d) of the centre line's point nearest to (px, py), on the whole road."""
    return project_near(table, ds, px, py, 0.0, (len(table) - 1) * ds)


@njit(error_model="numpy", force_inline=True, interpret_first=0.4)
def project_near(
    table: FloatArray, ds: float, px: float, py: float, s: float, reach: float
) -> tuple[float, float]:
    """Return (s, d) of the centre line's point nearest to (px, py), near ``s``.

    Only points up to about ``reach`` m from ``s``, along the road, are searched. So a car that is
    followed along its road stays on its piece of road where another piece is close.
    """
    last = len(table) - 1
    low = min(max(int((s - reach) / ds), 0), last)
    high = min(max(int((s + reach) / ds) + 1, 0), last)
    return _refine(table, ds, px, py, low, high)


@njit(interpret_first=0.5)
def track(table: FloatArray, ds: float, xy: FloatArray) -> FloatArray:
    """Return distances along the road and lateral offsets, (n, 2) in m, of a path.

    The first position is projected onto the whole road, and each further position near the distance
    of the position before, see `reach_of`.

    Args:
        table, ds: the road.
        xy: positions of the path, (n, 2) in m.
    """
    n = len(xy)
    out = np.empty((n, 2))
    s = 0.0
    for i in range(n):
        if i == 0:
            s, d = project_global(table, ds, xy[0, 0], xy[0, 1])
        else:
            moved = hypotenuse(xy[i, 0] - xy[i - 1, 0], xy[i, 1] - xy[i - 1, 1])
            s, d = project_near(table, ds, xy[i, 0], xy[i, 1], s, reach_of(moved))
        out[i, 0] = s
        out[i, 1] = d
    return out


@njit(interpret_first=0.5)
def offsets_near(table: FloatArray, ds: float, xy: FloatArray, distances: FloatArray) -> FloatArray:
    """Return lateral offsets (n,) in m of points from the road near these distances.

    Args:
        table, ds: the road.
        xy: the points, (n, 2) in m.
        distances: distance along the road, (n,) in m, within 2 m of which a point is projected.
    """
    out = np.empty(len(xy))
    for i in range(len(xy)):
        _, out[i] = project_near(table, ds, xy[i, 0], xy[i, 1], distances[i], _MIN_REACH)
    return out


@njit(error_model="numpy", force_inline=True, interpret_first=0.1)
def reach_of(moved: float) -> float:
    """Return how far along the road to search for a car that has moved ``moved`` m, in m.

    On the inside of a bend, the car's projection onto the road moves faster than the car: twice as
    fast half way to the bend's centre.
    """
    return _MIN_REACH + 2.0 * moved


@njit(interpret_first=0.3)
def sample_line(table: FloatArray, ds: float, distances: FloatArray, offset: float) -> FloatArray:
    """Return points (n, 2) in m of the line that is ``offset`` m left of the centre line.

    The points are at ``distances`` (n,) in m along the centre line.
    """
    out = np.empty((len(distances), 2))
    for i in range(len(distances)):
        x, y, c, n, _ = frame_at(table, ds, distances[i])
        out[i, 0] = x - offset * n
        out[i, 1] = y + offset * c
    return out
