"""A user's own driver by its name, which drives in other processes only."""

from __future__ import annotations

from typing import Any

from frenetic.drivers.driver import (
    Controls,
    Driver,
    DriveSetup,
    Observation,
    SelectiveDriver,
    camera_of,
)
from frenetic.recipe import Guest, Named


class NamedDriver(Named):
    """A user's own driver by its name."""

    is_selective: bool

    @staticmethod
    def attributes_of(part: Driver) -> dict[str, Any]:
        """Its camera and its period, and whether it refuses simulators."""
        asked = {"camera": camera_of(part), "period": getattr(part, "period", None)}
        known = {name: value for name, value in asked.items() if value is not None}
        return {"is_selective": isinstance(part, SelectiveDriver), **known}

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
