"""Ranges of conditions, and the conditions of drives, drawn from the ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from frenetic._support.bounds import Index, check, require_count
from frenetic._support.scalars import take_numpy_scalars
from frenetic.conditions.condition import SEED, SPEED, condition_named, known_conditions
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.search.records import Candidate
from frenetic.simulators.conditions import Conditions, check_can_vary, own_amount
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True)
class Variation:
    """Condition of a drive, and the range from which its amount is drawn, all alike probable.

    Raises:
        FreneticError: the condition is unknown, or the range is reversed or not allowed.
    """

    condition: str
    """Name of the condition in `frenetic.conditions`."""
    low: float
    """Lower end of the range, in the condition's unit."""
    high: float
    """Upper end of the range; equal to `low` if the condition is only set, not varied."""
    is_usual: bool = field(default=False, compare=False)
    """Whether the range is the usual range around the campaign's amount. For a test that recorded
    an amount, `of` returns the usual range around that amount."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        condition = condition_named(self.condition)
        if not condition.low <= self.low <= self.high <= condition.high:
            raise FreneticError(
                f"cannot vary {self.condition} from {self.low:g} to {self.high:g}: a range LOW:HIGH"
                f" within {condition.allowed} is needed"
            )

    @classmethod
    def usual(cls, name: str, simulator: Simulator, amount: float | None = None) -> Variation:
        """Return the usual range around a campaign's amount, see `frenetic.conditions`.

        Args:
            name: name of the condition.
            simulator: the campaign's simulator, whose attribute may hold the amount.
            amount: amount among the campaign's conditions; None if the campaign does not set it.

        Raises:
            FreneticError: the condition is unknown, or the simulator cannot vary it.
        """
        condition = condition_named(name)
        check_can_vary(simulator, [name])
        if condition.attribute and amount is None:
            amount = own_amount(simulator, name)
        return cls(name, *condition.around(amount), is_usual=True)

    def of(self, conditions: Conditions) -> Variation:
        """Return the variation for a test with these recorded conditions."""
        if not self.is_usual or self.condition not in conditions:
            return self
        low, high = condition_named(self.condition).around(conditions[self.condition])
        return replace(self, low=low, high=high)

    @property
    def is_fixed(self) -> bool:
        """Whether the condition is only set, not varied."""
        return self.low == self.high

    def __str__(self) -> str:
        unit = condition_named(self.condition).unit
        text = f"{self.low:.3g}" if self.is_fixed else f"{self.low:.3g} to {self.high:.3g}"
        return f"{self.condition} {text}{' ' if unit else ''}{unit}"


def recorded_conditions(road: Candidate, rules: Rules) -> Conditions:
    """Return the conditions that a road was driven in.

    They include a speed limit, the highest one of the road, if the road has limits.
    """
    if road.speed_limits is None or not len(road.speed_limits) or rules.road_limits == "ignored":
        return road.conditions
    return {SPEED: float(rules.speed_limits_on(road)[:, 1].max()), **road.conditions}


def draw_conditions(
    variations: Sequence[Variation], times: int, seed: Index
) -> tuple[Conditions, ...]:
    """Draw the conditions of several drives from ranges, as a Latin hypercube.

    The range of each condition is cut into as many equal parts as there are drives, and each drive
    gets a value of another part. So the conditions cover the ranges evenly, and the interval of a
    share of drives is rather too wide than too narrow. A seeded condition such as noise gets
    another seed in each drive.

    Args:
        variations: conditions and their ranges.
        times: number of drives.
        seed: seed of the draws.

    Raises:
        ValueError: ``times`` is not a positive whole number, the seed is not a whole number from 0
            to 2⁶³ - 1, or two variations have the same condition.
    """
    times = require_count("times", times)
    check({"seed": seed}, draw_conditions)
    names = [variation.condition for variation in variations]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is varied twice: give one range for it")
    rng = np.random.default_rng(seed)
    drawn: list[dict[str, float]] = [{} for _ in range(times)]
    # A fixed order, so that the order of the variations does not change the draws.
    order = list(known_conditions())
    for variation in sorted(variations, key=lambda v: order.index(v.condition)):
        shares = (rng.permutation(times) + rng.random(times)) / times
        values = variation.low + (variation.high - variation.low) * shares
        is_seeded = condition_named(variation.condition).is_seeded
        for conditions, value in zip(drawn, values.tolist(), strict=True):
            conditions[variation.condition] = value
            if is_seeded:
                conditions[SEED] = int(rng.integers(2**31))
    return tuple(drawn)
