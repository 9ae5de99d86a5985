"""Reruns of a campaign: same drives, changed outcomes, interruptions and damage."""

from __future__ import annotations

import json
import signal
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from events import on_result
from repeats import Counting, driven_in, failures_in, recorded

from frenetic.analysis.failures import Failure
from frenetic.campaign import Budget, Campaign, CampaignStore, Event, RoadTester, Summary, Test
from frenetic.campaign.check import check_campaign
from frenetic.campaign.database import DATABASE
from frenetic.drivers import Driver, Planner
from frenetic.errors import CampaignError, FreneticError, Trouble
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.rerun.campaigns import FOLDER, DrivingPlan, driving_campaign
from frenetic.rerun.rerun import drive_tests, rerun, rerun_with
from frenetic.rerun.reruns import Rerun, in_other_simulators, own_repeats, read_reruns, rerun_name
from frenetic.rerun.stability import Change
from frenetic.rerun.variations import Variation
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.segments.segment import segment_of
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Vehicle
from frenetic.simulators.conditions import Conditions
from frenetic.simulators.simulator import Simulator
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["searched_campaign"]


def rerun_tests(
    folder: Path,
    tests: Sequence[Test] | None = None,
    conditions: Sequence[Conditions] = ({},),
    *,
    simulator: Simulator | None = None,
    driver: Driver | None = None,
    **options: Any,
) -> Rerun:
    with CampaignStore.open(folder) as store:
        parts = simulator or EmbeddedSimulator(), driver or Planner()
        tester = RoadTester(*parts, store.setting.terms)
    tests = driven_in(folder)[:6] if tests is None else tests
    ids = [test.id for test in tests]
    return drive_tests(folder, tester, ids, conditions, options=options)  # type: ignore[arg-type]


def results_of(run: Rerun) -> list[Any]:
    return [(drive.recorded.id, drive.conditions, drive.test.result) for drive in run.drives]


def folders(campaign: Path) -> set[Path]:
    return {place.parent for place in (campaign / FOLDER).glob(f"*/{DATABASE}")}


class Icy(DummySimulator):
    """Simulator whose car leaves its lane if friction is below 0.9, farther with less friction."""

    def __init__(self) -> None:
        super().__init__(lambda road: 0.0 if self.friction >= 0.9 else 4.0 + 1.0 - self.friction)
        self.friction = 1.0


class Unreliable(DummySimulator):
    """Simulator that breaks unless `works` is true."""

    works = False

    def drive(self, road: Road, driver: Driver) -> Drive:
        drive = super().drive(road, driver)
        return (
            drive if Unreliable.works else replace(drive, trouble=Trouble("no connection \ud800"))
        )


def in_other_car(folder: Path) -> Rerun:
    car = Vehicle(mass=1500.0, yaw_inertia=2500.0, front_axle=1.4, rear_axle=1.3, width=1.85)
    return rerun(folder, EmbeddedSimulator(vehicle=car, friction=0.9), Planner())


# Drives


@pytest.mark.parametrize("workers", [1, 2])
def test_a_rerun_gives_the_same_results_bit_for_bit(campaign: Path, workers: int) -> None:
    tests = driven_in(campaign)
    run = rerun_tests(campaign, tests, workers=workers)
    assert [drive.recorded.id for drive in run.drives] == [test.id for test in tests]
    assert len(tests) == run.planned == 60
    for drive, test in zip(run.drives, tests, strict=True):
        assert drive.test.result == test.result, "outcome, MOOBD and departure among them"
        assert drive.test.pose == test.pose
        assert drive.is_same
    failed = [drive for drive in run.drives if drive.outcome is Outcome.FAIL]
    assert {drive.difference for drive in failed} == {0.0}


def test_the_conditions_reach_workers(campaign: Path) -> None:
    slippery = [{"friction": 0.5, "noise": 0.3, "noise_seed": seed} for seed in (4, 5)]
    here = rerun_tests(campaign, None, slippery)
    assert results_of(here) == results_of(
        rerun_tests(campaign, None, slippery, workers=2, out=campaign / "two")
    )
    assert [drive.conditions for drive in here.drives] == slippery * 6
    assert [drive.test.candidate.repeat for drive in here.drives] == [0, 1] * 6
    moobds = {drive.moobd for drive in (*here.drives, *rerun_tests(campaign).drives)}
    assert len(moobds) == 18, "each drive has its own errors"


def test_only_roads_that_were_driven_are_driven_again(campaign: Path) -> None:
    refused = replace(recorded(Outcome.INVALID, None, id=1000), result_number=61)
    with CampaignStore.open(campaign, readonly=False) as store:
        store.add_candidate(refused.candidate)
        store.add_result(refused)
    with pytest.raises(CampaignError, match="test 1000 is INVALID: only a road that was driven"):
        rerun_tests(campaign, [*driven_in(campaign)[:1], refused])
    assert rerun_tests(campaign, []).drives == []
    assert not (campaign / FOLDER).exists(), "without tests there is no folder"


