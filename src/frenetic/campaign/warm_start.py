"""The warm start of a search: roads of earlier campaigns, and real roads.

A new campaign takes roads that failed or nearly failed in earlier campaigns, with their drives, if
they fit the new campaign's map and strategy. Another driver, or another version of the driver,
drove them, so the strategy drives the roads again before it relies on them. The new campaign's
database stores all that was taken, so the earlier campaigns are no longer needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted
from frenetic.campaign.configuration import EarlierCampaign
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.objective import Objective
from frenetic.campaign.reader import EARLIER_SETTINGS
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester, fitted
from frenetic.errors import CampaignError, RoadError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.road import Road, profile
from frenetic.road.folders import find_roads
from frenetic.road.real_roads import fitting, step_of, stretches_of
from frenetic.search.approach import nearest_square
from frenetic.search.archive import critical_places
from frenetic.search.operator_names import EARLIER, GIVEN
from frenetic.search.records import Candidate, Evaluation, Origin, SourceTest
from frenetic.spec.terms import DriveSetting

_LEAST_DIFFERENCE: Final = 1.0
"""Difference from each taken test below which another test is left out, in m, by the measure of
`frenetic.search.approach` (our choice)."""
_MOST_REASONS: Final = 10
"""Largest number of unreadable files and roads named with their reasons (our choice)."""


class _Most(NamedTuple):
    """Limits of the tests that one earlier campaign gives."""

    taken: int
    """Largest number of tests that are taken."""
    read: int
    """Largest number of tests that are read to find them, by their MOOBD, lowest first."""


_MOST_TESTS: Final = {Outcome.FAIL: _Most(500, 5000), Outcome.PASS: _Most(100, 1000)}
"""Outcome -> limits of the tests with this outcome; in this order they are taken (our choice)."""


@dataclass(frozen=True)
class WarmStart:
    """What a new campaign takes from earlier campaigns and real roads."""

    campaigns: tuple[EarlierCampaign, ...]
    """The earlier campaigns, with the numbers of tests that were taken."""
    tests: list[Test]
    """The tests: stretches of real roads first, which nobody has driven."""
    facts: dict[str, JSONValue]
    """Facts for the new campaign: the settings of the earlier campaigns."""
    notes: tuple[str, ...] = field(default=())
    """Sentences about each start, and about files and roads that cannot be read."""


def take_starts(
    folders: Sequence[Path | str],
    from_roads: str | None,
    tester: RoadTester,
    objective: Objective,
    step: float | None,
) -> WarmStart:
    """Take tests from earlier campaigns, and real roads, to start from.

    Args:
        folders: folders of the earlier campaigns.
        from_roads: folder of road files; None for no real roads.
        tester: tester of the new campaign, whose map the roads have to fit.
        objective: objective of the new campaign.
        step: distance between two curvatures that the strategy needs, in m; None for any.

    Raises:
        CampaignError: an earlier campaign cannot be read, or none of its roads fits.
        FreneticError: no real road fits.
    """
    earlier = take_earlier(folders, tester, objective, step)
    texts, tests = [str(campaign) for campaign in earlier.campaigns], earlier.tests
    unread: list[str] = []
    if from_roads is not None:
        text, unread, stretches = take_roads(from_roads, tester, step)
        texts, tests = [text, *texts], [*stretches, *tests]
    notes = (*(f"starts from {text}" for text in texts), *unread)
    return replace(earlier, tests=tests, notes=notes)


def take_roads(
    folder: Path | str, tester: RoadTester, step: float | None
) -> tuple[str, list[str], list[Test]]:
    """Return stretches of the roads in a folder as tests, see `frenetic.road.real_roads`.

    The stretches are fitted to the rules of the new campaign's road class; invalid stretches are
    left out.

    Args:
        folder: folder of road files, see `frenetic.road.folders.find_roads`.
        tester: tester of the new campaign.
        step: distance between two curvatures that the strategy needs, in m; None for any.

    Returns:
        A text about the start; sentences about files and roads that cannot be read; the tests.

    Raises:
        FreneticError: no road fits.
    """
    files = find_roads([folder])
    stretches = stretches_of(files.roads, step_of(files.roads) if step is None else step)
    tests: list[Test] = []
    for name, road in stretches.items():
        if tester.terms.road_class is not None:
            road = fitting(road, tester.terms.road_class)
        test = _undriven_test(len(tests) + 1, name, road)
        if fitted(test.candidate, tester.terms)[1].valid:
            tests.append(test)
    if not tests:
        raise RoadError(
            f"nothing can be taken from {folder}: none of {counted(len(files.roads), 'road')} there"
            f" is 50 m long, with bends as wide as two lanes, and fits the map of"
            f" {tester.terms.map_size:g} m"
        )
    taken = f"{folder}: {counted(len(tests), 'stretch', 'stretches')} of"
    unread = f", {len(files.skipped)} could not be read" if files.skipped else ""
    reasons = [f"left out: {reason}" for reason in files.skipped[:_MOST_REASONS]]
    if len(files.skipped) > _MOST_REASONS:
        reasons.append(f"left out: {len(files.skipped) - _MOST_REASONS} more")
    limits = _speed_limits_text([test.candidate for test in tests], tester)
    text = f"{taken} {counted(len(files.roads), 'real road')}{unread}; {limits}"
    return text, reasons, tests


def _undriven_test(number: int, name: str, road: Road) -> Test:
    """Return a stretch of a real road as a test, with its number from 1 and its name."""
    candidate = Candidate(
        number,
        road.curvatures,
        road.step,
        Origin(GIVEN),
        notes={GIVEN: name},
        **{profile_name: getattr(road, profile_name) for profile_name in profile.NAMES},
    )
    return Test(
        candidate=candidate,
        result=Result(Outcome.DROPPED, "a stretch of a real road, which nobody has driven"),
        result_number=number,
        budget_spent=0.0,
        attempts=0,
    )


def _speed_limits_text(stretches: Sequence[Candidate], tester: RoadTester) -> str:
    """Return the speed limits on stretches, and the limit where a file says none, in words."""
    rules, class_name = tester.setting.rules_in({}), getattr(tester.terms.road_class, "name", "")
    if rules.road_limits == "ignored":
        return f"speed limit {rules.limit_text()}"
    # Per stretch pairs of a distance in m and the limit from there in km/h; 0 is an unknown limit.
    steps = [
        profile.piece_of(profile.LIMITS, road.speed_limits, 0.0, road.length)
        for road in stretches
        if road.speed_limits is not None
    ]
    limits = [float(limit) for pairs in steps for limit in pairs[:, 1] if limit > 0.0]
    limited = sum(len(pairs) > 0 and bool(pairs[:, 1].all()) for pairs in steps)
    unlimited = len(stretches) - limited
    assumed = rules.limit_text(class_name=class_name)
    if not limits:
        return f"no file says a speed limit: {assumed}"
    text = f"speed limits of the files: {min(limits):.4g} to {max(limits):.4g} km/h"
    if rules.road_limits == "scaled":
        text += f", scaled until the highest of a road is {rules.speed_limit:.4g} km/h"
    return f"{text}; where {unlimited} of them say none, {assumed}" if unlimited else text


def take_earlier(
    folders: Sequence[Path | str], tester: RoadTester, objective: Objective, step: float | None
) -> WarmStart:
    """Take tests from the campaigns in folders.

    From each campaign failures are taken first, then passing tests, both by their MOOBD, lowest
    first. A test that is like one that was taken is left out, see `_LEAST_DIFFERENCE`. A campaign
    gives at most 500 failures and 100 passing tests.

    Args:
        folders: folders of the campaigns.
        tester: tester of the new campaign, whose map the roads have to fit.
        objective: objective of the new campaign, measured on the stored drives.
        step: distance between two curvatures that the strategy needs, in m; None for any.

    Raises:
        CampaignError: a folder holds no campaign, a campaign is damaged, or no test fits.
    """
    vectors: dict[int, list[FloatArray]] = {}
    campaigns: list[EarlierCampaign] = []
    tests: list[Test] = []
    settings: dict[str, JSONValue] = {}
    for folder in folders:
        with CampaignStore.open(Path(folder)) as store:
            taken, left_out = _take_tests(store, tester, objective, step, vectors)
            tests += [_as_earlier_test(folder, test) for test in taken]
            counts = store.counts()
            names = [item.name for item in fields(DriveSetting) if item.name in store.config]
            settings[str(folder)] = {name: store.config[name] for name in names}
        campaigns.append(
            EarlierCampaign(str(folder), counts.simulations, counts.failures, len(taken), left_out)
        )
    if folders and not tests:
        raise CampaignError(
            f"nothing can be taken from {', '.join(map(str, folders))}: no drive there has records,"
            " a MOOBD, and a road that fits this map and the strategy's step; start without them"
        )
    return WarmStart(tuple(campaigns), tests, {EARLIER_SETTINGS: settings} if settings else {})


def _take_tests(
    store: CampaignStore,
    tester: RoadTester,
    objective: Objective,
    step: float | None,
    vectors: dict[int, list[FloatArray]],
) -> tuple[list[Test], int]:
    """Return the tests to take from one campaign, and the number of roads that do not fit.

    Args:
        store: the campaign.
        tester: tester of the new campaign, whose map the roads have to fit.
        objective: objective of the new campaign, measured on the stored drives.
        step: distance between two curvatures that the strategy needs, in m; None for any.
        vectors: vectors of all taken tests, see `_is_new`, to which the new ones are added.
    """
    tests: list[Test] = []
    left_out = 0
    for outcome, most in _MOST_TESTS.items():
        end = len(tests) + most.taken
        for test in store.tests(outcome, "moobd", most.read):
            if len(tests) == end:
                break
            if not _fits(test.candidate, tester, step):
                left_out += 1
                continue
            evaluation = evaluation_of(test, partial(store.trajectory, test.id), objective)
            is_known = evaluation.trace is not None and evaluation.moobd is not None
            if is_known and _is_new(evaluation, vectors):
                path, value = store.trajectory(test.id), objective.value_of(evaluation)
                tests.append(replace(test, trajectory=path, objective=value))
    return tests, left_out


def _fits(candidate: Candidate, tester: RoadTester, step: float | None) -> bool:
    """Return whether a candidate's road fits the map and has the strategy's step."""
    has_step = candidate.points is None and step in (None, candidate.step)
    return has_step and fitted(candidate, tester.terms)[1].valid


def _is_new(evaluation: Evaluation, vectors: dict[int, list[FloatArray]]) -> bool:
    """Return whether a test is unlike all taken tests; if so, add its vector to `vectors`.

    Args:
        evaluation: evaluation of the test.
        vectors: side of the lane -> vectors of the taken tests, see `frenetic.search.approach`.
    """
    worst = critical_places(evaluation, evaluation.candidate, 0.0)[0]
    taken, least_square = vectors.setdefault(worst.side, []), _LEAST_DIFFERENCE**2
    if taken and nearest_square(np.array(taken), worst.vector, least_square) < least_square:
        return False
    taken.append(worst.vector)
    return True


def _as_earlier_test(folder: Path | str, test: Test) -> Test:
    """Return a test of the campaign in a folder as the new campaign stores it."""
    earlier = test.candidate
    candidate = Candidate(
        earlier.id,
        earlier.curvatures,
        earlier.step,
        Origin(EARLIER),
        conditions=earlier.conditions,
        source=SourceTest(str(folder), earlier.id),
        **{name: getattr(earlier, name) for name in profile.NAMES},
    )
    return replace(
        test,
        candidate=candidate,
        budget_spent=0.0,
        reported_share=None,
    )


def numbered(tests: Sequence[Test]) -> list[Test]:
    """Return the tests with new ids and result numbers, both from 1 in the order of the tests."""
    return [
        replace(test, candidate=replace(test.candidate, id=number), result_number=number)
        for number, test in enumerate(tests, start=1)
    ]


def read_earlier(store: CampaignStore) -> list[Test]:
    """Return the tests with which a campaign started, without trajectories.

    Raises:
        CampaignError: a test is damaged.
    """
    tests = store.earlier()
    for test in tests:
        is_known = test.outcome.is_driven and test.moobd is not None and bool(test.records)
        if not is_known and test.outcome is not Outcome.DROPPED:  # of a real road
            raise CampaignError(
                f"{store.folder} is damaged: earlier test {test.id} is {test.outcome}, with a MOOBD"
                f" of {test.moobd} and {test.records} records; restore it from a copy"
            )
    return tests


def earlier_evaluations(store: CampaignStore, objective: Objective) -> list[Evaluation]:
    """Return the evaluations of the tests with which a campaign started, for its strategy.

    The candidates lack the conditions in which they were driven: the strategy draws its own.

    Args:
        store: the campaign.
        objective: the campaign's objective, measured on the drives.

    Raises:
        CampaignError: the campaign is damaged, or the objective has no value for a drive.
    """
    evaluations = []
    for test in read_earlier(store):
        read_trajectory = partial(store.earlier_trajectory, test.id)
        evaluation = evaluation_of(test, read_trajectory, objective)
        candidate = replace(test.candidate, conditions={})
        evaluations.append(replace(evaluation, candidate=candidate))
    return evaluations


def driven_again(store: CampaignStore) -> dict[int, Test]:
    """Return the earlier tests whose roads a campaign has driven again, by the ids of its tests.

    Raises:
        CampaignError: the campaign is damaged.
    """
    earlier = {
        (test.candidate.step, test.candidate.curvatures.tobytes()): test
        for test in read_earlier(store)
    }
    select = """
        SELECT id, step, curvatures FROM test
        WHERE operator = ? AND outcome IN ('PASS', 'FAIL')
    """
    rows = store.rows(select, (EARLIER,)) if earlier else ()
    return {
        test_id: earlier[step, curvatures]
        for test_id, step, curvatures in rows
        if (step, curvatures) in earlier
    }


def still_failing(store: CampaignStore) -> str:
    """Return how many earlier failures still fail, in words; empty if none was driven again.

    Raises:
        CampaignError: the campaign is damaged.
    """
    repeats = store.repeats()
    had_failed = [
        number
        for number, test in driven_again(store).items()
        if test.outcome is Outcome.FAIL and number not in repeats
    ]
    if not had_failed:
        return ""
    failing = {number for (number,) in store.rows("SELECT id FROM test WHERE outcome = 'FAIL'")}
    count = len(failing.intersection(had_failed))
    return f"{count} of {counted(len(had_failed), 'earlier failure')} driven again still failed"
