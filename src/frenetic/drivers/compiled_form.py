"""The compiled form of a driver: a built-in driver and its wrappers as numbers."""

from __future__ import annotations

from dataclasses import dataclass

from frenetic._support.arrays import FloatArray
from frenetic.drivers.builtin import BuiltIn
from frenetic.drivers.driver import AHEAD_POINTS, Driver
from frenetic.drivers.stack import OwnWrapper
from frenetic.drivers.wrappers import Delayed, ErrorSequence, Hasty, LimitedView, Noisy


@dataclass(frozen=True)
class Compiled:
    """A built-in driver and its wrappers as numbers, for the compiled rollout."""

    law: int
    """Number of the driver's law, see `frenetic.drivers.laws`."""
    parameters: FloatArray
    """Parameters of the law."""
    rows: int
    """Number of points of the view."""
    delay: int
    """Delay of the controls, in control periods."""
    errors: ErrorSequence | None
    """Errors about the position; None without errors."""
    excess: float
    """Excess over the speed limit, in m/s."""


def compiled_form(driver: Driver, period: float) -> Compiled | None:
    """Return the driver for the compiled rollout; None if it has to be called from Python.

    Only the built-in classes themselves are compiled, with at most one wrapper of each class. A
    subclass is not, as it may do anything in `act`.

    Args:
        driver: the driver with its wrappers.
        period: control period of the rollout, in s.
    """
    rows, delay, errors, excess = AHEAD_POINTS, 0, None, 0.0
    wrapper_classes = set()
    while isinstance(driver, OwnWrapper) and type(driver) in (Noisy, Delayed, LimitedView, Hasty):
        if type(driver) in wrapper_classes:
            return None
        wrapper_classes.add(type(driver))
        if isinstance(driver, Noisy):
            errors = driver.errors(period)
        elif isinstance(driver, Delayed):
            delay = driver.periods(period)
        elif isinstance(driver, LimitedView):
            rows = driver.rows
        elif isinstance(driver, Hasty):
            excess = driver.excess
        driver = driver.driver
    if not (isinstance(driver, BuiltIn) and type(driver).__module__ == BuiltIn.__module__):
        return None
    if hasattr(driver, "period"):  # the rollout has a fixed period
        return None
    return Compiled(driver.law, driver.parameters(), rows, delay, errors, excess / 3.6)
