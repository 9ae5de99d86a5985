from __future__ import annotations

import json
import pickle
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contents import contents
from events import on_result

from frenetic._support.arrays import FloatArray
from frenetic.again.conditions import Variation
from frenetic.again.rerun import read_reruns, rerun
from frenetic.campaign import Budget, Campaign, CampaignStore, Summary, new_folder
from frenetic.campaign import campaign as campaign_module
from frenetic.campaign.asking import ObservingStrategy
from frenetic.campaign.check import check_campaign
from frenetic.campaign.record import Attempt
from frenetic.drivers import Delayed, Planner
from frenetic.errors import CampaignError, StrategyError
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.search import Candidate, Frenetic, Frenetic2021, Origin, RandomSearch, SearchEnded
from frenetic.search.strategy import Strategy
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.testing import DummyDriver, DummySimulator


class Scripted(Strategy):
    """Asks for the given roads, over and over."""

    def __init__(self, *roads: list[float]) -> None:
        self.roads = roads
        self.asked = 0
        self.told: list[tuple[int, Outcome, float]] = []

    def ask(self) -> Candidate:
        self.asked += 1
        values = self.roads[(self.asked - 1) % len(self.roads)]
        return Candidate(self.asked, np.array(values), 10.0, Origin("scripted"))

    def tell(self, evaluation):  # type: ignore[no-untyped-def]
        self.told.append(
            (evaluation.candidate.id, evaluation.outcome, round(evaluation.budget_spent, 6))
        )


STRAIGHT = [0.0] * 8
BENT = [0.0, 0.02, 0.03, 0.02, 0.0, 0.0, 0.0, 0.0]
LOOP = [0.07] * 14


def fails_when_bent(road) -> float:  # type: ignore[no-untyped-def]
    return 4.0 if abs(road.curvatures).max() > 0.01 else 0.0


def campaign(folder: Path, strategy, budget: Budget, **options) -> Campaign:  # type: ignore[no-untyped-def]
    return Campaign(
        strategy=strategy,
        simulator=options.pop("simulator", DummySimulator(fails_when_bent)),
        driver=DummyDriver(),
        budget=budget,
        folder=folder,
        **options,
    )


def test_tests_are_stored_told_and_counted_in_order(tmp_path: Path) -> None:
    strategy = Scripted(STRAIGHT, LOOP, BENT)
    seen: list[Summary] = []
    summary = campaign(tmp_path / "c", strategy, Budget(simulations=4)).run(
        on_event=on_result(seen.append)
    )

    outcomes = [Outcome.PASS, Outcome.INVALID, Outcome.FAIL, Outcome.PASS, Outcome.INVALID]
    outcomes += [Outcome.FAIL]
    shares = [0.25, 0.25, 0.5, 0.75, 0.75, 1.0]
    assert strategy.told == [
        (i + 1, outcome, share)
        for i, (outcome, share) in enumerate(zip(outcomes, shares, strict=True))
    ]
    assert (summary.simulations, summary.passed, summary.failed, summary.invalid) == (4, 2, 2, 2)
    assert not summary.interrupted
    assert [p.tests for p in seen] == [1, 2, 3, 4, 5, 6]
    with CampaignStore.open(tmp_path / "c") as store:
        tests = list(store.tests(with_trajectory=True))
    assert [test.outcome for test in tests] == outcomes
    assert [test.told for test in tests] == [1, 2, 3, 4, 5, 6]
    assert [test.drive is not None for test in tests] == [True, False, True, True, False, True]
    assert summary.min_moobd == min(test.moobd for test in tests if test.moobd is not None)


def test_budget_of_failures_ends_with_the_last_one_wanted(tmp_path: Path) -> None:
    strategy = Scripted(STRAIGHT, BENT)
    summary = campaign(tmp_path, strategy, Budget(failures=3, simulations=100)).run()
    assert (summary.failed, summary.simulations) == (3, 6)


class Listed(Scripted):
    """Proposes each road once."""

    def ask(self) -> Candidate:
        if self.asked == len(self.roads):
            raise SearchEnded("the list is worked through")
        return super().ask()


