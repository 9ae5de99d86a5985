"""Estimates of how often a driver fails, checked against drivers that fail with a known chance."""

from __future__ import annotations

import inspect
import math
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from events import on_result

from frenetic import (
    Controls,
    Drive,
    Driver,
    DriveSetup,
    EmbeddedSimulator,
    Observation,
    Planner,
    Road,
)
from frenetic._support.arrays import FloatArray
from frenetic.analysis.statistics import rate_interval
from frenetic.campaign import CampaignStore, Event, RoadTester
from frenetic.campaign.record import Attempt
from frenetic.cli.estimate import estimate as estimate_command
from frenetic.conditions.domain import Domain
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.rerun.estimate import Draws, FailureRate, estimate
from frenetic.road import Verdict
from frenetic.road.classes import RoadClass
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Evaluation
from frenetic.search.strategy import SearchEnded
from frenetic.spec.terms import Terms

if TYPE_CHECKING:
    from command_line import Frenetic
    from interpreters import Interpreter

pytest_plugins = ["command_line", "interpreters"]

ENTRIES: dict[str, Any] = {
    "roads": "urban-50,length=200",
    "conditions": {"friction": {"low": 0.2, "high": 1.0}, "gust": {"low": 0.0, "high": 20.0}},
}
DOMAIN = Domain.from_entries("town", ENTRIES)
TERMS = Terms.of_class(DOMAIN.road_class, domain=DOMAIN)


@dataclass(frozen=True)
class Known(RoadTester):
    """Fails with a known chance: where friction and gust are both far from usual."""

    share: float = 0.1

    def laid(self, candidate: Candidate) -> tuple[Road | None, Verdict]:
        return _ROAD, Verdict(True, "")

    def test(self, candidate: Candidate) -> Attempt:
        conditions = candidate.conditions
        dry, calm = (conditions["friction"] - 0.2) / 0.8, 1.0 - conditions.get("gust", 0.0) / 20.0
        distance = max(dry, calm) - math.sqrt(self.share)
        outcome = Outcome.FAIL if distance < 0.0 else Outcome.PASS
        result = replace(_RESULT, outcome=outcome, moobd=distance)
        return Attempt(candidate.id, result, None, None)


_ROAD = Road([0.0] * 5)
_RESULT = judge(_ROAD, EmbeddedSimulator().drive(_ROAD, Planner()))


def known(share: float) -> Known:
    return Known(EmbeddedSimulator(), Planner(), TERMS, share=share)


def estimate_of(
    tester: RoadTester,
    drives: int,
    seed: int,
    order: Callable[[list[Candidate]], object] = lambda _: None,
) -> FailureRate:
    """Estimate without a campaign; `order` changes the order in which candidates are driven."""
    draws, outstanding, metres = Draws(tester, drives, seed), list[Candidate](), 0.0
    while not draws.is_complete:
        while (candidate := draws.ask()) is not None:
            outstanding.append(candidate)
        order(outstanding)
        while outstanding:
            candidate = outstanding.pop(0)
            result = tester.test(candidate).result
            draws.tell(Evaluation(candidate, result.outcome, result.moobd, 0.0))
            if candidate.id in draws.plain:
                metres += candidate.length
    with pytest.raises(SearchEnded):
        draws.ask()
    return draws.estimate(metres / 1000.0)


def per_1000_km(rate: FailureRate, share: float) -> float:
    """Failures per 1,000 km if this share of all drives fails."""
    return share / rate.length * 1000.0


def test_common_failures_need_plain_drives_only() -> None:
    failure_rate = estimate_of(known(0.2), drives=400, seed=1)
    assert failure_rate.method == "plain"
    assert failure_rate.rate is not None
    assert failure_rate.drives == failure_rate.plain == 400
    assert failure_rate.low < per_1000_km(failure_rate, 0.2) < failure_rate.high
    assert "failures per 1,000 km" in failure_rate.as_text()


