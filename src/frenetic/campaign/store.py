"""A campaign on disk: every test, as it comes, in one SQLite database.

The database, `campaign.sqlite` in the campaign's folder, is the campaign's record. Anyone with
SQLite can read it, while the campaign runs and long afterwards:

| table | one row per |
| --- | --- |
| fact | fact about the campaign (JSON): its configuration, when it was made and finished |
| test | road that the strategy asked for, with its result and drive once it is told |
| finding | breach of a criterion in a drive |

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
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, Self, TypeAlias

from filelock import FileLock

from frenetic._support.files import flush
from frenetic._support.json_value import JSONValue as JSONValue
from frenetic._support.json_value import plain
from frenetic._support.notebook import Shown
from frenetic._support.words import present_moment
from frenetic.campaign.counts import Counts, road_key
from frenetic.campaign.lock import lock_file
from frenetic.campaign.record import (
    FINDING,
    FINISHED,
    Setting,
    Test,
    read_candidate,
    read_test,
    row_of,
    row_of_candidate,
    row_of_finding,
)
from frenetic.campaign.trajectory_codec import decode
from frenetic.drive import Trajectory
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate
from frenetic.spec import require_count

Order: TypeAlias = Literal["told", "moobd"]
_Row: TypeAlias = tuple[Any, ...]

DATABASE: Final = "campaign.sqlite"
"""Name of the database in a campaign's folder."""
FORMAT: Final = 1
"""Format of the database (`PRAGMA user_version`); another one is refused."""
APPLICATION_ID: Final = int.from_bytes(b"FrnC")
"""Mark of our campaigns among SQLite files (`PRAGMA application_id`)."""
LOCK: Final = "campaign.lock"
"""Name of the lock file in a campaign's folder."""

_BUSY_TIMEOUT: Final = 10.0  # s that a reader waits for the writer
_AT_ONCE: Final = 500  # tests read by one SELECT
_NAMES: Final = [column.name for column in FINISHED]
_VALUES: Final = ", ".join(_NAMES)
_FINDING: Final = ", ".join(f'"{column.name}"' for column in FINDING)
SCHEMA: Final = f"""
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {FORMAT};
CREATE TABLE fact (
    name TEXT PRIMARY KEY, value TEXT NOT NULL, checksum INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE test (
    {", ".join(f"{column.name} {column.sql_type}" for column in FINISHED)},
    asked_after INTEGER NOT NULL, checksum INTEGER NOT NULL, trajectory BLOB, PRIMARY KEY (id)
) STRICT;
CREATE TABLE finding (
    test INTEGER NOT NULL REFERENCES test (id), number INTEGER NOT NULL,
    {", ".join(f'"{column.name}" {column.sql_type}' for column in FINDING)},
    PRIMARY KEY (test, number)
) STRICT, WITHOUT ROWID;
"""
"""`asked_after` is the number of results told before a road was asked for. A checksum is the CRC-32
of the other values of a row, in the order of the columns, without the trajectory, which has its
own, and with the findings of the test from their number on."""
_INSERT: Final = f"INSERT OR REPLACE INTO test VALUES ({', '.join('?' * (len(FINISHED) + 3))})"  # noqa: S608
_INSERT_FINDING: Final = f"INSERT INTO finding VALUES ({', '.join('?' * (len(FINDING) + 2))})"  # noqa: S608
_REPLACE_FACT: Final = "INSERT OR REPLACE INTO fact VALUES (?, ?, ?)"
_SELECT: Final = f"SELECT {_VALUES}, asked_after, checksum FROM test WHERE id IN "  # noqa: S608
_SELECT_FINDINGS: Final = f"SELECT test, number, {_FINDING} FROM finding WHERE test IN "  # noqa: S608
_ENDINGS: Final = ("finished_at", "seconds", "interrupted", "ended", "notice")
_FIXED: Final = ("config", "created_at", "earlier", "sources")
_UNLISTED: Final = ("config", "earlier", "sources")  # large, or shown elsewhere


