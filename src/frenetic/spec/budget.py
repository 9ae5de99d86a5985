"""The budget of a campaign: limits of which the first that is reached ends it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Final

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
    kilometres: float | None = None
    """Length of road that may be driven, in km: of each drive from the road's start to where the
    drive ended. None without this limit."""
    simulated_time: float | None = None
    """Largest simulated time of all drives together, in s; None without this limit."""

    def __post_init__(self) -> None:
        limits = {name: value for name, value in vars(self).items() if value is not None}
        if not limits:
            raise ValueError(
                "the budget limits nothing: give simulations, time, failures, kilometres or"
                " simulated_time"
            )
        for name, limit in limits.items():
            if name in ("simulations", "failures"):
                object.__setattr__(self, name, require_count(name, limit))
            elif not (is_number(limit) and limit > 0.0):
                unit = "kilometres" if name == "kilometres" else "seconds"
                raise ValueError(f"{name} is {limit}: a positive number of {unit} is needed")
        take_numpy_scalars(self)

    def __str__(self) -> str:
        """Return the limits with their units, such as "60 simulations, 17.2 s of time"."""
        texts = []
        if self.simulations is not None:
            texts.append(counted(self.simulations, "simulation"))
        if self.time is not None:
            texts.append(f"{_time_text(self.time)} of time")
        if self.failures is not None:
            texts.append(counted(self.failures, "failure"))
        if self.kilometres is not None:
            texts.append(f"{self.kilometres:.4g} km")
        if self.simulated_time is not None:
            texts.append(f"{_time_text(self.simulated_time)} of simulated time")
        return ", ".join(texts)

    def spent(self, amounts: Mapping[str, float]) -> float:
        """Return the spent share of the budget, from 0 to 1: the share of the nearest limit.

        Args:
            amounts: name of each limit -> amount so far, in the limit's unit, as
                `Counts.amounts` returns them.
        """
        limits: dict[str, float | None] = vars(self)
        shares = [amounts[name] / limit for name, limit in limits.items() if limit is not None]
        return min(max(shares), 1.0)


LIMITS: Final = tuple(item.name for item in fields(Budget))
"""Names of a budget's limits, which are entries of a run, too."""


def _time_text(seconds: float) -> str:
    """Return a time in words, such as 17.2 s or 12:34."""
    return f"{seconds:.3g} s" if seconds < 60.0 else format_duration(seconds)
