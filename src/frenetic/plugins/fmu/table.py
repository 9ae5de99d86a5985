"""The table, in TOML, that says which variable of an FMU is which signal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, TypeAlias

from msgspec import Meta, Struct

from frenetic._support.bounds import NotNegative, Positive
from frenetic._support.signal_links import SignalLink
from frenetic.spec import read_entries

START: Final = "start"
"""Word for an input that keeps its start value."""
_MOST_DISTANCES: Final = 1000
"""Largest number of distances of a signal; our choice."""


class VariableLink(SignalLink, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The link of a variable of an FMU with a signal, or with a control for an output."""

    distances: Annotated[tuple[NotNegative, ...], Meta(max_length=_MOST_DISTANCES)] = ()
    """Distances ahead, in m, one for each element of the variable."""


Entry: TypeAlias = bool | float | str | VariableLink
"""Entry of an input: a constant in its unit, a signal's name, `START`, or a link."""


class SignalTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which variables of an FMU are which signals."""

    inputs: Mapping[str, Entry] = {}
    """Input -> its signal."""
    outputs: Mapping[str, str | VariableLink] = {}
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
