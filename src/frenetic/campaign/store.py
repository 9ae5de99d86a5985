"""A campaign on disk: every test, as it comes, in one SQLite database.

The database, `campaign.sqlite` in the campaign's folder, is the campaign's log. It can be read by
anyone with SQLite, while the campaign runs and long afterwards:

| table | one row per |
| --- | --- |
| campaign | fact about the campaign: its configuration, when it was made and finished (JSON) |
| candidate | road that the strategy asked for: origin and curvatures |
| test | result that the strategy was told |
| screening | candidate that a twin drove, see `frenetic.campaign.screening` |
| trajectory | drive, compressed by `frenetic.campaign.trajectory_codec` |
| redrive_run, redrive | road that was driven again, see `frenetic.redrive.table` |
| earlier | test of an earlier campaign that the search started from |
| objective | drive, if the search minimises something else than the MOOBD |

and the view `overview` shows a test in one readable line.

Durability: when `CampaignStore.told` has returned, the result, its trajectory and all candidates
asked before are in the database, even if the process is killed right then. Results that it holds
back are there when `CampaignStore.write` has returned. If the machine itself goes down, the last
results may be missing, but the database is sound. Candidates asked since the last result are lost
with the process.
"""

from __future__ import annotations

import ctypes
import json
import operator
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, Self, TypeAlias, get_args
from weakref import WeakSet

from filelock import FileLock

from frenetic._support.files import flush
from frenetic._support.json_value import JSONValue as JSONValue
from frenetic._support.json_value import plain
from frenetic._support.pictures import ShownCampaign
from frenetic._support.words import present_moment
from frenetic.campaign.changes import CHANGES, PartChange, present_parts, read_changes
from frenetic.campaign.counts import StoredCounts, road_key
from frenetic.campaign.lock import lock_file
from frenetic.campaign.record import (
    CANDIDATE_COLUMNS,
    CHECKSUM,
    EARLIER_COLUMNS,
    SCREENING_COLUMNS,
    TEST_COLUMNS,
    EarlierTest,
    RowError,
    Setting,
    TestRecord,
    checksum_fault,
    read_candidate,
    read_earlier,
    read_screening,
    read_test,
    row_of_candidate,
    row_of_earlier,
    row_of_screening,
    row_of_test,
    setting_faults,
    with_checksum,
)
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate, Screening
from frenetic.simulators.drive import Trajectory
from frenetic.spec import is_number, require_count

Order: TypeAlias = Literal["told", "moobd"]

DATABASE: Final = "campaign.sqlite"
"""Name of the database in a campaign's folder."""
APPLICATION_ID: Final = int.from_bytes(b"Fren")
"""Mark of our campaigns among SQLite files (`PRAGMA application_id`)."""

LOCK: Final = "campaign.lock"
"""Name of the lock file in a campaign's folder."""
_BUSY_TIMEOUT: Final = (
    10.0  # [s] readers wait for the rare moments in which the writer excludes them
)
# Tables check their columns' types where SQLite can (3.37, 2021).
_STRICT: Final = "STRICT" if sqlite3.sqlite_version_info >= (3, 37) else ""

