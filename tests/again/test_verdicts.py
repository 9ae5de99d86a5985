"""What is said of roads that were driven again: shares that are known, what matters, and how."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from repeats import forget_reruns, recorded, redriven

from frenetic.again.conditions import Variation, draw_conditions
from frenetic.again.rerun import Rerun, own_repeats, read_reruns, rerun
from frenetic.again.verdicts import Change, Match, Repeats, Stability
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Controls, Driver, DriveSetup, Noisy, Observation, Planner
from frenetic.errors import FreneticError
from frenetic.oracle import Side
from frenetic.outcome import Outcome
from frenetic.quantities import quantities
from frenetic.road import Road
from frenetic.search import Candidate, Frenetic2021, Origin
from frenetic.search.strategy import Strategy
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Simulator
from frenetic.simulators.worlds import Conditions
from frenetic.testing import DummyDriver, DummySimulator


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with some failures."""
    folder = tmp_path_factory.mktemp("made")
    Campaign(
        strategy=Frenetic2021(seed=3, max_redraws=10),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(failures=6),
        folder=folder,
    ).run()
    return folder


@pytest.fixture
def campaign(made: Path) -> Path:
    """The same without what other tests have kept in it."""
    forget_reruns(made)
    return made


def said_of(one: Rerun) -> list[Any]:
    """A rerun without what depends on who drove it."""
    said: list[Any] = [test.as_json() for test in one.tests]
    for test in said:
        for drive in test["drives"]:
            del drive["seconds"]
    return said


def failures_of(folder: Path) -> list[int]:
    with CampaignStore.open(folder) as store:
        return [record.candidate.id for record in store.tests(Outcome.FAIL, order_by="moobd")]


class Icy(DummySimulator):
    """Its car leaves its lane where friction is below 0.9, the further the less there is."""

    def __init__(self) -> None:
        super().__init__(lambda road: 0.0 if self.friction >= 0.9 else 4.0 + 1.0 - self.friction)
        self.friction = 1.0


# How often


def test_a_deterministic_failure_repeats_every_time(campaign: Path) -> None:
    first = failures_of(campaign)[:1]
    (one,) = rerun(campaign, EmbeddedSimulator(), Planner(), tests=first, times=20).tests
    assert (one.failed, one.judged, one.alike, one.share) == (20, 20, 20, 1.0)
    assert one.stability is Stability.ROBUST
    assert all(drive.moobd == one.recorded.moobd for drive in one.drives)
    assert str(one) == ("fails 20 of 20 (100 %, 95 % interval 84 to 100 %): 20 same failure")


def test_a_failure_that_hangs_on_friction_repeats_in_its_share_of_the_range(
    campaign: Path,
) -> None:
    # Below 0.9 lies a quarter of 0.8 to 1.2, and the draws are even: exactly 5 of 20.
    ranges = [Variation("friction", 0.8, 1.2), Variation("speed", 50.0, 90.0)]
    found = rerun(campaign, Icy(), DummyDriver(), times=20, vary=ranges).tests
    assert [one.id for one in found] == failures_of(campaign)
    for one in found:
        assert (one.failed, one.judged) == (5, 20)
        assert one.stability is Stability.FRAGILE
        for drive in one.drives:
            assert (drive.outcome is Outcome.FAIL) == (drive.conditions["friction"] < 0.9)


class Startled:
    """A planner that lets go of the wheel if it first believes itself left of a place."""

    def __init__(self, place: float) -> None:
        self.place = place
        self.planner = Planner()

    def reset(self, setup: DriveSetup) -> None:
        self.planner.reset(setup)
        self.is_startled: bool | None = None

    def act(self, observation: Observation) -> Controls:
        if self.is_startled is None:
            self.is_startled = observation.lateral_offset > self.place
        if self.is_startled:
            return Controls(0.3, throttle=0.3)
        return self.planner.act(replace(observation, lateral_offset=0.0))


