"""The embedded simulator as a `Simulator`."""

from __future__ import annotations

import logging
import math
from dataclasses import asdict, replace
from types import TracebackType
from typing import Any, Self

import numpy as np

from frenetic.arrays import FloatArray
from frenetic.drivers.driver import Driver, DriveSetup, checked_controls
from frenetic.drivers.laws import setup_array
from frenetic.drivers.layers import Compiled, compiled_form
from frenetic.errors import DriverError, describe_error
from frenetic.oracle import rules_array
from frenetic.road import Road
from frenetic.simulators.drive import Drive, Rules, Trajectory
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.embedded.vehicle import (
    HEADING,
    SPEED,
    STEERING,
    YAW_RATE,
    Vehicle,
    X,
    Y,
)
from frenetic.simulators.observing import Observer
from frenetic.simulators.wall_limit import WallLimitExceeded, wall_limit

logger = logging.getLogger(__name__)

_NO_ERRORS = np.empty((0, 2))


class EmbeddedSimulator:
    """A dynamic single-track car in compiled code; a drive of 250 m takes about a millisecond.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        vehicle: the car, a BMW 320i by default.
        friction: of the road, in place of the vehicle's: 1 is dry, 0.7 wet, 0.3 snow.
        wall_limit: s of wall time that a drive with a driver written in Python may take; then it
            is an ERROR. Built-in drivers end by the rules.
    """

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        vehicle: Vehicle | None = None,
        friction: float | None = None,
        wall_limit: float = 60.0,
    ) -> None:
        self.rules = rules or Rules()
        self.vehicle = vehicle or Vehicle()
        if friction is not None:
            self.vehicle = replace(self.vehicle, friction=friction)
        if not (math.isfinite(wall_limit) and wall_limit > 0.0):
            raise ValueError(f"wall_limit is {wall_limit}: a positive number of seconds is needed")
        self.wall_limit = wall_limit
        self._vehicle = self.vehicle.to_array()
        self.car = self.vehicle.body()
        self._car = self.car.to_array()
        self._room = np.empty(0)  # memory for the records, used again and again

    @property
    def options(self) -> dict[str, Any]:
        """What it was made with, beside the rules."""
        return {"vehicle": asdict(self.vehicle), "wall_limit": self.wall_limit}

    def __enter__(self) -> Self:
        """Compiles what is not compiled yet."""
        self._compile()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing has to be ended."""

    @staticmethod
    def _compile() -> None:
        from frenetic.compilation import compile_kernels  # which needs this module

        compile_kernels()

    def setup(self, road: Road) -> DriveSetup:
        """What a driver is told before a drive along the road."""
        car = self.vehicle
        return DriveSetup(
            speed_limit=self.rules.speed_limit / 3.6,
            lane_width=road.lane_width,
            period=kernels.PERIOD,
            front_axle=car.front_axle,
            rear_axle=car.rear_axle,
            car_length=car.length,
            car_width=car.width,
            max_steering=car.steering_limit,
            max_acceleration=car.engine_acceleration,
            max_deceleration=car.brake_deceleration,
        )

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road."""
        rules = rules_array(self.rules, road.length)
        # The record after the timeout ends every drive.
        most = math.ceil(self.rules.timeout(road.length) / kernels.PERIOD) + 2
        columns_needed = len(Trajectory.names())
        if self._room.size < columns_needed * most:
            self._room = np.empty(columns_needed * most)
        room = self._room[: columns_needed * most].reshape(columns_needed, most)
        setup = self.setup(road)
        compiled = compiled_form(driver, setup.period)
        error = None
        if compiled is not None:
            n = self._drive_compiled(road, compiled, setup, rules, room)
        else:
            n, error = self._drive_python(road, driver, setup, room)
        return Drive(Trajectory(*room[:, :n]), self.car, self.rules, error)

    def _drive_compiled(
        self,
        road: Road,
        driver: Compiled,
        setup: DriveSetup,
        rules: FloatArray,
        room: FloatArray,
    ) -> int:
        errors = _NO_ERRORS if driver.errors is None else driver.errors.upto(room.shape[1])
        n: int = kernels.rollout(
            road.table,
            road.sub_step,
            road.lane_width,
            rules,
            self._car,
            self._vehicle,
            driver.law,
            driver.parameters,
            setup_array(setup),
            driver.rows,
            driver.delay,
            errors,
            room,
        )
        return n

    def _drive_python(
        self,
        road: Road,
        driver: Driver,
        setup: DriveSetup,
        room: FloatArray,
    ) -> tuple[int, str | None]:
        """The compiled rollout's loop with calls of the driver in between: (records, error)."""
        self._compile()  # not on the driver's time
        written = 0
        state = kernels.start_state(road.table, road.lane_width)
        controls = (0.0, 0.0, 0.0)

        def loop() -> None:
            nonlocal written, controls
            driver.reset(setup)
            observer = Observer(road, self.rules, self.car, room.shape[1])
            for i in range(room.shape[1]):
                kernels.write_record(room, i, state, *controls)
                written = i + 1
                if not observer.see(i * kernels.PERIOD, state[X], state[Y], state[HEADING]):
                    return
                observation = observer.observation(state[SPEED], state[YAW_RATE], state[STEERING])
                controls = checked_controls(driver.act(observation))
                kernels.write_record(room, i, state, *controls)
                kernels.advance_period(state, *controls, self._vehicle)

        try:
            with wall_limit(self.wall_limit):
                loop()
        except WallLimitExceeded:
            at = max(written - 1, 0) * kernels.PERIOD
            return written, (
                f"the driver did not finish its drive within {self.wall_limit:g} s of wall time"
                f" (it had driven {at:.1f} s)"
            )
        except DriverError as error:
            return written, str(error)
        except (Exception, SystemExit) as error:
            logger.debug("the driver broke", exc_info=True)
            return written, f"the driver raised {describe_error(error)}"
        return written, None
