"""Built-in strategies keep the contract, and the contract detects broken strategies."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.oracle.outcome import Outcome
from frenetic.search import (
    Candidate,
    Evaluation,
    Frenetic,
    Frenetic2021,
    Origin,
    RandomSearch,
    Strategy,
    Sweep,
)
from frenetic.search.strategy import Ledger
from frenetic.testing.strategy_contract import StrategyContract


class TestRandomSearch(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return RandomSearch(seed=seed)


class TestFrenetic(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return Frenetic(seed=seed)


@pytest.mark.heavy
class TestFreneticWithOptions(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return Frenetic(seed=seed, random_roads=5, likely=True)


class TestFrenetic2021(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return Frenetic2021(seed=seed)


class TestSweep(StrategyContract):
    def make(self, seed: int) -> Strategy:
        return Sweep(seed=seed)


# Each of these strategies breaks one promise of the contract.


class _Straight(Strategy):
    """Keeps the contract; derived classes break a promise."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.ledger = Ledger()

    def draw(self) -> FloatArray:
        return self.rng.random(10)

    def ask(self) -> Candidate:
        return self.ledger.issue(self.draw(), 10.0, Origin("random"))

    def tell(self, evaluation: Evaluation) -> None:
        self.ledger.settle(evaluation)


def _drawing(draw: Callable[[np.random.Generator], FloatArray]) -> type[_Straight]:
    class Drawing(_Straight):
        def draw(self) -> FloatArray:
            return draw(self.rng)

    return Drawing


class _NoSeed(_Straight):
    def __init__(self, seed: int) -> None:
        super().__init__(1)


class _Unseeded(_Straight):
    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.rng = np.random.default_rng()


class _CountsFromZero(_Straight):
    def ask(self) -> Candidate:
        candidate = super().ask()
        return Candidate(candidate.id - 1, candidate.curvatures, 10.0, candidate.origin)


class _BelievesAnything(_Straight):
    def tell(self, evaluation: Evaluation) -> None:
        pass


class _ChokesOnErrors(_Straight):
    def tell(self, evaluation: Evaluation) -> None:
        assert evaluation.moobd is not None
        super().tell(evaluation)


class _Writeable(_Straight):
    def ask(self) -> Candidate:
        candidate = super().ask()
        candidate.curvatures.setflags(write=True)
        return candidate


class _OneArrayForAll(_Straight):
    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.shared = np.zeros(10)

    def ask(self) -> Candidate:
        candidate = super().ask()
        self.shared[:] = candidate.curvatures
        view = self.shared.view()
        view.setflags(write=False)
        object.__setattr__(candidate, "curvatures", view)
        return candidate


class _SharedGenerator(_Straight):
    rngs: dict[str, np.random.Generator] = {}  # noqa: RUF012 - the offence

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.rngs["one for all"] = self.rng

    def draw(self) -> FloatArray:
        return self.rngs["one for all"].random(10)


class _LooksAtTheObject(_Straight):
    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.asked: dict[int, Candidate] = {}

    def ask(self) -> Candidate:
        candidate = super().ask()
        self.asked[candidate.id] = candidate
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        super().tell(evaluation)
        if evaluation.candidate is not self.asked[evaluation.candidate.id]:
            self.rng.random()  # a log gives back other objects than `ask` returned


