"""Operational design domains: the roads and conditions in which a driver has to keep its lane.

A TOML file for ``--odd`` describes a domain::

    about = "Town roads in all weather"
    roads = "urban-50,length=500"

    [conditions]
    friction = { low = 0.3, high = 1.0 }
    gust = { low = -20, high = 20, mean = 0, deviation = 6 }
    delay = { low = 0.0, high = 0.2, chance = 0.1 }
    load = 150

`frenetic.conditions` lists names and units. The amount of a condition is drawn evenly from its
range, or, with ``mean`` and ``deviation``, from a normal distribution cut at the ends of the range.
A number, such as 150 here, is the amount in all drives. With a ``chance``, only that share of the
drives has an amount of the condition. A condition with a place on the road, such as a gust, may be
anywhere along the road. Conditions are independent of each other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from statistics import NormalDist
from typing import Any, Final, Self

import numpy as np
from msgspec import ValidationError, convert

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, Positive, Share, check
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_toml
from frenetic.conditions.condition import SEED, condition_named, known_conditions
from frenetic.errors import FreneticError
from frenetic.road.classes import RoadClass, class_of

_SEEDS: Final = 2**31
"""Number of seeds from which the seed of noise is drawn; our choice."""
_DIGITS: Final = 4
"""Significant digits of a drawn amount; our choice."""


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """Distribution of the amount of one condition over the drives.

    Raises:
        ValueError: a value is out of range.
    """

    low: Finite
    """Least amount."""
    high: Finite
    """Largest amount."""
    mean: Finite | None = None
    """Mean of the normal distribution before it is cut; None for an even distribution."""
    deviation: Positive | None = None
    """Standard deviation of the normal distribution before it is cut; None for an even
    distribution."""
    chance: Share = 1.0
    """Share of the drives that have an amount of the condition; the other drives are without it."""

    def __post_init__(self) -> None:
        check(vars(self), Distribution)
        if self.low > self.high:
            raise ValueError(f"low is {self.low:g}: at most high, {self.high:g}, is needed")
        if (self.mean is None) != (self.deviation is None):
            raise ValueError("mean and deviation are needed together")
        if self.chance == 0.0:
            raise ValueError("chance is 0: more is needed")
        if self._cut_normal is not None:
            _, below_low, below_high = self._cut_normal
            if below_low == below_high:
                raise ValueError(
                    f"mean {self.mean:g} and deviation {self.deviation:g} leave nothing from"
                    f" {self.low:g} to {self.high:g}: choose others"
                )

    def amount(self, share: float) -> float | None:
        """Return the amount below which this share of the drives lies (the quantile function).

        Args:
            share: share of the drives, 0..1. Drives without the condition lie below all amounts.

        Returns:
            The amount; None for a drive without the condition.
        """
        share = (share - (1.0 - self.chance)) / self.chance
        if share < 0.0:
            return None
        if self._cut_normal is None:
            return self.low + share * (self.high - self.low)
        normal, below_low, below_high = self._cut_normal
        # The quantile function of a normal distribution is infinite at 0 and 1.
        quantile = min(max(below_low + share * (below_high - below_low), 1e-300), 1.0 - 1e-16)
        return min(max(normal.inv_cdf(quantile), self.low), self.high)

    def share(self, amount: float | None) -> float:
        """Return the share of the drives below an amount, 0..1: the inverse of `amount`.

        Where many shares have the same amount, or no amount, their middle is returned.
        """
        if amount is None:
            return 0.5 * (1.0 - self.chance)
        if self.low == self.high:
            share = 0.5
        elif self._cut_normal is None:
            share = (amount - self.low) / (self.high - self.low)
        else:
            normal, below_low, below_high = self._cut_normal
            share = (normal.cdf(amount) - below_low) / (below_high - below_low)
        return 1.0 - self.chance + self.chance * min(max(share, 0.0), 1.0)

    @cached_property
    def _cut_normal(self) -> tuple[NormalDist, float, float] | None:
        """Normal distribution and its shares below `low` and below `high`; None if even."""
        if self.mean is None or self.deviation is None or self.low == self.high:
            return None
        normal = NormalDist(self.mean, self.deviation)
        return normal, normal.cdf(self.low), normal.cdf(self.high)


@dataclass(frozen=True, kw_only=True)
class Domain:
    """An operational design domain.

    A point of the domain stands for the conditions of one drive. It is a vector of shares,
    (`dimension`,), with one share for each of `axes`: the share of the drives with less of the
    condition. Over the domain, each share is even from 0 to 1 and independent of the others.
    """

    name: str
    about: str = ""
    """Description in a sentence."""
    road_class: RoadClass | None = None
    """Class of the roads; None for roads by the competition's rules."""
    conditions: Mapping[str, Distribution] = field(default_factory=dict)
    """Name of a condition -> its distribution."""

    def __post_init__(self) -> None:
        for name, distribution in self.conditions.items():
            condition = condition_named(name)
            if condition.place_of:
                raise ValueError(
                    f"{name} follows from {condition.place_of}, and is anywhere on the road"
                )
            low, high = distribution.low, distribution.high
            if not condition.low <= low <= high <= condition.high:
                raise ValueError(
                    f"{name} is from {low:g} to {high:g}: {condition.allowed} is needed"
                )

    @classmethod
    def of(cls, path: Path | str) -> Self:
        """Return the domain of a file.

        Raises:
            FreneticError: the file cannot be read, or an entry of it is not valid; the message
                names the entry.
        """
        path = Path(path)
        data = read_bounded(path)
        try:
            entries = read_toml(data)
        except ValueError as error:
            raise FreneticError(f"{path} is no TOML file: {error}") from None
        try:
            return cls.from_entries(path.stem, entries)
        except (ValueError, FreneticError) as error:
            raise FreneticError(f"{path} describes no domain: {error}") from None

    @classmethod
    def from_entries(cls, name: str, entries: Mapping[str, Any]) -> Self:
        """Return the domain of a file's entries.

        Raises:
            ValueError: an entry is unknown, or a value is out of range.
            FreneticError: no condition or road class has a name in the entries.
        """
        names = {"name", "about", "roads", "conditions"}
        if unknown := sorted(entries.keys() - names):
            raise ValueError(f"there is no entry {unknown[0]}: about, roads and conditions are")
        conditions, roads = entries.get("conditions", {}), entries.get("roads")
        if not isinstance(conditions, Mapping):
            raise ValueError("conditions are names with distributions")
        distributions = {}
        for key, entry in conditions.items():
            condition_named(key)  # raises an error if there is no such condition
            fields = entry if isinstance(entry, Mapping) else {"low": entry, "high": entry}
            try:
                distributions[key] = convert(fields, Distribution)
            except (ValidationError, ValueError) as error:
                raise ValueError(f"{key}: {error}") from None
        return cls(
            name=str(entries.get("name", name)),
            about=str(entries.get("about", "")),
            road_class=None if roads is None else class_of(roads),
            conditions=distributions,
        )

    def entries(self) -> dict[str, Any]:
        """Return the entries of a file, as `from_entries` takes them."""
        conditions: dict[str, Any] = {}
        for name, distribution in self.conditions.items():
            fields = asdict(distribution).items()
            conditions[name] = {key: value for key, value in fields if value is not None}
        entries: dict[str, Any] = {"name": self.name, "about": self.about}
        if self.road_class is not None:
            entries["roads"] = self.road_class.as_json()
        return entries | {"conditions": conditions}

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of a point's shares: the conditions, their places, and the seed of noise."""
        known = known_conditions()
        names = [name for name in known if name in self.conditions]
        places = [
            condition.name for condition in known.values() if condition.place_of in self.conditions
        ]
        is_seeded = any(condition_named(name).is_seeded for name in names)
        return (*names, *places, *([SEED] if is_seeded else []))

    @property
    def dimension(self) -> int:
        """Number of shares of a point."""
        return len(self.axes)

    def at(self, shares: FloatArray, length: float) -> dict[str, float]:
        """Return the conditions of the drive at a point.

        Args:
            shares: the point, (`dimension`,).
            length: length of the road, in m.

        Returns:
            Name of a condition -> its amount, without amounts that have no effect.
        """
        conditions: dict[str, float] = {}
        for axis, share in zip(self.axes, shares.tolist(), strict=True):
            if axis == SEED:
                if any(condition_named(name).is_seeded for name in conditions):
                    conditions[SEED] = min(int(share * _SEEDS), _SEEDS - 1)
            elif (place_of := condition_named(axis).place_of) != "":
                if place_of in conditions:
                    conditions[axis] = round(share * length, 1)
            elif (amount := self.conditions[axis].amount(share)) is not None:
                distribution = self.conditions[axis]
                rounded = float(f"{amount:.{_DIGITS}g}")
                amount = min(max(rounded, distribution.low), distribution.high)
                if amount != condition_named(axis).no_effect:
                    conditions[axis] = amount
        return conditions

    def shares_of(self, conditions: Mapping[str, float], length: float) -> FloatArray:
        """Return the point, (`dimension`,), of the conditions of a drive: the inverse of `at`.

        Args:
            conditions: name of a condition -> its amount.
            length: length of the road, in m.
        """
        shares = np.full(self.dimension, 0.5)
        for i, axis in enumerate(self.axes):
            amount = conditions.get(axis)
            if axis == SEED or condition_named(axis).place_of:
                if amount is not None:
                    shares[i] = amount / (_SEEDS if axis == SEED else max(length, 1.0))
                continue
            distribution = self.conditions[axis]
            if amount is None and distribution.chance == 1.0:
                # All drives have an amount: a missing amount is the one without effect.
                amount = condition_named(axis).no_effect
                amount = None if amount is None or math.isinf(amount) else amount
            shares[i] = distribution.share(amount)
        clipped: FloatArray = np.clip(shares, 0.0, 1.0)
        return clipped

    def all_at_once(self) -> dict[str, float]:
        """Return an amount for every condition of the domain, to check them before any drive."""
        amounts = {axis: 0.0 for axis in self.axes if axis != SEED}
        amounts |= {name: distribution.low for name, distribution in self.conditions.items()}
        return amounts

    def as_text(self) -> str:
        """Return the name and the conditions in words."""
        texts = []
        for name, distribution in self.conditions.items():
            condition = condition_named(name)
            unit = f" {condition.unit}" if condition.unit else ""
            text = f"{name} {distribution.low:g} to {distribution.high:g}{unit}"
            if distribution.low == distribution.high:
                text = condition.text(distribution.low)
            if distribution.chance < 1.0:
                text += f" in {100.0 * distribution.chance:g} %"
            texts.append(text)
        return f"{self.name}: {', '.join(texts) or 'roads alone'}"
