"""Which candidates are asked, driven, dropped, tried again and told, and in which order."""

from __future__ import annotations

import os
import random
import signal
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from campaigns import campaign, quick_search
from contents import contents
from events import on_result
from faulty import Straight, Uneven, bend

from frenetic.campaign import Budget, Campaign, CampaignStore, Summary
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.loop import MAX_ERRORS_IN_A_ROW
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import Workers
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Evaluation, Origin, Strategy
from frenetic.testing import DummyDriver, DummySimulator

Choose = Callable[[list[int]], Sequence[int]]
"""Ids of the candidates that are being driven -> those that come back now, in this order."""


class FakeWorkers:
    """Workers that finish in the order a test has, and are lost where it wants.

    Args:
        losses: how often the attempt at a candidate is lost.
        busy: how many candidates keep them busy; as many as they can have if None.
    """

    def __init__(
        self,
        count: int,
        choose: Choose = lambda ids: ids[:1],
        losses: Mapping[int, int] | None = None,
        busy: int | None = None,
    ) -> None:
        self.count = count
        self.busy = count if busy is None else busy
        self.choose = choose
        self.losses = Counter(losses or {})
        self.running: dict[int, Candidate] = {}
        self.submitted: list[int] = []
        self.most = 0
        self.idle_waits = 0
        self.tester = RoadTester(DummySimulator(bend), DummyDriver())

    @property
    def free(self) -> int:
        return self.count - len(self.running)

    @property
    def needed(self) -> int:
        return max(0, self.busy - len(self.running))

    def submit(self, candidate: Candidate) -> None:
        assert self.free
        assert candidate.id not in self.running
        self.running[candidate.id] = candidate
        self.submitted.append(candidate.id)
        self.most = max(self.most, len(self.running))

    def wait(self, timeout: float) -> Sequence[Attempt]:
        self.idle_waits += not self.running
        assert self.idle_waits < 5, "it waits for nobody"
        chosen = list(self.choose(list(self.running))) if self.running else []
        return [self._attempt(self.running.pop(number)) for number in chosen]

    def _attempt(self, candidate: Candidate) -> Attempt:
        if self.losses[candidate.id]:
            self.losses[candidate.id] -= 1
            return Attempt.lost(candidate.id, "fake", 0.0, "fake was lost: it fell asleep")
        return replace(self.tester.test(candidate), worker="fake")

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
    folder: Path, strategy: Strategy, budget: Budget, fake: FakeWorkers, **options: Any
) -> Campaign:
    made = Faked(
        strategy=strategy,
        simulator=DummySimulator(bend),
        driver=DummyDriver(),
        budget=budget,
        folder=folder,
        **options,
    )
    made.fake = fake
    return made


class Noted(Strategy):
    """A strategy that notes what it is asked and told: ("ask", id) or (outcome, id)."""

    def __init__(self, strategy: Strategy) -> None:
        self.strategy = strategy
        self.notes: list[tuple[str, int]] = []
        self.options = getattr(strategy, "options", {})

    def ask(self) -> Candidate:
        candidate = self.strategy.ask()
        assert candidate is not None
        self.notes.append(("ask", candidate.id))
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        self.strategy.tell(evaluation)
        self.notes.append((str(evaluation.outcome), evaluation.candidate.id))

    def of(self, kind: str) -> list[int]:
        return [number for noted, number in self.notes if noted == kind]

    @property
    def told(self) -> list[int]:
        return [number for noted, number in self.notes if noted != "ask"]


class Selective(Noted):
    def is_wanted(self, candidate: Candidate) -> bool:
        return self.strategy.is_wanted(candidate)


def selective_search(**options: object) -> Selective:
    return Selective(quick_search(**options))


