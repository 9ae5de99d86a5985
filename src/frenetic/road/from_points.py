"""The road through points: curvatures, step and pose.

If the points sample a clothoid chain at equal distances, as the points of a `Road` do, the chain is
recovered by Gauss-Newton. Otherwise the road follows a spline through the points.
"""

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
"""Largest distance of points from the clothoid chain that they sample, in m; our choice."""
MOST_RECOGNISED = 300
"""Largest number of points for a chain of clothoids, whose time grows with the cube; our choice."""
_LEAST_RECOGNISED = 8
"""Fewest points for which a clothoid chain is fitted; our choice: through fewer points, a chain may
pass by accident."""
SPLINE_STEP = 0.5
"""Distance between the curvature samples of a road along a spline, in m; our choice."""
CORRECTION = 4.0
"""Length over which a road along a spline corrects its distance from the spline, in m; our choice.
"""
_MAX_CURVATURE = 5.0
"""Largest curvature of a road through points, in 1/m; our choice."""

_ENDS = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Starts of the fit: changes of the first and the last curvature, in units of 0.5 / step."""

Recovered: TypeAlias = tuple[FloatArray, float, tuple[float, float, float]]
"""Curvatures in 1/m, step in m, and pose in m, m and rad of a road."""


def curvature_from_points(points: FloatArray, most_samples: int) -> Recovered:
    """Return curvatures (M,), step and pose of the road through points.

    Args:
        points: the points, (N, 2) in m; consecutive points are distinct.
        most_samples: largest M. M is N for a recovered chain.
    """
    return _recognise(points) or _along_spline(points, most_samples)


def _along_spline(points: FloatArray, most_samples: int) -> Recovered:
    """Return the road along the competition's spline through points, see `interpolate`."""
    from scipy.interpolate import make_interp_spline  # takes as long as the rest of a start-up

    degree = min(len(points) - 1, 3)
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    polyline_length = float(chords[-1])
    # The same spline as scipy's splprep with s = 0: not-a-knot over the normalised chord length.
    spline = make_interp_spline(chords / polyline_length, points, k=degree)
    # Dense enough that between two parameters the line is nearly an arc: every 0.1 m, ten for each
    # point, and at least 64.
    intervals = max(64, 10 * len(points), math.ceil(polyline_length / 0.1))
    parameters = np.linspace(0.0, 1.0, intervals + 1)
    position = spline(parameters)
    first = spline.derivative(1)(parameters)
    second = spline.derivative(2)(parameters) if degree > 1 else np.zeros_like(first)
    # Length of line per parameter, kept above 0 for the division.
    rate = np.hypot(first[:, 0], first[:, 1])
    rate = np.maximum(rate, 1e-9 * max(rate.max(), 1e-300))
    curvature = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / rate**3
    # Distances along the line, by Simpson's rule between two parameters.
    middle = 0.5 * (parameters[1:] + parameters[:-1])
    middle_rate = np.hypot(*spline.derivative(1)(middle).T)
    pieces = (rate[1:] + 4.0 * middle_rate + rate[:-1]) * np.diff(parameters) / 6.0
    distances = np.concatenate([[0.0], np.cumsum(pieces)])
    length = float(distances[-1])
    samples = min(max(2, round(length / SPLINE_STEP)) + 1, most_samples)
    step = length / (samples - 1)
    sample_distances = np.linspace(0.0, length, samples)
    heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    curvature = np.clip(curvature, -_MAX_CURVATURE, _MAX_CURVATURE)
    line = np.column_stack(
        [
            np.interp(sample_distances, distances, column)
            for column in (position[:, 0], position[:, 1], heading, curvature)
        ]
    )
    return (
        follow_line(line, step, max(CORRECTION, 2.0 * step)),
        step,
        (float(line[0, 0]), float(line[0, 1]), float(line[0, 2])),
    )


