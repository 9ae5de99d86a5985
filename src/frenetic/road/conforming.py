"""Conforming: turning wished curvatures into curvatures that a road class allows."""

from __future__ import annotations

import math
from typing import Final

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

NO_CHANGE: Final = 1e-12
"""Largest difference of two curvatures that count as equal, in 1/m; our choice."""
_ROUNDING: Final = 1e-9
"""Number of steps, or share of a change, by which a computed value may miss a limit; our choice."""


@njit(interpret_first=0.5)
def conform(values: FloatArray, limits: FloatArray, wished: FloatArray) -> None:
    """Make curvatures, (n,) in 1/m, meet a class's limits, in place, from the first value on.

    The passed curvatures are wishes. The result consists of steady parts (arcs and straights) and
    of clothoids between them. When a steady part has its least length, a clothoid leads to the wish
    at which the wishes next change direction or stay the same. Where the wishes up to there change
    slowly enough, the clothoid has their values; otherwise its curvature changes as fast as is
    allowed. The next steady part follows. Wishes that meet the limits stay unchanged.

    Args:
        values: the wishes; the resulting curvatures replace them.
        limits: limits, (4,), see `RoadClass.limits`.
        wished: working memory, (n,).
    """
    max_curvature, max_change = limits[0], limits[1]
    arc_steps, straight_steps = int(limits[2]), int(limits[3])
    n = len(values)
    for i in range(n):
        wished[i] = min(max(values[i], -max_curvature), max_curvature)
    values[0] = wished[0]
    i = 0
    free_from = 0  # index from which the present curvature may change
    part_start = 0  # index at which the present steady part began
    side = 0.0  # sign of the last bend's curvature; 0 before the first bend
    while i < n - 1:
        now = values[i]
        target = now
        end = i + 1  # index at which the wishes next change direction or stay the same
        if i >= free_from and abs(wished[i + 1] - now) > NO_CHANGE:
            while end + 1 < n:
                step = wished[end + 1] - wished[end]
                if abs(step) <= NO_CHANGE:
                    break
                if end > i + 1 and step * (wished[end] - wished[end - 1]) < 0.0:
                    break
                end += 1
            target = wished[end]
            if abs(target) <= NO_CHANGE:
                target = 0.0
            if now == 0.0 and side * target > 0.0 and i - part_start < straight_steps:
                target = now  # this straight is too short for another bend to the same side
        if abs(target - now) <= NO_CHANGE:
            i += 1
            values[i] = now
            continue
        steps_needed = max(math.ceil(abs(target - now) / max_change - _ROUNDING), 1)
        follows_wishes = end - i >= steps_needed
        for k in range(i + 1, end + 1):
            before = now if k == i + 1 else wished[k - 1]
            rise = (wished[k] - before) * (1.0 if target > now else -1.0)
            follows_wishes = follows_wishes and 0.0 < rise <= max_change * (1.0 + _ROUNDING)
        count = end - i if follows_wishes else steps_needed
        for k in range(1, count + 1):
            if i + k < n:
                values[i + k] = (
                    wished[i + k] if follows_wishes else now + (target - now) * k / count
                )
        if now != 0.0:
            side = 1.0 if now > 0.0 else -1.0
        i += count
        if i < n:
            values[i] = target
        free_from = i
        part_start = i
        if target != 0.0:
            side = 1.0 if target > 0.0 else -1.0
            free_from = i + arc_steps
