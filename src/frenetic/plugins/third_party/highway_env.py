"""HighwayEnv's `ControlledVehicle` (E. Leurent and others, MIT licence)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.plugins.third_party import LATERAL, package, speed_plan


class HighwayEnv:
    """HighwayEnv's ControlledVehicle: a heading loop within a position loop, and its speed loop.

    The glue tells it the car's wheelbase, which its own vehicle takes to be its length, 5 m.

    Args:
        lateral: m/s^2, lateral acceleration that the planned speed keeps to in bends.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("highway-env",)
    """Distributions whose versions belong to it."""

    def __init__(self, *, lateral: Positive = LATERAL) -> None:
        check(locals(), HighwayEnv.__init__)
        self.options = {"lateral": float(lateral)}
        self._road = package("highway_env.road.road", "highway-env")
        self._controller = package("highway_env.vehicle.controller", "highway-env")

    def reset(self, setup: DriveSetup) -> None:
        """Put its vehicle onto an endless lane."""
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
    """The lane as its vehicle asks about it: distance ahead of the car, offset to the left."""

    observation: Observation | None = None

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
