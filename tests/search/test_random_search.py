"""Random roads: how long they are, and how often a refused one is drawn again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.road import MARGIN, Road
from frenetic.search import Frenetic, Frenetic2021, RandomSearch
from frenetic.search.random_search import RandomRoads


@pytest.mark.parametrize(
    ("options", "least", "largest"),
    [
        ({}, 15, 25),
        ({"map_size": 209.0}, 15, 25),
        ({"map_size": 1000.0}, 25, 35),
        ({"map_size": 1000.0, "max_length": 50}, 45, 55),
        ({"step": 5.0, "max_length": 100}, 35, 45),
        ({"step": 40.0}, 2, 10),
        ({"length_jitter": 1}, 19, 21),
    ],
)
def test_the_number_of_values_follows_the_map(
    options: dict[str, Any], least: int, largest: int
) -> None:
    rng, roads = np.random.default_rng(1), RandomRoads(is_valid=lambda *_: True, **options)
    assert {len(roads.draw(rng)) for _ in range(600)} == set(range(least, largest + 1))


def test_roads_are_valid_on_the_map_by_default() -> None:
    for margin in (None, 40.0):
        search, plain = RandomSearch(seed=2), RandomSearch(seed=2, max_redraws=0)
        if margin is not None:
            search.keep_margin(margin)
        kept = MARGIN if margin is None else margin
        valid = [
            [Road(one.ask().curvatures, 10.0).placed(200.0, kept)[1].valid for _ in range(30)]
            for one in (search, plain)
        ]
        assert sum(valid[0]) >= 29 > sum(valid[1])


def test_random_roads_are_187_m_long_in_the_mean_and_those_of_frenetic_275_m() -> None:
    searches = RandomSearch(seed=1), Frenetic(seed=1, random_roads=500)
    lengths = [[search.ask().length for _ in range(500)] for search in searches]
    assert np.mean(lengths, axis=1) == pytest.approx([187.0, 275.0], abs=3.0)


def test_random_roads_are_those_of_frenetic_2021_that_draws_invalid_ones_again() -> None:
    search, other = RandomSearch(seed=3), Frenetic2021(seed=3, max_redraws=10)
    for _ in range(50):
        np.testing.assert_array_equal(search.ask().curvatures, other.ask().curvatures)


@pytest.mark.parametrize(("accept_every", "max_redraws"), [(4, 10), (99, 0), (99, 1), (99, 10)])
def test_a_refused_road_is_drawn_again_and_the_last_draw_taken_whatever_it_is(
    accept_every: int, max_redraws: int
) -> None:
    seen: list[FloatArray] = []

    def check(curvatures: FloatArray, step: float) -> bool:
        assert step == 8.0
        seen.append(curvatures)
        return len(seen) % accept_every == 0

    search = RandomSearch(seed=1, step=8.0, is_valid=check, max_redraws=max_redraws)
    plain = RandomSearch(seed=1, step=8.0, max_redraws=0)
    draws = [plain.ask().curvatures for _ in range(min(accept_every, max_redraws + 1))]
    candidate = search.ask()
    assert (candidate.step, candidate.origin.operator) == (8.0, "random")
    np.testing.assert_array_equal(candidate.curvatures, draws[-1])
    assert len(seen) == min(accept_every, max_redraws)  # the last draw needs no verdict
