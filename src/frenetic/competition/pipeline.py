"""What the official pipeline offers a generator, as far as ours uses it."""

from __future__ import annotations

import importlib
import math
import time
from typing import Any, Protocol

from frenetic._support.arrays import FloatArray
from frenetic.errors import FreneticError


class Executor(Protocol):
    """Runs tests; every edition of the competition has these methods.

    When the time budget is spent, `execute_test` ends the process with ``sys.exit(123)``.
    """

    def execute_test(self, the_test: Any) -> Any:
        """Run a test and return (outcome, description, execution data)."""
        ...

    def get_remaining_time(self) -> Any:
        """Return seconds: a number in 2021, later a mapping such as ``{"time-budget": 7200.0}``."""
        ...

    def is_over(self) -> bool:
        """Return whether the budget is spent."""
        ...


class RoadTests:
    """Makes the pipeline's road tests.

    Raises:
        FreneticError: The pipeline cannot be imported.

    """

    def __init__(self) -> None:
        try:
            module = importlib.import_module("code_pipeline.tests_generation")
        except ImportError as error:
            raise FreneticError(
                f"the competition's pipeline cannot be imported ({error}): this generator is run by"
                " the pipeline's competition.py"
            ) from error
        self._factory = module.RoadTestFactory

    def make(self, points: FloatArray) -> Any:
        """Return a road test from the road's points, (N, 2) m."""
        # The pipeline wants a list of tuples, and numbers that it can write as JSON.
        return self._factory.create_road_test([(x, y) for x, y in points.tolist()])


def least_oob_distance(execution_data: Any) -> float | None:
    """Return the MOOBD in m of a test's records, None if no record has a finite oob distance."""
    try:
        distances = [_number(getattr(record, "oob_distance", None)) for record in execution_data]
    except Exception:  # no list of records
        return None
    return min((d for d in distances if d is not None), default=None)


def restart_generation_clock(executor: Any) -> None:
    """Make an executor usable again after an exception out of `execute_test`.

    From there on the later pipelines' executors hold None for the time at which the generation of
    the next test began, and every further `execute_test` would fail to subtract it.
    """
    if getattr(executor, "start_generation_time", 0.0) is None:
        executor.start_generation_time = time.monotonic()


def seconds(reading: Any) -> dict[str, float]:
    """Return what an executor told of its budget as seconds by name, without what is no number."""
    named = reading if isinstance(reading, dict) else {"time-budget": reading}
    numbers = {str(name): _number(value) for name, value in named.items()}
    return {name: number for name, number in numbers.items() if number is not None}


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None
