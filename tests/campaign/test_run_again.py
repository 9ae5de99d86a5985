"""A campaign that is run in parts, with callbacks, from Python."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from contents import contents
from events import on_result, on_test
from test_campaign import BENT, LOOP, STRAIGHT, Scripted, fails_when_bent

import frenetic.campaign.campaign as campaign_module
from frenetic.campaign import Budget, Campaign, CampaignStore, Summary, Test
from frenetic.campaign.check import check_campaign
from frenetic.campaign.objective import objectives
from frenetic.campaign.record import Attempt
from frenetic.campaign.workers.workers import InProcessWorker
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Evaluation, Frenetic, RandomSearch, Strategy
from frenetic.testing import DummyDriver, DummySimulator

ROADS = STRAIGHT, LOOP, BENT


def campaign(folder: Path, budget: Budget | None = None, **options) -> Campaign:  # type: ignore[no-untyped-def]
    return Campaign(
        strategy=options.pop("strategy", None) or Scripted(*ROADS),
        simulator=DummySimulator(fails_when_bent),
        driver=DummyDriver(),
        budget=budget,
        folder=folder,
        **options,
    )


@pytest.mark.parametrize("ordered", [False, True])
def test_parts_give_the_same_campaign_as_one_run(tmp_path: Path, ordered: bool) -> None:
    def search(name: str) -> Campaign:
        return campaign(
            tmp_path / name, Budget(simulations=20), strategy=Frenetic(seed=1), ordered=ordered
        )

    whole = search("whole").run()
    parts = search("parts")
    ends = [parts.run(3), parts.run(10), parts.run()]
    assert [end.simulations for end in ends] == [3, 13, 20]
    assert [end.interrupted for end in ends] == [True, True, False]
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")
    assert ends[-1].counts_json() == whole.counts_json()
    assert check_campaign(tmp_path / "parts").findings == ()
    # And so it is resumed, too.
    assert search("parts").resume().simulations == 20


class Mine(Strategy):
    """A strategy of one's own, around a built-in one."""

    def __init__(self) -> None:
        self.inner = RandomSearch(seed=1)

    def ask(self) -> Candidate:
        return self.inner.ask()

    def tell(self, evaluation: Evaluation) -> None:
        self.inner.tell(evaluation)


@pytest.mark.parametrize("kind", [Mine, lambda: Frenetic(seed=1)])
def test_a_strategy_searches_for_one_campaign(tmp_path: Path, kind: Callable[[], Strategy]) -> None:
    first = campaign(tmp_path / "first", strategy=kind())
    first.run(2)
    second = campaign(tmp_path / "second", strategy=first.strategy)
    with pytest.raises(CampaignError, match="was asked before: make a new one") as refused:
        second.run(2)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "second").exists()
    with pytest.raises(CampaignError, match="was asked before"):
        first.resume()
    assert first.run(1).simulations == 3
    fresh = campaign(tmp_path / "first", Budget(simulations=4), strategy=kind())
    assert fresh.resume().simulations == 4


def test_a_built_in_strategy_knows_that_it_was_asked(tmp_path: Path) -> None:
    strategy = RandomSearch(seed=1)
    strategy.ask()
    with pytest.raises(CampaignError, match="RandomSearch was asked before"):
        campaign(tmp_path / "c", strategy=strategy).run(1)


@pytest.mark.parametrize("ordered", [False, True])
def test_a_campaign_without_a_budget_makes_as_many_simulations_as_it_is_told(
    tmp_path: Path, ordered: bool
) -> None:
    search = campaign(tmp_path, ordered=ordered)
    assert [search.run(2).simulations, search.run(3).simulations] == [2, 5]
    assert search.budget == Budget(simulations=5)
    again = campaign(tmp_path, ordered=ordered)
    assert again.resume().simulations == 5
    last = again.run(1)
    assert (last.simulations, last.interrupted) == (6, False)


def test_a_spent_budget_grows(tmp_path: Path) -> None:
    search = campaign(tmp_path, Budget(simulations=3, time=1e6))
    assert search.run().simulations == 3
    assert search.run(4).simulations == 7
    assert search.budget == Budget(simulations=7, time=1e6)


def test_only_stored_tests_are_reported_in_order_and_whole(tmp_path: Path) -> None:
    seen: list[Test] = []
    search = campaign(tmp_path)

    def look(test: Test) -> None:
        with CampaignStore.open(tmp_path) as store:
            assert store.stored() == test.told
        seen.append(test)

    search.run(2, on_event=on_test(look))
    search.run(2, on_event=on_test(look))
    assert [test.told for test in seen] == [1, 2, 3, 4, 5, 6]
    outcomes = [Outcome.PASS, Outcome.INVALID, Outcome.FAIL]
    assert [test.outcome for test in seen] == [*outcomes, *outcomes]
    assert [test.drive is None for test in seen] == [test.moobd is None for test in seen]


