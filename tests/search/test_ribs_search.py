"""The algorithms of pyribs that take part in benches, see benchmarks/ribs_search.py."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numba
import numpy as np
import pytest

from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import STRATEGIES
from frenetic.road import Road
from frenetic.search.records import Evaluation, Trace
from frenetic.testing import StrategyContract

if TYPE_CHECKING:
    from frenetic.search import Strategy

pytestmark = pytest.mark.heavy

SPEC = f"{Path(__file__).parents[2] / 'benchmarks' / 'ribs_search.py'}:RibsSearch"
ALGORITHMS = ("map-elites", "cma-mae", "cma-es")


@pytest.fixture(scope="module", autouse=True)
def _ribs_as_plain_python() -> None:
    """Run pyribs' compiled functions as plain Python: compiling takes longer than these tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numba.config, "DISABLE_JIT", True)
        import ribs.archives
        import ribs.emitters  # noqa: F401


def ribs_search(algorithm: str, seed: int = 1, **options: object) -> Strategy:
    strategy: Strategy = STRATEGIES.make_from(
        SPEC, {"algorithm": algorithm, **options}, {"seed": seed, "map_size": 200.0}
    )
    return strategy


class TestRibsSearch(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return ribs_search("cma-mae", seed, values=8)


def search(strategy: Strategy, drives: int) -> list[tuple[str, float, bool]]:
    """Run a search in which MOOBD falls with the sum of |curvature|.

    Return origin, sum of |curvature| and validity of each road.
    """
    proposals = []
    trace = Trace(np.array([95.0, 100.0]), np.array([0.5, 1.0]), np.array([9.0, 10.0]))
    for _ in range(drives):
        candidate = strategy.ask()
        assert candidate is not None
        bent = float(np.abs(candidate.curvatures).sum())
        _, verdict = Road(candidate.curvatures, candidate.step).placed(200.0, 10.0)
        proposals.append((candidate.origin.operator, bent, verdict.valid))
        moobd = 2.0 - bent
        strategy.tell(
            Evaluation(
                candidate, Outcome.PASS, moobd, 0.0, worst_place=100.0, read_trace=lambda: trace
            )
        )
    return proposals


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_roads_become_worse_for_the_driver_and_are_all_valid(algorithm: str) -> None:
    proposals = search(ribs_search(algorithm, values=12), 600)

    assert [origin for origin, _, _ in proposals[:30]] == ["random"] * 30
    assert {origin for origin, _, _ in proposals[30:]} == {algorithm}
    assert all(valid for _, _, valid in proposals)
    first, last = ([bent for _, bent, _ in part] for part in (proposals[:30], proposals[-60:]))
    assert np.median(last) > np.median(first)
