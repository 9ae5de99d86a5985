"""Recorded drives to calibrate on: campaigns, test files of the competition, tables.

A folder is a campaign, a folder of campaigns, a folder of test files (JSON, one drive each), or an
export with a table of tests. A file is a test file or a table: JSON Lines, CSV or Parquet, one row
per drive. The entries of a row are those of a test file; docs/calibrating.md lists them. Only a
road and the outcome are needed, and everything is validated.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from frenetic._support.arrays import FloatArray
from frenetic._support.files import require_list
from frenetic._support.words import pip_install
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.database import DATABASE
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Rules
from frenetic.errors import FreneticError, RoadError
from frenetic.oracle import LEFT_LANE, assess
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.road.files import road_file
from frenetic.search.records import Trace
from frenetic.spec import shown

GRID: Final = 2.0
"""Distance along the road between two places where drives are compared, in m."""
MAX_ROWS: Final = 200_000
"""Most drives of a table."""
MAX_BYTES: Final = 2**30
"""Most bytes of a file."""

_TABLES: Final = (".jsonl", ".ndjson", ".csv", ".parquet")
_RUN: Final = ("recording", "search", "run")
_RECORD: Final = {"timer": 0, "pos": 1, "dir": 2, "vel": 3, "steering": 4}
_OOB_DISTANCE, _OOB_SHARE = 15, 16  # places in the competition's records


@dataclass(frozen=True)
class Terms:
    """The terms of recorded drives; None where the recording does not say and nobody else."""

    speed_limit: float | None = None
    """km/h."""
    oob_tolerance: float | None = None
    lane_width: float | None = None
    """m."""
    map_size: float | None = None
    """m."""

    def or_else(self, other: Terms) -> Terms:
        """These terms, and what they lack from others."""
        own = {k: v for k, v in vars(self).items() if v is not None}
        return replace(other, **own)


USUAL: Final = Terms(70.0, 0.95, 4.0, 200.0)


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
    departure: float = math.nan
    """Distance along the road to the place of departure, in m."""
    offset: FloatArray = field(default_factory=lambda: np.empty(0))
    """Offset left of the ego lane's centre every `GRID` m, (n,) in m, NaN where it did not come."""
    speed: FloatArray = field(default_factory=lambda: np.empty(0))
    """Speed there, (n,) in m/s, likewise."""


@dataclass(frozen=True, eq=False)
class Recordings:
    """All recorded drives, driven under the same terms."""

    drives: tuple[RecordedDrive, ...]
    terms: Terms
    digests: Mapping[str, str]
    """Path of a recording -> SHA-256 of what was read from it, wherever it lies."""
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
    digests: dict[str, str] = {}
    found: dict[Terms, str] = {}
    skipped = 0
    for place in map(Path, require_list("places", places, "files and folders")):
        if str(place) in digests:
            raise FreneticError(f"{place} is given twice: once is enough")
        digest = hashlib.sha256()
        runs: dict[str, int] = {}  # numbered, since their names depend on the place
        before = len(drives)
        with threadpool_limits(1):  # threads would wait for each other on small matrices
            for source in _sources(place):
                terms = (given or Terms()).or_else(source.terms).or_else(USUAL)
                found.setdefault(terms, source.name)
                for drive in source.drives(terms):
                    if drive is None:
                        skipped += 1
                        continue
                    drives.append(drive)
                    _feed(digest, drive, runs.setdefault(drive.run, len(runs)))
        if len(drives) == before:
            raise FreneticError(f"{place} holds no drive that passed or failed")
        digests[str(place)] = digest.hexdigest()
    if len(found) > 1:
        (one, first), (other, second), *_ = found.items()
        differ = [k for k in vars(one) if getattr(one, k) != getattr(other, k)]
        words = " and ".join(f"{k} {getattr(one, k):g} and {getattr(other, k):g}" for k in differ)
        raise FreneticError(
            f"{first} and {second} were driven under different terms ({words}): calibrate them one"
            " by one, or say which hold for all, such as"
            f" {differ[0].replace('_', ' ')} {getattr(one, differ[0]):g}"
        )
    return Recordings(tuple(drives), next(iter(found)), digests, skipped)