MIGRATIONS: tuple[tuple[str, ...], ...] = (
    (
        f"""
        CREATE TABLE campaign (
            key TEXT PRIMARY KEY NOT NULL,
            value TEXT NOT NULL  -- JSON
        ) {_STRICT}
        """,
        f"""
        CREATE TABLE candidate (
            id INTEGER PRIMARY KEY CHECK (id >= 1),
            operator TEXT NOT NULL,
            parents TEXT NOT NULL,  -- JSON list of candidate ids
            generation INTEGER NOT NULL CHECK (generation >= 0),
            step REAL NOT NULL CHECK (step > 0),  -- m between curvatures
            curvatures BLOB NOT NULL  -- 1/m, float64, little-endian
                CHECK (length(curvatures) % 8 = 0),
            asked_after INTEGER NOT NULL CHECK (asked_after >= 0)  -- results told by then
        ) {_STRICT}
        """,
        f"""
        CREATE TABLE test (
            candidate_id INTEGER PRIMARY KEY REFERENCES candidate (id),
            told INTEGER NOT NULL UNIQUE CHECK (told >= 1),
            outcome TEXT NOT NULL,  -- PASS, FAIL, INVALID or ERROR
            reason TEXT NOT NULL,
            budget_spent REAL NOT NULL,  -- share of the budget
            x REAL,  -- m, where the fitted road starts
            y REAL,  -- m
            heading REAL,  -- rad
            moobd REAL,  -- m
            max_oob_share REAL,  -- 0..1
            duration REAL,  -- simulated s
            moobd_distance REAL,  -- m along the road
            departure_time REAL,  -- simulated s
            departure_distance REAL,  -- m along the road
            departure_x REAL,  -- m
            departure_y REAL,  -- m
            departure_side TEXT CHECK (departure_side IN ('left', 'right')),
            seconds REAL NOT NULL,  -- wall time that the test took
            finished_at TEXT NOT NULL  -- UTC, ISO 8601
        ) {_STRICT}
        """,
        # Answers `counts` without touching the table.
        "CREATE INDEX test_by_outcome ON test (outcome, moobd)",
        f"""
        CREATE TABLE trajectory (
            candidate_id INTEGER PRIMARY KEY REFERENCES test (candidate_id),
            data BLOB NOT NULL
        ) {_STRICT}
        """,
        """
        CREATE VIEW overview AS
        SELECT told, candidate_id, outcome, round(moobd, 3) AS moobd, operator, parents, generation,
            length(curvatures) / 8 * step AS metres, round(duration, 2) AS duration, departure_side,
            reason
        FROM test JOIN candidate ON candidate.id = candidate_id
        ORDER BY told
        """,
    ),
    (
        "ALTER TABLE test ADD COLUMN attempts INTEGER NOT NULL DEFAULT 1 CHECK (attempts >= 0)",
        "ALTER TABLE test ADD COLUMN worker TEXT",  # who drove it
        "ALTER TABLE test ADD COLUMN elapsed REAL",  # s of the campaign's time when it was told
    ),
    (
        # m, x and y in turn, float64, little-endian: where the road was proposed as points
        "ALTER TABLE candidate ADD COLUMN points BLOB CHECK (length(points) % 16 = 0)",
    ),
    (
        f"""
        CREATE TABLE redrive_run (
            id INTEGER PRIMARY KEY,
            purpose TEXT NOT NULL,  -- robustness, confirmation, regression or minimising
            driver TEXT NOT NULL,  -- JSON, as in the configuration, like the next three
            simulator TEXT NOT NULL,
            rules TEXT,
            car TEXT,
            planned INTEGER NOT NULL CHECK (planned >= 0),  -- drives
            seed INTEGER,  -- from which conditions were drawn
            variations TEXT NOT NULL,  -- JSON: what was varied, and its ranges
            source TEXT,  -- name and digest of the file of an older version that held it
            made_at TEXT NOT NULL,  -- UTC, ISO 8601
            ended_at TEXT  -- UTC, ISO 8601
        ) {_STRICT}
        """,
        f"""
        CREATE TABLE redrive (
            run INTEGER NOT NULL REFERENCES redrive_run (id),
            number INTEGER NOT NULL CHECK (number >= 1),  -- in the run
            test INTEGER NOT NULL REFERENCES test (candidate_id),
            step REAL CHECK (step > 0),  -- of a minimised road, m between curvatures
            curvatures BLOB CHECK (length(curvatures) % 8 = 0),  -- likewise, 1/m, float64
            conditions TEXT NOT NULL,  -- JSON: what differed from the campaign
            outcome TEXT NOT NULL,  -- PASS, FAIL, INVALID or ERROR
            reason TEXT NOT NULL,
            moobd REAL,  -- m
            max_oob_share REAL,  -- 0..1
            duration REAL,  -- simulated s
            departure_distance REAL,  -- m along the road
            departure_side TEXT CHECK (departure_side IN ('left', 'right')),
            seconds REAL,  -- wall time of the drive
            trajectory BLOB,  -- of confirmations
            PRIMARY KEY (run, number)
        ) {_STRICT}
        """,
    ),
    (
        # CRC-32 of the other values, see `frenetic.campaign.record.checksum`; of a run without id
        # and ended_at
        *(
            f"ALTER TABLE {table} ADD COLUMN checksum INTEGER"
            for table in ("campaign", "candidate", "test", "trajectory", "redrive_run", "redrive")
        ),
        # m, between the recorded failure and this one; older drives have none
        "ALTER TABLE redrive ADD COLUMN difference REAL CHECK (difference >= 0)",
    ),
    (
        f"""
        CREATE TABLE earlier (
            number INTEGER PRIMARY KEY CHECK (number >= 1),
            campaign INTEGER NOT NULL CHECK (campaign >= 1),  -- of those that it starts from
            test INTEGER NOT NULL,  -- id of the test there
            step REAL NOT NULL CHECK (step > 0),  -- m between curvatures
            curvatures BLOB NOT NULL CHECK (length(curvatures) % 8 = 0),  -- 1/m, float64
            outcome TEXT NOT NULL,  -- PASS or FAIL
            moobd REAL NOT NULL,  -- m
            objective REAL,  -- what is minimised, if it is not the MOOBD
            place REAL,  -- m along the road to where the car left or was furthest off
            side TEXT CHECK (side IN ('left', 'right')),  -- where it left its lane
            duration REAL,  -- simulated s
            distance BLOB NOT NULL,  -- m along the road, float64, of each record of the drive
            lateral_offset BLOB NOT NULL,  -- m left of the ego lane's centre line, likewise
            speed BLOB NOT NULL,  -- m/s, likewise
            checksum INTEGER
        ) {_STRICT}
        """,
        f"""
        CREATE TABLE objective (
            candidate_id INTEGER PRIMARY KEY REFERENCES test (candidate_id),
            value REAL NOT NULL,  -- what is minimised, of a driven test, if it is not the MOOBD
            checksum INTEGER
        ) {_STRICT}
        """,
        f"""
        CREATE TABLE screening (
            candidate_id INTEGER PRIMARY KEY REFERENCES candidate (id),
            role TEXT NOT NULL CHECK (role IN ('screened', 'control')),
            drawn INTEGER NOT NULL CHECK (drawn >= 0),  -- roads that the twin drove to choose it
            outcome TEXT NOT NULL,  -- of the twin's drive
            moobd REAL,  -- m, of the twin's drive
            checksum INTEGER
        ) {_STRICT}
        """,
    ),
)
"""Statements that bring a database from schema version k to k + 1; never edited, only appended."""
_UNREAD: Final = frozenset({4, 5, 6})
"""Schema versions that only add what readers of the store can do without."""


def _insert(table: str, columns: int) -> str:
    """The INSERT of a table with so many columns and a checksum."""
    return f"INSERT INTO {table} VALUES ({', '.join('?' * (columns + 1))})"  # noqa: S608


