"""Recorded drives to calibrate on: campaigns, test files of the competition, tables.

A folder is a campaign, a folder of campaigns, a folder of test files (JSON, one drive each), or an
export with the table tests.jsonl. A file is a test file or a table: JSON Lines, a row per drive.
The entries of a row are those of a test file; docs/calibrating.md lists them. Only a road and the
outcome are needed.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct
from threadpoolctl import threadpool_limits

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, Positive, Share
from frenetic._support.files import require_list
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.drive import Rules
from frenetic.errors import FreneticError, RoadError
from frenetic.export.competition import SimulationRecord
from frenetic.oracle import assess
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.road.files import RoadEntries, RoadFile
from frenetic.search.records import Trace

GRID: Final = 2.0
"""Distance along the road between two places where drives are compared, in m."""
TABLE: Final = ".jsonl"
"""How the name of a table ends."""

Read = TypeVar("Read")


class Terms(Struct, frozen=True, kw_only=True):
    """The terms of recorded drives; None where nobody says."""

    speed_limit: Positive | None = None
    """km/h."""
    oob_tolerance: Share | None = None
    lane_width: Positive | None = None
    """m."""
    map_size: Positive | None = None
    """m."""


_USUAL: Final = Terms(speed_limit=70.0, oob_tolerance=0.95, lane_width=4.0, map_size=200.0)


@dataclass(frozen=True, eq=False)
class RecordedDrive:
    """A recorded drive; NaN stands for what the recording does not say."""

    name: str
    recording: str
    """Path of the folder or file that it is from."""
    run: str
    """Name of the run that drove it, such as one campaign; unique over all recordings."""
    road: Road
    rules: Rules
    failed: bool
    max_oob_share: float = math.nan
    mean_oob_distance: float = math.nan
    """m."""
    std_steering: float = math.nan
    offset: FloatArray = field(default_factory=lambda: np.empty(0))
    """Offset left of the ego lane's centre every `GRID` m, (n,) in m, NaN where it did not come."""
    speed: FloatArray = field(default_factory=lambda: np.empty(0))
    """Speed there, (n,) in m/s, likewise."""


@dataclass(frozen=True, eq=False)
class Recordings:
    """All recorded drives, driven under the same terms."""

    drives: tuple[RecordedDrive, ...]
    terms: Terms
    places: tuple[str, ...]
    """Files and folders."""
    skipped: int
    """Number of tests that were not driven or broke."""

    @property
    def runs(self) -> list[str]:
        """Names of the runs, in order."""
        return list(dict.fromkeys(drive.run for drive in self.drives))


def read_recordings(places: Iterable[Path | str], given: Terms | None = None) -> Recordings:
    """Reads recorded drives.

    Args:
        places: files and folders.
        given: terms that hold whatever a recording says.

    Raises:
        FreneticError: one of them cannot be read or is damaged, they hold no drive that passed or
            failed, or they were driven under different terms.
    """
    drives: list[RecordedDrive] = []
    read: list[str] = []
    found: dict[Terms, str] = {}
    skipped = 0
    for place in map(Path, require_list("places", places, "files and folders")):
        if str(place) in read:
            raise FreneticError(f"{place} is given twice: once is enough")
        read.append(str(place))
        before = len(drives)
        with threadpool_limits(1):  # threads would wait for each other on small matrices
            for name, own, drives_of in _sources(place):
                terms = _first_told(given or Terms(), own, _USUAL)
                found.setdefault(terms, name)
                several = list(drives_of(terms))
                drives += [drive for drive in several if drive is not None]
                skipped += several.count(None)
        if len(drives) == before:
            raise FreneticError(f"{place} holds no drive that passed or failed")
    if len(found) > 1:
        (one, first), (other, second), *_ = found.items()
        words = " and ".join(
            f"{k} {getattr(one, k):g} and {getattr(other, k):g}"
            for k in Terms.__struct_fields__
            if getattr(one, k) != getattr(other, k)
        )
        raise FreneticError(
            f"{first} and {second} were driven under different terms ({words}): calibrate them one"
            " by one, or say in a file which hold for all"
        )
    return Recordings(tuple(drives), next(iter(found)), tuple(read), skipped)


def _first_told(*several: Terms) -> Terms:
    return Terms(
        **{
            name: next((v for one in several if (v := getattr(one, name)) is not None), None)
            for name in Terms.__struct_fields__
        }
    )


# Places

_Source: TypeAlias = tuple[str, Terms, Callable[[Terms], Iterator[RecordedDrive | None]]]
"""Name, terms and drives of a campaign, folder of test files or table."""


