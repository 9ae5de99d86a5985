"""The budget of a campaign: limits of which the first that is reached ends it."""

from __future__ import annotations

from dataclasses import dataclass

from frenetic._support.bounds import is_number, require_count
from frenetic._support.scalars import take_numpy_scalars
from frenetic._support.words import counted, format_duration


@dataclass(frozen=True)
class Budget:
    """The limits of a campaign; the first that is reached ends it.

    Only drives count as simulations; INVALID roads are free.

    Raises:
        ValueError: nothing is limited, or a limit is not positive.
    """

    simulations: int | None = None
    """Largest number of drives; None without this limit."""
    time: float | None = None
    """Largest wall time, in s; None without this limit."""
    failures: int | None = None
    """Number of FAIL outcomes that ends the campaign; None without this limit."""

    def __post_init__(self) -> None:
        if self.simulations is None and self.time is None and self.failures is None:
            raise ValueError("the budget limits nothing: give simulations, time or failures")
        for name in ("simulations", "failures"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, require_count(name, value))
        if self.time is not None and not (is_number(self.time) and self.time > 0.0):
            raise ValueError(f"time is {self.time}: a positive number of seconds is needed")
        take_numpy_scalars(self)

    def __str__(self) -> str:
        """Return the limits with their units, such as "60 simulations, 17.2 s of time"."""
        texts = []
        if self.simulations is not None:
            texts.append(counted(self.simulations, "simulation"))
        if self.time is not None:
            is_below_a_minute = self.time < 60.0
            text = f"{self.time:.3g} s" if is_below_a_minute else format_duration(self.time)
            texts.append(f"{text} of time")
        if self.failures is not None:
            texts.append(counted(self.failures, "failure"))
        return ", ".join(texts)

    def spent(self, simulations: int, seconds: float, failures: int) -> float:
        """Return the spent share of the budget, from 0 to 1: the share of the nearest limit.

        Args:
            simulations: number of drives so far.
            seconds: wall time so far, in s.
            failures: number of FAIL outcomes so far.
        """
        shares = [0.0]
        if self.simulations is not None:
            shares.append(simulations / self.simulations)
        if self.time is not None:
            shares.append(seconds / self.time)
        if self.failures is not None:
            shares.append(failures / self.failures)
        return min(max(shares), 1.0)