_HELD: Final[Mapping[str, str]] = {
    "candidate": _insert("candidate", len(CANDIDATE_COLUMNS)),
    "screening": _insert("screening", len(SCREENING_COLUMNS)),
    "test": _insert("test", len(TEST_COLUMNS)),
    "trajectory": _insert("trajectory", 2),
    "objective": _insert("objective", 2),
}
"""Table of results -> its INSERT, in the order of writing."""
_INSERT_EARLIER: Final = _insert("earlier", len(EARLIER_COLUMNS))
_REPLACE_FACT: Final = "INSERT OR REPLACE INTO campaign VALUES (?, ?, ?)"
# {} is the column of checksums, NULL in older schemas.
_SELECT_CANDIDATE: Final = f"SELECT {', '.join(CANDIDATE_COLUMNS)}, {{}} FROM candidate"  # noqa: S608
_SELECT_RESULT: Final = f"SELECT {', '.join(TEST_COLUMNS)}, {{}} FROM test"  # noqa: S608
_SELECT_TEST: Final = f"""
    SELECT {", ".join(TEST_COLUMNS)}, {{}}, {", ".join(CANDIDATE_COLUMNS)}, {{}}
    FROM test LEFT JOIN candidate ON id = candidate_id WHERE candidate_id = ?
"""  # noqa: S608
_SELECT_TRAJECTORY: Final = "SELECT candidate_id, data, {} FROM trajectory"
_SELECT_EARLIER: Final = f"SELECT {', '.join(EARLIER_COLUMNS)}, {CHECKSUM} FROM earlier"  # noqa: S608
_SELECT_FACTS: Final = "SELECT key, value, {} FROM campaign"
_SELECT_IDS: Final[Mapping[str, str]] = {
    "told": """
        SELECT candidate_id FROM test
        WHERE told > ? AND (? IS NULL OR outcome = ?) ORDER BY told LIMIT ?
    """,
    "moobd": """
        SELECT candidate_id FROM test
        WHERE told > ? AND (? IS NULL OR outcome = ?)
        ORDER BY moobd IS NULL, moobd, told LIMIT ?
    """,
}
SELECT_TESTED_ROADS: Final = """
    SELECT step, curvatures, points FROM candidate JOIN test ON id = candidate_id
    WHERE outcome <> 'DROPPED'
"""
"""The roads of all tests, see `frenetic.campaign.counts.road_key`."""
_SELECT_SCREENINGS: Final = f"""
    SELECT candidate.id, test.outcome, test.moobd,
        {", ".join(f"screening.{name}" for name in SCREENING_COLUMNS)}, screening.{CHECKSUM}
    FROM candidate LEFT JOIN screening ON screening.candidate_id = id
    LEFT JOIN test ON test.candidate_id = id ORDER BY id
"""  # noqa: S608
_CHECKSUMS_SINCE: Final = 5  # schema version
_EARLIER_SINCE: Final = 6  # likewise
_CONFIG: Final = "config"
_CREATED_AT: Final = "created_at"


