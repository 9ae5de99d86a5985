"""The loop of a drive with a driver or a simulator in Python: observe, decide, move, record."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from time import perf_counter
from typing import Final, Protocol

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers.calls import blaming_driver, checked_controls
from frenetic.drivers.camera import Image
from frenetic.drivers.driver import Driver, DriveSetup, Observation
from frenetic.drivers.stack import period_of
from frenetic.errors import HANGS, DriverError, Fault, FreneticError, Trouble, traceback_of
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.drive_assessment import Assessment, DriveAssessment
from frenetic.processes import object_host
from frenetic.processes.wall_limit import WallLimitExceeded, wall_limit
from frenetic.road import Road
from frenetic.simulators.observer import Observer

RECORD_PERIOD: Final = 0.05
"""Time between two records, in s (20 Hz). It is also the time between two decisions, unless the
driver has another period."""
_MOTION_SIZE: Final = 8
"""Number of the columns ``time`` to ``steering`` of a `Trajectory`."""
_ROWS_AFTER_TIMEOUT: Final = 2
"""Records beyond the whole periods before the timeout: the record at 0 s, and the one after the
timeout, which ends every drive."""


class MovedCar(Protocol):
    """A car that a simulator moves. A new one stands at the start of the road."""

    def motion(self) -> Sequence[float]:
        """Return the columns ``x`` to ``steering`` of a `Trajectory` now, the heading unwrapped.

        A car that drives itself appends the columns of its controls.
        """

    def picture(self) -> Image | None:
        """Return what the driver's camera sees now; None without a camera."""

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Move the car for some simulated time.

        Args:
            steering: Angle asked of the front wheels, in rad, positive to the left.
            throttle: Throttle, 0..1.
            brake: Brake, 0..1.
            seconds: Simulated time, in s.
        """


class ObservedCar(ABC):
    """A car that moves and is observed, from the start to the end of one drive."""

    @abstractmethod
    def start(self) -> bool:
        """Record the car at the start; return whether the drive continues."""

    @abstractmethod
    def advance(
        self, controls: tuple[float, float, float], seconds: float, time: float, *, is_record: bool
    ) -> bool:
        """Move the car, and record it or not; return whether the drive continues.

        Args:
            controls: Steering in rad, throttle and brake; at the last record they were chosen.
            seconds: Simulated time of the move, in s.
            time: Time since the start of the drive at the end of the move, in s.
            is_record: Whether to record the car then.
        """

    @abstractmethod
    def observation(self) -> Observation:
        """Return what the driver sees now."""

    @abstractmethod
    def rows(self) -> FloatArray:
        """Return the records so far, (n, 11) float64 with the columns of a `Trajectory`."""

    def assessment(self) -> Assessment | None:
        """Return the assessment of the records so far; None if the car has made none."""
        return None


class _SimulatedCar(ObservedCar):
    """A car that a simulator moves, and an observer of it."""

    def __init__(self, car: MovedCar, observer: Observer) -> None:
        self._car = car
        self._observer = observer
        self._rows: list[list[float]] = []
        self._motion: Sequence[float] = ()  # now, with the time before it
        self._is_recorded = False  # whether the car is at its last record
        self._drives_itself = False  # whether its motions bring the controls

    def start(self) -> bool:
        """Record the car at the start; return whether the drive continues."""
        return self._look((0.0, 0.0, 0.0), 0.0, is_record=True)

    def advance(
        self, controls: tuple[float, float, float], seconds: float, time: float, *, is_record: bool
    ) -> bool:
        """Move the car, and record it or not; return whether the drive continues."""
        if self._is_recorded and not self._drives_itself:
            self._rows[-1][_MOTION_SIZE:] = controls
        self._car.advance(*controls, seconds)
        return self._look(controls, time, is_record=is_record)

    def _look(self, controls: tuple[float, float, float], time: float, *, is_record: bool) -> bool:
        """Take in the car's motion; return whether the drive continues."""
        self._motion = row = [time, *self._car.motion()]
        self._is_recorded = is_record
        if not is_record:
            return True
        self._drives_itself = len(row) > _MOTION_SIZE
        if not self._drives_itself:
            row += controls  # of the last decision, until another is made here
        self._rows.append(row)
        return self._observer.see(*row[:4])

    def observation(self) -> Observation:
        """Return what the driver sees now."""
        time, x, y, heading, speed, lateral_speed, yaw_rate, steering, *_ = self._motion
        if not self._is_recorded:
            self._observer.glance(time, x, y, heading)
        return self._observer.observation(
            speed, yaw_rate, steering, self._car.picture(), lateral_speed=lateral_speed
        )

    def rows(self) -> FloatArray:
        """Return the records so far, (n, 11) float64 with the columns of a `Trajectory`."""
        return np.array(self._rows, np.float64).reshape(-1, len(Trajectory.names()))


