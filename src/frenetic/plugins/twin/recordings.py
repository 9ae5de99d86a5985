"""Recorded drives to calibrate on: campaigns, test files of the competition, tables.

A folder is a campaign, a folder of campaigns, or a folder of test files (JSON, one drive each). A
file is a table: JSON Lines, a row per drive. The entries of a row are those of a test file;
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
from frenetic._support.files import require_list
from frenetic._support.outside_text import read_json
from frenetic.analysis.groups import find_campaigns
from frenetic.campaign.database import DATABASE
from frenetic.campaign.store import CampaignStore
from frenetic.errors import FreneticError, RoadError
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import assess
from frenetic.plugins.twin.fitting import LEAST, RecordedDrive, on_grid, states_of
from frenetic.road import Road
from frenetic.road.files import RoadEntries, RoadFile
from frenetic.search.records import Trace
from frenetic.spec import Spec
from frenetic.spec.terms import Terms

TABLE: Final = ".jsonl"
"""How the name of a table ends."""


class RecordedTerms(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The terms of recorded drives."""

    speed_limit: Positive = 70.0
    """km/h."""
    oob_tolerance: Share = 0.95
    lane_width: Positive = 4.0
    """m."""
    map_size: Positive = 200.0
    """m."""

    @classmethod
    def of(cls, terms: Terms, rules: Rules) -> Self:
        """The terms of drives by some rules."""
        return cls(
            speed_limit=rules.speed_limit,
            oob_tolerance=rules.oob_tolerance,
            lane_width=terms.lane_width,
            map_size=terms.map_size,
        )

    @property
    def rules(self) -> Rules:
        """The rules.

        Raises:
            FreneticError: they are out of range.
        """
        try:
            return Rules(speed_limit=self.speed_limit, oob_tolerance=self.oob_tolerance)
        except ValueError as error:
            raise FreneticError(str(error)) from None

    @property
    def spec(self) -> Spec:
        """The spec that says them; the usual speed limit lets a road's own hold."""
        is_usual = self.speed_limit == Rules().speed_limit
        entries = structs.asdict(self) | ({"speed_limit": None} if is_usual else {})
        return Spec(**entries)

    def differences(self, other: RecordedTerms) -> str:
        """What is different in others, in words; empty if nothing is."""
        mine, theirs = structs.asdict(self), structs.asdict(other)
        return "; ".join(
            f"{name.replace('_', ' ')} {value:g}, not {theirs[name]:g}"
            for name, value in mine.items()
            if value != theirs[name]
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


def read_recordings(places: Iterable[Path | str], given: RecordedTerms | None = None) -> Recordings:
    """Reads recorded drives.

    Args:
        places: files and folders.
        given: terms that hold whatever a campaign says.

    Raises:
        FreneticError: one of them cannot be read or is damaged, they hold no drive that passed or
            failed, or they were driven under different terms.
    """
    found: list[RecordedDrive | None] = []
    known: dict[RecordedTerms, Path] = {}
    for place in map(Path, require_list("places", places, "files and folders")):
        before = len(found)
        for terms, drives in _sources(place, given):
            known.setdefault(terms, place)
            found += drives
        if not any(found[before:]):
            raise FreneticError(f"{place} holds no drive that passed or failed with a trajectory")
    if len(known) > 1:
        (one, first), (other, second), *_ = known.items()
        raise FreneticError(
            f"{first} and {second} were driven under different terms ({one.differences(other)}):"
            " calibrate them one by one, or say in a file which hold for all"
        )
    kept = [drive for drive in found if drive is not None]
    return Recordings(kept, next(iter(known)), len(found) - len(kept))


_Source: TypeAlias = tuple[RecordedTerms, list[RecordedDrive | None]]


def _sources(place: Path, given: RecordedTerms | None) -> Iterator[_Source]:
    """Terms and drives of the table, test files or campaigns in a place."""
    terms = given or RecordedTerms()
    if place.suffix == TABLE:
        lines = enumerate(_read(place).split(b"\n"), start=1)
        rows = [(line, f"{place}, row {i}", str(place)) for i, line in lines if line.strip()]
    else:
        files = sorted([*place.glob("*.json"), *place.glob("*/*.json")])
        is_campaign = any(place.glob(f"**/{DATABASE}"))
        rows = [] if is_campaign else [(_read(one), str(one), str(one.parent)) for one in files]
    if rows:
        yield terms, [_drive_of(line, where, run, terms) for line, where, run in rows]
    else:
        for folder in find_campaigns(place):
            yield _campaign(folder, given)


def _campaign(folder: Path, given: RecordedTerms | None) -> _Source:
    drives: list[RecordedDrive | None] = []
    with CampaignStore.open(folder) as store:
        setting = store.setting
        terms = given or RecordedTerms.of(setting, setting.rules_in({}))
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
        return file.read_bytes()
    except OSError as error:
        raise FreneticError(f"{file} cannot be read: {error.strerror or error}") from None


# A test file or a row of a table

Vector: TypeAlias = Annotated[list[Finite], Meta(min_length=2)]


class Course(Struct):
    """A trajectory as columns."""

    time: list[Finite]
    x: list[Finite]
    y: list[Finite]
    speed: list[Finite] = []
    """m/s; worked out where it is unknown."""


class Record(Struct, array_like=True):
    """The beginning of a record of the competition's."""

    timer: Finite
    pos: Vector
    dir: Vector
    vel: Vector


class Row(RoadEntries):
    """The entries that describe a road and its drive."""

    outcome: Outcome | None = None
    test_outcome: Outcome | None = None
    """The same in the competition's files."""
    run: str = ""
    trajectory: Course | None = None
    execution_data: tuple[Record, ...] = ()


def _drive_of(text: bytes, where: str, run: str, terms: RecordedTerms) -> RecordedDrive | None:
    """The drive of a test file or row; None if it has no end, or no trajectory.

    Args:
        text: the file or row.
        where: it stands, for messages.
        run: name of the run of all drives there.
        terms: of the recording.
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
        x, y = ([one.pos[i] for one in records] for i in (0, 1))
        speed = [one.vel[0] * one.dir[0] + one.vel[1] * one.dir[1] for one in records]
        course = Course([one.timer for one in records], x, y, speed)
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


def _path(course: Course, where: str) -> tuple[FloatArray, FloatArray]:
    """Places (n, 2) and speeds (n,) of a trajectory."""
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
