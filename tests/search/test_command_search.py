"""Searches that are programs: the contract, their messages, their errors, and a resumed search."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sample_programs

from frenetic import Budget, Campaign, CampaignStore, EmbeddedSimulator, Planner
from frenetic.errors import CampaignError, StrategyError
from frenetic.oracle.outcome import Outcome
from frenetic.search import CommandSearch, Evaluation, SearchEnded, Strategy, Trace
from frenetic.search.command import as_message
from frenetic.testing.strategy_contract import StrategyContract


class TestCommandSearch(StrategyContract):
    @pytest.fixture(autouse=True)
    def _program(self, tmp_path: Path) -> None:
        self._command = sample_programs.search(tmp_path)

    def make(self, seed: int) -> Strategy:
        return CommandSearch(seed=seed, program=self._command)


def test_a_result_has_the_names_of_ask_tell(tmp_path: Path) -> None:
    strategy = CommandSearch(seed=1, program=sample_programs.search(tmp_path))
    candidate = strategy.ask()
    assert candidate is not None
    assert candidate.origin.operator == "drawn"
    trace = Trace(np.array([0.0, 1.0]), np.array([0.1, 0.2]), np.array([2.0, 3.0]))
    evaluation = Evaluation(
        candidate, Outcome.PASS, 0.5, 0.25, worst_place=9.0, duration=3.0, read_trace=lambda: trace
    )
    message = as_message(evaluation, with_trace=False)
    assert message == {
        "id": 1,
        "outcome": "PASS",
        "moobd": 0.5,
        "objective": None,
        "place": 9.0,
        "side": None,
        "duration": 3.0,
        "budget_spent": 0.25,
    }
    with_trace = as_message(evaluation, with_trace=True)
    assert with_trace["trace"] == {
        "distance": [0.0, 1.0],
        "lateral_offset": [0.1, 0.2],
        "speed": [2.0, 3.0],
    }


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ("answer = {}", 'without "candidate", "wait" or "end"'),
        ("answer = {'wait': True}", "waits for a result, and all results are told"),
        ("answer = {'candidate': {'curvatures': [0.1]}}", "1 curvatures: at least 2"),
        ("answer = {'candidate': {'curvatures': 'x'}}", "Expected `array`"),
        ("answer = {'candidate': {'curvature': [0, 0]}}", "unknown field `curvature`"),
        ("answer = {'error': 'no more ideas'}", "reports: no more ideas"),
        ("sys.exit(3)", "ended with exit code 3"),
        ("print('hello', flush=True)", "'hello'"),
        ("import time; time.sleep(60)", "took more than 0.5 s"),
    ],
)
def test_a_program_that_breaks_ends_the_search_in_one_line(
    tmp_path: Path, bad: str, text: str
) -> None:
    strategy = CommandSearch(seed=1, program=sample_programs.search(tmp_path, bad), deadline=0.5)
    with pytest.raises(StrategyError) as error:
        strategy.ask()
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_a_search_that_ends_says_why_and_is_still_told(tmp_path: Path) -> None:
    bad = "answer = {'end': 'all seen'} if told else answer"
    strategy = CommandSearch(seed=1, program=sample_programs.search(tmp_path, bad))
    first, second = strategy.ask(), strategy.ask()
    assert first is not None
    assert second is not None
    strategy.tell(Evaluation(first, Outcome.PASS, 0.5, 0.1))
    for _ in range(2):
        with pytest.raises(SearchEnded, match="all seen"):
            strategy.ask()
    strategy.tell(Evaluation(second, Outcome.PASS, 0.5, 0.1))
    with pytest.raises(ValueError, match="told already"):
        strategy.tell(Evaluation(second, Outcome.PASS, 0.5, 0.1))


def campaign(folder: Path, program: str, simulations: int) -> Campaign:
    return Campaign(
        strategy=CommandSearch(seed=4, program=program),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
    )


def roads(folder: Path) -> list[list[float]]:
    with CampaignStore.open(folder) as store:
        return [test.candidate.curvatures.tolist() for test in store.tests()]


def test_a_resumed_search_goes_on_as_if_it_had_not_stopped(tmp_path: Path) -> None:
    program = sample_programs.search(tmp_path, "pass", "trace")
    campaign(tmp_path / "whole", program, 12).run()
    campaign(tmp_path / "parts", program, 5).run()
    campaign(tmp_path / "parts", program, 12).resume()
    whole, parts = roads(tmp_path / "whole"), roads(tmp_path / "parts")
    most = min(len(whole), len(parts))
    assert most >= 10
    assert whole[:most] == parts[:most]


def test_results_survive_a_program_that_ends(tmp_path: Path) -> None:
    program = sample_programs.search(tmp_path, "if told > 5: sys.exit(2)")
    with pytest.raises(CampaignError, match="strategy's program ended with exit code 2"):
        campaign(tmp_path / "c", program, 100).run()
    assert len(roads(tmp_path / "c")) >= 5
