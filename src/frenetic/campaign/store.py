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

import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, Self

from filelock import FileLock

from frenetic._support.json_value import JSONValue
from frenetic._support.words import present_moment
from frenetic.campaign.database import (
    DATABASE,
    LOCK,
    REPLACE_FACT,
    check_identity,
    checksum,
    connect,
    connect_to_read,
    fact_row,
    find_database,
    make_database,
    refuse_existing,
    translated,
    writable,
)
from frenetic.campaign.lock import lock_file
from frenetic.campaign.reader import CampaignReader
from frenetic.campaign.record import (
    FINDING,
    FINISHED,
    TOLD,
    Test,
    row_of,
    row_of_candidate,
    row_of_finding,
)
from frenetic.errors import CampaignError
from frenetic.search.records import Candidate

_INSERT: Final = f"INSERT OR REPLACE INTO test VALUES ({', '.join('?' * (len(FINISHED) + 3))})"  # noqa: S608
_INSERT_FINDING: Final = f"INSERT INTO finding VALUES ({', '.join('?' * (len(FINDING) + 2))})"  # noqa: S608
_UNTOLD: Final = (None,) * len(TOLD)
_ENDINGS: Final = ("finished_at", "seconds", "interrupted", "ended", "notice")
_FIXED: Final = ("config", "created_at", "earlier", "sources", "started_in")


class CampaignStore(CampaignReader):
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
        super().__init__(folder, connection)
        self._lock = lock
        self._opened = self._path.stat()
        self._held: dict[int, tuple[object, ...]] = {}  # rows for the next transaction
        self._findings: list[tuple[object, ...]] = []  # likewise
        self._asked: dict[int, tuple[Candidate, tuple[object, ...]]] = {}  # and their values
        with translated(self._path):
            number = "SELECT coalesce(max(id), 0), count(told) FROM test"
            self._last_asked, self._told = connection.execute(number).fetchone()
            self._outstanding: dict[int, int] = dict(
                connection.execute("SELECT id, asked_after FROM test WHERE told IS NULL")
                if lock is not None
                else ()
            )

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
        rows = [fact_row(*fact) for fact in named.items()]
        with writable(folder):
            folder.mkdir(parents=True, exist_ok=True)
        path = folder / DATABASE
        refuse_existing(path)
        lock = lock_file(folder / LOCK)
        try:
            refuse_existing(path)  # again: someone may have been faster before we had the lock
            # Made under another name, so that a campaign exists completely or not at all.
            unfinished = folder / f"{DATABASE}.new"
            with translated(path):
                for leftover in ("", "-wal", "-shm", "-journal"):
                    unfinished.with_name(unfinished.name + leftover).unlink(missing_ok=True)
                make_database(unfinished, rows)
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
            connection = connect(path, "mode=rw")
        try:
            with translated(path):
                check_identity(connection, path)
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
        rows = [fact_row(*fact) for fact in facts.items()]
        with self._transaction() as connection:
            connection.executemany("DELETE FROM fact WHERE name = ?", [(name,) for name in without])
            connection.executemany(REPLACE_FACT, rows)

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
        asked = row_of_candidate(candidate)
        row = (*asked, *_UNTOLD, self._told)
        self._held[candidate.id] = (*row, checksum(row), None)
        self._asked[candidate.id] = candidate, asked
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
        candidate, asked = self._asked.pop(test.id, (None, ()))
        if candidate is not test.candidate:
            asked = row_of_candidate(test.candidate)
        if packed is not test.attempt:
            test = replace(test, attempt=packed)
        row = (*asked, *row_of(test), self._outstanding[test.id])
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
