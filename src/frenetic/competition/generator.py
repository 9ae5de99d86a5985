"""The loop of a test generator: ask the strategy, run valid roads, tell the results."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar, Final

from frenetic import search
from frenetic._support.compiled import IS_COMPILED
from frenetic.competition.pipeline import (
    Executor,
    RoadTests,
    TimeBudget,
    least_oob_distance,
    make_strategy,
    read_options,
    read_seed,
    restart_generation_clock,
    trace_of,
)
from frenetic.errors import FreneticError, RoadError, describe_error
from frenetic.outcome import Outcome
from frenetic.road import MAP_SIZE, Road, Verdict
from frenetic.search import Candidate, Evaluation
from frenetic.search.strategy import notice_of

logger = logging.getLogger(__name__)

MOST_EXCEPTIONS: Final = 100
"""Consecutive exceptions of the executor after which the search ends."""
REHEARSED: Final = 40
"""Made-up tests of each strategy before the clock starts."""
MANY_INVALID: Final = 100
"""Consecutive invalid roads after which the log says so."""

_OUTCOMES: Final = {
    str(outcome): outcome for outcome in (Outcome.PASS, Outcome.FAIL, Outcome.INVALID)
}


class Generator:
    """A test generator for the official pipeline, around a search strategy.

    For your own strategy::

        class Mine(Generator):
            strategy = MyStrategy

    Seed and options come from the environment, see `frenetic.competition.pipeline`, or from the
    class; the environment takes precedence.

    Args:
        executor: The pipeline's executor.
        map_size: m, side of the square map.
        time_budget: s; only the pipeline of 2021 gives it, later ones ask the executor.

    Raises:
        FreneticError: Map size, seed or options cannot be used, or there is no pipeline.

    """

    strategy: ClassVar[type[Any]]
    """Class of the strategy; seed and map size are passed to one that takes them."""
    seed: ClassVar[int | None] = None
    """A whole number of at least 0; None for a new one in every run, which is logged."""
    options: ClassVar[Mapping[str, Any]] = {}
    """Options of the strategy."""

    def __init__(
        self,
        executor: Executor,
        map_size: float = MAP_SIZE,
        time_budget: float | None = None,
    ) -> None:
        if not 0.0 < map_size < math.inf:
            raise FreneticError(f"map_size is {map_size}, but must be a positive number of metres")
        kind = type(self)
        self._executor = executor
        self._budget = TimeBudget(executor, time_budget)
        self._road_tests = RoadTests()
        self._map_size = float(map_size)
        self._seed = read_seed(kind.seed)
        self._options = read_options(kind.options)
        self._strategy = make_strategy(
            kind.strategy, seed=self._seed, map_size=self._map_size, options=self._options
        )
        self._notice: str | None = None
        self._exceptions = 0  # one after the other
        self._invalid = 0  # one after the other
        self._tally: Counter[str] = Counter()  # of what the executor answered

    def start(self) -> None:
        """Search until the executor reports that the budget is spent.

        Raises:
            SystemExit: The executor ends the process when the budget is spent; it passes through.

        """
        logger.info(
            "%s starts: seed %d, %s, map of %g m, %s, kernels %s",
            type(self).__name__,
            self._seed,
            f"options {self._options}" if self._options else "default options",
            self._map_size,
            ", ".join(f"{name} {total:g} s" for name, total in self._budget.totals.items())
            or "unknown time budget",
            "compiled" if IS_COMPILED else "not compiled: numba is missing",
        )
        try:
            while not self._is_over():
                candidate = self._strategy.ask()
                if candidate is None:
                    raise FreneticError("the strategy wants a result, and none is outstanding")
                self._try_road(candidate)
        finally:
            counts = ", ".join(f"{n} {answer}" for answer, n in sorted(self._tally.items()))
            logger.info("%s ends after %s", type(self).__name__, counts or "no test")

    def _try_road(self, candidate: Candidate) -> None:
        road, verdict = self._placed(candidate)
        if road is None or not verdict.valid:
            self._refuse(candidate, verdict)
            return
        self._invalid = 0
        self._tell(self._execute(candidate, road))

    def _placed(self, candidate: Candidate) -> tuple[Road | None, Verdict]:
        try:
            return Road(candidate.curvatures, candidate.step).placed(self._map_size)
        except RoadError as error:
            return None, Verdict(False, str(error))

    def _refuse(self, candidate: Candidate, verdict: Verdict) -> None:
        logger.debug("road %d is not handed over: %s", candidate.id, verdict.message)
        self._invalid += 1
        if self._invalid % MANY_INVALID == 0:
            logger.warning("%d invalid roads in a row, now: %s", self._invalid, verdict.message)
        self._tell(Evaluation(candidate, Outcome.INVALID, None, 0.0))

    def _execute(self, candidate: Candidate, road: Road) -> Evaluation:
        """Run a road; return its evaluation, which lacks the spent budget."""
        nothing = Evaluation(candidate, Outcome.ERROR, None, 0.0)
        try:
            test = self._road_tests.make(road.road_points)
            answer, description, execution_data = self._executor.execute_test(test)
        except Exception as error:
            logger.warning("%s: the executor raised %s", _name(candidate), describe_error(error))
            logger.debug("the executor raised", exc_info=True)
            restart_generation_clock(self._executor)
            self._exceptions += 1
            self._tally["exceptions"] += 1
            return nothing
        self._exceptions = 0
        self._tally[str(answer)] += 1
        outcome = _OUTCOMES.get(str(answer), Outcome.ERROR)
        moobd = least_oob_distance(execution_data)
        logger.log(
            logging.INFO if outcome.is_driven else logging.WARNING,
            "test %s, %s: %s%s, %s",
            getattr(test, "id", "?"),
            _name(candidate),
            answer,
            "" if moobd is None else f", MOOBD {moobd:.2f} m",
            description,
        )
        if not outcome.is_driven:
            return replace(nothing, outcome=outcome)
        if moobd is None:
            logger.warning("%s: nothing is learnt, as no oob distance came", _name(candidate))
            return nothing
        return _traced(replace(nothing, outcome=outcome, moobd=moobd), road, execution_data)

    def _tell(self, evaluation: Evaluation) -> None:
        spent = self._budget.share_spent()
        logger.debug("%.1f %% of the budget are spent", 100.0 * spent)
        self._strategy.tell(replace(evaluation, budget_spent=spent))
        notice = notice_of(self._strategy)
        if notice is not None and notice != self._notice:
            logger.info("%s", notice)
        self._notice = notice

    def _is_over(self) -> bool:
        if self._exceptions >= MOST_EXCEPTIONS:
            logger.error("the executor raised %d times in a row: giving up", self._exceptions)
            return True
        if not hasattr(self._executor, "is_over"):  # in 2021 only the remaining time told
            return self._budget.share_spent() >= 1.0
        try:
            return bool(self._executor.is_over())
        except Exception as error:
            logger.warning("is_over: the executor raised %s", describe_error(error))
            self._exceptions += 1
            return False


class Frenetic(Generator):
    """Roads that fail as no known failure does: `frenetic.search.Frenetic`."""

    strategy = search.Frenetic


class Frenetic2021(Generator):
    """Random roads, then mutants and crossovers of the worst: `frenetic.search.Frenetic2021`."""

    strategy = search.Frenetic2021


class RandomSearch(Generator):
    """Random roads only, the baseline: `frenetic.search.RandomSearch`."""

    strategy = search.RandomSearch


def _traced(told: Evaluation, road: Road, execution_data: Any) -> Evaluation:
    """An evaluation with the drive's trace, if the records have one."""
    traced = trace_of(execution_data, road)
    if traced is None:
        return told
    trace, worst = traced
    told = replace(told, place=float(trace.distance[worst]), read_trace=lambda: trace)
    if told.outcome is not Outcome.FAIL:
        return told
    return replace(told, side="left" if trace.lateral_offset[worst] > 0.0 else "right")


