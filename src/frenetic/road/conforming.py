"""Conforming: curvatures that follow wishes as far as a road class lets them."""

from __future__ import annotations

import math
from typing import Final

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

NO_CHANGE: Final = 1e-12
"""Largest difference of two curvatures that count as equal, in 1/m; ours."""


@njit()
def conform(values: FloatArray, limits: FloatArray, wished: FloatArray) -> None:
    """Make curvatures, (n,) 1/m, meet a class's rules, from the first value on, in place.

    Each value is a wish. After a curvature has lasted long enough, a clothoid leads to the next
    wish at which the wishes turn or rest. The clothoid follows the wishes if they change slowly
    enough, and otherwise changes as fast as is allowed. Then the curvature lasts. Wishes that meet
    the rules stay as they are.

    Args:
        values: wishes, then the curvatures, (n,) in 1/m.
        limits: limits, (4,), see `RoadClass.limits`.
        wished: working memory, (n,).
    """
    bound, change, arc, straight = limits[0], limits[1], int(limits[2]), int(limits[3])
    n = len(values)
    for i in range(n):
        wished[i] = min(max(values[i], -bound), bound)
    values[0] = wished[0]
    i = 0
    free = 0  # index from which the present curvature may be left
    begun = 0  # index where the present straight began
    side = 0.0  # side of the last bend; 0 before the first
    while i < n - 1:
        now = values[i]
        target = now
        turn = i + 1  # where the wishes turn or rest next
        if i >= free and abs(wished[i + 1] - now) > NO_CHANGE:
            while turn + 1 < n:
                step = wished[turn + 1] - wished[turn]
                if abs(step) <= NO_CHANGE:
                    break
                if turn > i + 1 and step * (wished[turn] - wished[turn - 1]) < 0.0:
                    break
                turn += 1
            target = wished[turn]
            if abs(target) <= NO_CHANGE:
                target = 0.0
            if now == 0.0 and side * target > 0.0 and i - begun < straight:
                target = now
        if abs(target - now) <= NO_CHANGE:
            i += 1
            values[i] = now
            continue
        needed = max(math.ceil(abs(target - now) / change - 1e-9), 1)
        is_kept = turn - i >= needed
        for k in range(i + 1, turn + 1):
            before = now if k == i + 1 else wished[k - 1]
            rise = (wished[k] - before) * (1.0 if target > now else -1.0)
            is_kept = is_kept and 0.0 < rise <= change * (1.0 + 1e-9)
        count = turn - i if is_kept else needed
        for k in range(1, count + 1):
            if i + k < n:
                values[i + k] = wished[i + k] if is_kept else now + (target - now) * k / count
        if now != 0.0:
            side = 1.0 if now > 0.0 else -1.0
        i += count
        if i < n:
            values[i] = target
        free = i
        begun = i
        if target != 0.0:
            side = 1.0 if target > 0.0 else -1.0
            free = i + arc
