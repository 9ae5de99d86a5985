"""The random expectation: what a search would have found if all its roads were random."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.analysis.expectation import RandomRoads
from frenetic.analysis.statistics import proportion_interval

# Numbers of roads that found each distinct failure, and roads that found none.
random_roads = st.builds(
    lambda found, others: RandomRoads(sum(found) + others, sum(found), tuple(found)),
    st.lists(st.integers(1, 6), min_size=1, max_size=8),
    st.integers(1, 40),
)


@given(found=st.lists(st.integers(1, 4), min_size=1, max_size=3), others=st.integers(0, 3))
def test_fewer_roads_find_the_mean_over_all_selections(found: list[int], others: int) -> None:
    owners: list[int | None] = [i for i, number in enumerate(found) for _ in range(number)]
    owners += [None] * others
    random = RandomRoads(len(owners), sum(found), tuple(found))
    numbers = range(len(owners) + 1)
    means = [
        np.mean(
            [len({owners[i] for i in chosen} - {None}) for chosen in combinations(numbers[:-1], n)]
        )
        for n in numbers
    ]
    assert random.distinct_after(list(numbers)).value == pytest.approx(means)


def test_more_roads_are_extrapolated_as_chao_does() -> None:
    # Of 10 roads, three found a failure of their own and two one that both found.
    random = RandomRoads(10, 5, (1, 1, 1, 2))
    unseen = 9 / 10 * 3 * 3 / (2 * 1)
    expected = [4 + unseen * (1 - (1 - 3 / (10 * unseen + 3)) ** more) for more in (0, 5, 90)]
    assert random.distinct_after([10, 15, 100]).value == pytest.approx(expected)
    # Without any that was found twice.
    alone = RandomRoads(10, 3, (1, 1, 1))
    unseen = 9 / 10 * 3 * 2 / 2
    assert alone.distinct_after([1e6]).value == pytest.approx([3 + unseen])
    known = RandomRoads(10, 5, (3, 2))
    assert known.distinct_after([10, 100]).value == pytest.approx([2, 2])


def test_the_interval_is_the_same_each_time_and_holds_what_more_roads_find() -> None:
    # Twenty problems, of which five are ten times as frequent as the others.
    rng = np.random.default_rng(3)
    chances = np.array([0.02] * 5 + [0.002] * 15)
    held = 0
    for _ in range(50):
        found = rng.binomial(200, chances)
        random = RandomRoads(200, int(found.sum()), tuple(int(n) for n in found if n))
        distinct = random.distinct_after([400])
        assert distinct.low == random.distinct_after([400]).low
        held += distinct.low[0] <= (1.0 - (1.0 - chances) ** 400).sum() <= distinct.high[0]
    assert held >= 40  # unseen ones are estimated from below


def test_no_failure_leaves_as_many_open_as_failures() -> None:
    random = RandomRoads(50, 0, ())
    distinct = random.distinct_after([50, 100])
    assert distinct.value.tolist() == distinct.low.tolist() == [0.0, 0.0]
    assert distinct.high == pytest.approx(proportion_interval(0, 50)[1] * np.array([50, 100]))
