"""The strategy that hands on roads from a search in a twin."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import spearmanr

from frenetic.outcome import Outcome
from frenetic.search import Candidate, Evaluation, RandomSearch, Strategy, Trace
from frenetic.twin.screened import NOTE, SCREENED, Screened


def driven(candidate: Candidate, budget_spent: float, fails: bool) -> Evaluation:
    """A drive of constant speed that fails halfway, or passes."""
    length = (len(candidate.curvatures) - 1) * candidate.step
    distance = np.arange(0.0, 0.5 * length, 1.0)
    trace = Trace(distance, np.zeros(len(distance)), np.full(len(distance), 10.0))
    return Evaluation(
        candidate,
        Outcome.FAIL if fails else Outcome.PASS,
        -2.0 if fails else 1.0,
        budget_spent,
        place=0.5 * length,
        side="left" if fails else None,
        read_trace=lambda: trace,
    )


def asked_of(strategy: Strategy) -> Candidate:
    candidate = strategy.ask()
    assert candidate is not None
    return candidate


def is_left(candidate: Candidate) -> bool:
    return bool(candidate.curvatures.sum() > 0.0)


def screened(twin_fails: bool | None = None, seed: int = 1) -> Screened:
    """The twin fails where `is_left`, always or never."""
    return Screened(
        RandomSearch(seed=seed),
        RandomSearch(seed=seed + 1),
        lambda one, spent: driven(one, spent, is_left(one) if twin_fails is None else twin_fails),
        drawn=5,
    )


def test_what_fails_in_the_twin_is_handed_on_with_controls_between() -> None:
    strategy = screened()
    roles: Counter[str] = Counter()
    promising = 0
    for number in range(1, 41):
        candidate = asked_of(strategy)
        assert candidate.id == number
        note = candidate.notes[NOTE]
        role = note["role"]
        roles[role] += 1
        assert note["outcome"] == (Outcome.FAIL if is_left(candidate) else Outcome.PASS)
        if role == "screened":
            promising += is_left(candidate)
            assert candidate.origin.operator == SCREENED
        strategy.tell(driven(candidate, number / 40, is_left(candidate)))
    assert roles == {"screened": 36, "control": 4}
    assert promising >= 30  # by chance 18
    assert strategy.stopped is None
    assert strategy.notice is None


def test_a_twin_that_misleads_is_stopped() -> None:
    # What the twin chooses passes; the strategy's own proposals fail.
    strategy = screened()
    for number in range(1, 101):
        candidate, asked = asked_of(strategy), number
        if not candidate.notes:
            break
        fails = candidate.notes[NOTE]["role"] == "control"
        strategy.tell(driven(candidate, 0.0, fails))
    assert asked < 40
    assert strategy.stopped is not None
    assert strategy.stopped == strategy.notice
    assert strategy.facts()["not screened after it stopped"] == 1
    assert "since the twin misleads: 0 of " in strategy.stopped
    strategy.tell(driven(candidate, 0.0, True))
    alone = [asked_of(strategy) for _ in range(5)]
    assert [(one.notes, one.origin.operator) for one in alone] == 5 * [({}, "random")]


def test_a_twin_that_breaks_on_every_road_is_given_up() -> None:
    strategy = Screened(
        RandomSearch(seed=1),
        RandomSearch(seed=2),
        lambda one, spent: Evaluation(one, Outcome.ERROR, None, spent),
        drawn=2,
    )
    for _ in range(10):
        candidate = asked_of(strategy)
        strategy.tell(driven(candidate, 0.0, False))
    assert candidate.notes == {}
    assert "drove none of the roads" in str(strategy.notice)


def test_facts_compare_the_twin_with_the_simulator_on_controls_alone() -> None:
    def searched(n: int) -> tuple[Mapping[str, Any], list[tuple[float, float, bool]]]:
        rng = np.random.default_rng(3)
        strategy = Screened(
            RandomSearch(seed=1),
            RandomSearch(seed=2),
            lambda one, spent: replace(driven(one, spent, False), moobd=float(rng.normal())),
            drawn=3,
        )
        controls = []
        for number in range(n):
            candidate = asked_of(strategy)
            note, fails = candidate.notes[NOTE], bool(rng.random() < 0.5)
            result = replace(driven(candidate, 0.0, fails), moobd=note["moobd"] - rng.random())
            strategy.tell(result)
            if note["role"] == "control":
                assert result.moobd is not None
                controls.append((note["moobd"], result.moobd, fails))
            assert strategy.stopped is None, number
        return strategy.facts(), controls

    facts, controls = searched(60)
    assert facts["roads screened"] == 3 * facts["handed on"]
    assert facts["handed on"] + facts["controls"] == 60
    assert (facts["controls"], facts["failed controls"]) == (
        len(controls),
        sum(fails for *_, fails in controls),
    )
    twin, slow, _ = zip(*controls, strict=True)
    assert facts["twin's rank correlation"] == pytest.approx(spearmanr(twin, slow).statistic)
    order = [a > b for a, *_, p in controls if not p for b, *_, q in controls if q]
    assert facts["twin's AUC"] == pytest.approx(sum(order) / len(order))
    few, _ = searched(10)
    assert not {"twin's rank correlation", "twin's AUC"} & few.keys()


def test_results_may_come_late_and_without_a_drive() -> None:
    strategy = screened()
    asked = [asked_of(strategy) for _ in range(20)]
    assert [one.id for one in asked] == list(range(1, 21))
    for number, candidate in enumerate(reversed(asked)):
        outcome = (Outcome.INVALID, Outcome.ERROR, Outcome.DROPPED)[number % 3]
        strategy.tell(Evaluation(candidate, outcome, None, 0.1))
    with pytest.raises(ValueError, match="told already"):
        strategy.tell(Evaluation(asked[0], Outcome.ERROR, None, 0.1))
