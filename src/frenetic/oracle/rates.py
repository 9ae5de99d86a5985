"""Rates of change of a drive's values: a derivative at each record, or the mean over a window."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

TIME_ROUNDING: Final = 1e-9
"""Time by which a window may begin before the drive, in s; our choice."""


@njit(error_model="numpy", interpret_first=0.5)
def rate(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Return the mean change of values per s over the window that ends at each record, (n,).

    NaN where the window begins before the drive, or with one record. Without a window, the
    derivative at the record, as of ``np.gradient``. Values are linear between records.

    Args:
        time: times of the records, (n,) in s; with a window they increase strictly.
        values: values at the records, (n,).
        window: length of the window in s; 0 for no window.
    """
    n = len(time)
    rates = np.full(n, math.nan)
    if n < 2:
        return rates
    if window == 0.0:
        _write_derivative(time, values, rates)
        return rates
    k = 0  # the last record up to the window's start
    for i in range(n):
        start = time[i] - window
        if start < time[0] - TIME_ROUNDING:
            continue
        while time[k + 1] <= start:
            k += 1
        at_start = values[k]
        if start > time[k]:
            slope = (values[k + 1] - values[k]) / (time[k + 1] - time[k])
            at_start = slope * (start - time[k]) + values[k]
        rates[i] = (values[i] - at_start) / window
    return rates


@njit(error_model="numpy")
def _write_derivative(time: FloatArray, values: FloatArray, rates: FloatArray) -> None:
    """Write the derivative of values, (n,), n >= 2: of second order, at both ends of first order.

    The terms are added as in ``np.gradient``, which has other terms where all steps are equal.
    """
    last = len(time) - 1
    step = time[1] - time[0]
    is_even = True
    for i in range(last):
        is_even = is_even and time[i + 1] - time[i] == step
    for i in range(1, last):
        if is_even:
            rates[i] = (values[i + 1] - values[i - 1]) / (2.0 * step)
            continue
        before, after = time[i] - time[i - 1], time[i + 1] - time[i]
        first = -after / (before * (before + after))
        middle = (after - before) / (before * after)
        final = before / (after * (before + after))
        rates[i] = first * values[i - 1] + middle * values[i] + final * values[i + 1]
    rates[0] = (values[1] - values[0]) / step
    rates[last] = (values[last] - values[last - 1]) / (time[last] - time[last - 1])
