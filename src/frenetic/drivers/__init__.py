"""Drivers: the Driver protocol, the built-in drivers, layers over any driver.

The names below are imported when they are used, so that the command line can look up what layers
there are without waiting for numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.drivers.builtin import BeamngAi, Planner, SpeedPlan, Stanley
    from frenetic.drivers.camera import Camera
    from frenetic.drivers.driver import CameraDriver, Controls, Driver, DriveSetup, Observation
    from frenetic.drivers.lane import Lane
    from frenetic.drivers.wrappers import Delayed, LimitedView, Noisy

__all__ = [
    "BeamngAi",
    "Camera",
    "CameraDriver",
    "Controls",
    "Delayed",
    "DriveSetup",
    "Driver",
    "Lane",
    "LimitedView",
    "Noisy",
    "Observation",
    "Planner",
    "SpeedPlan",
    "Stanley",
]

__getattr__ = lazy_names(__name__)
