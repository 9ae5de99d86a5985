"""The built-in drivers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import NotNegative, Positive, check
from frenetic._support.scalars import take_numpy_scalars
from frenetic.drivers import laws
from frenetic.drivers.driver import Controls, DriveSetup, Observation
from frenetic.drivers.elastic_band import MEMORY
from frenetic.road.classes import GRAVITY


def limits_of(observation: Observation, setup: FloatArray) -> FloatArray:
    """Return speed limits at the points ahead, (n,) in m/s; if not observed, the start's."""
    rows = len(observation.curvature_ahead)
    if len(observation.speed_limit_ahead) >= rows:
        return np.array(observation.speed_limit_ahead)
    return np.full(rows, setup[laws.SPEED_LIMIT])


class BuiltIn:
    """A driver whose law is a compiled kernel; the subclasses are its parameters."""

    law: ClassVar[int]
    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it, see `frenetic.parts.versions`."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        built_in = next(kind for kind in type(self).__mro__ if kind.__module__ == __name__)
        check(vars(self), built_in)

    def parameters(self) -> FloatArray:
        """Return the law's parameters in the order of `frenetic.drivers.laws`."""
        raise NotImplementedError

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self._setup = laws.setup_array(setup)
        self._parameters = self.parameters()
        self._memory = np.zeros(MEMORY)

    def act(self, observation: Observation) -> Controls:
        """Return the law's controls."""
        o = observation
        # Copies of the kind of array for which the rollout has compiled the kernels.
        ahead, curvature_ahead = np.array(o.ahead, order="C"), np.array(o.curvature_ahead)
        limit_ahead = limits_of(o, self._setup)
        steering, throttle, brake = laws.decide(
            self.law,
            o.speed,
            o.yaw_rate,
            o.distance,
            o.lateral_offset,
            o.heading_error,
            ahead,
            curvature_ahead,
            limit_ahead,
            len(ahead),
            self._parameters,
            self._setup,
            self._memory,
        )
        return Controls(steering, throttle, brake)


@dataclass
class SpeedPlanner(BuiltIn):
    """The speed plan that built-in drivers share: a speed for the curves in view."""

    aggression: Positive = 1.0
    """Scales both budgets; much more than 1 asks for more than the tyres can give."""
    lateral_acceleration: Positive = 8.0
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: Positive = 2.2
    """Deceleration before curves, in m/s^2 at aggression 1."""
    smoothing: NotNegative = 4.0
    """Length of road on each side over which a curve's curvature is averaged, in m."""
    speed_gain: Positive = 1.5
    """Acceleration per m/s of speed error, in 1/s."""

    def plan(self) -> list[float]:
        """Return the parameters of the speed plan, the first of every law."""
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

    lookahead_time: NotNegative = 0.3
    """Driving time to the point that is steered for, in s."""
    lookahead_min: Positive = 5.0
    """Lookahead distance at rest, in m."""

    def parameters(self) -> FloatArray:
        """Return the parameters of `laws.planner`."""
        return np.array([*self.plan(), self.lookahead_time, self.lookahead_min])


@dataclass
class Stanley(SpeedPlanner):
    """A driver that plans its speed like `Planner` and steers by Stanley's law.

    Source: Hoffmann et al., ACC 2007.
    """

    law: ClassVar[int] = laws.STANLEY
    BEHAVIOUR: ClassVar[int] = 1

    lateral_acceleration: Positive = 6.0
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: Positive = 2.8
    """Deceleration before curves, in m/s^2 at aggression 1."""
    offset_gain: Positive = 1.5
    """Rate at which a lateral offset is corrected, in 1/s."""
    softening: Positive = 2.0
    """Speed that keeps the steering calm at low speed, in m/s."""
    yaw_damping: NotNegative = 0.05
    """Gain of steering against yaw rate beyond the road's, in s."""

    def parameters(self) -> FloatArray:
        """Return the parameters of `laws.stanley`."""
        return np.array([*self.plan(), self.offset_gain, self.softening, self.yaw_damping])


