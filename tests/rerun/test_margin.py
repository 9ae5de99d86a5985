"""Margins, against closed forms and fabricated drivers whose limits are known."""

from __future__ import annotations

import cmath
import json
import math
import signal
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_margins import limits as made_up_limits

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
from frenetic.campaign import CampaignStore, Event, RoadTester
from frenetic.conditions.condition import SEED
from frenetic.conditions.domain import Domain
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.margin import measure_margins
from frenetic.rerun.margin_junit import margin_junit
from frenetic.rerun.margin_quantities import MarginQuantity, measured_quantities
from frenetic.rerun.margin_results import ConditionMargin, Margins, margins_of
from frenetic.rerun.margin_search import (
    MOST_DRIVES,
    MarginRoad,
    MarginSearch,
    draw_roads,
    in_any_size,
    with_class_profiles,
)
from frenetic.road.classes import RoadClass
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import SearchEnded
from frenetic.simulators.embedded import Vehicle
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator

DELAY = MarginQuantity("delay", 0.0, 1.0, 0.0)
OFFSET_LEFT = MarginQuantity("steering_offset", 0.0, 0.2, 0.0)
OFFSET_RIGHT = MarginQuantity("steering_offset", 0.0, -0.2, 0.0)
FRICTION = MarginQuantity("friction", 1.0, 0.01, 1.0)
VIEW = MarginQuantity("view", math.inf, 1.0, 500.0)
Verdict = Callable[[Candidate], bool]


def straight(number: int, length: float = 200.0, **fields: object) -> MarginRoad:
    """Return a straight road whose place of gusts is its number, in m."""
    candidate = Candidate(1, np.zeros(int(length / 10.0) + 1), 10.0, Origin("random"))
    return MarginRoad(replace(candidate, **fields), float(number), number)  # type: ignore[arg-type]


def measured(
    quantities: list[MarginQuantity],
    fails: Verdict,
    roads: list[MarginRoad] | int,
    order: Callable[[list[Candidate]], object] = lambda _: None,
) -> tuple[ConditionMargin, ...]:
    """Measure margins without a campaign; `order` changes the order in which results come."""
    if isinstance(roads, int):
        roads = [straight(i) for i in range(roads)]
    search, outstanding = MarginSearch(quantities, roads, [], {}), list[Candidate]()
    while not search.is_complete:
        while (candidate := search.ask()) is not None:
            outstanding.append(candidate)
            if search.is_complete or not search._drives:
                break
        order(outstanding)
        while outstanding:
            candidate = outstanding.pop(0)
            outcome = Outcome.FAIL if fails(candidate) else Outcome.PASS
            search.tell(Evaluation(candidate, outcome, 1.0, 0.0))
    with pytest.raises(SearchEnded):
        search.ask()
    return margins_of(search)


def drive_all(tester: RoadTester) -> Verdict:
    return lambda candidate: tester.test(candidate).result.outcome is Outcome.FAIL


# The closed form


class Proportional:
    """Steers in proportion to offset and heading, at a steady speed."""

    SPEED = 6.0

    def __init__(self, offset_gain: float, heading_gain: float) -> None:
        self.offset_gain, self.heading_gain = offset_gain, heading_gain

    def reset(self, setup: DriveSetup) -> None:
        pass

    def act(self, o: Observation) -> Controls:
        angle = -self.offset_gain * o.lateral_offset - self.heading_gain * o.heading_error
        return Controls(angle, throttle=0.5 * (self.SPEED - o.speed))


def critical_delay(driver: Proportional, lag: float, period: float) -> float:
    """Return the delay at which the linear car under a proportional driver turns unstable, in s.

    At a low speed the tyres do not slip: the heading changes by v/L δ, and the centre of mass moves
    to the left by v (heading + l_r/L δ). The front wheels follow with a lag, and a control holds
    for a period, which delays by half of it.
    """
    car, v = Vehicle(), driver.SPEED
    wheelbase = car.front_axle + car.rear_axle

    def open_loop(omega: float) -> complex:
        s = 1j * omega
        heading = v / wheelbase / s
        offset = v * (heading + car.rear_axle / wheelbase) / s
        loop = driver.offset_gain * offset + driver.heading_gain * heading
        return loop / (1.0 + lag * s)

    low, high = 1e-3, 1e3
    while high - low > 1e-9 * high:  # the gain falls with the frequency
        middle = math.sqrt(low * high)
        low, high = (middle, high) if abs(open_loop(middle)) > 1.0 else (low, middle)
    margin_of_phase = (math.pi + cmath.phase(open_loop(low))) % (2.0 * math.pi)
    return margin_of_phase / low - 0.5 * period


