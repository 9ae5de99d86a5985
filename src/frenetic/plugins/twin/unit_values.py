"""The scale of fitted parameters: unit values from 0 at the low bound to 1 at the high bound.

The scale is logarithmic if the low bound is positive, otherwise linear.
"""

from __future__ import annotations

import math


def value_at(unit_value: float, low: float, high: float) -> float:
    """Return the value of a unit value, which is cut to 0..1."""
    unit_value = min(max(unit_value, 0.0), 1.0)
    if low > 0.0:
        value = math.exp(math.log(low) + unit_value * math.log(high / low))
    else:
        value = low + unit_value * (high - low)
    return min(max(value, low), high)


def unit_value_of(value: float, low: float, high: float) -> float:
    """Return the unit value of a value between the bounds."""
    if low > 0.0:
        return math.log(value / low) / math.log(high / low)
    return (value - low) / (high - low)
