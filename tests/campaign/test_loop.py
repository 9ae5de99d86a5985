"""The loop of a campaign: order of candidates and results, dropped and lost ones, and its end."""

from __future__ import annotations

import itertools
import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, Self

import numpy as np
import pytest
from campaigns import campaign, quick_search, refused
from contents import contents
from events import on_result
from faulty import Straight, Uneven

from frenetic.campaign import Budget, Campaign, CampaignStore, Event, Summary
from frenetic.campaign.counts import Counts
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.loop import MAX_ERRORS_IN_A_ROW
from frenetic.campaign.record import Attempt
from frenetic.campaign.second_drive import SECOND_DRIVE
from frenetic.campaign.workers import Workers
from frenetic.errors import Trouble
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.search import Candidate, Evaluation, Origin, SearchEnded, Strategy
from frenetic.testing import DummyDriver, DummySimulator

Choose = Callable[[list[int]], Sequence[int]]
"""Ids of the candidates that are being driven -> ids of those that finish now, in this order."""
ASLEEP = "fake was lost: it fell asleep"
REASON = "as it was to be"


class Families(Strategy):
    """Proposes roads in families: after a failure no other road of the family is wanted.

    Args:
        outcomes: outcomes of the roads, in turn.
        size: number of roads in a family.
        mixed: whether the roads of two families alternate.
        names_parents: whether the roads of a family name the same parent.
        waits: share of the calls of `ask` that wait for a result first.
        roads: number of roads after which the strategy ends; None: never.
    """

    def __init__(
        self,
        outcomes: Sequence[Outcome] = (Outcome.PASS,),
        size: int = 1,
        *,
        mixed: bool = False,
        names_parents: bool = False,
        waits: float = 0.0,
        roads: int | None = None,
    ) -> None:
        self.outcomes, self.size = outcomes, size
        self.mixed, self.names_parents = mixed, names_parents
        self.waits, self.roads = waits, roads
        self.asked: list[int] = []
        self.told: list[tuple[int, Outcome]] = []
        self.notes: list[object] = []
        self.failed: set[int] = set()

    def family(self, number: int) -> int:
        if self.mixed:
            return (number - 1) // (2 * self.size) * 2 + number % 2
        return (number - 1) // self.size

    def outcome_of(self, number: int) -> Outcome:
        return self.outcomes[(number - 1) % len(self.outcomes)]

    def ask(self) -> Candidate | None:
        if len(self.asked) == self.roads:
            raise SearchEnded("that is all")
        moment = len(self.asked), len(self.told)
        if moment[0] > moment[1] and Random(str(moment)).random() < self.waits:
            return None
        number = len(self.asked) + 1
        self.asked.append(number)
        self.notes.append(number)
        parents = (1000 + self.family(number),) if self.names_parents else ()
        return Candidate(number, np.full(8, number / 1e5), 10.0, Origin("family", parents))

    def tell(self, evaluation: Evaluation) -> None:
        number, outcome = evaluation.candidate.id, evaluation.outcome
        self.told.append((number, outcome))
        self.notes.append((number, outcome, round(evaluation.budget_spent, 9)))
        if outcome is Outcome.FAIL:
            self.failed.add(self.family(number))

    def is_wanted(self, candidate: Candidate) -> bool:
        return self.family(candidate.id) not in self.failed

    def ids(self, outcome: Outcome) -> list[int]:
        return [number for number, result in self.told if result is outcome]


def result_of(number: int, outcome: Outcome) -> Result:
    """Return the result of a candidate; its drive is so long and takes so long as its id says."""
    if not outcome.is_driven:
        return Result(outcome, REASON)
    duration, distance = 7.3 + number % 5, 90.7 + 11.0 * (number % 7)
    return Result(outcome, REASON, -1.0 / number, duration=duration, distance=distance)


