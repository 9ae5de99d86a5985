"""The map of a sweep: hand-counted cells, and campaigns that are no sweep."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frenetic import Budget, Campaign, Candidate, EmbeddedSimulator, Planner
from frenetic.analysis import sweep_map
from frenetic.analysis.bend_map import bend_of
from frenetic.campaign import CampaignStore
from frenetic.campaign.record import Test
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.rerun.replay import ReplayRoads
from frenetic.search import Origin, Strategy, Sweep


def road_test(number: int, candidate: Candidate, outcome: str, moobd: float | None) -> Test:
    """Return a test of a road."""
    result = Result(Outcome(outcome), "", moobd)
    return Test(candidate=candidate, result=result, result_number=number, budget_spent=0.0)


def bend_test(
    number: int, outcome: str, radius: float, speed: float, moobd: float | None = None
) -> Test:
    """Return a test of a bend, to the right if the radius is negative."""
    curvatures = np.array([0.0, 0.0, 0.5, 1.0, 1.0, 0.5, 0.0]) / radius
    conditions = {"speed": speed}
    candidate = Candidate(number, curvatures, 2.0, Origin("sweep"), conditions=conditions)
    return road_test(number, candidate, outcome, moobd)


def test_cells_count_drives_failures_and_the_lowest_moobd() -> None:
    tests = [
        bend_test(1, "PASS", 20.0, 50.0, 1.5),
        bend_test(2, "FAIL", -20.0, 50.0, -0.5),
        bend_test(3, "PASS", 40.0, 50.0, 1.0),
        bend_test(4, "FAIL", 20.0, 60.0, -2.0),
        bend_test(5, "FAIL", 20.0, 60.0, None),  # the driver broke
        bend_test(6, "INVALID", 80.0, 60.0),
        bend_test(7, "ERROR", 80.0, 60.0),
    ]
    swept = sweep_map(tests)
    assert swept is not None
    assert swept.radii.tolist() == [20.0, 40.0]
    assert swept.speeds.tolist() == [50.0, 60.0]
    assert swept.drives.tolist() == [[2, 1], [2, 0]]
    assert swept.failures.tolist() == [[1, 0], [2, 0]]
    np.testing.assert_array_equal(swept.share, [[0.5, 0.0], [1.0, np.nan]])
    np.testing.assert_array_equal(swept.moobd, [[-0.5, 1.0], [-2.0, np.nan]])
    assert swept.worst_tests.tolist() == [[2, 3], [4, 0]]
    document = json.loads(json.dumps(swept.as_json()))
    assert document["cells"][2] == {
        "radius": 20.0, "speed": 60.0, "drives": 2, "failures": 2, "moobd": -2.0, "worst_test": 4
    }  # fmt: skip


@pytest.mark.parametrize(
    ("curvatures", "conditions"),
    [
        ([0.0, 0.01, 0.0], {}),  # no speed limit of its own
        ([0.0, 0.0, 0.0], {"speed": 50.0}),  # straight
        ([0.0, 0.01, -0.01, 0.0], {"speed": 50.0}),  # to both sides
        ([0.0, 0.01, 0.005, 0.01, 0.0], {"speed": 50.0}),  # two bends
        ([0.01, 0.01, 0.0], {"speed": 50.0}),  # begins in the bend
        ([0.0, 0.01], {"speed": 50.0}),
    ],
)
def test_other_roads_are_no_bend_of_a_sweep(
    curvatures: Sequence[float], conditions: dict[str, float]
) -> None:
    other = Candidate(1, np.array(curvatures), 10.0, Origin("random"), conditions=conditions)
    assert bend_of(other) is None
    test = bend_test(1, "PASS", 20.0, 50.0, 1.0)
    assert sweep_map([test]) is not None
    assert sweep_map([test, road_test(2, other, "PASS", 1.0)]) is None
    assert sweep_map([]) is None


def run(strategy: Strategy, folder: Path) -> None:
    """Run a campaign with a driver that is too fast."""
    Campaign(
        strategy=strategy,
        simulator=EmbeddedSimulator(),
        driver=Planner(aggression=1.4),
        budget=Budget(simulations=100),
        folder=folder,
    ).run()


def test_a_sweep_and_its_rerun_have_the_same_cells(tmp_path: Path) -> None:
    options: dict[str, Any] = {"radii": 3, "speeds": 2, "turns": 1, "least_speed": 40.0}
    run(Sweep(seed=3, **options), tmp_path / "swept")
    run(ReplayRoads(tmp_path / "swept", range(1, 13)), tmp_path / "again")
    cells = []
    for name in ("swept", "again"):
        with CampaignStore.open(tmp_path / name) as store:
            swept = sweep_map(store.tests())
        assert swept is not None
        assert swept.radii.tolist() == [15.0, 38.7, 100.0]
        assert swept.speeds.tolist() == [40.0, 80.0]
        assert (swept.drives == 2).all()
        assert swept.failures.any()
        assert not swept.failures.all()
        cells.append(swept.as_json())
    assert cells[0] == cells[1]
