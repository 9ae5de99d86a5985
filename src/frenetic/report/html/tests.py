"""The tests of a page: all as columns, and the drives of some, for showing and replaying."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.segments import Segment
from frenetic.campaign.record import Test
from frenetic.drive import Trajectory
from frenetic.errors import FreneticError
from frenetic.oracle import Assessment, Finding, Result, Side
from frenetic.outcome import Outcome
from frenetic.report.failures import FAILURES, file_stem
from frenetic.report.minimised import MINIMISED
from frenetic.report.orientation import turn_of
from frenetic.road import Road
from frenetic.road.files import read_road
from frenetic.search.operators import DOES
from frenetic.search.records import Origin

LETTERS: Final[Mapping[Outcome, str]] = {outcome: str(outcome)[0] for outcome in Outcome}
"""An outcome in one letter."""


@dataclass(frozen=True, slots=True)
class TestSummary:
    """The data of any test for a page."""

    __test__: ClassVar[bool] = False  # no test class of pytest's

    id: int
    outcome: Outcome
    moobd: float | None
    """m."""
    elapsed: float | None
    """Campaign time when it was told, in s."""
    origin: Origin
    side: Side | None = None
    """Side on which the car left its lane; None if it did not."""
    length: float = 0.0
    """Length of the road, in m."""
    duration: float | None = None
    """Simulated time of the drive, in s; None without one."""

    @classmethod
    def of(cls, record: Test) -> TestSummary:
        """The summary of a stored test."""
        candidate, departure = record.candidate, record.departure
        return cls(
            candidate.id,
            record.outcome,
            record.moobd,
            record.elapsed,
            candidate.origin,
            None if departure is None else departure.side,
            candidate.step * (len(candidate.curvatures) - 1),
            record.result.duration if record.outcome.is_driven else None,
        )


@dataclass(frozen=True)
class TestTable:
    """Columns of equal length, a row per test."""

    __test__: ClassVar[bool] = False  # likewise

    ids: tuple[int, ...]
    outcomes: str
    """A letter per test, see `LETTERS`."""
    moobds: tuple[int | None, ...]
    """cm."""
    operators: tuple[str, ...]
    """All operators."""
    operators_do: tuple[str, ...]
    """Description of each of them; empty if unknown."""
    operator: tuple[int, ...]
    """Operator of each test, as an index."""
    parents: tuple[tuple[int, ...], ...]
    sides: str
    """A letter per test: l or r where the car left its lane, - where it did not."""
    lengths: tuple[int, ...]
    """Of the roads, in m."""
    durations: tuple[int | None, ...]
    """Of the drives, in 0.1 s."""

    @classmethod
    def of(cls, tests: Iterable[TestSummary]) -> TestTable:
        """The table of some tests."""
        rows = list(tests)
        operators = sorted({test.origin.operator for test in rows})
        place = {name: i for i, name in enumerate(operators)}
        return cls(
            ids=tuple(test.id for test in rows),
            outcomes="".join(LETTERS[test.outcome] for test in rows),
            moobds=tuple(
                None if test.moobd is None else round(100.0 * test.moobd) for test in rows
            ),
            operators=tuple(operators),
            operators_do=tuple(DOES.get(name, "") for name in operators),
            operator=tuple(place[test.origin.operator] for test in rows),
            parents=tuple(tuple(test.origin.parents) for test in rows),
            sides="".join("-" if test.side is None else test.side[0] for test in rows),
            lengths=tuple(round(test.length) for test in rows),
            durations=tuple(
                None if test.duration is None else round(10.0 * test.duration) for test in rows
            ),
        )


# The drives, a few kilobytes of JSON each

RATE: Final = 10.0
"""Kept records per second, in Hz."""
MOST_RECORDS: Final = 1500
"""Most kept records of a drive."""
DRIVES_SIZE: Final = 3_500_000
"""Approximate bytes of JSON for all drives of a page."""

_COLUMNS: Final[Mapping[str, float]] = {
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
"""Column -> its resolution; the page divides by the same numbers, see ``road.js``."""


@dataclass(frozen=True)
class RoadData:
    """A road as its curvatures, which give its exact shape."""

    step: float
    """m."""
    curvatures: tuple[float, ...]
    """1/m."""
    pose: tuple[float, float, float]
    """Pose of the first sample, in m, m and rad."""
    turn: float
    """Angle in rad by which pictures turn it counter-clockwise, see `turn_of`."""

    @classmethod
    def of(cls, road: Road) -> RoadData:
        """The data of a road, rounded so that its end moves by less than 5 cm."""
        x, y, heading = road.pose
        return cls(
            road.step,
            tuple(road.curvatures.round(6).tolist()),
            (round(x, 3), round(y, 3), round(heading, 5)),
            round(turn_of(road), 3),
        )


@dataclass(frozen=True)
class Film:
    """Pictures that are shown beside a drive's replay."""

    pictures: str
    """All pictures as one image, `columns` beside each other, as a data URL."""
    columns: int
    width: int
    """Width of one of them."""
    height: int
    times: tuple[float, ...]
    """Time of each since the drive's start, in s."""
    caption: str

    @property
    def size(self) -> int:
        """Approximate bytes of its JSON."""
        return len(self.pictures) + 8 * len(self.times)