def rehearse() -> None:
    """Search with made-up drives, so that every kernel is compiled afterwards."""
    for strategy in (search.Frenetic(seed=1), search.Frenetic2021(seed=1)):
        for number in range(REHEARSED):
            candidate = strategy.ask()
            evaluation = Evaluation(candidate, Outcome.INVALID, None, number / REHEARSED)
            road, verdict = Road(candidate.curvatures, candidate.step).placed()
            if road is not None and verdict.valid:
                # The first fails: kernels have a form for one known road, and one for several.
                has_failed = number % 3 == 0
                records = [
                    SimpleNamespace(pos=(x + 2.0, y, 0.0), vel=(9.0, 0.0, 0.0), is_oob=has_failed)
                    for x, y in road.road_points.tolist()
                ]
                outcome, moobd = (Outcome.FAIL, -2.0) if has_failed else (Outcome.PASS, -0.6)
                told = replace(evaluation, outcome=outcome, moobd=moobd)
                evaluation = _traced(told, road, records)
            strategy.tell(evaluation)


def _name(candidate: Candidate) -> str:
    """A candidate in the log: its number and origin."""
    origin = candidate.origin
    parents = " and ".join(str(parent) for parent in origin.parents)
    return f"road {candidate.id} ({origin.operator}{' of ' if parents else ''}{parents})"


if IS_COMPILED:
    rehearse()  # on import: in the pipeline the clock starts later
