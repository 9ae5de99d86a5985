"""MetaDrive's policies, which decide on the car's controls inside MetaDrive's world."""

from __future__ import annotations

from typing import Any, Protocol

from metadrive.obs.state_obs import LidarStateObservation
from metadrive.policy.idm_policy import IDMPolicy

from frenetic.plugins.metadrive.car import Decision
from frenetic.plugins.metadrive.drivers import MetaDriveDriver, MetaDriveIdm, ObservingDriver
from frenetic.plugins.metadrive.world import SEED, World


class Policy(Protocol):
    """A driver that looks at MetaDrive's world instead of an `Observation`."""

    def act(self, speed_limit: float) -> Decision:
        """Return the controls until the next call, under a speed limit in km/h."""

    def close(self) -> None:
        """End the policy."""


class Idm:
    """Policy of `MetaDriveIdm`: MetaDrive's `IDMPolicy`, with a target speed in km/h."""

    def __init__(self, world: World, target_speed: float) -> None:
        self._vehicle = world.vehicle
        self._policy = IDMPolicy(world.vehicle, SEED)
        self._target_speed = target_speed  # km/h

    def act(self, speed_limit: float) -> Decision:
        """Return the decision of MetaDrive's policy."""
        self._policy.target_speed = min(self._target_speed, speed_limit)
        self._vehicle.after_step()  # makes MetaDrive find the car on the road
        return _decision(self._policy.act())

    def close(self) -> None:
        """End the policy."""
        self._policy.destroy()


class Observing:
    """Policy of an `ObservingDriver`, which gets MetaDrive's own observation."""

    def __init__(self, world: World, driver: ObservingDriver) -> None:
        self._mean_action = driver.mean_action
        self._vehicle = world.vehicle
        self._observation = LidarStateObservation(world.engine.global_config)

    def act(self, speed_limit: float) -> Decision:  # noqa: ARG002
        """Return the decision by the driver's mean action."""
        self._vehicle.after_step()  # makes MetaDrive find the car on the road
        return _decision(self._mean_action(self._observation.observe(self._vehicle)))

    def close(self) -> None:
        """End the observation."""
        self._observation.destroy()


def make_policy(driver: MetaDriveDriver, world: World) -> Policy:
    """Return a driver's policy for the car in MetaDrive's world."""
    if isinstance(driver, MetaDriveIdm):
        return Idm(world, driver.target_speed)
    assert isinstance(driver, ObservingDriver)
    return Observing(world, driver)


def _decision(action: Any) -> Decision:
    """Return the controls of an action, each value of which is cut to -1..1."""
    return Decision.of_action(*(min(max(float(value), -1.0), 1.0) for value in action))
