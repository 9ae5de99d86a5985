"""The budget of a campaign."""

from __future__ import annotations

from dataclasses import dataclass

from frenetic._support.bounds import is_number, require_count
from frenetic._support.scalars import take_numpy_scalars
from frenetic._support.words import counted, format_duration


@dataclass(frozen=True)
class Budget:
    """The budget of a campaign. Only drives cost simulations; INVALID roads are free.

    Raises:
        ValueError: nothing is limited, or a limit is not positive.
    """

    simulations: int | None = None
    """Number of drives."""
    time: float | None = None
    """Wall time, in s."""
    failures: int | None = None
    """Number of FAIL outcomes wanted."""

    def __post_init__(self) -> None:
        if self.simulations is None and self.time is None and self.failures is None:
            raise ValueError(
                "the budget limits nothing: simulations, time or failures has to be given"
            )
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
            is_short = self.time < 60.0
            text = f"{self.time:.3g} s" if is_short else format_duration(self.time)
            texts.append(f"{text} of time")
        if self.failures is not None:
            texts.append(counted(self.failures, "failure"))
        return ", ".join(texts)

    def spent(self, simulations: int, seconds: float, failures: int) -> float:
        """Return the spent share of the budget, 0..1: the largest share of a limit."""
        shares = [0.0]
        if self.simulations is not None:
            shares.append(simulations / self.simulations)
        if self.time is not None:
            shares.append(seconds / self.time)
        if self.failures is not None:
            shares.append(failures / self.failures)
        return min(max(shares), 1.0)