@pytest.mark.parametrize("share", [1e-3, pytest.param(1e-5, marks=pytest.mark.heavy)])
def test_rare_failures_need_importance_sampling(share: float) -> None:
    drives, intervals_with_true_rate = 3000, 0
    for seed in range(6):
        failure_rate = estimate_of(known(share), drives=drives, seed=seed)
        assert failure_rate.method == "importance sampling"
        assert failure_rate.drives == drives
        intervals_with_true_rate += (
            failure_rate.low <= per_1000_km(failure_rate, share) <= failure_rate.high
        )
        low, high = rate_interval(round(10 * drives * share), 1.0)
        if share > 1e-4:
            assert failure_rate.high / failure_rate.low < high / low, (
                "ten times as many plain drives"
            )
        else:
            assert failure_rate.high / failure_rate.low < 2.0, "plain drives had no failure"
    assert intervals_with_true_rate >= 5


@dataclass(frozen=True)
class Winding(Known):
    """Fails where the road turns by more than an angle, in any conditions."""

    angle: float = 1.0

    def test(self, candidate: Candidate) -> Attempt:
        distance = self.angle - turn(candidate.curvatures)
        outcome = Outcome.FAIL if distance < 0.0 else Outcome.PASS
        return Attempt(candidate.id, replace(_RESULT, outcome=outcome, moobd=distance), None, None)


def turn(curvatures: FloatArray) -> float:
    return abs(float(curvatures.sum())) * 10.0


@pytest.mark.heavy
def test_where_only_the_road_decides_most_drives_are_plain() -> None:
    rng = np.random.default_rng(5)
    roads = RandomRoads(road_class=DOMAIN.road_class)
    angle = float(np.quantile([turn(roads.draw_once(rng)) for _ in range(50_000)], 1.0 - 3e-3))
    tester = replace(Winding(**vars(known(0.5))), angle=angle)
    intervals_with_true_rate, plain = 0, []
    for seed in range(6):
        failure_rate = estimate_of(tester, drives=6000, seed=seed)
        intervals_with_true_rate += (
            failure_rate.low <= per_1000_km(failure_rate, 3e-3) <= failure_rate.high
        )
        assert failure_rate.drives == 6000
        plain.append(failure_rate.plain / failure_rate.drives)
    assert intervals_with_true_rate >= 5
    assert max(plain) > 0.5


def test_without_failures_the_estimate_is_an_upper_limit() -> None:
    failure_rate = estimate_of(known(0.0), drives=300, seed=1)
    assert failure_rate.rate is None
    assert failure_rate.low == 0.0
    assert "raise --drives" in failure_rate.note
    assert failure_rate.as_text().startswith("fewer than ")
    assert "two-sided" in failure_rate.as_text()
    assert (failure_rate.drives, failure_rate.failures, failure_rate.other_failures) == (300, 0, 0)
    assert failure_rate.high < 3.689 / failure_rate.kilometres * 1000.0, (
        "drives in wider conditions count, too"
    )


@pytest.mark.parametrize("share", [pytest.param(0.0, marks=pytest.mark.heavy), 2e-3])
def test_more_drives_lower_the_upper_limit_even_in_other_conditions(share: float) -> None:
    """Also if only the drives in other conditions failed, and too few of them for an estimate."""
    for seed in range(4):
        few, more = (estimate_of(known(share), drives=n, seed=seed) for n in (200, 1000))
        assert more.high < 0.5 * few.high
        plain_alone = rate_interval(few.failures, few.kilometres / 1000.0)[1]
        assert few.high < plain_alone, "drives in other conditions count, too"


def test_the_same_seed_gives_the_same_estimate_for_any_order_of_results() -> None:
    rng = np.random.default_rng(2)
    tester = known(0.01)
    first, same_seed, other_seed = (estimate_of(tester, 500, seed) for seed in (1, 1, 2))
    assert first == same_seed
    assert first != other_seed
    assert estimate_of(tester, 500, 1, order=rng.shuffle) == first