class FakeWorkers:
    """Workers that finish in the order that a test chooses, and are lost where it wants.

    Args:
        losses: candidate -> how many attempts at it are lost.
    """

    def __init__(
        self,
        count: int,
        choose: Choose = lambda ids: ids[:1],
        losses: Mapping[int, int] | None = None,
    ) -> None:
        self.count = count
        self.choose = choose
        self.losses = Counter(losses or {})
        self.outcome_of: Callable[[int], Outcome] = lambda number: Outcome.PASS
        self.running: list[int] = []
        self.submitted: list[int] = []
        self.answered: list[int] = []
        self.second_drives: list[int] = []

    @property
    def free(self) -> int:
        return self.count - len(self.running)

    def submit(self, candidate: Candidate) -> None:
        assert self.free
        assert candidate.id not in self.running
        self.running.append(candidate.id)
        is_second_drive = candidate.id in self.answered
        (self.second_drives if is_second_drive else self.submitted).append(candidate.id)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        assert self.running, "no candidate is being driven"
        return [self._attempt(number) for number in self.choose(list(self.running))]

    def _attempt(self, number: int) -> Attempt:
        self.running.remove(number)
        if self.losses[number]:
            self.losses[number] -= 1
            return Attempt.lost(number, "fake", 0.0, Trouble(ASLEEP))
        if number not in self.answered:
            self.answered.append(number)
        return replace(Attempt(number, result_of(number, self.outcome_of(number))), worker="fake")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.running.clear()


class Faked(Campaign):
    """A campaign with fake workers."""

    fake: FakeWorkers

    def _workers(self, log: CampaignLog) -> Workers:
        return self.fake


def faked(
    folder: Path, strategy: Strategy, budget: Budget, fake: FakeWorkers, max_in_flight: int = 16
) -> Campaign:
    """A campaign with fake workers, new or to be resumed."""
    fake_campaign = Faked(
        strategy=strategy,
        simulator=DummySimulator(),
        driver=DummyDriver(),
        budget=budget,
        folder=folder,
        max_in_flight=max_in_flight,
    )
    fake_campaign.fake = fake
    if isinstance(strategy, Families):
        fake.outcome_of = strategy.outcome_of
    return fake_campaign


def search_in_order(
    strategy: Families, losses: Mapping[int, int], budget: Budget, max_in_flight: int
) -> None:
    """Ask and tell a strategy as a campaign does in order, without workers."""
    waiting: deque[Candidate] = deque()
    most_simulations = budget.simulations or 1_000
    counts, share = Counts(), 0.0
    while share < 1.0:
        while len(waiting) < max_in_flight and counts.simulations + len(waiting) < most_simulations:
            try:
                candidate = strategy.ask()
            except SearchEnded:
                break
            if candidate is None:
                break
            waiting.append(candidate)
        if not waiting:
            return
        oldest = waiting.popleft()
        outcome = Outcome.ERROR if losses.get(oldest.id, 0) > 1 else strategy.outcome_of(oldest.id)
        if not strategy.is_wanted(oldest):
            outcome = Outcome.DROPPED
        counts.add(oldest, result_of(oldest.id, outcome))
        share = budget.spent(counts.amounts(0.0))
        strategy.tell(Evaluation(oldest, outcome, None, share))


def interrupt() -> None:
    raise KeyboardInterrupt


def after(results: int, call: Callable[[], object]) -> Callable[[Event], None]:
    """Return a callback that makes a call at each result after so many."""
    left = itertools.count(-results)
    return on_result(lambda _: call() if next(left) >= 0 else None)


