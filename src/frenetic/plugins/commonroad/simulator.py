"""CommonRoad's multi-body car as a `Simulator`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

from frenetic._support.bounds import Positive
from frenetic._support.words import pip_install
from frenetic.drivers.driver import DriveSetup
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Rules
from frenetic.road import Pose, Road
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.simulators.simulator import Amount, unusual_amounts
from frenetic.simulators.stepped import Motion, SteppedSimulator

if TYPE_CHECKING:
    from frenetic.plugins.commonroad.car import CommonRoadCar

VEHICLE: Final = Vehicle()
"""The embedded simulator's car, a BMW 320i like CommonRoad's; it gives engine, brakes, steering."""


class CommonRoadSimulator(SteppedSimulator):
    """CommonRoad's multi-body model of a BMW 320i, 29 states; needs the extra ``commonroad``.

    Engine, brakes and steering come from the embedded simulator's default car, so a driver gets
    the same car with other physics. Brake and throttle let go of all wheels while a wheel slips.
    There is no drag of air or rolling.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        wall_limit: wall time that a drive may take, in s; a longer drive is an ERROR.
        steering_lag: time constant of the steering, in s.
        start_offset: as for `SteppedSimulator`.
        start_heading: as for `SteppedSimulator`.
    """

    needs: Final = ("vehiclemodels",)
    """Modules that the extra ``commonroad`` installs."""
    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, increased when drives change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("commonroad-vehicle-models",)
    """Distributions whose versions belong to the behaviour, too."""

    car = VEHICLE.body()
    steering_lag = Amount[float]("lag", VEHICLE.steering_lag)
    """Time constant of the steering, in s; it may be set between two drives."""
    period_step = 0.01  # [s] the PERIOD of the car, whose module needs the extra

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        wall_limit: Positive = 60.0,
        steering_lag: float = VEHICLE.steering_lag,
        start_offset: float = 0.0,
        start_heading: float = 0.0,
    ) -> None:
        super().__init__(
            rules=rules,
            wall_limit=wall_limit,
            start_offset=start_offset,
            start_heading=start_heading,
        )
        self.steering_lag = steering_lag

    @property
    def options(self) -> Mapping[str, Any]:
        """Amounts of conditions that differ from their defaults."""
        return unusual_amounts(self)

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road for its driver."""
        setup = self._vehicle.setup(self.rules, road, super().setup(road).period)
        return replace(setup, rolling_drag=0.0, air_drag=0.0)

    @property
    def _vehicle(self) -> Vehicle:
        return replace(VEHICLE, steering_lag=self.steering_lag)

    def __enter__(self) -> Self:
        """Import the model.

        Raises:
            FreneticError: the extra ``commonroad`` is not installed.
        """
        self._car_class()
        return self

    def _car_class(self) -> type[CommonRoadCar]:
        """Import and return the car's class.

        Raises:
            FreneticError: the extra ``commonroad`` is not installed.
        """
        try:
            from frenetic.plugins.commonroad.car import CommonRoadCar  # imports the extra
        except ModuleNotFoundError as error:
            raise FreneticError(
                f"the simulator commonroad needs the package {error.name}:"
                f" {pip_install('commonroad')}"
            ) from error
        return CommonRoadCar

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:  # noqa: ARG002
        """Put the car at rest on the road."""
        self._car = self._car_class()(pose, self._vehicle)
        return self._car.motion

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        """Move the car on by a time, in s.

        Raises:
            ArithmeticError: the model broke, as in a spin at walking pace.
        """
        for _ in range(round(seconds / self.period_step)):
            self._car.advance(steering, throttle, brake)
        return self._car.motion