class CampaignStore(ShownCampaign):
    """The database of one campaign, open for one writer or for reading.

    Made by `create` or `open`; a context manager that closes it. One process writes at a time and
    any number may read meanwhile. A fork of the process that opened it never writes. Call methods
    from the thread that opened the store. Every problem with the database is a `CampaignError`
    whose message names the file and what to do. After a failed `told`, for example on a full disk,
    the database still holds everything told before, and the same record may be told again.
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, lock: FileLock | None
    ) -> None:  # used by `create` and `open` only
        self._folder = folder
        self._path = folder / DATABASE
        self._connection = connection
        self._owner = Owner(connection)
        self._lock = lock
        # Rows that the next transaction writes.
        self._held: dict[str, list[tuple[object, ...]]] = {table: [] for table in _HELD}
        self._last_asked = 0
        self._told = 0
        with translated(self._path):
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            has_checksums = version >= _CHECKSUMS_SINCE
            self._has_earlier = version >= _EARLIER_SINCE  # and other tables
            self.checksum_column: Final = CHECKSUM if has_checksums else "NULL"
            """The column of checksums in a SELECT, NULL in an older schema."""
            self._select_test = _SELECT_TEST.format(
                *(
                    f"{name}.{CHECKSUM}" if has_checksums else "NULL"
                    for name in ("test", "candidate")
                )
            )
            if lock is not None:
                (last,) = connection.execute("SELECT max(id) FROM candidate").fetchone()
                self._last_asked = last or 0
                (self._told,) = connection.execute("SELECT count(*) FROM test").fetchone()
            self._config = self._read_config()
        self._setting = None if setting_faults(self._config) else Setting.of(self._config)

    @classmethod
    def create(
        cls,
        folder: Path | str,
        config: Mapping[str, JSONValue],
        earlier: Iterable[EarlierTest] = (),
    ) -> Self:
        """Return a new campaign in `folder`, open for writing; the folder is made if need be.

        `earlier` are the tests of earlier campaigns that it starts from.

        Raises a `CampaignError` if `folder` holds a campaign already or cannot be written, and a
        `ValueError` if `config` is not JSON (NaN and infinity are not).
        """
        folder = Path(folder)
        facts = {_CONFIG: _to_json(dict(config)), _CREATED_AT: _to_json(present_moment())}
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise CampaignError(
                f"cannot make the folder {folder}: a file is in the way; choose another folder "
                "with --out"
            ) from error
        except OSError as error:
            raise CampaignError(
                f"cannot make the folder {folder}: {error.strerror or error}; choose another "
                "folder with --out"
            ) from error
        path = folder / DATABASE
        _refuse_existing(path)
        lock = lock_file(folder / LOCK)
        try:
            _refuse_existing(path)  # again: someone may have been faster before we had the lock
            # Made under another name, so that a campaign exists completely or not at all.
            unfinished = folder / f"{DATABASE}.new"
            with translated(path):
                for leftover in ("", "-wal", "-shm", "-journal"):
                    unfinished.with_name(unfinished.name + leftover).unlink(missing_ok=True)
                _make_database(unfinished, facts, earlier)
                unfinished.replace(path)
            return cls._open_locked(folder, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def open(cls, folder: Path | str, readonly: bool = True) -> Self:
        """Return the campaign in `folder`; a schema of an older version is updated.

        Raises a `CampaignError` if there is none, if its database is damaged, from a newer version
        or no campaign (it is left unchanged), or, for writing, if another process writes it.
        """
        folder = Path(folder)
        find_database(folder)
        if readonly:
            return cls._open_to_read(folder)
        lock = lock_file(folder / LOCK)
        try:
            return cls._open_locked(folder, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _open_to_read(cls, folder: Path) -> Self:
        path = folder / DATABASE
        with translated(path):
            connection = connect_to_read(path)
        try:
            with translated(path):
                version = check_identity(connection, path)
            if set(range(version + 1, len(MIGRATIONS) + 1)) - _UNREAD:
                connection.close()
                cls._update_schema(folder, version)
                with translated(path):
                    connection = connect_to_read(path)
            return cls(folder, connection, None)
        except BaseException:
            connection.close()
            raise

    @classmethod
    def _update_schema(cls, folder: Path, version: int) -> None:
        try:
            cls.open(folder, readonly=False).close()
        except CampaignError as error:
            raise CampaignError(
                f"{folder / DATABASE} was written by an older version of frenetic (schema "
                f"{version}, this one reads {len(MIGRATIONS)}) and cannot be brought up to date: "
                f"{error}"
            ) from error

    @classmethod
    def _open_locked(cls, folder: Path, lock: FileLock) -> Self:
        connection = connect_to_write(folder / DATABASE)
        try:
            with translated(folder / DATABASE):
                # Waiting for the disk every 16 MiB instead of every 4 MiB.
                connection.execute("PRAGMA wal_autocheckpoint = 4000").fetchone()
            return cls(folder, connection, lock)
        except BaseException:
            connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        if error is None:
            self.close()
        else:
            with suppress(CampaignError):  # the error under way says more
                self.close()

    def at_a_glance(self) -> str:
        """The campaign's folder and results: ``campaigns/night: 70 PASS, 12 FAIL``."""
        counts = [f"{number} {outcome}" for outcome, number in self.by_outcome().items() if number]
        return f"{self._folder}: {', '.join(counts) or 'no results'}"

    def __repr__(self) -> str:
        """The campaign at a glance; of a closed one, its folder."""
        try:
            return f"<CampaignStore {self.at_a_glance()}>"
        except CampaignError:
            return f"<CampaignStore {self._folder}>"

    @property
    def folder(self) -> Path:
        """The campaign's folder."""
        return self._folder

    @property
    def config(self) -> Mapping[str, JSONValue]:
        """The campaign's configuration."""
        return self._config

    @property
    def setting(self) -> Setting:
        """The setting of the campaign's drives.

        Raises a `CampaignError` if the configuration lacks it.
        """
        if self._setting is None:
            raise self._damaged("; ".join(setting_faults(self._config)))
        return self._setting

    @property
    def facts(self) -> Mapping[str, JSONValue]:
        """Other facts of the campaign: ``created_at`` and those that `finish` added."""
        with translated(self._path):
            rows = self._connection.execute(
                f"{_SELECT_FACTS.format(self.checksum_column)} ORDER BY key"
            )
            return MappingProxyType(
                {row[0]: self._to_fact(row, f"fact {row[0]}") for row in rows if row[0] != _CONFIG}
            )

    @property
    def changes(self) -> tuple[PartChange, ...]:
        """The changes of parts that were accepted when the campaign was resumed, in order."""
        try:
            return read_changes(self.facts.get(CHANGES))
        except ValueError as error:
            raise self._damaged(f"the fact {CHANGES}: {error}") from None

    @property
    def parts(self) -> Mapping[str, JSONValue]:
        """The configuration with the parts that the campaign was resumed with last."""
        return MappingProxyType(present_parts(self.config, self.changes))

    def parts_of(self, told: int) -> Mapping[str, JSONValue]:
        """Return the configuration with the parts that gave the result told as this number."""
        changes = [change for change in self.changes if change.first <= told]
        return MappingProxyType(present_parts(self.config, changes))

    def asked(self, candidate: Candidate) -> None:
        """Record `candidate`, to be written together with the next result (or on closing).

        Raises a `CampaignError` if its id is not higher than that of every candidate before, and a
        `ValueError` if a number is not finite.
        """
        self._require_writer()
        if candidate.id <= self._last_asked:
            raise CampaignError(
                f"{self._path} already holds candidate {self._last_asked}: the next one needs a "
                f"higher id, not {candidate.id}"
            )
        self._held["candidate"].append(with_checksum(row_of_candidate(candidate, self._told)))
        if candidate.screening is not None:
            self._held["screening"].append(with_checksum(row_of_screening(candidate)))
        self._last_asked = candidate.id

    def told(
        self, record: TestRecord, trajectory: bytes | None = None, *, hold: bool = False
    ) -> None:
        """Store a result with its trajectory, durably (see this module's text): one transaction.

        An encoded `trajectory` of another process replaces the record's. With `hold` the result
        only waits for `write`, so that several become one transaction.

        Raises a `CampaignError` if it cannot be written, if the candidate was not asked before or
        has a result already, or if another result has the same `told`; a `ValueError` if a number
        is not finite.
        """
        self._require_writer()
        row = with_checksum(row_of_test(record, present_moment()))
        data = trajectory
        if data is None and record.trajectory is not None:
            data = encode(record.trajectory)
        self._held["test"].append(row)
        if data is not None:
            self._held["trajectory"].append(with_checksum((int(record.candidate.id), data)))
        self._told += 1
        if hold:
            return
        try:
            self.write()
        except BaseException:
            if self._held["test"]:  # else it was Ctrl-C, noticed when all was written
                self._held["test"].pop()
                if data is not None:
                    self._held["trajectory"].pop()
                self._told -= 1
            raise

    def measured(self, id: int, value: float) -> None:  # noqa: A002
        """Record the objective's value for a held test, to be written together with it.

        Raises a `CampaignError` if the store was opened for reading.
        """
        self._require_writer()
        self._held["objective"].append(with_checksum((int(id), float(value))))

    def write(self) -> None:
        """Store held results and asked candidates, durably.

        Raises a `CampaignError` as `told` does; held results then stay held.
        """
        if self._held["candidate"] or self._held["test"]:
            with self._transaction():
                pass

    def finish(self, **facts: JSONValue) -> None:
        """Add facts about the whole campaign, such as its ``seconds``.

        The time, ``finished_at``, is added unless it is given. An older fact is replaced, since a
        campaign can be resumed and finish again.

        Raises a `ValueError` for a fact that is not JSON or is called ``config`` or ``created_at``.
        """
        rows = self._fact_rows({"finished_at": present_moment()} | facts)
        with self._transaction() as connection:
            connection.executemany(_REPLACE_FACT, rows)

    def reopen(self, **facts: JSONValue) -> None:
        """Replace the facts about the campaign's end by others.

        Raises a `ValueError` as `finish` does.
        """
        rows = self._fact_rows(facts)
        with self._transaction() as connection:
            connection.execute(
                "DELETE FROM campaign"
                " WHERE key IN ('finished_at', 'seconds', 'interrupted', 'ended')"
            )
            connection.executemany(_REPLACE_FACT, rows)

    def _fact_rows(self, facts: Mapping[str, JSONValue]) -> list[tuple[object, ...]]:
        self._require_writer()
        if fixed := {_CONFIG, _CREATED_AT} & facts.keys():
            raise ValueError(f"{', '.join(sorted(fixed))} cannot be changed: choose another name")
        return [with_checksum((key, _to_json(value))) for key, value in facts.items()]

    def tests(
        self,
        outcome: Outcome | None = None,
        order_by: Order = "told",
        limit: int | None = None,
        with_trajectory: bool = False,
        after: int = 0,
    ) -> Iterator[TestRecord]:
        """Return an iterator over the tests that are stored at this moment.

        It gives only those with `outcome`, if given, that were told later than the first `after`,
        and at most `limit` of them, in the order of telling, or of `moobd`, lowest first and those
        without one last. Later tests do not show up. Without `with_trajectory` their trajectory is
        None.

        Raises a `ValueError` for an unknown outcome or order, or a limit that is no whole number
        from 0; taking a damaged test raises a `CampaignError`.
        """
        if order_by not in get_args(Order):
            raise ValueError(f"order_by is {order_by!r}: one of {get_args(Order)} is needed")
        if limit is not None:
            limit = require_count("limit", limit, 0)
        # A stored test never changes, so the ids are a snapshot, and no transaction stays open
        # between two tests.
        only = None if outcome is None else str(Outcome(outcome))
        wanted = (int(after), only, only, -1 if limit is None else limit)
        self._write_tests()
        with translated(self._path):
            ids = self._connection.execute(_SELECT_IDS[order_by], wanted).fetchall()
        return (self._read_test(candidate_id, with_trajectory) for (candidate_id,) in ids)

    def test(self, id: int, with_trajectory: bool = True) -> TestRecord:  # noqa: A002
        """Return the test of the candidate with this `id`.

        Raises a `CampaignError` if there is none (naming the existing ids) or if it is damaged, and
        a `ValueError` if the id is no whole number.
        """
        self._write_tests()
        return self._read_test(id, with_trajectory)

    def trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """Return the trajectory of the candidate with this `id`; None if none is stored.

        The rest of its test is not read. Raises a `CampaignError` if the trajectory is damaged.
        """
        self._write_tests()
        return self._read_trajectory(id)

    def candidate(self, id: int) -> Candidate:  # noqa: A002
        """Return the candidate with this `id`, whether it has a result or not.

        Raises a `CampaignError` if there is none (naming the existing ids) or if it is damaged.
        """
        self.write()
        with translated(self._path):
            row = self._fetch(f"{_SELECT_CANDIDATE.format(self.checksum_column)} WHERE id = ?", id)
            if row is None:
                raise self._unknown("candidate", id, "SELECT min(id), max(id) FROM candidate")
        return self._to_candidate(row)[0]

    def candidates(self) -> Iterator[Candidate]:
        """Return all candidates that were asked up to this moment, in the order of asking."""
        return (candidate for candidate, _ in self.candidates_with_place())

    def candidates_with_place(self) -> Iterator[tuple[Candidate, int]]:
        """Return all candidates, each with the number of results told before it."""
        self.write()
        with translated(self._path):
            rows = self._connection.execute(
                "SELECT id, asked_after FROM candidate ORDER BY id"
            ).fetchall()
        return ((self.candidate(candidate_id), place) for candidate_id, place in rows)

    def screenings(self) -> list[tuple[Screening | None, Outcome | None, float | None]]:
        """Return of each candidate its screening, and its test's outcome and MOOBD in m.

        Those that are not known are None. Empty if no candidate was screened.

        Raises a `CampaignError` if one is damaged.
        """
        found: list[tuple[Screening | None, Outcome | None, float | None]] = []
        for number, outcome, moobd, *row in self._later(_SELECT_SCREENINGS):
            screening = None
            if row[0] is not None:
                with self._naming(f"of the screening of candidate {number}"):
                    screening = read_screening(row[:-1])
                self._require_checksum(row, f"the screening of candidate {number}")
            read = None if outcome is None else Outcome(self._value("outcome", outcome))
            found.append((screening, read, None if moobd is None else self._value("moobd", moobd)))
        return found if any(one[0] is not None for one in found) else []

    def by_outcome(self) -> dict[Outcome, int]:
        """Return the number of results per outcome; every outcome is present."""
        return self._count_by_outcome()[0]

    def objectives(self) -> dict[int, float]:
        """Return the objective's value for the tests that have one, by id in the order of ids.

        There are none if the MOOBD is minimised. Raises a `CampaignError` if one is damaged.
        """
        rows = self._later(
            "SELECT candidate_id, value, checksum FROM objective ORDER BY candidate_id"
        )
        for row in rows:
            self._require_checksum(row, f"the objective of test {row[0]}")
            if not is_number(row[1]):
                raise self._damaged(f"the objective of test {row[0]} is no finite number")
        return {row[0]: row[1] for row in rows}

    def earlier(self) -> list[EarlierTest]:
        """Return the tests of earlier campaigns that this one started from, in their order.

        Raises a `CampaignError` if one is damaged.
        """
        found = []
        for row in self._later(f"{_SELECT_EARLIER} ORDER BY number"):
            name = f"earlier test {row[0]}"
            with self._naming(f"of {name}"):
                found.append(read_earlier(row[:-1]))
            self._require_checksum(row, name)
        return found

    def counts(self) -> StoredCounts:
        """Return the number of tests per outcome and of different roads, and the lowest MOOBD.

        Reads the roads of all tests: where numbers are enough, `by_outcome` is faster.
        """
        by_outcome, min_moobd = self._count_by_outcome()
        with translated(self._path):
            (asked,) = self._connection.execute("SELECT count(*) FROM candidate").fetchone()
            roads = {road_key(*row) for row in self._connection.execute(SELECT_TESTED_ROADS)}
        return StoredCounts.of(
            by_outcome, min_moobd, len(roads), asked=asked + len(self._held["candidate"])
        )

    def _count_by_outcome(self) -> tuple[dict[Outcome, int], float | None]:
        """Return the number of results per outcome, and the lowest MOOBD in m."""
        self._write_tests()
        with translated(self._path):
            rows = self._connection.execute(
                "SELECT outcome, count(*), min(moobd) FROM test GROUP BY outcome"
            ).fetchall()
        by_outcome = dict.fromkeys(Outcome, 0)
        by_outcome |= {
            Outcome(self._value("outcome", outcome)): count for outcome, count, _ in rows
        }
        moobds = [self._value("moobd", moobd) for *_, moobd in rows if moobd is not None]
        return by_outcome, min(moobds, default=None)

    def stored(self) -> int:
        """Return the number of results on disk, without held ones; 0 if it cannot be read."""
        with suppress(CampaignError), translated(self._path):
            (number,) = self._connection.execute("SELECT count(*) FROM test").fetchone()
            return int(number)
        return 0

    def elapsed(self) -> float:
        """Return the campaign's time at the last result, in s."""
        self._write_tests()
        with translated(self._path):
            rows = self._connection.execute("SELECT seconds, elapsed FROM test ORDER BY told")
            total = 0.0
            for seconds, elapsed in rows:
                # Logs of old versions hold only the time of each test.
                if elapsed is None:
                    total += self._value("seconds", seconds)
                else:
                    total = self._value("elapsed", elapsed)
        return total

    def rows(self, select: str, parameters: Sequence[object] = ()) -> Iterator[tuple[Any, ...]]:
        """Return the rows of a SELECT, for reading many tests at once.

        Nothing is checked. Later results may show up.
        """
        self.write()
        with translated(self._path):
            yield from self._connection.execute(select, tuple(parameters))

    def close(self) -> None:
        """Write the rest and close the database; closing twice does no harm.

        In a fork it does nothing.
        """
        if not self._owner.is_here:
            return
        try:
            self.write()
        finally:
            self._forget_held()
            try:
                with translated(self._path):
                    self._connection.close()
            finally:
                if self._lock is not None:
                    self._lock.release()

    # Writing

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Give the connection within a transaction that begins with the held results.

        They stay held when it fails, so that it can be tried again.
        """
        self._owner.require(self._path)
        connection = self._connection
        has_begun = False
        with translated(self._path):
            try:
                connection.execute("BEGIN IMMEDIATE")
                has_begun = True
                for table, insert in _HELD.items():
                    connection.executemany(insert, self._held[table])
                yield connection
                connection.execute("COMMIT")
                self._forget_held()
            except BaseException as error:
                if connection.in_transaction:  # SQLite ends some by itself
                    connection.execute("ROLLBACK")
                elif has_begun and not isinstance(error, sqlite3.Error):
                    self._forget_held()  # Ctrl-C, noticed when all was written
                raise

    def _write_tests(self) -> None:
        if self._held["test"]:
            self.write()

    def _forget_held(self) -> None:
        for rows in self._held.values():
            rows.clear()

    def _require_writer(self) -> None:
        if self._lock is None:
            raise CampaignError(f"{self._path} was opened for reading: open it with readonly=False")
        self._owner.require(self._path)

    # Reading: every value from the disk is validated

    def require_whole(self) -> None:
        """Raise a `CampaignError` if SQLite finds the file damaged, so that nothing is added.

        Reads the whole file once, which takes about a second per gigabyte.
        """
        with translated(self._path):
            (verdict,) = self._connection.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise self._damaged(" ".join(verdict.split()))

    def _later(self, select: str) -> list[tuple[Any, ...]]:
        """Return the rows of a table that came with schema 6; there are none in older ones."""
        if not self._has_earlier:
            return []
        self.write()
        with translated(self._path):
            return self._connection.execute(select).fetchall()

    def _fetch(self, select: str, candidate_id: int) -> tuple[Any, ...] | None:
        """Return the row with this id, if there is one; SQLite knows no ids beyond 64 bits.

        Raises a `ValueError` if the id is no whole number.
        """
        try:
            number = operator.index(candidate_id)  # of numpy, too
        except TypeError:
            raise ValueError(f"id is {candidate_id!r}: a whole number is needed") from None
        if not 0 < number < 2**63:
            return None
        row: tuple[Any, ...] | None = self._connection.execute(select, (number,)).fetchone()
        return row

    def _unknown(self, what: str, candidate_id: int, select_range: str) -> CampaignError:
        lowest, highest = self._connection.execute(select_range).fetchone()
        there_are = f"ids run from {lowest} to {highest}" if lowest else "there are none so far"
        return CampaignError(f"{self._folder} holds no {what} {candidate_id}: {there_are}")

    def _damaged(self, what: str) -> CampaignError:
        return CampaignError(
            f"{self._path} is damaged: {what}; restore it from a copy, or run the campaign again"
        )

    def _read_test(self, candidate_id: int, with_trajectory: bool) -> TestRecord:
        with translated(self._path):
            row = self._fetch(self._select_test, candidate_id)
            if row is None:
                raise self._unknown(
                    "test of candidate",
                    candidate_id,
                    "SELECT min(candidate_id), max(candidate_id) FROM test",
                )
        of_test, of_candidate = row[: len(TEST_COLUMNS) + 1], row[len(TEST_COLUMNS) + 1 :]
        if of_candidate[0] is None:
            raise self._damaged(f"candidate {candidate_id} is missing")
        candidate, _ = self._to_candidate(of_candidate)
        trajectory = self._read_trajectory(candidate_id) if with_trajectory else None
        with self._naming(f"of test {candidate_id}"):
            record = read_test(of_test[:-1], candidate, trajectory, self._setting)
        self._require_checksum(of_test, f"test {candidate_id}")
        return record

    def _read_trajectory(self, candidate_id: int) -> Trajectory | None:
        select = f"{_SELECT_TRAJECTORY.format(self.checksum_column)} WHERE candidate_id = ?"
        with translated(self._path):
            row = self._fetch(select, candidate_id)
        if row is None:
            return None
        name, data = f"the trajectory of test {candidate_id}", row[1]
        if not isinstance(data, bytes):
            raise self._damaged(f"{name} has the wrong type")
        try:
            trajectory = decode(data)
        except CampaignError as error:
            raise CampaignError(f"{self._path}: {name}: {error}") from error
        self._require_checksum(row, name)
        return trajectory

    def _require_checksum(self, row: Sequence[Any], name: str) -> None:
        if fault := checksum_fault(row):
            raise self._damaged(f"{name} {fault}")

    def require_checksums(self, after: int, until: int, *, trajectories: bool = False) -> None:
        """Raise a `CampaignError` if a test, its road or, if asked, its trajectory was changed.

        It looks at the results told as numbers ``after + 1`` to ``until``.
        """
        told = "SELECT candidate_id FROM test WHERE told > ? AND told <= ?"
        wanted = [
            (_SELECT_RESULT, "candidate_id", "test"),
            (_SELECT_CANDIDATE, "id", "candidate"),
            *([(_SELECT_TRAJECTORY, "candidate_id", "the trajectory of test")] * trajectories),
        ]
        with translated(self._path):
            for select, column, name in wanted:
                rows = f"{select.format(self.checksum_column)} WHERE {column} IN ({told})"
                for row in self._connection.execute(rows, (after, until)):
                    self._require_checksum(row, f"{name} {row[0]}")

    def _to_candidate(self, row: tuple[Any, ...]) -> tuple[Candidate, int]:
        with self._naming(f"of candidate {row[0]}"):
            candidate = read_candidate(row[:-1])
        self._require_checksum(row, f"candidate {row[0]}")
        return candidate

    @contextmanager
    def _naming(self, name: str) -> Iterator[None]:
        """Turns the faults of a row into a `CampaignError` that names the row."""
        try:
            yield
        except RowError as error:
            column, text = error.fault
            raise self._damaged(f"the {column} {name} {text}") from None

    def _value(self, column: str, value: object) -> Any:
        """A value of some test."""
        try:
            return TEST_COLUMNS[column].read(value)
        except ValueError as error:
            raise self._damaged(f"the {column} of a test {error}") from None

    def _to_fact(self, row: tuple[Any, ...], name: str) -> JSONValue:
        value = self._from_json(row[1], name)
        self._require_checksum(row, f"the {name}")
        return value

    def _from_json(self, text: object, name: str) -> JSONValue:
        try:
            value: JSONValue = json.loads(text) if isinstance(text, str) else None
        except (ValueError, RecursionError):
            text = None
        if not isinstance(text, str):
            raise self._damaged(f"the {name} is not JSON")
        return value

    def _read_config(self) -> Mapping[str, JSONValue]:
        row = self._connection.execute(
            f"{_SELECT_FACTS.format(self.checksum_column)} WHERE key = ?", (_CONFIG,)
        ).fetchone()
        config = self._to_fact(row or (_CONFIG, None, None), _CONFIG)
        if not isinstance(config, dict):
            raise self._damaged("the config is no JSON object")
        return MappingProxyType(config)


def _to_json(value: JSONValue) -> str:
    return json.dumps(value, allow_nan=False, default=plain)


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise CampaignError(
            f"{path.parent} already holds a campaign; choose another folder with --out, or "
            "go on with that one: frenetic resume (in Python: resume())"
        )


def _connect(path: Path, options: str) -> sqlite3.Connection:
    """Return a connection that begins and ends transactions only when told to."""
    uri = path.resolve().as_uri()
    if not uri.startswith(
        "file:///"
    ):  # a network share on Windows: SQLite wants no host in the URI
        uri = "file:////" + uri.removeprefix("file://")
    return sqlite3.connect(
        f"{uri}?{options}", uri=True, timeout=_BUSY_TIMEOUT, isolation_level=None
    )


def find_database(folder: Path) -> Path:
    """Return the path of the database in a campaign's folder, or a CampaignError without one."""
    path = folder / DATABASE
    with translated(path):
        if not path.is_file():
            what = "holds no campaign" if folder.is_dir() else "is not a folder"
            if not os.path.lexists(folder):
                what = "does not exist"
            raise CampaignError(
                f"{folder} {what}: the folder of a campaign is needed, one with {DATABASE}"
            )
    return path