class Chance:
    """A strategy, losses of workers and a budget, drawn with a seed."""

    def __init__(self, seed: int) -> None:
        rng = self.rng = Random(seed)
        kinds = [Outcome.PASS, Outcome.PASS, Outcome.FAIL, Outcome.INVALID]
        self.outcomes = [Outcome.PASS, Outcome.FAIL, *rng.choices(kinds, k=rng.randint(3, 9))]
        self.size = rng.randint(1, 6)
        self.kind: dict[str, Any] = {
            "mixed": rng.random() < 0.5,
            "names_parents": rng.random() < 0.5,
            "waits": rng.choice([0.0, 0.0, 0.3]),
            "roads": rng.choice([None, None, rng.randint(1, 60)]),
        }
        has_losses = rng.random() < 0.5
        self.losses = {n: rng.choice([0, 0, 0, 1, 2]) for n in range(1, 1000)} if has_losses else {}
        simulations, failures = rng.randint(1, 40), rng.randint(1, 9)
        limits: list[dict[str, Any]] = [{"simulations": simulations}, {"failures": failures}]
        limits.append({"kilometres": rng.uniform(0.1, 4.0), "simulations": 300})
        limits.append({"simulated_time": rng.uniform(5.0, 400.0), "simulations": 300})
        self.budget = Budget(**rng.choice([*limits, limits[0] | limits[1], limits[2] | limits[1]]))
        self.is_broken_off = rng.random() < 0.5
        self.most_workers = 0
        self.fakes: list[FakeWorkers] = []

    def strategy(self) -> Families:
        return Families(self.outcomes, self.size, **self.kind)

    def run(self, folder: Path, max_in_flight: int) -> tuple[Families, Summary]:
        """Run the campaign to its end; if `is_broken_off`, interrupt and resume it on the way."""
        rng = self.rng
        for attempt in range(1000):
            strategy = self.strategy()
            count = rng.randint(1, 9)
            self.most_workers = max(self.most_workers, count)
            self.fakes.append(
                FakeWorkers(count, lambda ids: rng.sample(ids, rng.randint(1, len(ids))))
            )
            self.fakes[-1].losses.update(self.losses)
            fake_campaign = faked(folder, strategy, self.budget, self.fakes[-1], max_in_flight)
            left = rng.choice([0, 1, 2, 5, 20]) if self.is_broken_off else 1_000_000
            stopping = after(left, rng.choice([fake_campaign.stop, interrupt]))
            end = (fake_campaign.resume if attempt else fake_campaign.run)(on_event=stopping)
            if not end.interrupted:
                return strategy, end
        raise AssertionError("it does not end")

    def require_stored(self, folder: Path, strategy: Families) -> None:
        """Require that the store holds all candidates, results and numbers of attempts."""
        places, results = {}, 0
        for note in strategy.notes:
            if isinstance(note, int):
                places[note] = results
            else:
                results += 1
        with CampaignStore.open(folder) as store:
            assert {candidate.id: place for candidate, place in store.candidates()} == places
            tests = list(store.tests())
            second: Any = store.fact(SECOND_DRIVE)
        failed = strategy.ids(Outcome.FAIL)
        assert second is None or second["test"] == failed[0]
        assert not failed or self.is_broken_off or second is not None
        assert [(test.id, test.outcome) for test in tests] == strategy.told
        for test in tests:
            losses = self.losses.get(test.id, 0)
            if test.outcome is Outcome.DROPPED:
                assert (test.attempts, test.worker) == (0, None)
            else:
                assert test.attempts == 1 + min(losses, 1)
                assert (test.outcome is Outcome.ERROR) == (losses > 1)
                assert test.reason == (ASLEEP if losses > 1 else REASON)


@pytest.mark.parametrize(
    "seed", [*range(5), *(pytest.param(n, marks=pytest.mark.heavy) for n in range(5, 20))]
)
def test_a_campaign_equals_a_plain_search_for_any_workers_and_interruptions(
    tmp_path: Path, seed: int
) -> None:
    chance = Chance(seed)
    max_in_flight = chance.rng.randint(1, 9)
    search_in_order(plain := chance.strategy(), chance.losses, chance.budget, max_in_flight)
    strategy, _ = chance.run(tmp_path, max_in_flight)
    assert strategy.notes == plain.notes
    chance.require_stored(tmp_path, strategy)
    if chance.most_workers == 1 and not chance.kind["names_parents"]:
        driven = {number for fake in chance.fakes for number in fake.answered}
        assert not driven & set(strategy.ids(Outcome.DROPPED))  # no dropped road was driven


# Drives that are not needed


