"""Scenic's lane following by PID, after CARLA's (D. Fremont and others, BSD licence)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import ClassVar

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.shelf import LATERAL, package, speed_plan


class Scenic:
    """Scenic's PID controllers for following a lane with a car, with the gains that it gives them.

    The steering sees nothing but the distance from the lane's centre. The glue takes Scenic's full
    lock for that of the car; Scenic itself leaves it to its simulators.

    Args:
        lateral: m/s^2, lateral acceleration that the planned speed keeps to in bends.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("scenic",)
    """Distributions whose versions belong to it."""

    period: ClassVar[float] = 0.1
    """s: the time step of Scenic's driving simulators."""

    def __init__(self, *, lateral: Positive = LATERAL) -> None:
        check(locals(), Scenic.__init__)
        self.options = {"lateral": float(lateral)}
        self._simulation = package("scenic.domains.driving.simulators", "scenic").DrivingSimulation
        self._action = package("scenic.domains.driving.actions", "scenic").RegulatedControlAction

    def reset(self, setup: DriveSetup) -> None:
        """Makes both controllers."""
        self._setup, self._plan = setup, speed_plan(setup, self.options["lateral"])
        self._along, self._across = self._simulation.getLaneFollowingControllers(
            SimpleNamespace(timestep=self.period), SimpleNamespace(isCar=True)
        )
        self._steering = 0.0

    def act(self, observation: Observation) -> Controls:
        """Their answers, regulated as Scenic's behaviours do it; positive steers to the right."""
        pedal = self._along.run_step(self._plan.speed(observation) - observation.speed)
        steering = float(self._across.run_step(observation.lateral_offset))
        action = self._action(float(pedal), steering, self._steering)
        self._steering = steering
        return Controls(-action.steer * self._setup.max_steering, action.throttle, action.brake)
