"""The declaration of a condition: name, unit, range, and what sets it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from frenetic._support.entry_points import imported

FARTHEST: Final = 100_000.0
"""Largest amount of a length without upper bound, in m; our choice."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One condition of a drive: name, unit, range, and what sets it."""

    name: str
    about: str
    """Description of the amount, which starts in lower case."""
    unit: str = ""
    """Unit of the amounts; empty without a unit."""
    low: float
    """Least amount allowed."""
    high: float
    """Largest amount allowed."""
    usual: tuple[float, float]
    """Range in which `frenetic.rerun` varies the amount by default."""
    is_relative: bool = False
    """Whether `usual` holds factors of the simulator's own amount, not amounts."""
    no_effect: float | None = None
    """Amount without effect, by which a user removes a recorded condition; None if every amount has
    an effect."""
    wrapper: str = ""
    """``module:Class`` of a wrapper, whose class method ``over(driver, amount)`` returns the driver
    in the condition; empty for an attribute."""
    attribute: str = ""
    """Attribute of a simulator that has the amount; empty for a wrapper."""
    is_seeded: bool = False
    """Whether the wrapper draws random numbers: then ``over`` takes a ``seed``, too."""
    needs_camera: bool = False
    """Whether only a driver with a camera can have the wrapper."""
    place_of: str = ""
    """Name of another condition, such as ``gust``, whose place along the road this amount is, in m;
    empty for other conditions."""
    words: tuple[str, str] | None = None
    """Phrases for a smaller and a larger amount; None for "less" and "more" with the name."""

    @property
    def less(self) -> str:
        """Phrase for a smaller amount, such as "less friction"."""
        return self.words[0] if self.words else f"less {self.name}"

    @property
    def more(self) -> str:
        """Phrase for a larger amount, such as "more friction"."""
        return self.words[1] if self.words else f"more {self.name}"

    def wrapper_class(self) -> Any:
        """Import and return the class of the wrapper."""
        return imported(self.wrapper)

    def require(self, amount: float) -> float:
        """Return the amount as a float, if it is allowed.

        Raises:
            ValueError: the amount is below `low` or above `high`.
        """
        if not self.low <= amount <= self.high:
            raise ValueError(f"{self.name} is {amount:g}: {self.allowed} is needed")
        return float(amount)

    @property
    def allowed(self) -> str:
        """Allowed range in words."""
        unit = f" {self.unit}" if self.unit else ""
        low, high = (float(f"{value:.3g}") for value in (self.low, self.high))
        return f"{low:g} to {high:g}{unit}"

    def around(self, amount: float | None) -> tuple[float, float]:
        """Return the range in which an amount varies by default, within the allowed range.

        Args:
            amount: the campaign's amount. None if the campaign sets no amount: then the range is
                `usual`; this is not allowed where `is_relative`.
        """
        low, high = self.usual
        if self.is_relative:
            assert amount is not None
            low, high = low * amount, high * amount
        elif amount is not None and amount != self.no_effect:
            # As far to either side as the usual range is from no effect; where no effect is at
            # infinity, as of the view, half of the amount.
            no_effect = self.no_effect or 0.0
            spread = (
                0.5 * amount if no_effect == math.inf else max(high - no_effect, no_effect - low)
            )
            low, high = amount - spread, amount + spread
        return max(low, self.low), min(high, self.high)

    def text(self, amount: float) -> str:
        """Return an amount with name and unit."""
        return f"{self.name} {amount:g}{' ' if self.unit else ''}{self.unit}"
