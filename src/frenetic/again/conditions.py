"""Conditions of drives and their ranges, also as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from msgspec import convert

from frenetic._support.scalars import take_numpy_scalars
from frenetic.errors import FreneticError
from frenetic.search.strategy import require_whole
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import QUANTITIES, SEEDED, USUAL, Conditions, check_can_vary
from frenetic.spec import require_count


@dataclass(frozen=True)
class Variation:
    """A quantity of the world and the range from which it is drawn evenly.

    Raises:
        FreneticError: no such quantity, or a range that is none or beyond what is allowed.
    """

    quantity: str
    """Name in `frenetic.simulators.worlds.QUANTITIES`."""
    low: float
    high: float
    """Equal to `low` if the quantity is only set, not varied."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        if self.quantity not in QUANTITIES:
            raise FreneticError(
                f"cannot vary {self.quantity!r}: choose from {', '.join(QUANTITIES)}"
            )
        allowed = QUANTITIES[self.quantity]
        if not allowed.low <= self.low <= self.high <= allowed.high:
            unit = f" {allowed.unit}" if allowed.unit else ""
            raise FreneticError(
                f"cannot vary {self.quantity} from {self.low:g} to {self.high:g}: a range LOW:HIGH"
                f" within {allowed.low:.3g} to {allowed.high:.3g}{unit} is needed"
            )

    @classmethod
    def usual(cls, quantity: str, simulator: Simulator) -> Variation:
        """The default range of a quantity.

        Friction is up to a fifth less than the simulator's, the speed limit a tenth less or more;
        noise is up to 0.2 m, delay up to 0.1 s, the start within 0.3 m and 0.03 rad. What a camera
        sees varies from any scene and little wear to thick fog and dusk, see ``_USUAL``.

        Raises:
            FreneticError: no such quantity, or the simulator has none.
        """
        if quantity in QUANTITIES:
            check_can_vary(simulator, [quantity])
        match quantity:
            case "friction":
                friction: float = simulator.friction  # type: ignore[attr-defined]
                return cls(quantity, 0.8 * friction, friction)
            case "speed":
                limit = simulator.rules.speed_limit
                return cls(quantity, 0.9 * limit, 1.1 * limit)
        return cls(quantity, *_USUAL.get(quantity, (0.0, 0.0)))

    @classmethod
    def read(cls, item: Any) -> Variation:
        """A variation from JSON.

        Raises:
            ValueError: it is none.
        """
        try:
            return convert(item, cls)
        except FreneticError as error:
            raise ValueError(str(error)) from None

    @property
    def is_fixed(self) -> bool:
        """Whether the quantity is only set, not varied."""
        return self.low == self.high

    def __str__(self) -> str:
        unit = QUANTITIES[self.quantity].unit
        text = f"{self.low:.3g}" if self.is_fixed else f"{self.low:.3g} to {self.high:.3g}"
        return f"{self.quantity} {text}{' ' if unit else ''}{unit}"


_USUAL: Final[Mapping[str, tuple[float, float]]] = {
    "noise": (0.0, 0.2),
    "delay": (0.0, 0.1),
    "start": (-0.3, 0.3),
    "heading": (-0.03, 0.03),
    "scene": (0.0, 1000.0),
    "wear": (0.0, 0.8),
    "fog": (30.0, 300.0),
    "rain": (0.0, 20.0),
    "blur": (0.0, 0.05),
    "light": (0.4, 1.6),
    "grain": (0.0, 20.0),
}


def draw_conditions(
    variations: Sequence[Variation], times: int, seed: int
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
    seed = require_whole("seed", seed, 0, 2**63 - 1)
    names = [variation.quantity for variation in variations]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is varied twice: give one range for it")
    rng = np.random.default_rng(seed)
    drawn = [USUAL] * times
    # In a fixed order, independent of the given one.
    for variation in sorted(variations, key=lambda v: list(QUANTITIES).index(v.quantity)):
        shares = (rng.permutation(times) + rng.random(times)) / times
        values = variation.low + (variation.high - variation.low) * shares
        for i, value in enumerate(values.tolist()):
            changes: dict[str, Any] = {variation.quantity: value}
            if variation.quantity in SEEDED:
                changes["noise_seed"] = int(rng.integers(2**31))
            drawn[i] = replace(drawn[i], **changes)
    return tuple(drawn)
