"""The parts of the official pipeline that our generators use, and settings beyond its options."""

from __future__ import annotations

import difflib
import importlib
import inspect
import logging
import math
import os
import shlex
import time
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import read_setting
from frenetic.errors import FreneticError, describe_error
from frenetic.road import Road
from frenetic.search import Strategy, Trace

logger = logging.getLogger(__name__)

TIME_BUDGET = "time-budget"
"""Name of the one budget that covers generating and executing tests."""


class Executor(Protocol):
    """Runs tests; every edition of the competition has these methods, but 2021 no `is_over`.

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


class TimeBudget:
    """The share of an executor's time budget that is spent.

    The pipeline of 2022 can also run with two budgets, for generation and for execution; then the
    larger share counts, since either ends the search.

    Args:
        executor: Knows the remaining time.
        total: s, the whole time budget where the pipeline gives it; by default the executor's
            ``time_budget.time_budget``, or else the remaining time.

    """

    def __init__(self, executor: Executor, total: float | None = None) -> None:
        self._executor = executor
        self._share = 0.0
        self._is_readable = True
        self.totals = self._remaining()
        """Seconds by name of each budget."""
        known = total, getattr(getattr(executor, "time_budget", None), "time_budget", None)
        for value in known:
            told = _seconds(value).get(TIME_BUDGET, 0.0)
            if told > 0.0:
                self.totals = {TIME_BUDGET: told}
                break

    def share_spent(self) -> float:
        """Return 0..1; the last value if the executor does not answer."""
        remaining = self._remaining()
        shares = [
            (total - remaining[name]) / total
            for name, total in self.totals.items()
            if name in remaining and total > 0.0
        ]
        if shares:
            self._share = min(max(max(shares), 0.0), 1.0)
        return self._share

    def _remaining(self) -> dict[str, float]:
        try:
            remaining = _seconds(self._executor.get_remaining_time())
            reason = "it tells no number"
        except Exception as error:
            remaining, reason = {}, describe_error(error)
        if not remaining and self._is_readable:
            logger.warning("the executor does not say what time remains: %s", reason)
        self._is_readable = bool(remaining)
        return remaining


def least_oob_distance(execution_data: Any) -> float | None:
    """Return the MOOBD in m of a test's records, None if no record has a finite oob distance."""
    try:
        distances = [_number(getattr(record, "oob_distance", None)) for record in execution_data]
    except Exception:  # no list of records
        return None
    return min((d for d in distances if d is not None), default=None)


def trace_of(execution_data: Any, road: Road) -> tuple[Trace, int] | None:
    """Return a test's drive along its road, and the number of the record where the car was out.

    That is the first record with ``is_oob``, otherwise the one furthest from the lane's centre.
    None if a record lacks a place or a speed.
    """
    try:
        rows = [(*record.pos[:2], *record.vel[:2]) for record in execution_data]
        path = np.array(rows, dtype=np.float64).reshape(len(rows), 4)
        out = [bool(getattr(record, "is_oob", False)) for record in execution_data]
    except Exception:  # other records than the pipeline's
        return None
    if not len(path) or not np.isfinite(path).all():
        return None
    trace = Trace.along(road, path[:, :2], np.hypot(path[:, 2], path[:, 3]))
    worst = out.index(True) if any(out) else int(np.argmax(np.abs(trace.lateral_offset)))
    return trace, worst


def restart_generation_clock(executor: Any) -> None:
    """Make an executor usable again after an exception out of `execute_test`.

    After one, executors of later pipelines hold None for the start of the next test's generation,
    and every further `execute_test` would fail to subtract it.
    """
    if getattr(executor, "start_generation_time", 0.0) is None:
        executor.start_generation_time = time.monotonic()


def _seconds(reading: Any) -> dict[str, float]:
    """Return an executor's budget as seconds by name, without values that are no numbers."""
    named = reading if isinstance(reading, dict) else {"time-budget": reading}
    numbers = {str(name): _number(value) for name, value in named.items()}
    return {name: number for name, number in numbers.items() if number is not None}


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


# Settings: seed and options of the strategy

SEED = "FRENETIC_SEED"
"""Environment variable: a whole number of at least 0."""
OPTIONS = "FRENETIC_STRATEGY_OPTIONS"
"""Environment variable: NAME=VALUE, several separated by blanks."""


def read_seed(default: int | None, environment: Mapping[str, str] = os.environ) -> int:
    """Return the seed of the environment, else the default, else a new one.

    Raises:
        FreneticError: It is not a whole number of at least 0.

    """
    text = environment.get(SEED, "").strip()
    if not text:
        return (
            default if default is not None else int(np.random.SeedSequence().generate_state(1)[0])
        )
    if not text.isdecimal():
        raise FreneticError(f"{SEED} is {text!r}: a whole number of at least 0 is needed")
    return int(text)


def read_options(
    default: Mapping[str, Any], environment: Mapping[str, str] = os.environ
) -> dict[str, Any]:
    """Return the default options, overridden by those of the environment.

    A value is read as ``frenetic run --strategy-option`` reads it: as JSON or a number if it is
    one, otherwise as text.

    Raises:
        FreneticError: An option is not NAME=VALUE.

    """
    options = dict(default)
    text = environment.get(OPTIONS, "")
    try:
        settings = shlex.split(text)
    except ValueError as error:
        raise FreneticError(f"{OPTIONS} is {text!r}: {error}") from None
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not (name and equals):
            raise FreneticError(
                f"{OPTIONS} holds {setting!r}: NAME=VALUE is needed, several separated by blanks"
            )
        options[name] = read_setting(value)
    return options


def make_strategy(
    kind: type[Any], *, seed: int, map_size: float, options: Mapping[str, Any]
) -> Strategy:
    """Return a strategy; seed and map size are passed to a class that takes them.

    Raises:
        FreneticError: There is no such option, or its value is out of range.

    """
    parameters = inspect.signature(kind).parameters.values()
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    names = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD]
    given = {"seed": seed, "map_size": map_size}
    for name in options:
        if name in given:
            raise FreneticError(
                f"{name} is no option of the strategy here: it comes from"
                f" {'--map-size' if name == 'map_size' else SEED}"
            )
        if not takes_any and name not in names:
            close = difflib.get_close_matches(name, names, n=1)
            hint = f", did you mean {close[0]!r}?" if close else "."
            has = ", ".join(n for n in names if n not in given) or "none"
            raise FreneticError(f"{kind.__name__} has no option {name!r}{hint} It has: {has}")
    taken = {name: value for name, value in given.items() if takes_any or name in names}
    try:
        strategy: Strategy = kind(**taken, **options)
    except (TypeError, ValueError) as error:
        raise FreneticError(f"{kind.__name__}: {error}") from error
    return strategy