def test_a_stage_waits_for_the_results_of_the_stage_before() -> None:
    draws = Draws(known(0.01), 100, 1)
    stage = [draws.ask() for _ in range(21)]
    assert None not in stage[:20]
    assert stage[20] is draws.ask() is None
    for candidate in stage[:20]:
        assert candidate is not None
        draws.tell(Evaluation(candidate, Outcome.PASS, 1.0, 0.0))
    assert draws.ask() is not None


def test_a_drive_in_which_the_simulator_broke_is_proposed_again() -> None:
    draws = Draws(known(0.01), 100, 1)
    first, second = draws.ask(), draws.ask()
    assert first is not None
    assert second is not None
    draws.tell(Evaluation(first, Outcome.ERROR, None, 0.0))
    repeat = draws.ask()
    assert repeat is not None
    assert (repeat.id, repeat.repeat, repeat.conditions) == (3, 1, first.conditions)
    assert np.array_equal(repeat.curvatures, first.curvatures)


def test_kilometres_count_only_what_the_car_drove(tmp_path: Path) -> None:
    class Broken:
        def __init__(self, when: float) -> None:
            self.when = when

        def reset(self, setup: DriveSetup) -> None:
            pass

        def act(self, observation: Observation) -> Controls:
            if observation.time >= self.when:
                raise ValueError("lost")
            return Controls(0.0, throttle=0.5)

    soon = RoadTester(EmbeddedSimulator(), Broken(0.5), TERMS)
    failure_rate = estimate(soon, drives=100, seed=1, out=tmp_path / "soon")
    assert failure_rate.failures == failure_rate.plain
    assert 0.0 < failure_rate.length < 0.002, "km that are driven in half a second"
    never = RoadTester(EmbeddedSimulator(), Broken(0.0), TERMS)
    with pytest.raises(FreneticError, match="before the car moved"):
        estimate(never, drives=100, seed=1, out=tmp_path / "never")


def test_an_estimate_uses_the_roads_of_the_terms_not_of_the_domain(tmp_path: Path) -> None:
    """The roads of this search are longer than the domain's roads."""
    longer = RoadClass.of("urban-50", {"length": 600.0})
    terms = Terms(map_size=longer.map_size, road_class=longer, domain=DOMAIN)
    tester = RoadTester(EmbeddedSimulator(), Planner(), terms)
    assert estimate(tester, drives=100, seed=1, out=tmp_path / "c").length > 0.3


def test_a_domain_without_conditions_has_plain_drives(tmp_path: Path) -> None:
    flat = Domain.from_entries("flat", {"roads": "urban-50,length=200"})
    tester = replace(embedded(), terms=replace(TERMS, domain=flat))
    failure_rate = estimate(tester, drives=100, out=tmp_path / "c")
    assert (failure_rate.method, failure_rate.plain, failure_rate.failures) == ("none", 100, 0)


def test_a_domain_without_valid_roads_is_refused_and_leaves_no_folder(
    tmp_path: Path,
) -> None:
    tester = replace(embedded(), terms=replace(TERMS, map_size=50.0))
    with pytest.raises(CampaignError, match=r"^none of 1000 random roads of town is valid"):
        estimate(tester, drives=100, out=tmp_path / "c")
    assert not (tmp_path / "c").exists()


# Estimates as campaigns


def embedded(simulator: EmbeddedSimulator | None = None) -> RoadTester:
    return RoadTester(simulator or EmbeddedSimulator(), Planner(), TERMS)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> FailureRate:
    """The estimate of uninterrupted drives, with one worker."""
    failure_rate = estimate(embedded(), drives=100, out=tmp_path_factory.mktemp("whole") / "c")
    assert failure_rate.method == "importance sampling"
    assert failure_rate.other_failures
    return failure_rate


@pytest.mark.heavy
def test_the_estimate_does_not_depend_on_the_number_of_workers(
    uninterrupted: FailureRate, tmp_path: Path
) -> None:
    counts: list[int] = []
    count = on_result(lambda now: counts.append(now.simulations))
    out = tmp_path / "c"
    assert estimate(embedded(), drives=100, workers=3, out=out, on_event=count) == uninterrupted
    assert counts == list(range(1, 101))
    with CampaignStore.open(out) as store:
        assert store.counts().failed == uninterrupted.failures + uninterrupted.other_failures
        assert store.setting.domain == DOMAIN
    assert FailureRate.read(out) == uninterrupted


