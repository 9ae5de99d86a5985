"""Signals that an FMU's inputs may get, and controls that its outputs may be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.car_signals import CAR_SIGNALS, PEDALS
from frenetic.drivers import SpeedPlan
from frenetic.drivers.builtin import speed_limits_ahead
from frenetic.drivers.driver import AHEAD_SPACING, DriveSetup, Observation
from frenetic.drivers.laws import setup_array


class Moment(NamedTuple):
    """What an input's value follows from."""

    observation: Observation
    setup: DriveSetup
    plan: SpeedPlan


class InputSignal(NamedTuple):
    """A signal that an input may get."""

    unit: str
    about: str
    value: Callable[[Moment], float]
    """Function that returns the value."""
    names: tuple[str, ...] = ()
    """Other names, in compact spelling, see `frenetic._support.signal_names`."""


class PreviewSignal(NamedTuple):
    """A signal with a value at each distance ahead."""

    unit: str
    about: str
    values: Callable[[Moment], FloatArray]
    """Function that returns the values every `AHEAD_SPACING` m, from beside the car on, (n,)."""
    names: tuple[str, ...] = ()


class OutputControl(NamedTuple):
    """A control that an output may be."""

    unit: str
    about: str
    names: tuple[str, ...] = ()


def _observed(name: str) -> Callable[[Moment], float]:
    """Return the function that reads an attribute of the observation."""
    return lambda moment: float(getattr(moment.observation, name))


def _of_setup(name: str) -> Callable[[Moment], float]:
    """Return the function that reads an attribute of the setup."""
    return lambda moment: float(getattr(moment.setup, name))


def _limits(moment: Moment) -> FloatArray:
    """Return the speed limits at the points ahead, (n,) in m/s."""
    return speed_limits_ahead(moment.observation, setup_array(moment.setup))


SETUP_SIGNALS: Final[Mapping[str, InputSignal]] = {
    "period": InputSignal(
        "s", "between two steps", _of_setup("period"), ("dt", "ts", "sampletime")
    ),
    "wheelbase": InputSignal("m", "of the car", _of_setup("wheelbase")),
    "front_axle": InputSignal("m", "centre of mass to axle", _of_setup("front_axle"), ("lf",)),
    "rear_axle": InputSignal("m", "centre of mass to axle", _of_setup("rear_axle"), ("lr",)),
    "lane_width": InputSignal("m", "", _of_setup("lane_width")),
    "max_steering": InputSignal(
        "rad", "largest angle of the front wheels", _of_setup("max_steering")
    ),
}
"""Signals that are known before a drive, which a parameter may get, too."""
SIGNALS: Final[Mapping[str, InputSignal]] = {
    **{
        name: InputSignal(signal.unit, signal.about, _observed(name), signal.names)
        for name, signal in CAR_SIGNALS.items()
    },
    "target_speed": InputSignal(
        "m/s",
        "that Frenetic's planner would drive here",
        lambda moment: moment.plan.speed(moment.observation),
        (
            *("vref", "refspeed", "refvelocity", "referencespeed", "setspeed", "vset", "vdes"),
            *("desiredspeed", "vtarget", "targetvelocity", "speedref", "setvelocity"),
        ),
    ),
    **SETUP_SIGNALS,
}
"""Signals by name, in our units; left is positive."""
PREVIEWS: Final[Mapping[str, PreviewSignal]] = {
    "curvature": PreviewSignal(
        "1/m",
        "of the lane",
        lambda moment: moment.observation.curvature_ahead,
        ("kappa", "roadcurvature", "pathcurvature", "lanecurvature", "kapparef", "curvatureref"),
    ),
    "path_x": PreviewSignal(
        "m",
        "of the lane's centre, ahead of the car",
        lambda moment: moment.observation.ahead[:, 0],
        ("xpath", "previewx", "xpreview", "lanex", "xref", "refx"),
    ),
    "path_y": PreviewSignal(
        "m",
        "of the lane's centre, left of the car",
        lambda moment: moment.observation.ahead[:, 1],
        ("ypath", "previewy", "ypreview", "laney", "yref", "refy"),
    ),
    "speed_limit": PreviewSignal("m/s", "", _limits, ("vmax", "maxspeed", "speedlimits", "vlimit")),
}
"""Signals with distances by name, in our units; without distances they are beside the car."""
CONTROLS: Final[Mapping[str, OutputControl]] = {
    "steering": OutputControl(
        "rad",
        "wanted angle of the front wheels",
        (
            *("steeringangle", "delta", "deltaf", "steer", "steercmd", "steeringcmd", "deltacmd"),
            *("steeringcommand", "steeringanglecmd", "roadwheelangle", "frontwheelangle"),
            *("steerangle", "deltaref", "steeringrequest", "steeringanglerequest", "wheelangle"),
        ),
    ),
    "steering_share": OutputControl(
        "1", "-1..1 of the largest angle", ("steernorm", "steeringnorm")
    ),
    "curvature": OutputControl(
        "1/m", "to drive", ("kappa", "curvaturecmd", "kappacmd", "desiredcurvature", "kapparef")
    ),
    **{
        name: OutputControl(pedal.unit, pedal.about, (*pedal.names, f"{name}cmd"))
        for name, pedal in PEDALS.items()
    },
    "pedal": OutputControl("1", "-1..1: throttle above 0, brake below", ("throttlebrake",)),
    "acceleration": OutputControl(
        "m/s2",
        "along the car",
        (
            *("ax", "accel", "accelerationcmd", "accelcmd", "acccmd", "aref", "ades", "acmd"),
            *("longitudinalacceleration", "desiredacceleration", "accelerationrequest"),
        ),
    ),
}
"""Controls by name, in our units."""
LATERAL: Final = ("steering", "steering_share", "curvature")
"""Controls of which one steers, the first that is there."""
LONGITUDINAL: Final = (("throttle", "brake"), ("pedal",), ("acceleration",))
"""Controls of which one group drives, the first that is there."""

Source: TypeAlias = Callable[[Moment], list[float]]
"""Function that returns the values of the elements of an input."""


def source(name: str, distances: FloatArray) -> Source:
    """Return the function of a signal's values.

    Args:
        name: name of a signal with or without distances.
        distances: distances ahead, (n,) in m; a signal without distances has one value. Beyond the
            view the last value holds.
    """
    if name in SIGNALS:
        value = SIGNALS[name].value
        return lambda moment: [value(moment)]
    values = PREVIEWS[name].values
    positions = distances / AHEAD_SPACING
    if not positions.any():
        return lambda moment: [float(values(moment)[0])] * len(positions)

    def at_distances(moment: Moment) -> list[float]:
        ahead = values(moment)
        interpolated: list[float] = np.interp(positions, np.arange(len(ahead)), ahead).tolist()
        return interpolated

    return at_distances