def _sources(place: Path) -> Iterator[_Source]:
    if not place.exists():
        raise FreneticError(f"there is no file or folder {place}")
    if place.is_file():
        yield _table(place, place) if place.suffix == TABLE else _files(place, [place])
        return
    if (place / DATABASE).is_file() or any(place.glob(f"*/{DATABASE}")):
        for folder in find_campaigns(place):
            yield _campaign(place, folder)
        return
    if (table := place / f"tests{TABLE}").is_file():
        yield _table(place, table)
        return
    folders = sorted({file.parent for file in [*place.glob("*.json"), *place.glob("*/*.json")]})
    if not folders:
        raise FreneticError(
            f"{place} holds no recording: a campaign, test files (.json) or tests{TABLE} is needed"
        )
    for folder in [place] if place in folders else folders:
        yield _files(place, sorted(folder.glob("*.json")))


def _campaign(place: Path, folder: Path) -> _Source:
    def drives(terms: Terms) -> Iterator[RecordedDrive | None]:
        with CampaignStore.open(folder) as store:
            for test in store.tests(with_trajectory=True):
                drive = test.drive
                if not test.outcome.is_driven or drive is None:
                    yield None
                    continue
                seen = assess(test.road, drive)
                n = len(seen.distance)
                path = drive.trajectory
                offset, speed = on_grid(seen.distance, seen.lateral_offset, path.speed[:n])
                yield RecordedDrive(
                    name=f"test {test.id}",
                    recording=str(place),
                    run=str(folder),
                    road=_with_width(test.road, terms),
                    rules=_rules(terms),
                    failed=test.outcome is Outcome.FAIL,
                    max_oob_share=float(seen.oob_share.max()),
                    mean_oob_distance=float(seen.oob_distance.mean()),
                    std_steering=float(path.steering[:n].std()),
                    offset=offset,
                    speed=speed,
                )

    with CampaignStore.open(folder) as store:
        setting = store.setting
    terms = Terms(
        speed_limit=setting.rules.speed_limit,
        oob_tolerance=setting.rules.oob_tolerance,
        lane_width=setting.lane_width,
        map_size=setting.map_size,
    )
    return str(folder), terms, drives


def _files(place: Path, files: Sequence[Path]) -> _Source:
    folder = files[0].parent

    def drives(terms: Terms) -> Iterator[RecordedDrive | None]:
        for file in files:
            yield _drive_of(_json(_read(file), file), file, file.name, (place, folder), terms)

    described = folder / "experiment_description.csv"
    row: dict[str, str] = {}
    if described.is_file():
        row = next(csv.DictReader(io.StringIO(_read(described))), {})
    told = {name: value for name, value in row.items() if value}
    return str(folder), _converted(told, Terms, described, strict=False), drives


def _table(place: Path, table: Path) -> _Source:
    def drives(terms: Terms) -> Iterator[RecordedDrive | None]:
        for i, line in enumerate(_read(table).split("\n"), start=1):
            if line.strip():
                where = f"{table}, row {i}"
                yield _drive_of(_json(line, where), where, f"row {i}", (place, place), terms)

    return str(table), Terms(), drives


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FreneticError(f"{path} is no text in UTF-8") from None


def _json(text: str, where: object) -> dict[str, Any]:
    try:
        return msgspec.json.decode(text, type=dict[str, Any])
    except (ValueError, RecursionError) as error:
        raise FreneticError(f"{where} holds no object of JSON: {error}") from None


def _converted(value: object, kind: type[Read], where: object, *, strict: bool = True) -> Read:
    try:
        return msgspec.convert(value, kind, strict=strict)
    except (ValueError, OverflowError) as error:
        raise FreneticError(f"{where}: {error}") from None


# A drive

Vector: TypeAlias = Annotated[list[Finite], Meta(min_length=2)]


class Judged(Struct):
    """The entries of a test file or row that say how its drive ended."""

    outcome: Outcome | None = None
    test_outcome: Outcome | None = None
    """The same in the competition's files."""


class Course(Struct):
    """A trajectory as columns."""

    time: list[Finite]
    x: list[Finite]
    y: list[Finite]
    speed: list[float] = []
    """m/s; worked out where it is unknown."""


class Record(Struct):
    """A record of the competition's."""

    timer: Finite
    pos: Vector
    dir: Vector
    vel: Vector
    steering: Finite
    oob_distance: Finite
    oob_percentage: Finite


class Row(RoadEntries):
    """The entries of a test file or row that describe its road and drive."""

    run: Any = None
    max_oob_share: Finite | None = None
    mean_oob_distance: Finite | None = None
    std_steering: Finite | None = None
    trajectory: Course | None = None
    execution_data: list[Record] | None = None


