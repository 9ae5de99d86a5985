"""Trials of causes: which drives are made, what they say, and that they are kept."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import planted_drivers as planted
import pytest

from frenetic import Budget, Campaign, CampaignStore, EmbeddedSimulator, Frenetic
from frenetic.analysis.cause_trials import (
    Certainty,
    Trial,
    TrialDrive,
    TriedFailure,
    shows_itself,
    tried_failures,
)
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.explained import explained_causes
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.cause_trials import examples_of, try_failures
from frenetic.segments.causes import Kind


def searched(folder: Path, driver: planted.Sound, simulations: int = 25) -> Campaign:
    campaign = Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=driver,
        budget=Budget(simulations=simulations),
        folder=folder,
    )
    campaign.run()
    return campaign


def tried(kind: Kind, *, is_shown: bool = False, **outcomes: object) -> TriedFailure:
    """Return a failure at 100 m; a trial passes (True) or fails at a place, in m."""
    drives = []
    for name, outcome in outcomes.items():
        passes = outcome is True
        place = None if passes else float(str(outcome))
        result = Outcome.PASS if passes else Outcome.FAIL
        drives.append(TrialDrive(Trial[name], result, "" if passes else kind.name, place))
    return TriedFailure(1, kind.name, 100.0, is_shown, tuple(drives))


@pytest.mark.parametrize(
    ("failure", "certainty"),
    [
        (tried(Kind.TOO_FAST, MUCH_SLOWER=True), Certainty.CERTAIN),
        (tried(Kind.TOO_FAST, SLOWER=100, MUCH_SLOWER=104), Certainty.DOUBTFUL),
        (tried(Kind.TOO_FAST), Certainty.LIKELY),
        (tried(Kind.BRAKES_LATE, EARLIER=True, NO_PEDALS=100), Certainty.CERTAIN),
        (tried(Kind.BRAKES_LATE, EARLIER=100, NO_PEDALS=100), Certainty.DOUBTFUL),
        (tried(Kind.ACCELERATES, NO_PEDALS=100), Certainty.DOUBTFUL),
        (tried(Kind.TOO_LITTLE, LESS_STEERING=60, MORE_STEERING=True), Certainty.CERTAIN),
        (tried(Kind.TOO_LITTLE, LESS_STEERING=60, MORE_STEERING=100), Certainty.CERTAIN),
        (tried(Kind.TOO_LITTLE, LESS_STEERING=True, MORE_STEERING=100), Certainty.DOUBTFUL),
        (tried(Kind.TOO_LITTLE, LESS_STEERING=99, MORE_STEERING=101), Certainty.LIKELY),
        (tried(Kind.OSCILLATES, FASTER_STEERING=True, MORE_STEERING=90), Certainty.CERTAIN),
        (tried(Kind.OSCILLATES, FASTER_STEERING=True, MORE_STEERING=True), Certainty.DOUBTFUL),
        (tried(Kind.CUTS, is_shown=True, MUCH_SLOWER=100), Certainty.CERTAIN),
        (tried(Kind.CUTS, is_shown=True, MUCH_SLOWER=True), Certainty.DOUBTFUL),
        (tried(Kind.BEYOND, is_shown=True), Certainty.CERTAIN),
    ],
)
def test_trials_confirm_or_contradict_a_cause(failure: TriedFailure, certainty: Certainty) -> None:
    assert failure.certainty(share=0.5) is certainty


def test_a_rare_cause_needs_a_trial_that_confirms_it() -> None:
    failure = tried(Kind.WRONG_WAY, is_shown=True, MUCH_SLOWER=100)
    assert failure.certainty(share=0.5) is Certainty.CERTAIN
    assert failure.certainty(share=0.05) is Certainty.LIKELY


def test_a_cause_that_changes_with_hardly_other_grip_is_not_certain() -> None:
    kept = tried(Kind.TOO_FAST, MUCH_SLOWER=True, LESS_GRIP=100, MORE_GRIP=True)
    other = TrialDrive(Trial.LESS_GRIP, Outcome.FAIL, Kind.ASTRAY.name, 100.0)
    changed = TriedFailure(1, Kind.TOO_FAST.name, 100.0, False, (*kept.drives[:1], other))
    assert kept.certainty(1.0) is Certainty.CERTAIN
    assert changed.certainty(1.0) is Certainty.LIKELY


def test_the_text_names_what_helps_and_what_does_not() -> None:
    failure = tried(
        Kind.BRAKES_LATE, SLOWER=True, MUCH_SLOWER=True, EARLIER=True, NO_PEDALS=100, LESS_GRIP=99
    )
    assert failure.as_text() == (
        "passes when it is 10 % slower or when it sees the road 0.5 s earlier; not with pedals"
        " released while it slides"
    )
    slow = tried(Kind.BEYOND, SLOWER=100, MUCH_SLOWER=100)
    assert slow.as_text() == "fails in each of 2 trials"
    assert tried(Kind.BEYOND).as_text() == ""


@pytest.mark.parametrize(
    ("swings", "shows"), [((0.3, -0.8, 2.5), True), ((1.0, -0.8, 2.5), False), ((-2.5,), False)]
)
def test_growing_swings_show_that_a_driver_oscillates(
    swings: tuple[float, ...], shows: bool
) -> None:
    assert shows_itself(Kind.OSCILLATES, swings) is shows
    assert shows_itself(Kind.CUTS, swings)
    assert not shows_itself(Kind.TOO_FAST, swings)


def test_trials_are_kept_and_cost_nothing_a_second_time(tmp_path: Path) -> None:
    campaign = searched(tmp_path, planted.RateLimited(), 40)
    with CampaignStore.open(tmp_path) as store:
        clusters = distinct_failures(store)
    drives: list[object] = []
    ids = examples_of(clusters.causes)
    first = try_failures(tmp_path, ids, campaign.tester, on_event=drives.append)
    assert len(drives) > 0
    assert all(len(failure.drives) <= 16 for failure in first.values())
    drives.clear()
    assert try_failures(tmp_path, ids, campaign.tester) == first
    with CampaignStore.open(tmp_path) as store:
        assert tried_failures(store.facts) == first
        (cause,) = explained_causes(store, clusters)
    assert cause.certainty is Certainty.CERTAIN
    assert cause.as_text().startswith("turns its steering by 9° a second at most")
    assert "; passes when it is 10 % slower" in cause.as_text()


def test_only_failures_are_tried_and_conditions_are_taken_away(tmp_path: Path) -> None:
    campaign = searched(tmp_path, planted.TooFast())
    with CampaignStore.open(tmp_path) as store:
        passed = [test.id for test in store.tests(Outcome.PASS)]
    with pytest.raises(CampaignError, match="only a failure can be tried"):
        try_failures(tmp_path, passed[:1], campaign.tester)
    with pytest.raises(CampaignError, match=r"cause_trials is damaged.*repeat"):
        tried_failures({"cause_trials": [{"id": "x"}]})
    assert tried_failures({}) == {}


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("driver", "kinds"),
    [
        (planted.WrongFeedForward, {Kind.WRONG_WAY}),
        (planted.RateLimited, {Kind.SLOW_STEERING}),
        (planted.WindUp, {Kind.OSCILLATES}),
        (planted.Degrees, {Kind.BEYOND}),
        (planted.LateSpeed, {Kind.BRAKES_LATE, Kind.TOO_FAST}),
        (planted.WeakSteering, {Kind.TOO_LITTLE}),
        (planted.ShortWheelbase, {Kind.TOO_LITTLE}),
        (planted.Limited, {Kind.HELD}),
        (planted.WrongSign, {Kind.WRONG_WAY}),
        (planted.CutsBends, {Kind.CUTS}),
        (planted.Lagging, {Kind.OSCILLATES}),
        (planted.TooFast, {Kind.TOO_FAST}),
    ],
)
def test_a_certain_cause_is_the_planted_one(
    driver: Callable[[], planted.Sound], kinds: set[Kind], tmp_path: Path
) -> None:
    campaign = searched(tmp_path, driver(), 80)
    with CampaignStore.open(tmp_path) as store:
        clusters = distinct_failures(store)
    try_failures(tmp_path, examples_of(clusters.causes), campaign.tester)
    with CampaignStore.open(tmp_path) as store:
        causes = explained_causes(store, clusters)
    certain = [cause for cause in causes if cause.certainty is Certainty.CERTAIN]
    failures = sum(cause.group.failures for cause in certain)
    planted_failures = sum(
        cause.group.failures
        for cause in certain
        if cause.tried is not None and Kind[cause.tried.kind] in kinds
    )
    assert planted_failures >= math.floor(0.95 * failures)
