"""`evaluate`: a loop written by hand gives a strategy the same evaluations as a campaign."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import frenetic
from frenetic import Budget, Campaign, CampaignStore, Candidate, Evaluation, Outcome
from frenetic.campaign import evaluate
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.objective import Objective
from frenetic.errors import FreneticError, Trouble
from frenetic.oracle import Finding
from frenetic.search import Origin
from frenetic.testing import DummySimulator

SIMULATIONS = 40
DRIVER = frenetic.Planner(aggression=1.1)


def search_by_hand(strategy: frenetic.Strategy) -> list[Evaluation]:
    """Evaluations of a search without a campaign."""
    simulator = frenetic.EmbeddedSimulator()
    evaluations: list[Evaluation] = []
    driven = 0
    while driven < SIMULATIONS:
        candidate = strategy.ask()
        assert candidate is not None
        road, verdict = frenetic.Road(candidate.curvatures, candidate.step).placed()
        drive = simulator.drive(road, DRIVER) if road is not None and verdict.valid else None
        driven += drive is not None
        evaluations.append(evaluate(candidate, road, drive, budget_spent=driven / SIMULATIONS))
        strategy.tell(evaluations[-1])
    return evaluations


def test_a_loop_by_hand_gives_the_evaluations_of_a_campaign(tmp_path: Path) -> None:
    campaign = Campaign(
        strategy=frenetic.Frenetic2021(seed=4),
        simulator=frenetic.EmbeddedSimulator(),
        driver=DRIVER,
        budget=Budget(simulations=SIMULATIONS),
        folder=tmp_path / "c",
    )
    campaign.run()
    evaluations = search_by_hand(frenetic.Frenetic2021(seed=4))
    with CampaignStore.open(tmp_path / "c") as store:
        records = list(store.tests(with_trajectory=True))
    assert len(records) == len(evaluations)
    assert {Outcome.PASS, Outcome.FAIL} <= {evaluation.outcome for evaluation in evaluations}
    for record, evaluation in zip(records, evaluations, strict=True):
        recorded = evaluation_of(record, lambda: record.trajectory, Objective.load("moobd"))  # noqa: B023
        assert replace(recorded, candidate=evaluation.candidate) == evaluation
        np.testing.assert_array_equal(record.candidate.curvatures, evaluation.candidate.curvatures)
        assert (recorded.trace is None) == (evaluation.trace is None)
        if recorded.trace is not None and evaluation.trace is not None:
            for name in ("distance", "lateral_offset", "speed"):
                a, b = getattr(recorded.trace, name), getattr(evaluation.trace, name)
                np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-3)  # rounded in the database


def test_an_evaluation_has_a_moobd_only_after_a_whole_drive() -> None:
    candidate = Candidate(1, np.array([0.0, 0.03, 0.04, 0.03, 0.0]), 10.0, Origin("mine"))
    road = frenetic.Road(candidate.curvatures, 10.0)
    invalid = evaluate(candidate, None, None, budget_spent=0.5)
    assert (invalid.outcome, invalid.moobd, invalid.budget_spent) == (Outcome.INVALID, None, 0.5)
    drive = frenetic.EmbeddedSimulator().drive(road, DRIVER)
    broken = evaluate(
        candidate, road, frenetic.Drive(drive.trajectory, trouble=Trouble("it broke"))
    )
    assert (broken.outcome, broken.moobd, broken.trace) == (Outcome.ERROR, None, None)
    # This drive goes on after the failure.
    long_drive = DummySimulator(lambda road: 4.0).drive(road, DRIVER)
    failed, time = evaluate(candidate, road, long_drive), long_drive.trajectory.time
    assert failed.trace is not None
    assert failed.duration is not None
    assert len(failed.trace.distance) == (time < failed.duration + 0.01).sum() < len(time)
    accelerated = evaluate(candidate, road, drive, objective="lateral-acceleration")
    expected = Objective.load("lateral-acceleration").fitness(road, drive)
    assert expected is not None
    assert accelerated.fitness == expected < 0.0
    assert evaluate(candidate, road, drive).fitness == accelerated.moobd
    with pytest.raises(FreneticError, match="nothing"):
        evaluate(candidate, road, drive, objective="nothing")


def test_the_place_of_a_failure_is_its_finding_and_otherwise_the_lowest_moobd() -> None:
    candidate = Candidate(1, np.zeros(20), 10.0, Origin("mine"))
    passed = Evaluation(candidate, Outcome.PASS, 0.5, 0.1, worst_place=40.0)
    departure = Finding.departure("left", 87.0)
    failed = replace(passed, outcome=Outcome.FAIL, finding=departure)
    assert (passed.place, failed.place) == (40.0, 87.0)
