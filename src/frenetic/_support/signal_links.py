"""Links of the variables and channels of other tools with signals: factor and unit."""

from __future__ import annotations

from msgspec import Struct

from frenetic._support.bounds import Finite
from frenetic._support.signal_names import unit_in_name
from frenetic._support.units import Unit, known_units, unit_named


class SignalLink(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a variable or channel is: ``variable = factor * signal``, in the variable's unit."""

    signal: str
    """Name of the signal."""
    factor: Finite = 1.0
    """Factor of the signal, such as -1 where right is positive, or a steering ratio."""
    unit: str | None = None
    """Unit of the variable; None for the one that its file names."""

    def __post_init__(self) -> None:
        if self.factor == 0.0:
            raise ValueError("the factor is 0: any other number is needed")
        if self.unit is not None and unit_named(self.unit) is None:
            raise ValueError(f"the unit {self.unit!r} is not known; known: {known_units()}")


def known_unit(name: str) -> Unit:
    """Return one of our own units."""
    unit = unit_named(name)
    assert unit is not None
    return unit


def units_in(
    link: SignalLink, name: str, unit_name: str | None, unit: Unit | None, our_unit: Unit
) -> float:
    """Return the number of our units in one unit of a variable.

    Args:
        link: link of the variable.
        name: name of the variable, which may end with a unit.
        unit_name: name of the variable's unit in its file; None without one.
        unit: this unit; None if it is not known.
        our_unit: our unit of the signal.

    Raises:
        ValueError: the unit is not known, or measures something else.
    """
    if link.unit is not None:
        unit_name, unit = link.unit, unit_named(link.unit)
    elif unit_name is None:
        unit_name = unit_in_name(name)
        unit = our_unit if unit_name is None else unit_named(unit_name)
    if unit is None:
        raise ValueError(
            f"{name} has the unit {unit_name!r}, which is not known: set unit in a table,"
            f" signals=table.toml; known are {known_units()}"
        )
    if not unit.is_like(our_unit):
        raise ValueError(
            f"{name} has the unit {unit_name!r}, which is none of {link.signal}: name another"
            " signal, or set unit, in a table, signals=table.toml"
        )
    return unit.factor / our_unit.factor