@pytest.mark.parametrize(("offset_gain", "heading_gain"), [(0.05, 0.3), (0.1, 0.4), (0.04, 0.5)])
def test_the_margin_of_delay_is_where_a_proportional_driver_turns_unstable(
    offset_gain: float, heading_gain: float
) -> None:
    driver = Proportional(offset_gain, heading_gain)
    simulator = EmbeddedSimulator(start_offset=0.3)
    tester = RoadTester(simulator, driver, Terms.of_class(RoadClass.of("rural-80")))
    delay = MarginQuantity("delay", 0.0, 2.0, 0.0)
    (margin,) = measured([delay], drive_all(tester), [straight(1, 1000.0)])
    expected = critical_delay(driver, Vehicle().steering_lag, 0.05)
    assert margin.amount == pytest.approx(expected, rel=0.1)


# Fabricated drivers


def delay_of(candidate: Candidate) -> float:
    return float(candidate.conditions.get("delay", 0.0))


def test_the_least_failing_amount_is_bracketed_by_a_passing_one() -> None:
    (margin,) = measured([DELAY], lambda c: delay_of(c) >= 0.437, 3)
    for limit in margin.limits:
        assert limit.passes is not None
        assert limit.fails is not None
        assert limit.passes < 0.437 <= limit.fails
        assert limit.fails - limit.passes <= 0.03 * limit.fails
    assert margin.amount == margin.limits[0].fails


@pytest.mark.parametrize("threshold", [1e-4, 0.01, 0.05, 0.3, 0.9999])
def test_a_search_makes_no_more_drives_than_its_budget(threshold: float) -> None:
    drives = 0

    def fails(candidate: Candidate) -> bool:
        nonlocal drives
        drives += 1
        return delay_of(candidate) > threshold

    measured([DELAY], fails, 1)
    assert drives <= MOST_DRIVES


def test_a_failure_below_passing_amounts_counts_and_is_noted() -> None:
    """The driver fails from 0.3 to 0.4 s, passes beyond, and fails again from 0.9 s."""
    (margin,) = measured([DELAY], lambda c: 0.3 <= delay_of(c) < 0.4 or delay_of(c) > 0.9, 2)
    limit = margin.limits[0]
    assert limit.fails == pytest.approx(0.3, rel=0.03)
    assert limit.passes_again == 0.5
    assert len(margin.passing_again) == 2
    (note,) = of_margins(margin).notes
    assert "2 roads pass again beyond the failing amount" in note
    assert f"drive {limit.drive} fails at 0.3" in note


def test_a_driver_that_never_fails_in_the_range_has_no_amount() -> None:
    (margin,) = measured([DELAY], lambda _: False, 80)
    assert margin.amount is None
    assert margin.interval == (None, None)
    assert margin.never.count == 80
    assert margin.amount_text() == "never up to 1 s"
    assert margin.reaches(1.0)
    assert of_margins(margin).shortfalls([("delay", 1.0)]) == {}


def test_a_road_that_fails_as_usual_has_margin_0_and_is_named() -> None:
    """Of 80 roads, 5 % are 4."""
    for count, amount in ((3, 0.5), (8, 0.0)):
        (margin,) = measured(
            [DELAY],
            lambda c, n=count: len(c.curvatures) <= 20 + n or delay_of(c) > 0.49,  # type: ignore[misc]
            [straight(i, 200.0 + 10.0 * i) for i in range(80)],
        )
        assert [limit.fails for limit in margin.failing_as_usual] == [0.0] * count
        assert margin.amount == pytest.approx(amount, abs=0.02)
        (note,) = of_margins(margin).notes
        assert note.startswith(f"{count} of 80 roads fail as usual")
        assert "drives 1, 2, 3" in note
    assert margin.amount_text() == "usual"
    (shortfall,) = of_margins(margin).shortfalls([("delay", 0.1)]).values()
    assert shortfall == "delay: fails as usual, 0.1 s is needed"