# Changes


@pytest.mark.parametrize(
    ("simulator", "driver", "change"),
    [
        (EmbeddedSimulator(), Planner(), "fails again"),
        (EmbeddedSimulator(rules=Rules(speed_limit=25.0)), Planner(), "passes now"),
        (EmbeddedSimulator(), Planner(aggression=0.5), "passes now"),
    ],
)
def test_a_rerun_drives_all_failures_by_default(
    campaign: Path, simulator: Simulator, driver: Driver, change: str
) -> None:
    result = rerun(campaign, simulator, driver)
    assert [test.id for test in result.tests] == [test.id for test in failures_in(campaign)]
    assert {str(test.change) for test in result.tests} == {change}
    assert result.passed is (change == "passes now")
    assert result.rules == simulator.rules
    assert result.same == (len(result.tests) if change == "fails again" else 0)


def test_drives_with_a_broken_simulator_are_not_judged(campaign: Path) -> None:
    tests = [test.id for test in driven_in(campaign)]
    result = rerun(campaign, Unreliable(), DummyDriver(), tests=tests)
    assert result.count(Change.NOT_JUDGED) == len(result.tests) == 60
    assert {drive.reason for drive in result.drives} == {"no connection \\ud800"}


def test_a_driving_campaign_without_a_source_campaign_needs_a_folder(tmp_path: Path) -> None:
    plan = DrivingPlan(RandomSearch(seed=1), Budget(simulations=1), identity="x", purpose={})
    tester = RoadTester(DummySimulator(), DummyDriver())
    with pytest.raises(ValueError, match="give a source campaign, or out"):
        driving_campaign(None, plan, tester, {})
    assert driving_campaign(None, plan, tester, {"out": tmp_path / "a"}).folder == tmp_path / "a"


def test_the_same_failure_has_the_same_place_side_and_mechanism(campaign: Path) -> None:
    result = rerun(campaign, EmbeddedSimulator(friction=0.99), Planner())
    for repeat in result.drives:
        vectors, places = [], []
        for test in (repeat.recorded, repeat.test):
            with CampaignStore.open(campaign) as store:
                drive = store.test(test.id).drive if test is repeat.recorded else test.drive
            assert drive is not None
            verdict = judge(test.road, drive)
            assert verdict.departure is not None
            failure = Failure.of_judged(verdict, segment_of(test.road, drive, verdict.departure))
            assert failure is not None
            vectors.append(failure.vector())
            places.append(verdict.departure)
        is_same = (
            abs(places[0].distance - places[1].distance) <= 30.0
            and places[0].side == places[1].side
            and float(np.linalg.norm(vectors[0] - vectors[1])) <= 2.0
        )
        assert repeat.is_alike is is_same
    document: Any = result.as_json()
    assert 0 < document["matches"]["same failure"] < len(result.tests)
    assert sum(document["matches"].values()) == document["changes"]["fails again"]


def test_a_failure_by_friction_repeats_in_that_share_of_the_range(
    campaign: Path,
) -> None:
    # A quarter of 0.8 to 1.2 is below 0.9, and draws are even: exactly 5 of 20 fail.
    ranges = [Variation("friction", 0.8, 1.2), Variation("speed", 50.0, 90.0)]
    tests = rerun(campaign, Icy(), DummyDriver(), times=20, vary=ranges).tests
    for test in tests:
        assert (test.failed, test.judged) == (5, 20)
        for drive in test.drives:
            assert (drive.outcome is Outcome.FAIL) == (drive.conditions["friction"] < 0.9)


# Stored reruns


def test_a_stored_rerun_equals_the_returned_one(campaign: Path, tmp_path: Path) -> None:
    ranges = [Variation("friction", 0.6, 1.0), Variation("noise", 0.1, 0.2)]
    simulator = EmbeddedSimulator(friction=0.95)
    result = rerun(campaign, simulator, Planner(), times=10, vary=ranges, seed=8)
    (stored,) = read_reruns(campaign)
    document: Any = stored.as_json()
    assert document == result.as_json() == json.loads(json.dumps(document))
    assert (document["missing"], len(document["variations"])) == (0, 2)
    assert document["driver"]["class"].endswith(":Planner")
    assert document["simulator"]["options"]["vehicle"]["friction"] == 0.95
    for stored_drive, drive in zip(stored.drives, result.drives, strict=True):
        here, there = stored_drive.test.trajectory, drive.test.trajectory
        assert here is not None
        assert there is not None
        assert (here.to_rows() == there.to_rows()).all()
    assert read_reruns(tmp_path) == []


