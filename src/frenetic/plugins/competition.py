"""Frenetic as a plug-in of the official SBST/SBFT pipeline: its test generators.

``competition.py --module-name frenetic.plugins.competition --class-name FreneticGenerator`` runs
one. It is a client of ``frenetic ask-tell``, which searches in a process of its own. So this file,
or a copy of it under another name, needs Python 3.9 and the standard library alone.
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

COMMAND: Final = "FRENETIC_COMMAND"
"""Environment variable: the command ``frenetic``, if it is not on the path."""
SEED_VARIABLE: Final = "FRENETIC_SEED"
"""Environment variable: a whole number of at least 0."""
OPTIONS: Final = "FRENETIC_STRATEGY_OPTIONS"
"""Environment variable: NAME=VALUE, several separated by blanks."""
MOST_EXCEPTIONS: Final = 100
"""Consecutive exceptions of the executor after which the search ends."""

_TIME_BUDGET: Final = "time-budget"
_PATIENCE: Final = 60.0  # [s], ours, for the search's process to end


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
    """The strategy as ``frenetic ask-tell --strategy`` takes it, such as ``file.py:Class``."""

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
        self._exceptions = 0  # in a row
        self._answers: Counter[str] = Counter()  # of the executor

    def start(self) -> None:
        """Search until the executor says that the budget is spent.

        Raises:
            RuntimeError: the search cannot be started, or breaks; the message says why.
            SystemExit: the executor ends the process when the budget is spent.
        """
        name = type(self).__name__
        seed = os.environ.get(SEED_VARIABLE, "").strip() or str(secrets.randbelow(2**31))
        folder = Path("campaigns").absolute() / f"{datetime.now():%Y%m%d-%H%M%S-%f}"
        words = ["--seed", seed, "--out", str(folder)]
        words += ["--map-size", str(self._map_size), "--name", type(self._executor).__name__]
        total = math.ceil(sum(self._budget.totals.values()))
        if (
            total > 0
        ):  # for the record: the spent share that is reported replaces the search's count
            words += ["--time", str(total)]
        try:
            settings = shlex.split(os.environ.get(OPTIONS, ""))
        except ValueError as error:
            raise RuntimeError(f"{OPTIONS} is {os.environ[OPTIONS]!r}: {error}") from None
        words += ["--strategy", ",".join([self.strategy, *settings])]
        options, budget = " ".join(settings) or "by default", self._budget.totals or "unknown"
        logger.info(
            f"{name} starts: seed {seed}, options {options}, map of {self._map_size:g} m,"
            f" budget {budget}, campaign in {folder}"
        )
        try:
            with _Search(words) as search:
                self._follow(search)
        finally:
            counts = ", ".join(f"{n} {answer}" for answer, n in sorted(self._answers.items()))
            logger.info("%s ends after %s", name, counts or "no test")

    def _follow(self, search: _Search) -> None:
        """Execute the roads that the search asks for, and report their results to it."""
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
                logger.warning("road %d: nothing is learnt, as %s", road["id"], answer["error"])
                result = {name: result[name] for name in ("id", "outcome", "budget_spent")}
                search.call("tell", **result)

    def _execute(self, road: dict[str, Any]) -> dict[str, Any]:
        """Run a road; return its result as the search takes it."""
        try:
            # The pipeline wants a list of tuples.
            test = self._make_test([(x, y) for x, y in road["points"]])
            answer, description, records = self._executor.execute_test(test)
        except Exception as error:
            logger.warning("road %d: the executor raised %s", road["id"], _describe(error))
            logger.debug("the executor raised", exc_info=True)
            _restart_generation_clock(self._executor)
            self._exceptions += 1
            self._answers["exceptions"] += 1
            return {"outcome": "ERROR", "reason": f"the executor raised {_describe(error)}"}
        self._exceptions = 0
        self._answers[str(answer)] += 1
        moobd = least_oob_distance(records)
        is_driven = str(answer) in ("PASS", "FAIL")
        learnt = "nothing is learnt" if moobd is None else f"MOOBD {moobd:.2f} m"
        level = logging.WARNING if moobd is None or not is_driven else logging.INFO
        logger.log(level, "road %d: %s, %s, %s", road["id"], answer, learnt, description)
        if not is_driven:
            return {"outcome": "ERROR", "reason": f"{answer}: {description}"}
        result: dict[str, Any] = {"outcome": str(answer), "reason": str(description or "")}
        if moobd is not None:
            result.update(_course(records, road), moobd=moobd)
        return result

    def _is_over(self) -> bool:
        if self._exceptions >= MOST_EXCEPTIONS:
            logger.error("the executor raised %d times in a row: giving up", self._exceptions)
            return True
        if not hasattr(self._executor, "is_over"):  # in 2021 only the remaining time told
            return self._budget.share_spent() >= 1.0
        try:
            return bool(self._executor.is_over())
        except Exception as error:
            logger.warning("is_over: the executor raised %s", _describe(error))
            self._exceptions += 1
            return False


class FreneticGenerator(Generator):
    """Roads that fail as no known failure does."""

    strategy = "frenetic"


class Frenetic2021Generator(Generator):
    """Random roads, then mutants and crossovers of the worst."""

    strategy = "frenetic-2021"


class RandomSearchGenerator(Generator):
    """Random roads only, the baseline."""

    strategy = "random"


class _Search:
    """``frenetic ask-tell`` in a process of its own; a context manager that ends it."""

    def __init__(self, words: Sequence[str]) -> None:
        command = [*_frenetic(), "ask-tell", *words]
        self._line = " ".join(map(shlex.quote, command))
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  # closed with the process
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
                f"{command[0]} cannot be started ({error}): set {COMMAND} to the command frenetic"
            ) from None

    def call(self, request: str, **values: Any) -> dict[str, Any]:
        """Return the answer to a request.

        Raises:
            RuntimeError: the process has ended; the message is its last line.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({request: values}) + "\n")
            self._process.stdin.flush()
            answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        except (OSError, ValueError, RecursionError):
            self._end()
            self._log.seek(0)
            lines = self._log.read().decode("utf-8", "replace").split("\n")
            last = next((line for line in reversed(lines) if line.strip()), "it said nothing")
            raise RuntimeError(f"the search has ended: {last}; it was {self._line}") from None
        return answer

    def _end(self) -> None:
        assert self._process.stdin is not None
        with suppress(OSError):  # a request that it did not read
            self._process.stdin.close()  # with its input, the search ends and stores its summary
        try:
            self._process.wait(_PATIENCE)
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