def _feed(digest: Any, drive: RecordedDrive, run: int) -> None:
    values = [drive.failed, drive.max_oob_share, drive.mean_oob_distance, drive.std_steering]
    road = [drive.road.step, *drive.road.pose]
    digest.update(json.dumps([run, *values, drive.departure, *road]).encode())
    for array in (drive.road.curvatures, drive.offset, drive.speed):
        digest.update(np.asarray(array, dtype="<f8").tobytes())


# Places


@dataclass(frozen=True)
class _Source:
    """A campaign, folder of test files or table."""

    name: str
    terms: Terms
    drives: Callable[[Terms], Iterator[RecordedDrive | None]]


def _sources(place: Path) -> Iterator[_Source]:
    if not place.exists():
        raise FreneticError(f"there is no file or folder {place}")
    if place.is_file():
        yield _table(place, place) if place.suffix.lower() in _TABLES else _files(place, [place])
        return
    if (place / DATABASE).is_file() or any(place.glob(f"*/{DATABASE}")):
        for folder in find_campaigns(place):
            yield _campaign(place, folder)
        return
    for suffix in _TABLES:
        if (table := place / f"tests{suffix}").is_file():
            yield _table(place, table)
            return
    if files := sorted(place.glob("*.json")):
        yield _files(place, files)
        return
    folders = sorted({file.parent for file in place.glob("*/*.json")})
    if not folders:
        raise FreneticError(
            f"{place} holds no recording: a campaign, test files (.json) or a table named tests,"
            f" with {', '.join(_TABLES)}, is needed"
        )
    for folder in folders:
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
                    departure=float(seen.distance[-1]) if seen.end == LEFT_LANE else math.nan,
                    offset=offset,
                    speed=speed,
                )

    with CampaignStore.open(folder) as store:
        setting = store.setting
    rules = setting.rules
    terms = Terms(rules.speed_limit, rules.oob_tolerance, setting.lane_width, setting.map_size)
    return _Source(str(folder), terms, drives)


def _files(place: Path, files: Sequence[Path]) -> _Source:
    folder = files[0].parent

    def drives(terms: Terms) -> Iterator[RecordedDrive | None]:
        for file in files:
            text = _read(file)
            entries = _json(text, file)
            yield _drive_of(entries, file, file.name, str(place), str(folder), terms)

    described = folder / "experiment_description.csv"
    terms = Terms()
    if described.is_file():
        row = next(_rows(described), {})
        names = ("speed_limit", "oob_tolerance", "map_size")
        terms = Terms(**{k: _number(row, k, described) for k in names if k in row})
    return _Source(str(folder), terms, drives)


def _table(place: Path, table: Path) -> _Source:
    def drives(terms: Terms) -> Iterator[RecordedDrive | None]:
        paths: Mapping[str, Mapping[str, list[float]]] = {}
        beside = table.with_name(f"trajectories{table.suffix}")
        if beside.is_file() and beside != table:
            paths = _trajectories(_rows(beside))
        for i, row in enumerate(_rows(table), start=1):
            if i > MAX_ROWS:
                raise FreneticError(f"{table} has more than {MAX_ROWS:,} rows: split it")
            path = paths.get(str(row.get("id")))
            entries = row if path is None else {**row, "trajectory": path}
            name = f"row {i}"
            yield _drive_of(entries, f"{table}, {name}", name, str(place), str(place), terms)

    return _Source(str(table), Terms(), drives)


