"""Hypothesis strategies that draw specs of runs."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from frenetic.conditions.condition import known_conditions
from frenetic.conditions.declaration import Condition
from frenetic.spec import Part, Spec

names = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=12)
plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | texts
values = st.recursive(
    plain,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
positive = st.floats(1e-9, 1e18)
counts = st.integers(1, 10**9)

PARTS = st.builds(
    Part,
    st.sampled_from(["planner", "a b.py:It's, too", "package.module:Class"]),
    st.dictionaries(names, values, max_size=3),
).map(str)
CRITERIA: Any = ["competition", "after-iso-11270", {"name": "mine", "lateral_jerk": 4.0}]
ROADS: Any = ["competition", "rural-80", "rural-80,length=800", {"design_speed": 60}]
DOMAINS: Any = [
    {"conditions": {"fog": {"low": 20, "high": 90, "chance": 0.5}}},
    {"roads": "urban-50"},
]


def _amounts(row: Condition) -> st.SearchStrategy[float]:
    """Draw amounts that have an effect."""
    return st.floats(row.low, row.high).filter(lambda amount: amount != row.no_effect)


ENTRIES: dict[str, st.SearchStrategy[Any]] = {
    "strategy": PARTS,
    "driver": PARTS,
    "simulator": PARTS,
    "with": st.fixed_dictionaries(
        {}, optional={name: _amounts(row) for name, row in known_conditions().items()}
    ),
    "speed_limit": positive,
    "oob_tolerance": st.floats(0.01, 1.0),
    "criteria": st.sampled_from(CRITERIA),
    "wall_limit": positive,
    "roads": st.sampled_from(ROADS),
    "odd": st.sampled_from(DOMAINS),
    "map_size": positive,
    "map_margin": st.floats(0.0, 1e3),
    "lane_width": positive,
    "objective": texts.filter(bool),
    "simulations": counts,
    "time": positive | st.sampled_from(["90", "1h30m"]),
    "failures": counts,
    "kilometres": positive,
    "simulated_time": positive | st.sampled_from(["90", "1h30m"]),
    "from": st.lists(texts.filter(bool), max_size=2),
    "seed": st.integers(0, 2**62),
    "max_in_flight": counts,
    "workers": st.integers(1, 1024) | st.just("tcp://10.0.0.1:8786"),
}
"""Values of each entry, except names of road files: they would be read."""
entries = st.fixed_dictionaries({}, optional=ENTRIES)
specs = entries.map(Spec.of)
