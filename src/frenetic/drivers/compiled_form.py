"""The compiled form of a driver: a built-in driver and its wrappers as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.conditions.sensors_and_steering import SENSOR_CONDITIONS, STEERING_CONDITIONS
from frenetic.drivers.builtin import BuiltIn
from frenetic.drivers.driver import AHEAD_POINTS, Driver
from frenetic.drivers.sensor_errors import (
    SIGNALS,
    BoolArray,
    Dropouts,
    ErringSensor,
    SensorBias,
    SensorDropout,
)
from frenetic.drivers.stack import OwnWrapper
from frenetic.drivers.steering_errors import ErringSteering, exact_steering
from frenetic.drivers.wrappers import Delayed, ErrorSequence, Hasty, LimitedView, Noisy

_COMPILED_WRAPPERS: Final = frozenset(
    [
        Noisy,
        Delayed,
        LimitedView,
        Hasty,
        *(condition.wrapper_class() for condition in STEERING_CONDITIONS + SENSOR_CONDITIONS),
    ]
)
_CHAINS: Final = ((Noisy, ErringSensor), (Delayed, ErringSteering))
"""Wrappers that change the same values one after the other, so that their order matters."""


@dataclass(frozen=True, eq=False)
class Interface:
    """The sensors and the steering of a driver, which err."""

    biases: FloatArray
    """Constant errors of the signals, (4,), see `frenetic.drivers.sensor_errors`."""
    dropouts: dict[int, Dropouts]
    """Number of a signal that drops out -> its dropouts."""
    steering: FloatArray
    """Amounts of the errors of the steering, (5,), see `frenetic.drivers.steering_errors`."""

    def dropped(self, count: int, period: float) -> BoolArray:
        """Return whether each signal drops out in the first records of a drive, (count, 4).

        Args:
            count: number of records.
            period: time between two records, in s.
        """
        dropped = np.zeros((count, len(SIGNALS)), np.bool_)
        times = round(1e3 * period) * np.arange(count)
        for signal, dropouts in self.dropouts.items():
            dropped[:, signal] = dropouts.at(times)
        return dropped


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
    interface: Interface | None
    """Sensors and steering that err; None if none errs."""


def compiled_form(driver: Driver, period: float) -> Compiled | None:
    """Return the driver for the compiled rollout; None if it has to be called from Python.

    Only the built-in classes themselves are compiled, with at most one wrapper of each class, in
    the order of conditions where order matters. A subclass is not, as it may do anything in `act`.

    Args:
        driver: the driver with its wrappers.
        period: control period of the rollout, in s.
    """
    wrappers: list[OwnWrapper] = []
    while isinstance(driver, OwnWrapper):
        wrappers.append(driver)
        driver = driver.driver
    if not (isinstance(driver, BuiltIn) and type(driver).__module__ == BuiltIn.__module__):
        return None
    if hasattr(driver, "period"):  # the rollout has a fixed period
        return None
    if wrappers and not _are_compiled(wrappers):
        return None
    rows, delay, errors, excess = AHEAD_POINTS, 0, None, 0.0
    for wrapper in wrappers:
        if isinstance(wrapper, Noisy):
            errors = wrapper.errors(period)
        elif isinstance(wrapper, Delayed):
            delay = wrapper.periods(period)
        elif isinstance(wrapper, LimitedView):
            rows = wrapper.rows
        elif isinstance(wrapper, Hasty):
            excess = wrapper.excess / 3.6
    interface = _interface(wrappers) if wrappers else None
    return Compiled(driver.law, driver.parameters(), rows, delay, errors, excess, interface)


def _are_compiled(wrappers: Sequence[OwnWrapper]) -> bool:
    """Return whether wrappers, the outermost first, have a compiled form together."""
    classes = {type(wrapper) for wrapper in wrappers}
    if len(classes) < len(wrappers) or not classes <= _COMPILED_WRAPPERS:
        return False
    chains = (
        [wrapper.place for wrapper in wrappers if isinstance(wrapper, chain)] for chain in _CHAINS
    )
    return all(places == sorted(places) for places in chains)


def _interface(wrappers: Sequence[OwnWrapper]) -> Interface | None:
    """Return the sensors and the steering that wrappers make err; None if none errs."""
    if not any(isinstance(wrapper, (ErringSensor, ErringSteering)) for wrapper in wrappers):
        return None
    interface = Interface(np.zeros(len(SIGNALS)), {}, exact_steering())
    for wrapper in wrappers:
        if isinstance(wrapper, SensorBias):
            interface.biases[wrapper.signal] = wrapper.bias
        elif isinstance(wrapper, SensorDropout):
            interface.dropouts[wrapper.signal] = wrapper.dropouts()
        elif isinstance(wrapper, ErringSteering):
            interface.steering[STEERING_CONDITIONS.index(wrapper.condition)] = wrapper.amount
    return interface
