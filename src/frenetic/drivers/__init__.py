"""Drivers: the Driver protocol, the built-in drivers, layers over any driver.

The names below are imported when they are used, so that the command line can look up what layers
there are without waiting for numba.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frenetic.drivers.builtin import BeamngAi, Planner, Stanley
    from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
    from frenetic.drivers.layers import Delayed, LimitedView, Noisy

_HOMES = {
    "builtin": ("BeamngAi", "Planner", "Stanley"),
    "driver": ("Controls", "Driver", "DriveSetup", "Observation"),
    "layers": ("Delayed", "LimitedView", "Noisy"),
}

__all__ = [
    "BeamngAi",
    "Controls",
    "Delayed",
    "DriveSetup",
    "Driver",
    "LimitedView",
    "Noisy",
    "Observation",
    "Planner",
    "Stanley",
]


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            value = getattr(import_module(f"frenetic.drivers.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
