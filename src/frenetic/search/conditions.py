"""The conditions of a search's candidates in a domain: drawn, inherited, changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic.conditions.condition import SEED, quantity, without

if TYPE_CHECKING:
    from frenetic._support.arrays import FloatArray
    from frenetic.conditions.domain import Domain
    from frenetic.search.records import Candidate

_LITTLE: Final = 0.08
"""Standard deviation of a little change, in shares of the domain's drives."""
_MUCH: Final = 0.25
_AHEAD: Final = 15.0  # m
_CHANGED: Final = 0.4
"""Share of children on another road whose conditions change a little, too."""


def drawn(
    rng: np.random.Generator, domain: Domain | None, length: float, *, is_blind: bool = False
) -> dict[str, float]:
    """Conditions from the domain's distribution, on a road of ``length`` m; {} without a domain.

    While no failure is known (``is_blind``), what few drives have is there in half of them.
    """
    if domain is None:
        return {}
    shares = rng.random(domain.dimension)
    if is_blind:
        for i in range(len(shares)):
            shares[i] = _often(domain, i, float(shares[i]))
    return domain.at(shares, length)


def inherited(
    rng: np.random.Generator,
    domain: Domain | None,
    parent: Candidate,
    length: float,
    moved: float,
) -> Mapping[str, float]:
    """A parent's conditions on a child's road of ``length`` m, along which all is moved.

    Now and then one amount changes a little.
    """
    if domain is None:
        return parent.conditions
    shares = domain.shares_of(moved_along(parent.conditions, moved), length)
    if rng.random() < _CHANGED:
        _step(rng, domain, shares, int(rng.integers(len(shares))), _LITTLE)
    return domain.at(shares, length)


def changed(
    rng: np.random.Generator, domain: Domain, parent: Candidate, mate: Candidate, place: float
) -> dict[str, float]:
    """Other conditions on a parent's road, which came near failing ``place`` m along it.

    One amount is drawn anew, or some change much, or some are a mate's, or what lies on the road
    comes to lie before the place.
    """
    length = parent.length
    shares = domain.shares_of(parent.conditions, length)
    way, which = rng.random(), rng.random(len(shares)) < 0.5
    if way < 0.25:
        i = int(rng.integers(len(shares)))
        shares[i] = _often(domain, i, rng.random())
    elif way < 0.5:
        for i in np.flatnonzero(which).tolist():
            _step(rng, domain, shares, i, _MUCH)
    elif way < 0.75:
        shares[which] = domain.shares_of(mate.conditions, length)[which]
    else:
        _step(rng, domain, shares, int(rng.integers(len(shares))), _MUCH)
        for i, axis in enumerate(domain.axes):
            if axis != SEED and quantity(axis).place_of:
                there = place + rng.normal(-_AHEAD, _AHEAD)
                shares[i] = min(max(there / length, 0.0), 1.0)
    return domain.at(shares, length)


def moved_along(conditions: Mapping[str, float], way: float) -> dict[str, float]:
    """Conditions on a road that begins ``way`` m earlier, without what lies before its start."""
    found = dict(conditions)
    for name in conditions:
        if name != SEED and (of := quantity(name).place_of):
            found[name] = conditions[name] + way
            if found[name] < 0.0:
                found = without(found, of)
    return found


def _often(domain: Domain, i: int, share: float) -> float:
    """A share of the domain's drives, even in 0..1, as one of which half have the amount."""
    axis = domain.axes[i]
    chance = domain.conditions[axis].chance if axis in domain.conditions else 1.0
    if chance >= 0.5:
        return share
    return 2.0 * share * (1.0 - chance) if share < 0.5 else 1.0 - 2.0 * (1.0 - share) * chance


def _step(
    rng: np.random.Generator, domain: Domain, shares: FloatArray, i: int, deviation: float
) -> None:
    """Moves one share; an amount that a drive has by chance alone stays there."""
    axis = domain.axes[i]
    least = 1.0 - domain.conditions[axis].chance if axis in domain.conditions else 0.0
    if shares[i] < least:
        return
    moved = shares[i] + (1.0 - least) * rng.normal(0.0, deviation)
    shares[i] = min(max(moved, least), 1.0)