class SpeedPlan:
    """The built-in drivers' speed and pedals, for a driver that only steers.

    ::

        def reset(self, setup):
            self.plan = SpeedPlan(setup)

        def act(self, observation):
            return self.plan.controls(observation, steering=...)

    It keeps lateral acceleration in the curves of `Observation.ahead` within one budget, braking
    before them within another, and the speed limit.

    Args:
        setup: The setup with which the driver was reset.
        driver: Driver whose budgets count, such as ``Planner(aggression=0.8)``; by default
            `Planner`.
    """

    def __init__(self, setup: DriveSetup, driver: SpeedPlanner | None = None) -> None:
        self._setup = laws.setup_array(setup)
        self._parameters = np.array((driver or Planner()).plan())

    def speed(self, observation: Observation) -> float:
        """Return the speed planned for now, in m/s."""
        curvature_ahead = np.array(observation.curvature_ahead)
        wanted: float = laws.planned_speed(
            curvature_ahead,
            limits_of(observation, self._setup),
            len(curvature_ahead),
            self._parameters[laws.LATERAL],
            self._parameters[laws.BRAKING],
            int(self._parameters[laws.SMOOTHING]),
        )
        return wanted

    def controls(self, observation: Observation, steering: float) -> Controls:
        """Return this steering, in rad, with pedals that bring the car to the planned speed."""
        curvature_ahead = np.array(observation.curvature_ahead)
        throttle, brake = laws.planned_pedals(
            float(observation.speed),
            curvature_ahead,
            limits_of(observation, self._setup),
            len(curvature_ahead),
            self._parameters,
            self._setup,
        )
        return Controls(steering, throttle, brake)


@dataclass
class BeamngAi(BuiltIn):
    """A model of BeamNG.AI as it drives in its lane: an elastic band, a speed plan, look-ahead.

    `frenetic.drivers.elastic_band` says how it drives, `docs/beamng-ai.md` how well it follows
    recorded drives and where the values come from. They are fitted together with the car
    ``etk800`` of the embedded simulator, which it brings there. Roads are ranked by
    `Result.max_oob_share`.

    The simulator of BeamNG.tech replaces this driver by BeamNG.AI itself and never asks it.
    """

    law: ClassVar[int] = laws.BEAMNG_AI
    BEHAVIOUR: ClassVar[int] = 2
    VEHICLE: ClassVar[str] = "etk800"
    """Car that the driver brings to an embedded simulator for which no car was chosen."""

    aggression: Positive = 0.7
    """Share of grip used in bends, as BeamNG.AI's option; values beyond `grip` count as `grip`."""
    grip: Positive = 1.0
    """Friction of the tyres, as far as the driver knows."""
    curve_speed: Positive = 1.0
    """Planned lateral acceleration in bends, per min(aggression, grip) g."""
    braking: Positive = 6.9
    """Deceleration planned before bends, in m/s^2."""
    node_spacing: Positive = 2.0
    """Distance between the road's nodes, in lane widths; in BeamNG.tech, the width of the road."""
    band_strength: NotNegative = 115.0
    """Speed at which a node is drawn to the inside of its turn, in m/s per 1 - cos of the turn."""
    band_recoil: NotNegative = 0.35
    """Share of a node's draw by which both its neighbours are pushed outwards."""
    clearance: Positive = 0.84
    """Distance of the plan from the edges of the lane, in car widths."""
    forgiveness: NotNegative = 0.87
    """Share of the distance to the plan by which the plan moves to the car in a second, in 1/s."""
    lookahead_time: NotNegative = 0.63
    """Driving time to the point that is steered for, in s."""
    lookahead_min: Positive = 4.5
    """Least distance to the point that is steered for, in m."""
    aiming_point: Positive = 4.7
    """Place of the car that is led to that point, in m ahead of the rear axle: its front."""
    steering_gain: Positive = 0.6
    """Angle of the front wheels per angle to the point that is steered for."""
    throttle_gain: Positive = 0.5
    """Throttle per m/s that is missing beyond `speed_slack`, in s/m."""
    speed_slack: NotNegative = 1.0
    """Speed that may be missing without throttle, in m/s."""
    brake_gain: Positive = 1.0
    """Brake per m/s too much, in s/m."""

    def parameters(self) -> FloatArray:
        """Return the parameters of `frenetic.drivers.elastic_band`."""
        # The fields are in the order of the kernel's parameters.
        aggression, grip, curve_speed, *others = (getattr(self, item.name) for item in fields(self))
        return np.array([curve_speed * min(aggression, grip) * GRAVITY, *others])
