"""Statistics of paired differences, against scipy and all pairs of differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import wilcoxon

from frenetic._support.arrays import FloatArray
from frenetic.analysis.paired import paired_shift, signed_rank_p


def scipys_p(differences: FloatArray, **options: Any) -> float:
    """Return scipy's p of the signed-rank test."""
    return float(wilcoxon(differences, **options).pvalue)


@pytest.mark.parametrize("n", [5, 12, 40, 80, 81, 300])
def test_p_is_scipys(n: int) -> None:
    differences = np.random.default_rng(n).normal(0.3, 1.0, n)
    method = "exact" if n <= 80 else "asymptotic"
    expected = scipys_p(differences, method=method, correction=False)
    assert signed_rank_p(differences) == pytest.approx(expected, rel=1e-6)


def test_p_with_ties_and_zeros_is_pratts() -> None:
    differences = np.round(np.random.default_rng(0).normal(0.2, 1.0, 200))
    expected = scipys_p(differences, zero_method="pratt", method="asymptotic")
    assert signed_rank_p(differences) == pytest.approx(expected, rel=1e-6)


def test_p_of_signs_alone_is_the_sign_tests() -> None:
    differences = [0.0] * 20 + [1.0] * 9 + [-1.0]
    assert signed_rank_p(differences) == pytest.approx(2.0 * (1 + 10) / 2**10)
    assert signed_rank_p([0.0] * 30) == 1.0


@pytest.mark.parametrize("n", [1, 2, 3, 6, 7, 31, 90])
def test_the_shift_is_the_median_of_all_means_of_two(n: int) -> None:
    differences = np.random.default_rng(n).normal(0.3, 1.0, n)
    means = np.sort([np.mean([a, b]) for i, a in enumerate(differences) for b in differences[i:]])
    shift = paired_shift(differences)
    assert shift.value == pytest.approx(float(np.median(means)), abs=1e-12)
    if n < 6:
        assert (shift.low, shift.high) == (-math.inf, math.inf)
    else:
        below = int(np.searchsorted(means, shift.low - 1e-12))
        above = len(means) - int(np.searchsorted(means, shift.high + 1e-12, side="right"))
        assert below == above, "the interval leaves out as many means on either side"


@pytest.mark.parametrize("n", [8, 50, 120])
def test_the_interval_holds_the_shifts_that_the_test_does_not_refuse(n: int) -> None:
    differences = np.random.default_rng(n).normal(0.3, 1.0, n)
    shift = paired_shift(differences)
    width = shift.high - shift.low
    for inside, end in ((1.0, shift.low), (-1.0, shift.high)):
        assert signed_rank_p(differences - end - inside * 0.02 * width) > 0.04
        assert signed_rank_p(differences - end + inside * 0.02 * width) < 0.06


def test_equal_differences_have_an_exact_shift() -> None:
    shift = paired_shift([0.0] * 10 + [1.0])
    assert (shift.value, shift.low) == (0.0, 0.0)
    same = paired_shift([0.25] * 40)
    assert (same.value, same.low, same.high) == (0.25, 0.25, 0.25)


def test_odd_roads_move_the_shift_little() -> None:
    differences = np.random.default_rng(5).normal(0.1, 0.02, 100)
    odd = np.concatenate([differences[:95], np.full(5, 50.0)])
    assert paired_shift(odd).value == pytest.approx(0.1, abs=0.01)