def test_roads_with_the_same_parent_are_driven_last(tmp_path: Path) -> None:
    """The first road of each family fails: driven early, it saves the drives of the others."""
    submitted: dict[bool, list[int]] = {}
    for known in (False, True):
        outcomes = [Outcome.FAIL, Outcome.PASS, Outcome.PASS]
        strategy, fake = Families(outcomes, 3, names_parents=known), FakeWorkers(2)
        budget = Budget(simulations=20)
        summary = faked(tmp_path / str(known), strategy, budget, fake, max_in_flight=7).run()
        assert (summary.failed, summary.simulations) == (20, 20)
        submitted[known] = fake.submitted
    # Families of three begin with 1, 4 and 7; only then is it known that 2 and 3 are dropped.
    assert submitted[False][:2] == [1, 2]
    assert submitted[True][:3] == [1, 4, 7]
    assert len(submitted[True]) < 25 < 35 < len(submitted[False])


def test_the_end_of_the_budget_does_not_wait_for_later_candidates(tmp_path: Path) -> None:
    fake = FakeWorkers(4, lambda ids: [1])
    faked(tmp_path, Families([Outcome.FAIL]), Budget(failures=1), fake, max_in_flight=4).run()
    assert (fake.submitted, fake.answered, fake.second_drives) == ([1, 2, 3, 4], [1], [1])


# Reports and ends


def test_only_stored_results_are_reported(tmp_path: Path) -> None:
    """Results that arrive together are stored together, before any of them is reported."""
    stored: list[int] = []

    def report(progress: Summary) -> None:
        with CampaignStore.open(tmp_path) as store:
            stored.append(store.stored())
        assert progress.tests == len(stored)

    fake = FakeWorkers(5, lambda ids: ids)
    search = faked(tmp_path, Straight(8), Budget(simulations=15), fake)
    search.run(on_event=on_result(report))
    assert stored == [5] * 5 + [10] * 5 + [15] * 5


def test_results_before_a_broken_strategy_are_stored_and_reported(tmp_path: Path) -> None:
    class Breaking(Straight):
        def tell(self, evaluation: Evaluation) -> None:
            if evaluation.candidate.id == 4:
                raise KeyError("four")

    reported: list[int] = []
    fake = FakeWorkers(5, lambda ids: ids)
    with refused("the strategy raised KeyError: 'four'"):
        faked(tmp_path, Breaking(8), Budget(simulations=9), fake).run(
            on_event=on_result(lambda summary: reported.append(summary.tests))
        )
    assert reported == [1, 2, 3]
    with CampaignStore.open(tmp_path) as store:
        assert [test.id for test in store.tests()] == [1, 2, 3, 4]


def test_a_campaign_of_lost_attempts_only_ends_and_can_be_resumed(tmp_path: Path) -> None:
    losses = dict.fromkeys(range(1, 99), 9)
    budget = Budget(simulations=50)
    with refused(r"none of the last 10 drives could be judged.*it fell asleep"):
        faked(tmp_path, Straight(8), budget, FakeWorkers(3, losses=losses)).run()
    end = faked(tmp_path, Straight(8), budget, FakeWorkers(3)).resume()
    assert (end.errors, end.passed) == (MAX_ERRORS_IN_A_ROW, 50 - MAX_ERRORS_IN_A_ROW)


def test_ctrl_c_lets_running_tests_finish(tmp_path: Path) -> None:
    def press(progress: Summary) -> None:
        if progress.tests == 4:
            os.kill(os.getpid(), signal.SIGINT)

    fake = FakeWorkers(3)
    search = faked(tmp_path, Families(), Budget(simulations=50), fake)
    summary = search.run(on_event=on_result(press))
    assert summary.interrupted
    assert not fake.running
    assert 4 < summary.simulations == len(fake.submitted) <= 7


def test_one_and_two_workers_give_the_same_campaign(tmp_path: Path) -> None:
    """The search has mutants, crossovers and dropped roads."""
    for workers in (1, 2):
        folder, options = tmp_path / str(workers), {"max_in_flight": 7}
        simulator, strategy = Uneven(), quick_search()
        parts = {"simulator": simulator, "strategy": strategy, "workers": workers}
        assert campaign(folder, 90, **parts, **options).run().dropped
    whole = contents(tmp_path / "1")
    assert contents(tmp_path / "2") == whole
    assert {"F1", "C1", "P1"} <= {str(row[1]) for row in whole["test"]}
