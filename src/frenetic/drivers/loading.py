"""Drivers by name, with their options and layers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from frenetic.drivers.driver import Driver
from frenetic.drivers.layers import HEADING_PER_OFFSET, Delayed, LimitedView, Noisy
from frenetic.errors import FreneticError
from frenetic.registry import DRIVERS


def load_driver(
    spec: str,
    options: Mapping[str, Any] | None = None,
    *,
    noise: float | None = None,
    delay: float | None = None,
    view: float | None = None,
) -> Driver:
    """The driver that a name, ``package.module:Class`` or ``file.py:Class`` stands for.

    Args:
        spec: which driver.
        options: passed to its class.
        noise: m, standard deviation of the lateral error of a `Noisy` layer; its heading error is
            a tenth of it in rad per m.
        delay: s, of a `Delayed` layer.
        view: m, of a `LimitedView` layer.

    Raises:
        FreneticError: it cannot be loaded or made, or a layer's value is out of range.
    """
    driver: Driver = DRIVERS.make(spec, **(options or {}))
    try:
        if view is not None:
            driver = LimitedView(driver, distance=view)
        if noise is not None:
            driver = Noisy(driver, offset=noise, heading=HEADING_PER_OFFSET * noise)
        if delay is not None:
            driver = Delayed(driver, seconds=delay)
    except ValueError as error:
        raise FreneticError(f"layer over driver {spec!r}: {error}") from None
    return driver
