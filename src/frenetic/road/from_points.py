"""Curvature of a road through points."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.road import geometry

if TYPE_CHECKING:
    from typing import TypeAlias

RECOGNISED = 1e-5
"""Largest distance in m of points from a clothoid chain whose samples they are; ours."""
MOST_RECOGNISED = 300
"""Most points searched for a clothoid chain; ours: the work grows with their cube."""
SPLINE_STEP = 0.5
"""Distance between the curvature samples of a road along a spline, in m; ours."""
CORRECTION = 4.0
"""Length over which a road along a spline corrects its distance from the spline, in m; ours."""

_ENDS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Starts of the fit for the first and last curvature, in multiples of half a curvature per step."""

Recovered: TypeAlias = tuple[FloatArray, float, tuple[float, float, float]]
"""Curvatures, step and pose of a road."""


def curvature_from_points(points: FloatArray, most_samples: int) -> Recovered:
    """Return (curvatures (M,), step, pose) of the road through (N, 2) points.

    Consecutive points are distinct. M is the number of points, or at most ``most_samples``.
    """
    return _recognise(points) or _along_spline(points, most_samples)


def _along_spline(points: FloatArray, most_samples: int) -> Recovered:
    """Return the road along the competition's spline through the points."""
    from scipy.interpolate import make_interp_spline  # takes as long as the rest of a start-up

    degree = min(len(points) - 1, 3)
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    polyline = float(chords[-1])
    # The same spline as splprep's with s = 0: not-a-knot over the normalised chord length.
    spline = make_interp_spline(chords / polyline, points, k=degree)
    # Dense enough that between two parameters the line is nearly an arc.
    parameters = np.linspace(0.0, 1.0, max(64, 10 * len(points), math.ceil(polyline / 0.1)) + 1)
    position = spline(parameters)
    first = spline.derivative(1)(parameters)
    second = spline.derivative(2)(parameters) if degree > 1 else np.zeros_like(first)
    rate = np.hypot(first[:, 0], first[:, 1])
    rate = np.maximum(rate, 1e-9 * max(rate.max(), 1e-300))
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / rate**3
    # Simpson's rule on each parameter step.
    middle = 0.5 * (parameters[1:] + parameters[:-1])
    middle_rate = np.hypot(*spline.derivative(1)(middle).T)
    pieces = (rate[1:] + 4.0 * middle_rate + rate[:-1]) * np.diff(parameters) / 6.0
    arc = np.concatenate([[0.0], np.cumsum(pieces)])
    length = float(arc[-1])
    samples = min(max(2, round(length / SPLINE_STEP)) + 1, most_samples)
    step = length / (samples - 1)
    at = np.linspace(0.0, length, samples)
    heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    line = np.column_stack(
        [
            np.interp(at, arc, position[:, 0]),
            np.interp(at, arc, position[:, 1]),
            np.interp(at, arc, heading),
            np.interp(at, arc, np.clip(curvature, -5.0, 5.0)),
        ]
    )
    return (
        follow_line(line, step, max(CORRECTION, 2.0 * step)),
        step,
        (float(line[0, 0]), float(line[0, 1]), float(line[0, 2])),
    )


@njit()
def follow_line(line: FloatArray, step: float, reach: float) -> FloatArray:
    """Return curvatures (n,) of a chain that follows ``line`` (n, 4): x, y, heading, curvature.

    Sampling the line's curvature and integrating it again drifts, as the curvature between
    samples is not quite linear. Each sample therefore also works off the lateral and the heading
    error that the chain has gathered, critically damped over ``reach`` m.
    """
    n = len(line)
    curvatures = np.empty(n)
    x, y, heading = line[0, 0], line[0, 1], line[0, 2]
    curvatures[0] = line[0, 3]
    for i in range(1, n):
        # Where the chain would arrive if it took the line's own curvature.
        rate = (line[i, 3] - curvatures[i - 1]) / step
        dx, dy = geometry.chord(heading, curvatures[i - 1], rate, step)
        turned = 0.5 * step * (curvatures[i - 1] + line[i, 3])
        c, s = math.cos(line[i, 2]), math.sin(line[i, 2])
        lateral = (y + dy - line[i, 1]) * c - (x + dx - line[i, 0]) * s
        angle = heading + turned - line[i, 2]
        curvatures[i] = line[i, 3] - 2.0 * angle / reach - lateral / reach**2
        rate = (curvatures[i] - curvatures[i - 1]) / step
        dx, dy = geometry.chord(heading, curvatures[i - 1], rate, step)
        x += dx
        y += dy
        heading += 0.5 * step * (curvatures[i - 1] + curvatures[i])
    return curvatures