@pytest.mark.parametrize("options", [{}, {"ordered": True}, {"workers": 2}])
def test_a_strategy_that_ends_the_search(tmp_path: Path, options: dict[str, int]) -> None:
    strategy = Listed(STRAIGHT, LOOP, BENT)
    summary = campaign(tmp_path, strategy, Budget(simulations=100), **options).run()
    assert (summary.simulations, summary.invalid, summary.interrupted) == (2, 1, False)
    assert summary.ended == "the list is worked through"
    assert len(strategy.told) == 3
    with CampaignStore.open(tmp_path) as store:
        assert store.facts["ended"] == summary.ended
        assert "finished_at" in store.facts
        assert store.facts["strategy_seconds"] >= 0.0  # type: ignore[operator]
    assert check_campaign(tmp_path).findings == ()
    longer = Listed(STRAIGHT, LOOP, BENT, STRAIGHT)
    assert campaign(tmp_path, longer, Budget(simulations=3), **options).resume().simulations == 3
    with CampaignStore.open(tmp_path) as store:
        assert store.facts["ended"] == ""


def test_a_strategy_that_ends_sooner_when_resumed_is_noticed(tmp_path: Path) -> None:
    campaign(tmp_path, Listed(STRAIGHT, BENT), Budget(simulations=2)).run()
    with pytest.raises(CampaignError, match="proposes another road as candidate 2"):
        campaign(tmp_path, Listed(STRAIGHT), Budget(simulations=3)).resume()


def test_budget_of_time_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr("frenetic.campaign.campaign.time.perf_counter", lambda: next(clock))
    summary = campaign(tmp_path, Scripted(STRAIGHT), Budget(time=20.0)).run()
    assert 1 <= summary.simulations <= 20


def test_the_time_for_compiling_is_not_the_budgets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    monkeypatch.setattr(campaign_module, "compile_kernels", lambda: order.append("compiled"))
    search = campaign(tmp_path, Scripted(STRAIGHT), Budget(time=60.0, failures=1))
    search.run(1, on_event=lambda event: order.append(event.kind))
    assert order[:2] == ["compiled", "started"]


def test_campaign_of_errors_gives_up_and_keeps_what_it_has(tmp_path: Path) -> None:
    class Broken(DummySimulator):
        def drive(self, road, driver):  # type: ignore[no-untyped-def]
            drive = super().drive(road, driver)
            return type(drive)(drive.trajectory, drive.car, drive.rules, "no licence")

    with pytest.raises(CampaignError, match=r"last 10 drives broke.*no licence"):
        campaign(tmp_path, Scripted(STRAIGHT), Budget(simulations=99), simulator=Broken()).run()
    with CampaignStore.open(tmp_path) as store:
        assert store.counts().by_outcome[Outcome.ERROR] == 10


def test_campaign_that_only_proposes_refused_roads_gives_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.MAX_INVALID_IN_A_ROW", 25)
    with pytest.raises(CampaignError, match=r"last 25 roads were refused.*self-intersecting"):
        campaign(tmp_path, Scripted(LOOP), Budget(simulations=1)).run()


def test_existing_campaign_is_never_touched(tmp_path: Path) -> None:
    campaign(tmp_path, Scripted(STRAIGHT), Budget(simulations=2)).run()
    before = (tmp_path / "campaign.sqlite").read_bytes()
    with pytest.raises(CampaignError, match="already holds a campaign"):
        campaign(tmp_path, Scripted(BENT), Budget(simulations=2)).run()
    assert (tmp_path / "campaign.sqlite").read_bytes() == before


@pytest.mark.parametrize("strategy", [Frenetic, RandomSearch])
def test_same_seed_gives_the_same_database_but_for_times(
    tmp_path: Path, strategy: Callable[..., Frenetic]
) -> None:
    folders = [tmp_path / "first", tmp_path / "second", tmp_path / "other"]
    for folder, seed in zip(folders, (7, 7, 8), strict=True):
        Campaign(
            strategy=strategy(seed=seed),
            simulator=EmbeddedSimulator(),
            driver=Planner(),
            budget=Budget(simulations=60),
            folder=folder,
        ).run()
    first, second, other = (contents(folder) for folder in folders)
    assert len(first["test"]) >= 60
    assert first == second
    assert first["test"] != other["test"]


def test_new_folder_is_new(tmp_path: Path) -> None:
    first = new_folder(tmp_path)
    first.mkdir()
    assert new_folder(tmp_path) != first


class Bad(Scripted):
    """A strategy with a defect of its own."""

    def __init__(self, defect: str) -> None:
        super().__init__(STRAIGHT)
        self.defect = defect

    def ask(self) -> Candidate:
        if self.asked == 3:
            if self.defect == "ask":
                raise KeyError("pool")
            if self.defect == "type":
                return "a road"  # type: ignore[return-value]
            if self.defect == "nan":
                return Candidate(4, np.array([0.0, np.nan]), 10.0, Origin("bad"))
        return super().ask()

    def tell(self, evaluation) -> None:  # type: ignore[no-untyped-def]
        if self.defect == "tell" and self.asked == 4:
            raise RuntimeError("out of\nideas")
        super().tell(evaluation)  # type: ignore[no-untyped-call]


