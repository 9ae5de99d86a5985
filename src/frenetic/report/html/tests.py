"""Data of tests for the script of a page: a table of all tests, and some drives to replay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.failures import Failure, describe, describe_drive
from frenetic.campaign.record import Test, file_stem
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import SEED
from frenetic.criteria.criterion import DRIVER, LANE
from frenetic.errors import Fault
from frenetic.export.column import CONDITION, TableColumn, condition_column
from frenetic.export.failure_values import FailureAnalysis, cause_of_test, cause_text
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.drive_assessment import Assessment
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import measure
from frenetic.oracle.verdict import Finding, Result, Side, breach_text
from frenetic.report.failures import FAILURES
from frenetic.report.orientation import turn_of
from frenetic.rerun.minimised_roads import MINIMISED, minimised_drives
from frenetic.road import Road, profile
from frenetic.search.operator_names import OPERATOR_DESCRIPTIONS
from frenetic.search.records import Origin
from frenetic.search.road_families import FAMILIES
from frenetic.segments.causes import Cause
from frenetic.segments.evidence import evidence_of_result
from frenetic.segments.passing import PassingDrives
from frenetic.segments.segment import Segment

RATE: Final = 10.0
"""Rate of a drive's records in a page, in Hz; our choice."""
MOST_RECORDS: Final = 1500
"""Largest number of records of a drive in a page; our choice."""

COLUMNS: Final[Mapping[str, float]] = {
    "time": 0.01,  # [s]
    "x": 0.01,  # [m]
    "y": 0.01,  # [m]
    "heading": 0.001,  # [rad]
    "distance": 0.01,  # [m]
    "oob_distance": 0.01,  # [m]
    "speed": 0.01,  # [m/s]
    "steering": 0.001,  # [rad]
    "lateral_acceleration": 0.01,  # [m/s^2]
    "throttle": 0.01,  # [0..1]
    "brake": 0.01,  # [0..1]
}
"""Column of a drive -> resolution of its numbers, in the order of the columns."""
_RESOLUTIONS: Final = np.array([*COLUMNS.values()])[:, np.newaxis]


@dataclass(frozen=True, slots=True)
class TestSummary:
    """A test as the sections of a page need it."""

    __test__: ClassVar[bool] = False  # pytest would take the class for a test

    id: int
    outcome: Outcome
    moobd: float | None
    """Minimum oob distance, in m; None without one."""
    is_random: bool
    """Whether the road was drawn at random."""
    conditions: Mapping[str, float]
    """Name of a condition -> amount."""
    side: Side | None = None
    """Side on which the car left its lane; None if it stayed."""
    criteria: str | None = None
    """Names of the criteria that the drive exceeded, see `frenetic.oracle.Finding`, or None."""
    length: float = 0.0
    """Length of the road, in m."""
    duration: float | None = None
    """Simulated time of the drive, in s; None if nothing was driven."""
    is_repeat: bool = False
    """Whether the test repeats an earlier one: no measure counts it."""
    cause: Cause | Fault | None = None
    """What the driver did wrong; None without a failure, or if it was not read."""

    @classmethod
    def of(cls, record: Test, *, is_repeat: bool = False) -> TestSummary:
        """Return the summary of a stored test."""
        candidate, departure = record.candidate, record.departure
        criteria = [finding.criterion.replace("_", " ") for finding in record.result.findings]
        return cls(
            id=candidate.id,
            outcome=record.outcome,
            moobd=record.moobd,
            is_random=candidate.origin.operator in FAMILIES,
            conditions=candidate.conditions,
            side=None if departure is None else departure.side,
            criteria=", ".join(criteria) or None,
            length=candidate.step * (len(candidate.curvatures) - 1),
            duration=record.result.duration if record.outcome.is_driven else None,
            is_repeat=is_repeat,
            cause=cause_of_test(record),
        )