def test_a_marginal_failure_under_seeded_noise_reports_its_share(tmp_path: Path) -> None:
    # The error at the start is normal with a standard deviation of 0.2 m: above 0.1049 m in 30 %.
    driver = Startled(0.2 * 0.5244)
    gentle = Candidates([0.0] * 12)
    Campaign(
        strategy=gentle,
        simulator=EmbeddedSimulator(),
        driver=Noisy(driver, offset=0.2, heading=0.0, seed=0),
        budget=Budget(simulations=1),
        folder=tmp_path,
    ).run()
    (one,) = rerun(
        tmp_path,
        EmbeddedSimulator(),
        driver,
        tests=[1],
        times=150,
        vary=[Variation("noise", 0.2, 0.2)],
    ).tests
    low, high = one.interval
    assert low < 0.3 < high
    assert one.share is not None
    assert abs(one.share - 0.3) < 0.06
    assert one.recorded.outcome is Outcome.PASS
    assert one.stability is None
    assert one.influences == (), "nothing was varied but the seed"


class Candidates(Strategy):
    """Always asks for the same road."""

    def __init__(self, curvatures: list[float]) -> None:
        self.curvatures = curvatures
        self.asked = 0

    def ask(self) -> Candidate:
        self.asked += 1
        return Candidate(self.asked, np.array(self.curvatures), 10.0, Origin("given"))

    def tell(self, evaluation: object) -> None:
        pass


class Flaky(DummySimulator):
    """Fails every third drive, whatever is driven."""

    def __init__(self) -> None:
        super().__init__(lambda road: 5.0 if self.drives % 3 == 0 else 0.0)
        self.drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.drives += 1
        return super().drive(road, driver)


def test_a_simulator_that_is_not_repeatable_is_found_out_without_any_variation(
    campaign: Path,
) -> None:
    (one,) = rerun(
        campaign, Flaky(), DummyDriver(), tests=failures_of(campaign)[:1], times=21
    ).tests
    assert (one.failed, one.judged) == (7, 21)
    assert one.stability is Stability.UNCLEAR


class Broken(DummySimulator):
    """Breaks in two drives of three."""

    def __init__(self) -> None:
        super().__init__()
        self.drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.drives += 1
        if self.drives % 3:
            return Drive(super().drive(road, driver).trajectory, error="no connection \ud800")
        return super().drive(road, driver)


def test_drives_that_broke_count_neither_way(campaign: Path) -> None:
    first = failures_of(campaign)[:1]
    (one,) = rerun(campaign, Broken(), DummyDriver(), tests=first, times=9).tests
    assert (one.count(Outcome.ERROR), one.judged, one.share) == (6, 3, 0.0)
    (none,) = rerun(campaign, Broken(), DummyDriver(), tests=first, times=2).tests
    assert (none.judged, none.share, none.interval) == (0, None, (0.0, 1.0))
    assert none.stability is None
    assert str(none) == "none of 2 drives could be judged"
    assert none.change is Change.NOT_JUDGED
    assert {drive.reason for drive in none.drives} == {"no connection \\ud800"}


# What matters


def of_worlds(worlds: tuple[Conditions, ...], ranges: list[Variation], **outcomes: Any) -> Repeats:
    """A test whose drives fail and pass as a function of the world says."""
    verdict = outcomes["verdict"]
    drives = tuple(
        redriven(world, Outcome.FAIL if (moobd := verdict(world)) < 0.0 else Outcome.PASS, moobd)
        for world in worlds
    )
    return Repeats(recorded(), drives, tuple(ranges))


def test_what_matters_is_named_in_words_and_what_does_not_is_not() -> None:
    ranges = [Variation("friction", 0.8, 1.0), Variation("delay", 0.0, 0.2)]
    worlds = draw_conditions(ranges, 20, 1)
    one = of_worlds(worlds, ranges, verdict=lambda w: w["friction"] - 0.93)
    first, second = one.influences
    assert (first.quantity, first.matters) == ("friction", True)
    assert first.spearman > 0.8
    assert (second.quantity, second.matters) == ("delay", False)
    assert str(one).startswith(
        "fails 13 of 20 (65 %, 95 % interval 43 to 82 %): 13 same place; less friction is"
    )
    assert "delay" not in str(one)


def test_more_of_what_harms_is_worse() -> None:
    ranges = [Variation("noise", 0.0, 0.4)]
    worlds = draw_conditions(ranges, 30, 1)
    one = of_worlds(worlds, ranges, verdict=lambda w: 0.2 - w["noise"])
    (influence,) = one.influences
    assert influence.spearman < -0.8
    assert str(influence).startswith("more noise is worse")


