"""Conditions that differ a little from those in which a road was driven.

A *quantity* is a property of a drive's conditions that can vary, such as the road's friction. A
simulator offers those that it can vary as attributes that may be set between two drives: ``rules``,
which every simulator has, and ``friction``, ``start_offset`` and ``start_heading`` if it can.
Quantities of the driver are layers over it, so they work with every simulator.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

from frenetic.drivers import Delayed, Driver, LimitedView, Noisy
from frenetic.drivers.layers import HEADING_PER_OFFSET
from frenetic.errors import FreneticError
from frenetic.simulators.capabilities import bare, capabilities
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True)
class Quantity:
    """A property of a drive's conditions that can vary."""

    name: str
    """Name of the field in `Conditions`."""
    description: str
    unit: str
    """Empty if it has none."""
    low: float
    """Least value allowed."""
    high: float
    """Largest value allowed."""
    less: str
    """Words for a smaller value, such as "less friction"."""
    more: str
    attribute: str | None
    """Attribute that the simulator must have, None for a layer over the driver."""


QUANTITIES: Final[Mapping[str, Quantity]] = MappingProxyType(
    {
        quantity.name: quantity
        for quantity in (
            Quantity(
                "friction",
                "friction of the road, 1 is dry",
                "",
                0.01,
                1.5,
                "less friction",
                "more friction",
                "friction",
            ),
            Quantity(
                "speed",
                "speed limit",
                "km/h",
                1.0,
                500.0,
                "a lower speed limit",
                "a higher speed limit",
                "rules",
            ),
            Quantity(
                "noise",
                "standard deviation of the driver's error about its lateral place",
                "m",
                0.0,
                10.0,
                "less noise",
                "more noise",
                None,
            ),
            Quantity(
                "delay",
                "time until the driver's controls arrive",
                "s",
                0.0,
                10.0,
                "less delay",
                "more delay",
                None,
            ),
            Quantity(
                "start",
                "place of the start, to the left of the lane's centre",
                "m",
                -2.0,
                2.0,
                "a start further right",
                "a start further left",
                "start_offset",
            ),
            Quantity(
                "heading",
                "heading at the start, to the left of the road's direction",
                "rad",
                -math.pi / 4.0,
                math.pi / 4.0,
                "a start turned to the right",
                "a start turned to the left",
                "start_heading",
            ),
        )
    }
)
"""Name of a field of `Conditions` -> what it is."""


@dataclass(frozen=True)
class Conditions:
    """Differences of a drive from the campaign's; None where there is none."""

    friction: float | None = None
    """Friction of the road."""
    speed: float | None = None
    """Speed limit, in km/h."""
    noise: float | None = None
    """Offset of a `Noisy` layer in m, in place of the driver's own, if it has one."""
    noise_seed: int = 0
    """Seed of that layer."""
    delay: float | None = None
    """Delay of a `Delayed` layer in s, in place of the driver's own, if it has one."""
    start: float | None = None
    """Distance of the car's start to the left of the ego lane's centre, in m."""
    heading: float | None = None
    """Angle of the car's start to the left of the road's direction, in rad."""

    def value(self, name: str) -> float | None:
        """Value of a quantity, None if it is as in the campaign."""
        value: float | None = getattr(self, QUANTITIES[name].name)
        return value


USUAL: Final = Conditions()
"""The campaign's own."""


def check_can_vary(simulator: Simulator, names: Iterable[str]) -> None:
    """Refuses quantities that a simulator cannot vary.

    Raises:
        FreneticError: the simulator cannot vary one of them.
    """
    for name in names:
        attribute = QUANTITIES[name].attribute
        if attribute is not None and attribute not in capabilities(simulator).variable:
            raise FreneticError(
                f"{type(bare(simulator)).__name__} cannot vary {name}: it has no attribute"
                f" {attribute!r}; leave it out, or use another simulator, such as the embedded one"
            )


@contextmanager
def in_conditions(conditions: Conditions, simulator: Simulator, driver: Driver) -> Iterator[Driver]:
    """Puts a simulator into some conditions for a while; gives the driver for these.

    Raises:
        FreneticError: the simulator cannot be put into them.
    """
    values: dict[str, object] = {}
    if conditions.speed is not None:
        values["rules"] = replace(simulator.rules, speed_limit=conditions.speed)
    for name in ("friction", "start", "heading"):
        wanted = conditions.value(name)
        if wanted is not None:
            check_can_vary(simulator, [name])
            values[str(QUANTITIES[name].attribute)] = wanted
    before = {attribute: getattr(simulator, attribute) for attribute in values}
    try:
        _set(simulator, values)
        yield _layered(conditions, driver)
    finally:
        _set(simulator, before)


def _set(simulator: Simulator, values: Mapping[str, object]) -> None:
    for attribute, value in values.items():
        try:
            setattr(simulator, attribute, value)
        except (AttributeError, TypeError, ValueError) as error:
            raise FreneticError(
                f"{type(bare(simulator)).__name__} cannot have {attribute} = {value}: {error}"
            ) from error


def _layered(conditions: Conditions, driver: Driver) -> Driver:
    """The driver under the layers of some conditions, each in place of its own of that kind."""
    if conditions.noise is not None:
        driver = Noisy(
            _without(Noisy, driver),
            offset=conditions.noise,
            heading=HEADING_PER_OFFSET * conditions.noise,
            seed=conditions.noise_seed,
        )
    if conditions.delay is not None:
        driver = Delayed(_without(Delayed, driver), seconds=conditions.delay)
    return driver


def _without(kind: type[Noisy] | type[Delayed], driver: Driver) -> Driver:
    """The driver without its layers of a kind."""
    if not isinstance(driver, Noisy | Delayed | LimitedView):
        return driver
    inner = _without(kind, driver.driver)
    if isinstance(driver, kind):
        return inner
    layer = copy.copy(driver)
    layer.driver = inner
    return layer
