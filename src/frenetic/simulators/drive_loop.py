"""One drive of a car that a simulator in Python moves, record by record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Final, Protocol

import numpy as np

from frenetic.drivers.calls import blaming_driver, checked_controls
from frenetic.drivers.camera import Image
from frenetic.drivers.driver import Driver, DriveSetup, Observation
from frenetic.drivers.stack import period_of
from frenetic.errors import HANGS, DriverError, Fault, FreneticError, Trouble, traceback_of
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.processes import object_host
from frenetic.processes.wall_limit import WallLimitExceeded, wall_limit
from frenetic.road import Road
from frenetic.simulators.observer import Observer

RECORD_PERIOD: Final = 0.05
"""Time between two records, in s: 20 Hz; also between two decisions, unless the driver asks for
another period."""


class MovedCar(Protocol):
    """A car that a simulator moves; at first it stands at the start of the road."""

    def motion(self) -> Sequence[float]:
        """Return the columns of a `Trajectory` from ``x`` to ``steering``, the heading unwrapped.

        A car that drives itself adds the columns of its controls.
        """

    def picture(self) -> Image | None:
        """Return what the driver's camera sees now; None without a camera."""

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Move the car on."""


class _AskedDriver:
    """A driver with the time that its answers take."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._turn = object_host.turn
        self.is_awaited = False
        """Whether it is the driver's turn."""
        self.seconds = 0.0
        """Wall time that the driver's answers have taken, in s."""

    def reset(self, setup: DriveSetup, period_step: float) -> float:
        """Prepare the driver for a drive; return the period of its decisions, in s."""
        self._set_turn(True)
        period = period_of(self._driver, period_step) or setup.period
        self._ask("reset", replace(setup, period=period))
        return period

    def act(self, observation: Observation) -> tuple[float, float, float]:
        """Return the driver's steering, throttle and brake."""
        controls: tuple[float, float, float] = self._ask("act", observation)
        return controls

    def _ask(self, method: str, argument: DriveSetup | Observation) -> Any:
        self._set_turn(True)
        start = perf_counter()
        try:
            answer = getattr(self._driver, method)(argument)
            if method == "act":
                answer = checked_controls(answer)
        finally:
            self.seconds += perf_counter() - start
        self._set_turn(False)
        return answer

    def _set_turn(self, is_drivers: bool) -> None:
        self.is_awaited = self._turn.value = is_drivers


def follow(
    car: MovedCar,
    road: Road,
    rules: Rules,
    body: CarBody,
    setup: DriveSetup,
    driver: Driver | None,
    limit: float,
    *,
    period_step: float = RECORD_PERIOD,
    may_stall: bool = False,
) -> Drive:
    """Drive until the rules end the drive; a driver that breaks ends it, too.

    Args:
        car: The car that is moved.
        road: The road under the car.
        rules: Rules by which the drive ends.
        body: The box that the car covers.
        setup: Setup for the driver, whose own period replaces the setup's.
        driver: Driver that is asked every period; None if the car drives itself.
        limit: s of wall time.
        period_step: s of which a driver's own period is a multiple.
        may_stall: Whether the simulator itself may need that long.

    Raises:
        FreneticError: The simulator exceeded the wall time while no driver was asked.
    """
    # The record after the timeout ends every drive.
    most = math.ceil(rules.timeout(road.length) / RECORD_PERIOD) + 2
    observer = Observer(road, rules, body, most)
    rows: list[list[float]] = []
    trouble: Trouble | None = None
    asked = None if driver is None else _AskedDriver(driver)
    try:
        with wall_limit(limit):
            try:
                _drive(car, observer, asked, setup, rows, most, period_step)
            except WallLimitExceeded:
                raise
            except BaseException:
                if asked is not None and asked.is_awaited:
                    with blaming_driver():
                        raise
                raise
    except WallLimitExceeded as error:
        if may_stall and not (asked is not None and asked.is_awaited):
            raise FreneticError(
                f"the simulator did not finish a drive within {limit:g} s of wall time"
                f" ({len(rows)} records)"
            ) from None
        at = max(len(rows) - 1, 0) * RECORD_PERIOD
        text = (
            f"the driver did not finish its drive within {limit:g} s of wall time"
            f" (it had driven {at:.1f} s{error.place})"
        )
        trouble = Trouble(text, traceback_of(error), Fault("driver", HANGS))
    except DriverError as error:
        trouble = Trouble.of(error)
    finally:
        object_host.turn.value = False
    path = Trajectory.from_rows(np.array(rows).reshape(-1, len(Trajectory.names())))
    return Drive(path, body, rules, road, trouble, 0.0 if asked is None else asked.seconds)


def _drive(
    car: MovedCar,
    observer: Observer,
    driver: _AskedDriver | None,
    setup: DriveSetup,
    rows: list[list[float]],
    most: int,
    period_step: float,
) -> None:
    """Move the car and record it in `rows` until the observer ends the drive.

    Args:
        car: The car that is moved.
        observer: Observer of the car.
        driver: Driver that is asked; None if the car drives itself.
        setup: Setup for the driver.
        rows: Empty; rows of a `Trajectory` are appended as the car moves.
        most: Largest number of rows.
        period_step: s of which a driver's own period is a multiple.
    """
    controls = (0.0, 0.0, 0.0)
    period = setup.period if driver is None else driver.reset(setup, period_step)
    # Records and decisions fall on steps of equal length, in whole milliseconds.
    per_record, per_decision = round(1e3 * RECORD_PERIOD), round(1e3 * period)
    step = math.gcd(per_record, per_decision)
    for now in range(0, most * per_record, step):
        time = now / per_record * RECORD_PERIOD
        is_record, is_decision = now % per_record == 0, now % per_decision == 0
        motion = [time, *car.motion()]
        _, x, y, heading, speed, lateral_speed, yaw_rate, steering, *_ = motion
        if is_record:
            if driver is not None:
                motion += controls
            rows.append(motion)
            if not observer.see(time, x, y, heading):
                return
        elif is_decision:
            observer.glance(time, x, y, heading)
        if driver is not None and is_decision:
            observation = observer.observation(
                speed, yaw_rate, steering, car.picture(), lateral_speed=lateral_speed
            )
            controls = driver.act(observation)
            if is_record:
                motion[-len(controls) :] = controls
        car.advance(*controls, step / 1e3)
