"""The built-in drivers: parameters for the compiled laws of `frenetic.drivers.laws`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import NotNegative, Positive, check
from frenetic._support.scalars import take_numpy_scalars
from frenetic.drivers import laws
from frenetic.drivers.driver import Controls, DriveSetup, Observation
from frenetic.road.classes import GRAVITY


def speed_limits_ahead(observation: Observation, setup: FloatArray) -> FloatArray:
    """Return the speed limits at the points ahead, (n,) in m/s.

    They are the limit at the start if the simulator does not observe limits.

    Args:
        observation: the observation.
        setup: array that `laws.setup_array` makes of the `DriveSetup`.
    """
    rows = len(observation.curvature_ahead)
    if len(observation.speed_limit_ahead) >= rows:
        return np.array(observation.speed_limit_ahead)
    return np.full(rows, setup[laws.SPEED_LIMIT])


class BuiltIn:
    """Base of drivers whose law is a compiled kernel. A subclass has the law's parameters."""

    law: ClassVar[int]
    """Number of the law, see `laws.decide`."""
    BEHAVIOUR: ClassVar[int] = 1
    """Version of the driver: increase it when its controls change. Campaigns record it, see
    `frenetic.parts.versions`."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)
        # Check the fields of the class in this module: a user's subclass may have others.
        built_in = next(kind for kind in type(self).__mro__ if kind.__module__ == __name__)
        check(vars(self), built_in)

    def parameters(self) -> FloatArray:
        """Return the law's parameters in the order of `frenetic.drivers.laws`."""
        raise NotImplementedError

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self._setup = laws.setup_array(setup)
        self._parameters = self.parameters()
        memories = laws.new_memory(self.law, 1)
        self._memory = None if memories is None else memories[0]

    def act(self, observation: Observation) -> Controls:
        """Return the law's controls."""
        # Copies of the kind of array for which the rollout has compiled the kernels.
        ahead = np.array(observation.ahead, order="C")
        curvature_ahead = np.array(observation.curvature_ahead)
        steering, throttle, brake = laws.decide(
            self.law,
            observation.speed,
            observation.yaw_rate,
            observation.distance,
            observation.lateral_offset,
            observation.heading_error,
            ahead,
            curvature_ahead,
            speed_limits_ahead(observation, self._setup),
            len(ahead),
            self._parameters,
            self._setup,
            self._memory,
        )
        return Controls(steering, throttle, brake)


@dataclass
class SpeedPlanner(BuiltIn):
    """Base of built-in drivers that plan a speed for the curves in view, see `SpeedPlan`."""

    aggression: Positive = 1.0
    """Factor of `lateral_acceleration` and `braking`; much more than 1 asks for more than the tyres
    can give."""
    lateral_acceleration: Positive = 8.0
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: Positive = 2.2
    """Deceleration before curves, in m/s^2 at aggression 1."""
    smoothing: NotNegative = 4.0
    """Length of road on each side over which a curve's curvature is averaged, in m."""
    speed_gain: Positive = 1.5
    """Acceleration per m/s of speed error, in 1/s."""

    def plan(self) -> list[float]:
        """Return the parameters of the speed plan, which come first in `parameters`."""
        return [
            self.aggression * self.lateral_acceleration,
            self.aggression * self.braking,
            self.speed_gain,
            round(self.smoothing / laws.SPACING),
        ]


@dataclass
class Planner(SpeedPlanner):
    """A driver that knows the road ahead as BeamNG.AI does, and steers by pure pursuit.

    Its speed keeps the lateral acceleration on the road ahead, and the braking before a curve,
    within limits. It averages a curve's curvature over a short window and cuts the corner a little,
    so it has weak spots: short sharp bends, and bends in close succession, at the end of a fast
    stretch.
    """

    law: ClassVar[int] = laws.PLANNER
    BEHAVIOUR: ClassVar[int] = 2

    lookahead_time: NotNegative = 0.3
    """Driving time to the point to which the car steers, in s."""
    lookahead_min: Positive = 5.0
    """Distance to that point at rest, in m; `lookahead_time` adds to it."""

    def parameters(self) -> FloatArray:
        """Return the parameters of `laws.planner`."""
        return np.array([*self.plan(), self.lookahead_time, self.lookahead_min])