def test_own_repeats_are_the_most_informative_repeats_with_the_campaigns_parts(
    campaign: Path,
) -> None:
    first, second, *_ = (test.id for test in failures_in(campaign))

    def drive(*ids: int, times: int, delay: float | None = None, **options: Any) -> None:
        vary = [] if delay is None else [Variation("delay", 0.0, delay)]
        simulator = EmbeddedSimulator(rules=options.pop("rules", Rules()))
        driver = Planner(**options)
        rerun(campaign, simulator, driver, tests=ids, times=times, vary=vary)

    drive(first, second, times=2)
    drive(second, second, times=3, delay=0.1)
    drive(second, times=4, delay=0.2)
    drive(second, times=5, delay=0.1)
    drive(second, times=6)
    drive(second, times=7, delay=0.1, aggression=0.1)
    drive(second, times=8, delay=0.1, rules=Rules(speed_limit=50.0))
    reruns = read_reruns(campaign)
    drives = sorted(len(test.drives) for stored in reruns for test in stored.tests)
    assert drives == [2, 2, 3, 4, 5, 6, 7, 8]
    repeats = own_repeats(reruns)
    assert {test.id: len(test.drives) for test in repeats} == {first: 2, second: 5}


def elsewhere(campaign: Path) -> list[Rerun]:
    with CampaignStore.open(campaign) as store:
        return in_other_simulators(read_reruns(campaign), store.config)


def test_reruns_in_another_simulator_are_merged(campaign: Path) -> None:
    ids = [test.id for test in failures_in(campaign)]
    rerun(campaign, EmbeddedSimulator(), Planner())
    assert elsewhere(campaign) == [], "the rerun used the campaign's simulator"
    first = in_other_car(campaign)
    for chosen in (ids[2:], ids[:1]):
        rerun(campaign, EmbeddedSimulator(friction=0.9), Planner(), tests=chosen)
    other_car, merged = elsewhere(campaign)
    assert (other_car.key, other_car.as_json()) == (first.key, first.as_json())
    assert [test.id for test in merged.tests] == [*ids[2:], ids[0]]
    assert merged.missing == 0


# Folders


def test_a_rerun_is_named_after_its_simulator_and_conditions(tmp_path: Path) -> None:
    noisy = Terms(conditions={"noise": 0.1})
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        terms=noisy,
        budget=Budget(simulations=1),
        folder=tmp_path,
    ).run()
    with CampaignStore.open(tmp_path) as store:
        config, (test,) = store.config, store.tests()
    icy = Terms(conditions={"friction": 0.5})
    for terms, words in (
        (noisy, ""),
        (icy, " with friction 0.5"),
        (Terms(), " in the usual conditions"),
    ):
        tester = RoadTester(EmbeddedSimulator(friction=0.8), Planner(), terms)
        run = rerun_with(tmp_path, tester, tests=[test.id])
        assert rerun_name(run, config) == f"embedded,friction=0.8{words}"


def test_each_rerun_has_its_own_folder_and_is_driven_once(campaign: Path) -> None:
    tests, default, icy = driven_in(campaign), Counting(), Counting(friction=0.9)
    slow = Counting(rules=Rules(speed_limit=60.0))
    calls: list[Callable[[], Rerun]] = [
        lambda: rerun_tests(campaign, simulator=default),
        lambda: rerun_tests(campaign, simulator=default, driver=Planner(aggression=0.9)),
        lambda: rerun_tests(campaign, simulator=icy),
        lambda: rerun_tests(campaign, simulator=slow),
        lambda: rerun_tests(campaign, tests[:3], simulator=default),
        lambda: rerun_tests(campaign, tests[:3], [{"friction": 0.9}], simulator=default),
        lambda: rerun_tests(campaign, tests[:3], [{}, {}], simulator=default),
    ]
    runs = []
    for number, call in enumerate(calls, start=1):
        runs.append(call())
        assert len(folders(campaign)) == number
        assert len(runs[-1].drives) == runs[-1].planned
    driven = [simulator.driven for simulator in (default, icy, slow)]
    assert driven == [24, 6, 6]
    events: list[Event] = []
    for call, run in zip(calls, runs, strict=True):
        repeated = call()
        assert results_of(repeated) == results_of(run)
        assert repeated.folder == run.folder
    rerun_tests(campaign, simulator=default, workers=2, on_event=events.append)
    kinds = [event.kind for event in events]
    assert kinds == ["complete"], "a complete rerun starts no simulator"
    assert [simulator.driven for simulator in (default, icy, slow)] == driven
    assert len(folders(campaign)) == len(calls)
    assert len(read_reruns(campaign)) == len(calls)


def test_a_folder_of_another_campaign_is_refused(campaign: Path, tmp_path: Path) -> None:
    out, other = tmp_path / "out", tmp_path / "other"
    run = rerun_tests(campaign, out=out)
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=8),
        folder=other,
    ).run()
    for options in (
        {"out": campaign},
        {"out": other},
        {"out": out, "driver": Planner(aggression=0.9)},
    ):
        with pytest.raises(CampaignError, match=r"holds another campaign: choose another place"):
            rerun_tests(campaign, **options)
    assert results_of(rerun_tests(campaign, out=out)) == results_of(run)