def table_of(tests: Iterable[TestSummary], analysis: FailureAnalysis) -> dict[str, list[Any]]:
    """Return the table of tests: name of a column -> values, one per test.

    Columns about failures and conditions in which no test has a value are left out.

    Args:
        tests: the tests.
        analysis: analysis of the campaign's failures.
    """
    rows = list(tests)
    names = dict.fromkeys(name for test in rows for name in test.conditions if name != SEED)
    always: dict[str, list[Any]] = {
        "id": [test.id for test in rows],
        "outcome": [test.outcome for test in rows],
        "moobd": [_rounded(test.moobd, 2) for test in rows],
        "side": [test.side for test in rows],
        "criteria": [test.criteria for test in rows],
        "length": [round(test.length) for test in rows],
        "duration": [_rounded(test.duration, 1) for test in rows],
    }
    optional: dict[str, list[Any]] = {
        "cause": [cause_text(test.cause) for test in rows],
        "certainty": [analysis.certainty_of(test.cause) for test in rows],
        "distinct": [analysis.numbers.get(test.id) for test in rows],
        "minimised": [_rounded(analysis.minimised_lengths.get(test.id), 0) for test in rows],
        **{f"{CONDITION}{name}": [test.conditions.get(name) for test in rows] for name in names},
    }
    present = {
        name: values
        for name, values in optional.items()
        if any(value is not None for value in values)
    }
    return {**always, **present}


def condition_titles(table: Iterable[str]) -> list[dict[str, str]]:
    """Return name and title of each column of a condition in the table of tests.

    Args:
        table: names of the table's columns.
    """
    names = [name.removeprefix(CONDITION) for name in table if name.startswith(CONDITION)]
    return [
        {"column": f"{CONDITION}{name}", "title": _condition_title(condition_column(name))}
        for name in names
    ]


def _condition_title(column: TableColumn) -> str:
    """Return the title of a condition's column, such as ``gust at (m)``."""
    words = column.name.removeprefix(CONDITION).replace("_", " ")
    return f"{words} ({column.unit})" if column.unit else words


@dataclass(frozen=True)
class Film:
    """A film beside a drive's replay."""

    pictures: str
    """Image of all pictures in rows, as a data URL."""
    columns: int
    """Number of pictures in a row of the image."""
    width: int
    """Width of a picture, in pixels."""
    height: int
    """Height of a picture, in pixels."""
    times: tuple[float, ...]
    """Time of each picture since the drive's start, in s."""
    caption: str


def road_data(road: Road) -> dict[str, Any]:
    """Return a road for the script, with curvatures rounded so that its end moves less than 5 cm.

    The data hold the angle of `turn_of`, and the profiles that are not 0 everywhere.
    """
    x, y, heading = road.pose
    profiles = {name: getattr(road, name).round(5).tolist() for name in profile.SHAPES}
    return {
        "step": road.step,
        "curvatures": road.curvatures.round(6).tolist(),
        "pose": (round(x, 3), round(y, 3), round(heading, 5)),
        "turn": round(turn_of(road), 3),
        "words": road.as_text(),
        **{name: pairs for name, pairs in profiles.items() if pairs},
    }


def drive_data(
    id: int,  # noqa: A002
    result: Result,
    segment: Segment,
    origin: Origin | None = None,
    failure: Failure | None = None,
    passing: PassingDrives | None = None,
) -> dict[str, Any]:
    """Return a test with its road and its drive for the script, a few kilobytes in SI units.

    Args:
        id: id of the test.
        result: result of the drive.
        segment: a segment of the drive; any will do.
        origin: origin of the candidate; None if it is not shown.
        failure: failure or near miss of the drive, if it is known.
        passing: passing drives of the same driver, if they are known.
    """
    happens = describe_drive(segment, result) if failure is None else describe(failure)
    drive, road, departure = segment.drive, segment.road, result.departure
    car, mistake = drive.car, evidence_of_result(segment, result, passing)
    return {
        "id": id,
        "outcome": result.outcome,
        "reason": result.reason,
        "happens": happens,
        "mistake": mistake and {"text": mistake.text, "time": round(mistake.time, 3)},
        "moobd": _rounded(result.moobd, 2),
        "moobd_distance": _rounded(result.moobd_distance, 2),
        "max_oob_share": _rounded(result.max_oob_share, 2),
        "duration": _rounded(result.duration, 2),
        "origin": origin and _origin_text(origin),
        "road": road_data(road),
        "car": [round(size, 3) for size in (car.length, car.width, car.centre_ahead)],
        "speed_limits": drive.rules.speed_limits_on(road).round(3).tolist(),
        "departure": departure and {"side": departure.side, **_time_and_place(departure)},
        "breaches": [
            {
                "words": breach_text([finding], drive.rules.criteria),
                **_time_and_place(finding),
            }
            for finding in result.findings
            if finding.criterion not in (LANE, DRIVER)
        ],
        "kept": _kept_criteria(result, segment),
        "columns": drive_columns(drive.trajectory, segment.assessment),
        "film": None,
        "road_file": None,
        "minimised": None,
    }