def test_the_drive_that_shows_a_margin_is_on_the_road_nearest_to_the_amount() -> None:
    """Of 80 roads one fails early, which is less than 5 %."""
    limits = made_up_limits(DELAY, 0.1, *[0.31] * 39, *[0.9] * 39, 2.0)
    margin = ConditionMargin(DELAY, limits)
    assert margin.example is limits[1]
    assert of_margins(margin).shown_drives == [2]
    never = ConditionMargin(DELAY, made_up_limits(DELAY, *[2.0] * 80))
    assert never.example is None
    assert of_margins(margin, never).shown_drives == [2]
    assert [row[4] for row in of_margins(margin, never).rows] == ["2", ""]


def test_both_sides_and_infinite_usual_amounts_have_their_own_limits() -> None:
    def fails(candidate: Candidate) -> bool:
        conditions = candidate.conditions
        offset, view = conditions.get("steering_offset", 0.0), conditions.get("view", math.inf)
        return offset < -0.05 or offset > 0.12 or view < 30.0 or conditions.get("friction", 1) < 0.3

    left, right, friction, view = measured([OFFSET_LEFT, OFFSET_RIGHT, FRICTION, VIEW], fails, 2)
    assert left.amount == pytest.approx(0.12, rel=0.04)
    assert right.amount == pytest.approx(-0.05, rel=0.04)
    assert friction.amount == pytest.approx(0.3, abs=0.03 * 0.7)
    assert view.amount == pytest.approx(30.0, rel=0.04)
    assert not right.reaches(-0.06)
    assert right.reaches(-0.04)
    assert friction.reaches(0.4)
    assert not friction.reaches(0.2)
    assert view.reaches(40.0)
    assert not view.reaches(20.0)
    margins = of_margins(left, right)
    assert margins.named("steering_offset", -0.01) is right
    assert [*margins.shortfalls([("steering_offset", 0.1), ("steering_offset", -0.1)])] == [
        "steering_offset, less"
    ]


def test_amounts_and_shares_of_a_range_are_inverse() -> None:
    for quantity in (DELAY, OFFSET_RIGHT, FRICTION, VIEW):
        for share in (0.1, 0.5, 0.99, 1.0):
            assert quantity.share(quantity.amount(share)) == pytest.approx(share, abs=1e-3)
        assert quantity.amount(0.0) == quantity.usual
        assert quantity.share(quantity.usual) == 0.0


def test_the_order_of_results_changes_no_margin() -> None:
    rng = np.random.default_rng(2)

    def fails(candidate: Candidate) -> bool:
        return delay_of(candidate) > 0.01 * len(candidate.curvatures)

    roads = [straight(i, 200.0 + 10.0 * i) for i in range(20)]
    in_order, shuffled = (
        measured([DELAY, FRICTION], fails, roads, order) for order in (lambda _: None, rng.shuffle)
    )
    for margin, other in zip(in_order, shuffled, strict=True):
        assert [limit.fails for limit in margin.limits] == [limit.fails for limit in other.limits]


def test_a_drive_in_which_the_simulator_broke_is_proposed_again() -> None:
    search = MarginSearch([DELAY], [straight(1)], [], {})
    usual = search.ask()
    assert usual is not None
    assert search.ask() is None
    search.tell(Evaluation(usual, Outcome.ERROR, None, 0.0))
    repeat = search.ask()
    assert repeat is not None
    assert (repeat.id, repeat.repeat, repeat.conditions) == (2, 1, {})


def test_a_usual_drive_serves_all_quantities_with_equal_usual_conditions() -> None:
    drawn = {"delay": 0.2, "friction": 0.5}
    search = MarginSearch([DELAY, FRICTION, OFFSET_LEFT], [straight(1, conditions=drawn)], [], {})
    usual = [search.ask() for _ in range(3)]
    assert search.ask() is None
    assert [candidate.conditions for candidate in usual if candidate] == [
        {"friction": 0.5}, {"delay": 0.2}, drawn,
    ]  # fmt: skip
    search = MarginSearch([DELAY, FRICTION], [straight(1)], [], {})
    assert search.ask() is not None
    assert search.ask() is None


def test_a_gust_keeps_its_place_and_noise_its_seed_on_a_road() -> None:
    gust, noise = MarginQuantity("gust", 0.0, 40.0, 0.0), MarginQuantity("noise", 0.0, 2.0, 0.0)
    conditions: list[dict[str, float]] = []

    def fails(candidate: Candidate) -> bool:
        conditions.append(dict(candidate.conditions))
        return False

    measured([gust, noise], fails, [straight(7)])
    assert {c["gust_at"] for c in conditions if "gust" in c} == {7.0}
    assert {c[SEED] for c in conditions if "noise" in c} == {7}


# The radius of the road