def _rows(table: Path) -> Iterator[Mapping[str, Any]]:
    suffix = table.suffix.lower()
    if suffix == ".parquet":
        try:
            import pyarrow  # an extra
            import pyarrow.parquet as parquet
        except ImportError:
            raise FreneticError(
                f"{table}: reading Parquet needs pyarrow: {pip_install('tables')}"
            ) from None
        _check_size(table)
        try:
            for batch in parquet.ParquetFile(table).iter_batches():
                yield from batch.to_pylist()
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            raise FreneticError(f"{table} is no table in Parquet: {error}") from None
    elif suffix == ".csv":
        csv.field_size_limit(2**26)
        reader = csv.DictReader(io.StringIO(_read(table)))
        try:
            for row in reader:
                yield {k: _cell(v) for k, v in row.items() if k is not None and v not in (None, "")}
        except csv.Error as error:
            raise FreneticError(f"{table}, line {reader.line_num}: {error}") from None
    else:
        for i, line in enumerate(_read(table).split("\n"), start=1):
            if line.strip():
                yield _json(line, f"{table}, line {i}")


def _cell(text: Any) -> Any:
    try:
        return json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return text


def _trajectories(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, list[float]]]:
    """Id of a drive -> its columns."""
    found: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        columns = found.setdefault(str(row.get("id")), {k: [] for k in ("time", "x", "y", "speed")})
        for name, values in columns.items():
            values.append(row.get(name, math.nan))
    return found


def _check_size(path: Path) -> None:
    if path.stat().st_size > MAX_BYTES:
        raise FreneticError(f"{path} has more than {MAX_BYTES:,} bytes: split it")


def _read(path: Path) -> str:
    try:
        _check_size(path)
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FreneticError(f"{path} is no text in UTF-8") from None


