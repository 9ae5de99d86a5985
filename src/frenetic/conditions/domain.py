"""Operational design domains: on which roads and in which conditions a driver has to keep its lane.

A file says it, for ``--odd``::

    about = "Town roads in all weather"
    roads = "urban-50,length=500"

    [conditions]
    friction = { low = 0.3, high = 1.0 }
    gust = { low = -20, high = 20, mean = 0, deviation = 6 }
    delay = { low = 0.0, high = 0.2, chance = 0.1 }
    load = 150

Names and units are those of `frenetic.conditions`. An amount is drawn evenly from its range, or
from a normal distribution cut at its ends; with a ``chance``, only in that share of the drives.
What is placed on the road, such as a gust, is so anywhere along it. Quantities are independent of
each other.
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
from frenetic.conditions.condition import SEED, quantities, quantity
from frenetic.errors import FreneticError
from frenetic.road.classes import RoadClass, class_of

_SEEDS: Final = 2**31
_DIGITS: Final = 4
"""Significant digits of an amount that is drawn."""


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """How often a quantity has which amount.

    Raises:
        ValueError: a value is out of range.
    """

    low: Finite
    high: Finite
    mean: Finite | None = None
    """Of the normal distribution; None for an even one."""
    deviation: Positive | None = None
    """Its standard deviation."""
    chance: Share = 1.0
    """Share of the drives in which it has an amount at all; else it is as usual."""

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
        """The amount below which a share of the drives is, 0..1; None for the usual one."""
        share = (share - (1.0 - self.chance)) / self.chance
        if share < 0.0:
            return None
        if self._ends is None:
            return self.low + share * (self.high - self.low)
        normal, low, high = self._ends
        at = min(max(low + share * (high - low), 1e-300), 1.0 - 1e-16)
        return min(max(normal.inv_cdf(at), self.low), self.high)

    def share(self, amount: float | None) -> float:
        """The share of the drives below an amount, 0..1; the reverse of `amount`."""
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
        """The normal distribution, and its shares below both ends of the range."""
        if self.mean is None or self.deviation is None or self.low == self.high:
            return None
        normal = NormalDist(self.mean, self.deviation)
        return normal, normal.cdf(self.low), normal.cdf(self.high)


@dataclass(frozen=True, kw_only=True)
class Domain:
    """An operational design domain.

    A point of it is a vector of shares, (`dimension`,) from 0 to 1, which are even and independent.
    """

    name: str
    about: str = ""
    """What it is, in a sentence."""
    road_class: RoadClass | None = None
    """Class of its roads; None for the competition's."""
    conditions: Mapping[str, Distribution] = field(default_factory=dict)
    """Name of a quantity -> its distribution."""

    def __post_init__(self) -> None:
        for name, found in self.conditions.items():
            row = quantity(name)
            if row.place_of:
                raise ValueError(f"{name} follows from {row.place_of}, and is anywhere on the road")
            if not row.low <= found.low <= found.high <= row.high:
                raise ValueError(
                    f"{name} is from {found.low:g} to {found.high:g}: {row.allowed} is needed"
                )

    @classmethod
    def of(cls, path: Path | str) -> Self:
        """The domain of a file.

        Raises:
            FreneticError: there is no such file, or it is wrong; the message names the place.
        """
        path = Path(path)
        data = read_bounded(path)
        try:
            entries = read_toml(data)
        except ValueError as error:
            raise FreneticError(f"{path} is no TOML file: {error}") from None
        try:
            return cls.made(path.stem, entries)
        except (ValueError, FreneticError) as error:
            raise FreneticError(f"{path} does not say a domain: {error}") from None

    @classmethod
    def made(cls, name: str, entries: Mapping[str, Any]) -> Self:
        """The domain of a file's entries.

        Raises:
            ValueError: one is wrong.
            FreneticError: there is no such quantity or road class.
        """
        names = {"name", "about", "roads", "conditions"}
        if unknown := sorted(entries.keys() - names):
            raise ValueError(f"there is no entry {unknown[0]}: about, roads and conditions are")
        conditions, roads = entries.get("conditions", {}), entries.get("roads")
        if not isinstance(conditions, Mapping):
            raise ValueError("conditions are names with distributions")
        found = {}
        for key, entry in conditions.items():
            quantity(key)
            fixed = {"low": entry, "high": entry}
            try:
                found[key] = convert(entry if isinstance(entry, Mapping) else fixed, Distribution)
            except (ValidationError, ValueError) as error:
                raise ValueError(f"{key}: {error}") from None
        return cls(
            name=str(entries.get("name", name)),
            about=str(entries.get("about", "")),
            road_class=None if roads is None else class_of(roads),
            conditions=found,
        )

    def entries(self) -> dict[str, Any]:
        """The entries of its file."""
        conditions: dict[str, Any] = {}
        for name, found in self.conditions.items():
            told = asdict(found).items()
            conditions[name] = {key: value for key, value in told if value is not None}
        entries: dict[str, Any] = {"name": self.name, "about": self.about}
        if self.road_class is not None:
            entries["roads"] = self.road_class.as_json()
        return entries | {"conditions": conditions}

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """What each share is of: the quantities, then their places, then the seed of noise."""
        names = [name for name in quantities() if name in self.conditions]
        places = [row.name for row in quantities().values() if row.place_of in self.conditions]
        is_seeded = any(quantity(name).is_seeded for name in names)
        return (*names, *places, *([SEED] if is_seeded else []))

    @property
    def dimension(self) -> int:
        """Number of shares of a point."""
        return len(self.axes)

    def at(self, shares: FloatArray, length: float) -> dict[str, float]:
        """The conditions at a point, on a road of a length in m."""
        found: dict[str, float] = {}
        for axis, share in zip(self.axes, shares.tolist(), strict=True):
            if axis == SEED:
                if any(quantity(name).is_seeded for name in found):
                    found[SEED] = min(int(share * _SEEDS), _SEEDS - 1)
            elif (place_of := quantity(axis).place_of) != "":
                if place_of in found:
                    found[axis] = round(share * length, 1)
            elif (amount := self.conditions[axis].amount(share)) is not None:
                row, of = quantity(axis), self.conditions[axis]
                amount = min(max(float(f"{amount:.{_DIGITS}g}"), of.low), of.high)
                if amount != row.nothing:
                    found[axis] = amount
        return found

    def shares_of(self, conditions: Mapping[str, float], length: float) -> FloatArray:
        """The point of some conditions on a road of a length in m; the reverse of `at`."""
        shares = np.full(self.dimension, 0.5)
        for i, axis in enumerate(self.axes):
            amount = conditions.get(axis)
            if axis == SEED or quantity(axis).place_of:
                if amount is not None:
                    shares[i] = amount / (_SEEDS if axis == SEED else max(length, 1.0))
                continue
            of = self.conditions[axis]
            if amount is None and of.chance == 1.0:
                amount = quantity(axis).nothing
                amount = None if amount is None or math.isinf(amount) else amount
            shares[i] = of.share(amount)
        clipped: FloatArray = np.clip(shares, 0.0, 1.0)
        return clipped

    def all_at_once(self) -> dict[str, float]:
        """Conditions with every quantity of it, to be checked before anything is driven."""
        places = {axis: 0.0 for axis in self.axes if axis != SEED}
        return places | {name: found.low for name, found in self.conditions.items()}

    def in_words(self) -> str:
        """Its conditions for people."""
        texts = []
        for name, found in self.conditions.items():
            unit = f" {row.unit}" if (row := quantity(name)).unit else ""
            text = f"{name} {found.low:g} to {found.high:g}{unit}"
            if found.low == found.high:
                text = row.text(found.low)
            if found.chance < 1.0:
                text += f" in {100.0 * found.chance:g} %"
            texts.append(text)
        return f"{self.name}: {', '.join(texts) or 'roads alone'}"
