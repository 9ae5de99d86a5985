"""Recorded drives to calibrate on: campaigns, test files of the competition, tables and MDF.

A folder is a campaign, a folder of campaigns, or a folder of test files (JSON, one drive each). A
file is a table (JSON Lines, one drive a row), or a recording of one drive (CSV or MDF): its option
``road`` names the road. A row of a table has the entries of a test file; docs/calibrating.md lists
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Self, TypeAlias

import numpy as np
from msgspec import Meta, Struct, structs

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, Positive, Share
from frenetic._support.files import open_file, require_list
from frenetic._support.outside_text import read_json
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.database import DATABASE
from frenetic.campaign.store import CampaignStore
from frenetic.errors import FreneticError, RoadError
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.twin.recorded_drive import (
    MIN_POSITIONS,
    RecordedDrive,
    on_grid,
    states_of,
)
from frenetic.recordings import RecordingFile, read_recording
from frenetic.recordings.channels import SUFFIXES
from frenetic.recordings.comparison import along_road
from frenetic.road import LANE_WIDTH, Road
from frenetic.road.files import RoadEntries, RoadFile, read_road
from frenetic.search.records import Trace
from frenetic.spec import Spec
from frenetic.spec.terms import Terms

TABLE: Final = ".jsonl"
"""Ending of a table's file name."""
_LATEST_START: Final = 10.0
"""Largest distance along the road at which a recording in CSV or MDF begins, in m; our choice."""
_OPTIONS: Final = ("road", "outcome", "signals")
"""Options of a recording in CSV or MDF."""