def _frenetic() -> list[str]:
    """Return the command ``frenetic``.

    Raises:
        RuntimeError: the command is not found.
    """
    text = os.environ.get(COMMAND, "").strip()
    if text:
        return [word.strip('"') for word in shlex.split(text, posix=os.name != "nt")]
    program = shutil.which("frenetic")
    if program:
        return [program]
    if importlib.util.find_spec("frenetic") and importlib.util.find_spec("msgspec"):
        return [sys.executable, "-P", "-m", "frenetic"]
    raise RuntimeError(
        f"the command frenetic is not found: install frenetic-roads on Python 3.11 or newer, and"
        f" set {COMMAND} to its path"
    )


class _TimeBudget:
    """The share of an executor's time budget that is spent.

    The pipeline of 2022 can also run with two budgets, for generation and for execution; then the
    larger share counts, since either ends the search.

    Args:
        executor: knows the remaining time.
        total: s, the whole time budget where the pipeline gives it; by default the executor's
            ``time_budget.time_budget``, or else the remaining time.
    """

    def __init__(self, executor: Any, total: float | None) -> None:
        self._executor = executor
        self._share = 0.0
        self._is_readable = True
        self.totals = self._remaining()
        """Seconds by name of each budget."""
        for value in (total, getattr(getattr(executor, "time_budget", None), "time_budget", None)):
            number = _number(value) or 0.0
            if number > 0.0:
                self.totals = {_TIME_BUDGET: number}
                break

    def share_spent(self) -> float:
        """Return the spent share, 0..1; the last one if the executor does not answer."""
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
        try:
            answer = self._executor.get_remaining_time()
            reason = "it tells no number"
        except Exception as error:
            answer, reason = {}, _describe(error)
        named = answer if isinstance(answer, dict) else {_TIME_BUDGET: answer}
        numbers = {name: _number(value) for name, value in named.items()}
        remaining = {name: number for name, number in numbers.items() if number is not None}
        if not remaining and self._is_readable:
            logger.warning("the executor does not say what time remains: %s", reason)
        self._is_readable = bool(remaining)
        return remaining


def least_oob_distance(records: Any) -> float | None:
    """Return the MOOBD in m of a test's records, None if no record has a finite oob distance."""
    try:
        distances = [_number(getattr(record, "oob_distance", None)) for record in records]
    except Exception:  # no list of records
        return None
    return min((d for d in distances if d is not None), default=None)


def _course(records: Any, road: dict[str, Any]) -> dict[str, Any]:
    """Return a drive's course for the search; nothing if the records lack a place or a speed.

    The car was furthest off at the first record with ``is_oob``, or else at the one with the least
    oob distance.
    """
    try:
        columns = {
            "time": [float(record.timer) for record in records],
            "x": [float(record.pos[0]) for record in records],
            "y": [float(record.pos[1]) for record in records],
            "speed": [math.hypot(record.vel[0], record.vel[1]) for record in records],
        }
        out = [bool(getattr(record, "is_oob", False)) for record in records]
        off = [_number(getattr(record, "oob_distance", None)) for record in records]
    except Exception:  # other records than the pipeline's
        return {}
    if not all(math.isfinite(value) for column in columns.values() for value in column):
        return {}
    for name, unit in ("steering", math.radians(1.0)), ("throttle", 1.0), ("brake", 1.0):
        column = [_number(getattr(record, name, None)) for record in records]
        if None not in column:
            columns[name] = [value * unit for value in column if value is not None]
    distances = [math.inf if distance is None else distance for distance in off]
    worst = out.index(True) if any(out) else distances.index(min(distances))
    place, offset = _along(road["points"], columns["x"][worst], columns["y"][worst])
    course: dict[str, Any] = {"records": columns, "place": place}
    if any(out):
        course["side"] = "left" if offset > -0.5 * road["lane_width"] else "right"
    return course


def _along(points: Sequence[Sequence[float]], x: float, y: float) -> tuple[float, float]:
    """Return how far along a line, and to the left of it, the point x, y lies, in m."""
    nearest, before = (math.inf, 0.0, 0.0), 0.0
    ax, ay = points[0]
    for bx, by in points[1:]:
        dx, dy = bx - ax, by - ay
        length = math.hypot(dx, dy)
        share = min(max(((x - ax) * dx + (y - ay) * dy) / length**2, 0.0), 1.0)
        away = math.hypot(x - ax - share * dx, y - ay - share * dy)
        side = math.copysign(away, dx * (y - ay) - dy * (x - ax))
        nearest = min(nearest, (away, before + share * length, side))
        before += length
        ax, ay = bx, by
    return nearest[1:]


def _restart_generation_clock(executor: Any) -> None:
    """Make an executor usable again after an exception out of `execute_test`.

    After one, executors of later pipelines hold None for the start of the next test's generation,
    and every further `execute_test` would fail to subtract it.
    """
    if getattr(executor, "start_generation_time", 0.0) is None:
        executor.start_generation_time = time.monotonic()


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _describe(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
