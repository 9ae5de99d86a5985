"""A campaign on disk: every test, as it comes, in one SQLite database.

The database, `campaign.sqlite` in the campaign's folder, is the campaign's record. Anyone with
SQLite can read it, while the campaign runs and long afterwards:

| table | one row per |
| --- | --- |
| fact | fact about the campaign (JSON): its configuration, when it was made and finished |
| test | road that the strategy asked for, with its result and drive once it is told |
| finding | breach of a criterion in a drive |
| earlier_test | test of another campaign, or real road, that this one starts from |
| earlier_finding | breach of a criterion in such a test |

`frenetic.campaign.record` declares the columns. A test's trajectory is compressed by
`frenetic.campaign.trajectory_codec`.

When `CampaignStore.write` has returned, all results, their drives and all candidates asked before
are in the database, even if the process is killed right then. If the machine itself goes down, the
last results may be missing, but the database is sound.
"""

from __future__ import annotations

import json
import operator
import os
import sqlite3
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, Self, TypeAlias

from filelock import FileLock
from msgspec import convert

from frenetic._support.files import FolderInUse, flush
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.notebook import Shown
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted, present_moment
from frenetic.campaign.counts import Counts, FirstTests, road_key
from frenetic.campaign.lock import lock_file
from frenetic.campaign.record import (
    ASKED,
    FINDING,
    FINISHED,
    TOLD,
    Test,
    read_candidate,
    read_test,
    row_of,
)
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.errors import CampaignError, CampaignGoneError
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile
from frenetic.search.records import Candidate
from frenetic.spec.terms import Setting

DATABASE: Final = "campaign.sqlite"
"""Name of the database in a campaign's folder."""
FORMAT: Final = 7
"""Format of the database (`PRAGMA user_version`); another one is refused."""
APPLICATION_ID: Final = int.from_bytes(b"FrnC")
"""Mark of our campaigns among SQLite files (`PRAGMA application_id`)."""
LOCK: Final = "campaign.lock"
"""Name of the lock file in a campaign's folder."""
EARLIER_SETTINGS: Final = "earlier_settings"
"""Fact with the settings of the campaigns from which this one starts, by their folders."""
SOURCES: Final = "sources"
"""Fact with the user's own source of a campaign's parts: name of a file -> its text."""
STARTED_IN: Final = "started_in"
"""Fact with the folder from which a campaign was started, where its parts are found."""
SIGNATURE: Final = "signature"
"""Fact with the user's signature of what names code, of that folder and of these sources."""
Order: TypeAlias = Literal["told", "moobd"]

_BUSY_TIMEOUT: Final = 10.0  # s that a reader waits for the writer
_AT_ONCE: Final = 500  # tests read by one SELECT
_ENDINGS: Final = ("finished_at", "seconds", "interrupted", "ended", "notice")
_UNLISTED: Final = (
    "config",
    EARLIER_SETTINGS,
    SOURCES,
    STARTED_IN,
    SIGNATURE,
)  # large, or shown elsewhere


def _sql(columns: Sequence[object]) -> str:
    return ", ".join(map(str, columns))


_ASKED: Final = [*(column.name for column in ASKED), "asked_after"]
_TOLD: Final = [*(column.name for column in TOLD), "trajectory"]


