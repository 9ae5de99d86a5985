"""Drivers: the `Driver` protocol, the built-in drivers, and wrappers over any driver.

The names below are imported when they are used, so that the command line does not wait for numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.drivers.builtin import BeamngAi, Planner, SpeedPlan, Stanley
    from frenetic.drivers.camera import Camera
    from frenetic.drivers.command import CommandDriver
    from frenetic.drivers.driver import CameraDriver, Controls, Driver, DriveSetup, Observation
    from frenetic.drivers.half_drivers import SpeedOnly, SteeringOnly, wanted_curvature
    from frenetic.drivers.lane import Lane
    from frenetic.drivers.sensor_errors import (
        HeadingBias,
        HeadingDropout,
        LateralBias,
        LateralDropout,
        SpeedBias,
        SpeedDropout,
        YawRateBias,
        YawRateDropout,
    )
    from frenetic.drivers.steering_errors import (
        SteeringDeadBand,
        SteeringGain,
        SteeringOffset,
        SteeringRate,
        SteeringResolution,
    )
    from frenetic.drivers.wrappers import Delayed, LimitedView, Noisy

__all__ = [
    "BeamngAi",
    "Camera",
    "CameraDriver",
    "CommandDriver",
    "Controls",
    "Delayed",
    "DriveSetup",
    "Driver",
    "HeadingBias",
    "HeadingDropout",
    "Lane",
    "LateralBias",
    "LateralDropout",
    "LimitedView",
    "Noisy",
    "Observation",
    "Planner",
    "SpeedBias",
    "SpeedDropout",
    "SpeedOnly",
    "SpeedPlan",
    "Stanley",
    "SteeringDeadBand",
    "SteeringGain",
    "SteeringOffset",
    "SteeringOnly",
    "SteeringRate",
    "SteeringResolution",
    "YawRateBias",
    "YawRateDropout",
    "wanted_curvature",
]

_MODULES = {
    "BeamngAi": "frenetic.drivers.builtin",
    "Camera": "frenetic.drivers.camera",
    "CameraDriver": "frenetic.drivers.driver",
    "CommandDriver": "frenetic.drivers.command",
    "Controls": "frenetic.drivers.driver",
    "Delayed": "frenetic.drivers.wrappers",
    "DriveSetup": "frenetic.drivers.driver",
    "Driver": "frenetic.drivers.driver",
    "HeadingBias": "frenetic.drivers.sensor_errors",
    "HeadingDropout": "frenetic.drivers.sensor_errors",
    "Lane": "frenetic.drivers.lane",
    "LateralBias": "frenetic.drivers.sensor_errors",
    "LateralDropout": "frenetic.drivers.sensor_errors",
    "LimitedView": "frenetic.drivers.wrappers",
    "Noisy": "frenetic.drivers.wrappers",
    "Observation": "frenetic.drivers.driver",
    "Planner": "frenetic.drivers.builtin",
    "SpeedBias": "frenetic.drivers.sensor_errors",
    "SpeedDropout": "frenetic.drivers.sensor_errors",
    "SpeedOnly": "frenetic.drivers.half_drivers",
    "SpeedPlan": "frenetic.drivers.builtin",
    "Stanley": "frenetic.drivers.builtin",
    "SteeringDeadBand": "frenetic.drivers.steering_errors",
    "SteeringGain": "frenetic.drivers.steering_errors",
    "SteeringOffset": "frenetic.drivers.steering_errors",
    "SteeringOnly": "frenetic.drivers.half_drivers",
    "SteeringRate": "frenetic.drivers.steering_errors",
    "SteeringResolution": "frenetic.drivers.steering_errors",
    "YawRateBias": "frenetic.drivers.sensor_errors",
    "YawRateDropout": "frenetic.drivers.sensor_errors",
    "wanted_curvature": "frenetic.drivers.half_drivers",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
