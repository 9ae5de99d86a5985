"""The built-in drivers."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers import laws
from frenetic.drivers.driver import Controls, DriveSetup, Observation


class BuiltIn:
    """A driver whose law is a compiled kernel; the subclasses are its parameters."""

    law: ClassVar[int]
    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it, see `frenetic.fingerprint`."""

    def parameters(self) -> FloatArray:
        """The law's parameters in the order of `frenetic.drivers.laws`."""
        raise NotImplementedError

    def reset(self, setup: DriveSetup) -> None:
        """Prepares for the next drive."""
        self._setup = laws.setup_array(setup)
        self._parameters = self.parameters()

    def act(self, observation: Observation) -> Controls:
        """The law's controls."""
        o = observation
        steering, throttle, brake = laws.decide(
            self.law,
            o.speed,
            o.yaw_rate,
            o.lateral_offset,
            o.heading_error,
            o.ahead,
            o.curvature_ahead,
            len(o.ahead),
            self._parameters,
            self._setup,
        )
        return Controls(steering, throttle, brake)


def _check(driver: object, allow_zero: tuple[str, ...] = ()) -> None:
    """Raises ValueError unless every number of a driver is finite and positive."""
    for item in fields(driver):  # type: ignore[arg-type]
        value = getattr(driver, item.name)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{item.name} is {value!r}: a number is needed")
        least_fits = value >= 0.0 if item.name in allow_zero else value > 0.0
        if not (math.isfinite(value) and least_fits):
            allowed = "a number of 0 or more" if item.name in allow_zero else "a positive number"
            raise ValueError(f"{item.name} is {value}: {allowed} is needed")


@dataclass
class SpeedPlanner(BuiltIn):
    """The speed plan that the built-in drivers share: a speed for the curves in view."""

    aggression: float = 1.0
    """Scales both budgets; much more than 1 asks for more than the tyres can give."""
    lateral_acceleration: float = 8.0
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: float = 2.2
    """Deceleration before curves, in m/s^2 at aggression 1."""
    smoothing: float = 4.0
    """Length of road on each side over which a curve's curvature is averaged, in m."""
    speed_gain: float = 1.5
    """Acceleration per m/s of speed error, in 1/s."""

    may_be_zero: ClassVar[tuple[str, ...]] = ("smoothing",)

    def __post_init__(self) -> None:
        _check(self, self.may_be_zero)

    def plan(self) -> list[float]:
        """The parameters of the speed plan, the first of every law."""
        return [
            self.aggression * self.lateral_acceleration,
            self.aggression * self.braking,
            self.speed_gain,
            round(self.smoothing / laws.SPACING),
        ]


@dataclass
class Planner(SpeedPlanner):
    """A driver that knows the road ahead as BeamNG.AI does, and steers by pure pursuit.

    Its speed keeps lateral acceleration on the road ahead within one budget, and braking before a
    curve within another. It averages a curve over a short window and cuts the corner a little, so
    it has weak spots: short sharp bends, and bends that follow each other closely, at the end of a
    fast stretch.
    """

    law: ClassVar[int] = laws.PLANNER
    BEHAVIOUR: ClassVar[int] = 1

    lookahead_time: float = 0.3
    """Driving time to the point that is steered for, in s."""
    lookahead_min: float = 5.0
    """Lookahead distance at rest, in m."""

    may_be_zero: ClassVar[tuple[str, ...]] = ("smoothing", "lookahead_time")

    def parameters(self) -> FloatArray:
        """The parameters of `laws.planner`."""
        return np.array([*self.plan(), self.lookahead_time, self.lookahead_min])


@dataclass
class Stanley(SpeedPlanner):
    """Plans its speed like `Planner` and steers by Stanley's law (Hoffmann et al., ACC 2007)."""

    law: ClassVar[int] = laws.STANLEY
    BEHAVIOUR: ClassVar[int] = 1

    lateral_acceleration: float = 6.0
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: float = 2.8
    """Deceleration before curves, in m/s^2 at aggression 1."""
    offset_gain: float = 1.5
    """Rate at which a lateral offset is corrected, in 1/s."""
    softening: float = 2.0
    """Speed that keeps the steering calm at low speed, in m/s."""
    yaw_damping: float = 0.05
    """Gain of steering against yaw rate beyond the road's, in s."""

    may_be_zero: ClassVar[tuple[str, ...]] = ("smoothing", "yaw_damping")

    def parameters(self) -> FloatArray:
        """The parameters of `laws.stanley`."""
        return np.array([*self.plan(), self.offset_gain, self.softening, self.yaw_damping])


@dataclass
class BeamngAi(Planner):
    """The planner, tuned to rank roads as BeamNG.AI fares on them in BeamNG.tech.

    BeamNG.AI had driven them with risk factor 1.5 and a limit of 120 km/h on 5 m lanes, oob
    tolerance 0.5. The values were found by differential evolution on 93 recorded runs, in the
    embedded simulator under the same rules and with its default car. Its -MOOBD ranks the runs with
    a ROC AUC of 0.74 against FAIL, but tuned on four fifths of the runs and scored on the others,
    only of 0.63 on average (0.55 for `Planner`, 0.68 for the road's length alone). So it is a fast
    driver that leaves the lane in places like those where BeamNG.AI does, not a forecast of
    outcomes. `docs/beamng-ai.md` has the figures, `benchmarks/beamng_ai.py` the tuning.

    The simulator of BeamNG.tech replaces this driver by BeamNG.AI itself and never asks it.
    """

    law: ClassVar[int] = laws.PLANNER
    BEHAVIOUR: ClassVar[int] = 1

    lateral_acceleration: float = 6.44
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: float = 6.1
    """Deceleration before curves, in m/s^2 at aggression 1."""
    smoothing: float = 4.0
    """Length of road on each side over which a curve's curvature is averaged, in m."""
    lookahead_time: float = 0.454
    """Driving time to the point that is steered for, in s."""
    lookahead_min: float = 2.19
    """Lookahead distance at rest, in m."""
    speed_gain: float = 0.517
    """Acceleration per m/s of speed error, in 1/s."""
