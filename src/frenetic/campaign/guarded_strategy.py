"""How a strategy is asked and told: checked, timed, live and in the replay of a log."""

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
from frenetic.campaign.objective import Objective, evaluation_of
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
"""Fact with what the strategy tells of its search, see `frenetic.Strategy.facts`."""


class ObservingStrategy(Strategy):
    """A strategy that is shown each test whole, with its drive, right before it is told.

    Drives are exact only in the process that drove them, so its campaign has one worker and cannot
    be resumed.
    """

    @abstractmethod
    def observe(self, attempt: Attempt) -> None:
        """Looks at the last attempt to test the candidate that is told next."""


_used: Final[WeakValueDictionary[int, Strategy]] = WeakValueDictionary()
"""id() -> a strategy that a campaign of this process has asked or told anything."""


def _mark_used(strategy: Strategy) -> None:
    _used[id(strategy)] = strategy


def require_fresh(strategy: Strategy) -> None:
    """Checks that a strategy has not searched yet, as far as that can be known.

    It is known of built-in ones, and of those that a campaign of this process has asked. What such
    a strategy proposes follows from more than its arguments, so the campaign could be neither
    repeated nor resumed.

    Raises:
        CampaignError: it was asked before.
    """
    is_used = _used.get(id(strategy)) is strategy
    if is_built_in(strategy):
        ledgers = [one for one in vars(strategy).values() if isinstance(one, Ledger)]
        is_used = is_used or any(ledger.issued for ledger in ledgers)
    if is_used:
        raise CampaignError(
            f"the strategy {type(strategy).__name__} was asked before: make a new one for each"
            " campaign and each resume(); a Campaign that has run goes on with run()"
        )


def require_valid_roads(strategy: Strategy) -> None:
    """Checks that the strategy can propose a valid road, as far as it knows.

    Raises:
        CampaignError: the strategy can propose none, or its code raised.
    """
    try:
        strategy.require_valid_roads()
    except ValueError as error:
        raise CampaignError(str(error)) from error
    except (Exception, SystemExit) as error:
        raise CampaignError(str(raised(error))) from error


def start(strategy: Strategy, earlier: Sequence[Evaluation], summary: Summary) -> None:
    """Tells the strategy what earlier campaigns drove, if anything; its time is counted.

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
    """The strategy's next candidate, None if it has to be told first; its time is counted.

    Raises:
        SearchEnded: it has none left.
        CampaignError: the strategy raised, or its proposal is no candidate that can be stored.
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
    """What keeps a proposal from being driven and stored; empty if nothing does."""
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
        return f"the origin {shown(origin)}: a frenetic.Origin is needed"
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
    """Whether it is a whole number that the database holds."""
    return isinstance(value, Integral) and least <= int(value) < 2**63


def tell(strategy: Strategy, evaluation: Evaluation, summary: Summary) -> None:
    """Tells the strategy; its time is counted.

    Raises:
        CampaignError: the strategy raised.
    """
    with _own_time(summary, CampaignError):  # a damaged trajectory
        strategy.tell(evaluation)


def notice_of(strategy: Strategy) -> str:
    """What the strategy has to say of its search; empty if nothing.

    Raises:
        StrategyError: it raised.
    """
    try:
        return strategy.notice or ""
    except (Exception, SystemExit) as error:
        raise raised(error) from error


def facts_of(strategy: Strategy, summary: Summary) -> dict[str, JSONValue]:
    """What the strategy tells of its search; its time is counted.

    Raises:
        StrategyError: it raised, or they are no plain values.
    """
    with _own_time(summary, StrategyError):
        text = json.dumps(dict(strategy.facts()), default=plain, allow_nan=False)
        facts: dict[str, JSONValue] = read_json(text)
    return facts


@contextmanager
def _own_time(summary: Summary, passing: type[Exception]) -> Iterator[None]:
    """Counts the strategy's time; what it raises is its fault, but for ``passing``."""
    began = time.perf_counter()
    try:
        with one_process():
            yield
    except passing:
        raise
    except (Exception, SystemExit) as error:
        raise raised(error) from error
    finally:
        summary.strategy_seconds += time.perf_counter() - began


def raised(error: BaseException) -> StrategyError:
    """The error of a strategy that raised."""
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
    """Replays the log to a fresh strategy, asking and telling in the same order.

    Args:
        store: with the log.
        strategy: fresh.
        budget: of the campaign.
        objective: of the campaign.
        earlier: evaluations of earlier campaigns that it started from.

    Returns:
        The progress, and the candidates that were asked but not told, by id in the order of asking.

    Raises:
        CampaignError: the strategy is not fresh, it proposes another road than the log holds, or
            the log is damaged.
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

    def ask_until(told: int) -> None:
        nonlocal following
        while following is not None and following[1] <= told:
            logged = following[0]
            if not _is_same(logged, _proposed(strategy, summary)):
                raise _differs(store, logged)
            outstanding[logged.id] = logged
            following = next(asked, None)

    for test in store.tests():
        ask_until(summary.told)
        candidate = outstanding.pop(test.id, None)
        if candidate is None:
            raise CampaignError(
                f"{store.folder} is damaged: candidate {test.id} was told before it was asked"
            )
        evaluation = evaluation_of(test, partial(store.trajectory, test.id), objective)
        tell(strategy, evaluation, summary)
        summary.add(candidate, test.outcome, test.moobd)
        summary.measure(objective, evaluation)
        summary.seconds = test.elapsed
        summary.spend(budget, summary.seconds, test.told_share)
    ask_until(summary.told)
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