CLASS = RoadClass.of("rural-80", {"length": 600.0})
SIZE = MarginQuantity("radius", 1.0, 0.2, 1.0)


def of_class(driver: Driver | None = None, **options: Any) -> RoadTester:
    return RoadTester(EmbeddedSimulator(**options), driver or Planner(), Terms.of_class(CLASS))


def test_a_smaller_road_has_smaller_radii_and_the_same_lanes_slopes_and_places() -> None:
    (road,) = draw_roads(of_class(), 1, 0)
    gust = {"gust": 5.0, "gust_at": 100.0}
    points = np.zeros((2, 2))  # where a road of a map lies
    road = replace(road, candidate=replace(road.candidate, conditions=gust, points=points))
    (road,) = with_class_profiles([road], CLASS)
    small = road.at(SIZE, 0.75)
    usual = road.candidate
    assert small.points is None
    straight = len(small.curvatures) - len(usual.curvatures)
    assert not small.curvatures[:straight].any()
    assert np.allclose(small.curvatures[straight:], usual.curvatures / 0.4)
    assert small.length == pytest.approx(usual.length, abs=usual.step)
    start = small.length - 0.4 * usual.length
    assert small.conditions == {"gust": 5.0, "gust_at": pytest.approx(start + 40.0)}
    assert small.superelevation is not None
    assert usual.superelevation is not None
    expected = usual.superelevation * (0.4, 1.0) + (start, 0.0)
    assert np.allclose(small.superelevation, expected)
    tester = in_any_size(of_class(), CLASS)
    assert all(tester.fit_road(road.at(SIZE, i / 6))[1].valid for i in range(1, 7))
    assert not of_class().fit_road(small)[1].valid, "by the rules of its class"


def test_a_road_of_usual_size_is_driven_as_in_its_class() -> None:
    roads = draw_roads(of_class(), 3, 0)
    for road, same_road in zip(roads, with_class_profiles(roads, CLASS), strict=True):
        in_class = of_class().test(road.candidate)
        in_size = in_any_size(of_class(), CLASS).test(same_road.at(SIZE, 0.0))
        assert in_class.result == in_size.result


def test_a_driver_that_does_not_slow_down_fails_where_grip_ends() -> None:
    """The tyres hold on a radius of at least v² / (μ g): it grows with the square of the speed."""
    factors = []
    for speed in (75.0, 100.0):
        rules = Rules(speed_limit=speed)
        tester = of_class(Planner(lateral_acceleration=90.0), rules=rules, friction=0.5)
        roads = with_class_profiles(draw_roads(tester, 20, 0), CLASS)
        (margin,) = measured([SIZE], drive_all(in_any_size(tester, CLASS)), roads)
        factors.append([limit.fails for limit in margin.limits])
    pairs = [(slow, fast) for slow, fast in zip(*factors, strict=True) if slow and fast]
    assert len(pairs) >= 15
    ratio = np.median([fast / slow for slow, fast in pairs])
    assert ratio == pytest.approx((100.0 / 75.0) ** 2, rel=0.25)


def test_the_competitions_roads_have_no_margin_of_radius() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    assert "radius" not in {quantity.condition for quantity in measured_quantities(tester)}
    with pytest.raises(ValueError, match="name a road class to measure the radius"):
        measured_quantities(tester, {"radius": None})
    assert measured_quantities(of_class(), {"radius": None}) == [SIZE]


def test_a_campaign_measures_the_radius_beside_other_quantities(tmp_path: Path) -> None:
    quantities = measured_quantities(of_class(), {"radius": None, "delay": 0.4})
    margins = measure_margins(of_class(), quantities, roads=2, out=tmp_path / "c")
    alone = measure_margins(of_class(), quantities[1:], roads=2, out=tmp_path / "d")
    assert margins.domain == "rural-80, 80 km/h"
    assert [limit.fails for limit in margins.margins[1].limits] == [
        limit.fails for limit in alone.margins[0].limits
    ]


# Quantiles


def of_margins(*margins: ConditionMargin) -> Margins:
    part = {"class": "a:B"}
    return Margins(margins, "here", part, part, seed=0, drives=1, folder=Path("c"))


@cache
def amounts_fail_at(seed: int, roads: int) -> ConditionMargin:
    """Return the margin of a driver whose limits are drawn: 0.2 s to 0.8 s, evenly."""
    limits = np.random.default_rng(seed).uniform(0.2, 0.8, roads)
    return measured(
        [DELAY],
        lambda c: delay_of(c) >= limits[len(c.curvatures) - 21],
        [straight(i, 200.0 + 10.0 * i) for i in range(roads)],
    )[0]


