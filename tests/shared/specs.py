"""Specs of runs, made up."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from frenetic.quantities import Quantity, quantities
from frenetic.spec import Budget, Part, Spec

names = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=12)
plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | texts
positive = st.floats(1e-3, 1e6)


def _amounts(row: Quantity) -> st.SearchStrategy[float]:
    """Amounts that have an effect."""
    return st.floats(row.low, row.high).filter(lambda amount: amount != row.nothing)


def specs(
    values: st.SearchStrategy[Any] = plain, *, made: Any = None, **more: Any
) -> st.SearchStrategy[Spec]:
    """Specs whose parts have options of these values, and more entries."""
    part = st.builds(
        Part,
        st.sampled_from(["planner", "a b.py:It's, too", "package.module:Class"]),
        st.dictionaries(names, values, max_size=3),
        st.just({}) if made is None else made,
    )
    return st.builds(
        Spec,
        strategy=part,
        driver=part,
        simulator=part,
        layers=st.fixed_dictionaries(
            {}, optional={name: _amounts(row) for name, row in quantities().items() if row.layer}
        ),
        map_size=positive,
        margin=st.floats(0.0, 1e3),
        lane_width=st.floats(0.1, 100.0),
        seed=st.none() | st.integers(0, 2**62),
        lookahead=st.none() | st.integers(1, 100),
        budget=st.builds(
            Budget,
            simulations=st.integers(1, 10**9),
            time=st.none() | positive,
            failures=st.none() | st.integers(1, 10**9),
        ),
        workers=st.integers(1, 100),
        **more,
    )
