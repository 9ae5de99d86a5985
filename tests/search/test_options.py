"""Options out of range are refused in one line that says which values are allowed."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from frenetic.road.classes import RoadClass
from frenetic.search import Frenetic, Frenetic2021, RandomSearch

COMMON_MISTAKES = [
    ("seed", -1, "a whole number >= 0"),
    ("seed", 1.5, "a whole number"),
    ("map_size", float("inf"), "a number that is finite"),
    ("step", -1.0, "a number > 0"),
    ("max_length", 1, "a whole number >= 2"),
]
MISTAKES = [
    *(
        (strategy, *row)
        for strategy in (RandomSearch, Frenetic2021, Frenetic)
        for row in COMMON_MISTAKES
    ),
    (RandomSearch, "max_redraws", -1, "a whole number >= 0"),
    (Frenetic, "random_budget", 1.1, "a number <= 1"),
    (Frenetic, "random_roads", 0, "a whole number >= 1"),
    (Frenetic2021, "length_jitter", -1, "a whole number >= 0"),
    (Frenetic2021, "length_jitter", 1001, "a whole number <= 1000"),
    (Frenetic2021, "curvature_bound", 0.0, "a number > 0"),
    (Frenetic2021, "max_change", float("nan"), "a number > 0"),
    (Frenetic2021, "random_budget", -0.1, "a number >= 0"),
    (Frenetic2021, "threshold", float("nan"), "a number that is finite"),
    (Frenetic2021, "cross_freq", -1, "a whole number >= 0"),
    (Frenetic2021, "cross_num", 1, "a whole number >= 2"),
    (Frenetic2021, "min_changed", 0, "a whole number >= 1"),
    (Frenetic2021, "max_changed", 2.5, "a whole number"),
    (Frenetic2021, "min_scale", -1.0, "a number > 0"),
]


@pytest.mark.parametrize(("part", "option", "value", "needed"), MISTAKES)
def test_options_out_of_range_are_refused(
    part: Callable[..., object], option: str, value: float, needed: str
) -> None:
    with pytest.raises(ValueError) as refusal:
        part(**{"seed": 1, option: value})
    assert str(refusal.value) == f"{option} is {repr(value)[:60]}: {needed} is needed"


def test_a_range_whose_ends_are_exchanged_is_refused() -> None:
    with pytest.raises(ValueError, match=r"min_scale is 1.1: at most max_scale, 1.0, is allowed"):
        Frenetic2021(seed=1, max_scale=1.0)
    with pytest.raises(ValueError, match=r"step is 10.0: 16 m are needed, as its road class says"):
        RandomSearch(seed=1, step=10.0, road_class=RoadClass.of("rural-80"))
