"""Conditions of drives and their ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from frenetic._support.bounds import Index, check, require_count
from frenetic._support.scalars import take_numpy_scalars
from frenetic.conditions.condition import SEED, SPEED, quantities, quantity
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.search.records import Candidate
from frenetic.simulators.conditions import Conditions, check_can_vary, own_amount
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True)
class Variation:
    """A quantity of the world and the range from which it is drawn evenly.

    Raises:
        FreneticError: no such quantity, or a range that is none or beyond what is allowed.
    """

    quantity: str
    """Name in `frenetic.conditions`."""
    low: float
    high: float
    """Equal to `low` if the quantity is only set, not varied."""
    is_usual: bool = field(default=False, compare=False)
    """Whether it is the usual range around the campaign's amount, and around a test's own amount
    where that has one."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        row = quantity(self.quantity)
        if not row.low <= self.low <= self.high <= row.high:
            raise FreneticError(
                f"cannot vary {self.quantity} from {self.low:g} to {self.high:g}: a range LOW:HIGH"
                f" within {row.allowed} is needed"
            )

    @classmethod
    def usual(cls, name: str, simulator: Simulator, own: float | None = None) -> Variation:
        """The usual range of a quantity around a campaign's own amount, see `frenetic.conditions`.

        Args:
            name: of the quantity.
            simulator: the campaign's, with its amount of what is no layer over the driver.
            own: the amount among the campaign's conditions; None if it is not there.

        Raises:
            FreneticError: no such quantity, or the simulator has none.
        """
        row = quantity(name)
        check_can_vary(simulator, [name])
        if row.attribute and own is None:
            own = own_amount(simulator, name)
        return cls(name, *row.around(own), is_usual=True)

    def of(self, own: Conditions) -> Variation:
        """The variation for a test with these conditions."""
        if not self.is_usual or self.quantity not in own:
            return self
        low, high = quantity(self.quantity).around(own[self.quantity])
        return replace(self, low=low, high=high)

    @property
    def is_fixed(self) -> bool:
        """Whether the quantity is only set, not varied."""
        return self.low == self.high

    def __str__(self) -> str:
        unit = quantity(self.quantity).unit
        text = f"{self.low:.3g}" if self.is_fixed else f"{self.low:.3g} to {self.high:.3g}"
        return f"{self.quantity} {text}{' ' if unit else ''}{unit}"


def own_conditions(road: Candidate, rules: Rules) -> Conditions:
    """The conditions of a test, with its road's highest speed limit if the road has limits."""
    if road.speed_limits is None or not len(road.speed_limits) or rules.road_limits == "ignored":
        return road.conditions
    return {SPEED: float(rules.speed_limits_on(road)[:, 1].max()), **road.conditions}


def draw_conditions(
    variations: Sequence[Variation], times: int, seed: Index
) -> tuple[Conditions, ...]:
    """Conditions with quantities drawn from their ranges.

    They are a Latin hypercube: the range of each quantity is cut into ``times`` equal parts and
    gives one value from each. So the conditions cover the ranges evenly, and the interval of a
    share is, if anything, too wide. With noise, each drive has its own errors.

    Raises:
        ValueError: ``times`` is no positive whole number, the seed none from 0 to 2⁶³ - 1, or a
            quantity is there twice.
    """
    times = require_count("times", times)
    check({"seed": seed}, draw_conditions)
    table, names = list(quantities()), [variation.quantity for variation in variations]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is varied twice: give one range for it")
    rng = np.random.default_rng(seed)
    drawn: list[dict[str, float]] = [{} for _ in range(times)]
    # In a fixed order, independent of the given one.
    for variation in sorted(variations, key=lambda v: table.index(v.quantity)):
        shares = (rng.permutation(times) + rng.random(times)) / times
        values = variation.low + (variation.high - variation.low) * shares
        is_seeded = quantity(variation.quantity).is_seeded
        for conditions, value in zip(drawn, values.tolist(), strict=True):
            conditions[variation.quantity] = value
            if is_seeded:
                conditions[SEED] = int(rng.integers(2**31))
    return tuple(drawn)