class RecordedTerms(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The terms under which drives were recorded."""

    speed_limit: Positive = 70.0
    """Speed limit, in km/h."""
    oob_tolerance: Share = 0.95
    """Share of the car's box outside the ego lane beyond which a drive failed."""
    lane_width: Positive = LANE_WIDTH
    """Width of a lane, in m."""
    map_size: Positive = 200.0
    """Side of the map, in m."""

    @classmethod
    def of(cls, terms: Terms, rules: Rules) -> Self:
        """Return the terms of drives by these rules."""
        return cls(
            speed_limit=rules.speed_limit,
            oob_tolerance=rules.oob_tolerance,
            lane_width=terms.lane_width,
            map_size=terms.map_size,
        )

    @property
    def rules(self) -> Rules:
        """Rules of the drives.

        Raises:
            FreneticError: a rule is out of range.
        """
        try:
            return Rules(speed_limit=self.speed_limit, oob_tolerance=self.oob_tolerance)
        except ValueError as error:
            raise FreneticError(str(error)) from None

    @property
    def spec(self) -> Spec:
        """Spec with these terms.

        It leaves out the default speed limit, so that the speed limits of a road hold.
        """
        entries = structs.asdict(self)
        if self.speed_limit == Rules().speed_limit:
            entries["speed_limit"] = None
        return Spec(**entries)

    def differences(self, other: RecordedTerms) -> str:
        """Return how these terms differ from others, as text; empty if they are the same."""
        other_values = structs.asdict(other)
        return "; ".join(
            f"{name.replace('_', ' ')} {value:g}, not {other_values[name]:g}"
            for name, value in structs.asdict(self).items()
            if value != other_values[name]
        )


@dataclass(frozen=True, eq=False)
class Recordings:
    """Recorded drives that were driven under the same terms."""

    drives: list[RecordedDrive]
    terms: RecordedTerms
    skipped: int
    """Number of tests left out: not driven to an end, or without a usable trajectory."""

    @property
    def runs(self) -> list[str]:
        """Names of the runs, in the order of their first drives."""
        return list(dict.fromkeys(drive.run for drive in self.drives))


def read_recordings(
    places: Iterable[Path | str], stated_terms: RecordedTerms | None = None
) -> Recordings:
    """Read recorded drives.

    Args:
        places: files and folders of recorded drives.
        stated_terms: terms of all drives, in place of those that a campaign records.

    Raises:
        FreneticError: there are no files or folders; one cannot be read, is damaged or holds no
            drive that passed or failed; or drives were driven under different terms.
    """
    tests: list[_Test] = []
    place_of_terms: dict[RecordedTerms, Path] = {}
    for text in map(str, require_list("places", places, "files and folders")):
        place, options = RecordingFile.of(text, _OPTIONS)
        is_recording = place.suffix.lower() in SUFFIXES
        if options and not is_recording:
            raise FreneticError(f"{text}: options are for recordings in CSV or MDF")
        sources = _recording(place, options, stated_terms) if is_recording else None
        tests_of_place: list[_Test] = []
        for terms, tests_of_source in sources or _sources(place, stated_terms):
            place_of_terms.setdefault(terms, place)
            tests_of_place += tests_of_source
        if not any(tests_of_place):
            raise FreneticError(f"{place} holds no drive that passed or failed with a trajectory")
        tests += tests_of_place
    if not place_of_terms:
        raise FreneticError("there are no recordings: name a file or folder")
    if len(place_of_terms) > 1:
        (terms, place), (other_terms, other_place), *_ = place_of_terms.items()
        raise FreneticError(
            f"{place} and {other_place} were driven under different terms"
            f" ({terms.differences(other_terms)}): calibrate them one by one, or say in a file"
            " which hold for all"
        )
    drives = [drive for drive in tests if drive is not None]
    return Recordings(drives, next(iter(place_of_terms)), len(tests) - len(drives))


_Test: TypeAlias = RecordedDrive | None
"""Drive of a recorded test; None if the test is of no use here."""
_Source: TypeAlias = tuple[RecordedTerms, list[_Test]]
"""Terms and tests of a table, of a folder of test files, or of a campaign."""


def _recording(
    path: Path, options: Mapping[str, Any], stated_terms: RecordedTerms | None
) -> list[_Source]:
    """Return the terms and the drive of a recording in CSV or MDF.

    Without an outcome, the drive failed if the car's centre left the lane.

    Raises:
        FreneticError: the file or its road cannot be read, the road or the car's offset is not
            known, or the outcome is neither PASS nor FAIL.
    """
    terms = stated_terms or RecordedTerms()
    if "road" not in options:
        raise FreneticError(f"{path} does not say its road: name it, {path},road=road.json")
    outcome_text = str(options.get("outcome", "")).upper()
    if outcome_text not in ("", Outcome.PASS, Outcome.FAIL):
        raise FreneticError(f"{path}: outcome is {options['outcome']!r}: PASS or FAIL is needed")
    road_path = Path(str(options["road"])).expanduser()
    road = replace(read_road(road_path).road(), lane_width=terms.lane_width)
    recording = read_recording(RecordingFile(path, options))
    fitted, _ = road.placed(terms.map_size)
    roads = [road] if fitted is None else [road, fitted]
    _, signals = along_road(recording, roads)
    if "lateral_offset" not in signals:
        raise FreneticError(f"{path}: no channel is known for x and y, or the lateral offset")
    if "speed" not in signals:
        signals["speed"] = np.gradient(signals["distance"], recording.time)
    columns = np.stack([signals[name] for name in ("distance", "lateral_offset", "speed")])
    columns = columns[:, np.isfinite(columns).all(axis=0)]
    if not columns.shape[1] or columns[0, 0] > _LATEST_START:
        raise FreneticError(
            f"{path} has no record with place, offset and speed in the first"
            f" {_LATEST_START:g} m of the road"
        )
    outcome = Outcome(outcome_text) if outcome_text else Outcome.PASS
    if not outcome_text and np.abs(columns[1]).max() > 0.5 * terms.lane_width:
        outcome = Outcome.FAIL
    road = fitted or road
    return [(terms, [_recorded(road, on_grid(*columns), outcome, str(path.parent))])]


def _sources(place: Path, stated_terms: RecordedTerms | None) -> Iterator[_Source]:
    """Yield terms and tests of the table, test files or campaigns in a file or folder."""
    terms = stated_terms or RecordedTerms()
    if place.suffix == TABLE:
        lines = enumerate(_read(place).split(b"\n"), start=1)
        rows = [(line, f"{place}, row {i}", str(place)) for i, line in lines if line.strip()]
    else:
        files = sorted([*place.glob("*.json"), *place.glob("*/*.json")])
        is_campaign = any(place.glob(f"**/{DATABASE}"))  # which may hold JSON files, too
        rows = [] if is_campaign else [(_read(file), str(file), str(file.parent)) for file in files]
    if rows:
        yield terms, [_drive_of(text, source, run, terms) for text, source, run in rows]
    else:
        for folder in find_campaigns(place):
            yield _campaign(folder, stated_terms)


def _campaign(folder: Path, stated_terms: RecordedTerms | None) -> _Source:
    """Return the terms and tests of a campaign."""
    tests: list[_Test] = []
    with CampaignStore.open(folder) as store:
        setting = store.setting
        terms = stated_terms or RecordedTerms.of(setting, setting.rules_in({}))
        for test in store.tests(with_trajectory=True):
            drive = test.drive
            if not test.outcome.is_driven or drive is None:
                tests.append(None)
                continue
            states = states_of(drive, assess(test.road, drive, has_all_shares=False))
            road = replace(test.road, lane_width=terms.lane_width)
            if len(road.speed_limits):
                road = replace(road, speed_limits=drive.rules.speed_limits_on(road))
            tests.append(_recorded(road, states, test.outcome, str(folder)))
    return terms, tests


def _recorded(road: Road, states: FloatArray, outcome: Outcome, run: str) -> RecordedDrive | None:
    """Return a recorded drive; None if it is too short to be compared."""
    if states.shape[1] < MIN_POSITIONS:
        return None
    return RecordedDrive(road=road, states=states, failed=outcome is Outcome.FAIL, run=run)


def _read(file: Path) -> bytes:
    try:
        with open_file(file) as opened:
            return opened.read()
    except OSError as error:
        raise FreneticError(f"{file} cannot be read: {error.strerror or error}") from None


# A test file or a row of a table

Vector: TypeAlias = Annotated[list[Finite], Meta(min_length=2)]


class RecordedCourse(Struct):
    """A trajectory as columns of equal length: times in s, places on the map in m."""

    time: list[Finite]
    x: list[Finite]
    y: list[Finite]
    speed: list[Finite] = []
    """Speeds in m/s; without them they follow from times and places."""


class ExecutionRecord(Struct, array_like=True):
    """The first values of a record of the competition; further ones are not read."""

    timer: Finite
    """Time, in s."""
    pos: Vector
    """Place on the map, in m."""
    dir: Vector
    """Unit vector of the heading."""
    vel: Vector
    """Velocity, in m/s."""


class Row(RoadEntries):
    """A test file, or a row of a table: entries that describe a road and its drive."""

    outcome: Outcome | None = None
    test_outcome: Outcome | None = None
    """Outcome in the competition's files."""
    run: str = ""
    """Name of a run within the file or folder."""
    trajectory: RecordedCourse | None = None
    execution_data: tuple[ExecutionRecord, ...] = ()


def _drive_of(text: bytes, source: str, run: str, terms: RecordedTerms) -> RecordedDrive | None:
    """Return the drive of a test file or row; None if it has no end, or no trajectory.

    Args:
        text: the file or row, as JSON.
        source: name of the file, with the number of the row, for messages.
        run: name of the run of all drives in the file or folder.
        terms: terms of the recording.
    """
    try:
        row = read_json(text, Row)
    except ValueError as error:
        raise FreneticError(f"{source} says no drive: {error}") from None
    outcome = row.outcome or row.test_outcome
    if outcome is None:
        raise FreneticError(f"{source} has no outcome: PASS or FAIL is needed")
    course = row.trajectory
    if records := row.execution_data:
        x, y = ([record.pos[i] for record in records] for i in (0, 1))
        # The speed along the car; it is negative if the car rolls backwards.
        speed = [
            record.vel[0] * record.dir[0] + record.vel[1] * record.dir[1] for record in records
        ]
        course = RecordedCourse([record.timer for record in records], x, y, speed)
    if not outcome.is_driven or course is None:
        return None
    row.lane_width = terms.lane_width
    try:
        road = RoadFile(Path(source), row).road()
    except RoadError as error:
        raise FreneticError(str(error)) from None
    trace = Trace.along(road, *_path(course, source))
    states = on_grid(trace.distance, trace.lateral_offset, trace.speed)
    return _recorded(road, states, outcome, f"{run}, {row.run}" if row.run else run)


def _path(course: RecordedCourse, source: str) -> tuple[FloatArray, FloatArray]:
    """Return places on the map in m, (n, 2), and speeds in m/s, (n,), of a trajectory.

    Raises:
        FreneticError: the columns differ in length or are too short, or speeds are missing and the
            times do not grow.
    """
    n = len(course.time)
    if n < 2 or {len(course.x), len(course.y)} != {n} or len(course.speed) not in (0, n):
        raise FreneticError(f"{source}: its trajectory needs as many times as places, two or more")
    time, path = np.array(course.time), np.column_stack((course.x, course.y))
    if course.speed:
        return path, np.array(course.speed)
    if not (np.diff(time) > 0.0).all():
        raise FreneticError(f"{source}: the times of its trajectory do not grow")
    distance = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    return path, np.gradient(distance, time)
