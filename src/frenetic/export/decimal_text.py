"""Rows of decimal numbers as text, in the shortest form that gives the same numbers again.

Stored trajectories are whole multiples of a power of ten, so that their digits are known: a kernel
writes 40 million numbers a second, where `repr` writes two.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import IntArray
from frenetic._support.compiled import njit

_MOST_DIGITS: Final = 24
"""Most characters of a number: a sign, 19 digits, a point, and an exponent."""
_ZERO, _POINT, _MINUS, _E = (ord(character) for character in "0.-e")

_Bytes = npt.NDArray[np.uint8]


def decimal_rows(
    multiples: IntArray, decimals: IntArray, separators: list[bytes], *, has_exponents: bool
) -> bytes:
    """Return the rows of a table of decimal numbers as text.

    Args:
        multiples: columns of the table, (k, n), in units of their last decimal.
        decimals: number of decimals of each column, (k,), at least 1.
        separators: text before each column's number, and text after the last, k + 1.
        has_exponents: whether numbers below 1e-4 are written as `repr` does, such as ``5e-05``.
    """
    offsets = np.cumsum([0, *map(len, separators)])
    text = np.frombuffer(b"".join(separators), np.uint8)
    count = multiples.shape[1]
    rows = np.empty(count * (len(text) + _MOST_DIGITS * len(multiples)), np.uint8)
    size = _write_rows(multiples, decimals, text, offsets, has_exponents, rows)
    return rows[:size].tobytes()


@njit()
def _write_rows(
    multiples: IntArray,
    decimals: IntArray,
    text: _Bytes,
    offsets: IntArray,
    has_exponents: bool,
    rows: _Bytes,
) -> int:
    """Write the rows, and return their number of bytes."""
    end = 0
    for i in range(multiples.shape[1]):
        for k in range(len(multiples)):
            for j in range(offsets[k], offsets[k + 1]):
                rows[end] = text[j]
                end += 1
            end = _write_number(multiples[k, i], decimals[k], has_exponents, rows, end)
        for j in range(offsets[-2], offsets[-1]):
            rows[end] = text[j]
            end += 1
    return end


@njit()
def _write_number(multiple: int, decimals: int, has_exponents: bool, rows: _Bytes, end: int) -> int:
    """Write a number at the index `end`, and return the index after it."""
    if multiple < 0:
        rows[end] = _MINUS
        end += 1
        multiple = -multiple
    if has_exponents and decimals > 4 and 0 < multiple < 10 ** (decimals - 4):
        # Only one digit is left below 1e-4: a resolution of 1e-5 is the finest.
        rows[end], rows[end + 1], rows[end + 2] = _ZERO + multiple, _E, _MINUS
        rows[end + 3], rows[end + 4] = _ZERO, _ZERO + decimals
        return end + 5
    count = decimals
    while count > 1 and multiple % 10 == 0:
        multiple //= 10
        count -= 1
    whole, fraction = divmod(multiple, 10**count)
    digits = 1
    while whole >= 10**digits:
        digits += 1
    for j in range(digits - 1, -1, -1):
        rows[end + j] = _ZERO + whole % 10
        whole //= 10
    end += digits
    rows[end] = _POINT
    for j in range(count, 0, -1):
        rows[end + j] = _ZERO + fraction % 10
        fraction //= 10
    return end + count + 1