def checksum(row: Iterable[object]) -> int:
    """CRC-32 of the values of a row, see `SCHEMA`.

    It is that of a JSON list in ASCII, as Python writes it, with the CRC-32 of a blob in its place.
    """
    values = [zlib.crc32(value) if type(value) is bytes else value for value in row]
    return zlib.crc32(json.dumps(values).encode())


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
        self._folder = folder
        self._path = folder / DATABASE
        self._connection = connection
        self._lock = lock
        self._opened = self._path.stat()
        self._held: dict[int, tuple[object, ...]] = {}  # rows for the next transaction
        self._findings: list[tuple[object, ...]] = []  # likewise
        with translated(self._path):
            number = "SELECT coalesce(max(id), 0), count(told) FROM test"
            self._last_asked, self._told = connection.execute(number).fetchone()
            self._outstanding: dict[int, int] = dict(
                connection.execute("SELECT id, asked_after FROM test WHERE told IS NULL")
                if lock is not None
                else ()
            )
        config = self.fact("config")
        if not isinstance(config, dict):
            raise self._damaged("the config is no JSON object")
        self._config: Mapping[str, JSONValue] = MappingProxyType(config)
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
    ) -> Self:
        """A new campaign in a folder, which is made if need be.

        Raises:
            CampaignError: the folder holds a campaign already or cannot be written.
            ValueError: the configuration or a fact is not JSON (NaN and infinity are not).
        """
        folder = Path(folder)
        named = {"config": dict(config), "created_at": present_moment(), **facts}
        rows = [_fact_row(*fact) for fact in named.items()]
        with writable(folder):
            folder.mkdir(parents=True, exist_ok=True)
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
        path = find_database(folder)
        if not readonly:
            lock = lock_file(folder / LOCK)
            try:
                return cls._open_locked(folder, lock)
            except BaseException:
                lock.release()
                raise
        connection = connect_to_read(path)
        try:
            return cls(folder, connection, None)
        except BaseException:
            connection.close()
            raise

    @classmethod
    def _open_locked(cls, folder: Path, lock: FileLock) -> Self:
        path = folder / DATABASE
        with translated(path):
            connection = _connect(path, "mode=rw")
        try:
            with translated(path):
                _check_identity(connection, path)
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

        Raises:
            CampaignError: the configuration lacks it.
        """
        if isinstance(self._setting, str):
            raise self._damaged(f"its configuration: {self._setting}")
        return self._setting

    # Facts

    @property
    def facts(self) -> Mapping[str, JSONValue]:
        """The other facts of the campaign: ``created_at`` and those that `finish` added."""
        names = self._select("SELECT name FROM fact ORDER BY name")
        wanted = [name for (name,) in names if name not in _UNLISTED]
        return MappingProxyType({name: self.fact(name) for name in wanted})

    def fact(self, name: str) -> JSONValue:
        """A fact by its name, None if there is no such fact.

        Raises:
            CampaignError: it is damaged.
        """
        rows = self._select("SELECT name, value, checksum FROM fact WHERE name = ?", (name,))
        for *row, stored in rows:
            if checksum(row) != stored:
                raise self._damaged(f"the fact {name} does not match its checksum")
            try:
                value: JSONValue = json.loads(row[1])
            except (ValueError, RecursionError):
                raise self._damaged(f"the fact {name} is not JSON") from None
            return value
        return None

    def finish(self, **facts: JSONValue) -> None:
        """Adds facts about the whole campaign, such as its ``seconds``, and writes what is held.

        The time, ``finished_at``, is added unless it is given. An older fact is replaced, since a
        campaign can be resumed and finish again.

        Raises:
            ValueError: a fact is not JSON or cannot be changed.
            CampaignError: it cannot be written, or the database was removed.
        """
        self.require_there()
        self.keep(**{"finished_at": present_moment(), **facts})

    def keep(self, **facts: JSONValue) -> None:
        """Adds or replaces facts about the whole campaign; errors are those of `finish`."""
        self._add_facts(facts)

    def reopen(self, **facts: JSONValue) -> None:
        """Replaces the facts about the campaign's end by others; errors are those of `finish`."""
        self._add_facts(facts, without=_ENDINGS)

    def _add_facts(self, facts: Mapping[str, JSONValue], without: Sequence[str] = ()) -> None:
        self._require_writer()
        if fixed := sorted(facts.keys() & set(_FIXED)):
            raise ValueError(f"{', '.join(fixed)} cannot be changed: choose another name")
        rows = [_fact_row(*fact) for fact in facts.items()]
        with self._transaction() as connection:
            connection.executemany("DELETE FROM fact WHERE name = ?", [(name,) for name in without])
            connection.executemany(_REPLACE_FACT, rows)

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
        row = (*row_of_candidate(candidate), self._told)
        self._held[candidate.id] = (*row, checksum(row), None)
        self._outstanding[candidate.id] = self._told
        self._last_asked = candidate.id

    def told(self, test: Test) -> None:
        """Takes a result for the next `write`.

        Raises:
            CampaignError: its candidate is not outstanding, or it is not the next to be told.
            ValueError: a number is not finite.
        """
        self._require_writer()
        if test.id not in self._outstanding or test.told != self._told + 1:
            raise CampaignError(
                f"{self._path} refuses result {test.told} of candidate {test.id}: a candidate is"
                f" asked once, then told once, and the next result is number {self._told + 1}"
            )
        packed = test.attempt.pack(keep=True)
        row = (*row_of(replace(test, attempt=packed)), self._outstanding[test.id])
        numbered = enumerate(test.result.findings, start=1)
        findings = [(number, *row_of_finding(finding)) for number, finding in numbered]
        total = checksum([*row, *(value for finding in findings for value in finding)])
        del self._outstanding[test.id]
        self._held[test.id] = (*row, total, packed.packed)
        self._findings += [(test.id, *finding) for finding in findings]
        self._told += 1

    def write(self) -> None:
        """Stores what was asked and told, durably.

        Raises:
            CampaignError: it cannot be written; the rest waits for the next try.
        """
        if self._held:
            with self._transaction():
                pass

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Gives the connection within a transaction that begins with what is held."""
        connection = self._connection
        has_begun = False
        with translated(self._path):
            try:
                connection.execute("BEGIN IMMEDIATE")
                has_begun = True
                connection.executemany(_INSERT, self._held.values())
                connection.executemany(_INSERT_FINDING, self._findings)
                yield connection
                connection.execute("COMMIT")
                self._forget_held()
            except BaseException as error:
                if connection.in_transaction:  # SQLite ends some by itself
                    connection.execute("ROLLBACK")
                elif has_begun and not isinstance(error, sqlite3.Error):
                    self._forget_held()  # Ctrl-C, noticed when all was written
                raise

    def _forget_held(self) -> None:
        self._held.clear()
        self._findings.clear()

    def _require_writer(self) -> None:
        if self._lock is None:
            raise CampaignError(f"{self._path} was opened for reading: open it with readonly=False")

    def close(self) -> None:
        """Writes the rest and closes the database; closing twice does no harm."""
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

    # Reading

    def tests(
        self,
        outcome: Outcome | None = None,
        order_by: Order = "told",
        limit: int | None = None,
        with_trajectory: bool = False,
        after: int = 0,
    ) -> Iterator[Test]:
        """The tests that are stored at this moment; later ones do not show up.

        Args:
            outcome: only of tests with it.
            order_by: the order of telling, or ``moobd``: lowest first, those without one last.
            limit: most tests.
            with_trajectory: whether they come with their trajectories.
            after: only of tests told later than the first so many.

        Raises:
            ValueError: an unknown outcome or order, or a number that is no whole one from 0.
            CampaignError: a test is damaged or missing.
        """
        if order_by not in ("told", "moobd"):
            raise ValueError(f"order_by is {order_by!r}: 'told' or 'moobd' is needed")
        if limit is not None:
            limit = require_count("limit", limit, 0)
        only = None if outcome is None else Outcome(outcome)
        self.write()
        # A stored test never changes, so the ids are a snapshot, and no transaction stays open
        # between two tests.
        rows = [
            row
            for row in self._index(require_count("after", after, 0))
            if only is None or row[2] == only
        ]
        if order_by == "moobd":
            rows.sort(key=lambda row: (row[3] is None, row[3] or 0.0))
        ids = [row[1] for row in rows[:limit]]
        return (
            test
            for start in range(0, len(ids), _AT_ONCE)
            for test in self._read(ids[start : start + _AT_ONCE], with_trajectory)
        )

    def _index(self, after: int = 0) -> list[tuple[int, int, str, float | None]]:
        """Number of telling, id, outcome and MOOBD of all results, in the order of telling.

        Raises:
            CampaignError: a number is missing.
        """
        rows = self._select(
            "SELECT told, id, outcome, moobd FROM test WHERE told > ? ORDER BY told", (after,)
        )
        for number, row in enumerate(rows, start=after + 1):
            if row[0] != number:
                raise self._damaged(f"the result told as number {number} is missing")
        return rows

    def test(self, id: int, with_trajectory: bool = True) -> Test:  # noqa: A002
        """The test of the candidate with this id.

        Raises:
            CampaignError: there is none (the message names the existing ids), or it is damaged.
            ValueError: the id is no whole number.
        """
        number = _whole(id)
        self.write()
        ((told,),) = self._select(
            "SELECT count(*) FROM test WHERE id = ? AND told IS NOT NULL", (number,)
        )
        if not told:
            raise self._unknown("test of candidate", id, "WHERE told IS NOT NULL")
        return self._read([number], with_trajectory)[0]

    def _read(self, ids: Sequence[int], with_trajectory: bool) -> list[Test]:
        """The tests of some candidates, in this order."""
        setting = self._setting if isinstance(self._setting, Setting) else None
        tests = []
        for row, findings in self._whole_rows(ids):
            with self._reading(f"test {row[0]}"):
                packed = self._packed(row[0], row[-1]) if with_trajectory else None
                tests.append(read_test(row, findings, packed, setting))
        return tests

    def _whole_rows(self, ids: Sequence[int]) -> Iterator[tuple[_Row, list[_Row]]]:
        """The rows of some candidates, in this order, each with those of its findings.

        Raises:
            CampaignError: one is missing, or does not match its checksum.
        """
        wanted = f"({', '.join('?' * len(ids))})"
        rows = {row[0]: row for row in self._select(_SELECT + wanted, ids)}
        findings: dict[int, list[_Row]] = {}
        for test, *values in self._select(f"{_SELECT_FINDINGS}{wanted} ORDER BY test, number", ids):
            findings.setdefault(test, []).append(tuple(values))
        for number in ids:
            if number not in rows:
                raise self._damaged(f"candidate {number} is missing")
            *row, stored = rows[number]
            own = findings.get(number, [])
            if checksum([*row, *(value for finding in own for value in finding)]) != stored:
                raise self._damaged(f"test {number} does not match its checksum")
            yield tuple(row[:-1]), [finding[1:] for finding in own]

    def _packed(self, number: int, records: int | None) -> bytes | None:
        """The encoded trajectory of a test with so many records, None if it has none.

        Raises:
            CampaignError: it is gone.
        """
        if records is None:
            return None
        ((packed,),) = self._select("SELECT trajectory FROM test WHERE id = ?", (number,))
        if packed is None:
            raise self._damaged(f"the trajectory of test {number} is gone")
        data: bytes = packed
        return data

    def trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """The trajectory of the candidate with this id; None if none is stored.

        Raises:
            CampaignError: it is damaged.
        """
        number = _whole(id)
        self.write()
        rows = self._select("SELECT records FROM test WHERE id = ?", (number,))
        packed = self._packed(number, rows[0][0]) if rows else None
        if packed is None:
            return None
        with self._reading(f"the trajectory of test {id}"):
            return decode(packed)

    def candidate(self, id: int) -> Candidate:  # noqa: A002
        """The candidate with this id, whether it has a result or not.

        Raises:
            CampaignError: there is none (the message names the existing ids), or it is damaged.
        """
        number = _whole(id)
        self.write()
        if not self._select("SELECT 1 FROM test WHERE id = ?", (number,)):
            raise self._unknown("candidate", id)
        return self._read_candidates([number])[0]

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

    def _read_candidates(self, ids: Sequence[int]) -> list[Candidate]:
        candidates = []
        for row, _ in self._whole_rows(ids):
            with self._reading(f"candidate {row[0]}"):
                candidates.append(read_candidate(row))
        return candidates

    def by_outcome(self) -> dict[Outcome, int]:
        """The number of results per outcome; every outcome is present."""
        return self._count_by_outcome()[0]

    def counts(self) -> Counts:
        """The number of tests per outcome and of different roads, and the lowest MOOBD.

        Reads the roads of all tests: where numbers are enough, `by_outcome` is faster.
        """
        by_outcome, min_moobd = self._count_by_outcome()
        select = "SELECT step, curvatures, points FROM test WHERE outcome <> 'DROPPED'"
        roads = {road_key(*row) for row in self.rows(select)}
        return Counts.of(by_outcome, min_moobd, len(roads))

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
        with translated(self._path):
            yield from self._connection.execute(select, tuple(parameters))

    def require_there(self) -> None:
        """Checks that the database is still the file that was opened.

        Raises:
            CampaignError: it was removed or replaced.
        """
        try:
            is_there = os.path.samestat(self._path.stat(), self._opened)
        except OSError:
            is_there = False
        if not is_there:
            raise CampaignError(
                f"{self._path} was removed or replaced while it was written: what was stored is"
                " gone with it; run the campaign again"
            )

    def require_sound(self) -> None:
        """Checks that SQLite finds the file whole, before anything is added.

        Reads the whole file once, which takes about a second per gigabyte.

        Raises:
            CampaignError: it does not.
        """
        ((verdict,),) = self._select("PRAGMA quick_check(1)")
        if verdict != "ok":
            raise self._damaged(" ".join(verdict.split()))

    def _select(self, select: str, parameters: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        with translated(self._path):
            return self._connection.execute(select, tuple(parameters)).fetchall()

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        """Turns the faults of a value into a `CampaignError` that names it."""
        try:
            yield
        except (TypeError, ValueError, RecursionError) as error:
            raise self._damaged(f"{name}: {error}") from None
        except CampaignError as error:
            if str(self._path) in str(error):
                raise
            raise self._damaged(f"{name}: {error}") from None

    def _unknown(self, what: str, number: object, where: str = "") -> CampaignError:
        ((lowest, highest),) = self._select(f"SELECT min(id), max(id) FROM test {where}")  # noqa: S608
        there_are = f"ids run from {lowest} to {highest}" if lowest else "there are none so far"
        return CampaignError(f"{self._folder} holds no {what} {number}: {there_are}")

    def _damaged(self, what: str) -> CampaignError:
        return CampaignError(
            f"{self._path} is damaged: {what}; restore it from a copy, or run the campaign again"
        )


def _whole(number: object) -> int:
    """An id; 0 if it is beyond what SQLite knows.

    Raises:
        ValueError: it is no whole number.
    """
    try:
        value = operator.index(number)  # type: ignore[arg-type]  # of numpy, too
    except TypeError:
        raise ValueError(f"id is {number!r}: a whole number is needed") from None
    return value if 0 < value < 2**63 else 0


def _fact_row(name: str, value: JSONValue) -> tuple[object, ...]:
    row = name, json.dumps(value, allow_nan=False, default=plain)
    return (*row, checksum(row))


def _refuse_existing(path: Path) -> None:
    if os.path.lexists(path):
        raise CampaignError(
            f"{path.parent} already holds a campaign; choose another folder with --out, or "
            "go on with that one: frenetic resume (in Python: resume())"
        )


def _connect(path: Path, options: str) -> sqlite3.Connection:
    """A connection that begins and ends transactions only when told to."""
    uri = path.resolve().as_uri()
    if not uri.startswith(
        "file:///"
    ):  # a network share on Windows: SQLite wants no host in the URI
        uri = "file:////" + uri.removeprefix("file://")
    return sqlite3.connect(
        f"{uri}?{options}", uri=True, timeout=_BUSY_TIMEOUT, isolation_level=None
    )


def find_database(folder: Path) -> Path:
    """The path of the database in a campaign's folder.

    Raises:
        CampaignError: there is none.
    """
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
    """A connection to a campaign's database that changes nothing, even in a writable folder.

    Raises:
        CampaignError: it is none of this format, or cannot be read.
    """
    with translated(path):
        connection = _connect(path, "mode=ro")
        try:
            try:
                connection.execute("PRAGMA user_version").fetchone()
            except sqlite3.Error as error:
                # Even a reader makes files beside the database, which fails in a folder that it may
                # not write. If no writer's log is there, nobody is writing: this is what
                # `immutable` promises.
                code = getattr(error, "sqlite_errorcode", 0) & 0xFF
                is_written = path.with_name(f"{DATABASE}-wal").exists()
                if code not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY) or is_written:
                    raise
                connection.close()
                connection = _connect(path, "mode=ro&immutable=1")
            _check_identity(connection, path)
        except BaseException:
            connection.close()
            raise
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


def _make_database(path: Path, facts: Iterable[tuple[object, ...]]) -> None:
    """Writes a complete campaign without tests to a new file."""
    connection = _connect(path, "mode=rwc")
    try:
        # It counts when it is complete, so only its end waits for the disk.
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("PRAGMA journal_mode = MEMORY").fetchone()
        connection.executescript(SCHEMA)
        connection.executemany(_REPLACE_FACT, facts)
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
    finally:
        connection.close()
    flush(path)


@contextmanager
def writable(folder: Path) -> Iterator[None]:
    """Turns the errors of making a folder into a `CampaignError`."""
    try:
        yield
    except OSError as error:
        is_file = isinstance(error, FileExistsError | NotADirectoryError)
        reason = "a file is in the way" if is_file else error.strerror or error
        raise CampaignError(
            f"cannot make the folder {folder}: {reason}; choose another folder with --out"
        ) from error


@contextmanager
def translated(path: Path) -> Iterator[None]:
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
