"""An option out of range is refused in one line: what is allowed, and what was given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from frenetic.search import Frenetic, Frenetic2021, RandomSearch
from frenetic.search.operators import MutationOptions

OF_ALL = [
    ("seed", -1, "a whole number of at least 0"),
    ("seed", 1.5, "a whole number of at least 0"),
    ("map_size", float("inf"), "positive (m)"),
    ("step", -1.0, "positive (m)"),
    ("max_length", 1, "a whole number of at least 2"),
]
MISTAKES = [
    *((strategy, *row) for strategy in (RandomSearch, Frenetic2021, Frenetic) for row in OF_ALL),
    (RandomSearch, "max_redraws", -1, "a whole number of at least 0"),
    (Frenetic, "random_budget", 1.1, "between 0 and 1"),
    (Frenetic, "random_roads", 0, "a whole number of at least 1"),
    (Frenetic, "threshold", float("inf"), "a finite number"),
    (Frenetic2021, "length_jitter", -1, "a whole number of at least 0 and at most 1000"),
    (Frenetic2021, "length_jitter", 10**400, "a whole number of at least 0 and at most 1000"),
    (Frenetic2021, "curvature_bound", 0.0, "positive (1/m)"),
    (Frenetic2021, "max_change", float("nan"), "positive (1/m)"),
    (Frenetic2021, "max_change", 10**400, "positive (1/m)"),
    (Frenetic2021, "random_budget", -0.1, "between 0 and 1"),
    (Frenetic2021, "threshold", float("nan"), "a finite number (m)"),
    (Frenetic2021, "cross_freq", -1, "a whole number of at least 0"),
    (Frenetic2021, "cross_num", 1, "a whole number of at least 2"),
    (Frenetic2021, "min_changed", 0, "a whole number of at least 1"),
    (Frenetic2021, "max_scale", 1.0, "a number of at least min_scale (1.1)"),
    (MutationOptions, "bound", 0.0, "positive (1/m)"),
    (MutationOptions, "max_change", float("nan"), "positive (1/m)"),
    (MutationOptions, "max_changed", 2.5, "a whole number of at least 1"),
    (MutationOptions, "min_scale", -1.0, "positive"),
]


@pytest.mark.parametrize(("part", "option", "value", "allowed"), MISTAKES)
def test_options_out_of_range_are_refused(
    part: Callable[..., object], option: str, value: float, allowed: str
) -> None:
    options: dict[str, Any] = {} if part is MutationOptions else {"seed": 1}
    with pytest.raises(ValueError) as refusal:
        part(**options | {option: value})
    assert str(refusal.value) == f"{option} must be {allowed}, got {value!r}"
