"""Stability of failures: shares, matches, and the conditions that matter."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from repeats import failures_in, recorded, redriven

from frenetic.campaign.second_drive import Match
from frenetic.conditions.condition import known_conditions
from frenetic.drivers import Planner
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Side
from frenetic.rerun.rerun import rerun
from frenetic.rerun.reruns import read_reruns
from frenetic.rerun.stability import Change, Repeats, Stability
from frenetic.rerun.variations import Variation, draw_conditions
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.simulators.conditions import Conditions
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["searched_campaign"]

# Shares


def test_a_deterministic_failure_repeats_every_time(campaign: Path) -> None:
    worst = failures_in(campaign)[0].id
    (repeats,) = rerun(campaign, EmbeddedSimulator(), Planner(), tests=[worst], times=20).tests
    assert (repeats.failed, repeats.judged, repeats.alike, repeats.share) == (20, 20, 20, 1.0)
    assert repeats.stability is Stability.REPEATABLE
    assert all(drive.moobd == repeats.recorded.moobd for drive in repeats.drives)
    assert str(repeats) == "the same failure in 20 of 20 drives (100 %, 95 % interval 84 to 100 %)"


def test_drives_with_a_broken_simulator_are_not_judged() -> None:
    repeats = outcomes(*[Outcome.ERROR] * 6, *[Outcome.PASS] * 3)
    assert (repeats.judged, repeats.share) == (3, 0.0)
    none = outcomes(Outcome.ERROR, Outcome.ERROR)
    assert (none.judged, none.share, none.interval) == (0, None, (0.0, 1.0))
    assert none.stability is None
    assert str(none) == "none of 2 drives could be judged"
    assert repeats.change is none.change is Change.NOT_JUDGED


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
        (1, 1, None),
    ],
)
def test_stability_needs_the_whole_interval_on_the_same_side(
    failed: int, times: int, stability: Stability | None
) -> None:
    drives = [Outcome.FAIL] * failed + [Outcome.PASS] * (times - failed)
    assert outcomes(*drives).stability is stability
    passed = outcomes(*drives, before=Outcome.PASS)
    assert passed.stability is passed.as_json()["stability"] is None
    assert passed.change is (Change.FAILS_NOW if failed else Change.PASSES_AGAIN)


def outcomes(*drive_outcomes: Outcome, before: Outcome = Outcome.FAIL) -> Repeats:
    """Return repeats with these outcomes."""
    drives = tuple(redriven({}, outcome, None) for outcome in drive_outcomes)
    return Repeats(recorded(before), drives, (Variation("friction", 0.8, 1.0),))


def test_other_failures_on_the_road_do_not_make_a_failure_robust() -> None:
    test = recorded(Outcome.FAIL, -1.0, 50.0, "left")
    same, elsewhere = (
        redriven({}, Outcome.FAIL, -1.0, place, "left", test=test, difference=0.5)
        for place in (50.0, 90.0)
    )
    vary = (Variation("friction", 0.8, 1.0),)
    assert Repeats(test, (same,) * 18 + (elsewhere,) * 42, vary).stability is Stability.FRAGILE
    assert Repeats(test, (same,) * 3 + (elsewhere,) * 97, vary).stability is Stability.FRAGILE
    assert Repeats(test, (same,) * 60, vary).stability is Stability.ROBUST


def test_differing_drives_are_not_repeatable() -> None:
    test = recorded(Outcome.FAIL, -1.0, 50.0, "left")
    fails = redriven({}, Outcome.FAIL, -1.0, 50.0, "left", test=test, difference=0.5)
    passes = redriven({}, Outcome.PASS, 1.0, test=test)
    assert Repeats(test, (fails,) * 20).stability is Stability.REPEATABLE
    for often in (9, 19):
        drives = (fails,) * often + (passes,) * (20 - often)
        assert Repeats(test, drives).stability is Stability.NOT_REPEATABLE
        assert Repeats(test, drives, is_own=False).stability is not Stability.NOT_REPEATABLE


# Influences


def repeats_in(draws: tuple[Conditions, ...], ranges: list[Variation], **outcomes: Any) -> Repeats:
    """Return repeats whose outcomes follow from the conditions by ``verdict``."""
    verdict = outcomes["verdict"]
    drives = tuple(
        redriven(
            conditions,
            Outcome.FAIL if (moobd := verdict(conditions)) < 0.0 else Outcome.PASS,
            moobd,
        )
        for conditions in draws
    )
    return Repeats(recorded(), drives, tuple(ranges))


def test_only_conditions_that_matter_are_named() -> None:
    ranges = [Variation("friction", 0.8, 1.0), Variation("delay", 0.0, 0.2)]
    draws = draw_conditions(ranges, 20, 1)
    repeats = repeats_in(draws, ranges, verdict=lambda w: w["friction"] - 0.93)
    first, second = repeats.influences
    assert (first.condition, first.matters) == ("friction", True)
    assert first.spearman > 0.8
    assert (second.condition, second.matters) == ("delay", False)
    assert str(repeats).startswith(
        "the same failure in 13 of 20 drives (65 %, 95 % interval 43 to 82 %); less friction is"
    )
    assert "delay" not in str(repeats)
    ranges = [Variation("noise", 0.0, 0.4)]
    draws = draw_conditions(ranges, 30, 1)
    (influence,) = repeats_in(draws, ranges, verdict=lambda w: 0.2 - w["noise"]).influences
    assert influence.spearman < -0.8
    assert str(influence).startswith("more noise is worse")


@pytest.mark.parametrize(
    ("low", "times", "least"),
    [
        (0.5, 7, 0.7),  # too few drives
        (1.0, 20, 0.7),  # nothing varied
        (0.5, 20, 2.0),  # all fail
    ],
)
def test_influences_need_enough_differing_drives(low: float, times: int, least: float) -> None:
    ranges = [Variation("friction", low, 1.0)]
    draws = draw_conditions(ranges, times, 1)
    assert repeats_in(draws, ranges, verdict=lambda w: w["friction"] - least).influences == ()


def test_p_values_are_corrected_for_the_number_of_conditions() -> None:
    ranges = [Variation("friction", 0.5, 1.0), Variation("delay", 0.0, 0.2)]
    draws = draw_conditions(ranges, 12, 0)
    verdict = {"verdict": lambda w: w["delay"] - 0.1 + 0.2 * w["friction"]}
    p_of_both = {
        influence.condition: influence.p
        for influence in repeats_in(draws, ranges, **verdict).influences
    }
    p_alone = {
        range_.condition: repeats_in(draws, [range_], **verdict).influences[0].p
        for range_ in ranges
    }
    smaller = min(p_alone, key=lambda name: p_alone[name])
    assert p_of_both[smaller] == pytest.approx(min(1.0, 2.0 * p_alone[smaller]))


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
def test_matches_of_failures_are_distinguished(
    place: float | None, side: Side | None, difference: float | None, match: Match
) -> None:
    test = recorded(Outcome.FAIL, -1.0, 100.0, "left")
    drive = redriven({}, Outcome.FAIL, -1.0, place, side, test=test, difference=difference)
    assert drive.match is match
    assert drive.is_alike is (match in (Match.SAME, Match.SAME_PLACE))
    assert replace(drive, test=recorded(Outcome.PASS, 1.0, place, side)).match is None
    assert replace(drive, recorded=recorded(Outcome.PASS, 1.0)).match is None
    stuck = recorded(Outcome.FAIL, 1.0)  # within its lane
    assert redriven({}, Outcome.FAIL, 1.0, test=stuck, difference=1.9).match is Match.SAME


def test_the_text_counts_drives_with_the_same_failure() -> None:
    test = recorded(Outcome.FAIL, -1.0, 50.0, "left")
    here, there, otherwise = (
        redriven({}, Outcome.FAIL, -1.0, place, "left", test=test, difference=difference)
        for place, difference in ((50.0, 0.5), (90.0, 0.5), (50.0, 9.0))
    )
    repeats = Repeats(test, (here, there, there, otherwise))
    assert str(repeats) == (
        "the same failure in 1 of 4 drives (25 %, 95 % interval 5 to 70 %), another in 3 (1 other"
        " mechanism, 2 elsewhere)"
    )
    document: Any = repeats.as_json()
    assert {kind: number for kind, number in document["matches"].items() if number} == {
        "same failure": 1,
        "other mechanism": 1,
        "elsewhere": 2,
    }


# Draws of conditions


@given(
    st.lists(st.sampled_from(list(known_conditions())), min_size=1, max_size=6, unique=True),
    st.integers(1, 30),
    st.integers(0, 99),
)
def test_each_range_is_covered_evenly(names: list[str], times: int, seed: int) -> None:
    ranges = [
        Variation(name, known_conditions()[name].low, known_conditions()[name].high)
        for name in names
    ]
    draws = draw_conditions(ranges, times, seed)
    assert len(draws) == times
    for variation in ranges:
        values = [conditions[variation.condition] for conditions in draws]
        parts = sorted(
            math.floor((value - variation.low) / (variation.high - variation.low) * times)
            for value in values
        )
        assert parts == list(range(times))
    assert draws == draw_conditions(ranges[::-1], times, seed), "the order of the ranges counts"
    for name in known_conditions().keys() - names:
        assert {conditions.get(name) for conditions in draws} == {None}


def test_each_drive_has_its_own_noise_and_nothing_else_without_variation() -> None:
    draws = draw_conditions([Variation("noise", 0.2, 0.2)], 10, 1)
    assert {conditions["noise"] for conditions in draws} == {0.2}
    assert len({conditions["noise_seed"] for conditions in draws}) == 10
    assert draws != draw_conditions([Variation("noise", 0.2, 0.2)], 10, 2)
    assert draw_conditions([], 3, 0) == ({},) * 3


@pytest.mark.parametrize(
    ("ranges", "times", "seed", "message"),
    [
        *(([], times, 0, "times is") for times in (0, -1, 2.5, True)),
        *(([], 2, seed, f"seed is {seed!r}: a") for seed in (-1, 1.5, "a", None, 2**63)),
        ([("speed", 50.0, 60.0)] * 2, 3, 0, "speed is varied twice"),
        ([("mass", 1.0, 2.0)], 3, 0, "unknown condition 'mass'. Known: friction, wet"),
        ([("friction", 1.0, 0.8)], 3, 0, "from 1 to 0.8: a range LOW:HIGH within 0.01 to 1.5"),
        ([("speed", 0.0, 50.0)], 3, 0, "within 1 to 500 km/h is needed"),
        ([("noise", math.nan, 1.0)], 3, 0, "cannot vary noise from nan to 1"),
    ],
)
def test_invalid_ranges_are_refused(
    ranges: list[tuple[str, float, float]], times: Any, seed: Any, message: str
) -> None:
    with pytest.raises((FreneticError, ValueError)) as caught:
        draw_conditions([Variation(*arguments) for arguments in ranges], times, seed)
    assert message in str(caught.value)


def test_usual_ranges_follow_the_simulator(campaign: Path) -> None:
    simulator = EmbeddedSimulator(friction=0.5)
    assert Variation.usual("friction", simulator) == Variation("friction", 0.4, 0.6)
    assert Variation.usual("speed", simulator) == Variation("speed", 63.0, 77.0)
    for name in known_conditions():
        assert not Variation.usual(name, simulator).is_fixed
    with pytest.raises(FreneticError, match="DummySimulator cannot vary friction"):
        Variation.usual("friction", DummySimulator())
    with pytest.raises(FreneticError, match="unknown condition 'grip'"):
        Variation.usual("grip", simulator)
    with pytest.raises(FreneticError, match="DummySimulator cannot vary start"):
        rerun(campaign, DummySimulator(), DummyDriver(), vary=[Variation("start", 0.0, 0.1)])
    assert read_reruns(campaign) == [], "the error comes before a drive"


def test_usual_ranges_lie_on_both_sides_of_the_campaigns_amount() -> None:
    simulator = EmbeddedSimulator(
        rules=Rules(speed_limit=50.0), friction=0.7, start_offset=0.5, start_heading=-0.1
    )
    amounts = {"friction": 0.7, "speed": 50.0, "lag": 0.1, "start": 0.5, "heading": -0.1}
    for name, row in known_conditions().items():
        if row.attribute and name not in amounts:
            continue
        amount = amounts.get(name, 0.8 * row.usual[1])
        usual = Variation.usual(name, simulator, amount)
        below, above = amount - usual.low, usual.high - amount
        assert below > 0.0 < above, name
        assert below == pytest.approx(above) or row.low == usual.low, name
    assert Variation.usual("noise", simulator, 0.5) == Variation("noise", 0.3, 0.7)
    assert Variation.usual("view", simulator, 40.0) == Variation("view", 20.0, 60.0)
    assert Variation.usual("friction", EmbeddedSimulator(friction=1.4)).high == 1.5, (
        "no more than its bound"
    )
    for quick in (EmbeddedSimulator(vehicle="etk800"), EmbeddedSimulator(steering_lag=0.05)):
        usual = Variation.usual("lag", quick)
        assert (usual.low, usual.high) == pytest.approx((0.025, 0.075))
