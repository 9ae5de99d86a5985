"""Test generators for the official SBST/SBFT pipeline, each around a search strategy.

The pipeline's ``competition.py --module-name frenetic.plugins.competition --class-name
FreneticGenerator`` runs a generator. The generator is a client of ``frenetic ask-tell``, which
searches in a process of its own. So this file, or a copy of it under another name, needs Python 3.9
or newer and the standard library alone.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import logging
import math
import os
import secrets
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar, Final

__all__ = ["Frenetic2021Generator", "FreneticGenerator", "Generator", "RandomSearchGenerator"]

logger = logging.getLogger(__name__)

COMMAND_VARIABLE: Final = "FRENETIC_COMMAND"
"""Environment variable with the command ``frenetic``, if it is not on the path."""
SEED_VARIABLE: Final = "FRENETIC_SEED"
"""Environment variable with the seed, a whole number of at least 0."""
OPTIONS_VARIABLE: Final = "FRENETIC_STRATEGY_OPTIONS"
"""Environment variable with the strategy's options, NAME=VALUE, separated by blanks."""
MAX_EXCEPTIONS: Final = 100
"""Number of exceptions of the executor in a row after which the search ends; our choice."""

_TIME_BUDGET: Final = "time-budget"  # the pipeline's name for a single budget
_END_TIMEOUT: Final = 60.0  # [s] for the search's process to end, our choice
_SEED_RANGE: Final = 2**31  # number of seeds to draw from if none is set, our choice


