"""The strategies that the pipeline can run by name."""

from __future__ import annotations

from frenetic import search
from frenetic.competition.generator import Generator


class Frenetic(Generator):
    """Random roads, then mutants and crossovers of the worst: `frenetic.search.Frenetic`."""

    strategy = search.Frenetic


class RandomSearch(Generator):
    """Random roads only, the baseline: `frenetic.search.RandomSearch`."""

    strategy = search.RandomSearch
