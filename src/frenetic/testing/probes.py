"""Drivers that record how a simulator treats them."""

from __future__ import annotations

import math
from dataclasses import replace

from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation


class Watch:
    """Drives as another driver does, and keeps its setups, observations and answers.

    Args:
        driver: the other driver.
    """

    def __init__(self, driver: Driver) -> None:
        self.driver = driver
        self.setups: list[DriveSetup] = []
        """Its setups, drive by drive."""
        self.seen: list[Observation] = []
        """Its observations in the last drive."""
        self.given: list[Controls] = []
        """Its answers in the last drive."""

    def reset(self, setup: DriveSetup) -> None:
        """Another drive."""
        self.setups.append(setup)
        self.seen, self.given = [], []
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """The other driver's controls."""
        self.seen.append(observation)
        self.given.append(self.driver.act(observation))
        return self.given[-1]


class Weaving:
    """Keeps its lane as another driver does, but weaves in it, and brakes for a while.

    So everything that it sees and does changes.

    Args:
        driver: the driver that keeps the lane.
    """

    def __init__(self, driver: Driver) -> None:
        self.driver = driver

    def reset(self, setup: DriveSetup) -> None:
        """Another drive."""
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """The other driver's controls, with a little more steering to either side in turn."""
        controls = self.driver.act(observation)
        time = observation.time
        controls = replace(controls, steering=controls.steering + 0.03 * math.sin(math.pi * time))
        return replace(controls, throttle=0.0, brake=0.3) if 2.5 <= time < 3.5 else controls


class Circling:
    """Drives straight ahead and slowly, then steers to the left and keeps that angle."""

    angle = 0.15
    """Angle asked of the front wheels, in rad."""

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002
        """Another drive."""
        self.turns = False

    def act(self, observation: Observation) -> Controls:
        """Keeps to 3 m/s."""
        speed = observation.speed
        self.turns = self.turns or speed >= 2.5
        return Controls(
            self.angle if self.turns else 0.0,
            throttle=0.3 if speed < 3.0 else 0.0,
            brake=0.2 if speed > 3.5 else 0.0,
        )


class Broken:
    """Raises in the middle of its drive."""

    message = "no idea where I am"

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002
        """Another drive."""
        self.calls = 0

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002
        """Drives off, then raises."""
        self.calls += 1
        if self.calls > 5:
            raise RuntimeError(self.message)
        return Controls(0.0, throttle=0.3)
