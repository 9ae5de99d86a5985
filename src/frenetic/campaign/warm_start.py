"""The warm start of a search: roads of earlier campaigns, and real roads.

A campaign takes roads that failed or came near failing, with their drives, as far as they fit it.
Their results belong to another driver, or another version, so a strategy drives them again instead
of believing them. The new campaign's database keeps them, so the earlier campaign is no longer
needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Final

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
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.road import profile
from frenetic.road.files import find_roads
from frenetic.road.real_roads import fitting, step_of, stretches_of
from frenetic.search.approach import nearest_square
from frenetic.search.archive import critical_places
from frenetic.search.random_search import EARLIER, GIVEN
from frenetic.search.records import Candidate, Evaluation, Origin, SourceTest
from frenetic.spec.terms import DriveSetting

_APART: Final = 1.0
"""Least difference of two taken tests, in m (ours)."""
_REASONS: Final = 10
"""Most unreadable files and roads that are named with their reason (ours)."""
_MOST: Final = {Outcome.FAIL: (500, 5000), Outcome.PASS: (100, 1000)}
"""Most tests that are taken, and most that are looked at, of each campaign (ours)."""


def take_starts(
    folders: Sequence[Path | str],
    from_roads: str | None,
    tester: RoadTester,
    objective: Objective,
    step: float | None,
) -> tuple[tuple[EarlierCampaign, ...], list[Test], dict[str, JSONValue], tuple[str, ...]]:
    """Take tests from earlier campaigns, and real roads, to start from.

    Args:
        folders: of the earlier campaigns.
        from_roads: folder of road files; None for no real roads.
        tester: of the new campaign.
        objective: of the new campaign.
        step: distance between two curvatures that the roads need, in m; None for any.

    Returns:
        The earlier campaigns; the tests, real roads first; the fact with the campaigns' settings;
        and sentences about all starts, and about files and roads that cannot be read.

    Raises:
        CampaignError: an earlier campaign cannot be read, or none of its roads fits.
        FreneticError: no real road fits.
    """
    campaigns, tests, settings = take_earlier(folders, tester, objective, step)
    starts = [str(campaign) for campaign in campaigns]
    unread: list[str] = []
    if from_roads is not None:
        text, unread, roads = take_roads(from_roads, tester, step)
        starts, tests = [text, *starts], [*roads, *tests]
    notes = (*(f"starts from {start}" for start in starts), *unread)
    return campaigns, tests, settings, notes


def take_roads(
    folder: Path | str, tester: RoadTester, step: float | None
) -> tuple[str, list[str], list[Test]]:
    """Return stretches of the roads in a folder as tests, see `frenetic.road.real_roads`.

    The stretches are fitted to the rules of the new campaign's road class; invalid stretches are
    left out.

    Args:
        folder: of road files, see `frenetic.road.files.find_roads`.
        tester: of the new campaign.
        step: distance between two curvatures that the roads need, in m; None for any.

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
        candidate = Candidate(
            len(tests) + 1,
            road.curvatures,
            road.step,
            Origin(GIVEN),
            notes={GIVEN: name},
            **{name: getattr(road, name) for name in profile.NAMES},
        )
        if fitted(candidate, tester.terms)[1].valid:
            result = Result(Outcome.DROPPED, "a stretch of a real road, which nobody has driven")
            number = len(tests) + 1
            tests.append(
                Test(
                    candidate=candidate,
                    result=result,
                    result_number=number,
                    budget_spent=0.0,
                    attempts=0,
                )
            )
    if not tests:
        raise RoadError(
            f"nothing can be taken from {folder}: none of {counted(len(files.roads), 'road')} there"
            f" is 50 m long, with bends as wide as two lanes, and fits the map of"
            f" {tester.terms.map_size:g} m"
        )
    taken = f"{folder}: {counted(len(tests), 'stretch', 'stretches')} of"
    unread = f", {len(files.skipped)} could not be read" if files.skipped else ""
    reasons = [f"left out: {reason}" for reason in files.skipped[:_REASONS]]
    if len(files.skipped) > _REASONS:
        reasons.append(f"left out: {len(files.skipped) - _REASONS} more")
    limits = _limits_text([test.candidate for test in tests], tester)
    text = f"{taken} {counted(len(files.roads), 'real road')}{unread}; {limits}"
    return text, reasons, tests


def _limits_text(stretches: Sequence[Candidate], tester: RoadTester) -> str:
    """Return the speed limits on stretches, and the limit where a file says none, in words."""
    rules, class_name = tester.setting.rules_in({}), getattr(tester.terms.road_class, "name", "")
    if rules.road_limits == "ignored":
        return f"speed limit {rules.limit_text()}"
    steps = [
        profile.piece_of(profile.LIMITS, road.speed_limits, 0.0, road.length)
        for road in stretches
        if road.speed_limits is not None
    ]
    limits = [float(limit) for pairs in steps for limit in pairs[:, 1] if limit > 0.0]
    count = len(stretches) - sum(len(pairs) > 0 and bool(pairs[:, 1].all()) for pairs in steps)
    assumed = rules.limit_text(class_name=class_name)
    if not limits:
        return f"no file says a speed limit: {assumed}"
    text = f"speed limits of the files: {min(limits):.4g} to {max(limits):.4g} km/h"
    if rules.road_limits == "scaled":
        text += f", scaled until the highest of a road is {rules.speed_limit:.4g} km/h"
    return f"{text}; where {count} of them say none, {assumed}" if count else text