@pytest.mark.parametrize(
    ("defect", "complaint", "kept"),
    [
        ("ask", "the strategy raised KeyError: 'pool'", 3),
        ("type", "the strategy proposed str instead of frenetic.Candidate", 3),
        ("nan", "the strategy proposed candidate 4 with values that are not finite", 3),
        ("tell", "the strategy raised RuntimeError: out of ideas", 4),
    ],
)
def test_strategy_that_breaks_ends_the_campaign_with_one_line(
    tmp_path: Path, defect: str, complaint: str, kept: int
) -> None:
    with pytest.raises(StrategyError, match=complaint):
        campaign(tmp_path, Bad(defect), Budget(simulations=9)).run()
    with CampaignStore.open(tmp_path) as store:
        assert store.counts().told == kept


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"curvatures": np.zeros((3, 3))}, "candidate 1 with curvatures of shape (3, 3)"),
        ({"points": np.zeros(4)}, "candidate 1 with points of shape (4,)"),
        ({"points": np.full((4, 2), np.inf)}, "candidate 1 with values that are not finite"),
        ({"step": -1.0}, "candidate 1 with the step -1.0: a positive number"),
        ({"step": "10"}, "candidate 1 with the step '10': a positive number"),
        ({"id": "1"}, "candidate '1' with this id: a whole number"),
        ({"id": 2**65}, f"candidate {2**65} with this id: a whole number"),
        ({"origin": None}, "candidate 1 with the origin None: a frenetic.Origin"),
        ({"origin": Origin(None)}, "with the operator None: a text"),  # type: ignore[arg-type]
        ({"origin": Origin("a", ("b",))}, "with the parents ('b',): "),  # type: ignore[arg-type]
        ({"origin": Origin("a", (), -1)}, "with the generation -1: a whole number from 0"),
    ],
)
def test_a_malformed_proposal_is_named(
    tmp_path: Path, changed: dict[str, object], complaint: str
) -> None:
    class Malformed(Scripted):
        def ask(self) -> Candidate:
            return replace(super().ask(), **changed)  # type: ignore[arg-type]

    with pytest.raises(CampaignError) as refused:
        campaign(tmp_path, Malformed(STRAIGHT), Budget(simulations=1)).run()
    assert str(refused.value).startswith("the strategy proposed candidate ")
    assert complaint in str(refused.value)
    assert "\n" not in str(refused.value)


class Observing(Scripted, ObservingStrategy):
    """Keeps where the cars ended."""

    def __init__(self, *roads: list[float]) -> None:
        super().__init__(*roads)
        self.seen: list[tuple[int, Outcome, float | None]] = []

    def observe(self, attempt: Attempt) -> None:
        path = attempt.trajectory
        last = None if path is None else float(path.time[-1])
        self.seen.append((len(self.told), attempt.result.outcome, last))


def test_a_strategy_that_observes_sees_each_drive_before_it_is_told(tmp_path: Path) -> None:
    strategy = Observing(STRAIGHT, LOOP, BENT)
    campaign(tmp_path / "c", strategy, Budget(simulations=2)).run()
    assert [seen[:2] for seen in strategy.seen] == [
        (0, Outcome.PASS),
        (1, Outcome.INVALID),
        (2, Outcome.FAIL),
    ]
    assert [seen[2] is not None for seen in strategy.seen] == [True, False, True]
    with pytest.raises(CampaignError, match="observes drives, which are not kept exactly"):
        campaign(tmp_path / "c", Observing(STRAIGHT), Budget(simulations=3)).resume()
    with pytest.raises(ValueError, match="needs one worker"):
        campaign(tmp_path / "d", strategy, Budget(simulations=2), workers=2)


