"""Replay of a campaign's log to a fresh strategy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.loop import ObservingStrategy, ask, start, tell
from frenetic.campaign.objective import Objective
from frenetic.campaign.progress import Tally
from frenetic.campaign.record import EarlierTest
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.versions import package_versions
from frenetic.errors import CampaignError
from frenetic.search.records import Candidate
from frenetic.search.strategy import RevisableStrategy, SearchEnded, Strategy
from frenetic.spec import Budget


def replay(
    store: CampaignStore,
    strategy: Strategy,
    budget: Budget,
    objective: Objective,
    *,
    is_revised: bool = False,
    earlier: Sequence[EarlierTest] = (),
) -> tuple[Tally, dict[int, Candidate]]:
    """Replays the log to a fresh strategy, asking and telling in the same order.

    Args:
        store: with the log.
        strategy: fresh.
        budget: of the campaign.
        objective: of the campaign.
        is_revised: whether an earlier version of the strategy made part of the log. Then its roads
            take the place of those that the strategy proposes, if it is a `RevisableStrategy`.
        earlier: tests of earlier campaigns that it started from.

    Returns:
        The progress, and the candidates that were asked but not told, by id in the order of asking.

    Raises:
        CampaignError: the strategy proposes another road than the log holds, or the log is damaged.
    """
    if isinstance(strategy, ObservingStrategy):
        raise CampaignError(
            f"{store.folder} cannot be resumed: its strategy observes drives, which are not kept"
            " exactly; start a new campaign"
        )
    tally = Tally()
    start(strategy, earlier, tally)
    asked = store.candidates_with_place()
    following = next(asked, None)
    outstanding: dict[int, Candidate] = {}

    def ask_until(told: int) -> None:
        nonlocal following
        while following is not None and following[1] <= told:
            logged = following[0]
            proposed = _proposed(strategy, tally)
            if not _is_same(logged, proposed):
                if (
                    not is_revised
                    or proposed is None
                    or proposed.step != logged.step
                    or not isinstance(strategy, RevisableStrategy)
                ):
                    raise _differs(store, logged)
                strategy.replace(logged)
            outstanding[logged.id] = logged
            following = next(asked, None)

    for record in store.tests():
        ask_until(tally.told)
        candidate = outstanding.pop(record.candidate.id, None)
        if candidate is None:
            raise CampaignError(
                f"{store.folder} is damaged: candidate {record.candidate.id} was told before it"
                " was asked"
            )
        read_trajectory = partial(store.trajectory, record.id)
        evaluation = evaluation_of(record, read_trajectory, objective)
        tell(strategy, evaluation, tally)
        tally.count(candidate, record.outcome, record.moobd)
        tally.measure(objective, evaluation)
        tally.seconds = record.elapsed or tally.seconds + record.seconds
    ask_until(tally.told)
    tally.budget_spent = budget.spent(tally.simulations, tally.seconds, tally.failures)
    return tally, outstanding


def _proposed(strategy: Strategy, tally: Tally) -> Candidate | None:
    try:
        return ask(strategy, tally)
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
    theirs = store.config.get("versions")
    ours = package_versions()
    differing = (
        [f"{k} {v}, now {ours.get(k)}" for k, v in theirs.items() if ours.get(k) != v]
        if isinstance(theirs, Mapping)
        else []
    )
    return CampaignError(
        f"{store.folder} cannot be resumed: the strategy now proposes another road as candidate"
        f" {logged.id} than it did; "
        + (f"versions differ: {', '.join(differing)}" if differing else "was it changed?")
    )
