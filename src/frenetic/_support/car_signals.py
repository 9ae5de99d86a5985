"""Signals of a car that drives along a lane: their units, and the names that other tools use."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple


class CarSignal(NamedTuple):
    """A signal of a car; left is positive."""

    unit: str
    """Our unit."""
    about: str
    names: tuple[str, ...] = ()
    """Other names, in compact spelling, see `frenetic._support.signal_names`."""


CAR_SIGNALS: Final[Mapping[str, CarSignal]] = MappingProxyType(
    {
        "time": CarSignal("s", "since the start", ("t", "timestamp", "timestamps")),
        "distance": CarSignal("m", "along the road", ("s", "arclength", "station")),
        "speed": CarSignal(
            "m/s",
            "along the car",
            (
                *("v", "vx", "vlong", "velocity", "currvelocity", "currentvelocity", "speedx"),
                *("longitudinalvelocity", "longitudinalspeed", "velocityx", "vehspd"),
            ),
        ),
        "lateral_speed": CarSignal("m/s", "across the car", ("vy", "lateralvelocity", "vlat")),
        "yaw_rate": CarSignal(
            "rad/s",
            "",
            ("r", "psidot", "psip", "dpsi", "yawvelocity", "curryawrate", "omegaz", "wz"),
        ),
        "steering": CarSignal(
            "rad",
            "present angle of the front wheels",
            (
                *("steeringangle", "delta", "deltaf", "currsteer", "currentsteering", "steer"),
                *("roadwheelangle", "frontwheelangle", "measuredsteering", "steeringmeasured"),
            ),
        ),
        "lateral_offset": CarSignal(
            "m",
            "of the car from the lane's centre",
            (
                *("ey", "e1", "lateralerror", "lateraldeviation", "laterr", "erry", "yerr"),
                *("crosstrackerror", "cte", "lateraldistance", "offset", "deviation", "dlat"),
                "yerror",
            ),
        ),
        "heading_error": CarSignal(
            "rad",
            "heading of the car minus heading of the lane",
            (
                *("epsi", "e2", "relativeyawangle", "yawerror", "psierr", "psierror", "etheta"),
                *("headingdeviation", "yawangleerror", "orientationerror", "headingerr"),
                "dtheta",
            ),
        ),
        "x": CarSignal("m", "of the car on the map", ("posx", "xpos", "positionx")),
        "y": CarSignal("m", "of the car on the map", ("posy", "ypos", "positiony")),
        "heading": CarSignal("rad", "of the car on the map", ("psi", "yaw", "theta")),
    }
)
"""Signals that a driver observes and a recording may hold, by name."""
PEDALS: Final[Mapping[str, CarSignal]] = MappingProxyType(
    {
        "throttle": CarSignal(
            "1", "0..1", ("accelerator", "accelpedal", "gas", "acceleratorpedal")
        ),
        "brake": CarSignal("1", "0..1", ("brakepedal", "braking")),
    }
)
"""Positions of the pedals, which a driver sets and a recording may hold, by name."""