@pytest.mark.parametrize("options", [{}, {"ordered": True}, {"workers": 2}])
def test_a_callback_stops_a_campaign_which_goes_on_afterwards(
    tmp_path: Path, options: dict[str, int]
) -> None:
    search = campaign(tmp_path, Budget(simulations=30), **options)

    def until_it_fails(test: Test) -> None:
        if test.outcome is Outcome.FAIL:
            search.stop()

    assert search.run(1).simulations == 1
    end = search.run(on_event=on_test(until_it_fails))
    assert end.interrupted
    assert 1 <= end.failed < 15
    assert search.run().simulations == 30
    search.stop()  # not running: nothing happens


def test_an_error_in_a_callback_is_raised_and_loses_nothing(tmp_path: Path) -> None:
    search = campaign(tmp_path, Budget(simulations=4))

    def fail(_: object) -> None:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        search.run(on_event=on_result(fail))
    with CampaignStore.open(tmp_path) as store:
        assert store.stored() == 1
    assert search.run().simulations == 4
    campaign(tmp_path / "whole", Budget(simulations=4)).run()
    assert contents(tmp_path) == contents(tmp_path / "whole")


class TwoAtOnce(InProcessWorker):
    """Returns two attempts together, as several workers may."""

    @property
    def free(self) -> int:
        return 2 - len(self.__dict__.setdefault("candidates", []))

    def submit(self, candidate: Candidate) -> None:
        self.__dict__["candidates"].append(candidate)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        attempts: list[Attempt] = []
        for candidate in self.__dict__.pop("candidates"):
            super().submit(candidate)
            attempts += super().wait(timeout)
        return attempts


def test_what_was_stored_with_the_test_at_an_error_is_reported_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.campaign.InProcessWorker", TwoAtOnce)
    search = campaign(tmp_path, Budget(simulations=4))
    seen: list[int | None] = []

    def fail(test: Test) -> None:
        seen.append(test.told)
        raise KeyError("mine")

    with pytest.raises(KeyError):
        search.run(on_event=on_test(fail))
    with CampaignStore.open(tmp_path) as store:
        assert store.stored() == 2
    end = search.run(on_event=on_test(lambda test: seen.append(test.told)))
    assert end.simulations == 4
    assert seen == list(range(1, end.tests + 1))


def test_the_best_test_is_the_worst_for_the_driver(tmp_path: Path) -> None:
    search = campaign(tmp_path / "a")
    with pytest.raises(CampaignError, match="the folder of a campaign is needed"):
        _ = search.best_test
    search.run(2)
    best = search.best_test
    assert best is not None
    assert best.outcome is Outcome.FAIL
    assert best.drive is not None
    other = campaign(tmp_path / "b", objective="oob-share")
    end: Summary = other.run(4)
    with CampaignStore.open(tmp_path / "b") as store:
        values = objectives(store)
    assert other.best_test is not None
    assert values[other.best_test.id] == end.best == max(values.values())


def test_calls_that_make_no_sense(tmp_path: Path) -> None:
    search = campaign(tmp_path)
    with pytest.raises(ValueError, match=r"has no budget: run\(20\) makes 20 simulations"):
        search.run()
    for number in (0, -1, 1.5, True):
        with pytest.raises(ValueError, match="whole number of at least 1"):
            search.run(number)  # type: ignore[arg-type]
    assert not (tmp_path / "campaign.sqlite").exists()
    search.run(1)
    campaign(tmp_path, Budget(simulations=2)).resume()
    with pytest.raises(CampaignError, match="written by another process since"):
        search.run(1)


def test_progress_may_still_come_first(tmp_path: Path) -> None:
    seen: list[Summary] = []
    campaign(tmp_path, Budget(simulations=2)).run(on_event=on_result(seen.append))
    assert [one.simulations for one in seen] == [1, 1, 2]


@pytest.mark.parametrize("presses", [1, 2])
def test_what_a_second_ctrl_c_breaks_is_an_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, presses: int
) -> None:
    def compile_with_a_deaf_callback() -> None:
        """As llvmlite does, whose callbacks cannot raise."""
        for _ in range(presses):
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr(campaign_module, "compile_kernels", compile_with_a_deaf_callback)
    searching = campaign(tmp_path / "c", Budget(simulations=2))
    if presses == 2:
        assert searching.run().interrupted
    else:
        with pytest.raises(RuntimeError, match="no compiled object"):
            searching.run()
