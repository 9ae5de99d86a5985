from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic._support.arrays import FloatArray
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Evaluation, Frenetic, Frenetic2021, Origin, RandomSearch


def lengths(search: RandomSearch, count: int = 600) -> set[int]:
    return {len(search.ask().curvatures) for _ in range(count)}


@pytest.mark.parametrize(
    ("options", "least", "largest"),
    [
        ({}, 15, 25),
        ({"map_size": 209.0}, 15, 25),
        ({"map_size": 250.0}, 20, 30),
        ({"map_size": 1000.0}, 25, 35),
        ({"map_size": 1000.0, "max_length": 50}, 45, 55),
        ({"step": 5.0, "max_length": 100}, 35, 45),
        ({"step": 40.0}, 2, 10),
        ({"map_size": 5.0}, 2, 5),
        ({"length_jitter": 1}, 19, 21),
        ({"length_jitter": 0}, 20, 20),
    ],
)
def test_the_number_of_values_follows_the_map(
    options: dict[str, Any], least: int, largest: int
) -> None:
    assert lengths(RandomSearch(seed=1, **options)) == set(range(least, largest + 1))


def test_roads_are_random_ones() -> None:
    search = RandomSearch(seed=1, step=7.5)

    candidate = search.ask()

    assert candidate.origin == Origin("random", (), 0)
    assert candidate.step == 7.5


@given(st.integers(0, 2**32), st.floats(0.001, 0.2), st.floats(0.001, 0.2))
def test_values_stay_within_the_bound_and_the_change(
    seed: int, curvature_bound: float, max_change: float
) -> None:
    search = RandomSearch(seed=seed, curvature_bound=curvature_bound, max_change=max_change)

    for _ in range(5):
        curvatures = search.ask().curvatures
        assert np.all(np.abs(curvatures) <= curvature_bound)
        assert np.all(np.abs(np.diff(curvatures, prepend=0.0)) <= max_change * (1 + 1e-12))


def test_what_is_told_has_no_influence() -> None:
    told, untold = RandomSearch(seed=3), RandomSearch(seed=3)

    for count in range(50):
        candidate = told.ask()
        np.testing.assert_array_equal(candidate.curvatures, untold.ask().curvatures)
        told.tell(Evaluation(candidate, Outcome.FAIL, -2.0, count / 50))


def test_its_roads_are_those_of_the_random_phase_of_frenetic() -> None:
    search, frenetic = RandomSearch(seed=3), Frenetic2021(seed=3, max_redraws=10)

    for _ in range(50):
        np.testing.assert_array_equal(search.ask().curvatures, frenetic.ask().curvatures)


class Refusing:
    """A check that refuses roads by a rule, and counts."""

    def __init__(self, *, accept_every: int | None) -> None:
        self.accept_every = accept_every
        self.seen: list[FloatArray] = []
        self.steps: set[float] = set()

    def __call__(self, curvatures: FloatArray, step: float) -> bool:
        self.seen.append(curvatures.copy())
        self.steps.add(step)
        return self.accept_every is not None and len(self.seen) % self.accept_every == 0


def test_a_refused_road_is_drawn_again() -> None:
    check = Refusing(accept_every=4)
    search = RandomSearch(seed=1, step=8.0, is_valid=check)

    for count in range(1, 11):
        candidate = search.ask()
        assert len(check.seen) == 4 * count  # three refused, the fourth taken
        np.testing.assert_array_equal(candidate.curvatures, check.seen[-1])
    assert check.steps == {8.0}
    assert candidate.id == 10


@pytest.mark.parametrize("max_redraws", [0, 1, 10])
def test_the_last_draw_is_handed_out_whatever_it_is(max_redraws: int) -> None:
    check = Refusing(accept_every=None)
    search = RandomSearch(seed=1, is_valid=check, max_redraws=max_redraws)
    plain = RandomSearch(seed=1, max_redraws=0)
    draws = [plain.ask().curvatures for _ in range(max_redraws + 1)]

    candidate = search.ask()

    np.testing.assert_array_equal(candidate.curvatures, draws[-1])
    assert len(check.seen) == max_redraws  # the last draw needs no verdict


def test_a_check_that_accepts_all_changes_nothing() -> None:
    checked = RandomSearch(seed=1, is_valid=lambda curvatures, step: True)
    plain = RandomSearch(seed=1, max_redraws=0)

    for _ in range(20):
        np.testing.assert_array_equal(checked.ask().curvatures, plain.ask().curvatures)


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("seed", -1, "a whole number of at least 0"),
        ("seed", 1.5, "a whole number of at least 0"),
        ("map_size", 0.0, "positive (m)"),
        ("map_size", float("inf"), "positive (m)"),
        ("step", -1.0, "positive (m)"),
        ("length_jitter", -1, "a whole number of at least 0 and at most 1000"),
        ("length_jitter", 10**400, "a whole number of at least 0 and at most 1000"),
        ("max_length", 1, "a whole number of at least 2"),
        ("curvature_bound", 0.0, "positive (1/m)"),
        ("max_change", float("nan"), "positive (1/m)"),
        ("max_change", 10**400, "positive (1/m)"),
        ("max_redraws", -1, "a whole number of at least 0"),
    ],
)
@pytest.mark.parametrize("strategy", [RandomSearch, Frenetic2021, Frenetic])
def test_options_out_of_range_are_refused(
    strategy: type[RandomSearch | Frenetic2021 | Frenetic], option: str, value: float, allowed: str
) -> None:
    options: dict[str, Any] = {"seed": 1, option: value}

    with pytest.raises(ValueError) as refusal:
        strategy(**options)

    assert str(refusal.value) == f"{option} must be {allowed}, got {value!r}"


def test_memory_is_that_of_the_outstanding_candidates() -> None:
    search = RandomSearch(seed=1)
    waiting: list[Candidate] = [search.ask() for _ in range(5)]

    for _ in range(5000):
        search.tell(Evaluation(waiting.pop(0), Outcome.PASS, -1.0, 0.5))
        waiting.append(search.ask())

    assert len(search._ledger) == 5
