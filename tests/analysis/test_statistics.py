"""Statistics, compared with scipy, brute force and published cases."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from frenetic.analysis.statistics import (
    MOST_EXACT,
    a12,
    holm,
    magnitude,
    mann_whitney,
    median_estimate,
    paired_share_difference,
    proportion_interval,
    quantile_estimate,
    quartiles,
    rate_interval,
    spearman,
    weighted_interval,
)

few = st.lists(st.integers(0, 6).map(float), min_size=1, max_size=6)


def test_quartiles_next_to_infinity_are_infinite_and_never_nan() -> None:
    q = quartiles([10.0, math.inf, 20.0, math.inf])
    assert (q.least, q.low, q.median, q.high) == (10.0, 17.5, math.inf, math.inf)
    q = quartiles([10.0, -math.inf, 20.0, -math.inf])
    assert (q.least, q.low, q.median, q.high) == (-math.inf, -math.inf, -math.inf, 12.5)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30))
def test_quartiles_agree_with_numpy(values: list[float]) -> None:
    q = quartiles(values)
    expected = np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])
    assert np.allclose([q.least, q.low, q.median, q.high, q.most], expected)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: quartiles([]), "numbers in a row"),
        (lambda: quartiles([1.0, math.nan]), "numbers in a row"),
        (lambda: quartiles([[1.0], [2.0]]), "numbers in a row"),
        (lambda: proportion_interval(0, 0), "at least one trial"),
        (lambda: paired_share_difference([0.5, 1.0], [0.5]), "pairs of shares"),
        (lambda: paired_share_difference([0.5, 1.0], [0.5, 1.5]), "pairs of shares"),
        (lambda: paired_share_difference([0.5, 1.0], [0.5, -0.1]), "pairs of shares"),
        (lambda: spearman([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]), "that vary"),
    ],
)
def test_invalid_samples_are_refused(call: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()


@given(st.integers(1, 60).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_agrees_with_scipy(case: tuple[int, int]) -> None:
    successes, trials = case
    expected = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert proportion_interval(successes, trials) == pytest.approx(
        (expected.low, expected.high), abs=1e-12
    )


# paired_share_difference


def table(both: int, first: int, second: int, neither: int) -> tuple[list[int], list[int]]:
    """Return pairs of 0 and 1, this many of each kind."""
    x = [1] * (both + first) + [0] * (second + neither)
    y = [1] * both + [0] * first + [1] * second + [0] * neither
    return x, y


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        # R package contingencytables of Fagerland, Lydersen and Laake, with the sides exchanged.
        ((59, 6, 16, 80), (0.0621, 0.0046, 0.1186)),
        # The same authors in Statistics in Medicine 33 (2014), with data of Bentur et al. (2009).
        ((1, 1, 7, 12), (0.286, 0.026, 0.507)),
        # Altman et al., "Statistics with confidence" (2000), table 6.2.
        ((14, 5, 0, 22), (-0.122, -0.226, -0.011)),
    ],
)
def test_paired_difference_of_published_cases(
    counts: tuple[int, int, int, int], expected: tuple[float, float, float]
) -> None:
    difference = paired_share_difference(*table(*counts))
    assert (difference.value, difference.low, difference.high) == pytest.approx(expected, abs=6e-4)


# median_estimate


@pytest.mark.parametrize("n", [6, 17, 40, 201])
def test_the_interval_of_a_median_follows_from_the_sign_test(n: int) -> None:
    values = np.arange(1.0, n + 1.0)
    median = median_estimate(values)
    inside = [m for m in values if stats.binomtest(int((values < m - 0.5).sum()), n).pvalue > 0.05]
    outside = stats.binomtest(int((values < median.low - 0.5).sum()), n).pvalue
    assert outside <= 0.05
    assert min(inside) == median.low + 1.0
    assert median.high == n + 1.0 - median.low


# quantile_estimate


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 0.9])
@pytest.mark.parametrize("n", [5, 59, 71, 72, 80, 300])
def test_the_interval_of_a_quantile_misses_on_either_side_in_at_most_one_of_40(
    n: int, share: float
) -> None:
    """The value at position i lies above the quantile if fewer than i values lie below it."""
    quantile = quantile_estimate(np.arange(1.0, n + 1.0), share)
    below = stats.binom(n, share)
    if math.isfinite(quantile.low):
        assert below.cdf(quantile.low - 1.0) <= 0.025 < below.cdf(quantile.low)
    else:
        assert below.cdf(0) > 0.025
    if math.isfinite(quantile.high):
        assert below.sf(quantile.high - 1.0) <= 0.025 < below.sf(quantile.high - 2.0)
    else:
        assert below.sf(n - 1.0) > 0.025
    assert quantile.value == pytest.approx(np.quantile(np.arange(1.0, n + 1.0), share))


def test_a_quantile_among_infinite_values_is_infinite() -> None:
    quantile = quantile_estimate([0.0, 1.0, *[math.inf] * 98], 0.05)
    assert (quantile.value, quantile.low, quantile.high) == (math.inf, 0.0, math.inf)


# a12


def test_a12_counts_infinite_values_as_larger_and_equal_to_each_other() -> None:
    assert a12([math.inf, math.inf], [math.inf, 3.0]) == pytest.approx(0.75)


@given(few, few)
def test_a12_is_the_mann_whitney_statistic_per_pair(x: list[float], y: list[float]) -> None:
    u = stats.mannwhitneyu(x, y, method="asymptotic").statistic if len({*x, *y}) > 1 else None
    if u is not None:
        assert a12(x, y) == pytest.approx(u / (len(x) * len(y)))
    assert a12(x, y) + a12(y, x) == pytest.approx(1.0)


def test_magnitudes_begin_at_the_thresholds_in_both_directions() -> None:
    names = ["negligible", "negligible", "small", "medium", "large", "large"]
    for effect, name in zip((0.5, 0.559, 0.56, 0.64, 0.71, 1.0), names, strict=True):
        assert magnitude(effect) == magnitude(1.0 - effect) == name


# mann_whitney


def exact_p_value(x: list[float], y: list[float]) -> float:
    """Return the exact p-value, from all ways to divide the values."""
    ranks = stats.rankdata(x + y)
    n, total = len(x), len(ranks)
    mean = n * (total + 1) / 2.0
    difference = abs(ranks[:n].sum() - mean)
    sums = [abs(sum(ranks[list(deal)]) - mean) for deal in combinations(range(total), n)]
    return float(np.mean([s >= difference - 1e-9 for s in sums]))


@given(few, few)
def test_mann_whitney_is_exact_with_ties(x: list[float], y: list[float]) -> None:
    assert mann_whitney(x, y) == pytest.approx(exact_p_value(x, y), abs=1e-9)


def test_the_approximation_for_many_values_is_close_to_the_exact_p_value() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.normal(0.0, 1.0, 40), rng.normal(0.2, 1.0, 41)
    assert len(x) + len(y) > MOST_EXACT
    exact = stats.mannwhitneyu(x, y, method="exact").pvalue
    assert exact > 0.01
    assert mann_whitney(x, y) == pytest.approx(exact, rel=0.1)
    p = mann_whitney(x[:39], y)
    assert p == pytest.approx(stats.mannwhitneyu(x[:39], y, method="exact").pvalue, abs=1e-9)


@pytest.mark.parametrize("n", [4, 50])
def test_mann_whitney_of_equal_values_is_one(n: int) -> None:
    assert mann_whitney([3.0] * n, [3.0] * n) == 1.0


@given(st.integers(3, 5), st.integers(0, 999))
def test_spearman_of_few_pairs_is_exact(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 4, n).astype(float), rng.integers(0, 4, n).astype(float)
    if np.ptp(x) > 0.0 and np.ptp(y) > 0.0:
        rho, p = spearman(x, y)
        every = [abs(stats.spearmanr(x, order).statistic) for order in permutations(y)]
        assert p == pytest.approx(
            np.mean([correlation >= abs(rho) - 1e-9 for correlation in every])
        )
        assert rho == pytest.approx(stats.spearmanr(x, y).statistic)


@given(st.integers(9, 30), st.integers(0, 999))
def test_spearman_agrees_with_scipy(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 9, n).astype(float), rng.normal(size=n)
    if np.ptp(x) > 0.0:
        expected = stats.spearmanr(x, y)
        assert spearman(x, y) == pytest.approx((expected.statistic, expected.pvalue), abs=1e-9)


# holm


def test_holm_by_hand() -> None:
    # 3 * 0.01, then 2 * 0.03; 0.04 is less than 0.06 and is raised to 0.06.
    assert holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


@pytest.mark.parametrize("events", [0, 1, 7, 40, 1000])
@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_interval_of_a_rate_is_garwoods_and_two_sided_also_without_events(
    events: int, confidence: float
) -> None:
    low, high = rate_interval(events, 2.0, confidence)
    tail = 0.5 * (1.0 - confidence)
    expected = stats.chi2.ppf(tail, 2 * events) / 4.0 if events else 0.0
    assert low == pytest.approx(expected)
    assert high == pytest.approx(stats.chi2.ppf(1.0 - tail, 2 * events + 2) / 4.0)
    assert stats.poisson.cdf(events, 2.0 * high) == pytest.approx(tail)


def test_interval_of_no_event_in_1000_drives_is_as_published() -> None:
    low, high = rate_interval(0, 1000.0)
    assert low == 0.0
    assert high == pytest.approx(3.689e-3, rel=1e-4)


def test_weighted_interval_is_fay_and_feuers() -> None:
    weights, largest = np.array([0.5, 0.5, 2.0]), 3.0
    low, high = weighted_interval(weights, largest)
    total, variance = 3.0, 4.5
    assert low == pytest.approx(
        variance / total / 2 * stats.chi2.ppf(0.025, 2 * total**2 / variance)
    )
    total, variance = total + largest, variance + largest**2
    assert high == pytest.approx(
        variance / total / 2 * stats.chi2.ppf(0.975, 2 * total**2 / variance)
    )


@pytest.mark.parametrize(("events", "exposure"), [(-1, 1.0), (1, 0.0), (0, -2.0), (0, math.nan)])
def test_interval_of_a_rate_needs_an_exposure(events: int, exposure: float) -> None:
    with pytest.raises(ValueError, match="a positive exposure"):
        rate_interval(events, exposure)