@njit()
def follow_line(line: FloatArray, step: float, reach: float) -> FloatArray:
    """Return curvatures (n,) in 1/m of a clothoid chain that follows a line.

    A chain with the line's own curvatures drifts away from the line, as the line's curvature is not
    quite linear between samples. Therefore each curvature also corrects the lateral error and the
    heading error of the chain so far, critically damped over ``reach`` m.

    Args:
        line: x, y, heading and curvature of the line, (n, 4) in m, m, rad and 1/m.
        step: distance between two rows along the line, in m.
        reach: length over which errors are corrected, in m.
    """
    n = len(line)
    curvatures = np.empty(n)
    x, y, heading = line[0, 0], line[0, 1], line[0, 2]
    curvatures[0] = line[0, 3]
    for i in range(1, n):
        # The errors that the chain would have here with the line's own curvature.
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
    """Return the clothoid chain that points sample at equal distances; None if they sample none.

    The chain is fitted by Gauss-Newton. The unknowns are its N curvatures, its pose and its step;
    2 N coordinates determine N + 4 unknowns, so from 8 points on no chain fits by accident. The
    coordinates hardly depend on the first and the last curvature (their sign shows in the third
    order only), so several starts for these two are tried, `_ENDS`.
    """
    n = len(points)
    if not _LEAST_RECOGNISED <= n <= MOST_RECOGNISED:
        return None
    chords = np.diff(points, axis=0)
    lengths = np.hypot(chords[:, 0], chords[:, 1])
    directions = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    turns = np.diff(directions)
    # Equal steps along a road have nearly equal chords; other points are not fitted. The tests
    # have some leeway: an arc is longer than its chord by a share of turn^2 / 24, and any other
    # inner piece of a chain by less than six times that share.
    sharpest = np.abs(turns).max()
    if sharpest > 1.2 or lengths.min() < 0.8 * lengths.max():
        return None
    if np.ptp(lengths[1:-1]) > 0.25 * sharpest**2 * lengths.max() + 4.0 * RECOGNISED:
        return None
    step = float((lengths[1:-1] * (1.0 + turns[1:] * turns[:-1] / 24.0)).mean())
    best, best_mismatch = None, math.inf
    unit = 0.5 / step
    for first_change, last_change in _ENDS:
        curvatures = _from_turns(turns / step, first_change * unit, last_change * unit)
        heading = directions[0] - step * (curvatures[0] / 3.0 + curvatures[1] / 6.0)
        start = np.concatenate([curvatures, [points[0, 0], points[0, 1], heading, step]])
        unknowns, mismatch = _gauss_newton(start, points)
        if mismatch < best_mismatch:
            best, best_mismatch = unknowns, mismatch
        # Done, or the points sample no chain: a wrong start for the two ends alone leaves a
        # smaller mismatch than this.
        if best_mismatch < 1e-9 or best_mismatch > 2e-5 * step**3:
            break
    if best is None or best_mismatch > RECOGNISED or np.abs(best[:n]).max() > _MAX_CURVATURE:
        return None
    x, y, heading, step = (float(value) for value in best[n:])
    return best[:n].copy(), step, (x, y, heading)


def _from_turns(turns: FloatArray, first_change: float, last_change: float) -> FloatArray:
    """Return curvatures (N,) in 1/m whose chords have these turns, to first order.

    The chord of a clothoid piece has the direction heading + step * (kappa_i / 3 + kappa_i+1 / 6),
    so the turn from a chord to the next is step * (kappa_i-1 + 4 kappa_i + kappa_i+1) / 6.

    Args:
        turns: turns divided by the step, (N - 2,) in 1/m.
        first_change: first curvature minus the first turn, in 1/m, which the turns do not show.
        last_change: last curvature minus the last turn, in 1/m.
    """
    from scipy.linalg import solve_banded  # scipy takes its time

    n = len(turns)
    bands = np.zeros((3, n))
    bands[0, 1:] = bands[2, :-1] = 1.0 / 6.0
    bands[1] = 4.0 / 6.0
    first, last = turns[0] + first_change, turns[-1] + last_change
    right = turns.copy()
    right[0] -= first / 6.0
    right[-1] -= last / 6.0
    return np.concatenate([[first], solve_banded((1, 1), bands, right), [last]])


def _gauss_newton(unknowns: FloatArray, points: FloatArray) -> tuple[FloatArray, float]:
    """Return the unknowns that fit points best, and their largest mismatch in m.

    The iteration ends when the mismatch is below 1e-12 m, has hardly shrunk for some iterations, is
    still large after several, or the step has become absurd.

    Args:
        unknowns: start of the iteration, see `_chain_jacobian`.
        points: the points, (N, 2) in m.
    """
    from scipy.linalg import lstsq  # scipy takes its time

    step = unknowns[-1]
    best, best_mismatch, stalled = unknowns, math.inf, 0
    for iteration in range(40):
        samples, jacobian = _chain_jacobian(unknowns)
        residual = samples - points.ravel()
        mismatch = float(np.abs(residual).max())
        stalled = 0 if mismatch < 0.5 * best_mismatch else stalled + 1
        if mismatch < best_mismatch:
            best, best_mismatch = unknowns, mismatch
        if best_mismatch < 1e-12 or stalled > 3 or (iteration > 6 and best_mismatch > 0.1):
            break
        change = lstsq(jacobian, residual, cond=1e-14, lapack_driver="gelsy")[0]
        unknowns = unknowns - change
        if not (np.isfinite(unknowns).all() and 0.5 < unknowns[-1] / step < 2.0):
            break
    return best, best_mismatch


@njit()
def _chain_jacobian(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the samples of a clothoid chain, (2 N,), and their Jacobian, (2 N, N + 4).

    A sample is x and y, in m.

    Args:
        unknowns: N curvatures, then x, y and heading of the first sample, and the step.
    """
    n = len(unknowns) - 4
    heading, step = unknowns[n + 2], unknowns[n + 3]
    samples = np.empty(2 * n)
    jacobian = np.zeros((2 * n, n + 4))
    # d(heading)/d(unknown) at the current sample.
    turn = np.zeros(n + 4)
    turn[n + 2] = 1.0
    samples[0] = unknowns[n]
    samples[1] = unknowns[n + 1]
    jacobian[0, n] = 1.0
    jacobian[1, n + 1] = 1.0
    parts = max(1, math.ceil(step))  # of a piece, for Gauss-Legendre quadrature
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
        samples[2 * i + 2] = samples[2 * i] + step * dx
        samples[2 * i + 3] = samples[2 * i + 1] + step * dy
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
    return samples, jacobian
