"""The conditions of a search's candidates in a domain: how they are drawn and inherited."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic.conditions.condition import SEED, condition_named, without

if TYPE_CHECKING:
    from frenetic._support.arrays import FloatArray
    from frenetic.conditions.domain import Domain
    from frenetic.search.records import Candidate

# The values are our choice. A domain maps a share 0..1 of its drives to an amount of a condition.
_SMALL_DEVIATION: Final = 0.08  # standard deviation of a small change of such a share
_LARGE_DEVIATION: Final = 0.25  # standard deviation of a large change of such a share
_SMALL_CHANGE_SHARE: Final = 0.4  # share of children on another road whose conditions change, too
_MEAN_LEAD: Final = 15.0  # [m] mean distance from the start of a moved stretch to the place
_LEAD_DEVIATION: Final = 15.0  # [m] standard deviation of this distance


def draw_conditions(
    rng: np.random.Generator, domain: Domain | None, length: float, *, is_blind: bool = False
) -> dict[str, float]:
    """Return random conditions of a domain; empty without a domain.

    Args:
        rng: Generator that draws the conditions.
        domain: The domain.
        length: Length of the road, in m.
        is_blind: Whether no failure tells yet which conditions matter. Then a condition that only
            some of the domain's drives have is drawn for half of the roads.
    """
    if domain is None:
        return {}
    shares = rng.random(domain.dimension)
    if is_blind:
        for i in range(len(shares)):
            shares[i] = _as_if_frequent(domain, i, float(shares[i]))
    return domain.at(shares, length)


def inherit_conditions(
    rng: np.random.Generator,
    domain: Domain | None,
    parent: Candidate,
    length: float,
    moved: float,
) -> Mapping[str, float]:
    """Return the conditions of a child on another road: its parent's, one of them changed a little.

    Most children have the parent's amounts unchanged.

    Args:
        rng: Generator that draws the change.
        domain: The domain; without one, the conditions are the parent's.
        parent: The parent.
        length: Length of the child's road, in m.
        moved: Distance in m by which the critical place moved along the road; conditions of a
            stretch of road move with it.
    """
    if domain is None:
        return parent.conditions
    shares = domain.shares_of(moved_along(parent.conditions, moved), length)
    if rng.random() < _SMALL_CHANGE_SHARE:
        _change_share(rng, domain, shares, int(rng.integers(len(shares))), _SMALL_DEVIATION)
    return domain.at(shares, length)


def change_conditions(
    rng: np.random.Generator, domain: Domain, parent: Candidate, mate: Candidate, place: float
) -> dict[str, float]:
    """Return other conditions for a parent's road, in one of four ways with equal chance.

    One amount is drawn anew, or about half of the amounts change much, or about half are a mate's,
    or one changes much and stretches of the road with a condition, such as a wet stretch, are moved
    to shortly before the place.

    Args:
        rng: Generator that draws the change.
        domain: The domain.
        parent: The parent, which came near failing.
        mate: Another candidate, from which conditions may be taken.
        place: Distance along the parent's road to where it came near failing, in m.
    """
    length = parent.length
    shares = domain.shares_of(parent.conditions, length)
    way, is_chosen = rng.random(), rng.random(len(shares)) < 0.5
    if way < 0.25:
        i = int(rng.integers(len(shares)))
        shares[i] = _as_if_frequent(domain, i, rng.random())
    elif way < 0.5:
        for i in np.flatnonzero(is_chosen).tolist():
            _change_share(rng, domain, shares, i, _LARGE_DEVIATION)
    elif way < 0.75:
        shares[is_chosen] = domain.shares_of(mate.conditions, length)[is_chosen]
    else:
        _change_share(rng, domain, shares, int(rng.integers(len(shares))), _LARGE_DEVIATION)
        for i, axis in enumerate(domain.axes):
            if axis != SEED and condition_named(axis).place_of:
                start = place + rng.normal(-_MEAN_LEAD, _LEAD_DEVIATION)
                shares[i] = min(max(start / length, 0.0), 1.0)
    return domain.at(shares, length)


def moved_along(conditions: Mapping[str, float], distance: float) -> dict[str, float]:
    """Return conditions whose stretches of road begin `distance` m later.

    A condition whose stretch would begin before the road's start is left out.
    """
    moved = dict(conditions)
    for name in conditions:
        if name != SEED and (condition := condition_named(name).place_of):
            moved[name] = conditions[name] + distance
            if moved[name] < 0.0:
                moved = without(moved, condition)
    return moved


def _as_if_frequent(domain: Domain, i: int, share: float) -> float:
    """Return the share of an axis such that half of the drives have the condition, if few do.

    Args:
        domain: The domain.
        i: Index of the axis.
        share: A share of the drives, uniform in 0..1. The drives without the condition come first.
    """
    axis = domain.axes[i]
    chance = domain.conditions[axis].chance if axis in domain.conditions else 1.0
    if chance >= 0.5:
        return share
    return 2.0 * share * (1.0 - chance) if share < 0.5 else 1.0 - 2.0 * (1.0 - share) * chance


def _change_share(
    rng: np.random.Generator, domain: Domain, shares: FloatArray, i: int, deviation: float
) -> None:
    """Change one share in place; a drive without a condition stays without it.

    Args:
        rng: Generator that draws the change.
        domain: The domain.
        shares: Share on each axis, (axes,).
        i: Index of the axis.
        deviation: Standard deviation of the change, as a share of the drives with the condition.
    """
    axis = domain.axes[i]
    # Up to this share, drives do not have the condition.
    least = 1.0 - domain.conditions[axis].chance if axis in domain.conditions else 0.0
    if shares[i] < least:
        return
    moved = shares[i] + (1.0 - least) * rng.normal(0.0, deviation)
    shares[i] = min(max(moved, least), 1.0)
