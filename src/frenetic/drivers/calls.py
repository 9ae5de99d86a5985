"""Calls of a driver's code: its errors become `DriverError`, and its answers are checked."""

from __future__ import annotations

import math
import signal
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from frenetic.drivers.driver import Controls, Driver
from frenetic.drivers.stack import stack_of
from frenetic.errors import ControlsError, DriverError, describe_raised

MOST_STEERING: Final = 1e9
"""Largest steering angle that a driver may ask for, in rad; our choice, so that every recorded
angle fits into the database."""


@contextmanager
def blaming_driver() -> Iterator[None]:
    """Turn an error of a driver into a `DriverError` that says where in its code it was raised.

    A `KeyboardInterrupt` that may come from Ctrl-C is raised unchanged.
    """
    try:
        yield
    except DriverError:
        raise
    except BaseException as error:
        # A process that ignores Ctrl-C, such as a worker, gets none: the driver raised it.
        ignores_ctrl_c = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
        if isinstance(error, KeyboardInterrupt) and not ignores_ctrl_c:
            raise
        raise DriverError(f"the driver raised {describe_raised(error)}") from error


def is_of_driver(error: BaseException, driver: Driver) -> bool:
    """Return whether an error passed through `reset` or `act` of a driver or a driver under it."""
    codes = {
        getattr(getattr(type(part), name, None), "__code__", None)
        for part in stack_of(driver)
        for name in ("reset", "act")
    }
    return any(frame.f_code in codes for frame, _ in traceback.walk_tb(error.__traceback__))


def checked_controls(controls: Any) -> tuple[float, float, float]:
    """Return steering, throttle and brake of a driver's answer, pedals cut to 0..1.

    Raises:
        ControlsError: the answer is not `Controls`, a value is not a finite number, or the steering
            is more than `MOST_STEERING`.
    """
    if not isinstance(controls, Controls):
        raise ControlsError(
            f"the driver returned {type(controls).__name__} instead of frenetic.Controls"
        )
    steering, throttle, brake = controls.steering, controls.throttle, controls.brake
    # Nearly all answers pass this fast check.
    if (
        type(steering) is type(throttle) is type(brake) is float
        and -MOST_STEERING <= steering <= MOST_STEERING
        and 0.0 <= throttle <= 1.0
        and 0.0 <= brake <= 1.0
    ):
        return steering, throttle, brake
    steering, throttle, brake = _converted(controls)
    return steering, min(max(throttle, 0.0), 1.0), min(max(brake, 0.0), 1.0)


def _short_repr(value: object) -> str:
    """Return the beginning of a value's repr, or its class if the repr fails."""
    try:
        return repr(value)[:40]
    except Exception:  # a whole number may be too long, and foreign code may raise anything
        return f"<{type(value).__name__}>"


def _converted(controls: Controls) -> tuple[float, float, float]:
    """Return steering, throttle and brake as floats.

    Raises:
        ControlsError: a value is not a finite number, or the steering is more than `MOST_STEERING`.
    """
    values = []
    for name in ("steering", "throttle", "brake"):
        value = getattr(controls, name)
        try:
            number = math.nan if isinstance(value, (str, bytes)) else float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise ControlsError(
                f"the driver returned {name} = {_short_repr(value)}, not a finite number"
            )
        values.append(number)
    steering, throttle, brake = values
    if abs(steering) > MOST_STEERING:
        raise ControlsError(
            f"the driver returned steering = {steering:g}: an angle of at most"
            f" {MOST_STEERING:g} rad is needed"
        )
    return steering, throttle, brake
