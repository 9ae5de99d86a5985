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
    spec: str, options: Mapping[str, Any] | None = None, **amounts: float | None
) -> Driver:
    """Return a new driver, under the wrappers of conditions.

    Args:
        spec: a known name, ``package.module:Class`` or ``file.py:Class``.
        options: options that are passed to the driver's class.
        amounts: amounts of conditions by name, such as ``noise=0.1``; None for no condition.
            Conditions that an attribute of the simulator sets, such as ``friction``, have no
            wrapper: they are skipped.

    Raises:
        FreneticError: the driver cannot be loaded or made, or an amount is out of range.
    """
    driver: Driver = DRIVERS.make(spec, **(options or {}))
    return with_wrappers(
        driver, {name: amount for name, amount in amounts.items() if amount is not None}
    )


def with_wrappers(driver: Driver, amounts: Mapping[str, float]) -> Driver:
    """Return a driver under the wrappers of conditions.

    A wrapper replaces the driver's wrapper of the same class. The passed driver stays as it is.

    Args:
        driver: any driver.
        amounts: name of a condition of `frenetic.conditions` -> its amount; conditions without a
            wrapper are skipped. `frenetic.conditions.condition.SEED` is the seed of random
            wrappers.

    Raises:
        FreneticError: there is no such condition, or an amount is out of range.
    """
    seed = {"seed": int(amounts[SEED])} if SEED in amounts else {}
    # A list, so that an unknown name is refused before a wrapper is made.
    conditions = [condition_named(name) for name in amounts if name != SEED]
    for condition in conditions:
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
    """Return the driver without its wrappers of a class, down to the first foreign wrapper.

    A foreign wrapper comes from another package and is of another class: it and the driver under it
    stay as they are.
    """
    if isinstance(driver, wrapper_class):
        return _without(wrapper_class, driver.driver)
    if isinstance(driver, OwnWrapper):
        return _copy_over(driver, _without(wrapper_class, driver.driver))
    return driver


def _wrapped(
    wrapper_class: type[Any], driver: Driver, amount: float, options: Mapping[str, int]
) -> Driver:
    """Return the driver under a new wrapper, at the wrapper's `place` in the stack.

    Place 0 is the outermost. A wrapper without a place, which comes from another package, goes
    under all of Frenetic's own wrappers.
    """
    if isinstance(driver, OwnWrapper) and driver.place < getattr(wrapper_class, "place", math.inf):
        return _copy_over(driver, _wrapped(wrapper_class, driver.driver, amount, options))
    wrapped: Driver = wrapper_class.over(driver, amount, **options)
    return wrapped


def _copy_over(wrapper: OwnWrapper, driver: Driver) -> OwnWrapper:
    """Return a copy of a wrapper over another driver; the caller's own wrapper stays as it is."""
    wrapper = copy.copy(wrapper)
    wrapper.driver = driver
    return wrapper
