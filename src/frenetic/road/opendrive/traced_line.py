"""Traced lines: points along a road with their properties, and how gaps between them are closed.

A traced line is an array with one row for each point. Its ten columns are:

============  ==================================================================
``DISTANCE``  distance along the line, in m
``X, Y``      position of the point, in m
``HEADING``   heading of the line, in rad
``MOVED_X,``  move of the point by the blends of gaps between a road's geometries,
``MOVED_Y``   in m
``WIDTH``     width of the lane, in m
``HEIGHT``    height of the lane's inner edge, in m
``LEAN``      slope across the lane, in m/m
``LIMIT``     speed limit from the point before to this point, in km/h; 0 for none
============  ==================================================================

Arrays with only the first columns, (n, 4) or (n, 6), occur on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray

TOLERANCE: Final = 0.01
"""Largest distance of a road that was read from the line in its file, in m; our choice."""
GAP: Final = 0.05
"""Largest gap along the road between two geometries, or between two roads, in m; our choice."""
ROUNDING: Final = 1e-6
"""Error of computed gaps in m and turns in rad, so that a gap of exactly `GAP` is allowed; our
choice."""
BLEND: Final = 5.0
"""Length on either side of a gap over which the gap is blended, in m; our choice."""

DISTANCE, X, Y, HEADING, MOVED_X, MOVED_Y, WIDTH, HEIGHT, LEAN, LIMIT = range(10)
"""Columns of a traced line."""


def close_gaps(
    line: FloatArray, rows: Sequence[int], gaps: Sequence[tuple[float, float]]
) -> FloatArray:
    """Move the points of a line, in place, so that its gaps are closed.

    The sum of all gaps before a point is a staircase along the line. It is replaced by its smooth
    mean over `BLEND` m on either side, weighted by a triangle: each point moves by the mean minus
    the staircase. The line is then as smooth as a road whose curvature jumps by gap / BLEND^2. The
    time does not depend on how close the gaps are.

    Args:
        line: the line, with at least 4 columns; positions and headings are changed.
        rows: row of the first point after each gap.
        gaps: each gap (x, y) in m, from the end before the gap to the start after it.

    Returns:
        The points' moves, (n, 2) in m.
    """
    if not len(rows):
        return np.zeros((len(line), 2))
    stations = line[:, DISTANCE]
    knots = np.concatenate([stations[:1], stations[np.array(rows) - 1]])
    sums = np.concatenate([[(0.0, 0.0)], np.cumsum(gaps, axis=0)])
    # The staircase is constant between knots. Its first and second integral at the knots:
    spans = np.diff(knots)[:, None]
    first = np.concatenate([[(0.0, 0.0)], np.cumsum(spans * sums[:-1], axis=0)])
    pieces = spans * (first[:-1] + 0.5 * spans * sums[:-1])
    second = np.concatenate([[(0.0, 0.0)], np.cumsum(pieces, axis=0)])

    def integrals(ends: FloatArray) -> FloatArray:
        """Return the first and the second integral of the staircase, up to stations (n,)."""
        k = np.maximum(np.searchsorted(knots, ends, side="right") - 1, 0)
        p = (ends - knots[k])[:, None]
        return np.stack([first[k] + p * sums[k], second[k] + p * (first[k] + 0.5 * p * sums[k])])

    # The mean weighted by a triangle is the second difference of the second integral, and the slope
    # of the mean is the second difference of the first integral.
    before, here, after = (integrals(stations + shift) for shift in (-BLEND, 0.0, BLEND))
    slope, mean = (before - 2.0 * here + after) / BLEND**2
    moved: FloatArray = mean - sums[np.searchsorted(rows, np.arange(len(line)), side="right")]
    move_points(line, moved, slope)
    return moved


def move_points(line: FloatArray, moved: FloatArray, slope: FloatArray) -> None:
    """Move the points of a line, in place, and turn its headings accordingly.

    Args:
        line: the line, with at least 4 columns.
        moved: move of each point, (n, 2) in m.
        slope: change of the move along the line, (n, 2) in m per m.
    """
    c, s = np.cos(line[:, HEADING]), np.sin(line[:, HEADING])
    line[:, X:HEADING] += moved
    line[:, HEADING] += np.arctan2(
        c * slope[:, 1] - s * slope[:, 0], 1.0 + c * slope[:, 0] + s * slope[:, 1]
    )


def set_distances(line: FloatArray) -> None:
    """Set the distances of a line with at least 4 columns, in place, to its length so far, in m.

    Between two points the line is taken for an arc.
    """
    chords = np.hypot(*np.diff(line[:, X:HEADING], axis=0).T)
    arcs = chords * (1.0 + np.diff(line[:, HEADING]) ** 2 / 24.0)
    line[:, DISTANCE] = np.concatenate([[0.0], np.cumsum(arcs)])
