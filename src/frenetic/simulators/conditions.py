"""Conditions that differ from those in which a road was driven.

A simulator offers the conditions that it can vary as attributes that may be set between two drives
(`frenetic.simulators.capabilities`): ``rules``, which every simulator has, and ``friction``,
``start_offset`` and so on if it can. The other conditions are wrappers over the driver.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeAlias

from msgspec import convert

from frenetic._support.bounds import Finite
from frenetic.conditions.condition import SEED, condition_named, condition_names, known_conditions
from frenetic.drivers.driver import Driver
from frenetic.drivers.loading import under
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.simulators.capabilities import capabilities, check_pair
from frenetic.simulators.simulator import Simulator

Conditions: TypeAlias = Mapping[str, float]
"""Name of a condition -> its amount, where it differs from the campaign's; and the seed of what is
random, as `frenetic.conditions.condition.SEED`."""


def check_conditions(values: Conditions) -> None:
    """Check conditions that come from a file or a user.

    Raises:
        ValueError: A name is no condition, or a value is not a finite number.
    """
    if unknown := sorted(values.keys() - {*known_conditions(), SEED}):
        raise ValueError(
            f"there is no condition {', '.join(unknown)}: choose from"
            f" {', '.join(known_conditions())}"
        )
    convert(dict(values), dict[str, Finite])


def check_can_vary(simulator: Simulator, names: Iterable[str]) -> None:
    """Refuse conditions that a simulator cannot vary.

    Raises:
        FreneticError: The simulator cannot vary a condition.
    """
    declared = capabilities(simulator)
    for row in map(condition_named, names):
        if not declared.lays(row):
            raise FreneticError(
                f"{type(simulator).__name__} cannot vary {row.name}: it has no attribute"
                f" {row.attribute!r}; leave it out, or use another simulator, such as the embedded"
                " one ('frenetic list simulators')"
            )


def own_amount(simulator: Simulator, name: str) -> float | None:
    """Return a simulator's amount of a condition that is its attribute; None if there is none."""
    value: Any = getattr(simulator, condition_named(name).attribute)
    if value is None:  # it is the vehicle's
        value = getattr(getattr(simulator, "vehicle", None), condition_named(name).attribute, None)
    return value.speed_limit if isinstance(value, Rules) else value


def usual_conditions(conditions: Conditions, simulator: Simulator) -> dict[str, float]:
    """Return the usual amounts of some conditions: without effect, or the simulator's.

    A place on the road has no usual amount.
    """
    amounts: dict[str, float] = {}
    for name in condition_names(conditions):
        usual = condition_named(name).no_effect
        usual = own_amount(simulator, name) if usual is None else usual
        if usual is not None:
            amounts[name] = usual
    return amounts


def rules_in(conditions: Conditions, rules: Rules) -> Rules:
    """Return the rules of a drive in some conditions, in a campaign with these rules."""
    for name in condition_names(conditions):
        if condition_named(name).attribute == "rules":
            rules = rules.with_speed(conditions[name])
    return rules


@contextmanager
def in_conditions(conditions: Conditions, simulator: Simulator, driver: Driver) -> Iterator[Driver]:
    """Put a simulator into some conditions for a while; yield the driver for them.

    Raises:
        FreneticError: The simulator cannot be put into the conditions.
    """
    values: dict[str, object] = {}
    names = [name for name in conditions if name != SEED]
    check_can_vary(simulator, names)
    for name in names:
        attribute = condition_named(name).attribute
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
    """Check whether a driver can drive in a simulator in some conditions, as `check_pair` does.

    Raises:
        FreneticError: The simulator or the driver cannot have the conditions.
    """
    with in_conditions(conditions, simulator, driver) as wrapped:
        check_pair(simulator, wrapped)


def _set(simulator: Simulator, values: Mapping[str, object]) -> None:
    for attribute, value in values.items():
        try:
            setattr(simulator, attribute, value)
        except (AttributeError, TypeError, ValueError) as error:
            raise FreneticError(
                f"{type(simulator).__name__} cannot have {attribute} = {value}: {error}"
            ) from error
