"""Kernels of the trajectory codec: whole numbers to bits and back, by Rice's code.

Columns of whole numbers are stored as differences: second ones for the first columns, which are
smooth, and first ones for the others; the first differences are from 0. A difference is
zigzag-coded: 0, -1, 1, -2 .. become 0, 1, 2, 3 .., so that a code near 0 has few bits. A column's
codes are cut into blocks of `BLOCK`. A block has

- 6 bits: 0 if all codes are 0, and nothing follows; else 1 + k;
- for each code c: its quotient q = c >> k as q ones and a zero, then the k low bits of c. From
  `_ESCAPE` on, a quotient is `_ESCAPE` ones without a zero; then follow the number of bits of c
  less 1, in 6 bits, and the bits of c.

The lowest bit of a number comes first, and in a byte the lowest bit. Zeros fill the last byte.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit

BLOCK: Final = 32
"""Number of codes in a block: of 16 to 128, it gives the fewest bytes at little time."""
NO_END: Final = -1
"""Answer of `unpack` if the bits end too early or too late."""
OUT_OF_RANGE: Final = -2
"""Answer of `unpack` if a number is too large."""

_ESCAPE: Final = 20
"""Least quotient that is not written in ones; our choice."""
_HEADER_BITS: Final = 6
_LENGTH_BITS: Final = 6
_MOST_PARAMETER: Final = 60
_PATIENCE: Final = 2
"""Number of parameters in a row that give no fewer bits, after which the search ends; our choice:
codes that stand out have a minimum of their own."""
_ROUNDING: Final = 1.5 * 2.0**52
"""Number whose sum with a number up to 2**51 has no bits behind the point."""

_Integer: TypeAlias = Any
"""Whole number of 64 bits in a kernel: numba tells signed from unsigned ones, mypy need not."""
_Words = npt.NDArray[np.uint32]
_Codes = npt.NDArray[np.uint64]


@njit(interpret_first=0.1)
def round_columns(
    columns: FloatArray, steps_per_unit: FloatArray, most: float, steps: IntArray
) -> _Integer:
    """Write columns, (k, n), as whole numbers of steps.

    Args:
        columns: the columns.
        steps_per_unit: steps in a column's unit, (k,).
        most: largest number of steps, up to 2**51.
        steps: (k, n) array, which is overwritten.

    Returns:
        The index of the first value, counted over all columns, that is not finite or beyond `most`
        steps; -1 without such a value.
    """
    count = columns.shape[1]
    for k in range(len(columns)):
        unit = steps_per_unit[k]
        for i in range(count):
            value = columns[k, i] * unit
            if not abs(value) <= most:  # which is so for NaN, too
                return k * count + i
            steps[k, i] = np.int64((value + _ROUNDING) - _ROUNDING)  # rounds half to even
    return -1


@njit(interpret_first=1.3)
def pack(steps: IntArray, smooth_count: int) -> tuple[_Words, _Integer]:
    """Return the rows of whole numbers, (k, n), as bits, and the number of bytes that these fill.

    Args:
        steps: the rows.
        smooth_count: number of rows, the first ones, that are stored as second differences.
    """
    row_count, count = steps.shape
    most_bits = _ESCAPE + _LENGTH_BITS + 64 + _HEADER_BITS
    words = np.empty(row_count * count * most_bits // 32 + 4, np.uint32)
    codes = np.empty(BLOCK, np.uint64)
    bits, bit_count, word = np.uint64(0), 0, 0
    for row in range(row_count):
        before = change = np.int64(0)
        for start in range(0, count, BLOCK):
            size = min(BLOCK, count - start)
            any_bit = np.uint64(0)
            for i in range(size):
                value = steps[row, start + i]
                difference = value - before
                before = value
                if row < smooth_count:
                    difference, change = difference - change, difference
                codes[i] = np.uint64((difference << 1) ^ (difference >> 63))
                any_bit |= codes[i]
            if any_bit == 0:
                bits, bit_count, word = _put(
                    words, bits, bit_count, word, np.uint64(0), _HEADER_BITS
                )
                continue
            k = _best_parameter(codes, size)
            bits, bit_count, word = _put(
                words, bits, bit_count, word, np.uint64(k + 1), _HEADER_BITS
            )
            low_bits = (np.uint64(1) << np.uint64(k)) - np.uint64(1)
            for i in range(size):
                code = codes[i]
                quotient = code >> np.uint64(k)
                if quotient < _ESCAPE:
                    ones = (np.uint64(1) << quotient) - np.uint64(1)
                    bits, bit_count, word = _put(
                        words, bits, bit_count, word, ones, int(quotient) + 1
                    )
                    bits, bit_count, word = _put(words, bits, bit_count, word, code & low_bits, k)
                else:
                    ones = np.uint64((1 << _ESCAPE) - 1)
                    bits, bit_count, word = _put(words, bits, bit_count, word, ones, _ESCAPE)
                    length = _length_of(code)
                    bits, bit_count, word = _put(
                        words, bits, bit_count, word, np.uint64(length - 1), _LENGTH_BITS
                    )
                    bits, bit_count, word = _put(words, bits, bit_count, word, code, length)
    words[word] = np.uint32(bits)
    return words, 4 * word + (bit_count + 7) // 8


@njit(interpret_first=0.9)
def unpack(
    words: _Words,
    size: int,
    count: int,
    steps_per_unit: FloatArray,
    smooth_count: int,
    most: int,
) -> tuple[_Integer, FloatArray]:
    """Return the columns, (k, count), that `pack` has packed.

    Args:
        words: the packed bytes and at least 8 zeros, as words of 4 bytes, the lowest byte first.
        size: number of packed bytes.
        count: number of values of each column.
        steps_per_unit: steps in a column's unit, (k,).
        smooth_count: number of columns that are stored as second differences.
        most: largest number of steps that is in range.

    Returns:
        0 and the columns; or `NO_END` or `OUT_OF_RANGE` if the data are damaged.
    """
    columns = np.empty((len(steps_per_unit), count))
    end = 8 * size
    # The next bits are in `bits`, the lowest first: `bit_count` of them, then zeros.
    bits, bit_count, word = np.uint64(0), 0, 0
    for row in range(len(steps_per_unit)):
        value = change = np.int64(0)
        unit = steps_per_unit[row]
        for start in range(0, count, BLOCK):
            bits, bit_count, word = _refilled(words, bits, bit_count, word)
            header: _Integer = bits & np.uint64((1 << _HEADER_BITS) - 1)
            k = np.int64(header) - 1
            bits >>= np.uint64(_HEADER_BITS)
            bit_count -= _HEADER_BITS
            # After the end come zeros, so that a block is read without asking for each code.
            if 32 * word - bit_count > end or k > _MOST_PARAMETER:
                return NO_END, columns
            for i in range(start, min(start + BLOCK, count)):
                code = np.uint64(0)
                if k >= 0:
                    bits, bit_count, word = _refilled(words, bits, bit_count, word)
                    quotient = np.uint64(0)
                    while bits & np.uint64(1) and quotient < _ESCAPE:
                        bits >>= np.uint64(1)
                        quotient += np.uint64(1)
                    ones: _Integer = np.int64(quotient)
                    bit_count -= ones
                    low_count: _Integer
                    if quotient < _ESCAPE:
                        bits >>= np.uint64(1)
                        bit_count -= 1
                        code, low_count = quotient << np.uint64(k), k
                    else:
                        bits, bit_count, word = _refilled(words, bits, bit_count, word)
                        low_count = np.int64(bits & np.uint64((1 << _LENGTH_BITS) - 1)) + 1
                        bits >>= np.uint64(_LENGTH_BITS)
                        bit_count -= _LENGTH_BITS
                    if low_count <= bit_count:  # which is so for nearly all
                        code |= bits & ((np.uint64(1) << np.uint64(low_count)) - np.uint64(1))
                        bits >>= np.uint64(low_count)
                        bit_count -= low_count
                    else:
                        low, bits, bit_count, word = _long_number(
                            words, bits, bit_count, word, low_count
                        )
                        code |= low
                difference = np.int64(code >> np.uint64(1)) ^ -np.int64(code & np.uint64(1))
                if row < smooth_count:
                    change += difference
                    difference = change
                value += difference
                if value > most or value < -most:
                    return OUT_OF_RANGE, columns
                columns[row, i] = value / unit
    position = 32 * word - bit_count
    return 0 if (position + 7) // 8 == size and bits == 0 else NO_END, columns


@njit()
def _best_parameter(codes: _Codes, size: int) -> _Integer:
    """Return the parameter k that gives a block few bits, searched from the mean downwards."""
    total = np.uint64(0)  # of codes below 2**55
    for i in range(size):
        total += codes[i]
    mean = total // np.uint64(size)
    k = 0
    while mean >> np.uint64(k) and k < _MOST_PARAMETER:
        k += 1
    best, least = k, _bits_of(codes, size, k)
    while k > 0 and k > best - _PATIENCE:
        k -= 1
        bits = _bits_of(codes, size, k)
        if bits < least:
            best, least = k, bits
    return best


@njit()
def _bits_of(codes: _Codes, size: int, k: int) -> _Integer:
    """Return the number of bits of a block's codes with a parameter."""
    bits: _Integer = size * (k + 1)
    for i in range(size):
        quotient = codes[i] >> np.uint64(k)
        if quotient < _ESCAPE:
            bits += np.int64(quotient)
        else:
            bits += _ESCAPE + _LENGTH_BITS - 1 - k + _length_of(codes[i])
    return bits


