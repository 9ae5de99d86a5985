"""Asking and telling a strategy, with checks and a clock, live and in the replay of a log."""

from __future__ import annotations

import json
import time
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from numbers import Integral
from typing import Any, Final
from weakref import WeakValueDictionary

import numpy as np

from frenetic._support.bounds import is_number, shown
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.outside_text import read_json
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.objective import Objective
from frenetic.campaign.record import Attempt
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Summary
from frenetic.errors import CampaignError, StrategyError, describe_raised
from frenetic.parts.versions import changed_packages
from frenetic.processes.children import one_process
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy, has_own
from frenetic.spec import Budget
from frenetic.spec.part_record import is_built_in

FACTS: Final = "search"
"""Fact with the strategy's facts about its search, see `frenetic.Strategy.facts`."""


class ObservingStrategy(Strategy):
    """A strategy that sees each test whole, with its drive, right before `tell`.

    Drives are exact only in the process that drove them, so its campaign has one worker and cannot
    be resumed.
    """

    @abstractmethod
    def observe(self, attempt: Attempt) -> None:
        """Look at the last attempt to test the candidate of the next `tell`."""


_used: Final[WeakValueDictionary[int, Strategy]] = WeakValueDictionary()
"""id() -> a strategy that a campaign of this process has used."""


def _mark_used(strategy: Strategy) -> None:
    _used[id(strategy)] = strategy


def require_fresh(strategy: Strategy) -> None:
    """Check that a strategy has not searched yet, as far as that can be known.

    It is known for built-in strategies, and for those that a campaign of this process has asked.
    The proposals of a used strategy follow from more than its arguments, so its campaign could be
    neither repeated nor resumed.

    Raises:
        CampaignError: the strategy was asked before.
    """
    is_used = _used.get(id(strategy)) is strategy
    if is_built_in(strategy):
        ledgers = [value for value in vars(strategy).values() if isinstance(value, Ledger)]
        is_used = is_used or any(ledger.issued for ledger in ledgers)
    if is_used:
        raise CampaignError(
            f"the strategy {type(strategy).__name__} was asked before: make a new one for each"
            " campaign and each resume(); a Campaign that has run goes on with run()"
        )


def require_valid_roads(strategy: Strategy) -> None:
    """Check that the strategy can propose a valid road, as far as it knows.

    Raises:
        CampaignError: the strategy can propose no valid road, or its code raised.
    """
    try:
        strategy.require_valid_roads()
    except ValueError as error:
        raise CampaignError(str(error)) from error
    except (Exception, SystemExit) as error:
        raise CampaignError(str(strategy_error(error))) from error


def start(strategy: Strategy, earlier: Sequence[Evaluation], summary: Summary) -> None:
    """Tell the strategy the evaluations of earlier campaigns, and count its time.

    Raises:
        CampaignError: the strategy raised, or starts from no earlier campaign.
    """
    if not earlier:
        return
    if not has_own(strategy, "start_from"):
        raise StrategyError(
            f"the campaign started from earlier ones, but the strategy {type(strategy).__name__}"
            " has no start_from"
        )
    _mark_used(strategy)
    with _own_time(summary, CampaignError):
        strategy.start_from(earlier)


def ask(strategy: Strategy, summary: Summary) -> Candidate | None:
    """Return the strategy's next candidate, None if it needs a result first; count its time.

    Raises:
        SearchEnded: the strategy has no candidate left.
        CampaignError: the strategy raised, or its proposal cannot be stored.
    """
    _mark_used(strategy)
    with _own_time(summary, SearchEnded):
        candidate = strategy.ask()
    if candidate is None:
        return None
    if not isinstance(candidate, Candidate):
        raise StrategyError(
            f"the strategy proposed {type(candidate).__name__} instead of frenetic.Candidate"
        )
    if fault := _fault_of(candidate):
        raise StrategyError(f"the strategy proposed candidate {shown(candidate.id)} with {fault}")
    return candidate


def _fault_of(candidate: Any) -> str:
    """Return why a proposal cannot be driven and stored; empty if it can."""
    curvatures, points = candidate.curvatures, candidate.points
    if not _is_whole(candidate.id, 1):
        return "this id: a whole number of at least 1 is needed"
    if curvatures.ndim != 1:
        return f"curvatures of shape {curvatures.shape}: one row of numbers is needed"
    if points is not None and (points.ndim != 2 or points.shape[1] != 2):
        return f"points of shape {points.shape}: (N, 2) is needed"
    if not (np.isfinite(curvatures).all() and (points is None or np.isfinite(points).all())):
        return "values that are not finite"
    if not (is_number(candidate.step) and candidate.step > 0.0):
        return f"the step {shown(candidate.step)}: a positive number of metres is needed"
    origin = candidate.origin
    if not isinstance(candidate.origin, Origin):
        return f"the origin {shown(origin)}: a frenetic.search.Origin is needed"
    if not isinstance(origin.operator, str):
        return f"the operator {shown(origin.operator)}: a text is needed"
    if not (
        isinstance(origin.parents, Iterable)
        and all(isinstance(parent, Integral) for parent in origin.parents)
    ):
        return f"the parents {shown(origin.parents)}: a tuple of ids is needed"
    if not _is_whole(origin.generation, 0):
        return f"the generation {shown(origin.generation)}: a whole number from 0 is needed"
    try:
        read_json(json.dumps(dict(candidate.notes), default=plain, allow_nan=False))
    except (TypeError, ValueError, RecursionError):
        return f"the notes {shown(candidate.notes)}: names with plain values are needed"
    return ""


