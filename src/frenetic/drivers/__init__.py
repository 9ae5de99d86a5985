"""Drivers: the Driver protocol, the built-in drivers, layers over any driver."""

from frenetic.drivers.builtin import BeamngAi, Planner, Stanley
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.layers import Delayed, LimitedView, Noisy

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