@dataclass(frozen=True)
class _Tables:
    """Two tables, one of tests and one of their findings, and the statements for them."""

    test: str
    finding: str
    label: str
    """What one of the tests is called in messages."""

    @property
    def schema(self) -> str:
        """Statements that make the tables."""
        # asked_after is the number of results told before a road was asked for
        return f"""
            CREATE TABLE {self.test} (
                {_sql([f"{column.name} {column.sql_type}" for column in FINISHED])},
                asked_after INTEGER NOT NULL, trajectory BLOB, PRIMARY KEY (id)
            ) STRICT;
            CREATE TABLE {self.finding} (
                test INTEGER NOT NULL REFERENCES {self.test} (id), number INTEGER NOT NULL,
                {_sql([f'"{column.name}" {column.sql_type}' for column in FINDING])},
                PRIMARY KEY (test, number)
            ) STRICT, WITHOUT ROWID;
        """

    @cached_property
    def insert(self) -> str:
        """Statement that adds a candidate."""
        return f"INSERT INTO {self.test} ({_sql(_ASKED)}) VALUES ({_sql('?' * len(_ASKED))})"  # noqa: S608

    @cached_property
    def update(self) -> str:
        """Statement that adds the result of a candidate."""
        values = _sql([f"{name} = ?" for name in _TOLD])
        return f"UPDATE {self.test} SET {values} WHERE id = ?"  # noqa: S608

    @cached_property
    def insert_finding(self) -> str:
        """Statement that adds a finding."""
        return f"INSERT INTO {self.finding} VALUES ({_sql('?' * (len(FINDING) + 2))})"  # noqa: S608

    def select(self, count: int) -> str:
        """Return the statement that reads so many tests by their ids."""
        columns = _sql([column.name for column in FINISHED])
        return f"SELECT {columns} FROM {self.test} WHERE id IN ({_sql('?' * count)})"  # noqa: S608

    def select_findings(self, count: int) -> str:
        """Return the statement that reads the findings of so many tests."""
        columns = _sql([f'"{column.name}"' for column in FINDING])
        return (
            f"SELECT test, {columns} FROM {self.finding}"  # noqa: S608
            f" WHERE test IN ({_sql('?' * count)}) ORDER BY test, number"
        )

    def rows_of(self, test: Test, packed: bytes | None = None) -> dict[str, list[tuple[Any, ...]]]:
        """Return the statements that add the result of a test, each with its rows.

        Args:
            test: the test.
            packed: its encoded trajectory; None to encode that of the test.

        Raises:
            ValueError: a number is not finite.
        """
        if packed is None and test.trajectory is not None:
            packed = encode(test.trajectory)
            test = replace(test, records=len(test.trajectory))
        findings = enumerate([row_of(finding, FINDING) for finding in test.result.findings], 1)
        return {
            self.update: [(*row_of(test, TOLD), packed, test.id)],
            self.insert_finding: [(test.id, number, *row) for number, row in findings],
        }


_TESTS: Final = _Tables("test", "finding", "test")
_EARLIER: Final = _Tables("earlier_test", "earlier_finding", "earlier test")
_SCHEMA: Final = f"""
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {FORMAT};
CREATE TABLE fact (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID;
{_TESTS.schema}
{_EARLIER.schema}
"""
_REPLACE_FACT: Final = "INSERT OR REPLACE INTO fact VALUES (?, ?)"
_KEYS: Final = (
    f"SELECT id, outcome, conditions, step, curvatures, points, {_sql(profile.NAMES)} FROM test"  # noqa: S608
    " WHERE told IS NOT NULL AND outcome <> 'DROPPED' ORDER BY told"
)
_ORDERS: Final = {"told": "told", "moobd": "moobd IS NULL, moobd, told"}


