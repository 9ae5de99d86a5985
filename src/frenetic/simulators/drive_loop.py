"""One drive of a car that a simulator in Python moves, record by record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, Final, Protocol

import numpy as np

from frenetic.drivers.camera import Image
from frenetic.drivers.driver import (
    Driver,
    DriveSetup,
    Observation,
    blaming_driver,
    checked_controls,
    period_of,
)
from frenetic.errors import HANGS, DriverError, Fault, FreneticError, Trouble, traceback_of
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.processes import object_host
from frenetic.processes.wall_limit import WallLimitExceeded, wall_limit
from frenetic.road import Road
from frenetic.simulators.observer import Observer

RECORD_PERIOD: Final = 0.05
"""Time between two records, in s: 20 Hz; that between two decisions unless the driver asks for
another."""


class MovedCar(Protocol):
    """The car, which stands at the start of the road."""

    def motion(self) -> Sequence[float]:
        """Its columns of a `Trajectory` from ``x`` to ``steering``, with the heading unwrapped.

        Those after them, too, if it drives itself.
        """

    def picture(self) -> Image | None:
        """What the driver's camera sees now; None without one."""

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Moves it on."""


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
    """Drives until the rules end it; a driver that breaks ends it, too.

    Args:
        car: what is moved.
        road: under it.
        rules: say when the drive ends.
        body: of the car.
        setup: the driver's, unless it has a period of its own.
        driver: asked every period; None if the car drives itself.
        limit: s of wall time.
        period_step: s of which a driver's own period is a multiple.
        may_stall: whether the simulator itself may need that long.

    Raises:
        FreneticError: it did, while nobody waited for the driver.
    """
    # The record after the timeout ends every drive.
    most = math.ceil(rules.timeout(road.length) / RECORD_PERIOD) + 2
    observer = Observer(road, rules, body, most)
    rows: list[list[float]] = []
    waits = False  # for the driver
    trouble: Trouble | None = None
    driver_seconds = 0.0

    turn = object_host.turn

    def ask(method: str, argument: DriveSetup | Observation) -> Any:
        nonlocal waits, driver_seconds
        waits = turn.value = True
        start = perf_counter()
        try:
            answer = getattr(driver, method)(argument)
            if method == "act":
                answer = checked_controls(answer)
        finally:
            driver_seconds += perf_counter() - start
        waits = turn.value = False
        return answer

    def loop() -> None:
        nonlocal waits
        controls = (0.0, 0.0, 0.0)
        period = setup.period
        if driver is not None:
            waits = turn.value = True
            period = period_of(driver, period_step) or period
            ask("reset", replace(setup, period=period))
        # In equal steps of whole milliseconds, in which records and decisions have their places.
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
                controls = ask("act", observation)
                if is_record:
                    motion[-len(controls) :] = controls
            car.advance(*controls, step / 1e3)

    try:
        with wall_limit(limit):
            try:
                loop()
            except WallLimitExceeded:
                raise
            except BaseException:
                if waits:
                    with blaming_driver():
                        raise
                raise
    except WallLimitExceeded as error:
        if may_stall and not waits:
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
    return Drive(path, body, rules, road, trouble, driver_seconds)
