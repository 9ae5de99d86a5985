"""Campaigns of simple parts, and strategies that propose given roads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty import bend

from frenetic.campaign import Budget, Campaign
from frenetic.errors import CampaignError
from frenetic.road import Road
from frenetic.search import Candidate, Evaluation, Frenetic2021, Origin, Strategy
from frenetic.testing import DummyDriver, DummySimulator

STRAIGHT = [0.0] * 8
BENT = [0.0, 0.02, 0.03, 0.02, 0.0, 0.0, 0.0, 0.0]
LOOP = [0.07] * 14


def fails_when_bent(road: Road) -> float:
    """Return the drift of a car, in m: it leaves its lane on bent roads."""
    return 4.0 if abs(road.curvatures).max() > 0.01 else 0.0


def quick_search(**options: Any) -> Frenetic2021:
    """Return a search that soon makes mutants and crossovers."""
    defaults: dict[str, Any] = {
        "seed": 4,
        "random_budget": 0.1,
        "cross_freq": 10,
        "cross_num": 6,
        "max_redraws": 10,
    }
    return Frenetic2021(**(defaults | options))


def campaign(folder: Path, simulations: int = 60, **options: Any) -> Campaign:
    """Return a campaign of simple parts; options replace them."""
    parts: dict[str, Any] = {
        "strategy": quick_search(),
        "simulator": DummySimulator(bend),
        "driver": DummyDriver(),
        "budget": Budget(simulations=simulations),
    }
    return Campaign(folder=folder, **(parts | options))


@contextmanager
def refused(
    pattern: str | None = None, kind: type[Exception] = CampaignError
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """Assert that the code inside `with` raises an error of one line that matches the pattern."""
    with pytest.raises(kind, match=pattern) as caught:
        yield caught
    assert "\n" not in str(caught.value)


class Scripted(Strategy):
    """A strategy that proposes the same roads again and again; the third default road fails."""

    def __init__(self, *roads: list[float]) -> None:
        self.roads = roads or (STRAIGHT, LOOP, BENT)
        self.asked = 0
        self.evaluations: list[Evaluation] = []

    def ask(self) -> Candidate:
        self.asked += 1
        values = self.roads[(self.asked - 1) % len(self.roads)]
        return Candidate(self.asked, np.array(values), 10.0, Origin("scripted"))

    def tell(self, evaluation: Evaluation) -> None:
        self.evaluations.append(evaluation)


def scripted(folder: Path, budget: Budget | None, **options: Any) -> Campaign:
    """Return a campaign with a `Scripted` strategy, in which bent roads fail."""
    parts: dict[str, Any] = {"strategy": Scripted(), "simulator": DummySimulator(fails_when_bent)}
    return campaign(folder, budget=budget, **(parts | options))
