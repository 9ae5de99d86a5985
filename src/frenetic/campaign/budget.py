"""A campaign's budget: simulations, wall time or failures wanted; the first spent ends it."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Budget:
    """How much a campaign may spend. Only drives cost simulations; INVALID roads are free.

    Raises:
        ValueError: nothing is limited, or a limit is not positive.
    """

    simulations: int | None = None
    """Drives."""
    time: float | None = None
    """s of wall time."""
    failures: int | None = None
    """FAIL outcomes wanted."""

    def __post_init__(self) -> None:
        if self.simulations is None and self.time is None and self.failures is None:
            raise ValueError(
                "the budget limits nothing: simulations, time or failures has to be given"
            )
        for name in ("simulations", "failures"):
            value = getattr(self, name)
            if value is None:
                continue
            if isinstance(value, bool) or value != int(value) or value < 1:
                raise ValueError(f"{name} is {value}: a whole number of at least 1 is needed")
        if self.time is not None and not (math.isfinite(self.time) and self.time > 0.0):
            raise ValueError(f"time is {self.time}: a positive number of seconds is needed")

    def spent(self, simulations: int, seconds: float, failures: int) -> float:
        """Share of the budget that is spent, 0..1: that of the limit which is nearest."""
        shares = [0.0]
        if self.simulations is not None:
            shares.append(simulations / self.simulations)
        if self.time is not None:
            shares.append(seconds / self.time)
        if self.failures is not None:
            shares.append(failures / self.failures)
        return min(max(shares), 1.0)