class Litters(Strategy):
    """A selective strategy: straight roads in litters; of each, one fails and ends the litter.

    Args:
        litter: roads in each.
        failing: which of them fails, counted from 0.
        known: whether the roads of a litter name a parent.
    """

    def __init__(self, litter: int, failing: int, *, known: bool = False) -> None:
        self.litter = litter
        self.failing = failing
        self.known = known
        self.asked = self.place = 0
        self.litters: dict[int, int] = {}
        self.failed: set[int] = set()

    def ask(self) -> Candidate:
        if self.place // self.litter in self.failed:  # the rest is not asked any more
            self.place += -self.place % self.litter
        self.asked += 1
        self.litters[self.asked] = self.place // self.litter
        curvatures = np.full(8, 0.05 if self.place % self.litter == self.failing else 0.0)
        self.place += 1
        parents = (1000 + self.litters[self.asked],) if self.known else ()
        return Candidate(self.asked, curvatures, 10.0, Origin("litter", parents))

    def tell(self, evaluation: Evaluation) -> None:
        if evaluation.outcome is Outcome.FAIL:
            self.failed.add(self.litters[evaluation.candidate.id])

    def is_wanted(self, candidate: Candidate) -> bool:
        return self.litters[candidate.id] not in self.failed


# As results come


def test_results_are_told_as_they_come(tmp_path: Path) -> None:
    strategy = Noted(Straight(8, 9, 10))
    order = iter([[3, 1], [2], [4], [7, 6, 5]])
    fake = FakeWorkers(3, lambda ids: next(order))
    faked(tmp_path, strategy, Budget(simulations=7), fake).run()
    assert strategy.notes == [
        *[("ask", 1), ("ask", 2), ("ask", 3)],
        *[("PASS", 3), ("PASS", 1), ("ask", 4), ("ask", 5)],
        *[("PASS", 2), ("ask", 6)],
        *[("PASS", 4), ("ask", 7)],
        *[("PASS", 7), ("PASS", 6), ("PASS", 5)],
    ]
    with CampaignStore.open(tmp_path) as store:
        assert [record.candidate.id for record in store.tests()] == [3, 1, 2, 4, 7, 6, 5]
        places = {asked.id: place for asked, place in store.candidates()}
    assert places == {1: 0, 2: 0, 3: 0, 4: 2, 5: 2, 6: 3, 7: 4}


