"""Loading drivers by name, and putting drivers under the wrappers of conditions."""

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
    """Return a new driver, under the wrappers of conditions.

    Args:
        spec: a known name, ``package.module:Class`` or ``file.py:Class``.
        options: options that are passed to the driver's class.
        wrappers: amounts of conditions by name, see `under`; None for no condition.

    Raises:
        FreneticError: the driver cannot be loaded or made, or an amount is out of range.
    """
    driver: Driver = DRIVERS.make(spec, **(options or {}))
    amounts = {name: amount for name, amount in wrappers.items() if amount is not None}
    return under(amounts, driver)


def under(amounts: Mapping[str, float], driver: Driver) -> Driver:
    """Return a driver under the wrappers of conditions.

    A wrapper replaces the driver's wrapper of the same class.

    Args:
        amounts: name of a condition of `frenetic.conditions` -> its amount; conditions that are not
            wrappers are skipped. `frenetic.conditions.condition.SEED` is the seed of random
            wrappers.
        driver: any driver.

    Raises:
        FreneticError: there is no such condition, or an amount is out of range.
    """
    seed = {"seed": int(amounts[SEED])} if SEED in amounts else {}
    for condition in [condition_named(name) for name in amounts if name != SEED]:
        if condition.wrapper:
            wrapper_class = condition.wrapper_class()
            try:
                amount = condition.require(amounts[condition.name])
                bare = _without(wrapper_class, driver)
                options = seed if condition.is_seeded else {}
                driver = _wrapped(wrapper_class, bare, amount, options)
            except ValueError as error:
                raise FreneticError(str(error)) from None
    return driver


def _without(wrapper_class: type[Any], driver: Driver) -> Driver:
    """Return the driver without its wrappers of a class."""
    if isinstance(driver, wrapper_class):
        return _without(wrapper_class, driver.driver)
    if isinstance(driver, OwnWrapper):
        return _copied_over(driver, _without(wrapper_class, driver.driver))
    return driver


def _wrapped(
    wrapper_class: type[Any], driver: Driver, amount: float, options: Mapping[str, int]
) -> Driver:
    """Return the driver under a new wrapper, at the wrapper's `place` in the stack.

    A wrapper without a place, which comes from another package, is the innermost.
    """
    if isinstance(driver, OwnWrapper) and driver.place < getattr(wrapper_class, "place", math.inf):
        return _copied_over(driver, _wrapped(wrapper_class, driver.driver, amount, options))
    wrapped: Driver = wrapper_class.over(driver, amount, **options)
    return wrapped


def _copied_over(wrapper: OwnWrapper, driver: Driver) -> OwnWrapper:
    """Return a copy of a wrapper over another driver."""
    wrapper = copy.copy(wrapper)
    wrapper.driver = driver
    return wrapper