def _drive_of(
    entries: Mapping[str, Any], where: object, name: str, places: tuple[Path, Path], terms: Terms
) -> RecordedDrive | None:
    """The drive of a test file or of a row; None if the road was not driven or the drive broke.

    Args:
        entries: of the file or row.
        where: they stand, for messages.
        name: of the drive.
        places: of its recording and of its run.
        terms: of the recording.
    """
    judged = _converted(entries, Judged, where)
    outcome = judged.outcome or judged.test_outcome
    if outcome is None:
        raise FreneticError(f"{where} has no outcome: PASS or FAIL is needed")
    if not outcome.is_driven:
        return None
    if isinstance(records := entries.get("execution_data"), list):
        named = [
            dict(zip(SimulationRecord._fields, one, strict=False)) if isinstance(one, list) else one
            for one in records
        ]
        entries = {**entries, "execution_data": named}
    row = _converted(entries, Row, where)
    row.lane_width = terms.lane_width or row.lane_width
    if row.curvatures is None and row.road_points is None:
        raise FreneticError(f"{where} has neither 'curvatures' nor 'road_points'")
    try:
        road = RoadFile(Path(str(where)), row).road()
    except RoadError as error:
        raise FreneticError(str(error)) from None
    path = offset = speed = np.empty(0)
    measured: dict[str, float] = {}
    if row.execution_data:
        path, speed, measured = _competition_records(row.execution_data, where)
    elif row.trajectory:
        path, speed = _trajectory(row.trajectory, where)
    if len(path):
        along = Trace.along(road, path, speed)
        offset, speed = on_grid(along.distance, along.lateral_offset, along.speed)
    measured |= {
        key: value
        for key in ("max_oob_share", "mean_oob_distance", "std_steering")
        if (value := getattr(row, key)) is not None
    }
    recording, run = map(str, places)
    return RecordedDrive(
        name=name,
        recording=recording,
        run=run if row.run is None else f"{run}, {row.run}",
        road=road,
        rules=_rules(terms),
        failed=outcome is Outcome.FAIL,
        offset=offset,
        speed=speed,
        **measured,
    )


def _rules(terms: Terms) -> Rules:
    try:
        return Rules(speed_limit=terms.speed_limit or 0.0, oob_tolerance=terms.oob_tolerance or 0.0)
    except ValueError as error:
        raise FreneticError(str(error)) from None


def _with_width(road: Road, terms: Terms) -> Road:
    if terms.lane_width in (None, road.lane_width):
        return road
    return replace(road, lane_width=terms.lane_width)


def _trajectory(given: Course, where: object) -> tuple[FloatArray, FloatArray]:
    """(path, speed) of a trajectory."""
    n = len(given.time)
    if n < 2 or {len(given.x), len(given.y)} != {n} or len(given.speed) not in (0, n):
        raise FreneticError(f"{where}: its trajectory needs as many times as places, two or more")
    time, path = np.array(given.time), np.column_stack((given.x, given.y))
    if (np.diff(time) < 0.0).any():
        raise FreneticError(f"{where}: its trajectory is not in the order of time")
    speed = np.array(given.speed)
    if not len(speed) or not np.isfinite(speed).all():
        gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        times, first = np.unique(time, return_index=True)
        if len(times) < 2:
            raise FreneticError(f"{where}: all records of its trajectory are of one time")
        at = np.gradient(gone[first], times)
        speed = np.interp(time, times, at)
    return path, speed


def _competition_records(
    records: Sequence[Record], where: object
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """(path, speed, measures) of the competition's records."""
    places = ([r.pos[i] for r in records] for i in (0, 1))
    path, _ = _trajectory(Course([r.timer for r in records], *places), where)
    ahead, moving = (
        np.array([getattr(r, name)[:2] for r in records], dtype=np.float64)
        for name in ("dir", "vel")
    )
    measures = {
        "max_oob_share": float(max(r.oob_percentage for r in records)),
        "mean_oob_distance": float(np.mean([r.oob_distance for r in records])),
        "std_steering": float(np.std([r.steering for r in records])),
    }
    return path, (moving * ahead).sum(axis=1), measures


def on_grid(
    distance: FloatArray, offset: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Offset and speed every `GRID` m from the road's start; NaN before the first record."""
    ahead = np.maximum.accumulate(distance)
    keep = np.concatenate(([True], np.diff(ahead) > 0.0))
    places = GRID * np.arange(math.floor(ahead[-1] / GRID) + 1)
    columns = []
    for values in (offset, speed):
        column = np.interp(places, ahead[keep], values[keep])
        column[places < ahead[0] - 0.5 * GRID] = np.nan
        columns.append(column)
    return columns[0], columns[1]