def connect_to_read(path: Path) -> sqlite3.Connection:
    """Return a connection that changes nothing, even in a writable folder."""
    connection = _connect(path, "mode=ro")
    try:
        connection.execute("PRAGMA user_version").fetchone()
    except BaseException as error:
        connection.close()
        # Even a reader makes files beside the database, which fails in a folder that it may not
        # write. If no writer's log is there, nobody is writing: this is what `immutable` promises.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        is_written = path.with_name(f"{DATABASE}-wal").exists()
        if code not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY) or is_written:
            raise
        connection = _connect(path, "mode=ro&immutable=1")
    return connection


def connect_to_write(path: Path) -> sqlite3.Connection:
    """Return a connection for writing; a schema of an older version is updated.

    Others may write meanwhile, transaction by transaction. Raises a `CampaignError` if this is no
    campaign's database that this version can write.
    """
    with translated(path):
        connection = _connect(path, "mode=rw")
        try:
            version = check_identity(connection, path)
            connection.execute("PRAGMA journal_mode = WAL").fetchone()
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.execute("PRAGMA foreign_keys = ON")
            _migrate(connection, version)
        except BaseException:
            connection.close()
            raise
    return connection


class Owner:
    """The process that opened a connection; a fork of it is another.

    SQLite's locks belong to a process, so a fork never writes, and keeps its copy of the connection
    open until its end: closing it could free the locks of the owner.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._process_id = os.getpid()
        _owners.add(self)

    @property
    def is_here(self) -> bool:
        """Whether it is this process."""
        return os.getpid() == self._process_id

    def require(self, path: Path) -> None:
        """Checks that this process is the owner, before it writes the database at ``path``.

        Raises:
            CampaignError: it is a fork.
        """
        if not self.is_here:
            raise CampaignError(
                f"{path} is written by process {self._process_id}; this one, {os.getpid()}, is a"
                " fork of it and may not: end the fork where its work is done"
            )

    def keep_open(self) -> None:
        """In a fork: keeps the connection for good."""
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._connection))


_owners: Final[WeakSet[Owner]] = WeakSet()


def _keep_open() -> None:
    for owner in _owners:
        owner.keep_open()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_open)


def check_identity(connection: sqlite3.Connection, path: Path) -> int:
    """Return the schema version after checking that this is a campaign that we can read."""
    (application_id,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if application_id != APPLICATION_ID or version < 1:
        raise CampaignError(
            f"{path} is not a campaign's database: choose the folder of a campaign; nothing was "
            "changed"
        )
    if version > len(MIGRATIONS):
        raise CampaignError(
            f"{path} was written by a newer version of frenetic (schema {version}, this one reads "
            f"up to {len(MIGRATIONS)}): upgrade frenetic; nothing was changed"
        )
    return int(version)


def _make_database(path: Path, facts: Mapping[str, str], earlier: Iterable[EarlierTest]) -> None:
    """Write a complete campaign without tests to the new file at `path`."""
    connection = _connect(path, "mode=rwc")
    try:
        # It counts when it is complete, so only its end waits for the disk.
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("PRAGMA journal_mode = MEMORY").fetchone()
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        _migrate(connection, 0)
        with transaction(connection):
            connection.executemany(_REPLACE_FACT, map(with_checksum, facts.items()))
            rows = map(with_checksum, map(row_of_earlier, earlier))
            connection.executemany(_INSERT_EARLIER, rows)
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
    finally:
        connection.close()
    flush(path)


def _migrate(connection: sqlite3.Connection, version: int) -> None:
    """Bring the schema from `version` to the newest, each step in a transaction of its own."""
    for number, statements in enumerate(MIGRATIONS[version:], start=version + 1):
        with transaction(connection):
            (now,) = connection.execute("PRAGMA user_version").fetchone()
            if now < number:  # else another process was faster
                for statement in statements:
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {number}")


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """A transaction for writing, which is undone if anything is raised."""
    try:
        connection.execute("BEGIN IMMEDIATE")
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn errors of SQLite and the file system into a `CampaignError` about `path`."""
    try:
        yield
    except sqlite3.Error as error:
        # Extended codes carry the primary one in their lowest byte; Python's own errors have none.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        text = " ".join(str(error).split())
        raise CampaignError(f"{path} {_EXPLAINED.get(code, _UNEXPLAINED).format(text)}") from error
    except UnicodeDecodeError as error:  # SQLite quotes what it found in its complaint
        raise CampaignError(f"{path} {_EXPLAINED[sqlite3.SQLITE_CORRUPT].format(error)}") from error
    except OSError as error:
        raise CampaignError(
            f"cannot use {path}: {error.strerror or error}; check its permissions, or choose "
            "another folder"
        ) from error


