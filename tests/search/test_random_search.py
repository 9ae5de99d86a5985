"""Random roads: their length, validity and redraws."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.road import MAP_MARGIN, Road
from frenetic.road.classes import RoadClass, class_of, classes
from frenetic.search import Frenetic, Frenetic2021, RandomSearch, Strategy
from frenetic.search.map_check import most_frequent
from frenetic.search.random_roads import RandomRoads


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
    for map_margin in (None, 40.0):
        search, plain = RandomSearch(seed=2), RandomSearch(seed=2, max_redraws=0)
        if map_margin is not None:
            search.keep_map_margin(map_margin)
        least = MAP_MARGIN if map_margin is None else map_margin
        valid = [
            [Road(strategy.ask().curvatures, 10.0).placed(200.0, least)[1].valid for _ in range(30)]
            for strategy in (search, plain)
        ]
        assert sum(valid[0]) >= 29 > sum(valid[1])


def test_valid_roads_keep_the_map_margin_also_in_a_class() -> None:
    for name in (None, "rural-80"):
        road_class = None if name is None else class_of(name)
        map_size = 200.0 if road_class is None else road_class.map_size
        roads = RandomRoads(map_size=map_size, road_class=road_class)
        roads.keep_map_margin(40.0)
        for road in islice(roads.valid(np.random.default_rng(1)), 10):
            assert road.road_points.min() >= 40.0 - 1e-6
            assert road.road_points.max() <= map_size - 40.0 + 1e-6


def test_random_roads_have_a_mean_length_of_187_m_and_266_m_in_frenetic() -> None:
    searches = RandomSearch(seed=1), Frenetic(seed=1, random_roads=500)
    lengths = [[search.ask().length for _ in range(500)] for search in searches]
    assert np.mean(lengths, axis=1) == pytest.approx([187.0, 266.0], abs=3.0)


def test_random_search_draws_the_roads_of_frenetic_2021_with_redraws() -> None:
    search, frenetic = RandomSearch(seed=3), Frenetic2021(seed=3, max_redraws=10)
    for _ in range(50):
        np.testing.assert_array_equal(search.ask().curvatures, frenetic.ask().curvatures)


@pytest.mark.parametrize(("accept_every", "max_redraws"), [(4, 10), (99, 0), (99, 1), (99, 10)])
def test_a_refused_road_is_drawn_again_and_the_last_draw_is_always_taken(
    accept_every: int, max_redraws: int
) -> None:
    checked: list[FloatArray] = []

    def check(curvatures: FloatArray, step: float) -> bool:
        assert step == 8.0
        checked.append(curvatures)
        return len(checked) % accept_every == 0

    search = RandomSearch(seed=1, step=8.0, is_valid=check, max_redraws=max_redraws)
    plain = RandomSearch(seed=1, step=8.0, max_redraws=0)
    draws = [plain.ask().curvatures for _ in range(min(accept_every, max_redraws + 1))]
    candidate = search.ask()
    assert (candidate.step, candidate.origin.operator) == (8.0, "random")
    np.testing.assert_array_equal(candidate.curvatures, draws[-1])
    assert len(checked) == min(accept_every, max_redraws)  # the last draw needs no verdict


@pytest.mark.parametrize("name", classes())
@pytest.mark.parametrize("make", [Frenetic, Frenetic2021, RandomSearch])
def test_every_class_has_valid_roads(name: str, make: Callable[..., Strategy]) -> None:
    make(seed=1, road_class=RoadClass.of(name)).require_valid_roads()
    make(seed=1).require_valid_roads()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rural-80,design_speed=20", "a min_radius of 8 m (20 km/h)"),
        ("rural-80,design_speed=30", "a min_radius of 21 m (30 km/h)"),
        ("rural-80,min_radius=10", "a min_radius of 10 m (80 km/h)"),
        ("rural-80,map_size=200", "a map_size of 200 m"),
    ],
)
@pytest.mark.parametrize("make", [Frenetic, Frenetic2021, RandomSearch])
def test_options_without_valid_roads_are_refused_and_a_length_is_proposed(
    text: str, words: str, make: Callable[..., Strategy]
) -> None:
    road_class = class_of(text)
    assert road_class is not None
    with pytest.raises(ValueError, match=re.escape(words)) as refused:
        make(seed=1, road_class=road_class).require_valid_roads()
    assert str(refused.value).startswith("the length of rural-80 is 2000 m, and with ")
    needed = re.search(r"; length=(\d+) or less is needed$", str(refused.value))
    assert needed is not None
    make(seed=1, road_class=replace(road_class, length=float(needed[1]))).require_valid_roads()


def test_a_map_too_small_for_roads_is_refused() -> None:
    reason = r"fewer than 2 of 300 random roads are valid there: .*fit.* \(300 times\)"
    with pytest.raises(ValueError, match=f"^map_size is 25 m, and {reason}"):
        RandomSearch(seed=1, map_size=25.0).require_valid_roads()


def test_require_valid_roads_changes_no_proposal_and_calls_no_user_check() -> None:
    road_class = RoadClass.of("rural-80")
    checked, plain = (RandomSearch(seed=1, road_class=road_class) for _ in range(2))
    checked.require_valid_roads()
    for _ in range(5):
        assert np.array_equal(checked.ask().curvatures, plain.ask().curvatures)
    steps: list[float] = []

    def check(_: FloatArray, step: float) -> bool:
        steps.append(step)
        return False

    RandomSearch(seed=1, map_size=25.0, is_valid=check).require_valid_roads()
    assert steps == []


def test_reasons_that_differ_in_their_numbers_count_as_one() -> None:
    reasons = Counter({"at 10 m": 2, "self-intersecting": 3, "at 12.5 m": 2, "else": 1, "more": 1})
    assert most_frequent(reasons, 2) == "at 10 m (4 times), self-intersecting (3 times)"