class Generator:
    """A test generator for the official pipeline, around a search strategy.

    Args:
        executor: the pipeline's executor.
        map_size: side of the square map, in m.
        time_budget: time budget in s; only the pipeline of 2021 gives it, later ones ask the
            executor.

    Raises:
        RuntimeError: the pipeline cannot be imported.
    """

    strategy: ClassVar[str]
    """Strategy as ``frenetic ask-tell --strategy`` takes it, such as ``file.py:Class``."""

    def __init__(
        self, executor: Any, map_size: float = 200, time_budget: float | None = None
    ) -> None:
        try:
            pipeline = importlib.import_module("code_pipeline.tests_generation")
        except ImportError as error:
            raise RuntimeError(
                f"the competition's pipeline cannot be imported ({error}): this generator is run by"
                " the pipeline's competition.py"
            ) from error
        self._make_test = pipeline.RoadTestFactory.create_road_test
        self._executor = executor
        self._map_size = map_size
        self._budget = _TimeBudget(executor, time_budget)
        self._exceptions = 0  # of the executor, in a row
        self._outcomes: Counter[str] = Counter()  # of the executor's tests

    def start(self) -> None:
        """Search until the executor says that the budget is spent, or the search itself ends.

        Raises:
            RuntimeError: the search cannot be started, or breaks; the message says why.
            SystemExit: the executor ends the process when the budget is spent.
        """
        name = type(self).__name__
        seed = os.environ.get(SEED_VARIABLE, "").strip() or str(secrets.randbelow(_SEED_RANGE))
        folder = Path("campaigns").absolute() / f"{datetime.now():%Y%m%d-%H%M%S-%f}"
        strategy_options = _strategy_options()
        arguments = ["--seed", seed, "--out", str(folder), "--map-size", str(self._map_size)]
        arguments += ["--name", type(self._executor).__name__]
        arguments += ["--strategy", ",".join([self.strategy, *strategy_options])]
        total_time = math.ceil(sum(self._budget.totals.values()))
        if total_time > 0:
            # Only for the campaign's record: each result reports the share that is spent.
            arguments += ["--time", str(total_time)]
        options_text = " ".join(strategy_options) or "by default"
        logger.info(
            f"{name} starts: seed {seed}, options {options_text}, map of {self._map_size:g} m,"
            f" budget {self._budget.totals or 'unknown'}, campaign in {folder}"
        )
        try:
            with _Search(arguments) as search:
                self._execute_roads(search)
        finally:
            counts = ", ".join(f"{n} {outcome}" for outcome, n in sorted(self._outcomes.items()))
            logger.info("%s ends after %s", name, counts or "no test")

    def _execute_roads(self, search: _Search) -> None:
        """Execute the roads that the search proposes, and report their results to it."""
        while not self._is_over():
            answer = search.call("ask")
            if "candidate" not in answer:
                logger.warning("the search ends: %s", answer.get("end", answer))
                return
            road = answer["candidate"]
            result = {"id": road["id"], **self._execute(road)}
            result["budget_spent"] = self._budget.share_spent()
            answer = search.call("tell", **result)
            if "error" in answer:
                # The search refuses the executor's records, but waits for a result of the road. The
                # MOOBD is computed from these records, so it is dropped, too. The rest has no entry
                # that the search could refuse: its answer needs no check.
                logger.warning("road %d: nothing is learnt, as %s", road["id"], answer["error"])
                least_result = {name: result[name] for name in ("id", "outcome", "budget_spent")}
                search.call("tell", **least_result)

    def _execute(self, road: dict[str, Any]) -> dict[str, Any]:
        """Let the executor drive a road; return the entries of the result for the search."""
        try:
            # The pipeline wants a list of tuples.
            test = self._make_test([(x, y) for x, y in road["points"]])
            outcome, description, records = self._executor.execute_test(test)
        except Exception as error:
            logger.warning("road %d: the executor raised %s", road["id"], _describe(error))
            logger.debug("the executor raised", exc_info=True)
            _restart_generation_clock(self._executor)
            self._exceptions += 1
            self._outcomes["exceptions"] += 1
            return {"outcome": "ERROR", "reason": f"the executor raised {_describe(error)}"}
        self._exceptions = 0
        self._outcomes[str(outcome)] += 1
        moobd = least_oob_distance(records)
        is_driven = str(outcome) in ("PASS", "FAIL")
        learnt = "nothing is learnt" if moobd is None else f"MOOBD {moobd:.2f} m"
        level = logging.WARNING if moobd is None or not is_driven else logging.INFO
        logger.log(level, "road %d: %s, %s, %s", road["id"], outcome, learnt, description)
        if not is_driven:
            # The search takes PASS, FAIL and ERROR only. So a road that the executor refused as
            # INVALID counts as ERROR, too, from which the search learns nothing; the reason keeps
            # the executor's own word.
            return {"outcome": "ERROR", "reason": f"{outcome}: {description}"}
        result: dict[str, Any] = {"outcome": str(outcome), "reason": str(description or "")}
        if moobd is not None:
            result.update(_course(records, road), moobd=moobd)
        return result

    def _is_over(self) -> bool:
        """Return whether the budget is spent, or the executor raises again and again."""
        if self._exceptions >= MAX_EXCEPTIONS:
            logger.error("the executor raised %d times in a row: giving up", self._exceptions)
            return True
        if not hasattr(self._executor, "is_over"):  # the pipeline of 2021 has none
            return self._budget.share_spent() >= 1.0
        try:
            return bool(self._executor.is_over())
        except Exception as error:
            logger.warning("is_over: the executor raised %s", _describe(error))
            self._exceptions += 1
            return False


class FreneticGenerator(Generator):
    """The default strategy: it looks for roads that fail in other ways than known failures."""

    strategy = "frenetic"


class Frenetic2021Generator(Generator):
    """The strategy of the 2021 paper: random roads, then mutants and crossovers of the worst."""

    strategy = "frenetic-2021"


class RandomSearchGenerator(Generator):
    """The baseline: random roads only."""

    strategy = "random"


def _strategy_options() -> list[str]:
    """Return the strategy's options from `OPTIONS_VARIABLE`, each NAME=VALUE.

    Raises:
        RuntimeError: the variable has a quote that is not closed.
    """
    text = os.environ.get(OPTIONS_VARIABLE, "")
    try:
        return shlex.split(text)
    except ValueError as error:
        raise RuntimeError(f"{OPTIONS_VARIABLE} is {text!r}: {error}") from None


