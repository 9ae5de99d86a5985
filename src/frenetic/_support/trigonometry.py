"""Sine, cosine, arctangent and hypotenuse for kernels: the same bits on every system.

The mathematics library of each system rounds these functions in its own way. These kernels use
the four operations, square roots and roundings alone, whose results IEEE 754 defines to the last
bit, and no branches. So a loop that calls them can be compiled to vector instructions, and a
car has the same drive alone and beside others. Their errors are below 5e-16.

Each polynomial interpolates its function at Chebyshev nodes and is off by at most 2e-18.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.compiled import njit

_TURN: Final = 6.2831853069365025
"""First 33 bits of a whole turn, in rad: its product with a whole number of turns is exact."""
_TURN_REST: Final = 2.430840202602477e-10
"""A whole turn without `_TURN`, in rad."""
_EIGHTH: Final = math.sqrt(2.0) - 1.0
"""Tangent of an eighth of a half turn."""


@njit(error_model="numpy", force_inline=True)
def wrapped(angle: float) -> float:
    """Return the angle without whole turns: in rad, -pi to pi."""
    turns: float = np.rint(angle * (0.5 / math.pi))
    return angle - turns * _TURN - turns * _TURN_REST


@njit(error_model="numpy", force_inline=True)
def sine_within_turn(angle: float) -> float:
    """Return the sine of an angle between -pi and pi, in rad."""
    size = abs(angle)
    x = size if size <= 0.5 * math.pi else math.pi - size
    q = x * x
    # (sin(x) / x - 1) / q
    rest = 2.7314447669863995e-15
    rest = rest * q - 7.643970296798572e-13
    rest = rest * q + 1.6058977312464087e-10
    rest = rest * q - 2.5052107616996182e-08
    rest = rest * q + 2.7557319219163234e-06
    rest = rest * q - 0.00019841269841254974
    rest = rest * q + 0.008333333333333316
    rest = rest * q - 0.16666666666666666
    value = x + x * (q * rest)
    return value if angle >= 0.0 else -value


@njit(error_model="numpy", force_inline=True)
def cosine_within_turn(angle: float) -> float:
    """Return the cosine of an angle between -pi and pi, in rad."""
    return sine_within_turn(0.5 * math.pi - abs(angle))


@njit(error_model="numpy", force_inline=True)
def sine(angle: float) -> float:
    """Return the sine of an angle in rad."""
    return sine_within_turn(wrapped(angle))


@njit(error_model="numpy", force_inline=True)
def cosine(angle: float) -> float:
    """Return the cosine of an angle in rad."""
    return cosine_within_turn(wrapped(angle))


@njit(error_model="numpy", force_inline=True)
def arctangent(x: float) -> float:
    """Return the angle in rad, -pi/2 to pi/2, whose tangent is ``x``."""
    size = abs(x)
    # atan(size) = base + atan(t), where t is at most the tangent of an eighth of a half turn.
    is_high, is_middle = size > 1.0 / _EIGHTH, size > _EIGHTH
    over = -1.0 if is_high else (size - 1.0 if is_middle else size)
    under = size if is_high else (size + 1.0 if is_middle else 1.0)
    base = 0.5 * math.pi if is_high else (0.25 * math.pi if is_middle else 0.0)
    t = over / under
    q = t * t
    # (atan(t) / t - 1) / q
    rest = -0.01917688711906226
    rest = rest * q + 0.03923165829558719
    rest = rest * q - 0.0508544973794026
    rest = rest * q + 0.0585814891280221
    rest = rest * q - 0.06664511447381948
    rest = rest * q + 0.07692183190826087
    rest = rest * q - 0.09090904578123903
    rest = rest * q + 0.11111111015256361
    rest = rest * q - 0.14285714284666542
    rest = rest * q + 0.1999999999999552
    rest = rest * q - 0.3333333333333333
    value = base + (t + t * (q * rest))
    return value if x >= 0.0 else -value


@njit(error_model="numpy", force_inline=True)
def hypotenuse(x: float, y: float) -> float:
    """Return the length of the vector (x, y)."""
    return math.sqrt(x * x + y * y)
