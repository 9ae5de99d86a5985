"""MetaDrive's own drivers as systems under test.

In MetaDrive they look at its world instead of an `Observation`: `MetaDriveSimulator` recognises
them and lets MetaDrive's policies act, see `policies` beside this module. The expert drives
elsewhere, too: an `Observation` has all that it sees on an empty road, see `expert`.
"""

from __future__ import annotations

import math
from typing import ClassVar, NoReturn

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.driver import under_layers
from frenetic.errors import DriverError
from frenetic.metadrive.car import VEHICLE, Decision
from frenetic.metadrive.expert import mean_action, state_of, weights
from frenetic.simulators.simulator import Simulator


class PolicySimulator:
    """Base of a simulator that lets MetaDrive's policies act."""


class MetaDriveDriver:
    """A policy that comes with MetaDrive; the subclasses are its options."""

    name: ClassVar[str]
    """Name in the registry."""
    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("metadrive-simulator",)
    """Distributions whose versions belong to it."""

    def check_simulator(self, simulator: Simulator) -> None:
        """Refuses simulators that do not know MetaDrive's drivers.

        Raises:
            DriverError: the simulator does not know them.
        """
        if not isinstance(simulator, PolicySimulator):
            self._refuse()

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002 - asked by a foreign simulator
        """Refuses: see `act`.

        Raises:
            DriverError: always.
        """
        self._refuse()

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002
        """Refuses, because a simulator that asks for controls is not MetaDrive.

        Raises:
            DriverError: always.
        """
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise DriverError(f"{self.name} drives in MetaDrive only: choose the simulator metadrive")


class MetaDriveIdm(MetaDriveDriver):
    """MetaDrive's rule-based driver: PID steering to the lane's centre, constant target speed.

    It does not slow down for curves, so its target speed decides which roads it can take.

    Args:
        target_speed: km/h; 30 is what MetaDrive's traffic keeps. The speed limit caps it.
    """

    name = "metadrive-idm"

    def __init__(self, *, target_speed: Positive = 30.0) -> None:
        check(locals(), MetaDriveIdm.__init__)
        self.target_speed = float(target_speed)

    @property
    def options(self) -> dict[str, float]:
        """Its options."""
        return {"target_speed": self.target_speed}


class MetaDriveExpert(MetaDriveDriver):
    """The neural network that comes with MetaDrive, trained there by PPO; its mean action.

    In another simulator it steers the wheels by the same angle as MetaDrive's car and accelerates
    like it, as far as that car can.
    """

    name = "metadrive-expert"
    period: ClassVar[float] = 0.1
    """s: the time between two decisions for which it was trained."""

    def check_simulator(self, simulator: Simulator) -> None:
        """Accepts any."""

    def reset(self, setup: DriveSetup) -> None:
        """Forgets the last drive.

        Raises:
            FreneticError: MetaDrive is not installed.
        """
        weights()
        self._setup, self._action, self._heading = setup, (0.0, 0.0), math.nan

    def act(self, observation: Observation) -> Controls:
        """The network's action, as the controls of this car."""
        turned = observation.heading - self._heading
        turned = 0.0 if math.isnan(turned) else turned
        seen = state_of(observation, self._setup, self._action, turned)
        steering, pedal = (min(max(value, -1.0), 1.0) for value in mean_action(seen))
        self._action, self._heading = (steering, pedal), observation.heading
        decision = Decision.of_action(steering, pedal)
        acceleration = (
            decision.throttle * VEHICLE.engine_acceleration
            - decision.brake * VEHICLE.brake_deceleration
        )
        return Controls.from_acceleration(
            acceleration, decision.steering, speed=observation.speed, setup=self._setup
        )


def metadrive_driver(driver: Driver) -> MetaDriveDriver | None:
    """The driver if it is one of MetaDrive's own, otherwise None.

    Raises:
        DriverError: it is one of MetaDrive's own under layers, which would not reach it.
    """
    inner = under_layers(driver)
    if not isinstance(inner, MetaDriveDriver):
        return None
    if inner is not driver:
        raise DriverError(
            f"{inner.name} looks at MetaDrive's own world, where noise, delay and view do not"
            " reach it: leave them out, those of a campaign with noise=0, delay=0 or view=inf"
        )
    return inner
