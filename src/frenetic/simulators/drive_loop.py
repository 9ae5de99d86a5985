"""The loop of a drive with a driver or a simulator in Python: observe, decide, move, record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
"""Time between two records, in s (20 Hz). It is also the time between two decisions, unless the
driver has another period."""
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


class _TimedDriver:
    """A driver, the time that its answers take, and whether its answer is awaited."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._turn = object_host.turn  # shared with the process that watches this one
        self.is_awaited = False
        """Whether the driver's code runs: what breaks now is the driver's fault."""
        self.seconds = 0.0
        """Wall time that the driver's answers have taken, in s."""

    def reset(self, setup: DriveSetup, period_step: float) -> float:
        """Prepare the driver for a drive; return the period of its decisions, in s."""
        self._set_turn(is_drivers=True)
        period = period_of(self._driver, period_step) or setup.period
        self._ask("reset", replace(setup, period=period))
        return period

    def act(self, observation: Observation) -> tuple[float, float, float]:
        """Return the steering in rad, throttle and brake that the driver decides on."""
        controls: tuple[float, float, float] = self._ask("act", observation)
        return controls

    def _ask(self, method: str, argument: DriveSetup | Observation) -> Any:
        """Call a method of the driver and measure the time; it stays awaited if it raises."""
        self._set_turn(is_drivers=True)
        start = perf_counter()
        try:
            answer = getattr(self._driver, method)(argument)
            if method == "act":
                answer = checked_controls(answer)
        finally:
            self.seconds += perf_counter() - start
        self._set_turn(is_drivers=False)
        return answer

    def _set_turn(self, *, is_drivers: bool) -> None:
        """Note whether the driver's code runs from now on, here and for the watching process."""
        self.is_awaited = self._turn.value = is_drivers


def run_drive(
    car: MovedCar,
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
        car: The car that is moved.
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
    max_rows = math.ceil(rules.timeout(road.length) / RECORD_PERIOD) + _ROWS_AFTER_TIMEOUT
    observer = Observer(road, rules, body, max_rows)
    rows: list[list[float]] = []
    trouble: Trouble | None = None
    timed = None if driver is None else _TimedDriver(driver)
    try:
        with wall_limit(limit), _blaming_awaited(timed):
            _fill_rows(rows, car, observer, timed, setup, max_rows, period_step)
    except WallLimitExceeded as error:
        if may_stall and not (timed is not None and timed.is_awaited):
            raise FreneticError(
                f"the simulator did not finish a drive within {limit:g} s of wall time"
                f" ({len(rows)} records)"
            ) from None
        driven = max(len(rows) - 1, 0) * RECORD_PERIOD
        text = (
            f"the driver did not finish its drive within {limit:g} s of wall time"
            f" (it had driven {driven:.1f} s{error.place})"
        )
        trouble = Trouble(text, traceback_of(error), Fault("driver", HANGS))
    except DriverError as error:
        trouble = Trouble.of(error)
    finally:
        object_host.turn.value = False
    path = Trajectory.from_rows(np.array(rows).reshape(-1, len(Trajectory.names())))
    return Drive(path, body, rules, road, trouble, 0.0 if timed is None else timed.seconds)


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


def _fill_rows(
    rows: list[list[float]],
    car: MovedCar,
    observer: Observer,
    driver: _TimedDriver | None,
    setup: DriveSetup,
    max_rows: int,
    period_step: float,
) -> None:
    """Move the car and record it until the observer ends the drive.

    The rows are an argument, not a result, so that they outlast an error.

    Args:
        rows: Empty; rows of a `Trajectory` are appended as the car moves.
        car: The car that is moved.
        observer: Observer of the car.
        driver: Driver that is asked; None if the car drives itself.
        setup: Setup for the driver.
        max_rows: Largest number of rows.
        period_step: Time of which a driver's period is a multiple, in s.
    """
    controls = (0.0, 0.0, 0.0)
    period = setup.period if driver is None else driver.reset(setup, period_step)
    # The car moves in equal steps of whole milliseconds, on which records and decisions fall.
    record_ms, decision_ms = round(1e3 * RECORD_PERIOD), round(1e3 * period)
    step_ms = math.gcd(record_ms, decision_ms)
    for now_ms in range(0, max_rows * record_ms, step_ms):
        time = now_ms / record_ms * RECORD_PERIOD
        is_record, is_decision = now_ms % record_ms == 0, now_ms % decision_ms == 0
        motion = [time, *car.motion()]
        _, x, y, heading, speed, lateral_speed, yaw_rate, steering, *_ = motion
        if is_record:
            if driver is not None:
                motion += controls  # of the last decision; a decision now replaces them below
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
        car.advance(*controls, step_ms / 1e3)
