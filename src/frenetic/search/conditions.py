"""The conditions of a search's candidates in a domain: drawn, inherited, changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic.conditions.condition import SEED, condition_named, without

if TYPE_CHECKING:
    from frenetic._support.arrays import FloatArray
    from frenetic.conditions.domain import Domain
    from frenetic.search.records import Candidate

# All values are ours.
_SMALL_DEVIATION: Final = 0.08  # of a small change, in shares of the domain's drives
_LARGE_DEVIATION: Final = 0.25  # of a large change, in shares of the domain's drives
_MEAN_LEAD: Final = 15.0  # [m], mean way from the start of a moved stretch to the place
_LEAD_DEVIATION: Final = 15.0  # [m], deviation of that way
_SMALL_CHANGE_SHARE: Final = 0.4  # of children on another road whose conditions change, too


def drawn(
    rng: np.random.Generator, domain: Domain | None, length: float, *, is_blind: bool = False
) -> dict[str, float]:
    """Draw conditions from the domain, on a road of ``length`` m; {} without a domain.

    While no failure is known (``is_blind``), half of the drives have a condition that few have.
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
    """Return a parent's conditions on a child's road of ``length`` m, ``moved`` m further along it.

    Now and then one amount changes a little.
    """
    if domain is None:
        return parent.conditions
    shares = domain.shares_of(moved_along(parent.conditions, moved), length)
    if rng.random() < _SMALL_CHANGE_SHARE:
        _step(rng, domain, shares, int(rng.integers(len(shares))), _SMALL_DEVIATION)
    return domain.at(shares, length)


def changed(
    rng: np.random.Generator, domain: Domain, parent: Candidate, mate: Candidate, place: float
) -> dict[str, float]:
    """Return other conditions for a parent's road, which came near failing ``place`` m along it.

    One amount is drawn anew, or some change much, or some are a mate's, or a stretch of the road
    with a condition, such as a wet one, is moved to shortly before the place.
    """
    length = parent.length
    shares = domain.shares_of(parent.conditions, length)
    way, is_chosen = rng.random(), rng.random(len(shares)) < 0.5
    if way < 0.25:
        i = int(rng.integers(len(shares)))
        shares[i] = _often(domain, i, rng.random())
    elif way < 0.5:
        for i in np.flatnonzero(is_chosen).tolist():
            _step(rng, domain, shares, i, _LARGE_DEVIATION)
    elif way < 0.75:
        shares[is_chosen] = domain.shares_of(mate.conditions, length)[is_chosen]
    else:
        _step(rng, domain, shares, int(rng.integers(len(shares))), _LARGE_DEVIATION)
        for i, axis in enumerate(domain.axes):
            if axis != SEED and condition_named(axis).place_of:
                there = place + rng.normal(-_MEAN_LEAD, _LEAD_DEVIATION)
                shares[i] = min(max(there / length, 0.0), 1.0)
    return domain.at(shares, length)


def moved_along(conditions: Mapping[str, float], way: float) -> dict[str, float]:
    """Return conditions on a road that begins ``way`` m earlier, none of them before its start."""
    moved = dict(conditions)
    for name in conditions:
        if name != SEED and (condition := condition_named(name).place_of):
            moved[name] = conditions[name] + way
            if moved[name] < 0.0:
                moved = without(moved, condition)
    return moved


def _often(domain: Domain, i: int, share: float) -> float:
    """Return a share of the domain's drives, uniform in 0..1, as if half of them had the amount."""
    axis = domain.axes[i]
    chance = domain.conditions[axis].chance if axis in domain.conditions else 1.0
    if chance >= 0.5:
        return share
    return 2.0 * share * (1.0 - chance) if share < 0.5 else 1.0 - 2.0 * (1.0 - share) * chance


def _step(
    rng: np.random.Generator, domain: Domain, shares: FloatArray, i: int, deviation: float
) -> None:
    """Move one share; a drive without an amount that only some drives have stays without it."""
    axis = domain.axes[i]
    least = 1.0 - domain.conditions[axis].chance if axis in domain.conditions else 0.0
    if shares[i] < least:
        return
    moved = shares[i] + (1.0 - least) * rng.normal(0.0, deviation)
    shares[i] = min(max(moved, least), 1.0)
