"""A driver that records what a simulator shows it, and changes of its controls for tests."""

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
"""Function of a drive's observations so far and a driver's controls; returns other controls."""


class Watch:
    """A wrapper that records setups, observations and answers of a driver.

    Args:
        driver: the driver under the wrapper.
        change: function that changes the driver's controls; by default they stay.
    """

    def __init__(self, driver: Driver, change: Change = lambda _, controls: controls) -> None:
        self.driver = driver
        self.change = change
        self.setups: list[DriveSetup] = []
        """Setups of all drives, in their order."""
        self.observations: list[Observation] = []
        """Observations of the last drive."""
        self.answers: list[Controls] = []
        """Controls answered in the last drive, one for each observation."""

    def reset(self, setup: DriveSetup) -> None:
        """Begin a drive: record its setup, and forget the observations of the last drive."""
        self.setups.append(setup)
        self.observations, self.answers = [], []
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the changed controls of the driver."""
        self.observations.append(observation)
        self.answers.append(self.change(self.observations, self.driver.act(observation)))
        return self.answers[-1]


def weaving(observations: list[Observation], controls: Controls) -> Controls:
    """Add a weaving of the steering, and brake for a second, so that all signals change."""
    time = observations[-1].time
    controls = replace(controls, steering=controls.steering + 0.03 * math.sin(math.pi * time))
    return replace(controls, throttle=0.0, brake=0.3) if 2.5 <= time < 3.5 else controls


def circling(observations: list[Observation], _: Controls) -> Controls:
    """Drive straight ahead up to 2.5 m/s, then to the left by a steady angle at about 3 m/s."""
    speed = observations[-1].speed
    turns = any(observation.speed >= 2.5 for observation in observations)
    return Controls(
        steering=0.15 if turns else 0.0,
        throttle=0.3 if speed < 3.0 else 0.0,
        brake=0.2 if speed > 3.5 else 0.0,
    )


def breaking(observations: list[Observation], controls: Controls) -> Controls:
    """Return the controls unchanged, and raise at the sixth observation of a drive."""
    if len(observations) > 5:
        raise RuntimeError(ERROR_TEXT)
    return controls