def _is_whole(value: object, least: int) -> bool:
    """Return whether a value is a whole number that the database can hold."""
    return isinstance(value, Integral) and least <= int(value) < 2**63


def tell(strategy: Strategy, evaluation: Evaluation, summary: Summary) -> None:
    """Tell the strategy an evaluation, and count its time.

    Raises:
        CampaignError: the strategy raised.
    """
    with _own_time(summary, CampaignError):  # a damaged trajectory
        strategy.tell(evaluation)


def notice_of(strategy: Strategy) -> str:
    """Return the strategy's notice about its search; empty without a notice.

    Raises:
        StrategyError: the strategy raised.
    """
    try:
        return strategy.notice or ""
    except (Exception, SystemExit) as error:
        raise strategy_error(error) from error


def facts_of(strategy: Strategy, summary: Summary) -> dict[str, JSONValue]:
    """Return the strategy's facts about its search, and count its time.

    Raises:
        StrategyError: the strategy raised, or a fact is no plain value.
    """
    with _own_time(summary, StrategyError):
        text = json.dumps(dict(strategy.facts()), default=plain, allow_nan=False)
        facts: dict[str, JSONValue] = read_json(text)
    return facts


@contextmanager
def _own_time(summary: Summary, passing: type[Exception]) -> Iterator[None]:
    """Count the strategy's time, and blame it for exceptions other than ``passing``."""
    began = time.perf_counter()
    try:
        with one_process():
            yield
    except passing:
        raise
    except (Exception, SystemExit) as error:
        raise strategy_error(error) from error
    finally:
        summary.strategy_seconds += time.perf_counter() - began


def strategy_error(error: BaseException) -> StrategyError:
    """Return the error about an exception of a strategy."""
    return StrategyError(f"the strategy raised {describe_raised(error)}")


# Replay


def replay(
    store: CampaignStore,
    strategy: Strategy,
    budget: Budget,
    objective: Objective,
    *,
    earlier: Sequence[Evaluation] = (),
) -> tuple[Summary, dict[int, Candidate]]:
    """Replay the stored tests to a fresh strategy, asking and telling in the same order.

    Args:
        store: of the campaign.
        strategy: a fresh strategy.
        budget: of the campaign.
        objective: of the campaign.
        earlier: evaluations of the earlier campaigns from which it started.

    Returns:
        The progress, and the candidates without a result, by id in the order of asking.

    Raises:
        CampaignError: the strategy is not fresh, or proposes another road than the stored one, or
            the database is damaged.
    """
    if isinstance(strategy, ObservingStrategy):
        raise CampaignError(
            f"{store.folder} cannot be resumed: its strategy observes drives, which are not kept"
            " exactly; start a new campaign"
        )
    require_fresh(strategy)
    summary = Summary(lane_width=store.lane_width)
    start(strategy, earlier, summary)
    asked = store.candidates()
    following = next(asked, None)
    outstanding: dict[int, Candidate] = {}

    def ask_until(result_count: int) -> None:
        nonlocal following
        while following is not None and following[1] <= result_count:
            logged = following[0]
            if not _is_same(logged, _proposed(strategy, summary)):
                raise _differs(store, logged)
            outstanding[logged.id] = logged
            following = next(asked, None)

    for test in store.tests():
        ask_until(summary.result_count)
        candidate = outstanding.pop(test.id, None)
        if candidate is None:
            raise CampaignError(
                f"{store.folder} is damaged: candidate {test.id} was told before it was asked"
            )
        evaluation = evaluation_of(test, partial(store.trajectory, test.id), objective)
        tell(strategy, evaluation, summary)
        summary.add(candidate, test.outcome, test.moobd)
        summary.note_objective(objective, evaluation)
        summary.seconds = test.elapsed
        summary.update_budget_spent(budget, summary.seconds, test.reported_share)
    ask_until(summary.result_count)
    return summary, outstanding


def _proposed(strategy: Strategy, summary: Summary) -> Candidate | None:
    try:
        return ask(strategy, summary)
    except SearchEnded:
        return None


def _is_same(logged: Candidate, proposed: Candidate | None) -> bool:
    return (
        proposed is not None
        and proposed.id == logged.id
        and proposed.step == logged.step
        and proposed.origin == logged.origin
        and np.array_equal(proposed.curvatures, logged.curvatures)
    )


def _differs(store: CampaignStore, logged: Candidate) -> CampaignError:
    differing = changed_packages(store.config.get("versions"))
    return CampaignError(
        f"{store.folder} cannot be resumed: the strategy now proposes another road as candidate"
        f" {logged.id} than it did; "
        + (f"versions differ: {', '.join(differing)}" if differing else "was it changed?")
    )
