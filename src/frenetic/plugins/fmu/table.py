"""The table, in TOML, that says which variable of an FMU is which signal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, TypeAlias

from msgspec import Meta, Struct

from frenetic._support.bounds import Finite, NotNegative, Positive
from frenetic._support.units import known_units, unit_named
from frenetic.spec import read_entries

START: Final = "start"
"""Word for an input that keeps its start value."""
_MOST_DISTANCES: Final = 1000
"""Largest number of distances of a signal; our choice."""


class SignalLink(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a variable is: ``variable = factor * signal``, in the variable's unit."""

    signal: str
    """Name of a signal, or of a control for an output."""
    factor: Finite = 1.0
    """Factor of the signal, such as -1 where right is positive, or a steering ratio."""
    unit: str | None = None
    """Unit of the variable; None for the one in its description."""
    distances: Annotated[list[NotNegative], Meta(min_length=1, max_length=_MOST_DISTANCES)] = []
    """Distances ahead, in m, one for each element of the variable."""

    def __post_init__(self) -> None:
        if self.factor == 0.0:
            raise ValueError("the factor is 0: any other number is needed")
        if self.unit is not None and unit_named(self.unit) is None:
            raise ValueError(f"the unit {self.unit!r} is not known; known: {known_units()}")


Entry: TypeAlias = bool | float | str | SignalLink
"""Entry of an input: a constant in its unit, a signal's name, `START`, or a link."""


class SignalTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which variables of an FMU are which signals."""

    inputs: Mapping[str, Entry] = {}
    """Input -> its signal."""
    outputs: Mapping[str, str | SignalLink] = {}
    """Output -> its control."""
    parameters: Mapping[str, bool | float | str] = {}
    """Parameter -> its value, in its unit; the name of a signal of the car for this signal."""
    period: Positive | None = None
    """Time between two calls, in s; None to follow the FMU's preferred step size."""
    speed: Mapping[str, Positive] = {}
    """Options of the planner whose speeds an FMU without pedals drives, and `target_speed`."""

    @classmethod
    def read(cls, path: Path | str) -> SignalTable:
        """Read a table.

        Raises:
            FreneticError: there is no such file, or an entry is wrong.
        """
        return read_entries(Path(path).expanduser(), cls, "a table of signals")
