"""Earlier campaigns, and real roads, from which a search starts: what is taken from them.

Taken are roads that failed or came near failing, with their drives, as far as they fit the new
campaign. Their results are those of another driver, or of another version of it, so a strategy
drives them again instead of believing them. The new campaign's database keeps them, so that the
earlier campaign is needed no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from msgspec import Struct, convert, to_builtins

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, Index, NotNegative, Positive
from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted
from frenetic.campaign.objective import Objective, evaluation_of
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester, fitted
from frenetic.errors import CampaignError, RoadError
from frenetic.oracle import Side
from frenetic.outcome import Outcome
from frenetic.road import profile
from frenetic.road.files import find_roads
from frenetic.road.stretches import fitting, step_of, stretches_of
from frenetic.search.approach import nearest_square
from frenetic.search.archive import places_of
from frenetic.search.random_search import EARLIER, GIVEN
from frenetic.search.records import Candidate, Evaluation, Origin, Trace
from frenetic.spec import EarlierCampaign, earlier_of

_APART: Final = 1.0
"""Least difference of two taken tests, in m."""
_REASONS: Final = 10
"""Most files and roads that cannot be read and are named with their reason."""
_MOST: Final = {Outcome.FAIL: (500, 5000), Outcome.PASS: (100, 1000)}
"""Most tests that are taken, and that are looked at for it, of each campaign."""


@dataclass(frozen=True, eq=False)
class EarlierTest:
    """Test of an earlier campaign, or stretch of a real road, that a search starts from."""

    campaign: int
    """Number from 1 of the campaign among those that it starts from; 0 for a real road."""
    test: int
    """Id of the test there; 0 for a real road."""
    evaluation: Evaluation
    """Result, as the strategy is told it; its candidate counts from 1 in this order."""


def take_roads(
    folder: Path | str, tester: RoadTester, step: float | None
) -> tuple[str, list[str], list[EarlierTest]]:
    """The stretches of the roads in a folder, see `frenetic.road.stretches`, in words and as tests.

    They are fitted to the rules of the new campaign's road class. Those that are not valid in it
    are left out. Between the two stand sentences about files and roads that cannot be read.

    Args:
        folder: of road files, see `frenetic.road.files.find_roads`.
        tester: of the new campaign.
        step: m between two curvatures that the roads need, None for any.

    Raises:
        FreneticError: there is no road that fits.
    """
    found = find_roads([folder])
    stretches = stretches_of(found.roads, step_of(found.roads) if step is None else step)
    tests: list[EarlierTest] = []
    for name, road in stretches.items():
        if tester.road_class is not None:
            road = fitting(road, tester.road_class)
        candidate = Candidate(
            len(tests) + 1,
            road.curvatures,
            road.step,
            Origin(GIVEN),
            notes={GIVEN: name},
            **{name: getattr(road, name) for name in profile.NAMES},
        )
        if fitted(candidate, tester)[1].valid:
            tests.append(EarlierTest(0, 0, Evaluation(candidate, Outcome.DROPPED, None, 0.0)))
    if not tests:
        raise RoadError(
            f"nothing can be taken from {folder}: none of {counted(len(found.roads), 'road')} there"
            f" is 50 m long, with bends as wide as two lanes, and fits the map of"
            f" {tester.map_size:g} m"
        )
    taken = f"{folder}: {counted(len(tests), 'stretch', 'stretches')} of"
    unread = f", {len(found.skipped)} could not be read" if found.skipped else ""
    reasons = [f"left out: {reason}" for reason in found.skipped[:_REASONS]]
    if len(found.skipped) > _REASONS:
        reasons.append(f"left out: {len(found.skipped) - _REASONS} more")
    limits = _limits_in_words([test.evaluation.candidate for test in tests], tester)
    text = f"{taken} {counted(len(found.roads), 'real road')}{unread}; {limits}"
    return text, reasons, tests


def _limits_in_words(stretches: Sequence[Candidate], tester: RoadTester) -> str:
    """The speed limits on some stretches, and what is assumed where a file says none."""
    rules, class_name = tester.simulator.rules, getattr(tester.road_class, "name", "")
    if rules.road_limits == "ignored":
        return f"speed limit {rules.limit_in_words()}"
    steps = [
        profile.piece_of(profile.LIMITS, road.speed_limits, 0.0, road.length)
        for road in stretches
        if road.speed_limits is not None
    ]
    limits = [float(limit) for pairs in steps for limit in pairs[:, 1] if limit > 0.0]
    count = len(stretches) - sum(len(pairs) > 0 and bool(pairs[:, 1].all()) for pairs in steps)
    assumed = rules.limit_in_words(class_name=class_name)
    if not limits:
        return f"no file says a speed limit: {assumed}"
    text = f"speed limits of the files: {min(limits):.4g} to {max(limits):.4g} km/h"
    if rules.road_limits == "scaled":
        text += f", scaled until the highest of a road is {rules.speed_limit:.4g} km/h"
    return f"{text}; where {count} of them say none, {assumed}" if count else text


def take_earlier(
    folders: Sequence[Path | str], tester: RoadTester, objective: Objective, step: float | None
) -> tuple[tuple[EarlierCampaign, ...], list[EarlierTest]]:
    """What is taken from the campaigns in some folders.

    The failures come first, then the passing tests, both by their MOOBD. One that differs by less
    than 1 m (`frenetic.search.approach`) from a taken one is left out; so are those beyond 500
    failures and 100 passing tests of a campaign.

    Args:
        folders: of the campaigns.
        tester: of the new campaign, whose map the roads have to fit.
        objective: of the new campaign, measured on the stored drives.
        step: m between two curvatures that the roads need, None for any.

    Raises:
        CampaignError: there is no campaign in a folder, it is damaged, or nothing in it fits.
    """
    near: dict[int, list[FloatArray]] = {}  # by side, what was taken
    campaigns: list[EarlierCampaign] = []
    tests: list[EarlierTest] = []
    for number, folder in enumerate(folders, start=1):
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
                    told = evaluation_of(record, partial(store.trajectory, record.id), objective)
                    is_known = told.trace is not None and told.moobd is not None
                    if is_known and _is_new(told, near):
                        taken += 1
                        tests.append(_kept(number, record.id, told, len(tests) + 1))
            counts = store.counts()
        campaigns.append(
            EarlierCampaign(str(folder), counts.simulations, counts.failures, taken, left_out)
        )
    if folders and not tests:
        raise CampaignError(
            f"nothing can be taken from {', '.join(map(str, folders))}: no drive there has records,"
            " a MOOBD, and a road that fits this map and the strategy's step; start without them"
        )
    return tuple(campaigns), tests


def _fits(road: Candidate, tester: RoadTester, step: float | None) -> bool:
    has_step = road.points is None and step in (None, road.step)
    return has_step and fitted(road, tester)[1].valid


def _is_new(told: Evaluation, near: dict[int, list[FloatArray]]) -> bool:
    """Whether a test is near no other one, to which it is added then."""
    worst = places_of(told, told.candidate, 0.0)[0]
    others = near.setdefault(worst.side, [])
    if others and nearest_square(np.array(others), worst.vector, _APART**2) < _APART**2:
        return False
    others.append(worst.vector)
    return True


def _kept(campaign: int, test: int, told: Evaluation, number: int) -> EarlierTest:
    """A result under another number, which needs its campaign no more."""
    road, trace = told.candidate, told.trace
    slopes: dict[str, Any] = {name: getattr(road, name) for name in profile.NAMES}
    candidate = Candidate(number, road.curvatures, road.step, Origin(EARLIER), **slopes)
    told = replace(told, candidate=candidate, budget_spent=0.0, read_trace=lambda: trace)
    return EarlierTest(campaign, test, told)


def stored_earlier(
    store: CampaignStore,
) -> tuple[tuple[EarlierCampaign, ...], list[EarlierTest]]:
    """The campaigns from which a stored one started, and what it took from them.

    Raises:
        CampaignError: the stored campaign is damaged.
    """
    return earlier_of(store.config), read_earlier(store)


def driven_again(store: CampaignStore) -> dict[int, EarlierTest]:
    """Id of each test that drove the road of an earlier campaign again -> the test there.

    Raises:
        CampaignError: the campaign is damaged.
    """
    earlier = {
        (test.evaluation.candidate.step, test.evaluation.candidate.curvatures.tobytes()): test
        for test in read_earlier(store)
    }
    select = """
        SELECT id, step, curvatures FROM test
        WHERE operator = ? AND outcome IN ('PASS', 'FAIL')
    """
    rows = store.rows(select, (EARLIER,)) if earlier else ()
    return {test: earlier[road] for test, *key in rows if (road := tuple(key)) in earlier}


def still_failing(store: CampaignStore) -> str:
    """What became of the failures of earlier campaigns, in words; empty if none was driven again.

    Raises:
        CampaignError: the campaign is damaged.
    """
    repeats = store.repeats()
    had_failed = [
        number
        for number, test in driven_again(store).items()
        if test.evaluation.outcome is Outcome.FAIL and number not in repeats
    ]
    if not had_failed:
        return ""
    failing = {number for (number,) in store.rows("SELECT id FROM test WHERE outcome = 'FAIL'")}
    still = len(failing.intersection(had_failed))
    return f"{still} of {counted(len(had_failed), 'earlier failure')} driven again still failed"


class _Row(Struct):
    """An `EarlierTest` in the fact."""

    campaign: Index
    test: Index
    step: Positive
    outcome: Literal["PASS", "FAIL", "DROPPED"]
    moobd: Finite | None
    objective: Finite | None
    place: Finite | None
    side: Side | None
    duration: NotNegative | None
    arrays: dict[str, bytes]
    """Curvatures, profiles and trace: float64, in base64."""
    name: str | None = None
    """Of a real road."""


FACT: Final = "earlier"
"""Name of the fact with the tests that were taken."""
_OF_EVALUATION: Final = ("outcome", "moobd", "objective", "place", "side", "duration")
_OF_ROAD: Final = ("curvatures", *profile.NAMES)
_OF_TRACE: Final = ("distance", "lateral_offset", "speed")


def fact_of(tests: Sequence[EarlierTest]) -> dict[str, JSONValue]:
    """The fact with what was taken from earlier campaigns; none if nothing was."""
    return {FACT: [to_builtins(_row_of(test), builtin_types=()) for test in tests]} if tests else {}


def _row_of(test: EarlierTest) -> _Row:
    told, road = test.evaluation, test.evaluation.candidate
    arrays = {name: getattr(road, name) for name in _OF_ROAD}
    arrays |= {name: getattr(told.trace, name, None) for name in _OF_TRACE}
    return _Row(
        test.campaign,
        test.test,
        float(road.step),
        **{name: getattr(told, name) for name in _OF_EVALUATION},
        arrays={
            name: np.ascontiguousarray(values, np.float64).tobytes()
            for name, values in arrays.items()
            if values is not None
        },
        name=road.notes.get(GIVEN),
    )


def read_earlier(store: CampaignStore) -> list[EarlierTest]:
    """What a campaign took from earlier ones.

    Raises:
        CampaignError: it is damaged.
    """
    try:
        rows = convert(store.fact(FACT) or [], list[_Row])
        return [_test_of(number, row) for number, row in enumerate(rows, start=1)]
    except ValueError as error:
        raise CampaignError(
            f"{store.folder} is damaged: what it started from: {error}; restore it from a copy"
        ) from None


def _test_of(number: int, row: _Row) -> EarlierTest:
    arrays: dict[str, Any] = {name: np.frombuffer(data) for name, data in row.arrays.items()}
    road = {name: arrays[name] for name in _OF_ROAD if name in arrays}
    slopes = {name: values.reshape(-1, 2) for name, values in road.items() if name in profile.NAMES}
    is_driven = row.outcome != "DROPPED"
    trace = None
    if is_driven:
        trace = Trace(*(arrays.get(name, np.empty(0)) for name in _OF_TRACE))
        if not 1 <= len(trace.distance) == len(trace.lateral_offset) == len(trace.speed):
            raise ValueError("a drive has not as many offsets and speeds as distances")
        if row.moobd is None:
            raise ValueError("a drive has no MOOBD")
    candidate = Candidate(
        number,
        road.get("curvatures", np.empty(0)),
        row.step,
        Origin(EARLIER if is_driven else GIVEN),
        notes={} if row.name is None else {GIVEN: row.name},
        **slopes,
    )
    values: dict[str, Any] = {name: getattr(row, name) for name in _OF_EVALUATION}
    told = Evaluation(candidate, budget_spent=0.0, **values, read_trace=lambda: trace)
    return EarlierTest(row.campaign, row.test, told)
