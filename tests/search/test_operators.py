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
    flip,
    mix,
    next_curvature,
    random_curvatures,
    remove_end,
    remove_front,
    remove_random,
    replace_random,
    reverse_road,
    reverse_values,
    scale,
    splice,
    swap_halves,
)

BOUND, MAX_CHANGE = 0.07, 0.05


seeds = st.integers(0, 2**32 - 1)
curvatures_1_m = st.floats(-0.15, 0.15, allow_nan=False, allow_subnormal=False)


def roads(min_size: int = 2, max_size: int = 40) -> st.SearchStrategy[FloatArray]:
    return arrays(np.float64, st.integers(min_size, max_size), elements=curvatures_1_m)


def distinct_roads(min_size: int = 2, max_size: int = 40) -> st.SearchStrategy[FloatArray]:
    return arrays(np.float64, st.integers(min_size, max_size), elements=curvatures_1_m, unique=True)


def rng_of(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def is_subsequence(short: FloatArray, long: FloatArray) -> bool:
    remaining = iter(long.tolist())
    return all(value in remaining for value in short.tolist())


# Random roads


@given(seeds, st.integers(1, 60), st.floats(0.001, 0.2), st.floats(0.001, 0.2))
def test_random_values_stay_within_the_bound_and_the_change(
    seed: int, n: int, bound: float, max_change: float
) -> None:
    values = random_curvatures(rng_of(seed), n, bound=bound, max_change=max_change)

    assert values.shape == (n,)
    assert np.all(np.abs(values) <= bound)
    changes = np.diff(values, prepend=0.0)  # the first value is drawn relative to 0
    assert np.all(np.abs(changes) <= max_change * (1 + 1e-12))


def test_random_values_are_uniform_in_the_intersection() -> None:
    rng = rng_of(1)
    draws = np.array([random_curvatures(rng, 2) for _ in range(20_000)])

    first, second = draws.T
    np.testing.assert_allclose(  # the first: U(-0.05, 0.05)
        np.quantile(first, [0.0, 0.25, 0.5, 0.75, 1.0]),
        [-0.05, -0.025, 0.0, 0.025, 0.05],
        atol=0.001,
    )
    after_sharp = second[first > 0.049]  # about U(0, 0.07)
    np.testing.assert_allclose(
        np.quantile(after_sharp, [0.0, 0.25, 0.5, 0.75, 1.0]),
        [0.0, 0.0175, 0.035, 0.0525, 0.07],
        atol=0.007,
    )


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
    def at(u: float) -> float:
        return next_curvature(previous, u, bound=BOUND, max_change=MAX_CHANGE)

    assert at(0.0) == pytest.approx(low, abs=1e-15)
    assert at(1.0) == pytest.approx(high, abs=1e-15)
    assert at(0.25) == pytest.approx(low + (high - low) / 4, abs=1e-15)


# Mutations of roads that passed


@given(seeds, roads(max_size=12))
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


@given(seeds, roads())
def test_a_mutation_is_a_function_of_the_generator_and_the_road(
    seed: int, road: FloatArray
) -> None:
    for mutate in PASS_OPERATORS.values():
        first, second = (mutate(rng_of(seed), road, LISTING_1) for _ in range(2))
        if first is None:
            assert second is None
        else:
            np.testing.assert_array_equal(first, second)


@given(seeds, roads())
def test_append_continues_from_the_last_value(seed: int, road: FloatArray) -> None:
    mutant = append(rng_of(seed), road)

    added = mutant[len(road) :]
    assert 1 <= len(added) <= 5
    np.testing.assert_array_equal(mutant[: len(road)], road)
    assert np.all(np.abs(added) <= BOUND)
    changes = np.abs(np.diff(mutant[len(road) - 1 :]))
    if abs(road[-1]) <= BOUND + MAX_CHANGE:
        assert np.all(changes <= MAX_CHANGE + 1e-15)
    else:
        assert added[0] == math.copysign(BOUND, road[-1])


@given(seeds, distinct_roads(min_size=7))
def test_remove_random_keeps_the_order_of_the_rest(seed: int, road: FloatArray) -> None:
    mutant = remove_random(rng_of(seed), road)

    assert mutant is not None
    assert 1 <= len(road) - len(mutant) <= 5
    assert is_subsequence(mutant, road)


def test_remove_random_removes_anywhere() -> None:
    rng, road = rng_of(1), np.arange(20.0)

    removed = set()
    for _ in range(300):
        mutant = remove_random(rng, road)
        assert mutant is not None
        removed |= set(road.tolist()) - set(mutant.tolist())

    assert removed == set(road.tolist())


@given(seeds, roads(min_size=7))
def test_remove_front_and_end_leave_the_other_end(seed: int, road: FloatArray) -> None:
    back, front = remove_front(rng_of(seed), road), remove_end(rng_of(seed), road)

    assert back is not None
    assert front is not None
    assert 1 <= len(road) - len(back) <= 5
    assert 1 <= len(road) - len(front) <= 5
    np.testing.assert_array_equal(back, road[-len(back) :])
    np.testing.assert_array_equal(front, road[: len(front)])


@pytest.mark.parametrize("name", ["P2", "P3", "P4"])
@given(seed=seeds, n=st.integers(3, 6))
def test_removing_leaves_two_values(name: str, seed: int, n: int) -> None:
    five = MutationOptions(min_changed=5, max_changed=5)

    mutant = PASS_OPERATORS[name](rng_of(seed), np.arange(float(n)), five)

    assert mutant is not None
    assert len(mutant) == 2


@pytest.mark.parametrize("name", ["P2", "P3", "P4"])
def test_removing_does_not_apply_to_two_values(name: str) -> None:
    assert PASS_OPERATORS[name](rng_of(1), np.zeros(2), LISTING_1) is None


@given(seeds, roads())
def test_replace_random_draws_relative_to_the_value_before(seed: int, road: FloatArray) -> None:
    mutant = replace_random(rng_of(seed), road)

    assert len(mutant) == len(road)
    replaced = np.flatnonzero(mutant != road)
    assert len(replaced) <= 5
    for i in replaced:
        previous = mutant[i - 1] if i > 0 else 0.0
        assert abs(mutant[i]) <= BOUND
        if abs(previous) <= BOUND + MAX_CHANGE:
            assert abs(mutant[i] - previous) <= MAX_CHANGE + 1e-15


def test_replace_random_replaces_one_to_five_values_anywhere() -> None:
    rng, road = rng_of(1), np.full(20, 0.2)  # no new value equals an old one

    replaced = [np.flatnonzero(replace_random(rng, road) != road) for _ in range(300)]

    assert {len(positions) for positions in replaced} == {1, 2, 3, 4, 5}
    assert set(np.concatenate(replaced).tolist()) == set(range(20))


def test_replace_random_replaces_at_most_all() -> None:
    five = MutationOptions(min_changed=5, max_changed=5)

    mutant = replace_random(rng_of(1), np.full(2, 0.2), five)

    assert np.all(mutant != 0.2)


@given(seeds, roads())
def test_scale_multiplies_all_values_by_one_factor(seed: int, road: FloatArray) -> None:
    mutant = scale(rng_of(seed), road)

    longest = int(np.argmax(np.abs(road)))
    if road[longest] != 0:
        factor = mutant[longest] / road[longest]
        assert 1.1 - 1e-12 <= factor <= 1.2 + 1e-12
        np.testing.assert_allclose(mutant, factor * road, rtol=1e-12, atol=0)


def test_scale_draws_its_factor_from_the_whole_range() -> None:
    rng = rng_of(1)
    factors = [scale(rng, np.ones(2))[0] for _ in range(2000)]

    np.testing.assert_allclose(np.quantile(factors, [0.0, 0.5, 1.0]), [1.1, 1.15, 1.2], atol=0.005)


@pytest.mark.parametrize("name", ["P1", "P2", "P3", "P4", "P5"])
def test_the_numbers_of_changed_values_are_options(name: str) -> None:
    options = MutationOptions(min_changed=2, max_changed=4)
    rng, road = rng_of(1), np.full(20, 0.2)

    counts = set()
    for _ in range(200):
        mutant = PASS_OPERATORS[name](rng, road, options)
        assert mutant is not None
        changed = abs(len(mutant) - len(road))
        counts.add(changed if name != "P5" else int(np.count_nonzero(mutant != road)))

    assert counts == {2, 3, 4}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bound": 0.0}, "bound must be positive"),
        ({"max_change": float("nan")}, "max_change must be positive"),
        ({"min_changed": 0}, "min_changed must be a whole number of at least 1, got 0"),
        ({"min_changed": 3, "max_changed": 2}, "max_changed must be a whole number of at least 3"),
        ({"max_changed": 2.5}, "max_changed must be a whole number of at least 1, got 2.5"),
        ({"min_scale": -1.0}, "min_scale must be positive"),
        ({"min_scale": 1.3}, r"max_scale must be a number of at least min_scale \(1.3\), got 1.2"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MutationOptions(**options)  # type: ignore[arg-type]


# Mutations of roads that failed


@given(roads())
def test_f1_f2_and_f4_undo_themselves(road: FloatArray) -> None:
    for vary in (reverse_road, reverse_values, flip):
        np.testing.assert_array_equal(vary(vary(road)), road)


@given(distinct_roads())
def test_f3_undoes_itself_for_an_even_number_of_values(road: FloatArray) -> None:
    twice = swap_halves(swap_halves(road))

    assert np.array_equal(twice, road) == (len(road) % 2 == 0)


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


def centre_line(
    curvatures: FloatArray, step: float, start: tuple[float, float], heading: float
) -> tuple[FloatArray, FloatArray]:
    """Return points, (n, 2) m, and headings by midpoint integration of linear pieces, 1000 each."""
    pieces = 1000
    ds = step / pieces
    fine = np.interp(
        np.arange((len(curvatures) - 1) * pieces * 2 + 1) / (2 * pieces),
        np.arange(len(curvatures)),
        curvatures,
    )
    quarter = (fine[:-1] + fine[1:]) / 2 * (ds / 2)
    theta = heading + np.concatenate(([0.0], np.cumsum(quarter)))
    moves = ds * np.column_stack((np.cos(theta[1::2]), np.sin(theta[1::2])))
    return np.vstack((start, start + np.cumsum(moves, axis=0))), theta[::2]


@given(arrays(np.float64, st.integers(2, 12), elements=st.floats(-0.07, 0.07)))
def test_f1_is_the_same_road_driven_from_its_other_end(road: FloatArray) -> None:
    points, headings = centre_line(road, 10.0, (0.0, 0.0), math.pi / 2)
    end_x, end_y = points[-1]

    back, _ = centre_line(reverse_road(road), 10.0, (end_x, end_y), headings[-1] + math.pi)

    np.testing.assert_allclose(back, points[::-1], atol=1e-6)


# Crossover


@given(seeds, distinct_roads(), distinct_roads())
def test_mix_takes_each_value_from_either_parent(
    seed: int, first: FloatArray, second: FloatArray
) -> None:
    child = mix(rng_of(seed), first, second)

    n = min(len(first), len(second))
    assert child.shape == (n,)
    assert np.all((child == first[:n]) | (child == second[:n]))


def test_mix_takes_half_from_each_parent_independently() -> None:
    rng = rng_of(1)
    children = np.array([mix(rng, np.zeros(10), np.ones(12)) for _ in range(4000)])

    np.testing.assert_allclose(children.mean(axis=0), 0.5, atol=0.04)
    neighbours = np.corrcoef(children.T)[np.triu_indices(10, k=1)]
    assert np.max(np.abs(neighbours)) < 0.08


@given(distinct_roads(), distinct_roads())
def test_splice_joins_a_front_half_and_a_back_half(first: FloatArray, second: FloatArray) -> None:
    one, other = splice(first, second)

    n, m = len(first), len(second)
    assert len(one) == n // 2 + math.ceil(m / 2)
    assert len(other) == math.ceil(n / 2) + m // 2
    assert one.tolist() == first.tolist()[: n // 2] + second.tolist()[m // 2 :]
    assert other.tolist() == second.tolist()[: m // 2] + first.tolist()[n // 2 :]


@given(distinct_roads(), distinct_roads())
def test_splice_loses_no_value(first: FloatArray, second: FloatArray) -> None:
    one, other = splice(first, second)

    assert sorted([*one, *other]) == sorted([*first, *second])


def test_the_tables_are_in_the_order_of_the_listing() -> None:
    assert list(PASS_OPERATORS.items()) == [
        ("P1", append),
        ("P2", remove_random),
        ("P3", remove_front),
        ("P4", remove_end),
        ("P5", replace_random),
        ("P6", scale),
    ]
    assert list(FAIL_OPERATORS.items()) == [
        ("F1", reverse_road),
        ("F2", reverse_values),
        ("F3", swap_halves),
        ("F4", flip),
    ]
