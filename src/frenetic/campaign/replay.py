"""The replay of a stored campaign to a fresh strategy, which then knows what the old one knew."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.guarded_strategy import ObservingStrategy, ask, require_fresh, start, tell
from frenetic.campaign.objective import Objective
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Summary
from frenetic.errors import CampaignError
from frenetic.parts.versions import changed_packages
from frenetic.search.records import Candidate, Evaluation
from frenetic.search.strategy import SearchEnded, Strategy
from frenetic.spec import Budget


def replay(
    store: CampaignStore,
    strategy: Strategy,
    budget: Budget,
    objective: Objective,
    *,
    earlier: Sequence[Evaluation] = (),
) -> tuple[Summary, dict[int, Candidate]]:
    """Ask and tell a fresh strategy in the order of a stored campaign, with the stored results.

    Args:
        store: the campaign.
        strategy: a fresh strategy.
        budget: budget of the campaign.
        objective: objective of the campaign.
        earlier: evaluations of the earlier campaigns from which the campaign started.

    Returns:
        The campaign's progress, and its candidates without a result, by id in the order of asking.

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
    # Each stored candidate comes with the number of results that the strategy knew before it.
    stored_candidates = store.candidates()
    next_stored = next(stored_candidates, None)
    outstanding: dict[int, Candidate] = {}

    def ask_as_before() -> None:
        """Ask for the candidates that were asked for when the strategy knew as many results."""
        nonlocal next_stored
        while next_stored is not None and next_stored[1] <= summary.result_count:
            stored = next_stored[0]
            if not _is_same(stored, _proposal(strategy, summary)):
                raise _other_road_error(store, stored)
            outstanding[stored.id] = stored
            next_stored = next(stored_candidates, None)

    for test in store.tests():
        ask_as_before()
        candidate = outstanding.pop(test.id, None)
        if candidate is None:
            raise CampaignError(
                f"{store.folder} is damaged: candidate {test.id} was told before it was asked"
            )
        evaluation = evaluation_of(test, partial(store.trajectory, test.id), objective)
        tell(strategy, evaluation, summary)
        summary.add(candidate, test.result)
        summary.note_objective(objective, evaluation)
        summary.seconds = test.elapsed
        summary.update_budget_spent(budget, summary.seconds, test.reported_share)
    ask_as_before()
    return summary, outstanding


def _proposal(strategy: Strategy, summary: Summary) -> Candidate | None:
    """Return the strategy's next candidate; None if it has none."""
    try:
        return ask(strategy, summary)
    except SearchEnded:
        return None


def _is_same(stored: Candidate, proposed: Candidate | None) -> bool:
    """Return whether the strategy proposes the road of a stored candidate."""
    return (
        proposed is not None
        and proposed.id == stored.id
        and proposed.step == stored.step
        and proposed.origin == stored.origin
        and np.array_equal(proposed.curvatures, stored.curvatures)
    )


def _other_road_error(store: CampaignStore, stored: Candidate) -> CampaignError:
    """Return the error about a strategy that proposes another road than the stored one."""
    differing = changed_packages(store.config.get("versions"))
    return CampaignError(
        f"{store.folder} cannot be resumed: the strategy now proposes another road as candidate"
        f" {stored.id} than it did; "
        + (f"versions differ: {', '.join(differing)}" if differing else "was it changed?")
    )
