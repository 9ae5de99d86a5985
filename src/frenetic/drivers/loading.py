"""Drivers by name, with their options, under the wrappers of some conditions."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

from frenetic.conditions.condition import SEED, condition_named
from frenetic.drivers.driver import Driver
from frenetic.drivers.stack import OwnWrapper
from frenetic.errors import FreneticError
from frenetic.parts.registry import DRIVERS


def load_driver(
    spec: str, options: Mapping[str, Any] | None = None, **wrappers: float | None
) -> Driver:
    """Return the driver of a name, of ``package.module:Class`` or of ``file.py:Class``.

    Args:
        spec: Name of the driver.
        options: Options that are passed to its class.
        wrappers: Amounts of conditions of the driver, see `under`.

    Raises:
        FreneticError: The driver cannot be loaded or made, or an amount is out of range.
    """
    driver: Driver = DRIVERS.make(spec, **(options or {}))
    return under({name: value for name, value in wrappers.items() if value is not None}, driver)


def under(amounts: Mapping[str, float], driver: Driver) -> Driver:
    """Return a driver under wrappers; each replaces the driver's wrapper of that kind.

    Args:
        amounts: Name of a condition of `frenetic.conditions` -> its amount; conditions that are not
            wrappers are skipped. ``noise`` is the lateral error of a `Noisy` wrapper, whose heading
            error is 0.1 rad per m of it. `frenetic.conditions.condition.SEED` is the seed of random
            wrappers.
        driver: Any driver.

    Raises:
        FreneticError: There is no such condition, or an amount is out of range.
    """
    seed = {"seed": int(amounts[SEED])} if SEED in amounts else {}
    for row in [condition_named(name) for name in amounts if name != SEED]:
        if row.wrapper:
            kind = row.wrapper_class()
            try:
                amount = row.require(amounts[row.name])
                bare = _without(kind, driver)
                driver = _laid(kind, bare, amount, seed if row.is_seeded else {})
            except ValueError as error:
                raise FreneticError(str(error)) from None
    return driver


def _without(kind: type[Any], driver: Driver) -> Driver:
    """Return the driver without its wrappers of a kind."""
    if isinstance(driver, kind):
        return _without(kind, driver.driver)
    return (
        _over(driver, _without(kind, driver.driver)) if isinstance(driver, OwnWrapper) else driver
    )


def _laid(kind: type[Any], driver: Driver, amount: float, seed: Mapping[str, int]) -> Driver:
    """Return the driver under a wrapper, in its place among others; a foreign one is innermost."""
    if isinstance(driver, OwnWrapper) and driver.place < getattr(kind, "place", math.inf):
        return _over(driver, _laid(kind, driver.driver, amount, seed))
    wrapped: Driver = kind.over(driver, amount, **seed)
    return wrapped


def _over(wrapper: OwnWrapper, driver: Driver) -> OwnWrapper:
    """Return a copy of a wrapper over another driver."""
    wrapper = copy.copy(wrapper)
    wrapper.driver = driver
    return wrapper