class _Search:
    """``frenetic ask-tell`` in a process of its own; a context manager that ends it.

    Args:
        arguments: arguments of the command.

    Raises:
        RuntimeError: the command is not found, or cannot be started.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        command = [*_frenetic_command(), "ask-tell", *arguments]
        self._command_line = " ".join(map(shlex.quote, command))
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed by `__exit__`
        try:
            self._process = subprocess.Popen(  # noqa: S603  # the user's own command
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                encoding="utf-8",
            )
        except OSError as error:
            self._log.close()
            raise RuntimeError(
                f"{command[0]} cannot be started ({error}): set {COMMAND_VARIABLE} to the command"
                " frenetic"
            ) from None

    def call(self, request: str, **values: Any) -> dict[str, Any]:
        """Return the answer to a request, ``ask`` or ``tell``.

        Raises:
            RuntimeError: the process has ended, or its answer is no JSON, after which it is ended;
                the message holds its last line of stderr.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({request: values}) + "\n")
            self._process.stdin.flush()
            answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        except (OSError, ValueError, RecursionError):  # the last: JSON that is nested too deeply
            self._end()
            self._log.seek(0)
            lines = self._log.read().decode("utf-8", "replace").split("\n")
            last_line = next((line for line in reversed(lines) if line.strip()), "it said nothing")
            raise RuntimeError(
                f"the search has ended: {last_line}; it was {self._command_line}"
            ) from None
        return answer

    def _end(self) -> None:
        """End the process; it stores the campaign's summary when its input ends."""
        assert self._process.stdin is not None
        with suppress(OSError):  # raised if the process has not read the last request
            self._process.stdin.close()
        try:
            self._process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> _Search:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._log.close()


def _frenetic_command() -> list[str]:
    """Return the program and arguments that start ``frenetic``.

    Raises:
        RuntimeError: the command is not found.
    """
    text = os.environ.get(COMMAND_VARIABLE, "").strip()
    if text:
        # On Windows a backslash separates folders, and quotes stay around the words.
        return [word.strip('"') for word in shlex.split(text, posix=os.name != "nt")]
    program = shutil.which("frenetic")
    if program:
        return [program]
    # Another generator's package may be called frenetic, too: msgspec shows that it is ours. -P
    # keeps the current folder, which may hold such a package, off the path.
    if importlib.util.find_spec("frenetic") and importlib.util.find_spec("msgspec"):
        return [sys.executable, "-P", "-m", "frenetic"]
    raise RuntimeError(
        f"the command frenetic is not found: install frenetic-roads on Python 3.11 or newer, and"
        f" set {COMMAND_VARIABLE} to its path"
    )


class _TimeBudget:
    """The time budget of an executor, and the share of it that is spent.

    The pipeline of 2022 can also run with two budgets, for generation and for execution; then the
    larger share counts, since either ends the search.

    Args:
        executor: the pipeline's executor, which knows the remaining time.
        total: the whole time budget in s, if the pipeline gives it; by default the executor's
            ``time_budget.time_budget``, or else the remaining time.
    """

    def __init__(self, executor: Any, total: float | None) -> None:
        self._executor = executor
        self._share = 0.0
        self._is_readable = True  # whether the executor's latest answer could be read
        self.totals = self._remaining()
        """Name of each budget -> its whole time, in s."""
        for value in (total, getattr(getattr(executor, "time_budget", None), "time_budget", None)):
            number = _number(value) or 0.0
            if number > 0.0:
                self.totals = {_TIME_BUDGET: number}
                break

    def share_spent(self) -> float:
        """Return the spent share, 0 to 1; the last known share if the executor does not answer."""
        remaining = self._remaining()
        shares = [
            (total - remaining[name]) / total
            for name, total in self.totals.items()
            if name in remaining and total > 0.0
        ]
        if shares:
            self._share = min(max(*shares, 0.0), 1.0)
        return self._share

    def _remaining(self) -> dict[str, float]:
        """Return name of each budget -> remaining time in s; empty if the executor does not say."""
        try:
            answer = self._executor.get_remaining_time()
            reason = "its answer is no number"
        except Exception as error:
            answer, reason = {}, _describe(error)
        values = answer if isinstance(answer, dict) else {_TIME_BUDGET: answer}
        numbers = {name: _number(value) for name, value in values.items()}
        remaining = {name: number for name, number in numbers.items() if number is not None}
        if not remaining and self._is_readable:  # warned of once
            logger.warning("the executor does not say what time remains: %s", reason)
        self._is_readable = bool(remaining)
        return remaining


