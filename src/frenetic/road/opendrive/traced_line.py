"""Traced lines: arrays of points along a road with their properties, and closing their gaps.

A traced line is an array (n, 10), one row per point, or its first columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray

TOLERANCE: Final = 0.01
"""Largest distance of a road beside the line in its file, in m; ours."""
GAP: Final = 0.05
"""Largest gap along the road between two geometries, and between two roads, in m; ours."""
ROUNDING: Final = 1e-6
"""Error of computed gaps and turns, in m or rad: a gap of exactly `GAP` must not be refused."""
BLEND: Final = 5.0
"""Length on either side of a gap over which the gap is blended, in m; ours."""

# Columns of a traced line, one row per point. (MOVED_X, MOVED_Y) is how far the blends of gaps
# between a road's geometries have moved the point, in m. LIMIT is the speed limit on the way from
# the row before, in km/h.
DISTANCE, X, Y, HEADING, MOVED_X, MOVED_Y, WIDTH, HEIGHT, LEAN, LIMIT = range(10)


def close_gaps(
    line: FloatArray, rows: Sequence[int], gaps: Sequence[tuple[float, float]]
) -> FloatArray:
    """Move the points of a line (n, >= 4) so that its gaps are closed.

    The sum of the gaps behind a point is a staircase along the line. Each point moves to where the
    mean of the staircase over `BLEND` m on either side, weighted by a triangle, puts it. So the
    line is as smooth there as a road whose curvature jumps by gap / BLEND^2. The time does not
    depend on how dense the gaps are.

    Args:
        line: the line; its places and headings are changed.
        rows: row of the first point behind each gap.
        gaps: each gap (x, y) in m, from the end before the gap to the start behind it.

    Returns:
        The points' moves, (n, 2) in m.
    """
    if not len(rows):
        return np.zeros((len(line), 2))
    stations = line[:, DISTANCE]
    knots = np.concatenate([stations[:1], stations[np.array(rows) - 1]])
    sums = np.concatenate([[(0.0, 0.0)], np.cumsum(gaps, axis=0)])
    # The staircase, constant from knot to knot, and its first and second integral at the knots.
    spans = np.diff(knots)[:, None]
    first = np.concatenate([[(0.0, 0.0)], np.cumsum(spans * sums[:-1], axis=0)])
    pieces = spans * (first[:-1] + 0.5 * spans * sums[:-1])
    second = np.concatenate([[(0.0, 0.0)], np.cumsum(pieces, axis=0)])

    def integrals(places: FloatArray) -> FloatArray:
        k = np.maximum(np.searchsorted(knots, places, side="right") - 1, 0)
        p = (places - knots[k])[:, None]
        return np.stack([first[k] + p * sums[k], second[k] + p * (first[k] + 0.5 * p * sums[k])])

    before, here, behind = (integrals(stations + shift) for shift in (-BLEND, 0.0, BLEND))
    slope, mean = (before - 2.0 * here + behind) / BLEND**2
    moved: FloatArray = mean - sums[np.searchsorted(rows, np.arange(len(line)), side="right")]
    move_points(line, moved, slope)
    return moved


def move_points(line: FloatArray, moved: FloatArray, slope: FloatArray) -> None:
    """Move the points of a line (n, >= 4) by (n, 2) m, which changes by (n, 2) m per m along it."""
    c, s = np.cos(line[:, HEADING]), np.sin(line[:, HEADING])
    line[:, X:HEADING] += moved
    line[:, HEADING] += np.arctan2(
        c * slope[:, 1] - s * slope[:, 0], 1.0 + c * slope[:, 0] + s * slope[:, 1]
    )


def set_distances(line: FloatArray) -> None:
    """Set the distances of a line (n, >= 4) to its length so far, in m."""
    chords = np.hypot(*np.diff(line[:, X:HEADING], axis=0).T)
    arcs = chords * (1.0 + np.diff(line[:, HEADING]) ** 2 / 24.0)
    line[:, DISTANCE] = np.concatenate([[0.0], np.cumsum(arcs)])
