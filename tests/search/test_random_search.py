"""Random roads: how long they are, and how often a refused one is drawn again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.search import Evaluation, Frenetic2021, Origin, RandomSearch


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
    search = RandomSearch(seed=1, is_valid=lambda *_: True, **options)
    lengths = {len(search.ask().curvatures) for _ in range(600)}
    assert lengths == set(range(least, largest + 1))


def test_its_roads_are_those_of_the_random_phase_whatever_is_told() -> None:
    options: dict[str, Any] = {"step": 7.5, "curvature_bound": 0.02, "max_change": 0.01}
    search = RandomSearch(seed=3, **options)
    phase = Frenetic2021(seed=3, max_redraws=10, **options)

    for count in range(50):
        candidate = search.ask()
        assert (candidate.origin, candidate.step) == (Origin("random", (), 0), 7.5)
        np.testing.assert_array_equal(candidate.curvatures, phase.ask().curvatures)
        assert np.abs(candidate.curvatures).max() <= 0.02
        search.tell(Evaluation(candidate, Outcome.FAIL, -2.0, count / 50))


def test_roads_are_valid_on_the_map_by_default() -> None:
    for margin in (None, 40.0):
        search, plain = RandomSearch(seed=2), RandomSearch(seed=2, max_redraws=0)
        if margin is not None:
            search.keep_margin(margin)
        more = {} if margin is None else {"margin": margin}
        valid = [
            [Road(one.ask().curvatures, 10.0).placed(200.0, **more)[1].valid for _ in range(30)]
            for one in (search, plain)
        ]
        assert sum(valid[0]) >= 29 > sum(valid[1])


class Refusing:
    """A check that refuses roads by a rule, and counts."""

    def __init__(self, *, accept_every: int | None) -> None:
        self.accept_every = accept_every
        self.seen: list[FloatArray] = []

    def __call__(self, curvatures: FloatArray, step: float) -> bool:
        assert step == 8.0
        self.seen.append(curvatures.copy())
        return self.accept_every is not None and len(self.seen) % self.accept_every == 0


def test_a_refused_road_is_drawn_again() -> None:
    check = Refusing(accept_every=4)
    search = RandomSearch(seed=1, step=8.0, is_valid=check)

    for count in range(1, 11):
        candidate = search.ask()
        assert len(check.seen) == 4 * count  # three refused, the fourth taken
        np.testing.assert_array_equal(candidate.curvatures, check.seen[-1])
    assert candidate.id == 10


@pytest.mark.parametrize("max_redraws", [0, 1, 10])
def test_the_last_draw_is_handed_out_whatever_it_is(max_redraws: int) -> None:
    check = Refusing(accept_every=None)
    search = RandomSearch(seed=1, step=8.0, is_valid=check, max_redraws=max_redraws)
    plain = RandomSearch(seed=1, step=8.0, max_redraws=0)
    draws = [plain.ask().curvatures for _ in range(max_redraws + 1)]

    np.testing.assert_array_equal(search.ask().curvatures, draws[-1])
    assert len(check.seen) == max_redraws  # the last draw needs no verdict