def least_oob_distance(records: Any) -> float | None:
    """Return the least oob distance (MOOBD, minimum out-of-bounds distance) of records, in m.

    The result is None if no record has a finite oob distance.
    """
    try:
        distances = [_number(getattr(record, "oob_distance", None)) for record in records]
    except Exception:  # the pipeline gives no list of records
        return None
    return min((distance for distance in distances if distance is not None), default=None)


def _course(records: Any, road: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of a result that describe the drive's course.

    These are

    - ``records``, with a column for each signal;
    - ``place``, the distance along the road in m at which the car first left its lane (the first
      record with ``is_oob``), or else came nearest to leaving it (the least oob distance);
    - ``side``, the side on which the car left its lane, if it did.

    There are no entries if a record lacks a position or a speed.

    Args:
        records: records of the pipeline.
        road: the candidate as the search has sent it.
    """
    try:
        columns = {
            "time": [float(record.timer) for record in records],
            "x": [float(record.pos[0]) for record in records],
            "y": [float(record.pos[1]) for record in records],
            "speed": [math.hypot(record.vel[0], record.vel[1]) for record in records],
        }
        is_out = [bool(getattr(record, "is_oob", False)) for record in records]
        oob_distances = [_number(getattr(record, "oob_distance", None)) for record in records]
    except Exception:  # records of another form than the pipeline's
        return {}
    if not all(math.isfinite(value) for column in columns.values() for value in column):
        return {}
    degree = math.radians(1.0)  # the pipeline's unit of steering; the search takes radians
    for name, unit in ("steering", degree), ("throttle", 1.0), ("brake", 1.0):
        column = [_number(getattr(record, name, None)) for record in records]
        if None not in column:
            columns[name] = [value * unit for value in column if value is not None]
    distances = [math.inf if distance is None else distance for distance in oob_distances]
    i = is_out.index(True) if any(is_out) else distances.index(min(distances))
    place, offset = _nearest_on_line(road["points"], columns["x"][i], columns["y"][i])
    course: dict[str, Any] = {"records": columns, "place": place}
    if any(is_out):
        # The road's points are its centre line; the car's lane lies to the right of it.
        course["side"] = "left" if offset > -0.5 * road["lane_width"] else "right"
    return course


def _nearest_on_line(points: Sequence[Sequence[float]], x: float, y: float) -> tuple[float, float]:
    """Return how far along a line, and how far to the left of it, the point x, y is, in m."""
    nearest = (math.inf, 0.0, 0.0)  # distance from the line, distance along it, offset to the left
    along = 0.0  # [m] along the line to point a, where the segment from a to b begins
    ax, ay = points[0]
    for bx, by in points[1:]:
        dx, dy = bx - ax, by - ay
        length = math.hypot(dx, dy)
        share = min(max(((x - ax) * dx + (y - ay) * dy) / length**2, 0.0), 1.0)
        distance = math.hypot(x - ax - share * dx, y - ay - share * dy)
        offset = math.copysign(distance, dx * (y - ay) - dy * (x - ax))
        nearest = min(nearest, (distance, along + share * length, offset))
        along += length
        ax, ay = bx, by
    return nearest[1:]


def _restart_generation_clock(executor: Any) -> None:
    """Make an executor usable again after `execute_test` has raised.

    After an exception, executors of the pipelines since 2022 hold None as the time at which the
    next test's generation began; every further `execute_test` would fail to subtract it.
    """
    if getattr(executor, "start_generation_time", 0.0) is None:
        executor.start_generation_time = time.monotonic()


def _number(value: Any) -> float | None:
    """Return a value as a number; None if it is no finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _describe(error: Exception) -> str:
    """Return an error's type and message."""
    return f"{type(error).__name__}: {error}"