class _Choosy(_Straight):
    """Loses interest in candidates of ids more than 10 below the highest that was told."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.last = 0

    def tell(self, evaluation: Evaluation) -> None:
        super().tell(evaluation)
        self.last = max(self.last, evaluation.candidate.id)

    def is_wanted(self, candidate: Candidate) -> bool:
        return candidate.id > self.last - 10


class _ChangesItsMind(_Choosy):
    def is_wanted(self, candidate: Candidate) -> bool:
        return bool(super().is_wanted(candidate) or self.last % 2)


class _ThrowsDice(_Choosy):
    def is_wanted(self, candidate: Candidate) -> bool:
        self.rng.random()
        return super().is_wanted(candidate)


class _WantsNothing(_Choosy):
    def is_wanted(self, candidate: Candidate) -> bool:
        return False


class _WantsTheObject(_Choosy):
    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.asked: list[Candidate] = []

    def ask(self) -> Candidate:
        self.asked.append(super().ask())
        return self.asked[-1]

    def is_wanted(self, candidate: Candidate) -> bool:
        # Candidates read from a log are other objects.
        return super().is_wanted(candidate) and any(asked is candidate for asked in self.asked)


class _ChokesOnDropped(_Choosy):
    def tell(self, evaluation: Evaluation) -> None:
        if evaluation.outcome is Outcome.DROPPED:
            raise ValueError("what is that")
        super().tell(evaluation)


def _make(strategy: Callable[[int], Strategy]) -> StrategyContract:
    class Contract(StrategyContract):
        def make(self, seed: int) -> Strategy:
            return strategy(seed)

    return Contract()


def _is_broken(promise: str, strategy: Callable[[int], Strategy]) -> bool:
    test = getattr(_make(strategy), promise)
    try:
        if "outstanding" in test.__annotations__:
            test(outstanding=20, dropping=True)
        elif "outcome" in test.__annotations__:
            for outcome in Outcome:
                test(outcome=outcome)
        elif "unknown_id" in test.__annotations__:
            test(unknown_id=1000)
        else:
            test()
    except (AssertionError, ValueError, pytest.fail.Exception):
        return True
    return False


@pytest.mark.parametrize("strategy", [_Straight, _Choosy])
def test_a_strategy_of_ten_lines_keeps_the_contract(strategy: Callable[[int], Strategy]) -> None:
    promises = [name for name in dir(StrategyContract) if name.startswith("test_")]
    assert [promise for promise in promises if _is_broken(promise, strategy)] == []


@pytest.mark.parametrize(
    ("strategy", "promise"),
    [
        (
            _drawing(lambda _: np.random.random(10)),  # noqa: NPY002 - the offence
            "test_global_random_states_are_neither_read_nor_changed",
        ),
        (_NoSeed, "test_another_seed_gives_other_candidates"),
        (_Unseeded, "test_a_replayed_log_gives_the_same_continuation"),
        (_drawing(lambda rng: rng.random(1)), "test_candidates_are_roads"),
        (_drawing(lambda _: np.full(10, np.nan)), "test_fifty_are_asked_before_any_is_told"),
        (_CountsFromZero, "test_ids_count_from_one_in_the_order_of_asking"),
        (_BelievesAnything, "test_telling_twice_is_refused_and_changes_nothing"),
        (_BelievesAnything, "test_an_unknown_candidate_is_refused_and_changes_nothing"),
        (_ChokesOnErrors, "test_it_continues_when_all_outcomes_are_alike"),
        (_Writeable, "test_curvatures_belong_to_one_candidate_and_stay_as_they_are"),
        (_OneArrayForAll, "test_curvatures_belong_to_one_candidate_and_stay_as_they_are"),
        (_SharedGenerator, "test_two_strategies_do_not_disturb_each_other"),
        (_LooksAtTheObject, "test_a_replayed_log_gives_the_same_continuation"),
        (_ChangesItsMind, "test_interest_is_lost_once_and_asking_for_it_changes_nothing"),
        (_ThrowsDice, "test_interest_is_lost_once_and_asking_for_it_changes_nothing"),
        (_WantsNothing, "test_interest_is_lost_once_and_asking_for_it_changes_nothing"),
        (_WantsTheObject, "test_a_replayed_log_gives_the_same_continuation"),
        (_ChokesOnDropped, "test_a_replayed_log_gives_the_same_continuation"),
    ],
)
def test_the_contract_detects_a_broken_promise(
    strategy: Callable[[int], Strategy], promise: str
) -> None:
    assert _is_broken(promise, strategy)


def test_make_has_to_be_overridden() -> None:
    with pytest.raises(NotImplementedError, match=r"override make\(seed\)"):
        StrategyContract().make(1)


# The ledger, in which strategies record outstanding candidates.


def _evaluation(
    candidate: Candidate,
    outcome: Outcome = Outcome.PASS,
    moobd: float | None = 1.0,
    budget_spent: float = 0.0,
) -> Evaluation:
    return Evaluation(candidate, outcome, moobd, budget_spent)


@pytest.mark.parametrize(
    ("number", "moobd", "spent", "message"),
    [
        (-1, 1.0, 0.0, "candidate -1 was never asked: the last candidate is 2"),
        (0, 1.0, 0.0, "candidate 0 was never asked: the last candidate is 2"),
        (3, 1.0, 0.0, "candidate 3 was never asked: the last candidate is 2"),
        (1, 1.0, 0.0, "candidate 1 was told already"),
        (2, math.nan, 0.0, "MOOBD must be a finite number of m, got nan"),
        (2, math.inf, 0.0, "MOOBD must be a finite number of m, got inf"),
        (2, 1.0, -0.1, "budget spent must be a finite number of at least 0, got -0.1"),
        (2, 1.0, math.nan, "budget spent must be a finite number of at least 0, got nan"),
        (2, 1.0, math.inf, "budget spent must be a finite number of at least 0, got inf"),
    ],
)
def test_the_ledger_refuses_unknown_candidates_and_non_finite_numbers(
    number: int, moobd: float, spent: float, message: str
) -> None:
    ledger = Ledger()
    first, second = (ledger.issue(np.zeros(3), 10.0, Origin("random")) for _ in range(2))
    ledger.settle(Evaluation(first, Outcome.PASS, 1.0, 0.0))

    stranger = Candidate(number, np.zeros(3), 10.0, Origin("random"))
    with pytest.raises(ValueError, match=message):
        ledger.settle(Evaluation(stranger, Outcome.FAIL, moobd, spent))

    assert len(ledger) == 1  # the second candidate still waits
    rebuilt = Candidate(2, np.ones(3), 10.0, Origin("random"))
    assert ledger.settle(Evaluation(rebuilt, Outcome.FAIL, None, 0.0)) is second
    assert len(ledger) == 0


def test_an_evaluation_accepts_the_name_of_an_outcome_and_no_other_text() -> None:
    strategy = RandomSearch(seed=1)
    evaluation = Evaluation(strategy.ask(), "FAIL", -1.0, 0.1)  # type: ignore[arg-type]
    assert evaluation.outcome is Outcome.FAIL
    strategy.tell(evaluation)
    with pytest.raises(ValueError, match="outcome is 'fail': one of PASS, FAIL, INVALID, ERROR, "):
        Evaluation(strategy.ask(), "fail", -1.0, 0.1)  # type: ignore[arg-type]


def test_a_candidate_without_curvatures_has_no_length() -> None:
    points = np.zeros((2, 2))
    assert Candidate(1, np.empty(0), 10.0, Origin("random"), points).length == 0.0
