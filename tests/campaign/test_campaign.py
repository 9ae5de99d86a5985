"""Campaigns from Python: runs in one go and in parts, broken strategies, options and budgets."""

from __future__ import annotations

import json
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import BENT, LOOP, STRAIGHT, Scripted, campaign, refused, scripted
from contents import contents
from events import on_test

from frenetic._support.arrays import FloatArray
from frenetic.campaign import Budget, Campaign, CampaignStore, Test, defaults, new_folder
from frenetic.campaign.check import check_campaign
from frenetic.campaign.configuration import decode_budget
from frenetic.campaign.guarded_strategy import ObservingStrategy
from frenetic.campaign.objective_values import objective_values
from frenetic.campaign.record import Attempt
from frenetic.campaign.summary import Summary
from frenetic.campaign.workers.workers import InProcessWorker
from frenetic.drivers import Controls, Delayed, Driver, Observation, Planner
from frenetic.errors import StrategyError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.road import Road
from frenetic.search import (
    Candidate,
    Evaluation,
    Frenetic,
    Frenetic2021,
    Origin,
    RandomSearch,
    SearchEnded,
)
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.spec import Spec
from frenetic.spec.budget import LIMITS
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver

# One run


@pytest.mark.parametrize(
    ("driver", "budget", "workers"),
    [
        ("planner", Budget(simulations=1000), 1),
        ("planner", Budget(simulations=1001), 3),
        ("planner", Budget(time=60.0), 3),
        ("frenetic.testing:DummyDriver", Budget(simulations=1000), 3),
    ],
)
def test_few_compiled_drives_use_one_worker_by_default(
    driver: str, budget: Budget, workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(defaults, "available_cores", lambda: 3)
    spec = Spec(strategy="random", driver=driver, seed=1).with_budget(budget)
    assert Campaign.of(spec, folder=tmp_path / "c").workers == workers
    assert Campaign.of(spec, folder=tmp_path / "c", workers=2).workers == 2


class ProposesOnce(Scripted):
    """Proposes each road once."""

    def ask(self) -> Candidate:
        if self.asked == len(self.roads):
            raise SearchEnded("the list is worked through")
        return super().ask()


def test_a_strategy_may_end_the_search_and_a_longer_one_goes_on(tmp_path: Path) -> None:
    def search(*roads: list[float]) -> Campaign:
        return scripted(tmp_path, Budget(simulations=3), strategy=ProposesOnce(*roads))

    summary = search(STRAIGHT, LOOP, BENT).run()
    assert (summary.simulations, summary.invalid, summary.interrupted) == (2, 1, False)
    assert summary.ended == "the list is worked through"
    with CampaignStore.open(tmp_path) as store:
        assert store.facts["ended"] == summary.ended
        assert "finished_at" in store.facts
        assert store.facts["strategy_seconds"] >= 0.0  # type: ignore[operator]
    assert check_campaign(tmp_path).findings == ()
    with refused("proposes another road as candidate 2"):
        search(STRAIGHT).resume()
    assert search(STRAIGHT, LOOP, BENT, STRAIGHT).resume().simulations == 3
    with CampaignStore.open(tmp_path) as store:
        assert store.facts["ended"] == ""


def test_a_budget_of_time_ends_the_campaign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr("frenetic.campaign.session.time.perf_counter", lambda: next(clock))
    assert 1 <= scripted(tmp_path, Budget(time=20.0)).run().simulations <= 20


def test_kernels_are_compiled_before_the_time_budget_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    monkeypatch.setattr(
        "frenetic.campaign.campaign.compile_for", lambda *_: order.append("compiled")
    )
    search = scripted(tmp_path, Budget(time=60.0, failures=1))
    search.run(1, on_event=lambda event: order.append(event.kind))
    assert order[:2] == ["compiled", "started"]


def test_a_campaign_with_invalid_roads_only_gives_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.MAX_INVALID_AT_FIRST", 25)
    with refused(r"the first 25 roads were refused.*self-intersecting \(25 times\); 25 results"):
        scripted(tmp_path, Budget(simulations=1), strategy=Scripted(LOOP)).run()


def test_a_campaign_that_has_driven_waits_longer_for_a_valid_road(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.MAX_INVALID_AT_FIRST", 5)
    monkeypatch.setattr("frenetic.campaign.loop.MAX_INVALID_IN_A_ROW", 25)
    with refused(r"the last 25 roads were refused.*self-intersecting \(25 times\); 26 results"):
        strategy = Scripted(STRAIGHT, *(LOOP for _ in range(30)))
        scripted(tmp_path, Budget(simulations=2), strategy=strategy).run()


def test_the_most_frequent_reason_of_refused_roads_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.MAX_INVALID_AT_FIRST", 9)
    short = [0.0, 0.0]
    with refused(
        r"gives up: [^(]*self-intersecting \(6 times\), [^(]*not long enough\. \(3 times\);"
    ):
        strategy = Scripted(short, LOOP, LOOP)
        scripted(tmp_path, Budget(simulations=1), strategy=strategy).run()


def test_a_campaign_gives_up_if_its_strategy_wants_no_road(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Fickle(Scripted):
        def is_wanted(self, candidate: Candidate) -> bool:
            return False

    monkeypatch.setattr("frenetic.campaign.loop.MAX_INVALID_AT_FIRST", 25)
    with refused(r"first 25 roads were refused.*not wanted any more"):
        scripted(tmp_path, Budget(simulations=1), strategy=Fickle(STRAIGHT)).run()


@pytest.mark.parametrize("method", ["ask", "notice"])
def test_sys_exit_in_a_strategy_does_not_end_the_program(tmp_path: Path, method: str) -> None:
    class Leaving(Scripted):
        def ask(self) -> Candidate:
            return sys.exit(3) if method == "ask" else super().ask()

        @property
        def notice(self) -> str | None:
            return sys.exit(3) if method == "notice" else None

    with refused("the strategy raised SystemExit: 3"):
        scripted(tmp_path, Budget(simulations=2), strategy=Leaving(STRAIGHT)).run()


def test_a_new_folder_has_a_new_name(tmp_path: Path) -> None:
    first = new_folder(tmp_path)
    first.mkdir()
    assert new_folder(tmp_path) != first


@pytest.mark.parametrize("presses", [1, 2])
def test_an_error_after_a_second_ctrl_c_is_an_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, presses: int
) -> None:
    def compile_with_a_deaf_callback(*arguments: object) -> None:
        """Swallow Ctrl-C and raise another error, as llvmlite does: its callbacks cannot raise."""
        for _ in range(presses):
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr("frenetic.campaign.campaign.compile_for", compile_with_a_deaf_callback)
    search = scripted(tmp_path, Budget(simulations=2))
    if presses == 2:
        assert search.run().interrupted
    else:
        with pytest.raises(RuntimeError, match="no compiled object"):
            search.run()


# Several runs


@pytest.mark.parametrize("max_in_flight", [1, 16])
def test_a_campaign_run_in_parts_equals_one_run(tmp_path: Path, max_in_flight: int) -> None:
    def search(name: str) -> Campaign:
        return campaign(tmp_path / name, 20, strategy=Frenetic(seed=1), max_in_flight=max_in_flight)

    whole = search("whole").run()
    parts = search("parts")
    ends = [parts.run(3), parts.run(10), parts.run()]
    assert [end.simulations for end in ends] == [3, 13, 20]
    assert [end.interrupted for end in ends] == [True, True, False]
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")
    assert ends[-1].counts_json() == whole.counts_json()
    assert check_campaign(tmp_path / "parts").findings == ()
    # A resumed campaign goes on in the same way.
    assert search("parts").resume().simulations == 20


def test_without_a_budget_run_takes_the_number_of_simulations(
    tmp_path: Path,
) -> None:
    search = scripted(tmp_path, None, max_in_flight=16)
    assert [search.run(2).simulations, search.run(3).simulations] == [2, 5]
    assert search.budget == Budget(simulations=5)
    resumed = scripted(tmp_path, None, max_in_flight=16)
    assert resumed.resume().simulations == 5
    last = resumed.run(1)
    assert (last.simulations, last.interrupted) == (6, False)
    resumed.stop()  # not running: nothing happens
    limited = scripted(tmp_path / "limited", Budget(simulations=3, time=1e6))
    assert [limited.run().simulations, limited.run(4).simulations] == [3, 7]
    assert limited.budget == Budget(simulations=7, time=1e6)


def test_a_strategy_serves_one_campaign_only(tmp_path: Path) -> None:
    first = scripted(tmp_path / "first", None)
    first.run(2)
    second = scripted(tmp_path / "second", None, strategy=first.strategy)
    with refused("was asked before: make a new one"):
        second.run(2)
    assert not (tmp_path / "second").exists()
    with refused("was asked before"):
        first.resume()
    assert first.run(1).simulations == 3
    assert scripted(tmp_path / "first", Budget(simulations=4)).resume().simulations == 4
    used_strategy = RandomSearch(seed=1)
    used_strategy.ask()
    with refused("RandomSearch was asked before"):
        campaign(tmp_path / "second", strategy=used_strategy).run(1)


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


def test_an_error_in_a_callback_is_raised_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next run reports the results that were stored together with the first."""
    monkeypatch.setattr("frenetic.campaign.workers.local.InProcessWorker", TwoAtOnce)
    search = scripted(tmp_path, Budget(simulations=4), max_in_flight=2)
    orders: list[int | None] = []

    def fail(test: Test) -> None:
        orders.append(test.result_number)
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        search.run(on_event=on_test(fail))
    with CampaignStore.open(tmp_path) as store:
        assert store.stored() == 2
    end = search.run(on_event=on_test(lambda test: orders.append(test.result_number)))
    assert end.simulations == 4
    assert orders == list(range(1, end.tests + 1))


def test_best_test_is_the_most_severe_test(tmp_path: Path) -> None:
    search = scripted(tmp_path / "a", None)
    with refused("the folder of a campaign is needed"):
        _ = search.best_test
    search.run(2)
    best = search.best_test
    assert best is not None
    assert best.outcome is Outcome.FAIL
    assert best.drive is not None
    other = scripted(tmp_path / "b", None, objective="oob-share")
    end = other.run(4)
    with CampaignStore.open(tmp_path / "b") as store:
        values = objective_values(store)
    assert other.best_test is not None
    assert values[other.best_test.id] == end.worst == max(values.values())


def test_run_refuses_a_missing_or_wrong_number_of_simulations(tmp_path: Path) -> None:
    search = scripted(tmp_path, None)
    with pytest.raises(ValueError, match=r"has no budget: run\(20\) makes 20 simulations"):
        search.run()
    for number in (0, -1, 1.5, True):
        with pytest.raises(ValueError, match="whole number of at least 1"):
            search.run(number)  # type: ignore[arg-type]
    assert not (tmp_path / "campaign.sqlite").exists()
    search.run(1)
    scripted(tmp_path, Budget(simulations=2)).resume()
    with refused("written by another process since"):
        search.run(1)


# Broken strategies


def nested(levels: int) -> list[Any]:
    """Lists that are nested so many levels deep."""
    value: list[Any] = []
    for _ in range(levels):
        value = [value]
    return value


class Broken(Scripted):
    """Breaks at its fourth candidate: it raises in a method, or proposes something else."""

    def __init__(self, method: str = "", proposal: object = None) -> None:
        super().__init__(STRAIGHT)
        self.method = method
        self.proposal = proposal

    def _break(self, method: str) -> None:
        if method == self.method and self.asked >= 3:
            raise KeyError("out of\nideas")

    def ask(self) -> Candidate:
        self._break("ask")
        candidate = super().ask()
        if self.asked < 4 or self.method:
            return candidate
        if isinstance(self.proposal, dict):
            return replace(candidate, **self.proposal)
        return self.proposal  # type: ignore[return-value]

    def tell(self, evaluation: Evaluation) -> None:
        if self.asked == 4:
            self._break("tell")
        super().tell(evaluation)

    def is_wanted(self, candidate: Candidate) -> bool:
        if self.asked == 4:
            self._break("is_wanted")
        return True


RAISED = r"the strategy raised KeyError: 'out of\nideas'"


@pytest.mark.parametrize(
    ("strategy", "message", "results"),
    [
        (Broken("ask"), RAISED, 3),
        (Broken("tell"), RAISED, 4),
        (Broken("is_wanted"), RAISED, 3),
        *(
            (Broken(proposal=proposal), f"the strategy proposed {message}", 3)
            for proposal, message in [
                ("a road", "str instead of frenetic.Candidate"),
                ({"curvatures": np.zeros((3, 3))}, "candidate 4 with curvatures of shape (3, 3)"),
                ({"curvatures": [0.0, np.nan]}, "candidate 4 with values that are not finite"),
                ({"points": np.zeros(4)}, "candidate 4 with points of shape (4,)"),
                ({"points": np.full((4, 2), np.inf)}, "candidate 4 with values that are not"),
                ({"step": -1.0}, "candidate 4 with the step -1.0: a positive number"),
                ({"step": "10"}, "candidate 4 with the step '10': a positive number"),
                ({"id": "1"}, "candidate '1' with this id: a whole number"),
                ({"id": 2**65}, f"candidate {2**65} with this id: a whole number"),
                ({"origin": None}, "candidate 4 with the origin None: a frenetic.search.Origin"),
                ({"origin": Origin(None)}, "candidate 4 with the operator None: a text"),  # type: ignore[arg-type]
                ({"origin": Origin("a", ("b",))}, "candidate 4 with the parents ('b',): "),  # type: ignore[arg-type]
                ({"origin": Origin("a", (), -1)}, "candidate 4 with the generation -1: a whole"),
                ({"notes": {"a": np.nan}}, "candidate 4 with the notes {'a': nan}: names with"),
                ({"notes": {"a": {1}}}, "candidate 4 with the notes {'a': {1}}: names with"),
                ({"notes": {"a": nested(150)}}, "candidate 4 with the notes {'a': [[[[[["),
                (
                    {"notes": {"a": nested(5_000)}},
                    "candidate 4 with the notes a dict that is nested",
                ),
            ]
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_strategy_that_breaks_ends_the_campaign_with_one_line(
    tmp_path: Path, strategy: Broken, message: str, results: int
) -> None:
    with pytest.raises(StrategyError) as caught:
        scripted(tmp_path, Budget(simulations=9), strategy=strategy).run()
    assert str(caught.value).startswith(message)
    with CampaignStore.open(tmp_path) as store:
        assert store.counts().result_count == results


class Observing(Scripted, ObservingStrategy):
    """Records outcomes, and how many results `tell` had before each."""

    def __init__(self) -> None:
        super().__init__()
        self.observed: list[tuple[int, Outcome, bool]] = []

    def observe(self, attempt: Attempt) -> None:
        path = attempt.trajectory
        is_driven = path is not None and len(path) > 0
        self.observed.append((len(self.evaluations), attempt.result.outcome, is_driven))


def test_an_observing_strategy_sees_each_drive_before_tell(tmp_path: Path) -> None:
    strategy, budget = Observing(), Budget(simulations=2)
    scripted(tmp_path / "c", budget, strategy=strategy).run()
    assert strategy.observed == [
        (0, Outcome.PASS, True),
        (1, Outcome.INVALID, False),
        (2, Outcome.FAIL, True),
    ]
    with refused("observes drives, which are not kept exactly"):
        scripted(tmp_path / "c", Budget(simulations=3), strategy=Observing()).resume()
    with pytest.raises(ValueError, match="needs one worker"):
        scripted(tmp_path / "d", budget, strategy=strategy, workers=2)


# Options and budgets

COUNT = "a whole number of at least 1"
NUMBER = "a number is needed"


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("lane_width", 0, "lane_width is 0: a number > 0 is needed"),
        ("lane_width", float("nan"), "lane_width is nan: a number > 0 is needed"),
        ("lane_width", "4", f"lane_width is '4': {NUMBER}"),
        ("map_margin", -1.0, "map_margin is -1.0: a number >= 0 is needed"),
        ("map_margin", None, f"map_margin is None: {NUMBER}"),
        ("map_size", 150.0, "map_size is 150, but the strategy was made for 200"),
        ("map_size", "wide", f"map_size is 'wide': {NUMBER}"),
        ("map_size", True, f"map_size is True: {NUMBER}"),
        ("workers", "a", "'a' is neither a number nor the address of a Dask scheduler"),
        ("workers", "", "'' is neither a number nor the address of a Dask scheduler"),
        ("workers", float("nan"), f"workers is nan: {COUNT}"),
        ("workers", 1025, "workers is 1025: at most 1024 are allowed"),
        ("max_in_flight", 0, f"max_in_flight is 0: {COUNT}"),
        ("drive_limit", 0.0, "drive_limit is 0.0: a positive number of seconds"),
        ("strategy", object(), "object is no strategy: make it a frenetic.Strategy"),
        ("start_from", ["c"], "the strategy RandomSearch starts from no earlier campaign"),
    ],
)
def test_options_are_checked_before_anything_is_written(
    tmp_path: Path, option: str, value: object, words: str
) -> None:
    with refused(f"^{words}", ValueError):
        if option in ("lane_width", "map_margin", "map_size"):
            option, value = "terms", Terms(**{option: value})  # type: ignore[arg-type]
        campaign(tmp_path / "c", **{"strategy": RandomSearch(seed=1), option: value})  # type: ignore[arg-type]
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, "the budget limits nothing: give simulations, time, failures, kilometres or"),
        ({"simulations": 0}, f"simulations is 0: {COUNT} is needed"),
        ({"failures": -1}, f"failures is -1: {COUNT} is needed"),
        ({"time": -1.0}, "time is -1.0: a positive number of seconds is needed"),
        ({"time": float("inf")}, "time is inf: a positive number of seconds is needed"),
        ({"kilometres": 0.0}, "kilometres is 0.0: a positive number of kilometres is needed"),
        ({"simulated_time": -5.0}, "simulated_time is -5.0: a positive number of seconds is"),
        *(({name: bad}, "") for name, bad in [("simulations", 2.5), ("failures", True)]),
    ],
)
def test_a_wrong_budget_is_refused_from_python_and_from_a_record(
    limits: dict[str, Any], message: str
) -> None:
    with refused(f"^{message}", ValueError):
        Budget(**limits)
    with refused(f"^{message}", ValueError):
        decode_budget(limits)


def test_the_largest_spent_share_of_a_budget_counts() -> None:
    budget = Budget(simulations=100, time=50.0, failures=4, kilometres=20.0, simulated_time=1e3)

    def spent(*amounts: float) -> float:
        return budget.spent(dict(zip(LIMITS, amounts, strict=True)))

    assert spent(10, 1.0, 0, 1.0, 10.0) == 0.1
    assert spent(10, 25.0, 0, 1.0, 10.0) == 0.5
    assert spent(10, 25.0, 3, 1.0, 10.0) == 0.75
    assert spent(10, 25.0, 3, 16.0, 10.0) == 0.8
    assert spent(10, 25.0, 3, 16.0, 900.0) == 0.9
    assert spent(0, 70.0, 0, 0.0, 0.0) == 1.0


def test_numbers_of_numpy_give_the_same_campaign(tmp_path: Path) -> None:
    def search(name: str, whole: Callable[..., Any], real: Callable[..., Any]) -> Campaign:
        return Campaign(
            strategy=RandomSearch(seed=whole(1), map_size=real(200)),
            simulator=EmbeddedSimulator(rules=Rules(speed_limit=whole(60))),
            driver=Planner(aggression=real(1.25)),
            budget=Budget(simulations=whole(2), time=real(1e6), failures=whole(9)),
            folder=tmp_path / name,
            terms=Terms(map_size=real(200), map_margin=whole(8), lane_width=real(3.5)),
            workers=whole(1),
            max_in_flight=whole(2),
        )

    search("python", int, float).run()
    search("numpy", np.int64, np.float32).run(np.int64(1))  # type: ignore[arg-type]
    assert search("numpy", np.int64, np.float32).resume().simulations == 2
    assert contents(tmp_path / "numpy") == contents(tmp_path / "python")


@pytest.mark.parametrize("kind", [RandomSearch, Frenetic])
def test_a_campaigns_margin_reaches_a_strategy_without_a_margin(
    tmp_path: Path, kind: type[RandomSearch | Frenetic]
) -> None:
    def search(simulations: int) -> Campaign:
        return scripted(
            tmp_path,
            Budget(simulations=simulations),
            strategy=kind(seed=1),
            terms=Terms(map_margin=40),
        )

    assert search(15).run().invalid == 0
    assert search(30).resume().invalid == 0  # and the log replays

    checked_steps = []

    def check(curvatures: FloatArray, step: float) -> bool:
        checked_steps.append(step)
        return True

    strategy = kind(seed=1, is_valid=check)
    strategy.keep_map_margin(40.0)
    strategy.ask()
    assert len(checked_steps) == 1


def test_the_configuration_records_parts_and_options(tmp_path: Path) -> None:
    class Part(DummyDriver):
        def __init__(self) -> None:
            super().__init__()
            odd = {"table": np.zeros(3), "worst": float("inf"), "lock": threading.Lock()}
            self.options = odd | {"gains": (1, 2.5), "name": "plain"}

    search = campaign(
        tmp_path,
        strategy=Frenetic2021(seed=5, threshold=-0.25),
        simulator=EmbeddedSimulator(friction=0.5),
        driver=Delayed(Part(), seconds=0.2),
    )
    stored = json.loads(json.dumps(search.configuration(), allow_nan=False))
    assert (stored["seed"], stored["strategy"]["options"]["threshold"]) == (5, -0.25)
    assert stored["simulator"]["options"]["vehicle"]["friction"] == 0.5
    assert stored["driver"]["options"] == {"seconds": 0.2}
    inner = stored["driver"]["driver"]["options"]
    assert (inner["gains"], inner["name"], inner["worst"]) == ([1, 2.5], "plain", "inf")
    assert "array" in inner["table"]


@pytest.mark.parametrize(
    "part",
    [
        Candidate(3, np.array([0.0, 0.01]), 10.0, Origin("P1", (1,), 1)),
        Road([0.0, 0.01, 0.0], pose=(1.0, 2.0, 3.0), lane_width=5.0),
        EmbeddedSimulator().drive(Road([0.0, 0.0, 0.0]), Planner()).trajectory,
    ],
)
def test_pickled_records_stay_read_only(part: object) -> None:
    unpickled = pickle.loads(pickle.dumps(part))
    for name in ("curvatures", "time", "table"):
        values = getattr(part, name, None)
        if values is not None:
            assert np.array_equal(getattr(unpickled, name), values)
            assert not getattr(unpickled, name).flags.writeable
    assert type(unpickled) is type(part)


class _PythonPlanner(Planner):
    """The planner as a driver in Python."""

    def act(self, observation: Observation) -> Controls:
        return super().act(observation)


@pytest.mark.parametrize(("driver", "is_python"), [(_PythonPlanner(), True), (Planner(), False)])
def test_the_time_in_a_drivers_python_code_is_measured(
    tmp_path: Path, driver: Driver, *, is_python: bool
) -> None:
    summary = Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=driver,
        budget=Budget(simulations=3),
        folder=tmp_path / "c",
    ).run()
    assert (0.0 < summary.driver_seconds < summary.drive_seconds) is is_python


def test_a_driver_that_takes_most_of_the_time_is_named_slow() -> None:
    slow = Summary(drive_seconds=20.0, driver_seconds=19.0)
    assert slow.slow_driver_text() == "Your driver takes 95 % of the time"
    assert Summary(drive_seconds=20.0, driver_seconds=15.0).slow_driver_text() == ""
    assert Summary().slow_driver_text() == ""


def test_a_snapshot_of_a_summary_refuses_more_results() -> None:
    candidate = Candidate(1, np.array([0.0, 0.01]), 10.0, Origin("random"))
    summary, passed = Summary(), Result(Outcome.PASS, "", 1.5)
    summary.add(candidate, passed)
    with pytest.raises(RuntimeError, match="add to the original"):
        summary.snapshot(1.0).add(candidate, passed)
    summary.add(candidate, passed)
    assert (summary.tests, summary.roads, summary.repeats) == (2, 1, 1)