def test_how_far_out_failing_cars_are_does_not_matter() -> None:
    # With less friction a car is slower, so it is less far out when its drive is ended.
    ranges = [Variation("friction", 0.5, 1.0)]
    one = of_worlds(draw_conditions(ranges, 20, 1), ranges, verdict=lambda w: -w["friction"])
    assert one.failed == 20
    assert one.influences == ()


def test_too_few_drives_say_nothing_about_what_matters() -> None:
    ranges = [Variation("friction", 0.5, 1.0)]
    one = of_worlds(draw_conditions(ranges, 7, 1), ranges, verdict=lambda w: w["friction"] - 0.7)
    assert one.influences == ()


def test_p_values_are_corrected_for_the_number_of_quantities() -> None:
    ranges = [Variation("friction", 0.5, 1.0), Variation("delay", 0.0, 0.2)]
    worlds = draw_conditions(ranges, 12, 0)
    verdict = {"verdict": lambda w: w["delay"] - 0.1 + 0.2 * w["friction"]}
    both = {one.quantity: one.p for one in of_worlds(worlds, ranges, **verdict).influences}
    alone = {
        range_.quantity: of_worlds(worlds, [range_], **verdict).influences[0].p for range_ in ranges
    }
    smaller = min(alone, key=lambda name: alone[name])
    assert both[smaller] == pytest.approx(min(1.0, 2.0 * alone[smaller]))


@pytest.mark.parametrize(
    ("failed", "times", "stability"),
    [
        (5, 20, Stability.FRAGILE),
        (6, 20, Stability.UNCLEAR),
        (14, 20, Stability.UNCLEAR),
        (15, 20, Stability.ROBUST),
        (3, 3, Stability.UNCLEAR),
        (4, 4, Stability.ROBUST),
        (0, 4, Stability.FRAGILE),
    ],
)
def test_stability_needs_the_whole_interval_on_one_side(
    failed: int, times: int, stability: Stability
) -> None:
    moobds = iter([-1.0] * failed + [1.0] * (times - failed))
    one = of_worlds(({},) * times, [], verdict=lambda w: next(moobds))
    assert one.stability is stability


@pytest.mark.parametrize(
    ("place", "side", "difference", "match"),
    [
        (129.0, "left", 1.9, Match.SAME),
        (129.0, "left", 2.1, Match.OTHER_MECHANISM),
        (129.0, "right", 1.9, Match.OTHER_SIDE),
        (69.0, "right", 1.9, Match.ELSEWHERE),
        (131.0, "right", 1.9, Match.ELSEWHERE),
        (129.0, "left", None, Match.SAME_PLACE),
        (None, None, 1.9, Match.OTHER_MECHANISM),
    ],
)
def test_kinds_of_failing_are_told_apart(
    place: float | None, side: Side | None, difference: float | None, match: Match
) -> None:
    test = recorded(Outcome.FAIL, -1.0, 100.0, "left")
    drive = redriven({}, Outcome.FAIL, -1.0, place, side, test=test, difference=difference)
    assert drive.match is match
    assert drive.is_alike is (match in (Match.SAME, Match.SAME_PLACE))
    assert replace(drive, test=recorded(Outcome.PASS, 1.0, place, side)).match is None
    assert replace(drive, recorded=recorded(Outcome.PASS, 1.0)).match is None


def test_two_that_fail_within_their_lane_fail_alike() -> None:
    stuck = recorded(Outcome.FAIL, 1.0)
    drive = redriven({}, Outcome.FAIL, 1.0, test=stuck, difference=1.9)
    assert drive.match is Match.SAME


# Worlds


@given(
    st.lists(st.sampled_from(list(quantities())), min_size=1, max_size=6, unique=True),
    st.integers(1, 30),
    st.integers(0, 99),
)
def test_each_range_is_covered_evenly(names: list[str], times: int, seed: int) -> None:
    ranges = [Variation(name, quantities()[name].low, quantities()[name].high) for name in names]
    worlds = draw_conditions(ranges, times, seed)
    assert len(worlds) == times
    for one in ranges:
        values = [world[one.quantity] for world in worlds]
        parts = sorted(
            math.floor((value - one.low) / (one.high - one.low) * times) for value in values
        )
        assert parts == list(range(times))
    assert worlds == draw_conditions(ranges[::-1], times, seed), "the order of the ranges counts"
    for name in quantities().keys() - names:
        assert {world.get(name) for world in worlds} == {None}