@pytest.mark.parametrize("seed", range(12))
def test_as_results_come_each_promise_is_kept(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    count, simulations, lost = 1 + seed % 9, rng.randint(20, 60), rng.random() < 0.5
    losses = {number: rng.choice([0, 0, 1, 2]) for number in range(1, 500)} if lost else {}
    fake = FakeWorkers(count, lambda ids: rng.sample(ids, rng.randint(1, len(ids))), losses)
    strategy = selective_search(max_redraws=0)
    summary = faked(tmp_path, strategy, Budget(simulations=simulations), fake).run()
    assert summary.simulations == simulations  # exactly
    assert summary.invalid > 0  # at no cost
    assert fake.most <= count
    assert count > 1 or not summary.dropped
    outstanding = most = 0
    for kind, _ in strategy.notes:
        outstanding += 1 if kind == "ask" else -1
        most = max(most, outstanding)
    assert most <= count
    assert sorted(strategy.told) == strategy.of("ask") == list(range(1, len(strategy.told) + 1))
    tries = Counter(fake.submitted)
    with CampaignStore.open(tmp_path) as store:
        for record in store.tests():
            number = record.candidate.id
            if record.outcome is Outcome.DROPPED:
                # Driven it was not, though an attempt may have been lost.
                assert tries[number] == 0 or lost
                assert (record.attempts, record.attempt.worker) == (0, None)
            else:
                assert record.attempts == tries[number] <= 2
                assert (record.outcome is Outcome.ERROR) == (losses.get(number, 0) >= 2)


def test_a_sibling_that_waits_is_dropped_and_one_that_was_driven_is_not(tmp_path: Path) -> None:
    strategy = Selective(Litters(litter=3, failing=1))
    fake = FakeWorkers(3, lambda ids: ids, losses={1: 1})
    faked(tmp_path, strategy, Budget(simulations=5), fake).run()
    # 1 was lost and waits, 2 failed, 3 had been driven: only 1 is dropped.
    assert strategy.notes[:3] == [("ask", 1), ("ask", 2), ("ask", 3)]
    assert strategy.told[:3] == [2, 3, 1]
    assert strategy.of("DROPPED") == [1]
    assert fake.submitted.count(1) == 1


def test_after_dropping_others_are_asked_at_once(tmp_path: Path) -> None:
    """Asked by a campaign of three workers, two candidates wait for the one that goes on."""
    budget = Budget(simulations=9)
    fake = FakeWorkers(3, lambda ids: ids[:1])

    def leave(progress: Summary) -> None:
        raise KeyboardInterrupt

    first = Selective(Litters(litter=9, failing=1))
    assert faked(tmp_path, first, budget, fake).run(on_event=on_result(leave)).interrupted
    assert first.notes == [("ask", 1), ("ask", 2), ("ask", 3), ("PASS", 1)]
    second, alone = Selective(Litters(litter=9, failing=1)), FakeWorkers(1)
    faked(tmp_path, second, budget, alone).resume()
    assert second.notes[4:7] == [("FAIL", 2), ("DROPPED", 3), ("ask", 4)]
    assert alone.idle_waits == 0


def test_a_budget_of_failures_may_bring_a_few_more_but_asks_for_none(tmp_path: Path) -> None:
    strategy = Noted(Litters(litter=1, failing=0))
    summary = faked(tmp_path, strategy, Budget(failures=4), FakeWorkers(3)).run()
    assert summary.failed == 4 + 2  # what ran when the fourth came
    assert strategy.of("ask") == strategy.of("FAIL")


# In the order of asking


def test_in_order_the_oldest_is_told_first(tmp_path: Path) -> None:
    strategy = Noted(Straight(8, 9))
    order = iter([[3, 2], [1], [4], [6], [5]])
    fake = FakeWorkers(3, lambda ids: next(order))
    faked(tmp_path, strategy, Budget(simulations=6), fake, ordered=True, lookahead=4).run()
    assert strategy.notes == [
        *[("ask", 1), ("ask", 2), ("ask", 3), ("ask", 4)],
        *[("PASS", 1), ("ask", 5), ("PASS", 2), ("ask", 6), ("PASS", 3)],
        *[("PASS", 4), ("PASS", 5), ("PASS", 6)],
    ]


def ordered_run(
    folder: Path,
    budget: Budget,
    rng: random.Random | None = None,
    count: int = 1,
    losses: Mapping[int, int] | None = None,
    lookahead: int = 7,
) -> tuple[Selective, Summary, FakeWorkers]:
    choose: Choose = lambda ids: ids[:1]  # noqa: E731
    if rng is not None:
        choose = lambda ids: rng.sample(ids, rng.randint(0, len(ids)))  # noqa: E731
    fake = FakeWorkers(count, choose, losses)
    strategy = selective_search()
    summary = faked(folder, strategy, budget, fake, ordered=True, lookahead=lookahead).run()
    return strategy, summary, fake


BUDGETS = [Budget(simulations=90), Budget(failures=25), Budget(simulations=200, failures=30)]


@pytest.fixture(scope="module")
def one_by_one(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Folders of ordered campaigns with one worker that never errs, by budget."""
    folders = [tmp_path_factory.mktemp("ordered") for _ in BUDGETS]
    for folder, budget in zip(folders, BUDGETS, strict=True):
        strategy, _, _ = ordered_run(folder, budget)
        assert strategy.of("DROPPED")
        assert {"F1", "C1", "P1"} <= {str(row[1]) for row in contents(folder)["test"]}
    return folders


@pytest.mark.parametrize("budget", range(len(BUDGETS)))
@pytest.mark.parametrize("seed", range(4))
def test_in_order_the_campaign_does_not_depend_on_the_workers(
    tmp_path: Path, one_by_one: list[Path], seed: int, budget: int
) -> None:
    rng = random.Random(seed)
    count, lost = rng.randint(1, 20), rng.random() < 0.5
    losses = {number: rng.choice([0, 0, 1]) for number in range(1, 1000)} if lost else {}
    strategy, _, fake = ordered_run(tmp_path, BUDGETS[budget], rng, count, losses)
    without = ("attempts",) if lost else ()
    assert contents(tmp_path, without=without) == contents(one_by_one[budget], without=without)
    assert strategy.told == sorted(strategy.told)
    assert fake.most <= count


@pytest.mark.parametrize("budget", range(len(BUDGETS)))
@pytest.mark.parametrize("seed", range(2))
def test_in_order_the_campaign_does_not_depend_on_interruptions(
    tmp_path: Path, one_by_one: list[Path], seed: int, budget: int
) -> None:
    rng = random.Random(seed)
    for attempt in range(1000):
        choose: Choose = lambda ids: rng.sample(ids, rng.randint(0, len(ids)))  # noqa: E731
        one = faked(
            tmp_path,
            selective_search(),
            BUDGETS[budget],
            FakeWorkers(rng.randint(1, 9), choose),
            ordered=True,
            lookahead=7,
        )
        left = rng.choice([0, 1, 2, 3, 20, 60])

        def stop(progress: Summary) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                raise KeyboardInterrupt

        summary = (one.resume if attempt else one.run)(on_event=on_result(stop))
        if not summary.interrupted:
            break
    assert contents(tmp_path) == contents(one_by_one[budget])


def test_in_order_nothing_is_driven_for_nobody(tmp_path: Path) -> None:
    """Whatever is unwanted when a worker comes free is not handed out."""
    strategy = Selective(Litters(litter=5, failing=0))
    fake = FakeWorkers(1)
    summary = faked(
        tmp_path, strategy, Budget(simulations=6), fake, ordered=True, lookahead=5
    ).run()
    assert (summary.failed, summary.simulations) == (6, 6)
    assert len(fake.submitted) == 6
    assert summary.dropped == len(strategy.of("DROPPED")) > 0
    assert not set(fake.submitted) & set(strategy.of("DROPPED"))


def test_in_order_siblings_are_driven_last(tmp_path: Path) -> None:
    """The first of each litter fails: driven early, it spares the drives of the others."""
    submitted: dict[bool, list[int]] = {}
    for known in (False, True):
        strategy = Selective(Litters(litter=3, failing=0, known=known))
        fake = FakeWorkers(2)
        folder = tmp_path / str(known)
        budget = Budget(simulations=20)
        summary = faked(folder, strategy, budget, fake, ordered=True, lookahead=7).run()
        assert (summary.failed, summary.simulations) == (20, 20)
        submitted[known] = fake.submitted
    # Litters of three begin with 1, 4 and 7; only then is it known that 2 and 3 are dropped.
    assert submitted[False][:2] == [1, 2]
    assert submitted[True][:3] == [1, 4, 7]
    assert len(submitted[False]) == 39  # almost two of each litter
    assert len(submitted[True]) == 20 + 2  # the last ones, when nothing else is left
    told = [contents(tmp_path / str(known), without=("parents",)) for known in (False, True)]
    assert told[0] == told[1]


def test_in_order_doubtful_siblings_are_not_driven_ahead(tmp_path: Path) -> None:
    """Workers that may have seven candidates get those that keep them busy, and all sure ones."""
    first: list[int] = []

    def choose(ids: list[int]) -> list[int]:
        first[:] = first or ids
        return ids[:1]

    strategy = Selective(Litters(litter=4, failing=3, known=True))
    fake = FakeWorkers(7, choose, busy=3)
    budget = Budget(simulations=20)
    summary = faked(tmp_path, strategy, budget, fake, ordered=True, lookahead=9).run()
    assert first == [1, 5, 9]  # each the first of its litter
    assert summary.simulations == len(fake.submitted) == 20


def test_in_order_the_end_does_not_wait_for_what_comes_too_late(tmp_path: Path) -> None:
    fake = FakeWorkers(4, lambda ids: ids[:1])
    strategy = Noted(Litters(litter=1, failing=0))
    summary = faked(tmp_path, strategy, Budget(failures=3), fake, ordered=True, lookahead=6).run()
    assert (summary.failed, summary.simulations) == (3, 3)


# What is reported


@pytest.mark.parametrize("ordered", [False, True])
def test_only_what_is_stored_is_reported(tmp_path: Path, ordered: bool) -> None:
    """Results that come together are stored together, and before any of them is reported."""
    fake = FakeWorkers(5, lambda ids: ids)
    stored: list[int] = []

    def report(progress: Summary) -> None:
        with CampaignStore.open(tmp_path) as store:
            stored.append(store.counts().told)
        assert progress.tests == len(stored)

    faked(tmp_path, Straight(8), Budget(simulations=15), fake, ordered=ordered).run(
        on_event=on_result(report)
    )
    assert stored == [5] * 5 + [10] * 5 + [15] * 5


def test_what_came_before_a_strategy_broke_is_stored_and_reported(tmp_path: Path) -> None:
    class Breaking(Straight):
        def tell(self, evaluation: Evaluation) -> None:
            if evaluation.candidate.id == 4:
                raise KeyError("four")

    reported: list[int] = []
    with pytest.raises(CampaignError, match="the strategy raised KeyError: 'four'"):
        faked(tmp_path, Breaking(8), Budget(simulations=9), FakeWorkers(5, lambda ids: ids)).run(
            on_event=on_result(lambda summary: reported.append(summary.tests))
        )
    assert reported == [1, 2, 3]
    with CampaignStore.open(tmp_path) as store:
        assert [record.candidate.id for record in store.tests()] == [1, 2, 3, 4]


# Real workers


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_real_workers_in_order_give_the_same_campaign(
    tmp_path: Path, one_by_one: list[Path], workers: int
) -> None:
    for number, budget in enumerate(BUDGETS[:2]):
        folder, options = tmp_path / str(number), {"ordered": True, "lookahead": 7}
        campaign(folder, budget=budget, simulator=Uneven(), workers=workers, **options).run()
        assert contents(folder) == contents(one_by_one[number])


def test_real_workers_as_results_come_meet_the_budget(tmp_path: Path) -> None:
    strategy = selective_search()
    uneven = campaign(tmp_path, 80, strategy=strategy, simulator=Uneven(), workers=3)
    assert uneven.run().simulations == 80
    assert sorted(strategy.told) == strategy.of("ask")
    with CampaignStore.open(tmp_path) as store:
        by = Counter(r.attempt.worker for r in store.tests() if r.outcome is not Outcome.DROPPED)
    assert set(by) == {"worker 1", "worker 2", "worker 3"}


# Attempts


def test_a_road_lost_twice_is_an_error_with_its_reason(tmp_path: Path) -> None:
    fake = FakeWorkers(2, losses={2: 9})
    summary = faked(tmp_path, Straight(8), Budget(simulations=4), fake).run()
    assert (summary.errors, summary.passed) == (1, 3)
    with CampaignStore.open(tmp_path) as store:
        record = store.test(2)
    assert (record.outcome, record.attempts) == (Outcome.ERROR, 2)
    assert record.reason == "fake was lost: it fell asleep"
    assert (record.attempt.pose, record.drive) == (None, None)


def test_nothing_but_lost_attempts_ends_the_campaign(tmp_path: Path) -> None:
    losses = dict.fromkeys(range(1, 99), 9)
    with pytest.raises(CampaignError, match=r"last 10 drives broke.*it fell asleep"):
        faked(tmp_path, Straight(8), Budget(simulations=50), FakeWorkers(3, losses=losses)).run()
    with CampaignStore.open(tmp_path) as store:
        assert store.counts().by_outcome[Outcome.ERROR] == MAX_ERRORS_IN_A_ROW
    # It can be resumed when whatever it was is mended.
    one = faked(tmp_path, Straight(8), Budget(simulations=50), FakeWorkers(3))
    assert one.resume().passed == 50 - MAX_ERRORS_IN_A_ROW


# Interrupts


@pytest.mark.parametrize("ordered", [False, True])
def test_an_interrupt_finishes_what_runs(tmp_path: Path, ordered: bool) -> None:
    fake = FakeWorkers(3)
    seen: list[Summary] = []

    def interrupt(progress: Summary) -> None:
        seen.append(progress)
        if len(seen) == 4:
            os.kill(os.getpid(), signal.SIGINT)

    one = faked(tmp_path, Noted(Straight(8, 9)), Budget(simulations=50), fake, ordered=ordered)
    summary = one.run(on_event=on_result(interrupt))
    assert summary.interrupted
    assert not fake.running
    assert summary.simulations == len(fake.submitted) == len(seen)
    assert 4 < summary.simulations <= 7