@njit()
def _length_of(code: _Integer) -> _Integer:
    """Return the number of bits of a code without leading zeros."""
    length = 0
    while code:
        code >>= np.uint64(1)
        length += 1
    return length


@njit()
def _put(
    words: _Words, bits: _Integer, bit_count: _Integer, word: int, value: _Integer, count: int
) -> tuple[_Integer, int, int]:
    """Append the `count` bits of a value; the value's other bits are 0.

    Bits wait in `bits` until they fill a word: `bit_count` of them, fewer than 32.

    Returns:
        The waiting bits, their number, and the index of the next word.
    """
    while True:
        part = min(count, 32)
        mask = (np.uint64(1) << np.uint64(part)) - np.uint64(1)
        bits |= (value & mask) << np.uint64(bit_count)
        bit_count += part
        if bit_count >= 32:
            words[word] = np.uint32(bits & np.uint64(0xFFFFFFFF))
            bits >>= np.uint64(32)
            bit_count -= 32
            word += 1
        if count <= 32:
            return bits, bit_count, word
        value >>= np.uint64(32)
        count -= 32


@njit()
def _long_number(
    words: _Words, bits: _Integer, bit_count: _Integer, word: int, count: int
) -> tuple[np.uint64, _Integer, int, int]:
    """Return the number in the next `count` bits, at most 64, and what `_refilled` returns."""
    number = np.uint64(0)
    read = 0
    while read < count:
        bits, bit_count, word = _refilled(words, bits, bit_count, word)
        part = min(32, count - read)
        mask = (np.uint64(1) << np.uint64(part)) - np.uint64(1)
        number |= (bits & mask) << np.uint64(read)
        bits >>= np.uint64(part)
        bit_count -= part
        read += part
    return number, bits, bit_count, word


@njit()
def _refilled(
    words: _Words, bits: _Integer, bit_count: _Integer, word: int
) -> tuple[_Integer, int, int]:
    """Return the waiting bits with a word more if they were 32 or fewer; zeros after the end.

    Returns:
        The waiting bits, their number, and the index of the next word.
    """
    if bit_count <= 32:
        if word < len(words):
            bits |= np.uint64(words[word]) << np.uint64(bit_count)
        bit_count += 32
        word += 1
    return bits, bit_count, word