@pytest.mark.parametrize(
    "workers",
    [
        pytest.param((1, 1), marks=pytest.mark.heavy),
        (1, 3),
        pytest.param((3, 1), marks=pytest.mark.heavy),
    ],
)
def test_after_ctrl_c_the_same_call_goes_on(
    uninterrupted: FailureRate, tmp_path: Path, workers: tuple[int, int]
) -> None:
    def interrupt(event: Event) -> None:
        if event.kind == "result" and event.summary.simulations == 30:
            signal.raise_signal(signal.SIGINT)

    out = tmp_path / "c"
    first, second = workers
    with pytest.raises(KeyboardInterrupt):
        estimate(embedded(), drives=100, workers=first, out=out, on_event=interrupt)
    assert FailureRate.read(out) is None
    events: list[Event] = []
    assert (
        estimate(embedded(), drives=100, workers=second, out=out, on_event=events.append)
        == uninterrupted
    )
    results = [event for event in events if event.kind == "result"]
    assert 0 < len(results) <= 70


def test_a_complete_estimate_is_read_instead_of_driven_again(
    uninterrupted: FailureRate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def drive(*_: object, **__: object) -> list[Drive]:
        raise AssertionError("nothing may be driven")

    out = tmp_path / "c"
    estimate(embedded(), drives=100, out=out)
    monkeypatch.setattr(EmbeddedSimulator, "drive_compiled", drive)
    for text in (None, "damaged"):
        if text is not None:
            (out / "estimate.json").write_text(text)
        events: list[Event] = []
        assert estimate(embedded(), drives=100, out=out, on_event=events.append) == uninterrupted
        assert [event.kind for event in events] == ["complete"]
    assert FailureRate.read(out) == uninterrupted
    with pytest.raises(CampaignError, match="holds another campaign"):
        estimate(embedded(), drives=101, out=out)


class Breaking(EmbeddedSimulator):
    """Raises from its 25th drive on, as long as it is broken."""

    is_broken = True
    drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        Breaking.drives += 1
        if Breaking.is_broken and Breaking.drives >= 25:
            raise OSError("no graphics")
        return super().drive(road, driver)


def test_after_a_simulator_broke_the_same_call_goes_on(
    uninterrupted: FailureRate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Breaking, "drives", 0)
    out = tmp_path / "c"
    for attempt in range(2):
        with pytest.raises(FreneticError, match=r"simulator broke, .*: no graphics .*; the drives"):
            estimate(embedded(Breaking()), drives=100, out=out)
        with CampaignStore.open(out) as store:
            counts = store.counts()
            assert (counts.passed + counts.failed, counts.errors) == (24, attempt + 1)
    monkeypatch.setattr(Breaking, "is_broken", False)
    assert estimate(embedded(Breaking()), drives=100, out=out) == uninterrupted


def test_library_and_command_drive_as_often_by_default() -> None:
    (option,) = (option for option in estimate_command.params if option.name == "drives")
    assert inspect.signature(estimate).parameters["drives"].default == option.default


def test_estimate_prints_a_rate_that_show_and_report_repeat(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    path = tmp_path / "icy.toml"
    path.write_text(
        'roads = "urban-50,length=200"\n[conditions]\nfriction = { low = 0.1, high = 0.6 }\n',
        encoding="utf-8",
    )
    words = ("estimate", "--odd", str(path), "--drives", "100")
    estimated = frenetic(*words)
    assert estimated.code == 0, estimated.err
    assert "failures per 1,000 km" in estimated.out
    assert frenetic(*words, "--json").json["domain"] == "icy"
    assert frenetic("run", "--odd", str(path), "--simulations", "20", "--out", "c").code == 0
    assert frenetic("estimate", "c", "--drives", "100").code == 0
    assert "how often" in frenetic("show", "c").out
    assert frenetic("report", "c").code == 0
    assert "failures per 1,000 km" in Path("c/report.html").read_text("utf-8")
    Path("c/estimate.json").write_text('{"domain": 3}')
    assert "estimate.json is damaged" in frenetic("show", "c").err
    assert frenetic("estimate").code == 2
    assert frenetic("run", "--simulations", "3", "--out", "d").code == 0
    assert "searched no domain" in frenetic("estimate", "d").err
    with pytest.raises(FreneticError):
        Domain.of(tmp_path / "none.toml")


TOWN = """
roads = "urban-50,length=200"
[conditions]
friction = { low = 0.2, high = 1.0 }
gust = { low = 0.0, high = 20.0 }
"""
KILLED = """
import os, signal
from unittest.mock import patch
from frenetic.cli import main
kill = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
with patch("frenetic.rerun.importance_sampling.WeightedDrives.add", kill):
    main(["estimate", "--odd", "town.toml", "--drives", "100", "--out", "c"])
"""
"""A program that is killed at the end of the first stage."""


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform == "win32", reason="a process kills itself by a POSIX signal")
def test_after_a_kill_the_same_command_goes_on(
    frenetic: Frenetic, interpreter: Interpreter, tmp_path: Path
) -> None:
    (tmp_path / "town.toml").write_text(TOWN, encoding="utf-8")
    assert interpreter.python(KILLED, folder=tmp_path).code == -signal.SIGKILL
    with CampaignStore.open("c") as store:
        assert 0 < store.counts().simulations <= 20
    words = ("estimate", "--odd", "town.toml", "--drives", "100", "--out")
    resumed = frenetic(*words, "c", "--workers", "2", "--json")
    assert resumed.code == 0, resumed.err
    assert resumed.json == frenetic(*words, "whole", "--json").json
    repeated = frenetic(*words, "c")
    assert repeated.out.splitlines()[-1] == "Kept in c; to see it: frenetic report c"
    assert "how often" in frenetic("show", "c").out
    assert frenetic("resume", "c").refuses("c does not search", "'estimate'", "goes on with it")


@pytest.mark.heavy
def test_ctrl_c_prints_the_command_that_goes_on_with_the_drives(
    frenetic: Frenetic, stopping_driver: Callable[[int], str], tmp_path: Path
) -> None:
    (tmp_path / "town.toml").write_text(TOWN, encoding="utf-8")
    words = ("estimate", "--odd", "town.toml", "--driver", stopping_driver(30), "--drives", "100")
    stopped = frenetic(*words)
    (folder,) = Path("campaigns").iterdir()
    assert stopped.code == 130
    left, command = stopped.err.splitlines()[-1].split("; go on: ")
    assert left.startswith("Interrupted: ")
    assert 0 < int(left.split()[1]) <= 70, "drives in progress are finished"
    assert command == f"frenetic {' '.join(words)} --out {folder}"
    stopping_driver(0)
    done = frenetic(*words, "--out", str(folder))
    assert done.code == 0, done.err
    assert done.out.splitlines()[-1] == f"Kept in {folder}; to see it: frenetic report {folder}"
    assert list(Path("campaigns").iterdir()) == [folder]


def test_the_estimate_of_a_campaign_lies_in_its_folder(frenetic: Frenetic, tmp_path: Path) -> None:
    (tmp_path / "town.toml").write_text(TOWN, encoding="utf-8")
    search = ("--odd", "town.toml", "--simulations", "5", "--seed", "1", "--workers", "1")
    assert frenetic("run", *search, "--out", "c").code == 0
    earlier_reruns = set(Path("c").glob("rerun/*"))
    words = ("estimate", "c", "--drives", "100")
    estimated = frenetic(*words)
    (folder,) = set(Path("c/rerun").iterdir()) - earlier_reruns
    assert estimated.out.splitlines()[-1] == f"Kept in {folder}; to see it: frenetic report c"
    assert FailureRate.read(Path("c")) == FailureRate.read(folder) is not None
    assert frenetic(*words, "--workers", "2").out == estimated.out
    assert set(Path("c/rerun").iterdir()) == {folder, *earlier_reruns}