def test_the_margin_of_many_other_roads_lies_within_the_interval_in_19_of_20() -> None:
    many = amounts_fail_at(1000, 1600).amount
    assert many == pytest.approx(0.23, rel=0.05)
    intervals = [amounts_fail_at(seed, 80).interval for seed in range(20)]
    assert sum(low <= many <= high for low, high in intervals) >= 19  # type: ignore[operator]
    pairs = zip(intervals, intervals[1:] + intervals[:1], strict=True)
    overlaps = [a[0] <= b[1] and b[0] <= a[1] for a, b in pairs]  # type: ignore[operator]
    assert sum(overlaps) >= 19, "of the intervals of two seeds"


def test_too_few_roads_let_the_interval_begin_at_the_usual_amount() -> None:
    assert amounts_fail_at(1, 71).interval[0] == 0.0
    assert amounts_fail_at(1, 72).interval[0] == min(
        limit.fails for limit in amounts_fail_at(1, 72).limits if limit.fails is not None
    )


# Quantities


def dummy() -> RoadTester:
    return RoadTester(DummySimulator(), DummyDriver())


def test_quantities_follow_from_the_declarations_of_conditions() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    quantities = {quantity.key: quantity for quantity in measured_quantities(tester)}
    assert quantities["delay, more"] == DELAY
    assert quantities["friction, less"] == FRICTION
    assert quantities["friction, more"].end == 1.5
    assert quantities["lag, more"].usual == Vehicle().steering_lag
    assert {"steering_offset, less", "steering_offset, more"} <= quantities.keys()
    assert "delay, less" not in quantities
    (view,) = measured_quantities(tester, {"view": None})
    assert view == VIEW
    (to_right,) = measured_quantities(tester, {"steering_offset": -0.1})
    assert to_right == MarginQuantity("steering_offset", 0.0, -0.1, 0.0)


def test_a_simulator_without_friction_has_fewer_default_quantities() -> None:
    names = {quantity.condition for quantity in measured_quantities(dummy())}
    assert "delay" in names
    assert "friction" not in names
    with pytest.raises(FreneticError, match="cannot vary friction"):
        measured_quantities(dummy(), {"friction": None})
    with pytest.raises(FreneticError, match="cannot vary friction"):
        measured_quantities(dummy(), at_least=[("friction", 0.5)])


def test_a_required_amount_is_measured_and_lengthens_the_range() -> None:
    quantities = measured_quantities(dummy(), {"delay": 0.5}, [("delay", 0.8), ("noise", 0.1)])
    assert [(quantity.key, quantity.end) for quantity in quantities] == [
        ("delay, more", 0.8), ("noise, more", 0.1),
    ]  # fmt: skip
    (delay,) = measured_quantities(dummy(), {"delay": 0.5}, [("delay", 0.3)])
    assert delay.end == 0.5


def test_the_amount_of_the_terms_is_the_usual_one() -> None:
    tester = RoadTester(DummySimulator(), DummyDriver(), Terms(conditions={"delay": 0.1}))
    (more,) = measured_quantities(tester, {"delay": None})
    assert (more.usual, more.end) == (0.1, 1.1)
    (less,) = measured_quantities(tester, {"delay": 0.0})
    assert (less.usual, less.end, less.side) == (0.1, 0.0, "less")


@pytest.mark.parametrize(
    ("name", "end", "words"),
    [
        ("delay", 0.0, "delay 0 s is the usual amount"),
        ("delay", 11.0, "delay is 11: 0 to 10 s is needed"),
        ("mass", None, "unknown condition 'mass'"),
    ],
)
def test_a_wrong_range_is_refused_in_a_line(name: str, end: float | None, words: str) -> None:
    with pytest.raises((FreneticError, ValueError), match=words):
        measured_quantities(dummy(), {name: end})


def test_a_place_is_no_quantity() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    with pytest.raises(ValueError, match="gust_at has no usual amount"):
        measured_quantities(tester, {"gust_at": None})


# Roads


