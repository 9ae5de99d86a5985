"""Families of random roads, each of which some drivers fear, and the choice among them.

==================  ============================================================================
family              its roads
==================  ============================================================================
``random``          each value is drawn relative to the one before it, as in the paper
``independent``     each value is drawn by itself, within an amplitude of the road's own
``slalom``          bends to both sides in turn, of one period; along some roads they grow
``bends``           bends of one curvature after straights
``sections``        straights, clothoids and arcs, as road builders lay them out
==================  ============================================================================
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.search.elements import draw_elements
from frenetic.search.operator_choice import SuccessShares
from frenetic.search.operator_names import BENDS, INDEPENDENT, RANDOM, SECTIONS, SLALOM
from frenetic.search.operators import random_curvatures
from frenetic.search.variation import limit_changes

# The values are our choice.
_LEAST_AMPLITUDE = 0.3  # least amplitude of values, as a share of the bound
_PERIODS = (2.2, 12.0)  # least and largest period of a slalom, in values
_LEAST_GROWTH = 0.3  # share of a growing slalom's amplitude at its start
_FIRST_STRAIGHTS = (1, 8)  # least and largest straight before the first bend, in values
_BENDS = (1, 7)  # least and largest length of a bend, in values
_STRAIGHTS = (0, 9)  # least and largest straight between two bends, in values
_LEAST_ARC = 2.0  # length of the shortest arc between clothoids, in values
_POWER = 2.0  # power of a family's share of successes that is its chance
_ASSUMED_ROADS = 1.0  # roads with which the count of each family begins
_ASSUMED_SUCCESSES = 0.3  # successes among these roads

_Draw: TypeAlias = Callable[[np.random.Generator, int, float, float], FloatArray]


def _random(rng: np.random.Generator, n: int, bound: float, max_change: float) -> FloatArray:
    return random_curvatures(rng, n, bound=bound, max_change=max_change)


def _independent(rng: np.random.Generator, n: int, bound: float, max_change: float) -> FloatArray:
    amplitude = rng.uniform(_LEAST_AMPLITUDE, 1.0) * bound
    return _limited(rng.uniform(-amplitude, amplitude, n), max_change)


def _slalom(rng: np.random.Generator, n: int, bound: float, max_change: float) -> FloatArray:
    shortest, longest = _PERIODS
    period = shortest * (longest / shortest) ** rng.random()
    amplitude = rng.uniform(_LEAST_AMPLITUDE, 1.0) * bound
    growth = np.linspace(rng.choice([1.0, _LEAST_GROWTH]), 1.0, n)
    phases = 2.0 * np.pi * (np.arange(n) / period + rng.random())
    return _limited(amplitude * growth * np.sin(phases), max_change)


def _bends(rng: np.random.Generator, n: int, bound: float, max_change: float) -> FloatArray:
    values = np.zeros(n)
    first = int(rng.integers(*_FIRST_STRAIGHTS, endpoint=True))
    while first < n:
        end = first + int(rng.integers(*_BENDS, endpoint=True))
        values[first:end] = rng.choice([-1.0, 1.0]) * rng.uniform(_LEAST_AMPLITUDE, 1.0) * bound
        first = end + int(rng.integers(*_STRAIGHTS, endpoint=True))
    return _limited(values, max_change)


def _sections(rng: np.random.Generator, n: int, bound: float, max_change: float) -> FloatArray:
    values = np.zeros(n)
    first = int(rng.integers(*_FIRST_STRAIGHTS, endpoint=True))
    limits = np.array([bound, max_change, _LEAST_ARC])
    draw_elements(
        values, first=first, end=n, previous=0.0, u=rng.random(n), offset=0, limits=limits
    )
    return values


def _limited(values: FloatArray, max_change: float) -> FloatArray:
    limit_changes(values, 0, max_change)
    return values


FAMILIES: Final[Mapping[str, _Draw]] = MappingProxyType(
    {
        INDEPENDENT: _independent,
        RANDOM: _random,
        SLALOM: _slalom,
        SECTIONS: _sections,
        BENDS: _bends,
    }
)
"""Name of a family -> function that draws a road of n values: generator, n, and largest absolute
value and largest change of values in 1/m. The names are operators of an `Origin`, too."""


class FamilyChoice:
    """Draws families: each once at first, then the more often the more its roads have brought.

    Until a road fails, every other road has independent values: on such roads most drivers fail
    sooner than on others, and without a near miss before, from which a search could learn.
    """

    def __init__(self) -> None:
        self._names = list(FAMILIES)
        self._untried = deque(name for name in FAMILIES if name != INDEPENDENT)
        self._scouted = 0  # number of choices before a road failed
        self._shares = SuccessShares(
            len(FAMILIES), roads=_ASSUMED_ROADS, successes=_ASSUMED_SUCCESSES, power=_POWER
        )

    def choose(self, rng: np.random.Generator, *, has_failures: bool) -> str:
        """Return the name of a family; `has_failures` says whether a road has failed."""
        if not has_failures:
            self._scouted += 1
            if self._scouted % 2 == 1:
                return INDEPENDENT
        if self._untried:
            return self._untried.popleft()
        return self._names[int(self._shares.draw(rng, 1)[0])]

    def learn(self, family: str, success: float) -> None:
        """Learn what a road of a family brought, from 0 to 1."""
        self._shares.learn(self._names.index(family), success)