def test_another_seed_gives_other_worlds_and_each_world_its_own_noise() -> None:
    ranges = [Variation("noise", 0.2, 0.2)]
    worlds = draw_conditions(ranges, 10, 1)
    assert {world["noise"] for world in worlds} == {0.2}
    assert len({world["noise_seed"] for world in worlds}) == 10
    assert worlds != draw_conditions(ranges, 10, 2)


def test_without_variation_all_worlds_are_the_campaigns() -> None:
    assert draw_conditions([], 3, 0) == ({},) * 3


@pytest.mark.parametrize("times", [0, -1, 2.5, True])
def test_a_number_of_times_that_is_none_is_refused(times: int) -> None:
    with pytest.raises(ValueError, match="times is"):
        draw_conditions([], times, 0)


def test_a_quantity_is_varied_once() -> None:
    with pytest.raises(ValueError, match="speed is varied twice"):
        draw_conditions([Variation("speed", 50.0, 60.0), Variation("speed", 60.0, 70.0)], 3, 0)


@pytest.mark.parametrize(
    ("name", "low", "high", "said"),
    [
        ("mass", 1.0, 2.0, "unknown quantity 'mass'. Known: friction, speed"),
        ("friction", 1.0, 0.8, "friction from 1 to 0.8: a range LOW:HIGH within 0.01 to 1.5"),
        ("speed", 0.0, 50.0, "within 1 to 500 km/h is needed"),
        ("noise", math.nan, 1.0, "cannot vary noise from nan to 1"),
        ("start", -3.0, 0.0, "within -2 to 2 m is needed"),
    ],
)
def test_a_range_that_is_none_is_one_line(name: str, low: float, high: float, said: str) -> None:
    with pytest.raises(FreneticError) as caught:
        Variation(name, low, high)
    assert said in str(caught.value)


def test_usual_ranges_follow_the_simulator() -> None:
    simulator = EmbeddedSimulator(friction=0.5)
    assert Variation.usual("friction", simulator) == Variation("friction", 0.4, 0.5)
    assert Variation.usual("speed", simulator) == Variation("speed", 63.0, 77.0)
    for name in quantities():
        assert not Variation.usual(name, simulator).is_fixed
    with pytest.raises(FreneticError, match="DummySimulator cannot vary friction"):
        Variation.usual("friction", DummySimulator())
    with pytest.raises(FreneticError, match="unknown quantity 'grip'"):
        Variation.usual("grip", simulator)


def test_a_simulator_that_cannot_is_refused_before_anything_is_driven(campaign: Path) -> None:
    with pytest.raises(FreneticError, match="DummySimulator cannot vary start"):
        rerun(campaign, DummySimulator(), DummyDriver(), vary=[Variation("start", 0.0, 0.1)])
    assert read_reruns(campaign) == []


# What is kept


def test_the_same_seed_gives_the_same_drives_whoever_drives(campaign: Path) -> None:
    ranges = [Variation("friction", 0.7, 1.0), Variation("noise", 0.0, 0.3)]
    kept = []
    for workers in (1, 2):
        rerun(
            campaign,
            EmbeddedSimulator(),
            Planner(),
            times=6,
            vary=ranges,
            seed=4,
            workers=workers,
        )
        kept.append([said_of(one) for one in read_reruns(campaign)])
        forget_reruns(campaign)
    assert kept[0] == kept[1] != []


def test_the_most_telling_repeats_of_each_test_with_the_own_parts_count(
    campaign: Path,
) -> None:
    first, second, *_ = failures_of(campaign)

    def again(*ids: int, times: int, delay: float | None = None, aggression: float = 1.0) -> None:
        rerun(
            campaign,
            EmbeddedSimulator(),
            Planner(aggression=aggression),
            tests=ids,
            times=times,
            vary=[] if delay is None else [Variation("delay", 0.0, delay)],
        )

    again(first, second, times=2)
    again(second, second, times=3, delay=0.1)
    again(second, times=4, delay=0.2)
    again(second, times=5, delay=0.1)
    again(second, times=6)
    again(second, times=7, delay=0.1, aggression=0.1)
    kept = read_reruns(campaign)
    assert sorted(len(test.drives) for one in kept for test in one.tests) == [2, 2, 3, 4, 5, 6, 7]
    with CampaignStore.open(campaign) as store:
        config, rules = store.config, store.setting.rules
    own = own_repeats(kept, config, rules)
    assert {one.id: len(one.drives) for one in own} == {first: 2, second: 5}
    assert own_repeats(kept, {**config, "simulator": {"class": "another"}}, rules) == []