@dataclass
class Stanley(SpeedPlanner):
    """A driver that plans its speed like `Planner` and steers by Stanley's law.

    Source: Hoffmann et al., ACC 2007.
    """

    law: ClassVar[int] = laws.STANLEY
    BEHAVIOUR: ClassVar[int] = 2

    lateral_acceleration: Positive = 6.0
    """Lateral acceleration in curves, in m/s^2 at aggression 1."""
    braking: Positive = 2.8
    """Deceleration before curves, in m/s^2 at aggression 1."""
    offset_gain: Positive = 1.5
    """Rate at which a lateral offset is corrected, in 1/s."""
    softening: Positive = 2.0
    """Speed that is added to the car's speed in the correction of the lateral offset, in m/s: it
    keeps the steering calm at low speed."""
    yaw_damping: NotNegative = 0.05
    """Steering angle per yaw rate in excess of the road's, against the yaw, in s."""

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

    The planned speed keeps the speed limit, and keeps the lateral acceleration in the curves of
    `Observation.ahead`, and the braking before them, within limits.

    Args:
        setup: the setup with which the driver was reset.
        driver: driver whose limits hold, such as ``Planner(aggression=0.8)``; by default
            `Planner`.
    """

    def __init__(self, setup: DriveSetup, driver: SpeedPlanner | None = None) -> None:
        self._setup = laws.setup_array(setup)
        self._parameters = np.array((driver or Planner()).plan())

    def speed(self, observation: Observation) -> float:
        """Return the speed that the plan has for the car's present position, in m/s."""
        curvature_ahead = np.array(observation.curvature_ahead)
        speed: float = laws.planned_speed(
            curvature_ahead,
            speed_limits_ahead(observation, self._setup),
            len(curvature_ahead),
            self._parameters[laws.LATERAL],
            self._parameters[laws.BRAKING],
            int(self._parameters[laws.SMOOTHING]),
        )
        return speed

    def controls(self, observation: Observation, steering: float) -> Controls:
        """Return controls with this steering in rad, and pedals that lead to the planned speed."""
        curvature_ahead = np.array(observation.curvature_ahead)
        throttle, brake = laws.planned_pedals(
            float(observation.speed),
            curvature_ahead,
            speed_limits_ahead(observation, self._setup),
            len(curvature_ahead),
            self._parameters,
            self._setup,
        )
        return Controls(steering, throttle, brake)


@dataclass
class BeamngAi(BuiltIn):
    """A model of BeamNG.AI as it drives in its lane: an elastic band, a speed plan, look-ahead.

    `frenetic.drivers.elastic_band` describes its law, and `docs/beamng-ai.md` how well it follows
    recorded drives and where the default values come from. The values are fitted together with the
    car ``etk800``, which the embedded simulator therefore uses for this driver by default.

    The simulator of BeamNG.tech uses BeamNG.AI itself in place of this driver, and never calls it.
    """

    law: ClassVar[int] = laws.BEAMNG_AI
    BEHAVIOUR: ClassVar[int] = 3
    VEHICLE: ClassVar[str] = "etk800"
    """Car that the embedded simulator uses for this driver if the user chooses no car."""

    aggression: Positive = 0.7
    """Lateral acceleration used in bends, in g, as BeamNG.AI's option; values beyond `grip` count
    as `grip`."""
    grip: Positive = 1.0
    """Friction of the tyres that the driver assumes."""
    curve_speed: Positive = 1.0
    """Factor of the lateral acceleration planned in bends, which is this times
    min(aggression, grip) g."""
    braking: Positive = 6.9
    """Deceleration planned before bends, in m/s^2."""
    node_spacing: Positive = 2.0
    """Distance between the road's nodes, in lane widths. In BeamNG.tech it is the road's width."""
    band_strength: NotNegative = 115.0
    """Speed at which a node is drawn to the inside of its turn, in m/s, per 1 - cos(turn)."""
    band_recoil: NotNegative = 0.35
    """Share of a node's move by which both its neighbours are pushed to the outside."""
    clearance: Positive = 0.84
    """Distance of the plan from the edges of the lane, in car widths."""
    forgiveness: NotNegative = 0.87
    """Share of the distance to the plan by which the plan moves to the car in a second, in 1/s."""
    lookahead_time: NotNegative = 0.63
    """Driving time to the point to which the car steers, in s."""
    lookahead_min: Positive = 4.5
    """Least distance to the point to which the car steers, in m."""
    aiming_point: Positive = 4.7
    """Distance from the rear axle to the car's front, which is led to that point, in m."""
    steering_gain: Positive = 0.6
    """Angle of the front wheels per angle between the car and the direction to that point."""
    throttle_gain: Positive = 0.5
    """Throttle per m/s by which the car is slower than planned, beyond `speed_slack`, in s/m."""
    speed_slack: NotNegative = 1.0
    """Speed by which the car may be slower than planned without throttle, in m/s."""
    brake_gain: Positive = 1.0
    """Brake per m/s by which the car is faster than planned, in s/m."""

    def parameters(self) -> FloatArray:
        """Return the parameters of `frenetic.drivers.elastic_band`."""
        # The fields are in the order of the kernel's parameters.
        aggression, grip, curve_speed, *others = (getattr(self, item.name) for item in fields(self))
        return np.array([curve_speed * min(aggression, grip) * GRAVITY, *others])