def test_map_sizes_have_to_agree(tmp_path: Path) -> None:
    strategy = RandomSearch(seed=1, map_size=150.0)
    assert campaign(tmp_path, strategy, Budget(failures=1)).tester.map_size == 150.0
    with pytest.raises(ValueError, match="strategy was made for 150"):
        campaign(tmp_path, strategy, Budget(failures=1), map_size=200.0)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("lane_width", 0, "lane_width is 0: 0.1 to 100 m are allowed"),
        ("lane_width", float("nan"), "lane_width is nan: a number of metres"),
        ("lane_width", "4", "lane_width is '4': a number of metres"),
        ("margin", -1.0, "margin is -1: a number of at least 0"),
        ("margin", None, "margin is None: a number of metres"),
        ("map_size", "wide", "map_size is wide, but the strategy was made for 200"),
        ("map_size", True, "map_size is True"),
    ],
)
def test_sizes_are_checked_before_anything_is_written(
    tmp_path: Path, option: str, value: object, words: str
) -> None:
    with pytest.raises(ValueError, match=words) as refused:
        campaign(tmp_path / "c", RandomSearch(seed=1), Budget(simulations=1), **{option: value})
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "c").exists()


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    def search(name: str, whole: Callable[..., Any], real: Callable[..., Any]) -> Campaign:
        return Campaign(
            strategy=RandomSearch(seed=whole(1), map_size=real(200)),
            simulator=EmbeddedSimulator(rules=Rules(speed_limit=whole(60))),
            driver=Planner(aggression=real(1.25)),
            budget=Budget(simulations=whole(2), time=real(1e6), failures=whole(9)),
            folder=tmp_path / name,
            map_size=real(200),
            margin=whole(8),
            lane_width=real(3.5),
            workers=whole(1),
            ordered=True,
            lookahead=whole(2),
        )

    search("python", int, float).run()
    numpy = search("numpy", np.int64, np.float32)
    numpy.run(np.int64(1))  # type: ignore[arg-type]
    search("numpy", np.int64, np.float32).resume()
    assert contents(tmp_path / "numpy") == contents(tmp_path / "python")
    with CampaignStore.open(tmp_path / "numpy") as store:
        assert store.counts().simulations == 2
        driven = [np.int64(test.id) for test in store.tests(Outcome.PASS)][:1]
    found = rerun(
        tmp_path / "numpy",
        numpy.tester.simulator,
        numpy.tester.driver,
        tests=driven,  # type: ignore[arg-type]
        times=np.int64(2),  # type: ignore[arg-type]
        seed=np.int64(3),  # type: ignore[arg-type]
        vary=[Variation("friction", np.float32(0.9), np.float32(1.1))],  # type: ignore[arg-type]
    )
    (kept,) = read_reruns(tmp_path / "numpy")
    assert [test.id for test in kept.tests] == [int(number) for number in driven]
    assert json.loads(json.dumps(found.as_json()))["seed"] == 3


def test_a_count_that_is_no_number_is_named(tmp_path: Path) -> None:
    for value in ("a", None, float("nan")):
        with pytest.raises(ValueError, match=r"^workers is .*: a whole number of at least 1"):
            campaign(tmp_path, Scripted(STRAIGHT), Budget(failures=1), workers=value)


def test_no_computer_has_so_many_workers(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="workers is 1025: at most 1024 are allowed"):
        campaign(tmp_path / "c", Scripted(BENT), Budget(simulations=1), workers=1025)
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("kind", [RandomSearch, Frenetic])
def test_the_margin_reaches_the_check_of_the_strategy(
    tmp_path: Path, kind: type[RandomSearch | Frenetic]
) -> None:
    def searched(simulations: int) -> Campaign:
        budget = Budget(simulations=simulations)
        return campaign(tmp_path / "c", kind(seed=1), budget, margin=40.0)

    assert searched(50).run().invalid == 0
    assert searched(100).resume().invalid == 0  # and the log replays


def test_a_check_of_ones_own_stays() -> None:
    asked = []

    def check(curvatures: FloatArray, step: float) -> bool:
        asked.append(step)
        return True

    for kind in (RandomSearch, Frenetic):
        strategy = kind(seed=1, is_valid=check)
        strategy.keep_margin(40.0)
        strategy.ask()
    assert len(asked) == 2


def test_configuration_says_what_was_run(tmp_path: Path) -> None:
    class Part(DummyDriver):
        def __init__(self) -> None:
            super().__init__()
            self.options = {
                "table": np.zeros(3),
                "worst": float("inf"),
                "lock": threading.Lock(),
                "gains": (1, 2.5),
                "name": "plain",
            }

    configuration = Campaign(
        strategy=Frenetic2021(seed=5, threshold=-0.25, max_redraws=10),
        simulator=EmbeddedSimulator(friction=0.5),
        driver=Delayed(Part(), seconds=0.2),
        budget=Budget(simulations=3),
        folder=tmp_path,
    ).configuration()
    text = json.dumps(configuration, allow_nan=False)
    assert configuration["seed"] == 5
    stored = json.loads(text)
    assert stored["strategy"]["options"]["threshold"] == -0.25
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
def test_records_stay_read_only_when_they_travel_between_processes(part: object) -> None:
    again = pickle.loads(pickle.dumps(part))
    for name in ("curvatures", "time", "table"):
        values = getattr(part, name, None)
        if values is not None:
            assert np.array_equal(getattr(again, name), values)
            assert not getattr(again, name).flags.writeable
    assert type(again) is type(part)
