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

NEGATIVE_ZERO: Final = -(2**63)
"""Multiple that stands for -0.0."""
MISSING: Final = NEGATIVE_ZERO + 1
"""Multiple that stands for a missing number."""
TRUTH: Final = -1
"""Number of decimals of a column of truth values."""
_MOST_DIGITS: Final = 24
"""Most characters of a number: a sign, 19 digits, a point, and an exponent."""
_FALSE, _TRUE = (np.frombuffer(text, np.uint8) for text in (b"false", b"true"))
_ZERO, _POINT, _MINUS, _E = (ord(character) for character in "0.-e")

_Bytes = npt.NDArray[np.uint8]


def decimal_rows(
    multiples: IntArray,
    decimals: IntArray,
    separators: list[bytes],
    *,
    has_exponents: bool,
    missing: bytes = b"",
) -> bytes:
    """Return the rows of a table of decimal numbers as text.

    Args:
        multiples: columns of the table, (k, n), in units of their last decimal; `NEGATIVE_ZERO`
            stands for -0.0, `MISSING` for a missing number.
        decimals: number of decimals of each column, (k,); 0 for whole numbers, which have no point;
            `TRUTH` for a column of 0 and 1, which become ``false`` and ``true``.
        separators: text before each column's number, and text after the last, k + 1.
        has_exponents: whether numbers below 1e-4 are written as `repr` does, such as ``5e-05``.
        missing: text of a missing number, at most 24 characters.
    """
    offsets = np.cumsum([0, *map(len, separators)])
    text = np.frombuffer(b"".join(separators), np.uint8)
    count = multiples.shape[1]
    rows = np.empty(count * (len(text) + _MOST_DIGITS * len(multiples)), np.uint8)
    missing_text = np.frombuffer(missing, np.uint8)
    size = _write_rows(multiples, decimals, text, offsets, has_exponents, missing_text, rows)
    return rows[:size].tobytes()


@njit()
def _write_rows(
    multiples: IntArray,
    decimals: IntArray,
    text: _Bytes,
    offsets: IntArray,
    has_exponents: bool,
    missing: _Bytes,
    rows: _Bytes,
) -> int:
    """Write the rows, and return their number of bytes."""
    end = 0
    for i in range(multiples.shape[1]):
        for k in range(len(multiples)):
            for j in range(offsets[k], offsets[k + 1]):
                rows[end] = text[j]
                end += 1
            if multiples[k, i] == MISSING:
                rows[end : end + len(missing)] = missing
                end += len(missing)
            else:
                end = _write_number(multiples[k, i], decimals[k], has_exponents, rows, end)
        for j in range(offsets[-2], offsets[-1]):
            rows[end] = text[j]
            end += 1
    return end


@njit()
def _write_number(multiple: int, decimals: int, has_exponents: bool, rows: _Bytes, end: int) -> int:
    """Write a number at the index `end`, and return the index after it."""
    if decimals == TRUTH:
        word = _TRUE if multiple else _FALSE
        rows[end : end + len(word)] = word
        return end + len(word)
    if multiple < 0:
        rows[end] = _MINUS
        end += 1
        multiple = 0 if multiple == NEGATIVE_ZERO else -multiple
    while decimals > 1 and multiple % 10 == 0:
        multiple //= 10
        decimals -= 1
    if has_exponents and decimals > 4 and 0 < multiple < 10 ** (decimals - 4):
        return _write_with_exponent(multiple, decimals, rows, end)
    whole, fraction = divmod(multiple, 10**decimals)
    end = _write_whole(whole, rows, end)
    if decimals == 0:
        return end
    rows[end] = _POINT
    for j in range(decimals, 0, -1):
        rows[end + j] = _ZERO + fraction % 10
        fraction //= 10
    return end + decimals + 1


@njit()
def _write_with_exponent(multiple: int, decimals: int, rows: _Bytes, end: int) -> int:
    """Write a number below 1e-4 with an exponent of two digits, and return the index after it."""
    digits = _digits_of(multiple)
    first = 10 ** (digits - 1)
    rows[end] = _ZERO + multiple // first
    end += 1
    if digits > 1:
        rows[end] = _POINT
        end = _write_digits(multiple % first, digits - 1, rows, end + 1)
    rows[end], rows[end + 1] = _E, _MINUS
    return _write_digits(decimals - digits + 1, 2, rows, end + 2)


@njit()
def _write_whole(number: int, rows: _Bytes, end: int) -> int:
    """Write a whole number, and return the index after it."""
    return _write_digits(number, _digits_of(number), rows, end)


@njit()
def _digits_of(number: int) -> int:
    """Return the number of digits of a whole number."""
    digits = 1
    while digits < 19 and number >= 10**digits:
        digits += 1
    return digits


@njit()
def _write_digits(number: int, digits: int, rows: _Bytes, end: int) -> int:
    """Write the last digits of a whole number, and return the index after them."""
    for j in range(digits - 1, -1, -1):
        rows[end + j] = _ZERO + number % 10
        number //= 10
    return end + digits
