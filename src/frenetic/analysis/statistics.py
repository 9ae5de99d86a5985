"""Statistics for few repeats: intervals, effect sizes and tests that assume no distribution.

The tests are scipy's, except for what scipy does not have: quartiles of infinite values, exact p
values with ties, Holm's correction, the difference of paired shares, and intervals of rates.
Wilson's interval and ranks are a few lines here, because the import of `scipy.stats` takes as long
as a tenth of a report.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import JSONValue

LEAST_REPEATS: Final = 5
"""Fewest values per group for a verdict (our choice); 5 and 5 can give a p of 0.008."""
SIGNIFICANT: Final = 0.05
"""Value of p below which a difference counts as more than chance."""
MOST_EXACT: Final = 80
"""Largest number of values in both groups together for an exact Mann-Whitney test (our choice)."""
MOST_PERMUTED: Final = 8
"""Largest number of pairs for an exact p of Spearman's rank correlation (our choice)."""
_ROUNDING: Final = 1e-9  # difference of two products of ranks that a rounding error can make


@dataclass(frozen=True)
class Quartiles:
    """Least, most and quartiles of values, which may be infinite."""

    n: int
    """Number of values."""
    least: float
    """Least value."""
    low: float
    """First quartile."""
    median: float
    """Median."""
    high: float
    """Third quartile."""
    most: float
    """Largest value."""


@dataclass(frozen=True)
class ValueWithInterval:
    """Estimated value with its confidence interval."""

    value: float
    """Estimated value."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""

    @property
    def sign(self) -> int:
        """Sign of the whole interval: 1 or -1 if it lies above or below 0, else 0."""
        return (self.low > 0.0) - (self.high < 0.0)


@dataclass(frozen=True)
class Share:
    """Share of some cases, counted, with Wilson's 95 % interval."""

    count: int
    """Number of cases that count."""
    total: int
    """Number of all cases."""

    @property
    def value(self) -> float | None:
        """Share 0..1; None without a case."""
        return self.count / self.total if self.total else None

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the share; 0..1 without a case."""
        return proportion_interval(self.count, self.total) if self.total else (0.0, 1.0)

    def as_json(self) -> dict[str, JSONValue]:
        """Return the counts, the share and its interval as a JSON object."""
        return {
            "count": self.count,
            "total": self.total,
            "share": self.value,
            "interval": list(self.interval),
        }

    def __str__(self) -> str:
        if not self.total:
            return "none of 0"
        low, high = self.interval
        return f"{self.count} of {self.total} ({100.0 * low:.0f} to {100.0 * high:.0f} %)"


def quartiles(values: npt.ArrayLike) -> Quartiles:
    """Return the quartiles of one or more values.

    Quartiles are interpolated between values; next to an infinite value they are infinite, too.

    Raises:
        ValueError: there are no values, or a value is not a number.
    """
    ordered = np.sort(_values(values))
    low, median, high = (_quantile(ordered, share) for share in (0.25, 0.5, 0.75))
    return Quartiles(len(ordered), float(ordered[0]), low, median, high, float(ordered[-1]))


def _quantile(ordered: FloatArray, share: float) -> float:
    """Return the quantile of sorted values below which a share of them lies, interpolated."""
    position = share * (len(ordered) - 1)
    below, above = float(ordered[math.floor(position)]), float(ordered[math.ceil(position)])
    if math.isinf(above) or below == above:
        return above
    if math.isinf(below):
        return below
    return below + (position - math.floor(position)) * (above - below)


def proportion_interval(
    successes: int, trials: int, confidence: float = 0.95
) -> tuple[float, float]:
    """Return Wilson's score interval of a share: the shares 0..1 that agree with the counts.

    Raises:
        ValueError: there are no trials, or fewer than successes.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"{successes} of {trials}: at least one trial is needed")
    return _wilson(successes / trials, trials, confidence)


def _wilson(share: float, trials: float, confidence: float) -> tuple[float, float]:
    """Return Wilson's score interval of a share, which may be a mean of shares."""
    from scipy.special import ndtri  # slow to import, but faster than scipy.stats

    z = float(ndtri(0.5 + 0.5 * confidence))
    scale = 1.0 + z * z / trials
    centre = share + z * z / (2.0 * trials)
    half = z * math.sqrt(share * (1.0 - share) / trials + z * z / (4.0 * trials * trials))
    return max(0.0, (centre - half) / scale), min(1.0, (centre + half) / scale)


