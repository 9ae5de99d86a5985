"""Search: the Strategy protocol, its operators and its implementations."""

from __future__ import annotations

from frenetic.search.frenetic import Frenetic
from frenetic.search.random_search import RandomSearch
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import CheckingStrategy, SearchEnded, SelectiveStrategy, Strategy

__all__ = [
    "Candidate",
    "CheckingStrategy",
    "Evaluation",
    "Frenetic",
    "Origin",
    "RandomSearch",
    "SearchEnded",
    "SelectiveStrategy",
    "Strategy",
]
