"""The tests of a page: a table of all tests, and some drives for replays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.failures import describe_drive
from frenetic.analysis.segments import Segment, segment_of_test
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.criteria.criterion import DRIVER, LANE
from frenetic.oracle.assessment import Assessment
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import measure
from frenetic.oracle.verdict import Result, Side, breach_text
from frenetic.report.failures import FAILURES, file_stem
from frenetic.report.minimised import MINIMISED, minimised_drives
from frenetic.report.orientation import turn_of
from frenetic.road import Road, profile
from frenetic.search.operator_names import OPERATOR_DESCRIPTIONS, RANDOM
from frenetic.search.records import Origin

RATE: Final = 10.0
"""Rate of a drive's records in a page, in Hz."""
MOST_RECORDS: Final = 1500
"""Most records of a drive in a page."""

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
"""Columns of a drive, in their order -> resolution."""


@dataclass(frozen=True, slots=True)
class TestSummary:
    """Data of a test for a page."""

    __test__: ClassVar[bool] = False  # no test class of pytest's

    id: int
    outcome: Outcome
    moobd: float | None
    """m."""
    is_random: bool
    """Whether its road was drawn at random."""
    conditions: Mapping[str, float]
    side: Side | None = None
    """Side on which the car left its lane; None if it did not."""
    criteria: str | None = None
    """The criteria by which it failed, see `frenetic.oracle.Finding`; None without one."""
    length: float = 0.0
    """Length of the road, in m."""
    duration: float | None = None
    """Simulated time of the drive, in s; None without one."""
    is_repeat: bool = False
    """Whether it repeats an earlier test, and so counts in no measure."""

    @classmethod
    def of(cls, record: Test, *, is_repeat: bool = False) -> TestSummary:
        """Return the summary of a stored test."""
        candidate, departure = record.candidate, record.departure
        return cls(
            candidate.id,
            record.outcome,
            record.moobd,
            candidate.origin.operator == RANDOM,
            candidate.conditions,
            None if departure is None else departure.side,
            ", ".join(finding.criterion.replace("_", " ") for finding in record.result.findings)
            or None,
            candidate.step * (len(candidate.curvatures) - 1),
            record.result.duration if record.outcome.is_driven else None,
            is_repeat,
        )


def table_of(tests: Iterable[TestSummary]) -> dict[str, list[Any]]:
    """Return columns of equal length, a row per test."""
    rows = list(tests)
    return {
        "id": [test.id for test in rows],
        "outcome": [test.outcome for test in rows],
        "moobd": [_rounded(test.moobd, 2) for test in rows],
        "side": [test.side for test in rows],
        "criteria": [test.criteria for test in rows],
        "length": [round(test.length) for test in rows],
        "duration": [_rounded(test.duration, 1) for test in rows],
    }


@dataclass(frozen=True)
class Film:
    """Pictures beside a drive's replay."""

    pictures: str
    """All pictures as one image, `columns` beside each other, as a data URL."""
    columns: int
    width: int
    """Width of a picture."""
    height: int
    times: tuple[float, ...]
    """Time of each picture since the drive's start, in s."""
    caption: str


def road_data(road: Road) -> dict[str, Any]:
    """Return a road as its curvatures, rounded so that its end moves by less than 5 cm.

    ``turn`` is the angle in rad by which pictures turn it counter-clockwise, see `turn_of`. Of its
    profiles it has those that are not 0 everywhere.
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
) -> dict[str, Any]:
    """Return a test with its road and its drive, in SI units, a few kilobytes of JSON.

    Args:
        id: id of the test.
        result: result of the drive.
        segment: any segment of the drive.
        origin: origin of the candidate.
    """
    drive, road, departure = segment.drive, segment.road, result.departure
    car = drive.car
    return {
        "id": id,
        "outcome": result.outcome,
        "reason": result.reason,
        "happens": describe_drive(segment, result),
        "moobd": _rounded(result.moobd, 2),
        "moobd_distance": _rounded(result.moobd_distance, 2),
        "max_oob_share": _rounded(result.max_oob_share, 2),
        "duration": _rounded(result.duration, 2),
        "origin": origin and _origin_text(origin),
        "road": road_data(road),
        "car": [round(size, 3) for size in (car.length, car.width, car.centre_ahead)],
        "speed_limits": drive.rules.speed_limits_on(road).round(3).tolist(),
        "departure": departure
        and {
            "side": departure.side,
            **{name: round(getattr(departure, name), 3) for name in ("time", "distance", "x", "y")},
        },
        "breaches": [
            {
                "words": breach_text([finding], drive.rules.criteria),
                **{
                    name: round(getattr(finding, name), 3)
                    for name in ("time", "distance", "x", "y")
                },
            }
            for finding in result.findings
            if finding.criterion not in (LANE, DRIVER)
        ],
        "kept": _kept(result, segment),
        "columns": drive_columns(drive.trajectory, segment.assessment),
        "film": None,
        "road_file": None,
        "minimised": None,
    }


def _origin_text(origin: Origin) -> str:
    parents = f" of {' and '.join(map(str, origin.parents))}" if origin.parents else ""
    description = OPERATOR_DESCRIPTIONS.get(origin.operator)
    does = f": {description}" if description else ""
    return f"{origin.operator}{parents}{does}; generation {origin.generation}"


def _kept(result: Result, segment: Segment) -> list[str]:
    """Return the criteria that a drive kept, with the worst values, in words."""
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
    """Return a test's files in a campaign's folder: its road, and its minimised road's drive."""
    name = f"{file_stem(test_id)}.json"
    has_file = (store.folder / FAILURES / name).is_file()
    road_file = f"{FAILURES}/{name}" if has_file else None
    data: dict[str, Any] = {"road_file": road_file, "minimised": None}
    for short in minimised_drives(store, [test_id]).values():
        if (segment := segment_of_test(short)) is not None:
            drive = drive_data(test_id, short.result, segment)
            data["minimised"] = {"drive": drive, "file": f"{MINIMISED}/{name}"}
    return data


def drive_columns(path: Trajectory, assessment: Assessment) -> list[list[int]]:
    """Return `COLUMNS` of a drive in multiples of their resolution, as second differences."""
    n = len(assessment.distance)
    taken = _taken(path.time[:n], int(np.argmin(assessment.oob_distance)))
    columns = []
    for name, resolution in COLUMNS.items():
        values: FloatArray = getattr(path if hasattr(path, name) else assessment, name)
        whole = np.rint(values[:n][taken] / resolution).astype(np.int64)
        columns.append(np.diff(whole, n=2, prepend=[0, 0]).tolist())
    return columns


def _taken(time: FloatArray, worst: int) -> np.ndarray:
    """Return indices of records, (k,): at `RATE`, at the least oob distance, and the last."""
    interval = max(1.0 / RATE, float(time[-1] - time[0]) / MOST_RECORDS)
    ticks = np.floor((time - time[0]) / interval + 1e-6)
    first = np.flatnonzero(np.diff(ticks, prepend=-1.0))
    return np.union1d(first, [worst, len(time) - 1])


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