def rate_interval(events: int, exposure: float, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact two-sided interval of the rate of events per unit of exposure.

    This is the interval of F. Garwood, "Fiducial limits for the Poisson distribution", Biometrika
    28 (1936). Without any event, the upper end is two-sided, too: 0 events in 1,000 drives give 0
    to 0.0037 events per drive.

    Args:
        events: number of events.
        exposure: what was exposed, such as a number of drives or a length in km.
        confidence: 0..1.

    Raises:
        ValueError: the events are below 0, or the exposure is not positive.
    """
    if events < 0 or not exposure > 0.0:
        raise ValueError(
            f"{events} events in {exposure}: 0 events or more in a positive exposure are needed"
        )
    low, high = weighted_interval([1.0] * events, 1.0, confidence)
    return low / exposure, high / exposure


def weighted_interval(
    weights: npt.ArrayLike, largest: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Return the two-sided interval of a sum of Poisson numbers, each with a weight.

    This is the gamma interval of M. P. Fay and E. J. Feuer, "Confidence intervals for directly
    standardized rates", Statistics in Medicine 16 (1997). Equal weights give Garwood's.

    Args:
        weights: (n,) weights of the events that happened; none if none did.
        largest: largest weight that an event may have.
        confidence: 0..1.
    """
    from scipy.special import gammaincinv  # slow to import, but faster than scipy.stats

    # gammaincinv(k, p) is half of the chi-squared quantile p with 2 k degrees of freedom.
    event_weights = np.asarray(weights, dtype=np.float64)
    tail = 0.5 * (1.0 - confidence)
    total, variance = float(event_weights.sum()), float((event_weights**2).sum())
    low = variance / total * float(gammaincinv(total**2 / variance, tail)) if total else 0.0
    # The upper end counts one event more, of the largest weight.
    total, variance = total + largest, variance + largest**2
    return low, variance / total * float(gammaincinv(total**2 / variance, 1.0 - tail))


def paired_share_difference(
    first: npt.ArrayLike, second: npt.ArrayLike, *, confidence: float = 0.95
) -> ValueWithInterval:
    """Return the mean second share minus the mean first share, with Newcombe's interval for pairs.

    This is the square-and-add interval with a correction for continuity: method 10 of
    R. G. Newcombe, "Improved confidence intervals for the difference between binomial proportions
    based on paired data", Statistics in Medicine 17 (1998). Fagerland, Lydersen and Laake recommend
    it in the same journal (33, 2014). The interval follows from Wilson's intervals of both means
    and from their correlation.

    Args:
        first: (n,) shares 0..1, such as 0 for a road that passed and 1 for one that failed.
        second: (n,) shares of the same roads.
        confidence: 0..1.

    Raises:
        ValueError: there are no values, a value is no share, or the numbers of values differ.
    """
    x, y = _values(first), _values(second)
    n = len(x)
    both = np.concatenate([x, y])
    if n != len(y) or both.min() < 0.0 or both.max() > 1.0:
        raise ValueError(f"{n} and {len(y)} values: pairs of shares from 0 to 1 are needed")
    p, q = float(x.mean()), float(y.mean())
    covariance = float((x * y).mean()) - p * q
    if covariance > 0.0:
        covariance = max(0.0, covariance - 0.5 / n)
    spread = float(x.std() * y.std())
    correlation = max(-1.0, min(1.0, covariance / spread)) if spread > 0.0 else 0.0
    (p_low, p_high), (q_low, q_high) = (_wilson(share, n, confidence) for share in (p, q))

    def deviation(first: float, second: float) -> float:
        """Return the deviation of a difference from the deviations of both means."""
        squares = first * first - 2.0 * correlation * first * second + second * second
        return math.sqrt(max(0.0, squares))

    difference = q - p
    return ValueWithInterval(
        difference,
        low=difference - deviation(q - q_low, p_high - p),
        high=difference + deviation(q_high - q, p - p_low),
    )


def median_estimate(values: npt.ArrayLike, confidence: float = 0.95) -> ValueWithInterval:
    """Return the median, with the interval between two of the values by the exact sign test.

    The interval assumes no distribution. For fewer than 6 values no interval between values has a
    confidence of 95 %, so the interval is infinite.

    Raises:
        ValueError: there are no values, or a value is not a number.
    """
    return quantile_estimate(values, 0.5, confidence)


def quantile_estimate(
    values: npt.ArrayLike, share: float, confidence: float = 0.95
) -> ValueWithInterval:
    """Return a quantile, with the interval between two of the values, which may be infinite.

    The interval follows from the binomial number of values below the true quantile and assumes no
    distribution. Either end misses the quantile with at most half of the remaining probability; an
    end is infinite where too few values allow that: for the quantile 0.05 and a confidence of 95 %,
    the lower end of fewer than 72 values.

    Args:
        values: (n,) independent values.
        share: share of the distribution below the quantile, 0..1, without the ends.
        confidence: 0..1.

    Raises:
        ValueError: there are no values, or a value is not a number.
    """
    from scipy.special import bdtr  # slow to import, but faster than scipy.stats

    ordered = np.sort(_values(values))
    n = len(ordered)

    def position(share: float) -> int:
        """Return the position, from 1, of the interval's lower end; 0 if it is infinite."""
        # bdtr(k, n, share) is the chance that at most k of n values lie below the quantile.
        return int((2.0 * bdtr(np.arange(n), n, share) <= 1.0 - confidence).sum())

    below, above = position(share), position(1.0 - share)
    low = float(ordered[below - 1]) if below else -math.inf
    high = float(ordered[n - above]) if above else math.inf
    return ValueWithInterval(_quantile(ordered, share), low, high)


def a12(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Return Vargha and Delaney's A12: the chance 0..1 that a value of the first group is larger.

    Ties count half, so 0.5 means no difference.

    Raises:
        ValueError: there are no values, or a value is not a number.
    """
    x, y = _values(first), _values(second)
    n = len(x)
    larger = ranks(np.concatenate([x, y]))[:n].sum() - 0.5 * n * (n + 1)
    return float(larger / (n * len(y)))


def magnitude(effect: float) -> str:
    """Return the size of an A12 in words, by the thresholds of Vargha and Delaney (2000).

    An A12 above 0.5 is small from 0.56, medium from 0.64, large from 0.71, else negligible; an A12
    below 0.5 has the size of 1 - A12.
    """
    distance = abs(effect - 0.5) + 1e-12  # 0.56 is small, whatever its rounding error
    return ("negligible", "small", "medium", "large")[bisect((0.06, 0.14, 0.21), distance)]


def mann_whitney(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Return p of the two-sided Mann-Whitney U test that both come from one distribution.

    Up to `MOST_EXACT` values p is exact, also with ties: of all ways to distribute the values to
    the groups, the share in which U differs at least as much from its mean. For more values p is
    the normal approximation with correction for ties and continuity.

    Raises:
        ValueError: there are no values, or a value is not a number.
    """
    x, y = _values(first), _values(second)
    # Ranks of ties are halves; doubled ranks are whole numbers.
    doubled = np.rint(2.0 * ranks(np.concatenate([x, y]))).astype(np.int64)
    n, total = len(x), len(doubled)
    rank_sum = int(doubled[:n].sum())
    mean = n * (total + 1)  # of the doubled rank sum
    if total > MOST_EXACT:
        from scipy.stats import mannwhitneyu  # slow to import

        if np.ptp(doubled) == 0:
            return 1.0
        return float(mannwhitneyu(x, y, alternative="two-sided", method="asymptotic").pvalue)
    shares = _rank_sums(doubled, n)
    sums = np.arange(len(shares))
    return min(1.0, float(shares[np.abs(sums - mean) >= abs(rank_sum - mean)].sum()))


def _rank_sums(ranks: npt.NDArray[np.int64], n: int) -> FloatArray:
    """Return, of all choices of n ranks, the share that has each sum, (largest sum + 1,)."""
    # ways[k, s] is the number of choices of k of the first i ranks with the sum s. Each further
    # rank is taken or not.
    ways = np.zeros((n + 1, int(ranks.sum()) + 1))
    ways[0, 0] = 1.0
    for i, rank in enumerate(ranks):
        for k in range(min(i + 1, n), 0, -1):
            ways[k, rank:] += ways[k - 1, : ways.shape[1] - rank]
    shares: FloatArray = ways[n] / ways[n].sum()
    return shares


def spearman(first: npt.ArrayLike, second: npt.ArrayLike) -> tuple[float, float]:
    """Return Spearman's rank correlation -1..1 of two columns, and its two-sided p.

    p is exact up to `MOST_PERMUTED` rows: the share of all orders of the second column whose
    correlation with the first is at least as strong. For more rows p follows from Student's t with
    n - 2 degrees of freedom.

    Raises:
        ValueError: there are fewer than 3 rows, the columns differ in length, a column is constant,
            or a value is not a number.
    """
    from scipy.stats import spearmanr  # slow to import

    x, y = ranks(_values(first)), ranks(_values(second))
    n = len(x)
    if n != len(y) or n < 3 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        raise ValueError(f"{n} and {len(y)} values: three or more pairs that vary are needed")
    result = spearmanr(x, y)
    if n > MOST_PERMUTED:
        return float(result.statistic), float(result.pvalue)
    orders = np.array(list(permutations(y - y.mean())))
    products = np.abs(orders @ (x - x.mean()))
    return float(result.statistic), float((products >= products[0] - _ROUNDING).mean())


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p values of several tests, corrected by Holm, in the same order."""
    order = sorted(range(len(p_values)), key=lambda i: p_values[i])
    corrected = [0.0] * len(p_values)
    largest = 0.0
    for position, i in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - position) * p_values[i]))
        corrected[i] = largest
    return corrected


def _values(values: npt.ArrayLike) -> FloatArray:
    """Return values as an array, (n,).

    Raises:
        ValueError: there are no values, they have several dimensions, or a value is not a number.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or len(array) == 0 or np.isnan(array).any():
        raise ValueError(f"values of shape {array.shape}: one or more numbers in a row are needed")
    return array


def ranks(values: FloatArray) -> FloatArray:
    """Return ranks from 1, (n,); equal values share their mean rank."""
    _, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    last_rank = np.cumsum(counts)
    ranks: FloatArray = (last_rank - 0.5 * (counts - 1))[index.ravel()]
    return ranks
