"""Campaigns that end by the length of road driven, or by simulated time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from campaigns import campaign
from contents import contents
from events import on_result

from frenetic.campaign import Budget, CampaignStore, Summary
from frenetic.campaign.record import Test
from frenetic.drivers import Planner
from frenetic.oracle.outcome import Outcome
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator

LIMITED: dict[str, Callable[[Test], float]] = {
    "kilometres": lambda test: (test.result.distance or 0.0) / 1000.0,
    "simulated_time": lambda test: test.result.duration or 0.0,
}
"""Name of a limit -> what a test spends of it."""
BUDGETS = {"kilometres": Budget(kilometres=3.0), "simulated_time": Budget(simulated_time=400.0)}


def drives(folder: Path, **options: Any) -> Any:
    """Return a campaign of compiled drives that are not all of one length."""
    parts: dict[str, Any] = {
        "strategy": RandomSearch(seed=2),
        "simulator": EmbeddedSimulator(),
        "driver": Planner(aggression=1.3),
    }
    return campaign(folder, **(parts | options))


@pytest.mark.parametrize("limit", LIMITED)
def test_the_first_result_that_reaches_the_limit_ends_the_campaign(
    tmp_path: Path, limit: str
) -> None:
    summary = drives(tmp_path, budget=BUDGETS[limit]).run()
    most: float = getattr(BUDGETS[limit], limit)
    with CampaignStore.open(tmp_path) as store:
        tests = list(store.tests())
        counts = store.counts()
    assert not summary.interrupted
    assert {test.outcome for test in tests} >= {Outcome.PASS, Outcome.FAIL}
    spent = 0.0
    for test in tests:
        assert spent < most
        spent += LIMITED[limit](test)
        assert test.budget_spent == pytest.approx(min(spent / most, 1.0))
    assert spent >= most
    assert counts.amounts(0.0) == summary.amounts(0.0)
    assert counts.amounts(0.0)[limit] == pytest.approx(spent)


def test_a_drive_spends_the_road_up_to_where_it_ended(tmp_path: Path) -> None:
    drives(tmp_path, budget=Budget(kilometres=3.0)).run()
    with CampaignStore.open(tmp_path) as store:
        for test in store.tests():
            distance = test.result.distance
            if test.outcome is Outcome.PASS:  # the goal is 8 m before the road's end
                assert distance is not None
                assert 0.0 < test.road.length - distance < 8.5
            elif test.departure is not None:
                assert distance == pytest.approx(test.departure.distance)
            elif test.outcome is Outcome.INVALID:
                assert distance is None


@pytest.mark.parametrize("budget", BUDGETS.values(), ids=BUDGETS)
def test_an_interrupted_campaign_ends_with_the_same_tests(tmp_path: Path, budget: Budget) -> None:
    drives(tmp_path / "whole", budget=budget).run()

    def stop(summary: Summary) -> None:
        if summary.simulations == 7:
            halted.stop()

    halted = drives(tmp_path / "halted", budget=budget)
    assert halted.run(on_event=on_result(stop)).interrupted
    assert not drives(tmp_path / "halted", budget=None).resume().interrupted
    assert contents(tmp_path / "halted") == contents(tmp_path / "whole")


@pytest.mark.heavy
@pytest.mark.parametrize("budget", BUDGETS.values(), ids=BUDGETS)
def test_the_workers_do_not_change_where_a_campaign_ends(tmp_path: Path, budget: Budget) -> None:
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        drives(folder, budget=budget, workers=workers, max_in_flight=5).run()
    assert contents(tmp_path / "1") == contents(tmp_path / "2")
