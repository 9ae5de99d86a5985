"""Search: the Strategy protocol, its operators and its implementations."""

from __future__ import annotations

from frenetic.search.command import CommandSearch
from frenetic.search.frenetic import Frenetic
from frenetic.search.frenetic_2021 import Frenetic2021
from frenetic.search.random_search import RandomSearch
from frenetic.search.records import Candidate, Evaluation, Origin, Trace
from frenetic.search.strategy import (
    SearchEnded,
    Strategy,
)
from frenetic.search.sweep import Sweep

__all__ = [
    "Candidate",
    "CommandSearch",
    "Evaluation",
    "Frenetic",
    "Frenetic2021",
    "Origin",
    "RandomSearch",
    "SearchEnded",
    "Strategy",
    "Sweep",
    "Trace",
]