def take_earlier(
    folders: Sequence[Path | str], tester: RoadTester, objective: Objective, step: float | None
) -> tuple[tuple[EarlierCampaign, ...], list[Test], dict[str, JSONValue]]:
    """Take tests from the campaigns in folders; return them with the fact about their settings.

    The failures come first, then the passing tests, both by their MOOBD. A test that differs by
    less than 1 m (`frenetic.search.approach`) from a taken test is left out. A campaign gives at
    most 500 failures and 100 passing tests.

    Args:
        folders: of the campaigns.
        tester: of the new campaign, whose map the roads have to fit.
        objective: of the new campaign, measured on the stored drives.
        step: distance between two curvatures that the roads need, in m; None for any.

    Raises:
        CampaignError: a folder holds no campaign, a campaign is damaged, or no test fits.
    """
    near: dict[int, list[FloatArray]] = {}  # side -> vectors of the taken tests
    campaigns: list[EarlierCampaign] = []
    tests: list[Test] = []
    settings: dict[str, JSONValue] = {}
    for folder in folders:
        taken = left_out = 0
        with CampaignStore.open(Path(folder)) as store:
            for outcome, (most, looked_at) in _MOST.items():
                end = taken + most
                for record in store.tests(outcome, "moobd", looked_at):
                    if taken == end:
                        break
                    if not _fits(record.candidate, tester, step):
                        left_out += 1
                        continue
                    read_trajectory = partial(store.trajectory, record.id)
                    evaluation = evaluation_of(record, read_trajectory, objective)
                    is_known = evaluation.trace is not None and evaluation.moobd is not None
                    if is_known and _is_new(evaluation, near):
                        taken += 1
                        path = store.trajectory(record.id)
                        value = objective.value_of(evaluation)
                        tests.append(_taken(folder, record, path, value))
            counts = store.counts()
            names = [item.name for item in fields(DriveSetting) if item.name in store.config]
            settings[str(folder)] = {name: store.config[name] for name in names}
        campaigns.append(
            EarlierCampaign(str(folder), counts.simulations, counts.failures, taken, left_out)
        )
    if folders and not tests:
        raise CampaignError(
            f"nothing can be taken from {', '.join(map(str, folders))}: no drive there has records,"
            " a MOOBD, and a road that fits this map and the strategy's step; start without them"
        )
    return tuple(campaigns), tests, {EARLIER_SETTINGS: settings} if settings else {}


def _fits(road: Candidate, tester: RoadTester, step: float | None) -> bool:
    has_step = road.points is None and step in (None, road.step)
    return has_step and fitted(road, tester.terms)[1].valid


def _is_new(evaluation: Evaluation, near: dict[int, list[FloatArray]]) -> bool:
    """Return whether a test is near no other test, and add it to `near` then."""
    worst = critical_places(evaluation, evaluation.candidate, 0.0)[0]
    others = near.setdefault(worst.side, [])
    if others and nearest_square(np.array(others), worst.vector, _APART**2) < _APART**2:
        return False
    others.append(worst.vector)
    return True


def _taken(
    folder: Path | str, record: Test, path: Trajectory | None, objective: float | None
) -> Test:
    """Return a test of an earlier campaign as the new campaign keeps it."""
    road = record.candidate
    candidate = Candidate(
        road.id,
        road.curvatures,
        road.step,
        Origin(EARLIER),
        conditions=road.conditions,
        source=SourceTest(str(folder), road.id),
        **{name: getattr(road, name) for name in profile.NAMES},
    )
    return replace(
        record,
        candidate=candidate,
        budget_spent=0.0,
        reported_share=None,
        objective=objective,
        trajectory=path,
    )


def numbered(tests: Sequence[Test]) -> list[Test]:
    """Return the tests with numbers from 1 in this order, as candidates and as results."""
    return [
        replace(test, candidate=replace(test.candidate, id=number), result_number=number)
        for number, test in enumerate(tests, start=1)
    ]


def read_earlier(store: CampaignStore) -> list[Test]:
    """Return the tests that a campaign took from its warm start, without trajectories.

    Raises:
        CampaignError: a test is damaged.
    """
    tests = store.earlier()
    for test in tests:
        is_known = test.outcome.is_driven and test.moobd is not None and bool(test.records)
        if not is_known and test.outcome is not Outcome.DROPPED:
            raise CampaignError(
                f"{store.folder} is damaged: earlier test {test.id} is {test.outcome}, with a MOOBD"
                f" of {test.moobd} and {test.records} records; restore it from a copy"
            )
    return tests


def earlier_evaluations(store: CampaignStore, objective: Objective) -> list[Evaluation]:
    """Return the evaluations of a campaign's warm start for its strategy.

    The candidates come without the conditions in which they were driven.

    Args:
        store: the campaign.
        objective: its objective, measured on the drives.

    Raises:
        CampaignError: the campaign is damaged, or the objective has no value for a drive.
    """
    evaluations = []
    for test in read_earlier(store):
        read_trajectory = partial(store.earlier_trajectory, test.id)
        evaluation = evaluation_of(test, read_trajectory, objective)
        road = replace(test.candidate, conditions={})
        evaluations.append(replace(evaluation, candidate=road))
    return evaluations


def driven_again(store: CampaignStore) -> dict[int, Test]:
    """Return the tests that drove earlier roads again: id -> the earlier test.

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
    return {test: earlier[road] for test, *key in rows if (road := tuple(key)) in earlier}


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
    still = len(failing.intersection(had_failed))
    return f"{still} of {counted(len(had_failed), 'earlier failure')} driven again still failed"