class _TimedDriver:
    """A driver, the time that its answers take, and whether its answer is awaited.

    While the driver's code raises, its answer stays awaited.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._turn = object_host.turn  # shared with the process that watches this one
        self.is_awaited = False
        """Whether the driver's code runs: what breaks now is the driver's fault."""
        self.seconds = 0.0
        """Wall time that the driver's answers have taken, in s."""

    def reset(self, setup: DriveSetup, period_step: float) -> float:
        """Prepare the driver for a drive; return the period of its decisions, in s."""
        self.is_awaited = self._turn.value = True
        period = period_of(self._driver, period_step) or setup.period
        start = perf_counter()
        try:
            self._driver.reset(replace(setup, period=period))
        finally:
            self.seconds += perf_counter() - start
        self.is_awaited = self._turn.value = False
        return period

    def act(self, observation: Observation) -> tuple[float, float, float]:
        """Return the steering in rad, throttle and brake that the driver decides on."""
        self.is_awaited = self._turn.value = True
        start = perf_counter()
        try:
            controls = checked_controls(self._driver.act(observation))
        finally:
            self.seconds += perf_counter() - start
        self.is_awaited = self._turn.value = False
        return controls


def most_records(rules: Rules, road: Road) -> int:
    """Return the largest number of records of a drive along a road."""
    return math.ceil(rules.timeout(road.length) / RECORD_PERIOD) + _ROWS_AFTER_TIMEOUT


def run_drive(
    car: MovedCar | ObservedCar,
    driver: Driver | None,
    *,
    road: Road,
    rules: Rules,
    body: CarBody,
    setup: DriveSetup,
    limit: float,
    period_step: float = RECORD_PERIOD,
    may_stall: bool = False,
) -> Drive:
    """Drive until the rules end the drive, or the driver breaks.

    Args:
        car: The car that is moved; an `ObservedCar` brings its observer.
        driver: Driver that is asked every period; None if the car drives itself.
        road: The road under the car.
        rules: Rules by which the drive ends.
        body: The box that the car covers.
        setup: Setup for the driver; a period of the driver replaces the setup's.
        limit: Wall time that the drive may take, in s.
        period_step: Time of which a driver's period is a multiple, in s.
        may_stall: Whether the simulator itself may exceed the wall time. Otherwise the driver is to
            blame for it, whenever it happens.

    Raises:
        FreneticError: The simulator exceeded the wall time while no driver was asked.
    """
    most = most_records(rules, road)
    if not isinstance(car, ObservedCar):
        car = _SimulatedCar(car, Observer(road, rules, body, most))
    trouble: Trouble | None = None
    timed = None if driver is None else _TimedDriver(driver)
    try:
        with wall_limit(limit), _blaming_awaited(timed):
            _move(car, timed, setup, most, period_step)
    except WallLimitExceeded as error:
        if may_stall and not (timed is not None and timed.is_awaited):
            raise FreneticError(
                f"the simulator did not finish a drive within {limit:g} s of wall time"
                f" ({len(car.rows())} records)"
            ) from None
        driven = max(len(car.rows()) - 1, 0) * RECORD_PERIOD
        text = (
            f"the driver did not finish its drive within {limit:g} s of wall time"
            f" (it had driven {driven:.1f} s{error.place})"
        )
        trouble = Trouble(text, traceback_of(error), Fault("driver", HANGS))
    except DriverError as error:
        trouble = Trouble.of(error)
    finally:
        object_host.turn.value = False
    path = Trajectory.of_block(car.rows().T.copy())
    assessment, assessed = car.assessment(), None
    if assessment is not None:
        assessed = DriveAssessment(assessment, (road, rules, body, path))
    driver_seconds = 0.0 if timed is None else timed.seconds
    return Drive(path, body, rules, road, trouble, driver_seconds, assessed)


@contextmanager
def _blaming_awaited(driver: _TimedDriver | None) -> Iterator[None]:
    """Blame the driver for an error while its answer is awaited, except for the wall time's."""
    try:
        yield
    except WallLimitExceeded:
        raise
    except BaseException:
        if driver is not None and driver.is_awaited:
            with blaming_driver():
                raise
        raise


def _move(
    car: ObservedCar,
    driver: _TimedDriver | None,
    setup: DriveSetup,
    most: int,
    period_step: float,
) -> None:
    """Move the car and record it until its observer ends the drive.

    Args:
        car: The car that is moved.
        driver: Driver that is asked; None if the car drives itself.
        setup: Setup for the driver.
        most: Largest number of records.
        period_step: Time of which a driver's period is a multiple, in s.
    """
    controls = (0.0, 0.0, 0.0)
    period = setup.period if driver is None else driver.reset(setup, period_step)
    # The car moves in equal steps of whole milliseconds, on which records and decisions fall.
    record_ms, decision_ms = round(1e3 * RECORD_PERIOD), round(1e3 * period)
    step_ms = math.gcd(record_ms, decision_ms)
    seconds = step_ms / 1e3
    continues = car.start()
    for next_ms in range(step_ms, most * record_ms, step_ms):
        if not continues:
            return
        if driver is not None and (next_ms - step_ms) % decision_ms == 0:
            controls = driver.act(car.observation())
        continues = car.advance(
            controls,
            seconds,
            next_ms / record_ms * RECORD_PERIOD,
            is_record=next_ms % record_ms == 0,
        )
