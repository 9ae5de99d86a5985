"""Drivers: the `Driver` protocol, the built-in drivers, and wrappers over any driver.

The names below are imported when they are used, so that the command line does not wait for numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

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

_MODULES = {
    "BeamngAi": "frenetic.drivers.builtin",
    "Camera": "frenetic.drivers.camera",
    "CameraDriver": "frenetic.drivers.driver",
    "Controls": "frenetic.drivers.driver",
    "Delayed": "frenetic.drivers.wrappers",
    "DriveSetup": "frenetic.drivers.driver",
    "Driver": "frenetic.drivers.driver",
    "Lane": "frenetic.drivers.lane",
    "LimitedView": "frenetic.drivers.wrappers",
    "Noisy": "frenetic.drivers.wrappers",
    "Observation": "frenetic.drivers.driver",
    "Planner": "frenetic.drivers.builtin",
    "SpeedPlan": "frenetic.drivers.builtin",
    "Stanley": "frenetic.drivers.builtin",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