# Interrupted


class CallbackError(Exception):
    """Error of a callback."""


def press_ctrl_c() -> None:
    signal.raise_signal(signal.SIGINT)


def raise_error() -> None:
    raise CallbackError


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("stop", [press_ctrl_c, raise_error])
def test_the_same_call_resumes_an_interrupted_rerun_with_the_same_results(
    campaign: Path, stop: Callable[[], None], workers: int
) -> None:
    conditions = [{}, {"friction": 0.8}, {"friction": 0.9}, {"noise": 0.1}]
    whole = rerun_tests(campaign, None, conditions, out=campaign / "whole")
    reports: list[tuple[int, int]] = []

    def interrupt(now: Summary) -> None:
        reports.append((now.simulations, now.failed))
        if now.simulations in (3, 12):
            stop()

    drive_counts = []
    for _ in range(2):
        with suppress(CallbackError):
            rerun_tests(campaign, None, conditions, workers=workers, on_event=on_result(interrupt))
        (run,) = read_reruns(campaign)
        assert run.planned == 24
        drive_counts.append(len(run.drives))
    result = rerun_tests(campaign, None, conditions, workers=workers, on_event=on_result(interrupt))
    # The roads that are driven side by side are finished.
    assert 3 <= drive_counts[0] < 24
    assert 12 <= drive_counts[1] <= 24
    if workers == 1:
        assert drive_counts[1] < 24
        assert reports[-1] == (24, sum(drive.outcome is Outcome.FAIL for drive in whole.drives))
    assert results_of(result) == results_of(whole)
    assert [drives for drives, _ in reports] == sorted({drives for drives, _ in reports}), (
        "each number of drives is reported once"
    )
    assert not check_campaign(result.folder or campaign).findings


def test_a_rerun_goes_on_after_its_campaign_was_moved(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    conditions = [{}, {"friction": 0.9}]
    with suppress(CallbackError):
        rerun_tests(campaign, None, conditions, on_event=on_result(lambda _: raise_error()))
    (interrupted,) = read_reruns(campaign)
    campaign.rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path)
    reports: list[int] = []
    report = on_result(lambda now: reports.append(now.simulations))
    run = rerun_tests(Path("moved"), None, conditions, on_event=report)
    assert len(folders(Path("moved"))) == 1
    assert reports == list(range(len(interrupted.drives) + 1, 13)) != []
    assert all(drive.is_same for drive in run.drives if not drive.conditions)


def test_interrupted_reruns_are_read_before_complete_ones(campaign: Path) -> None:
    complete = rerun_tests(campaign, [*driven_in(campaign)[:2]])
    conditions = [{}, {"friction": 0.9}]
    with suppress(CallbackError):
        rerun_tests(campaign, None, conditions, on_event=on_result(lambda _: raise_error()))
    later = rerun_tests(campaign, [*driven_in(campaign)[:1]])
    interrupted, *rest = read_reruns(campaign)
    assert 1 <= len(interrupted.drives) < interrupted.planned == 12
    assert [run.folder for run in rest] == [complete.folder, later.folder]


# Damage


def spoil(folder: Path, change: str) -> None:
    with closing(sqlite3.connect(folder / DATABASE)) as connection, connection:
        connection.execute(change)


@pytest.mark.parametrize(
    ("change", "is_own", "words"),
    [
        ("UPDATE test SET outcome = 'MAYBE' WHERE id = 2", True, "damaged"),
        ("DELETE FROM test WHERE outcome = 'FAIL'", False, "holds no test of candidate"),
    ],
)
def test_a_damaged_rerun_is_an_error_in_one_line(
    campaign: Path, change: str, is_own: bool, words: str
) -> None:
    """The rerun is damaged, or a test of the campaign is missing."""
    failing = failures_in(campaign)
    run = rerun_tests(campaign, failing)
    assert run.folder is not None
    place = run.folder if is_own else campaign
    spoil(place, change)
    for read in (lambda: read_reruns(campaign), lambda: rerun_tests(campaign, failing)):
        with pytest.raises(CampaignError, match=words) as caught:
            read()
        assert str(place) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "option", [{"instead": "friction"}, {"tests": 5}, {"vary": Variation("friction", 0.8, 1.0)}]
)
def test_a_single_value_in_place_of_a_list_is_refused(
    campaign: Path, option: dict[str, Any]
) -> None:
    (name,) = option
    with pytest.raises(FreneticError, match=f"{name} is .*: a list of .* is needed"):
        rerun(campaign, EmbeddedSimulator(), Planner(), **option)