@dataclass(frozen=True)
class MinimisedData:
    """A minimised road."""

    road: RoadData
    file: str
    """Path in the campaign's folder."""


@dataclass(frozen=True)
class DriveData:
    """A test with its road and its drive."""

    id: int
    outcome: str
    reason: str
    moobd: float | None
    """m."""
    moobd_distance: float | None
    """Distance along the road, in m."""
    max_oob_share: float | None
    """0..1."""
    duration: float | None
    """s."""
    side: Side | None
    generation: int
    road: RoadData
    car: tuple[float, float, float]
    """m: length, width, centre_ahead."""
    speed_limit: float
    """km/h."""
    departure: Finding | None
    columns: tuple[tuple[int, ...], ...]
    """See `drive_columns`."""
    film: Film | None
    """What is shown beside its replay, if anything and there is room."""
    road_file: str | None
    """The road's file in the campaign's folder, if any."""
    minimised: MinimisedData | None
    """The shortest known road that fails alike, if any."""

    @property
    def size(self) -> int:
        """Approximate bytes of its JSON."""
        own = 400 + 10 * len(self.road.curvatures) + len(self.reason)
        return own + columns_size(self.columns)

    def with_files(self, folder: Path) -> DriveData:
        """The same with the files that the campaign's folder holds now."""
        name = f"{file_stem(self.id)}.json"
        return replace(
            self,
            road_file=f"{FAILURES}/{name}" if (folder / FAILURES / name).is_file() else None,
            minimised=_minimised(folder, f"{MINIMISED}/{name}"),
        )


def drive_data(record: Test, segment: Segment) -> DriveData:
    """The data of a test for a page, without files.

    Args:
        record: of the test.
        segment: of its drive, any.
    """
    return drive_data_of(
        record.id, record.result, segment, generation=record.candidate.origin.generation
    )


def drive_data_of(
    id: int,  # noqa: A002
    result: Result,
    segment: Segment,
    *,
    generation: int = 0,
) -> DriveData:
    """The data of a drive with its verdict; see `DriveData` for the arguments."""
    drive, road, departure = segment.drive, segment.road, result.departure
    return DriveData(
        id=id,
        outcome=str(result.outcome),
        reason=result.reason,
        moobd=_rounded(result.moobd, 3),
        moobd_distance=_rounded(result.moobd_distance, 2),
        max_oob_share=_rounded(result.max_oob_share, 3),
        duration=_rounded(result.duration, 2),
        side=None if departure is None else departure.side,
        generation=generation,
        road=RoadData.of(road),
        car=(
            round(drive.car.length, 3),
            round(drive.car.width, 3),
            round(drive.car.centre_ahead, 3),
        ),
        speed_limit=drive.rules.speed_limit,
        departure=None if departure is None else _rounded_departure(departure),
        columns=drive_columns(drive.trajectory, segment.assessment),
        film=None,
        road_file=None,
        minimised=None,
    )


def drive_columns(path: Trajectory, seen: Assessment) -> tuple[tuple[int, ...], ...]:
    """Columns of `_COLUMNS` in multiples of their resolution, as second differences."""
    n = len(seen.distance)
    taken = _taken(path.time[:n], int(np.argmin(seen.oob_distance)))
    values: dict[str, FloatArray] = {
        "distance": seen.distance,
        "oob_distance": seen.oob_distance,
        **{name: getattr(path, name) for name in _COLUMNS if hasattr(path, name)},
    }
    columns = []
    for name, resolution in _COLUMNS.items():
        whole = np.rint(values[name][:n][taken] / resolution).astype(np.int64)
        columns.append(tuple(np.diff(whole, n=2, prepend=[0, 0]).tolist()))
    return tuple(columns)


def columns_size(columns: tuple[tuple[int, ...], ...]) -> int:
    """Approximate bytes of the JSON of such columns."""
    return int(2.6 * sum(map(len, columns)))


def _taken(time: FloatArray, worst: int) -> np.ndarray:
    """Kept records, (k,): at `RATE`, the last, and that of the minimum oob distance."""
    interval = max(1.0 / RATE, float(time[-1] - time[0]) / MOST_RECORDS)
    ticks = np.floor((time - time[0]) / interval + 1e-6)
    first = np.flatnonzero(np.diff(ticks, prepend=-1.0))
    return np.union1d(first, [worst, len(time) - 1])


def _minimised(folder: Path, file: str) -> MinimisedData | None:
    """A minimised road from its file; None for any other file."""
    path = folder / file
    try:
        return MinimisedData(RoadData.of(read_road(path).road()), file) if path.is_file() else None
    except (FreneticError, OSError):
        return None


def _rounded_departure(place: Finding) -> Finding:
    names = ("time", "distance", "x", "y")
    return replace(place, **{name: round(getattr(place, name), 3) for name in names})


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
