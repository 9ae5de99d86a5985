"""Try causes: drive failing roads again, with one thing changed at a time.

The drives are a campaign, as in a rerun: the same call continues interrupted trials, and reads
complete ones. `frenetic.analysis.cause_trials` says what they show.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple, Unpack

from msgspec import to_builtins

from frenetic.analysis.cause_trials import (
    CAUSE_TRIALS,
    Trial,
    TrialDrive,
    TriedFailure,
    shows_itself,
    tried_failures,
)
from frenetic.analysis.clusters import CauseGroup
from frenetic.analysis.failure_stability import Grip
from frenetic.analysis.failures import Failure
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import condition_named
from frenetic.drivers.stack import camera_of
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.campaigns import DrivingOptions
from frenetic.rerun.replay import ReplayRoads, drive_replays, keep_fact, recorded_test
from frenetic.segments.causes import Kind
from frenetic.segments.departure import Departure
from frenetic.segments.evidence import swings_of
from frenetic.segments.segment import segment_of
from frenetic.simulators.conditions import (
    Conditions,
    check_can_vary,
    check_pair_in,
    usual_amount,
)

MOST_CAUSES: Final = 8
"""Largest number of causes that are tried, the most frequent ones; our choice."""


class _ChangedCondition(NamedTuple):
    """The change of a trial."""

    condition: str
    """Name of the condition that is changed."""
    amount: float
    """New amount, or factor of the present one."""
    is_factor: bool = False


_CHANGES: Final[Mapping[Trial, _ChangedCondition]] = MappingProxyType(
    {
        Trial.LESS_GRIP: _ChangedCondition("friction", Grip.LESS.factor, is_factor=True),
        Trial.MORE_GRIP: _ChangedCondition("friction", Grip.MORE.factor, is_factor=True),
        Trial.SLOWER: _ChangedCondition("pace", 0.9, is_factor=True),
        Trial.MUCH_SLOWER: _ChangedCondition("pace", 0.8, is_factor=True),
        Trial.EARLIER: _ChangedCondition("preview", 0.5),
        Trial.LESS_STEERING: _ChangedCondition("steering_gain", 0.9, is_factor=True),
        Trial.MORE_STEERING: _ChangedCondition("steering_gain", 1.1, is_factor=True),
        Trial.FASTER_STEERING: _ChangedCondition("lag", 0.1, is_factor=True),
        Trial.NO_DELAY: _ChangedCondition("delay", 0.0),
        Trial.NO_NOISE: _ChangedCondition("noise", 0.0),
        Trial.NO_RATE_LIMIT: _ChangedCondition("steering_rate", math.inf),
        Trial.MUCH_MORE_GRIP: _ChangedCondition("friction", 1.1, is_factor=True),
        Trial.NO_PEDALS: _ChangedCondition("pedal_release", 0.1),
    }
)
_TAKEN_AWAY: Final = (Trial.NO_DELAY, Trial.NO_NOISE, Trial.NO_RATE_LIMIT)
"""Trials that take a condition away, which only a failure in this condition can have."""


def examples_of(causes: Sequence[CauseGroup]) -> list[int]:
    """Return the ids of a failure of each cause to try, at most `MOST_CAUSES`.

    A fault of the driver needs no trial: it has a line of code.
    """
    return [cause.example for cause in causes if cause.fault is None][:MOST_CAUSES]


def try_failures(
    folder: Path | str,
    tests: Iterable[int],
    tester: RoadTester,
    **options: Unpack[DrivingOptions],
) -> dict[int, TriedFailure]:
    """Try failures of a campaign, and keep what the trials showed as a fact of the campaign.

    A failure is driven at most 13 times. Changes that the simulator or the driver cannot have are
    left out.

    Args:
        folder: folder of the campaign.
        tests: ids of the failures.
        tester: drives on the campaign's terms.
        options: see `DrivingOptions`.

    Returns:
        Id of a test -> the tried failure. A failure lacks if its cause is unknown, if nothing can
        be changed, or if Ctrl-C prevented its drives.

    Raises:
        CampaignError: the campaign is damaged, a test did not fail, or see
            `frenetic.rerun.campaigns.driving_campaign`.
    """
    with CampaignStore.open(folder) as store:
        failures = {number: store.test(number) for number in tests}
    for test in failures.values():
        if test.outcome is not Outcome.FAIL:
            raise CampaignError(f"test {test.id} is {test.outcome}: only a failure can be tried")
    changes = {
        number: changed
        for number, test in failures.items()
        if (changed := dict(_changes_of(test.candidate.conditions, tester)))
    }
    if not changes:
        return {}
    conditions = {number: list(changed.values()) for number, changed in changes.items()}
    strategy = ReplayRoads(folder, list(changes), conditions)
    driving_folder = drive_replays(folder, tester, strategy, CAUSE_TRIALS, options)
    drives: dict[int, list[TrialDrive]] = {number: [] for number in changes}
    with CampaignStore.open(driving_folder) as store:
        for test in store.tests(with_segments=True):
            number = recorded_test(store, test)
            trial = list(changes[number])[test.candidate.repeat]
            drives[number].append(_drive_of(trial, test))
    tried = {
        number: failure
        for number, trial_drives in drives.items()
        if len(trial_drives) == len(changes[number])
        and (failure := _tried(failures[number], tuple(trial_drives))) is not None
    }
    _keep(folder, tried)
    return tried


def _changes_of(recorded: Conditions, tester: RoadTester) -> Iterator[tuple[Trial, Conditions]]:
    """Yield the trials that a failure can have, and what differs from its conditions in each.

    Args:
        recorded: conditions that the test recorded.
        tester: the tester, which has the other conditions.
    """
    present = tester.terms.conditions_of(recorded)
    for trial, change in _CHANGES.items():
        condition = condition_named(change.condition)
        try:
            check_can_vary(tester.simulator, [condition.name])
            amount = present.get(condition.name)
            if amount is None:
                amount = usual_amount(tester.simulator, condition.name)
            is_present = amount != condition.no_effect
            if amount is None or (trial in _TAKEN_AWAY and not is_present):
                continue
            changed = change.amount * amount if change.is_factor else change.amount
            changed = min(max(changed, condition.low), max(condition.high, changed))
            if trial is Trial.EARLIER and camera_of(tester.driver) is not None:
                continue  # an image shows the road where the car is
            check_pair_in({**present, condition.name: changed}, tester.simulator, tester.driver)
        except FreneticError:  # the simulator or the driver cannot have it
            continue
        yield trial, {condition.name: changed}


def _drive_of(trial: Trial, test: Test) -> TrialDrive:
    """Return a drive with one change."""
    failure = Failure.of_test(test)
    cause = None if failure is None else failure.cause
    finding = test.result.finding
    return TrialDrive(
        trial,
        test.outcome,
        "" if cause is None else cause.kind.name,
        None if finding is None or test.outcome is Outcome.PASS else finding.distance,
    )


def _tried(test: Test, drives: tuple[TrialDrive, ...]) -> TriedFailure | None:
    """Return a failure with its trials; None if its cause is unknown."""
    failure, finding = Failure.of_test(test), test.result.finding
    if failure is None or failure.cause is None:
        return None
    kind = failure.cause.kind
    swings: list[float] = []
    if kind is Kind.OSCILLATES and test.drive is not None:
        swings = swings_of(Departure.of(segment_of(test.road, test.drive, finding)))
    place = 0.0 if finding is None else finding.distance
    return TriedFailure(test.id, kind.name, place, shows_itself(kind, swings), drives)


def _keep(folder: Path | str, tried: Mapping[int, TriedFailure]) -> None:
    """Keep tried failures as a fact of the campaign, beside earlier tried failures."""
    with CampaignStore.open(folder) as store:
        known = tried_failures(store.facts)
    everything = {**known, **tried}
    if everything != known:
        fact = to_builtins(list(everything.values()))
        warning = "the campaign does not keep its trials: %s; then repeat them"
        keep_fact(folder, CAUSE_TRIALS, fact, warning=warning)
