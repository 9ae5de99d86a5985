"""Operational design domains: the roads and conditions in which a driver has to keep its lane.

A TOML file for ``--odd`` describes a domain::

    about = "Town roads in all weather"
    roads = "urban-50,length=500"

    [conditions]
    friction = { low = 0.3, high = 1.0 }
    gust = { low = -20, high = 20, mean = 0, deviation = 6 }
    delay = { low = 0.0, high = 0.2, chance = 0.1 }
    load = 150

`frenetic.conditions` lists names and units. An amount is drawn evenly from its range, or from a
normal distribution cut at its ends; with a ``chance``, only in that share of the drives. A
condition with a place on the road, such as a gust, may be anywhere along the road. Conditions are
independent of each other.
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
"""Number of seeds of noise from which one is drawn; ours."""
_DIGITS: Final = 4
"""Significant digits of a drawn amount; ours."""


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """Distribution of the amounts of one condition over the drives.

    Raises:
        ValueError: a value is out of range.
    """

    low: Finite
    high: Finite
    mean: Finite | None = None
    """Mean of the normal distribution; None for an even distribution."""
    deviation: Positive | None = None
    """Standard deviation of the normal distribution; None for an even distribution."""
    chance: Share = 1.0
    """Share of the drives in which the condition has an amount; the others have the usual one."""

    def __post_init__(self) -> None:
        check(vars(self), Distribution)
        if self.low > self.high:
            raise ValueError(f"low is {self.low:g}: at most high, {self.high:g}, is needed")
        if (self.mean is None) != (self.deviation is None):
            raise ValueError("mean and deviation are needed together")
        if self.chance == 0.0:
            raise ValueError("chance is 0: more is needed")
        if self._ends is not None and self._ends[1] == self._ends[2]:
            raise ValueError(
                f"mean {self.mean:g} and deviation {self.deviation:g} leave nothing from"
                f" {self.low:g} to {self.high:g}: choose others"
            )

    def amount(self, share: float) -> float | None:
        """Return the amount below which a share of the drives is, 0..1; None for the usual one."""
        share = (share - (1.0 - self.chance)) / self.chance
        if share < 0.0:
            return None
        if self._ends is None:
            return self.low + share * (self.high - self.low)
        normal, low, high = self._ends
        quantile = min(max(low + share * (high - low), 1e-300), 1.0 - 1e-16)
        return min(max(normal.inv_cdf(quantile), self.low), self.high)

    def share(self, amount: float | None) -> float:
        """Return the share of the drives below an amount, 0..1; the reverse of `amount`."""
        if amount is None:
            return 0.5 * (1.0 - self.chance)
        if self.low == self.high:
            share = 0.5
        elif self._ends is None:
            share = (amount - self.low) / (self.high - self.low)
        else:
            normal, low, high = self._ends
            share = (normal.cdf(amount) - low) / (high - low)
        return 1.0 - self.chance + self.chance * min(max(share, 0.0), 1.0)

    @cached_property
    def _ends(self) -> tuple[NormalDist, float, float] | None:
        """Normal distribution, and its shares below both ends of the range; None if even."""
        if self.mean is None or self.deviation is None or self.low == self.high:
            return None
        normal = NormalDist(self.mean, self.deviation)
        return normal, normal.cdf(self.low), normal.cdf(self.high)


@dataclass(frozen=True, kw_only=True)
class Domain:
    """An operational design domain.

    A point of the domain is a vector of shares, (`dimension`,), each even from 0 to 1 and
    independent of the others.
    """

    name: str
    about: str = ""
    """Description in a sentence."""
    road_class: RoadClass | None = None
    """Class of the roads; None for the competition's."""
    conditions: Mapping[str, Distribution] = field(default_factory=dict)
    """Name of a condition -> its distribution."""

    def __post_init__(self) -> None:
        for name, amounts in self.conditions.items():
            row = condition_named(name)
            if row.place_of:
                raise ValueError(f"{name} follows from {row.place_of}, and is anywhere on the road")
            if not row.low <= amounts.low <= amounts.high <= row.high:
                raise ValueError(
                    f"{name} is from {amounts.low:g} to {amounts.high:g}: {row.allowed} is needed"
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
            raise FreneticError(f"{path} does not say a domain: {error}") from None

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
            condition_named(key)
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
        for name, amounts in self.conditions.items():
            fields = asdict(amounts).items()
            conditions[name] = {key: value for key, value in fields if value is not None}
        entries: dict[str, Any] = {"name": self.name, "about": self.about}
        if self.road_class is not None:
            entries["roads"] = self.road_class.as_json()
        return entries | {"conditions": conditions}

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of a point's shares: the conditions, then their places, then the seed of noise."""
        names = [name for name in known_conditions() if name in self.conditions]
        places = [
            row.name for row in known_conditions().values() if row.place_of in self.conditions
        ]
        is_seeded = any(condition_named(name).is_seeded for name in names)
        return (*names, *places, *([SEED] if is_seeded else []))

    @property
    def dimension(self) -> int:
        """Number of shares of a point."""
        return len(self.axes)

    def at(self, shares: FloatArray, length: float) -> dict[str, float]:
        """Return the conditions at a point, on a road of a length in m."""
        conditions: dict[str, float] = {}
        for axis, share in zip(self.axes, shares.tolist(), strict=True):
            if axis == SEED:
                if any(condition_named(name).is_seeded for name in conditions):
                    conditions[SEED] = min(int(share * _SEEDS), _SEEDS - 1)
            elif (place_of := condition_named(axis).place_of) != "":
                if place_of in conditions:
                    conditions[axis] = round(share * length, 1)
            elif (amount := self.conditions[axis].amount(share)) is not None:
                amounts = self.conditions[axis]
                amount = min(max(float(f"{amount:.{_DIGITS}g}"), amounts.low), amounts.high)
                if amount != condition_named(axis).nothing:
                    conditions[axis] = amount
        return conditions

    def shares_of(self, conditions: Mapping[str, float], length: float) -> FloatArray:
        """Return the point of conditions on a road of a length in m; the reverse of `at`."""
        shares = np.full(self.dimension, 0.5)
        for i, axis in enumerate(self.axes):
            amount = conditions.get(axis)
            if axis == SEED or condition_named(axis).place_of:
                if amount is not None:
                    shares[i] = amount / (_SEEDS if axis == SEED else max(length, 1.0))
                continue
            amounts = self.conditions[axis]
            if amount is None and amounts.chance == 1.0:
                amount = condition_named(axis).nothing
                amount = None if amount is None or math.isinf(amount) else amount
            shares[i] = amounts.share(amount)
        clipped: FloatArray = np.clip(shares, 0.0, 1.0)
        return clipped

    def all_at_once(self) -> dict[str, float]:
        """Return an amount for every condition of the domain, to check them before any drive."""
        places = {axis: 0.0 for axis in self.axes if axis != SEED}
        return places | {name: amounts.low for name, amounts in self.conditions.items()}

    def as_text(self) -> str:
        """Return the name and the conditions in words."""
        texts = []
        for name, amounts in self.conditions.items():
            row = condition_named(name)
            unit = f" {row.unit}" if row.unit else ""
            text = f"{name} {amounts.low:g} to {amounts.high:g}{unit}"
            if amounts.low == amounts.high:
                text = row.text(amounts.low)
            if amounts.chance < 1.0:
                text += f" in {100.0 * amounts.chance:g} %"
            texts.append(text)
        return f"{self.name}: {', '.join(texts) or 'roads alone'}"
