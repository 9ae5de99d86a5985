"""Overlaps: whether a road is twisted or meets itself, by the competition's rule.

The competition's road is a chain of quadrilaterals between the edges of consecutive interpolated
points:

    left[i]   o-----------o left[i + 1]
              |           |                quad i
    node[i]   +           +                = left[i], left[i + 1], right[i + 1], right[i]
              |           |
    right[i]  o-----------o right[i + 1]
              line i      line i + 1       line i runs from left[i] to right[i]

"Ahead" of line i is the side of the line to which the road leads there. A quad is *plain* if it
lies ahead of its first line and behind its second line. Then three things hold: it is convex; it
meets a plain neighbour in their common line only; and it does not meet a later quad that lies
entirely ahead of its second line. These tests settle nearly every pair of quads of an ordinary
road. The few other pairs are compared edge by edge. Pairs that are too far apart to meet are
skipped, together with the quads that the road needs to come back. Along such a chain, no quad lies
inside another unless their edges meet, so comparing edges suffices.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

_AREA_ROUNDING: Final = 1e-6
"""Area above the rounding error of the product of two road widths, in m2; our choice."""
_LENGTH_ROUNDING: Final = 1e-6
"""Length above the rounding errors of the extents of quads, in m; our choice."""


@njit(interpret_first=1.9)
def is_overlapping(left: FloatArray, right: FloatArray) -> bool:
    """Return whether a quad is twisted, or touches another quad beyond a neighbour's common line.

    The time is nearly linear in the number of quads if the road seldom comes near itself.

    Args:
        left: points of the left edge, (M, 2) in m.
        right: points of the right edge, (M, 2) in m.
    """
    quads = len(left) - 1
    plain = np.empty(quads, dtype=np.bool_)
    for i in range(quads):
        plain[i] = _is_ahead(left, right, i, i + 1) and _is_ahead(right, left, i + 1, i)
        if not plain[i] and (
            _segments_touch(left[i], left[i + 1], right[i], right[i + 1])
            or _segments_touch(left[i], right[i], left[i + 1], right[i + 1])
        ):
            return True
    for i in range(quads - 1):
        if not (plain[i] and plain[i + 1]) and not _share_only_their_line(left, right, i):
            return True

    centres = np.empty((quads, 2))
    reach = np.zeros(quads)  # [m] largest distance of a quad's corner from its centre
    hop = 0.0  # [m] largest distance between consecutive centres
    for i in range(quads):
        for axis in range(2):
            start, end = left[i, axis] + right[i, axis], left[i + 1, axis] + right[i + 1, axis]
            centres[i, axis] = 0.25 * (start + end)
        for edge in (left, right):
            for k in range(i, i + 2):
                dx, dy = edge[k, 0] - centres[i, 0], edge[k, 1] - centres[i, 1]
                reach[i] = max(reach[i], math.sqrt(dx * dx + dy * dy))
        if i > 0:
            dx = centres[i, 0] - centres[i - 1, 0]
            dy = centres[i, 1] - centres[i - 1, 1]
            hop = max(hop, math.sqrt(dx * dx + dy * dy))
    longest_reach = reach.max() + _LENGTH_ROUNDING

    for i in range(quads - 2):
        near = reach[i] + longest_reach
        # A vector ahead of line i + 1; it is as long as the road is wide.
        x, y = left[i + 1, 0], left[i + 1, 1]
        ahead_x = y - right[i + 1, 1]
        ahead_y = right[i + 1, 0] - x
        j = i + 2
        while j < quads:
            dx = centres[j, 0] - centres[i, 0]
            dy = centres[j, 1] - centres[i, 1]
            squared = dx * dx + dy * dy
            if squared > near * near:
                # The road needs more than this many quads to come back within reach.
                j += 1 + int((math.sqrt(squared) - near) / hop)
                continue
            apart = (
                plain[i]
                and ahead_x * (left[j, 0] - x) + ahead_y * (left[j, 1] - y) > _AREA_ROUNDING
                and ahead_x * (right[j, 0] - x) + ahead_y * (right[j, 1] - y) > _AREA_ROUNDING
                and ahead_x * (left[j + 1, 0] - x) + ahead_y * (left[j + 1, 1] - y) > _AREA_ROUNDING
                and ahead_x * (right[j + 1, 0] - x) + ahead_y * (right[j + 1, 1] - y)
                > _AREA_ROUNDING
            )
            if not apart and _edges_touch(left, right, i, j):
                return True
            j += 1
    return False


@njit()
def _is_ahead(left: FloatArray, right: FloatArray, line: int, other: int) -> bool:
    """Return whether all of line `other` lies ahead of line `line`.

    With `left` and `right` swapped, return whether it lies behind line `line`.
    """
    ax, ay = left[line, 0], left[line, 1]
    bx, by = right[line, 0], right[line, 1]
    return bool(
        _side(ax, ay, bx, by, left[other, 0], left[other, 1]) > 0.0
        and _side(ax, ay, bx, by, right[other, 0], right[other, 1]) > 0.0
    )


@njit()
def _edge(left: FloatArray, right: FloatArray, i: int, k: int) -> tuple[FloatArray, FloatArray]:
    """Return the ends of edge k of quad i: left (0), right (1), first line (2), second line (3)."""
    if k == 0:
        return left[i], left[i + 1]
    if k == 1:
        return right[i], right[i + 1]
    return left[i + k - 2], right[i + k - 2]


@njit()
def _edges_touch(left: FloatArray, right: FloatArray, i: int, j: int) -> bool:
    """Return whether an edge of quad i has a point in common with an edge of quad j."""
    for k in range(4):
        a, b = _edge(left, right, i, k)
        for m in range(4):
            c, d = _edge(left, right, j, m)
            if _segments_touch(a, b, c, d):
                return True
    return False


@njit()
def _share_only_their_line(left: FloatArray, right: FloatArray, i: int) -> bool:
    """Return whether the untwisted quads i and i + 1 have only line i + 1 in common.

    Two conditions have to hold. The quads lie on different sides of the line, which is the case if
    their corners turn the same way. And their other edges meet in the ends of the line only. (Two
    edges that run along each other from such an end are not compared: then the edge after the
    shorter one touches the longer one.)
    """
    if _turns_clockwise(left, right, i) != _turns_clockwise(left, right, i + 1):
        return False
    for k in (0, 1, 2):
        a, b = _edge(left, right, i, k)
        for m in (0, 1, 3):
            c, d = _edge(left, right, i + 1, m)
            if k != m and _segments_touch(a, b, c, d):
                return False
    return True


@njit()
def _turns_clockwise(left: FloatArray, right: FloatArray, i: int) -> bool:
    """Return whether left[i], left[i + 1], right[i + 1], right[i] is a clockwise turn."""
    a = right[i + 1] - left[i]
    b = right[i] - left[i + 1]
    return bool(a[0] * b[1] - a[1] * b[0] < 0.0)


@njit()
def _segments_touch(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> bool:
    """Return whether the segments from a to b and from c to d have a point in common."""
    for axis in range(2):
        if max(a[axis], b[axis]) < min(c[axis], d[axis]):
            return False
        if max(c[axis], d[axis]) < min(a[axis], b[axis]):
            return False
    # The boxes meet, so the segments do, unless one lies strictly on one side of the other.
    c_side = _side(a[0], a[1], b[0], b[1], c[0], c[1])
    d_side = _side(a[0], a[1], b[0], b[1], d[0], d[1])
    if c_side * d_side > 0.0:
        return False
    a_side = _side(c[0], c[1], d[0], d[1], a[0], a[1])
    b_side = _side(c[0], c[1], d[0], d[1], b[0], b[1])
    return a_side * b_side <= 0.0


@njit()
def _side(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the area of the triangle a, b, c in m2: positive if c lies left of a to b."""
    return (ax - cx) * (by - cy) - (ay - cy) * (bx - cx)
