"""A user's own driver by its name, which drives in other processes only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from frenetic.drivers.camera import Camera
from frenetic.drivers.driver import (
    Controls,
    Driver,
    DriveSetup,
    Observation,
    SelectiveDriver,
    camera_of,
)
from frenetic.recipe import Guest, Named


@dataclass(frozen=True)
class DriverAttributes:
    """A driver's camera and period, and whether it refuses simulators."""

    is_selective: bool
    camera: Camera | None
    period: Any


class NamedDriver(Named):
    """A user's own driver by its name."""

    attributes_type: ClassVar[type] = DriverAttributes
    is_selective: bool

    @staticmethod
    def attributes_of(part: Driver) -> DriverAttributes:
        """Its camera and its period, and whether it refuses simulators."""
        period = getattr(part, "period", None)
        return DriverAttributes(isinstance(part, SelectiveDriver), camera_of(part), period)

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002
        """Raises a `DriverError`."""
        self.refuse()

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002
        """Raises a `DriverError`."""
        self.refuse()

    def check_simulator(self, simulator: Any) -> None:
        """Raises an error if it cannot drive in this one."""
        if self.is_selective:
            self.recipe.ask(_check_simulator, simulator)


def _check_simulator(guest: Guest, simulator: Any) -> None:
    guest.part.check_simulator(simulator)
