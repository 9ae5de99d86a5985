"""Drivers that record how a simulator treats them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from frenetic.drivers import Driver, DriveSetup, Observation
from frenetic.drivers.driver import Controls

ERROR_TEXT = "no idea where I am"
"""Message of the error that `breaking` raises."""

Change: TypeAlias = Callable[[list[Observation], Controls], Controls]
"""Function of a drive's observations so far and a driver's controls to the changed controls."""


class Watch:
    """Drives as another driver does, and records its setups, observations and answers.

    Args:
        driver: the other driver.
        change: what replaces its controls; none by default.
    """

    def __init__(self, driver: Driver, change: Change = lambda _, controls: controls) -> None:
        self.driver = driver
        self.change = change
        self.setups: list[DriveSetup] = []
        """Setups, drive by drive."""
        self.observations: list[Observation] = []
        """Observations in the last drive."""
        self.answers: list[Controls] = []
        """Controls answered in the last drive, one for each observation."""

    def reset(self, setup: DriveSetup) -> None:
        """Begin another drive."""
        self.setups.append(setup)
        self.observations, self.answers = [], []
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the other driver's controls, changed."""
        self.observations.append(observation)
        self.answers.append(self.change(self.observations, self.driver.act(observation)))
        return self.answers[-1]


def weaving(observations: list[Observation], controls: Controls) -> Controls:
    """Steer a little to either side in turn and brake for a while, so that everything changes."""
    time = observations[-1].time
    controls = replace(controls, steering=controls.steering + 0.03 * math.sin(math.pi * time))
    return replace(controls, throttle=0.0, brake=0.3) if 2.5 <= time < 3.5 else controls


def circling(observations: list[Observation], _: Controls) -> Controls:
    """Drive straight ahead, slowly, then to the left by a steady angle at 3 m/s."""
    speed = observations[-1].speed
    turns = any(observation.speed >= 2.5 for observation in observations)
    return Controls(0.15 if turns else 0.0, 0.3 if speed < 3.0 else 0.0, 0.2 * (speed > 3.5))


def breaking(observations: list[Observation], controls: Controls) -> Controls:
    """Return the controls unchanged, and raise at the sixth observation of a drive."""
    if len(observations) > 5:
        raise RuntimeError(ERROR_TEXT)
    return controls