_EXPLAINED: Final[Mapping[int, str]] = {
    sqlite3.SQLITE_FULL: (
        "cannot grow, the disk is full: free some space and resume the campaign; what was stored "
        "is safe"
    ),
    sqlite3.SQLITE_READONLY: "cannot be written ({}): check the permissions of the file and folder",
    sqlite3.SQLITE_PERM: "cannot be used ({}): check the permissions of the file and folder",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened ({}): check the permissions of the file and folder",
    sqlite3.SQLITE_BUSY: "is in use by another program ({}): close it and try again",
    sqlite3.SQLITE_LOCKED: "is in use by another program ({}): close it and try again",
    sqlite3.SQLITE_IOERR: "cannot be read or written ({}): check the disk and try again",
    sqlite3.SQLITE_CORRUPT: "is damaged ({}): restore it from a copy, or run the campaign again",
    sqlite3.SQLITE_NOTADB: (
        "is not a database, or is damaged ({}): restore it from a copy, or choose another folder"
    ),
    sqlite3.SQLITE_CONSTRAINT: (
        "refuses what does not fit the rest ({}): a candidate is asked once, then told once"
    ),
}
"""SQLite's primary result code -> its meaning for the campaign and what to do."""
_UNEXPLAINED: Final = "cannot be used ({}): restore it from a copy, or run the campaign again"
