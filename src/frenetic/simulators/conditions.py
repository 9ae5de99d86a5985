"""Conditions of one drive: put the simulator into them, and the driver's wrappers over the driver.

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
from frenetic.drivers.loading import with_wrappers
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.simulators.capabilities import capabilities, check_pair
from frenetic.simulators.simulator import Simulator

Conditions: TypeAlias = Mapping[str, float]
"""Name of a condition -> its amount, where that differs from the campaign's amount. The key
`frenetic.conditions.condition.SEED` holds the seed of random conditions."""


def check_conditions(values: Conditions) -> None:
    """Check the names and amounts of conditions that come from a file or a user.

    Raises:
        ValueError: A name is no condition's, or an amount is not a finite number.
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
        FreneticError: The simulator lacks the attribute of a condition.
    """
    declared = capabilities(simulator)
    for condition in map(condition_named, names):
        if not declared.can_apply(condition):
            raise FreneticError(
                f"{type(simulator).__name__} cannot vary {condition.name}: it has no attribute"
                f" {condition.attribute!r}; leave it out, or use another simulator, such as the"
                " embedded one ('frenetic list simulators')"
            )


def own_amount(simulator: Simulator, name: str) -> float | None:
    """Return the amount of a condition that an attribute of the simulator holds.

    None if neither the simulator nor its vehicle has an amount.
    """
    attribute = condition_named(name).attribute
    value: Any = getattr(simulator, attribute)
    if value is None:  # then the vehicle has the amount
        value = getattr(getattr(simulator, "vehicle", None), attribute, None)
    return value.speed_limit if isinstance(value, Rules) else value


def usual_amount(simulator: Simulator, name: str) -> float | None:
    """Return the usual amount of a condition.

    That is the amount without effect or, of a condition that always has an effect, such as
    friction, the simulator's amount. A place on the road has none, nor an amount that nobody says.
    """
    condition = condition_named(name)
    if condition.no_effect is not None or condition.place_of or not condition.attribute:
        return condition.no_effect
    return own_amount(simulator, name)


def usual_conditions(conditions: Conditions, simulator: Simulator) -> dict[str, float]:
    """Return the usual amounts of some conditions, see `usual_amount`."""
    amounts = {name: usual_amount(simulator, name) for name in condition_names(conditions)}
    return {name: amount for name, amount in amounts.items() if amount is not None}


def rules_in(conditions: Conditions, rules: Rules) -> Rules:
    """Return a campaign's rules, changed as the conditions of a drive ask: the speed limit."""
    for name in condition_names(conditions):
        if condition_named(name).attribute == "rules":
            rules = rules.with_speed(conditions[name])
    return rules


@contextmanager
def in_conditions(conditions: Conditions, simulator: Simulator, driver: Driver) -> Iterator[Driver]:
    """Put a simulator into some conditions until the context ends.

    Yields:
        The driver under the wrappers of the conditions.

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
        yield with_wrappers(driver, conditions)
    finally:
        _set(simulator, before)


def check_pair_in(conditions: Conditions, simulator: Simulator, driver: Driver) -> None:
    """Check whether a driver can drive in a simulator in some conditions, see `check_pair`.

    Raises:
        FreneticError: The simulator or the driver cannot have the conditions.
    """
    with in_conditions(conditions, simulator, driver) as wrapped:
        check_pair(simulator, wrapped)


def _set(simulator: Simulator, values: Mapping[str, object]) -> None:
    """Set attributes of a simulator.

    Raises:
        FreneticError: The simulator refuses a value.
    """
    for attribute, value in values.items():
        try:
            setattr(simulator, attribute, value)
        except (AttributeError, TypeError, ValueError) as error:
            raise FreneticError(
                f"{type(simulator).__name__} cannot have {attribute} = {value}: {error}"
            ) from error
