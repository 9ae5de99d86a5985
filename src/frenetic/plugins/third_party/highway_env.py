"""The driver of HighwayEnv's `ControlledVehicle` (E. Leurent and others, MIT licence)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.drivers.half_drivers import LATERAL, speed_plan
from frenetic.plugins.third_party import package


class HighwayEnv:
    """HighwayEnv's ControlledVehicle: a heading loop within a position loop, and a speed loop.

    The controller takes its vehicle's length, 5 m, as the wheelbase. The glue sets it to the
    wheelbase of the car that is driven.

    Args:
        lateral: largest lateral acceleration of the planned speed in bends, in m/s^2.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, increased when the controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("highway-env",)
    """Distributions whose versions belong to the behaviour, too."""

    def __init__(self, *, lateral: Positive = LATERAL) -> None:
        check(locals(), HighwayEnv.__init__)
        self.options = {"lateral": float(lateral)}
        self._road = package("highway_env.road.road", "highway-env")
        self._controller = package("highway_env.vehicle.controller", "highway-env")

    def reset(self, setup: DriveSetup) -> None:
        """Put the controller's vehicle onto a lane without end."""
        self._setup, self._plan = setup, speed_plan(setup, self.options["lateral"])
        self._lane, network = _HighwayLane(), self._road.RoadNetwork()
        network.add_lane("here", "there", self._lane)
        self._vehicle = self._controller.ControlledVehicle(self._road.Road(network), (0.0, 0.0))
        self._vehicle.LENGTH = setup.wheelbase

    def act(self, observation: Observation) -> Controls:
        """Return steering and acceleration, in the car's frame."""
        self._lane.observation = observation
        self._vehicle.speed = observation.speed
        self._vehicle.target_speed = self._plan.speed(observation)
        self._vehicle.act()
        acceleration, steering = (self._vehicle.action[k] for k in ("acceleration", "steering"))
        return Controls.from_acceleration(
            float(acceleration), float(steering), speed=observation.speed, setup=self._setup
        )


class _HighwayLane:
    """The ego lane with the methods of a HighwayEnv lane that the controller calls.

    Its coordinates are the distance ahead of the car along the lane, and the offset to the left.
    """

    observation: Observation | None = None
    """Latest observation; None before the first call of `HighwayEnv.act`."""

    def local_coordinates(self, _: object) -> tuple[float, float]:
        return 0.0, 0.0 if self.observation is None else self.observation.lateral_offset

    def heading_at(self, ahead: float) -> float:
        assert self.observation is not None
        lane = self.observation.lane(spacing=0.5, ahead=abs(ahead) + 0.5)
        return float(np.interp(ahead, lane.distances, lane.headings))

    def after_end(self, _: object) -> bool:
        return False

    def distance_with_heading(self, *_: object) -> float:
        return 0.0
