"""Statistics of paired differences: the signed-rank test, and the interval that belongs to it.

The interval and the test assume only that a difference is as likely to one side of its middle as to
the other. For two drivers that are alike this holds: their names could be exchanged.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, IntArray
from frenetic.analysis.statistics import ValueWithInterval, ranks

MOST_EXACT: Final = 80
"""Largest number of pairs for an exact test and interval (our choice)."""
_HALVINGS: Final = 60
"""Number of halvings that find a mean of two differences as exactly as a number can hold it."""


def signed_rank_p(differences: npt.ArrayLike) -> float:
    """Return p of the two-sided Wilcoxon signed-rank test that differences are symmetric about 0.

    Differences of 0 are ranked and then left out (J. W. Pratt, "Remarks on zeros and ties in the
    Wilcoxon signed rank procedures", Journal of the American Statistical Association 54, 1959). Up
    to `MOST_EXACT` differences p is exact, also with ties: the share of all choices of signs that
    give a sum of ranks at least as far from its mean. For more, p follows from the normal
    distribution with the same mean and variance.

    Args:
        differences: (n,) differences; 1 without any difference from 0.
    """
    values = np.asarray(differences, dtype=np.float64)
    is_nonzero = values != 0.0
    if not is_nonzero.any():
        return 1.0
    # Ranks of ties are halves; doubled ranks are whole numbers.
    doubled = np.rint(2.0 * ranks(np.abs(values))).astype(np.int64)[is_nonzero]
    positive_sum = int(doubled[values[is_nonzero] > 0.0].sum())
    deviation = abs(positive_sum - 0.5 * int(doubled.sum()))
    if len(values) > MOST_EXACT:
        from scipy.special import ndtr  # slow to import, but faster than scipy.stats

        return float(2.0 * ndtr(-deviation / (0.5 * math.sqrt(float((doubled**2).sum())))))
    shares = _sum_shares(doubled)
    deviations = np.abs(np.arange(len(shares)) - 0.5 * int(doubled.sum()))
    return min(1.0, float(shares[deviations >= deviation].sum()))


def _sum_shares(ranks: IntArray) -> FloatArray:
    """Return the share of all choices of some of the ranks that has each sum, (total + 1,)."""
    shares = np.zeros(int(ranks.sum()) + 1)
    shares[0] = 1.0
    for rank in ranks.tolist():
        shares *= 0.5  # of the choices without this rank
        shares[rank:] += shares[: len(shares) - rank].copy()
    return shares


def paired_shift(differences: npt.ArrayLike, confidence: float = 0.95) -> ValueWithInterval:
    """Return the Hodges-Lehmann estimate of paired differences, with Wilcoxon's interval.

    The estimate is the median of the means of all pairs of differences, each with itself, too. It
    is the middle of the differences, which a few odd roads do not move, and more precise than their
    median. The interval holds all shifts that the signed-rank test does not refuse. For fewer than
    6 differences no such interval has a confidence of 95 %, so it is infinite.

    Args:
        differences: (n,) differences, n >= 1.
        confidence: 0..1.
    """
    ordered = np.sort(np.asarray(differences, dtype=np.float64))
    n = len(ordered)
    count = n * (n + 1) // 2  # of the means
    left_out = _means_left_out(n, 1.0 - confidence)
    middle = 0.5 * (_mean_of_two(ordered, (count + 1) // 2) + _mean_of_two(ordered, count // 2 + 1))
    low, high = -math.inf, math.inf
    if left_out >= 1:
        low = _mean_of_two(ordered, left_out)
        high = _mean_of_two(ordered, count + 1 - left_out)
    return ValueWithInterval(middle, low, high)


def _means_left_out(n: int, error: float) -> int:
    """Return the place, from 1, of the interval's lower end among the ordered means; 0 for none.

    Args:
        n: number of differences.
        error: chance that the interval misses the middle.
    """
    if n <= MOST_EXACT:
        cumulated = np.cumsum(_sum_shares(np.arange(1, n + 1)))
        return int((2.0 * cumulated <= error).sum())
    from scipy.special import ndtri  # slow to import, but faster than scipy.stats

    spread = math.sqrt(n * (n + 1) * (2 * n + 1) / 24.0)
    return math.floor(0.25 * n * (n + 1) + float(ndtri(0.5 * error)) * spread)


def _mean_of_two(ordered: FloatArray, place: int) -> float:
    """Return the mean of two differences at a place, from 1, among all such means in order.

    Args:
        ordered: (n,) differences in ascending order.
        place: place from 1 to n (n + 1) / 2; each difference has a mean with itself.
    """
    n = len(ordered)
    low, high = float(ordered[0]), float(ordered[-1])
    for _ in range(_HALVINGS):
        if low == high:
            break
        middle = 0.5 * (low + high)
        # Partners of each difference, from itself upwards, whose mean with it is at most `middle`.
        partners = np.searchsorted(ordered, 2.0 * middle - ordered, side="right") - np.arange(n)
        if int(np.maximum(partners, 0).sum()) >= place:
            high = middle
        else:
            low = middle
    last = np.searchsorted(ordered, 2.0 * high - ordered, side="right") - 1
    means = 0.5 * (ordered + ordered[np.maximum(last, 0)])
    return float(means[last >= np.arange(n)].max(initial=ordered[0]))