def _time_and_place(finding: Finding) -> dict[str, float]:
    """Return time and place of a finding, rounded."""
    names = ("time", "distance", "x", "y")
    return {name: round(getattr(finding, name), 3) for name in names}


def _origin_text(origin: Origin) -> str:
    """Return an origin in words: operator, parents, the operator's effect, generation."""
    parents = f" of {' and '.join(map(str, origin.parents))}" if origin.parents else ""
    description = OPERATOR_DESCRIPTIONS.get(origin.operator)
    effect = f": {description}" if description else ""
    return f"{origin.operator}{parents}{effect}; generation {origin.generation}"


def _kept_criteria(result: Result, segment: Segment) -> list[str]:
    """Return a text about each criterion that a drive kept, with the worst value."""
    if not result.outcome.is_driven:
        return []
    exceeded = {finding.criterion for finding in result.findings}
    criteria = segment.drive.rules.criteria.criteria
    measured = [
        measure(criterion, segment.signals)
        for criterion in criteria
        if criterion.signal not in exceeded
    ]
    return [value.text() for value in measured if value is not None]


def files_of(test_id: int, store: CampaignStore) -> dict[str, Any]:
    """Return the entries of `drive_data` about a test's files in a campaign's folder.

    ``road_file`` is the road's file, ``minimised`` the file and the drive of its minimised road.
    """
    name = f"{file_stem(test_id)}.json"
    has_file = (store.folder / FAILURES / name).is_file()
    road_file = f"{FAILURES}/{name}" if has_file else None
    data: dict[str, Any] = {"road_file": road_file, "minimised": None}
    for minimised in minimised_drives(store, [test_id]).values():  # at most one
        if (segment := minimised.segment) is not None:
            drive = drive_data(test_id, minimised.result, segment)
            data["minimised"] = {"drive": drive, "file": f"{MINIMISED}/{name}"}
    return data


def drive_columns(trajectory: Trajectory, assessment: Assessment) -> list[list[int]]:
    """Return the `COLUMNS` of a drive as small whole numbers.

    A value is a multiple of its column's resolution; a column holds the second differences of these
    multiples, which have few digits.
    """
    n = len(assessment.distance)
    shown = _shown_records(trajectory.time[:n], int(np.argmin(assessment.oob_distance)))
    sources = [trajectory if hasattr(trajectory, name) else assessment for name in COLUMNS]
    named = zip(sources, COLUMNS, strict=True)
    values = np.array([getattr(source, name)[:n][shown] for source, name in named])
    multiples = np.rint(values / _RESOLUTIONS).astype(np.int64)
    before = np.zeros((len(COLUMNS), 2), np.int64)
    columns: list[list[int]] = np.diff(multiples, n=2, prepend=before).tolist()
    return columns


def _shown_records(time: FloatArray, worst: int) -> np.ndarray:
    """Return indices of the records in the page, (k,): at `RATE`, the worst and the last one."""
    interval = max(1.0 / RATE, float(time[-1] - time[0]) / MOST_RECORDS)
    ticks = np.floor((time - time[0]) / interval + 1e-6)
    first = np.flatnonzero(np.diff(ticks, prepend=-1.0))
    return np.union1d(first, [worst, len(time) - 1])


def _rounded(value: float | None, digits: int) -> float | None:
    """Return a rounded number; None for None."""
    return None if value is None else round(value, digits)
