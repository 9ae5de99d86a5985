"""Half a driver, for controllers that do the other half.

Bases of drivers that only steer, or only choose their speed, and a law for controllers that only
follow a curvature.
"""

from __future__ import annotations

import math
from typing import Final, Literal, TypeAlias

from frenetic._support.bounds import Positive, check
from frenetic.drivers.builtin import Planner, SpeedPlan, SpeedPlanner, Stanley
from frenetic.drivers.driver import Controls, DriveSetup, Observation
from frenetic.errors import DriverError

LATERAL: Final = 4.0
"""Default of the lateral acceleration that a speed plan accepts in bends, in m/s^2; our choice."""
PREVIEW: Final = 0.2
"""Default of the preview of `wanted_curvature`, in s; our choice."""
RETURN_RATE: Final = 1.0
"""Default of the rate at which `wanted_curvature` returns to the lane's middle, in 1/s; ours."""
_MIN_SPEED: Final = 3.0  # [m/s] by which `wanted_curvature` divides at least; our choice
Law: TypeAlias = Literal["stanley", "planner"]
"""Name of the built-in driver by whose law a car keeps its lane."""
_KEEPERS: Final[dict[str, type[SpeedPlanner]]] = {"stanley": Stanley, "planner": Planner}


def speed_plan(setup: DriveSetup, lateral: float = LATERAL, aggression: float = 1.0) -> SpeedPlan:
    """Return the built-in drivers' speed plan.

    Args:
        setup: setup of the drive.
        lateral: lateral acceleration that is accepted in bends, in m/s^2.
        aggression: factor of ``lateral`` and of the braking before bends.
    """
    return SpeedPlan(setup, Planner(lateral_acceleration=lateral, aggression=aggression))


def lane_keeper(setup: DriveSetup, law: Law = "stanley") -> SpeedPlanner:
    """Return a built-in driver at the start of a drive, for its steering."""
    keeper = _KEEPERS[law]()
    keeper.reset(setup)
    return keeper


def acceleration_to(wanted: float, speed: float) -> float:
    """Return the acceleration, in m/s^2, by which the built-in drivers reach a speed, in m/s."""
    return SpeedPlanner.speed_gain * (wanted - speed)


def wanted_curvature(
    observation: Observation, *, preview: float = PREVIEW, rate: float = RETURN_RATE
) -> float:
    """Return the curvature, in 1/m, that keeps the car in its lane's middle.

    It is the lane's curvature a moment ahead, with a critically damped return to the middle: with
    offset y and speed v, y'' + 2 rate y' + rate^2 y = 0.

    Args:
        observation: the observation.
        preview: driving time to the point at which the lane's curvature is taken, in s.
        rate: rate at which the car returns to the middle, in 1/s.
    """
    speed = max(observation.speed, _MIN_SPEED)
    lane = observation.lane(spacing=1.0, ahead=preview * speed + 1.0)
    # y' = v sin(course), and v^2 times the curvature beyond the lane's is y''.
    course = observation.heading_error + math.atan2(observation.lateral_speed, speed)
    damped_offset = 2.0 * math.sin(course) + rate * observation.lateral_offset / speed
    curvature: float = lane.curvatures[-2:].mean() - rate * damped_offset / speed
    return curvature


class SteeringOnly:
    """Base of drivers that only steer; the car drives at the built-in drivers' planned speed.

    ::

        class FollowLane(SteeringOnly):
            def steer(self, observation):
                return ...  # rad, positive to the left

    A subclass that prepares something for each drive overrides `reset`, and calls
    ``super().reset(setup)`` there.

    Args:
        lateral: lateral acceleration that the planned speed accepts in bends, in m/s^2; with 100,
            the car keeps to the speed limit alone.
        aggression: factor of ``lateral`` and of the braking before bends.
    """

    lateral: float = LATERAL
    aggression: float = 1.0
    setup: DriveSetup
    """Setup of the present drive."""
    plan: SpeedPlan | None = None
    """Speed plan of the present drive; None before the first."""

    def __init__(self, *, lateral: Positive = LATERAL, aggression: Positive = 1.0) -> None:
        check({"lateral": lateral, "aggression": aggression}, SteeringOnly.__init__)
        self.lateral, self.aggression = lateral, aggression

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self.setup = setup
        self.plan = speed_plan(setup, self.lateral, self.aggression)

    def act(self, observation: Observation) -> Controls:
        """Return the subclass's steering with the pedals of the speed plan."""
        if self.plan is None:
            raise _reset_error(self)
        return self.plan.controls(observation, self.steer(observation))

    def steer(self, observation: Observation) -> float:
        """Return the wanted angle of the front wheels, in rad, positive to the left."""
        raise NotImplementedError(f"{type(self).__name__} needs a method steer(observation)")


class SpeedOnly:
    """Base of drivers that only choose their speed; a built-in law keeps the lane.

    ::

        class Cruise(SpeedOnly):
            def speed(self, observation):
                return ...  # m/s

    A subclass has a method `speed` or a method `acceleration`. If it prepares something for each
    drive, it overrides `reset`, and calls ``super().reset(setup)`` there.

    Args:
        law: built-in driver that steers, ``stanley`` or ``planner``.
    """

    law: Law = "stanley"
    setup: DriveSetup
    """Setup of the present drive."""
    keeper: SpeedPlanner | None = None
    """Built-in driver that steers in the present drive; None before the first."""

    def __init__(self, *, law: Law = "stanley") -> None:
        check({"law": law}, SpeedOnly.__init__)
        self.law = law

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self.setup = setup
        self.keeper = lane_keeper(setup, self.law)

    def act(self, observation: Observation) -> Controls:
        """Return the law's steering with the pedals for the subclass's acceleration."""
        if self.keeper is None:
            raise _reset_error(self)
        return Controls.from_acceleration(
            self.acceleration(observation),
            self.keeper.act(observation).steering,
            speed=observation.speed,
            setup=self.setup,
        )

    def acceleration(self, observation: Observation) -> float:
        """Return the wanted acceleration in m/s^2, by default the one that leads to `speed`."""
        return acceleration_to(self.speed(observation), observation.speed)

    def speed(self, observation: Observation) -> float:
        """Return the wanted speed, in m/s."""
        raise NotImplementedError(
            f"{type(self).__name__} needs a method speed(observation) or acceleration(observation)"
        )


def _reset_error(driver: object) -> DriverError:
    name = type(driver).__name__
    return DriverError(f"the method reset of {name} does not call super().reset(setup)")