class CampaignStore(Shown):
    """The database of one campaign, open for one writer or for reading.

    Made by `create` or `open`; a context manager that closes it. One process writes at a time and
    any number may read meanwhile. Call methods from the thread that opened the store. Every problem
    with the database is a `CampaignError` whose message names the file and what to do. After a
    failed `write`, for example on a full disk, the database still holds everything written before,
    and the rest waits for the next `write`.
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, lock: FileLock | None
    ) -> None:  # used by `create` and `open` only
        self.folder = folder
        """The campaign's folder."""
        self._path = folder / DATABASE
        self._connection = connection
        self._lock = lock
        self._opened = self._path.stat()
        self._in_use = FolderInUse(folder)
        self._held: dict[str, list[tuple[Any, ...]]] = {  # for the next transaction
            statement: [] for statement in (_TESTS.insert, _TESTS.update, _TESTS.insert_finding)
        }
        self._repeats: tuple[int, frozenset[int]] | None = None  # of so many results
        ((self._last_asked, self._told),) = self._select(
            "SELECT coalesce(max(id), 0), count(told) FROM test"
        )
        config = self.fact("config")
        if not isinstance(config, dict):
            raise self._damaged("the config is no JSON object")
        self.config: Mapping[str, JSONValue] = MappingProxyType(config)
        """The campaign's configuration."""
        try:
            self._setting: Setting | str = Setting.of(config)
        except ValueError as error:
            self._setting = str(error)

    @classmethod
    def create(
        cls,
        folder: Path | str,
        config: Mapping[str, JSONValue],
        facts: Mapping[str, JSONValue] = MappingProxyType({}),
        earlier: Sequence[Test] = (),
    ) -> Self:
        """A new campaign in a folder, which is made if need be.

        Args:
            folder: the folder.
            config: its configuration.
            facts: other facts.
            earlier: tests of other campaigns, and real roads, that it starts from.

        Raises:
            CampaignError: the folder holds a campaign already or cannot be written.
            ValueError: the configuration or a fact is not JSON (NaN and infinity are not), or a
                number of a test is not finite.
        """
        folder = Path(folder)
        named = {"config": dict(config), "created_at": present_moment(), **facts}
        rows = {
            _REPLACE_FACT: [_fact_row(*fact) for fact in named.items()],
            _EARLIER.insert: [(*row_of(test.candidate, ASKED), 0) for test in earlier],
        }
        for test in earlier:
            for statement, added in _EARLIER.rows_of(test).items():
                rows.setdefault(statement, []).extend(added)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            is_file = isinstance(error, FileExistsError | NotADirectoryError)
            reason = "a file is in the way" if is_file else error.strerror or error
            raise CampaignError(
                f"cannot make the folder {folder}: {reason}; choose another place"
            ) from error
        path = folder / DATABASE
        _refuse_existing(path)
        lock = lock_file(folder / LOCK)
        try:
            _refuse_existing(path)  # again: someone may have been faster before we had the lock
            # Made under another name, so that a campaign exists completely or not at all.
            unfinished = folder / f"{DATABASE}.new"
            with _translated(path):
                for leftover in ("", "-wal", "-shm", "-journal"):
                    unfinished.with_name(unfinished.name + leftover).unlink(missing_ok=True)
                _make_database(unfinished, rows)
                unfinished.replace(path)
            return cls._open_locked(folder, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def open(cls, folder: Path | str, readonly: bool = True) -> Self:
        """The campaign in a folder.

        Raises:
            CampaignError: there is none, its database is damaged, of another format or no
                campaign; or, for writing, another process writes it.
        """
        folder = Path(folder)
        path = folder / DATABASE
        with _translated(path):
            if not path.is_file():
                what = "holds no campaign" if folder.is_dir() else "is not a folder"
                if not os.path.lexists(folder):
                    what = "does not exist"
                raise CampaignError(
                    f"{folder} {what}: the folder of a campaign is needed, one with {DATABASE}"
                )
        if readonly:
            return cls._with(folder, _connect_to_read(path), None)
        lock = lock_file(folder / LOCK)
        try:
            return cls._open_locked(folder, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _open_locked(cls, folder: Path, lock: FileLock) -> Self:
        with _translated(folder / DATABASE):
            connection = _connect(folder / DATABASE, "mode=rw")
        return cls._with(folder, connection, lock)

    @classmethod
    def _with(cls, folder: Path, connection: sqlite3.Connection, lock: FileLock | None) -> Self:
        """The campaign of a connection, which is closed if it is none."""
        path = folder / DATABASE
        try:
            with _translated(path):
                _check_identity(connection, path)
                if lock is not None:
                    connection.execute("PRAGMA journal_mode = WAL").fetchone()
                    connection.execute("PRAGMA synchronous = NORMAL")
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
            return
        gone = self._gone() if isinstance(error, (CampaignError, OSError)) else None
        with suppress(CampaignError):  # the error under way says more
            self.close()
        if gone is not None and not isinstance(error, CampaignGoneError):
            raise gone from error

    def close(self) -> None:
        """Writes the rest and closes the database; closing twice does no harm."""
        try:
            self.write()
        finally:
            self._forget_held()
            try:
                with _translated(self._path):
                    self._connection.close()
            finally:
                self._in_use.close()
                if self._lock is not None:
                    self._lock.release()

    def at_a_glance(self) -> str:
        """The campaign's folder and results: ``campaigns/night: 70 PASS, 12 FAIL``."""
        counts = [f"{number} {outcome}" for outcome, number in self.by_outcome().items() if number]
        return f"{self.folder}: {', '.join(counts) or 'no results'}"

    def __repr__(self) -> str:
        """The campaign at a glance; of a closed one, its folder."""
        try:
            return f"<CampaignStore {self.at_a_glance()}>"
        except CampaignError:
            return f"<CampaignStore {self.folder}>"

    # Facts

    @property
    def setting(self) -> Setting:
        """The setting of the campaign's drives.

        Raises:
            CampaignError: the configuration lacks it.
        """
        if isinstance(self._setting, str):
            raise self._damaged(f"its configuration: {self._setting}")
        return self._setting

    @property
    def lane_width(self) -> float:
        """Width of each lane, in m; the usual one where the configuration lacks the setting."""
        return 4.0 if isinstance(self._setting, str) else self._setting.lane_width

    @property
    def facts(self) -> Mapping[str, JSONValue]:
        """The other facts of the campaign: ``created_at`` and those that `finish` added."""
        names = [name for (name,) in self._select("SELECT name FROM fact ORDER BY name")]
        return MappingProxyType({name: self.fact(name) for name in names if name not in _UNLISTED})

    def fact(self, name: str) -> JSONValue:
        """A fact by its name, None if there is no such fact.

        Raises:
            CampaignError: it is damaged.
        """
        for (text,) in self._select("SELECT value FROM fact WHERE name = ?", (name,)):
            try:
                value: JSONValue = read_json(text)
            except ValueError as error:
                raise self._damaged(f"the fact {name} is not JSON: {error}") from None
            return value
        return None

    def finish(self, **facts: JSONValue) -> None:
        """Adds facts about the whole campaign, such as its ``seconds``, and writes what is held.

        The time, ``finished_at``, is added unless it is given. An older fact is replaced, since a
        campaign can be resumed and finish again.

        Raises:
            ValueError: a fact is not JSON.
            CampaignError: it cannot be written, or the database was removed.
        """
        self.require_there()
        self.keep(**{"finished_at": present_moment(), **facts})

    def keep(self, **facts: JSONValue) -> None:
        """Adds or replaces facts about the whole campaign; errors are those of `finish`."""
        self._transact({_REPLACE_FACT: [_fact_row(*fact) for fact in facts.items()]})

    def reopen(self, **facts: JSONValue) -> None:
        """Replaces the facts about the campaign's end by others; errors are those of `finish`."""
        ends = {"DELETE FROM fact WHERE name = ?": [(name,) for name in _ENDINGS]}
        self._transact({**ends, _REPLACE_FACT: [_fact_row(*fact) for fact in facts.items()]})

    # Writing

    def asked(self, candidate: Candidate) -> None:
        """Takes a candidate for the next `write`.

        Raises:
            CampaignError: its id is not higher than that of every candidate before.
            ValueError: a number is not finite.
        """
        self._require_writer()
        if candidate.id <= self._last_asked:
            raise CampaignError(
                f"{self._path} already holds candidate {self._last_asked}: the next one needs a"
                f" higher id, not {candidate.id}"
            )
        self._held[_TESTS.insert].append((*row_of(candidate, ASKED), self._told))
        self._last_asked = candidate.id

    def told(self, test: Test, packed: bytes | None = None) -> None:
        """Takes the result of an outstanding candidate for the next `write`.

        Args:
            test: the test.
            packed: its encoded trajectory, if the worker has encoded it.

        Raises:
            ValueError: a number is not finite.
        """
        self._require_writer()
        for statement, rows in _TESTS.rows_of(test, packed).items():
            self._held[statement] += rows
        self._told += 1

    def write(self) -> None:
        """Stores what was asked and told, durably.

        Raises:
            CampaignError: it cannot be written; the rest waits for the next try.
        """
        if any(self._held.values()):
            self._transact({})

    def _transact(self, others: Mapping[str, Sequence[tuple[Any, ...]]]) -> None:
        """Executes what is held, and other statements with their values, in one transaction."""
        self._require_writer()
        connection, has_begun = self._connection, False
        with _translated(self._path):
            try:
                connection.execute("BEGIN IMMEDIATE")
                has_begun = True
                for statement, rows in {**self._held, **others}.items():
                    connection.executemany(statement, rows)
                connection.execute("COMMIT")
                self._forget_held()
            except BaseException as error:
                if connection.in_transaction:  # SQLite ends some by itself
                    connection.execute("ROLLBACK")
                elif has_begun and not isinstance(error, sqlite3.Error):
                    self._forget_held()  # Ctrl-C, noticed when all was written
                raise

    def _forget_held(self) -> None:
        for rows in self._held.values():
            rows.clear()

    def _require_writer(self) -> None:
        if self._lock is None:
            raise CampaignError(f"{self._path} was opened for reading: open it with readonly=False")

    def require_there(self) -> None:
        """Checks that the database is still the file that was opened.

        Raises:
            CampaignGoneError: it was moved, deleted or replaced.
        """
        if (gone := self._gone()) is not None:
            raise gone

    def _gone(self) -> CampaignGoneError | None:
        """What has become of the folder or the database; None if both are in their place.

        SQLite writes on into a database that was moved with its folder, so its results stand there.
        """
        with suppress(OSError):
            if os.path.samestat(self._path.stat(), self._opened):
                return None
        fate = self._in_use.fate()
        if self._in_use.holds(DATABASE, self._opened):
            with suppress(CampaignError):  # the disk is full, say
                self.write()
            text = f"{self.folder} {fate} while it was in use: {self._stored_words()} there"
            error = CampaignGoneError(f"{text}; go on with it there")
            error.place = self._in_use.place()
            return error
        if not fate:
            return CampaignGoneError(
                f"{self._path} was taken out of its folder or replaced while it was in use: put it"
                f" back beside the file {DATABASE}-wal, which holds its last results, or run the"
                " campaign again"
            )
        return CampaignGoneError(
            f"{self.folder} {fate} while it was in use, and its results are gone: restore a copy,"
            " or run the campaign again"
        )

    def _stored_words(self) -> str:
        """How many results stand in the database: ``its 3 results stand``."""
        number = self.stored()
        return f"its {counted(number, 'result')} {'stands' if number == 1 else 'stand'}"

    def require_sound(self) -> None:
        """Checks that SQLite finds the file whole and no result is missing, before one is added.

        Reads the whole file once, which takes about a second per gigabyte.

        Raises:
            CampaignError: it is not.
        """
        ((verdict,),) = self._select("PRAGMA quick_check(1)")
        if verdict != "ok":
            raise self._damaged(" ".join(verdict.split()))
        ((number, last),) = self._select("SELECT count(told), max(told) FROM test")
        if number and number != last:
            raise self._damaged(f"it holds {number} of {last} results")

    # Reading

    def tests(
        self,
        outcome: Outcome | None = None,
        order_by: Order = "told",
        limit: int | None = None,
        with_trajectory: bool | Container[int] = False,
        *,
        with_repeats: bool = True,
    ) -> Iterator[Test]:
        """The tests that are stored at this moment; later ones do not show up.

        Args:
            outcome: only of tests with it.
            order_by: the order of telling, or ``moobd``: lowest first, those without one last.
            limit: most tests.
            with_trajectory: whether they come with their trajectories, or the ids of those that do.
            with_repeats: whether to give tests that repeat an earlier one, too, see `repeats`;
                measures leave them out.

        Raises:
            CampaignError: a test is damaged or missing.
        """
        only = "" if outcome is None else f"AND outcome = '{Outcome(outcome)}'"
        self.write()
        # A stored test never changes, so the ids are a snapshot, and no transaction stays open
        # between two tests.
        repeats = frozenset[int]() if with_repeats else self.repeats()
        most = -1 if limit is None else limit + len(repeats)
        ids = self._ids(
            f"SELECT id FROM test WHERE told IS NOT NULL {only} ORDER BY {_ORDERS[order_by]}"  # noqa: S608
            f" LIMIT {most:d}"
        )
        ids = [number for number in ids if number not in repeats][:limit]
        return (
            test
            for start in range(0, len(ids), _AT_ONCE)
            for test in self._read(ids[start : start + _AT_ONCE], with_trajectory)
        )

    def _ids(self, select: str) -> list[int]:
        return [number for (number,) in self._select(select)]

    def test(self, id: int, with_trajectory: bool = True) -> Test:  # noqa: A002
        """The test of the candidate with this id.

        Raises:
            CampaignError: there is none (the message names the existing ids), or it is damaged.
        """
        number = self._known(id, "test of candidate", "told IS NOT NULL")
        return self._read([number], with_trajectory)[0]

    def trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """The trajectory of the candidate with this id; None if none is stored.

        Raises:
            CampaignError: it is damaged.
        """
        self.write()
        return self._trajectory(operator.index(id), _TESTS)

    def _trajectory(self, number: int, tables: _Tables) -> Trajectory | None:
        select = f"SELECT records, trajectory FROM {tables.test} WHERE id = ?"  # noqa: S608
        for records, packed in self._select(select, (number,)):
            if packed is not None:
                with self._reading(f"the trajectory of {tables.label} {number}"):
                    return decode(packed)
            if records is not None:
                raise self._damaged(f"the trajectory of {tables.label} {number} is gone")
        return None

    def earlier(self) -> list[Test]:
        """The tests of other campaigns, and real roads, that this one starts from.

        They come without their trajectories, numbered from 1, each with the setting of its own
        campaign.

        Raises:
            CampaignError: one is damaged or missing.
        """
        with self._reading("the settings of the campaigns that it started from"):
            settings = convert(self.fact(EARLIER_SETTINGS) or {}, dict[str, Setting])
        ids = self._ids(f"SELECT id FROM {_EARLIER.test} ORDER BY id")  # noqa: S608
        return [
            replace(test, setting=settings.get(test.candidate.source.campaign))
            if test.candidate.source is not None
            else test
            for start in range(0, len(ids), _AT_ONCE)
            for test in self._read(ids[start : start + _AT_ONCE], False, _EARLIER)
        ]

    def earlier_trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """The trajectory of an `earlier` test; None for a real road.

        Raises:
            CampaignError: it is damaged.
        """
        return self._trajectory(id, _EARLIER)

    def candidate(self, id: int) -> Candidate:  # noqa: A002
        """The candidate with this id, whether it has a result or not.

        Raises:
            CampaignError: there is none (the message names the existing ids), or it is damaged.
        """
        return self._read_candidates([self._known(id, "candidate", "true")])[0]

    def candidates(self) -> Iterator[tuple[Candidate, int]]:
        """All candidates in the order of asking, each with the number of results told before it.

        Raises:
            CampaignError: one is damaged or missing.
        """
        self.write()
        places = dict(self._select("SELECT id, asked_after FROM test ORDER BY id"))
        ids = list(places)
        return (
            (candidate, places[candidate.id])
            for start in range(0, len(ids), _AT_ONCE)
            for candidate in self._read_candidates(ids[start : start + _AT_ONCE])
        )

    def _read(
        self,
        ids: Sequence[int],
        with_trajectory: bool | Container[int],
        tables: _Tables = _TESTS,
    ) -> list[Test]:
        """The tests of some candidates, in this order."""
        has_path = ids if with_trajectory is True else with_trajectory or ()
        setting = self._setting if isinstance(self._setting, Setting) else None
        findings: dict[int, list[Sequence[Any]]] = {}
        for number, *values in self._select(tables.select_findings(len(ids)), ids):
            findings.setdefault(number, []).append(values)
        tests = []
        for row in self._rows(ids, tables):
            path = self._trajectory(row[0], tables) if row[0] in has_path else None
            with self._reading(f"{tables.label} {row[0]}"):
                tests.append(read_test(row, findings.get(row[0], ()), path, setting))
        return tests

    def _read_candidates(self, ids: Sequence[int]) -> list[Candidate]:
        candidates = []
        for row in self._rows(ids):
            with self._reading(f"candidate {row[0]}"):
                candidates.append(read_candidate(row))
        return candidates

    def _rows(self, ids: Sequence[int], tables: _Tables = _TESTS) -> list[tuple[Any, ...]]:
        """The rows of some candidates, in this order.

        Raises:
            CampaignError: one is missing.
        """
        rows = {row[0]: row for row in self._select(tables.select(len(ids)), ids)}
        for number in ids:
            if number not in rows:
                raise self._damaged(f"candidate {number} is missing")
        return [rows[number] for number in ids]

    def by_outcome(self) -> dict[Outcome, int]:
        """The number of results per outcome; every outcome is present."""
        return self._count_by_outcome()[0]

    def counts(self) -> Counts:
        """The number of tests per outcome and of different roads, and the lowest MOOBD.

        Reads the roads of all tests: where numbers are enough, `by_outcome` is faster.
        """
        by_outcome, min_moobd = self._count_by_outcome()
        counts = Counts.of(by_outcome, min_moobd)
        roads, first = set(), FirstTests()
        for _, outcome, road, conditions, profiles in self._keys():
            roads.add(road)
            if not first.add_key(outcome, road, conditions, profiles):
                counts.add_repeat(outcome)
        counts.roads = len(roads)
        return counts

    def repeats(self) -> frozenset[int]:
        """The ids of the tests that repeat an earlier one.

        See `frenetic.campaign.counts.FirstTests`. Reads the roads of all tests, again only after
        further results.

        Raises:
            CampaignError: a test is damaged.
        """
        self.write()
        ((stored,),) = self._select("SELECT count(told) FROM test")
        if self._repeats is None or self._repeats[0] != stored:
            first = FirstTests()
            repeats = frozenset(
                number
                for number, outcome, road, conditions, profiles in self._keys()
                if not first.add_key(outcome, road, conditions, profiles)
            )
            self._repeats = stored, repeats
        return self._repeats[1]

    def _keys(self) -> Iterator[tuple[int, Outcome, int, dict[str, Any], list[bytes | None]]]:
        """The id of each test in the order of telling, and what `FirstTests.add_key` takes."""
        for number, outcome, conditions, step, curvatures, points, *profiles in self.rows(_KEYS):
            with self._reading(f"test {number}"):
                road = road_key(step, curvatures, points)
                result = Outcome(outcome)
                amounts = {} if conditions == "{}" else dict(read_json(conditions))
            yield number, result, road, amounts, profiles

    def _count_by_outcome(self) -> tuple[dict[Outcome, int], float | None]:
        """The number of results per outcome, and the lowest MOOBD in m."""
        self.write()
        rows = self._select(
            "SELECT outcome, count(*), min(moobd) FROM test WHERE told IS NOT NULL GROUP BY outcome"
        )
        by_outcome = dict.fromkeys(Outcome, 0)
        with self._reading("the outcome of a test"):
            by_outcome |= {Outcome(outcome): count for outcome, count, _ in rows}
        return by_outcome, min((moobd for *_, moobd in rows if moobd is not None), default=None)

    def stored(self) -> int:
        """The number of results on disk, without held ones; 0 if it cannot be read."""
        with suppress(CampaignError):
            ((number,),) = self._select("SELECT count(told) FROM test")
            return int(number)
        return 0

    def elapsed(self) -> float:
        """The campaign's time at the last result, in s."""
        self.write()
        ((seconds,),) = self._select("SELECT coalesce(max(elapsed), 0.0) FROM test")
        return float(seconds)

    def rows(self, select: str, parameters: Sequence[object] = ()) -> Iterator[tuple[Any, ...]]:
        """The rows of a SELECT, for reading many tests at once.

        Nothing is checked. Later results may show up.
        """
        self.write()
        with _translated(self._path):
            yield from self._connection.execute(select, tuple(parameters))

    def _select(self, select: str, parameters: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        with _translated(self._path):
            return self._connection.execute(select, tuple(parameters)).fetchall()

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        """Turns the faults of a value into a `CampaignError` that names it."""
        try:
            yield
        except (TypeError, ValueError, CampaignError) as error:
            raise self._damaged(f"{name}: {error}") from None

    def _known(self, id: int, what: str, where: str) -> int:  # noqa: A002
        """An id, if the database holds it; beyond what SQLite knows there is none."""
        self.write()
        number = operator.index(id)  # of numpy, too
        select = f"SELECT count(*) FROM test WHERE {where} AND id = ?"  # noqa: S608
        if 0 < number < 2**63 and self._select(select, (number,)) == [(1,)]:
            return number
        ids = f"SELECT min(id), max(id) FROM test WHERE {where}"  # noqa: S608
        ((lowest, highest),) = self._select(ids)
        there_are = f"ids run from {lowest} to {highest}" if lowest else "there are none so far"
        raise CampaignError(f"{self.folder} holds no {what} {number}: {there_are}")

    def _damaged(self, what: str) -> CampaignError:
        return CampaignError(
            f"{self._path} is damaged: {what}; restore it from a copy, or run the campaign again"
        )


def _fact_row(name: str, value: JSONValue) -> tuple[str, str]:
    """The row of a fact.

    Raises:
        ValueError: the value is not JSON, or could not be read again.
    """
    try:
        text = json.dumps(value, allow_nan=False, default=plain)
    except RecursionError:
        raise ValueError(f"{name} is nested too deep") from None
    read_json(text)
    return name, text


def _refuse_existing(path: Path) -> None:
    """Raises a `CampaignError` if there is something in a new database's place."""
    if os.path.lexists(path):
        raise CampaignError(
            f"{path.parent} already holds a campaign; choose another place, or "
            "go on with that one: frenetic resume (in Python: resume())"
        )


def _connect(path: Path, options: str) -> sqlite3.Connection:
    """A connection that begins and ends transactions only when told to."""
    uri = f"{path.resolve().as_uri()}?{options}"
    return sqlite3.connect(uri, uri=True, timeout=_BUSY_TIMEOUT, isolation_level=None)


def _connect_to_read(path: Path) -> sqlite3.Connection:
    """A connection to a campaign's database that changes nothing, even in a writable folder.

    Raises:
        CampaignError: it cannot be read.
    """
    with _translated(path):
        connection = _connect(path, "mode=ro")
        try:
            connection.execute("PRAGMA user_version").fetchone()
        except sqlite3.Error as error:
            connection.close()
            # Even a reader makes files beside the database, which fails in a folder that it may
            # not write. If no writer's log is there, nobody is writing: this is what `immutable`
            # promises.
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            is_written = path.with_name(f"{DATABASE}-wal").exists()
            if code not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY) or is_written:
                raise
            connection = _connect(path, "mode=ro&immutable=1")
    return connection


def _check_identity(connection: sqlite3.Connection, path: Path) -> None:
    """Checks that a database is a campaign's of this format.

    Raises:
        CampaignError: it is not.
    """
    (application_id,) = connection.execute("PRAGMA application_id").fetchone()
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if application_id != APPLICATION_ID:
        raise CampaignError(
            f"{path} is not a campaign's database: choose the folder of a campaign; nothing was"
            " changed"
        )
    if version != FORMAT:
        raise CampaignError(
            f"{path} has format {version}, this version of frenetic reads format {FORMAT}: use the"
            " version that wrote it; nothing was changed"
        )


def _make_database(path: Path, rows: Mapping[str, Sequence[tuple[Any, ...]]]) -> None:
    """Writes a complete campaign without tests to a new file."""
    connection = _connect(path, "mode=rwc")
    try:
        # It counts when it is complete, so only its end waits for the disk.
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("PRAGMA journal_mode = MEMORY").fetchone()
        connection.executescript(_SCHEMA)
        connection.execute("BEGIN")
        for statement, values in rows.items():
            connection.executemany(statement, values)
        connection.execute("COMMIT")
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
    finally:
        connection.close()
    flush(path)


@contextmanager
def _translated(path: Path) -> Iterator[None]:
    """Turns errors of SQLite and the file system into a `CampaignError` about `path`."""
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


_IN_USE: Final = "is in use by another program ({}): close it and try again"
_EXPLAINED: Final[Mapping[int, str]] = {
    sqlite3.SQLITE_FULL: (
        "cannot grow, the disk is full: free some space and resume the campaign; what was stored "
        "is safe"
    ),
    sqlite3.SQLITE_BUSY: _IN_USE,
    sqlite3.SQLITE_LOCKED: _IN_USE,
    sqlite3.SQLITE_CORRUPT: "is damaged ({}): restore it from a copy, or run the campaign again",
    sqlite3.SQLITE_NOTADB: (
        "is not a database, or is damaged ({}): restore it from a copy, or choose another folder"
    ),
}
"""SQLite's primary result code -> its meaning for the campaign and what to do."""
_UNEXPLAINED: Final = (
    "cannot be used ({}): check the permissions of file and folder, and the disk; if these are in"
    " order, restore it from a copy"
)
