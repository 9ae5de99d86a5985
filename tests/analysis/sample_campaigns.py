"""Campaigns and their measures, as samples for the tests of analysis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from frenetic._support.json_value import JSONValue
from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.campaign.counts import Counts
from frenetic.drivers import Driver, Planner
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.search import Candidate, Origin, Strategy
from frenetic.simulators import EmbeddedSimulator, Simulator


def search(
    folder: Path,
    strategy: Strategy,
    simulations: int,
    *,
    simulator: Simulator | None = None,
    driver: Driver | None = None,
) -> Path:
    """Run a campaign and return its folder."""
    Campaign(
        strategy=strategy,
        simulator=simulator or EmbeddedSimulator(),
        driver=driver or Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()
    return folder


def store_of(
    folder: Path, outcomes: Sequence[Outcome], elapsed: float = 0.0, **facts: JSONValue
) -> Path:
    """Store a campaign with some outcomes on different roads, without trajectories."""
    config: dict[str, JSONValue] = {"seed": 1, "lane_width": 4.0, "rules": {}, "car": {}}
    with CampaignStore.create(folder, config) as store:
        for number, outcome in enumerate(outcomes, start=1):
            candidate = Candidate(number, np.full(5, 1e-4 * number), 10.0, Origin("random"))
            store.add_candidate(candidate)
            store.add_result(
                Test(
                    candidate=candidate,
                    result=Result(outcome, ""),
                    seconds=2.0,
                    result_number=number,
                    budget_spent=0.0,
                    elapsed=number * elapsed,
                )
            )
        if facts:
            store.finish(**facts)
    return folder


def measures(
    failures: int,
    *,
    first: int = 1,
    simulations: int = 100,
    invalid: int = 0,
    min_moobd: float | None = None,
    sparseness: float = -math.inf,
) -> CampaignMeasures:
    """Return measures of a campaign whose failures follow each other and are all distinct."""
    curve = np.clip(np.arange(simulations + 1) - first + 1, 0, failures)
    return CampaignMeasures(
        folder=Path("made-up"),
        seed=None,
        counts=Counts(invalid=invalid, min_moobd=min_moobd),
        failures_after=curve,
        distinct_after=curve,
        is_finished=True,
        competition_sparseness=sparseness,
    )
