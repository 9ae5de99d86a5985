"""Known failures: what their order finds is what a look at each of them finds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.search.approach import SIZE, is_near, nearest_square
from frenetic.search.known_failures import (
    NOTHING,
    Known,
    KnownFailures,
    near_failure,
    nearest_known_square,
    outline_of,
)


def known_failures(vectors: FloatArray, expected: int = 0) -> Known:
    """Return known failures, of which the last ones are only expected."""
    failures = KnownFailures()
    count = len(vectors) - expected
    for vector in vectors[:count]:
        failures.add(vector)
    assert len(failures) == count
    return failures.known(list(vectors[count:]))


@given(
    seed=st.integers(0, 10_000),
    count=st.integers(0, 150),
    expected=st.integers(0, 5),
    scale=st.sampled_from([0.0, 0.05, 0.4, 3.0]),
    square=st.sampled_from([1e-12, 0.5, 2.56, 16.0]),
)
def test_no_failure_is_missed_or_added(
    seed: int, count: int, expected: int, scale: float, square: float
) -> None:
    rng = np.random.default_rng(seed)
    families = 10.0 + rng.normal(0.0, 1.0, (4, SIZE))
    vectors = families[rng.integers(0, 4, count)] + rng.normal(0.0, scale, (count, SIZE))
    known = known_failures(vectors, min(expected, count))
    assert (np.diff(known.outlines[:, 0]) >= 0.0).all()
    for vector in (families[0], *vectors[:3]):
        squares = ((vectors - vector) ** 2).sum(axis=1)
        if np.abs(squares - square).min(initial=np.inf) > 1e-9:  # else rounding decides
            assert (near_failure(known, vector, square) >= 0) == bool((squares < square).any())
        row = near_failure(known, vector, square)
        assert (row >= 0) == is_near(vectors, vector, square)
        assert row < 0 or is_near(vectors[row : row + 1], vector, square)
        assert nearest_known_square(known, vector, 16.0) == nearest_square(vectors, vector, 16.0)


@given(seed=st.integers(0, 10_000))
def test_outlines_differ_by_no_more_than_approaches(seed: int) -> None:
    first, second = np.random.default_rng(seed).normal(0.0, 1.0, (2, SIZE))
    outlines = np.subtract(outline_of(first), outline_of(second))
    assert (outlines**2).sum() <= ((first - second) ** 2).sum() * (1.0 + 1e-12)


@pytest.mark.parametrize("expected", [0, 1])
def test_a_failure_exactly_at_the_bound_is_not_near(expected: int) -> None:
    vector = np.zeros(SIZE)
    faster = vector.copy()
    faster[-1] = 1.5
    known = known_failures(faster[np.newaxis], expected)
    assert near_failure(known, vector, 2.25) == -1
    assert near_failure(known, vector, float(np.nextafter(2.25, 3.0))) == 0
    assert nearest_known_square(known, vector, 4.0) == 2.25
    assert nearest_known_square(NOTHING, vector, 4.0) == 4.0


def test_more_failures_than_there_was_room_for_are_kept() -> None:
    vectors = np.random.default_rng(1).normal(0.0, 1.0, (300, SIZE))
    known = known_failures(vectors, 100)
    np.testing.assert_array_equal(known.vectors, vectors)
    assert sorted(known.order.tolist()) == list(range(200))