def _json(text: str, where: object) -> Mapping[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FreneticError(f"{where} is not JSON: {error}") from None
    if not isinstance(value, Mapping):
        raise FreneticError(f"{where} holds {shown(value)}: an object is needed")
    return value


# A drive


def _drive_of(
    entries: Mapping[str, Any], where: object, name: str, recording: str, run: str, terms: Terms
) -> RecordedDrive | None:
    """The drive of a test file or of a row; None if the road was not driven or the drive broke."""
    outcome = entries.get("outcome", entries.get("test_outcome"))
    if outcome is None:
        raise FreneticError(f"{where} has no outcome: PASS or FAIL is needed")
    if not isinstance(outcome, str) or outcome not in set(Outcome):
        raise FreneticError(f"{where}: its outcome is {shown(outcome)}: PASS or FAIL is needed")
    if not Outcome(outcome).is_driven:
        return None
    described = {**entries, "lane_width": terms.lane_width}
    pose = [entries.get(name) for name in Pose._fields]
    if None not in pose:  # as in our own tables
        described.setdefault("pose", pose)
    try:
        road = road_file(Path(str(where)), described).road()
    except RoadError as error:
        raise FreneticError(str(error)) from None
    groups = [str(entries[key]) for key in _RUN if entries.get(key) is not None]
    path = offset = speed = np.empty(0)
    measured: dict[str, float] = {}
    if (records := entries.get("execution_data")) not in (None, []):
        path, speed, measured = _competition_records(records, where)
    elif (trajectory := entries.get("trajectory")) not in (None, []):
        path, speed = _trajectory(trajectory, where)
    if len(path):
        along = Trace.along(road, path, speed)
        offset, speed = on_grid(along.distance, along.lateral_offset, along.speed)
    measured |= {
        key: _number(entries, key, where)
        for key in ("max_oob_share", "mean_oob_distance", "std_steering")
        if entries.get(key) is not None
    }
    rules = _rules(terms)
    failed = outcome == Outcome.FAIL
    departure = math.nan
    seen = np.flatnonzero(np.isfinite(offset))
    if failed and entries.get("departure_distance") is not None:
        departure = _number(entries, "departure_distance", where)
    elif failed and len(seen) and abs(offset[seen[-1]]) > 0.25 * road.lane_width:
        departure = GRID * float(seen[-1])  # where its record ends, unless it got stuck
    return RecordedDrive(
        name=name,
        recording=recording,
        run=", ".join([run, *groups]),
        road=road,
        rules=rules,
        failed=failed,
        departure=departure,
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
    return Road(road.curvatures, road.step, road.pose, lane_width=terms.lane_width)


def _number(entries: Mapping[str, Any], name: str, where: object) -> float:
    try:
        value = float(entries[name])
    except (TypeError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise FreneticError(f"{where}: its {name} is {shown(entries[name])}: a number is needed")
    return value


def _array(values: object, where: object, what: str) -> FloatArray:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(())
    if array.ndim != 1:
        raise FreneticError(f"{where}: {what} is not a list of numbers")
    return array


def _trajectory(given: Any, where: object) -> tuple[FloatArray, FloatArray]:
    """(path, speed) of rows [time, x, y, ...] or of columns."""
    if isinstance(given, Mapping):
        if missing := [name for name in ("time", "x", "y") if name not in given]:
            raise FreneticError(f"{where}: its trajectory has no {missing[0]}")
        entries = given
    elif isinstance(given, list) and all(isinstance(row, list) and len(row) > 2 for row in given):
        entries = {name: [row[i] for row in given] for i, name in enumerate(("time", "x", "y"))}
    else:
        raise FreneticError(f"{where}: its trajectory is no list of [time, x, y]")
    columns = [_array(entries[name], where, f"its {name}") for name in ("time", "x", "y")]
    speed = _array(entries.get("speed", []), where, "its speed")
    n = len(columns[0])
    if any(column.shape != (n,) for column in columns) or len(speed) not in (0, n) or n < 2:
        raise FreneticError(f"{where}: its trajectory needs as many times as places, two or more")
    if not np.isfinite(columns).all() or (np.diff(columns[0]) < 0.0).any():
        raise FreneticError(f"{where}: its trajectory needs finite numbers in the order of time")
    path = np.column_stack(columns[1:])
    if not len(speed) or not np.isfinite(speed).all():
        gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        times, first = np.unique(columns[0], return_index=True)
        if len(times) < 2:
            raise FreneticError(f"{where}: all records of its trajectory are of one time")
        at = np.gradient(gone[first], times)
        speed = np.interp(columns[0], times, at)
    return path, speed


def _competition_records(
    records: Any, where: object
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """(path, speed, measures) of the competition's records."""

    def column(place: int, name: str) -> Any:
        return [row[name] if isinstance(row, Mapping) else row[place] for row in records]

    try:
        timer, pos, ahead, vel, steering = (column(place, name) for name, place in _RECORD.items())
        distance = column(_OOB_DISTANCE, "oob_distance")
        share = column(_OOB_SHARE, "oob_percentage")
        arrays = [np.array(values, dtype=np.float64) for values in (steering, distance, share)]
        if not np.isfinite(arrays).all():
            raise ValueError
        path = [[place[0], place[1]] for place in pos]
        places, _ = _trajectory(
            {"time": timer, "x": [p[0] for p in path], "y": [p[1] for p in path]}, where
        )
        along = [[v[:2] for v in one] for one in (vel, ahead)]
        vectors = np.array(along, dtype=np.float64)
        speed = np.prod(vectors, axis=0).sum(axis=1)
    except (TypeError, ValueError, OverflowError, IndexError, KeyError):
        raise FreneticError(f"{where}: its execution_data are no records of a drive") from None
    for name, values in zip(("vel", "dir"), vectors, strict=True):
        if len(odd := np.flatnonzero(~np.isfinite(values).all(axis=1))):
            raise FreneticError(
                f"{where}: {name} of record {odd[0] + 1} of its execution_data is"
                f" {shown(column(_RECORD[name], name)[odd[0]])}: finite numbers are needed"
            )
    measures = {
        "max_oob_share": float(arrays[2].max()),
        "mean_oob_distance": float(arrays[1].mean()),
        "std_steering": float(arrays[0].std()),
    }
    return places, speed, measures


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
