"""The embedded simulator with the twin's car, in which the driver under test drives."""

from __future__ import annotations

from dataclasses import replace

from frenetic.drivers.compiled_form import compiled_form
from frenetic.drivers.driver import Driver, DriveSetup
from frenetic.oracle.drive import CarBody, Rules
from frenetic.road import Road
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.embedded.rollout import PERIOD
from frenetic.simulators.embedded.vehicle import Vehicle


class TwinSimulator(EmbeddedSimulator):
    """The embedded simulator in which a driver believes that it drives another simulator's car.

    Args:
        rules: rules of the drives.
        vehicle: the car that moves.
        body: box of the other simulator's car, by which drives are judged.
        setup: setup of a drive in the other simulator, on any road; None for the setup of
            ``vehicle``.
        wall_limit: wall time that a drive may take, in s.
    """

    def __init__(
        self,
        *,
        rules: Rules,
        vehicle: Vehicle,
        body: CarBody,
        setup: DriveSetup | None,
        wall_limit: float = 60.0,
    ) -> None:
        self._body, self._other_setup = body, setup
        super().__init__(rules=rules, vehicle=vehicle, wall_limit=wall_limit)

    def _set_vehicle(self, vehicle: Vehicle) -> None:
        """Take over a car, but not its box."""
        super()._set_vehicle(vehicle)
        self.car, self._car = self._body, self._body.to_array()

    def drives_compiled(self, driver: Driver) -> bool:
        """Return whether the driver's drives run compiled code alone."""
        return compiled_form(driver, PERIOD) is not None

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road, for its driver."""
        if self._other_setup is None:
            return super().setup(road)
        speed_limit = self.rules.start_limit_on(road)
        return replace(self._other_setup, speed_limit=speed_limit, lane_width=road.lane_width)