def _recognise(points: FloatArray) -> Recovered | None:
    """Return the clothoid chain that the points sample at equal distances, or None.

    Gauss-Newton on the N curvatures, the pose and the step; 2 N equations for N + 4 unknowns, so
    that from 8 points on a fit is no accident. The points say little about the first and the last
    curvature (their sign shows in the third order only), so several starts for these two are tried.
    """
    n = len(points)
    if not 8 <= n <= MOST_RECOGNISED:
        return None
    chords = np.diff(points, axis=0)
    lengths = np.hypot(chords[:, 0], chords[:, 1])
    directions = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    turns = np.diff(directions)
    # Equal steps along a road give nearly equal chords; anything else is not worth the fit. An arc
    # is longer than its chord by (turn)^2 / 24, any piece inside a chain by less than six times
    # that.
    sharpest = np.abs(turns).max()
    if sharpest > 1.2 or lengths.min() < 0.8 * lengths.max():
        return None
    if np.ptp(lengths[1:-1]) > 0.25 * sharpest**2 * lengths.max() + 4.0 * RECOGNISED:
        return None
    step = float((lengths[1:-1] * (1.0 + turns[1:] * turns[:-1] / 24.0)).mean())
    best, worst = None, math.inf
    spread = 0.5 / step
    for front, back in _ENDS:
        curvatures = _from_turns(turns / step, front * spread, back * spread)
        heading = directions[0] - step * (curvatures[0] / 3.0 + curvatures[1] / 6.0)
        start = np.concatenate([curvatures, [points[0, 0], points[0, 1], heading, step]])
        unknowns, mismatch = _gauss_newton(start, points)
        if mismatch < worst:
            best, worst = unknowns, mismatch
        # A wrong start for the two ends leaves a mismatch of this order, not more.
        if worst < 1e-9 or worst > 2e-5 * step**3:
            break
    if best is None or worst > RECOGNISED or np.abs(best[:n]).max() > 5.0:
        return None
    x, y, heading, step = (float(v) for v in best[n:])
    return best[:n].copy(), step, (x, y, heading)


def _from_turns(turns: FloatArray, front: float, back: float) -> FloatArray:
    """Return curvatures (N,) whose chords turn by ``turns`` (N - 2,) rad per step, to first order.

    A chord of a clothoid piece points along heading + step * (kappa_i / 3 + kappa_i+1 / 6), so
    the turn from one to the next is (kappa_i-1 + 4 kappa_i + kappa_i+1) / 6. The first and the last
    curvature are free: ``front`` and ``back`` 1/m beyond the neighbouring turn.
    """
    from scipy.linalg import solve_banded  # takes its time

    n = len(turns)
    bands = np.zeros((3, n))
    bands[0, 1:] = bands[2, :-1] = 1.0 / 6.0
    bands[1] = 4.0 / 6.0
    first, last = turns[0] + front, turns[-1] + back
    right = turns.copy()
    right[0] -= first / 6.0
    right[-1] -= last / 6.0
    return np.concatenate([[first], solve_banded((1, 1), bands, right), [last]])


def _gauss_newton(unknowns: FloatArray, points: FloatArray) -> tuple[FloatArray, float]:
    """Return the best unknowns from a start, and their largest mismatch in m."""
    from scipy.linalg import lstsq  # takes its time

    step = unknowns[-1]
    best, best_worst, stalled = unknowns, math.inf, 0
    for iteration in range(40):
        place, jacobian = _chain_jacobian(unknowns)
        residual = place - points.ravel()
        worst = float(np.abs(residual).max())
        stalled = 0 if worst < 0.5 * best_worst else stalled + 1
        if worst < best_worst:
            best, best_worst = unknowns, worst
        if best_worst < 1e-12 or stalled > 3 or (iteration > 6 and best_worst > 0.1):
            break
        change = lstsq(jacobian, residual, cond=1e-14, lapack_driver="gelsy")[0]
        unknowns = unknowns - change
        if not (np.isfinite(unknowns).all() and 0.5 < unknowns[-1] / step < 2.0):
            break
    return best, best_worst


@njit()
def _chain_jacobian(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the samples (2 N,) of a clothoid chain and their Jacobian (2 N, N + 4).

    The unknowns are N curvatures, x, y, heading and step.
    """
    n = len(unknowns) - 4
    heading, step = unknowns[n + 2], unknowns[n + 3]
    place = np.empty(2 * n)
    jacobian = np.zeros((2 * n, n + 4))
    # d(heading)/d(unknown) at the current sample.
    turn = np.zeros(n + 4)
    turn[n + 2] = 1.0
    place[0] = unknowns[n]
    place[1] = unknowns[n + 1]
    jacobian[0, n] = 1.0
    jacobian[1, n + 1] = 1.0
    parts = max(1, math.ceil(step))
    du = 1.0 / parts
    for i in range(n - 1):
        k0, k1 = unknowns[i], unknowns[i + 1]
        dx = dy = 0.0
        gx, gy = np.zeros(4), np.zeros(4)  # by heading, k0, k1, step
        for part in range(parts):
            for node, weight in geometry.GAUSS:
                u = (part + node) * du
                by_k0 = step * (u - 0.5 * u * u)
                by_k1 = step * 0.5 * u * u
                angle = heading + k0 * by_k0 + k1 * by_k1
                c, s = weight * du * math.cos(angle), weight * du * math.sin(angle)
                dx += c
                dy += s
                by_step = (k0 * by_k0 + k1 * by_k1) / step
                for j, factor in enumerate((1.0, by_k0, by_k1, by_step)):
                    gx[j] -= s * factor
                    gy[j] += c * factor
        place[2 * i + 2] = place[2 * i] + step * dx
        place[2 * i + 3] = place[2 * i + 1] + step * dy
        row, before = 2 * i + 2, 2 * i
        for j in range(n + 4):
            jacobian[row, j] = jacobian[before, j] + step * gx[0] * turn[j]
            jacobian[row + 1, j] = jacobian[before + 1, j] + step * gy[0] * turn[j]
        jacobian[row, i] += step * gx[1]
        jacobian[row + 1, i] += step * gy[1]
        jacobian[row, i + 1] += step * gx[2]
        jacobian[row + 1, i + 1] += step * gy[2]
        jacobian[row, n + 3] += dx + step * gx[3]
        jacobian[row + 1, n + 3] += dy + step * gy[3]
        turn[i] += 0.5 * step
        turn[i + 1] += 0.5 * step
        turn[n + 3] += 0.5 * (k0 + k1)
        heading += 0.5 * step * (k0 + k1)
    return place, jacobian
