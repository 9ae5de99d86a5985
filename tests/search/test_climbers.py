"""The climbers that take part in benches, see benchmarks/climbers.py."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import STRATEGIES
from frenetic.search.change_limit import largest_change
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE
from frenetic.search.records import Evaluation
from frenetic.testing import StrategyContract

if TYPE_CHECKING:
    from frenetic.search import Strategy

pytestmark = pytest.mark.heavy

FILE = Path(__file__).parents[2] / "benchmarks" / "climbers.py"
CLIMBERS = ("OnePlusOne", "CmaEs")


def climber(name: str, seed: int = 1, **options: object) -> Strategy:
    own = {"seed": seed, "map_size": 200.0}
    strategy: Strategy = STRATEGIES.make_from(f"{FILE}:{name}", options, own)
    return strategy


class TestOnePlusOne(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return climber("OnePlusOne", seed)


class TestCmaEs(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return climber("CmaEs", seed)


@pytest.mark.parametrize("name", CLIMBERS)
def test_a_climber_comes_down_within_bound_and_change(name: str) -> None:
    strategy = climber(name)
    moobds = []
    for _ in range(400):
        candidate = strategy.ask()
        assert candidate is not None
        values = candidate.curvatures
        assert np.abs(values).max() <= CURVATURE_BOUND
        assert largest_change(values) <= MAX_CHANGE + 1e-12
        moobds.append(1.5 - 20.0 * float(values[10:15].mean()))
        strategy.tell(Evaluation(candidate, Outcome.PASS, moobds[-1], 0.1))
    assert min(moobds[300:]) < min(moobds[:30]) - 0.2
