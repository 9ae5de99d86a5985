"""The operators of Listing 1, each by what it does to any road."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from frenetic._support.arrays import FloatArray
from frenetic.search.operators import (
    FAIL_OPERATORS,
    LISTING_1,
    PASS_OPERATORS,
    MutationOptions,
    append,
    mix,
    next_curvature,
    random_curvatures,
    remove_end,
    remove_front,
    remove_random,
    replace_random,
    scale,
    splice,
)

BOUND, MAX_CHANGE = 0.07, 0.05

seeds = st.integers(0, 2**32 - 1)
curvatures_1_m = st.floats(-0.15, 0.15, allow_nan=False, allow_subnormal=False)


def roads(min_size: int = 2, *, unique: bool = False) -> st.SearchStrategy[FloatArray]:
    return arrays(np.float64, st.integers(min_size, 40), elements=curvatures_1_m, unique=unique)


def rng_of(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_operators_and_their_strength_are_those_of_the_paper() -> None:
    assert list(PASS_OPERATORS.items()) == [
        ("P1", append),
        ("P2", remove_random),
        ("P3", remove_front),
        ("P4", remove_end),
        ("P5", replace_random),
        ("P6", scale),
    ]
    assert list(FAIL_OPERATORS) == ["F1", "F2", "F3", "F4"]
    assert MutationOptions(BOUND, MAX_CHANGE, 1, 5, 1.1, 1.2) == LISTING_1


@given(seeds, roads())
def test_nothing_is_modified_or_shared(seed: int, road: FloatArray) -> None:
    before = road.copy()
    road.setflags(write=False)

    results = [mutate(rng_of(seed), road, LISTING_1) for mutate in PASS_OPERATORS.values()]
    results += [vary(road) for vary in FAIL_OPERATORS.values()]
    results += [mix(rng_of(seed), road, road[1:]), *splice(road, road[1:])]

    np.testing.assert_array_equal(road, before)
    for result in results:
        if result is not None:
            assert result.dtype == np.float64
            assert result.flags.writeable
            assert not np.shares_memory(result, road)


# New values


@pytest.mark.parametrize(
    ("previous", "low", "high"),
    [
        (0.0, -0.05, 0.05),
        (0.04, -0.01, 0.07),
        (-0.04, -0.07, 0.01),
        (0.1, 0.05, 0.07),
        (0.13, 0.07, 0.07),  # nothing is within both: the nearest end of the bound
        (-0.13, -0.07, -0.07),
    ],
)
def test_next_curvature_spans_the_intersection(previous: float, low: float, high: float) -> None:
    for u in (0.0, 0.25, 1.0):
        value = next_curvature(previous, u, bound=BOUND, max_change=MAX_CHANGE)
        assert value == pytest.approx(low + u * (high - low), abs=1e-15)


@given(seeds, st.integers(1, 60), st.floats(0.001, 0.2), st.floats(0.001, 0.2))
def test_a_random_road_follows_next_curvature_from_0(
    seed: int, n: int, bound: float, max_change: float
) -> None:
    values = random_curvatures(rng_of(seed), n, bound=bound, max_change=max_change)

    previous, expected = 0.0, []
    for u in rng_of(seed).random(n).tolist():
        previous = next_curvature(previous, u, bound=bound, max_change=max_change)
        expected.append(previous)
    assert values.tolist() == expected
    assert np.all(np.abs(values) <= bound)


def follows(value: float, previous: float) -> bool:
    """Whether a new value keeps to the bound and, where it can, to the change."""
    if abs(previous) > BOUND + MAX_CHANGE:
        return value == math.copysign(BOUND, previous)
    return abs(value) <= BOUND and abs(value - previous) <= MAX_CHANGE + 1e-15


# Mutations of roads that passed


@given(seeds, roads())
def test_append_continues_from_the_last_value(seed: int, road: FloatArray) -> None:
    mutant = append(rng_of(seed), road)

    np.testing.assert_array_equal(mutant[: len(road)], road)
    assert all(follows(mutant[i], mutant[i - 1]) for i in range(len(road), len(mutant)))


@given(seeds, roads(min_size=7, unique=True))
def test_removing_leaves_the_rest_in_order(seed: int, road: FloatArray) -> None:
    anywhere, back, front = (
        PASS_OPERATORS[name](rng_of(seed), road, LISTING_1) for name in ("P2", "P3", "P4")
    )

    assert anywhere is not None
    assert back is not None
    assert front is not None
    np.testing.assert_array_equal(anywhere, road[np.isin(road, anywhere)])
    np.testing.assert_array_equal(back, road[-len(back) :])
    np.testing.assert_array_equal(front, road[: len(front)])


@pytest.mark.parametrize("name", ["P2", "P3", "P4"])
def test_removing_leaves_two_values(name: str) -> None:
    five = MutationOptions(min_changed=5, max_changed=5)
    for n in (3, 4, 5, 6, 7):
        mutant = PASS_OPERATORS[name](rng_of(n), np.arange(float(n)), five)
        assert mutant is not None
        assert len(mutant) == 2
    assert PASS_OPERATORS[name](rng_of(1), np.zeros(2), LISTING_1) is None


@given(seeds, roads())
def test_replace_random_draws_relative_to_the_value_before(seed: int, road: FloatArray) -> None:
    mutant = replace_random(rng_of(seed), road)

    assert len(mutant) == len(road)
    for i in np.flatnonzero(mutant != road):
        assert follows(mutant[i], mutant[i - 1] if i > 0 else 0.0)


@pytest.mark.parametrize("name", ["P1", "P2", "P3", "P4", "P5"])
def test_as_many_values_are_changed_as_the_options_say(name: str) -> None:
    options = MutationOptions(min_changed=2, max_changed=4)
    rng, road = rng_of(1), np.linspace(0.2, 0.4, 20)  # no new value equals an old one

    counts, places = set(), set()
    for _ in range(200):
        mutant = PASS_OPERATORS[name](rng, road, options)
        assert mutant is not None
        gone = np.flatnonzero(~np.isin(road, mutant))
        counts.add(len(mutant) - len(road) if name == "P1" else len(gone))
        places.update(gone.tolist())

    assert counts == {2, 3, 4}
    if name in ("P2", "P5"):
        assert places == set(range(20))


def test_replace_random_replaces_at_most_all() -> None:
    five = MutationOptions(min_changed=5, max_changed=5)
    assert np.all(replace_random(rng_of(1), np.full(2, 0.2), five) != 0.2)


def test_scale_multiplies_all_values_by_one_factor_of_its_range() -> None:
    rng, road = rng_of(1), np.array([0.01, 0.0, -0.03])
    mutants = np.array([scale(rng, road) for _ in range(2000)])

    factors = mutants[:, 0] / road[0]
    np.testing.assert_allclose(mutants, np.outer(factors, road), rtol=1e-12)
    np.testing.assert_allclose(np.quantile(factors, [0.0, 0.5, 1.0]), [1.1, 1.15, 1.2], atol=0.005)


# Mutations of roads that failed


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("F1", [-5.0, -4.0, -3.0, -2.0, -1.0]),
        ("F2", [5.0, 4.0, 3.0, 2.0, 1.0]),
        ("F3", [3.0, 4.0, 5.0, 1.0, 2.0]),
        ("F4", [-1.0, -2.0, -3.0, -4.0, -5.0]),
    ],
)
def test_mutations_of_a_failed_road_by_example(name: str, values: list[float]) -> None:
    assert FAIL_OPERATORS[name](np.arange(1.0, 6.0)).tolist() == values


# Crossover


@given(seeds, roads(unique=True), roads(unique=True))
def test_mix_takes_each_value_from_either_parent(
    seed: int, first: FloatArray, second: FloatArray
) -> None:
    child = mix(rng_of(seed), first, second)

    n = min(len(first), len(second))
    assert child.shape == (n,)
    assert np.all((child == first[:n]) | (child == second[:n]))


@given(roads(), roads())
def test_splice_joins_a_front_half_and_a_back_half(first: FloatArray, second: FloatArray) -> None:
    one, other = splice(first, second)

    n, m = len(first) // 2, len(second) // 2
    assert one.tolist() == [*first[:n], *second[m:]]
    assert other.tolist() == [*second[:m], *first[n:]]


def test_mix_takes_half_from_each_parent_independently() -> None:
    child = mix(rng_of(1), np.zeros(10_000), np.ones(12_000))

    assert child.mean() == pytest.approx(0.5, abs=0.02)
    assert np.mean(child[1:] == child[:-1]) == pytest.approx(0.5, abs=0.02)
