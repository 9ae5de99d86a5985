"""Conditions that differ from those in which a road was driven.

A simulator offers those of `frenetic.conditions` that it can vary as attributes that may be set
between two drives (`frenetic.simulators.capabilities`): ``rules``, which every simulator has, and
``friction``, ``start_offset`` and so on if it can. The others are layers over the driver.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeAlias

from msgspec import convert

from frenetic._support.bounds import Finite
from frenetic.conditions.condition import SEED, named, quantities, quantity
from frenetic.drivers.driver import Driver
from frenetic.drivers.loading import under
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.simulators.capabilities import capabilities, check_pair
from frenetic.simulators.simulator import Simulator

Conditions: TypeAlias = Mapping[str, float]
"""Name of a quantity -> its amount, where it differs from the campaign's; and the seed of what is
random, as `frenetic.conditions.condition.SEED`."""


def check_conditions(values: Conditions) -> None:
    """Checks conditions from elsewhere.

    Raises:
        ValueError: there is no such condition, or a value is no finite number.
    """
    if unknown := sorted(values.keys() - {*quantities(), SEED}):
        raise ValueError(
            f"there is no condition {', '.join(unknown)}: choose from {', '.join(quantities())}"
        )
    convert(dict(values), dict[str, Finite])


def check_can_vary(simulator: Simulator, names: Iterable[str]) -> None:
    """Refuses quantities that a simulator cannot vary.

    Raises:
        FreneticError: the simulator cannot vary one of them.
    """
    able = capabilities(simulator)
    for row in map(quantity, names):
        if not able.lays(row):
            raise FreneticError(
                f"{type(simulator).__name__} cannot vary {row.name}: it has no attribute"
                f" {row.attribute!r}; leave it out, or use another simulator, such as the embedded"
                " one ('frenetic list simulators')"
            )


def own_amount(simulator: Simulator, name: str) -> float | None:
    """A simulator's own amount of a quantity that is an attribute of it; None if it has none."""
    value: Any = getattr(simulator, quantity(name).attribute)
    if value is None:  # it is the vehicle's
        value = getattr(getattr(simulator, "vehicle", None), quantity(name).attribute, None)
    return value.speed_limit if isinstance(value, Rules) else value


def usual_conditions(conditions: Conditions, simulator: Simulator) -> dict[str, float]:
    """What is usual of the quantities of some conditions: without effect, or the simulator's own.

    A place on the road has no usual amount.
    """
    found: dict[str, float] = {}
    for name in named(conditions):
        usual = quantity(name).nothing
        usual = own_amount(simulator, name) if usual is None else usual
        if usual is not None:
            found[name] = usual
    return found


def rules_in(conditions: Conditions, rules: Rules) -> Rules:
    """The rules of a drive in some conditions of a campaign with these rules."""
    for name in named(conditions):
        if quantity(name).attribute == "rules":
            rules = rules.with_speed(conditions[name])
    return rules


@contextmanager
def in_conditions(conditions: Conditions, simulator: Simulator, driver: Driver) -> Iterator[Driver]:
    """Puts a simulator into some conditions for a while; gives the driver for these.

    Raises:
        FreneticError: the simulator cannot be put into them.
    """
    values: dict[str, object] = {}
    names = [name for name in conditions if name != SEED]
    check_can_vary(simulator, names)
    for name in names:
        attribute = quantity(name).attribute
        if attribute == "rules":
            values[attribute] = simulator.rules.with_speed(conditions[name])
        elif attribute:
            values[attribute] = conditions[name]
    before = {attribute: getattr(simulator, attribute) for attribute in values}
    try:
        _set(simulator, values)
        yield under(conditions, driver)
    finally:
        _set(simulator, before)


def check_pair_in(conditions: Conditions, simulator: Simulator, driver: Driver) -> None:
    """Checks whether a driver can drive in a simulator in some conditions, as `check_pair` does.

    Raises:
        FreneticError: the simulator cannot be put into them, or the driver cannot have them.
    """
    with in_conditions(conditions, simulator, driver) as layered:
        check_pair(simulator, layered)


def _set(simulator: Simulator, values: Mapping[str, object]) -> None:
    for attribute, value in values.items():
        try:
            setattr(simulator, attribute, value)
        except (AttributeError, TypeError, ValueError) as error:
            raise FreneticError(
                f"{type(simulator).__name__} cannot have {attribute} = {value}: {error}"
            ) from error
