"""Recorded drives to calibrate on: campaigns, test files of the competition, tables.

A folder is a campaign, a folder of campaigns, or a folder of test files (JSON, one drive each). A
file is a table: JSON Lines, a row per drive. A row has the entries of a test file;
docs/calibrating.md lists them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final, Self, TypeAlias

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
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import assess
from frenetic.plugins.twin.fitting import LEAST, RecordedDrive, on_grid, states_of
from frenetic.road import LANE_WIDTH, Road
from frenetic.road.files import RoadEntries, RoadFile
from frenetic.search.records import Trace
from frenetic.spec import Spec
from frenetic.spec.terms import Terms

TABLE: Final = ".jsonl"
"""How the name of a table ends."""


class RecordedTerms(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The terms of recorded drives."""

    speed_limit: Positive = 70.0
    """Speed limit, in km/h."""
    oob_tolerance: Share = 0.95
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
        """Spec with these terms; the usual speed limit lets a road's own hold."""
        is_usual = self.speed_limit == Rules().speed_limit
        entries = structs.asdict(self) | ({"speed_limit": None} if is_usual else {})
        return Spec(**entries)

    def differences(self, other: RecordedTerms) -> str:
        """Return how other terms differ, as text; empty if they do not."""
        ours, others = structs.asdict(self), structs.asdict(other)
        return "; ".join(
            f"{name.replace('_', ' ')} {value:g}, not {others[name]:g}"
            for name, value in ours.items()
            if value != others[name]
        )


@dataclass(frozen=True, eq=False)
class Recordings:
    """All recorded drives, driven under the same terms."""

    drives: list[RecordedDrive]
    terms: RecordedTerms
    skipped: int
    """Number of tests that were not driven to an end, or have no trajectory."""

    @property
    def runs(self) -> list[str]:
        """Names of the runs, in order."""
        return list(dict.fromkeys(drive.run for drive in self.drives))


def read_recordings(
    places: Iterable[Path | str], stated_terms: RecordedTerms | None = None
) -> Recordings:
    """Read recorded drives.

    Args:
        places: files and folders.
        stated_terms: terms that hold whatever a campaign says.

    Raises:
        FreneticError: a place cannot be read or is damaged, they hold no drive that passed or
            failed, or they were driven under different terms.
    """
    drives: list[RecordedDrive | None] = []
    known: dict[RecordedTerms, Path] = {}
    for place in map(Path, require_list("places", places, "files and folders")):
        before = len(drives)
        for terms, more in _sources(place, stated_terms):
            known.setdefault(terms, place)
            drives += more
        if not any(drives[before:]):
            raise FreneticError(f"{place} holds no drive that passed or failed with a trajectory")
    if len(known) > 1:
        (first_terms, first), (other, second), *_ = known.items()
        raise FreneticError(
            f"{first} and {second} were driven under different terms"
            f" ({first_terms.differences(other)}): calibrate them one by one, or say in a file"
            " which hold for all"
        )
    usable = [drive for drive in drives if drive is not None]
    return Recordings(usable, next(iter(known)), len(drives) - len(usable))


_Source: TypeAlias = tuple[RecordedTerms, list[RecordedDrive | None]]


def _sources(place: Path, stated_terms: RecordedTerms | None) -> Iterator[_Source]:
    """Yield terms and drives of the table, test files or campaigns in a place."""
    terms = stated_terms or RecordedTerms()
    if place.suffix == TABLE:
        lines = enumerate(_read(place).split(b"\n"), start=1)
        rows = [(line, f"{place}, row {i}", str(place)) for i, line in lines if line.strip()]
    else:
        files = sorted([*place.glob("*.json"), *place.glob("*/*.json")])
        is_campaign = any(place.glob(f"**/{DATABASE}"))
        rows = [] if is_campaign else [(_read(file), str(file), str(file.parent)) for file in files]
    if rows:
        yield terms, [_drive_of(line, where, run, terms) for line, where, run in rows]
    else:
        for folder in find_campaigns(place):
            yield _campaign(folder, stated_terms)


def _campaign(folder: Path, stated_terms: RecordedTerms | None) -> _Source:
    drives: list[RecordedDrive | None] = []
    with CampaignStore.open(folder) as store:
        setting = store.setting
        terms = stated_terms or RecordedTerms.of(setting, setting.rules_in({}))
        for test in store.tests(with_trajectory=True):
            drive = test.drive
            if not test.outcome.is_driven or drive is None:
                drives.append(None)
                continue
            states = states_of(drive, assess(test.road, drive, has_shares=False))
            road = replace(test.road, lane_width=terms.lane_width)
            if len(road.speed_limits):
                road = replace(road, speed_limits=drive.rules.speed_limits_on(road))
            drives.append(_recorded(road, states, test.outcome, str(folder)))
    return terms, drives


def _recorded(road: Road, states: FloatArray, outcome: Outcome, run: str) -> RecordedDrive | None:
    if states.shape[1] < LEAST:
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
    """A trajectory as columns."""

    time: list[Finite]
    x: list[Finite]
    y: list[Finite]
    speed: list[Finite] = []
    """m/s; worked out where it is unknown."""


class ExecutionRecord(Struct, array_like=True):
    """Beginning of a record of the competition."""

    timer: Finite
    pos: Vector
    dir: Vector
    vel: Vector


class Row(RoadEntries):
    """The entries that describe a road and its drive."""

    outcome: Outcome | None = None
    test_outcome: Outcome | None = None
    """Outcome in the competition's files."""
    run: str = ""
    trajectory: RecordedCourse | None = None
    execution_data: tuple[ExecutionRecord, ...] = ()


def _drive_of(text: bytes, where: str, run: str, terms: RecordedTerms) -> RecordedDrive | None:
    """Return the drive of a test file or row; None if it has no end, or no trajectory.

    Args:
        text: the file or row.
        where: name of its place, for messages.
        run: name of the run of all drives there.
        terms: terms of the recording.
    """
    try:
        row = read_json(text, Row)
    except ValueError as error:
        raise FreneticError(f"{where} says no drive: {error}") from None
    outcome = row.outcome or row.test_outcome
    if outcome is None:
        raise FreneticError(f"{where} has no outcome: PASS or FAIL is needed")
    course = row.trajectory
    if records := row.execution_data:
        x, y = ([record.pos[i] for record in records] for i in (0, 1))
        speed = [
            record.vel[0] * record.dir[0] + record.vel[1] * record.dir[1] for record in records
        ]
        course = RecordedCourse([record.timer for record in records], x, y, speed)
    if not outcome.is_driven or course is None:
        return None
    row.lane_width = terms.lane_width
    try:
        road = RoadFile(Path(where), row).road()
    except RoadError as error:
        raise FreneticError(str(error)) from None
    along = Trace.along(road, *_path(course, where))
    states = on_grid(along.distance, along.lateral_offset, along.speed)
    return _recorded(road, states, outcome, f"{run}, {row.run}" if row.run else run)


def _path(course: RecordedCourse, where: str) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) and speeds (n,) of a trajectory."""
    n = len(course.time)
    if n < 2 or {len(course.x), len(course.y)} != {n} or len(course.speed) not in (0, n):
        raise FreneticError(f"{where}: its trajectory needs as many times as places, two or more")
    time, path = np.array(course.time), np.column_stack((course.x, course.y))
    if course.speed:
        return path, np.array(course.speed)
    if not (np.diff(time) > 0.0).all():
        raise FreneticError(f"{where}: the times of its trajectory do not grow")
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    return path, np.gradient(gone, time)
