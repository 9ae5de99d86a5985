"""Calls of a strategy: its time is counted, its proposals are checked, its errors are named."""

from __future__ import annotations

import json
import time
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from numbers import Integral
from typing import Any, Final
from weakref import WeakValueDictionary

import numpy as np

from frenetic._support.bounds import is_number, short_repr
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.outside_text import read_json
from frenetic.campaign.record import Attempt
from frenetic.campaign.summary import Summary
from frenetic.errors import CampaignError, StrategyError, describe_raised
from frenetic.processes.forks import one_process
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy, has_own
from frenetic.spec.part_record import is_built_in

SEARCH_FACTS: Final = "search"
"""Name of the campaign's fact with the strategy's facts, see `frenetic.Strategy.facts`."""


class ObservingStrategy(Strategy):
    """A strategy that gets each test with its exact drive, right before `tell`.

    Stored drives are rounded, so its campaign drives with one worker in this process and cannot be
    resumed.
    """

    @abstractmethod
    def observe(self, attempt: Attempt) -> None:
        """Take the attempt whose result the next `tell` brings."""


_used: Final[WeakValueDictionary[int, Strategy]] = WeakValueDictionary()
"""Strategies that a campaign of this process has asked or told, by their `id()`."""


def _mark_used(strategy: Strategy) -> None:
    if _used.get(id(strategy)) is not strategy:
        _used[id(strategy)] = strategy


def require_fresh(strategy: Strategy) -> None:
    """Check that a strategy has not searched yet, as far as that can be known.

    A strategy counts as used if a campaign of this process has asked it, or if it is a built-in
    strategy that has proposed a candidate. What a used strategy proposes depends on its past, so
    its campaign could be neither repeated nor resumed.

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
            " campaign and each resume(); a Campaign that has run continues with run()"
        )


def require_valid_roads(strategy: Strategy) -> None:
    """Check that the strategy can propose a valid road, as far as the strategy knows.

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
    """Give the strategy the evaluations of earlier campaigns, and count its time.

    Raises:
        CampaignError: the strategy raised, or cannot start from earlier campaigns.
    """
    if not earlier:
        return
    if not has_own(strategy, "start_from"):
        raise StrategyError(
            f"the campaign started from earlier ones, but the strategy {type(strategy).__name__}"
            " has no start_from"
        )
    _mark_used(strategy)
    with _call_of_strategy(summary, unchanged=CampaignError):
        strategy.start_from(earlier)


def ask(strategy: Strategy, summary: Summary) -> Candidate | None:
    """Return the strategy's next candidate, or None if it needs a result first; count its time.

    Raises:
        SearchEnded: the strategy has no candidate left.
        CampaignError: the strategy raised, or its proposal cannot be stored.
    """
    _mark_used(strategy)
    with _call_of_strategy(summary, unchanged=SearchEnded):
        candidate = strategy.ask()
    if candidate is None:
        return None
    if not isinstance(candidate, Candidate):
        raise StrategyError(
            f"the strategy proposed {type(candidate).__name__} instead of frenetic.Candidate"
        )
    if fault := _unusable_part(candidate):
        raise StrategyError(
            f"the strategy proposed candidate {short_repr(candidate.id)} with {fault}"
        )
    return candidate


def _unusable_part(candidate: Any) -> str:
    """Return the part of a proposal that cannot be driven and stored; empty if all parts can."""
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
        return f"the step {short_repr(candidate.step)}: a positive number of metres is needed"
    origin = candidate.origin
    if not isinstance(candidate.origin, Origin):
        return f"the origin {short_repr(origin)}: a frenetic.search.Origin is needed"
    if not isinstance(origin.operator, str):
        return f"the operator {short_repr(origin.operator)}: a text is needed"
    if not (
        isinstance(origin.parents, Iterable)
        and all(isinstance(parent, Integral) for parent in origin.parents)
    ):
        return f"the parents {short_repr(origin.parents)}: a tuple of ids is needed"
    if not _is_whole(origin.generation, 0):
        return f"the generation {short_repr(origin.generation)}: a whole number from 0 is needed"
    if isinstance(candidate.notes, dict) and not candidate.notes:
        return ""
    try:
        read_json(json.dumps(dict(candidate.notes), default=plain, allow_nan=False))
    except (TypeError, ValueError, RecursionError):
        return f"the notes {short_repr(candidate.notes)}: names with plain values are needed"
    return ""


def _is_whole(value: object, least: int) -> bool:
    """Return whether a value is a whole number from `least` that the database can hold."""
    return isinstance(value, Integral) and least <= int(value) < 2**63


def tell(strategy: Strategy, evaluation: Evaluation, summary: Summary) -> None:
    """Tell the strategy an evaluation, and count its time.

    Raises:
        CampaignError: the strategy raised.
    """
    # A strategy that reads the trace of a damaged trajectory meets a `CampaignError` of ours.
    with _call_of_strategy(summary, unchanged=CampaignError):
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
    with _call_of_strategy(summary, unchanged=StrategyError):
        text = json.dumps(dict(strategy.facts()), default=plain, allow_nan=False)
        facts: dict[str, JSONValue] = read_json(text)
    return facts


@contextmanager
def _call_of_strategy(summary: Summary, *, unchanged: type[Exception]) -> Iterator[None]:
    """Count the time of a call of the strategy, and turn its exceptions into a `StrategyError`.

    Args:
        summary: summary of the campaign, which counts the time.
        unchanged: class of exceptions that are raised as they are.
    """
    began = time.perf_counter()
    try:
        with one_process():
            yield
    except unchanged:
        raise
    except (Exception, SystemExit) as error:
        raise strategy_error(error) from error
    finally:
        summary.strategy_seconds += time.perf_counter() - began


def strategy_error(error: BaseException) -> StrategyError:
    """Return the error about an exception of a strategy; one of ours says itself what is wrong."""
    if isinstance(error, StrategyError):
        return error
    return StrategyError(f"the strategy raised {describe_raised(error)}")