def test_more_roads_begin_with_the_same_roads_in_conditions_of_the_domain() -> None:
    entries = {"roads": "urban-50,length=200", "conditions": {"friction": {"low": 0.4, "high": 1}}}
    domain = Domain.from_entries("town", entries)
    terms = Terms.of_class(domain.road_class, domain=domain)
    tester = RoadTester(EmbeddedSimulator(), Planner(), terms)
    few, more, other = (draw_roads(tester, n, seed) for n, seed in ((3, 1), (6, 1), (3, 2)))
    for road, same in zip(few, more, strict=False):
        assert np.array_equal(road.candidate.curvatures, same.candidate.curvatures)
        assert road.candidate.conditions == same.candidate.conditions
        assert 0.4 <= road.candidate.conditions["friction"] <= 1.0
        assert 0.0 <= road.place <= road.candidate.length
    assert few[0].candidate.conditions != other[0].candidate.conditions
    tiny = RoadTester(EmbeddedSimulator(), Planner(), replace(terms, map_size=30.0))
    with pytest.raises(ValueError, match="none of 1000 random roads is valid on a map of 30 m"):
        draw_roads(tiny, 1, 0)


# Margins as campaigns


def embedded() -> RoadTester:
    terms = Terms.of_class(Domain.from_entries("a", {"roads": "urban-50,length=200"}).road_class)
    return RoadTester(EmbeddedSimulator(), Planner(), terms)


def test_a_complete_campaign_is_read_and_an_interrupted_one_goes_on(tmp_path: Path) -> None:
    def interrupt(event: Event) -> None:
        if event.kind == "result" and event.summary.simulations == 30:
            signal.raise_signal(signal.SIGINT)

    def margins_in(name: str, **options: object) -> Margins:
        return measure_margins(embedded(), [DELAY], roads=5, out=tmp_path / name, **options)  # type: ignore[arg-type]

    whole = margins_in("whole")
    assert whole.margins[0].amount is not None
    events: list[Event] = []
    assert margins_in("whole", on_event=events.append) == whole
    assert [event.kind for event in events] == ["complete"]
    with pytest.raises(KeyboardInterrupt):
        margins_in("parts", on_event=interrupt)
    events.clear()
    parts = margins_in("parts", workers=2, on_event=events.append)
    assert parts.margins == whole.margins
    results = [event for event in events if event.kind == "result"]
    assert 0 < len(results) <= whole.drives - 30
    with pytest.raises(CampaignError, match="holds another campaign"):
        measure_margins(embedded(), [DELAY], roads=6, out=tmp_path / "whole")
    with CampaignStore.open(tmp_path / "whole") as store:
        limit = whole.margins[0].limits[0]
        assert limit.drive is not None
        test = store.test(limit.drive)
        assert test.outcome is Outcome.FAIL
        assert test.candidate.conditions == {"delay": limit.fails}


class Breaking(DummySimulator):
    def drive(self, road: Road, driver: Driver) -> Drive:
        raise OSError("no graphics")


def test_a_broken_simulator_ends_the_measurement(tmp_path: Path) -> None:
    tester = RoadTester(Breaking(), DummyDriver())
    with pytest.raises(FreneticError, match=r"simulator broke, .*: no graphics .*; the drives so"):
        measure_margins(tester, [DELAY], roads=2, out=tmp_path / "c")


def test_nothing_to_measure_and_no_roads_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="nothing is measured"):
        measure_margins(dummy(), [], out=tmp_path / "c")
    with pytest.raises(ValueError, match="roads is 0"):
        measure_margins(dummy(), [DELAY], roads=0, out=tmp_path / "c")
    assert not (tmp_path / "c").exists()


# Files


def test_a_junit_file_has_a_failure_for_each_margin_that_is_too_small() -> None:
    delay, friction = measured([DELAY, FRICTION], lambda c: delay_of(c) > 0.2, 80)
    margins = of_margins(delay, friction)
    root = ET.fromstring(margin_junit(margins, [("delay", 0.5), ("friction", 0.5)]))
    assert (root.get("tests"), root.get("failures")) == ("2", "1")
    first, second = root.iter("testcase")
    failure = first.find("failure")
    assert failure is not None
    assert "delay: begins to fail at 0.20" in (failure.get("message") or "")
    assert second.find("failure") is None
    properties = {item.get("name"): item.get("value") for item in second.iter("property")}
    assert properties["amount"] == "never up to 0.01"
    assert properties["at_least"] == "0.5"


def test_json_has_no_infinite_number() -> None:
    document = json.dumps(of_margins(*measured([VIEW, DELAY], lambda _: False, 3)).as_json())
    assert "Infinity" not in document
    view, delay = json.loads(document)["margins"]
    assert (view["usual"], view["amount"], delay["end"]) == (None, None, 1.0)