def test_other_rules_are_another_rerun_and_not_the_campaigns(campaign: Path) -> None:
    first, *_ = failures_of(campaign)
    for limit in (70.0, 50.0):
        simulator = EmbeddedSimulator(rules=Rules(speed_limit=limit))
        rerun(campaign, simulator, Planner(), tests=[first], times=2)
    fast, slow = kept = read_reruns(campaign)
    assert fast.tests[0].failed > slow.tests[0].failed
    with CampaignStore.open(campaign) as store:
        assert own_repeats(kept, store.config, store.setting.rules) == list(fast.tests)


def test_a_test_that_passed_is_neither_robust_nor_fragile(campaign: Path) -> None:
    with CampaignStore.open(campaign) as store:
        passed = next(iter(store.tests(Outcome.PASS))).candidate.id
    (one,) = rerun(campaign, EmbeddedSimulator(), Planner(), tests=[passed], times=10).tests
    assert one.failed == 0
    assert one.stability is None
    assert one.as_json()["stability"] is None
    assert one.change is Change.PASSES_AGAIN


def test_it_is_said_how_many_have_the_same_failure() -> None:
    test = recorded(Outcome.FAIL, -1.0, 50.0, "left")
    here, there, otherwise = (
        redriven({}, Outcome.FAIL, -1.0, place, "left", test=test, difference=difference)
        for place, difference in ((50.0, 0.5), (90.0, 0.5), (50.0, 9.0))
    )
    one = Repeats(test, (here, there, there, otherwise))
    assert str(one) == (
        "fails 4 of 4 (100 %, 95 % interval 51 to 100 %): 1 same failure, 1 other mechanism,"
        " 2 elsewhere"
    )
    document = one.as_json()
    assert document["matches"] == {
        "same failure": 1,
        "other mechanism": 1,
        "other side": 0,
        "elsewhere": 2,
        "same place": 0,
    }
    assert [drive["match"] for drive in document["drives"]] == [  # type: ignore[index,call-overload,union-attr]
        "same failure",
        "elsewhere",
        "elsewhere",
        "other mechanism",
    ]


def test_what_is_written_is_read_again(campaign: Path, tmp_path: Path) -> None:
    ranges = [Variation("friction", 0.6, 1.0), Variation("noise", 0.1, 0.2)]
    found = rerun(campaign, EmbeddedSimulator(), Planner(), times=10, vary=ranges, seed=8)
    (kept,) = read_reruns(campaign)
    assert kept.as_json() == found.as_json()
    document = json.loads(json.dumps(found.as_json()))
    assert (document["seed"], document["missing"], len(document["variations"])) == (8, 0, 2)
    for one, said in zip(found.tests, document["tests"], strict=True):
        assert said["failed"] == one.failed
        assert said["interval"] == list(one.interval)
        assert said["stability"] == one.stability
    assert read_reruns(tmp_path) == []


def test_the_parts_are_recorded(campaign: Path) -> None:
    simulator: Simulator = EmbeddedSimulator(friction=0.95)
    rerun(campaign, simulator, Planner(), tests=failures_of(campaign)[:1], times=1)
    (kept,) = read_reruns(campaign)
    assert str(kept.driver["class"]).endswith(":Planner")
    assert kept.simulator["options"]["vehicle"]["friction"] == 0.95  # type: ignore[index,call-overload]


@pytest.mark.parametrize("seed", [-1, 1.5, "a", None, 2**63])
def test_a_seed_is_a_whole_number(seed: Any) -> None:
    with pytest.raises(ValueError, match=r"^seed must be a whole number of at least 0"):
        draw_conditions((), 2, seed)
    if seed != 2**63:
        with pytest.raises(ValueError, match=r"a whole number of at least 0 is needed$"):
            Noisy(Planner(), seed=seed)
