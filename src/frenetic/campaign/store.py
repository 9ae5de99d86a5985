"""A campaign on disk: one SQLite database, to which each test is added when it ends.

The database, `campaign.sqlite` in the campaign's folder, is the campaign's record. Anyone with
SQLite can read it, while the campaign runs and long afterwards:

| table | one row per |
| --- | --- |
| fact | fact about the campaign (JSON), such as its configuration and the times of start and end |
| test | candidate of the strategy, with its result and drive as soon as the strategy knows them |
| finding | breach of a criterion in a drive |
| segment | drive that was judged: values of the segment around its place |
| earlier_test | test of another campaign, or real road, from which the search starts |
| earlier_finding | breach of a criterion in an earlier test |

`frenetic.campaign.columns` declares the columns. A test's trajectory is compressed by
`frenetic.campaign.trajectory_codec`.

When `CampaignStore.write` has returned, all results, drives and candidates that were added before
are in the database, even if the process is killed at that moment. If the machine itself goes down,
the last results may be missing, but the database is sound.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

from filelock import FileLock

from frenetic._support.files import FolderInUse
from frenetic._support.json_value import JSONValue, plain
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted, present_moment
from frenetic.campaign.columns import CANDIDATE_COLUMNS, row_of, segment_row
from frenetic.campaign.database import (
    DATABASE,
    EARLIER_TESTS,
    INSERT_SEGMENT,
    TESTS,
    check_identity,
    connect,
    connect_to_read,
    errors_about,
    make_database,
)
from frenetic.campaign.lock import lock_file
from frenetic.campaign.reader import CampaignReader
from frenetic.campaign.record import Test
from frenetic.campaign.trajectory_codec import decode, encode_and_round
from frenetic.errors import CampaignError, CampaignGoneError
from frenetic.search.records import Candidate

LOCK: Final = "campaign.lock"
"""Name of the lock file in a campaign's folder."""

_END_FACTS: Final = ("finished_at", "seconds", "interrupted", "ended", "notice")
"""Names of facts about a campaign's end, which are removed when the campaign is resumed."""
_REPLACE_FACT: Final = "INSERT OR REPLACE INTO fact VALUES (?, ?)"


class CampaignStore(CampaignReader):
    """The database of one campaign, open for one writer or for reading.

    `create` and `open` return a store; it is a context manager, which closes it at the end. One
    process writes at a time, and any number may read meanwhile. Call methods from the thread that
    opened the store. Every problem with the database is a `CampaignError` whose message names the
    file and what to do. After a failed `write`, for example on a full disk, the database still
    holds everything written before, and the other rows wait for the next `write`.
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, lock: FileLock | None
    ) -> None:  # called by `create` and `open` only; lock is None in a store for reading
        super().__init__(folder, connection)
        self._lock = lock
        self._opened_file = self._path.stat()
        self._in_use = FolderInUse(folder)
        self._waiting: dict[str, list[tuple[Any, ...]]] = {  # rows of the next transaction
            statement: []
            for statement in (TESTS.insert, TESTS.update, TESTS.insert_finding, INSERT_SEGMENT)
        }
        ((self._last_id, self._result_count),) = self._select(
            "SELECT coalesce(max(id), 0), count(result_number) FROM test"
        )

    @classmethod
    def create(
        cls,
        folder: Path | str,
        config: Mapping[str, JSONValue],
        facts: Mapping[str, JSONValue] = MappingProxyType({}),
        earlier: Sequence[Test] = (),
    ) -> Self:
        """Create a campaign in a folder, and the folder if need be.

        Args:
            folder: the campaign's folder.
            config: the campaign's configuration.
            facts: other facts about the campaign, by name.
            earlier: tests of other campaigns, and real roads, from which the search starts.

        Raises:
            CampaignError: the folder holds a campaign already or cannot be written.
            ValueError: the configuration or a fact is not JSON (NaN and infinity are not), or a
                number of a test is not finite.
        """
        folder = Path(folder)
        all_facts = {"config": dict(config), "created_at": present_moment(), **facts}
        rows = {
            _REPLACE_FACT: [_fact_row(*fact) for fact in all_facts.items()],
            EARLIER_TESTS.insert: [
                (*row_of(test.candidate, CANDIDATE_COLUMNS), 0) for test in earlier
            ],
        }
        for test in earlier:
            for statement, result_rows in EARLIER_TESTS.rows_of(test).items():
                rows.setdefault(statement, []).extend(result_rows)
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
            _refuse_existing(path)  # again: another process may have made one before the lock
            # Written under another name, so that a campaign exists completely or not at all.
            unfinished = folder / f"{DATABASE}.new"
            with errors_about(path):
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
        """Open the campaign in a folder.

        Raises:
            CampaignError: the folder holds no campaign, its database is damaged or has another
                format; or, for writing, another process writes it.
        """
        folder = Path(folder)
        path = folder / DATABASE
        with errors_about(path):
            if not path.is_file():
                problem = "holds no campaign" if folder.is_dir() else "is not a folder"
                if not os.path.lexists(folder):
                    problem = "does not exist"
                raise CampaignError(
                    f"{folder} {problem}: the folder of a campaign is needed, one with {DATABASE}"
                )
        if readonly:
            return cls._from_connection(folder, connect_to_read(path), None)
        lock = lock_file(folder / LOCK)
        try:
            return cls._open_locked(folder, lock)
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _open_locked(cls, folder: Path, lock: FileLock) -> Self:
        with errors_about(folder / DATABASE):
            connection = connect(folder / DATABASE, "mode=rw")
        return cls._from_connection(folder, connection, lock)

    @classmethod
    def _from_connection(
        cls, folder: Path, connection: sqlite3.Connection, lock: FileLock | None
    ) -> Self:
        """Return the store with this connection; close the connection if it is no campaign's.

        Raises:
            CampaignError: the database is another program's, or has another format.
        """
        path = folder / DATABASE
        try:
            with errors_about(path):
                check_identity(connection, path)
                if lock is not None:
                    connection.execute("PRAGMA journal_mode = WAL").fetchone()
                    connection.execute("PRAGMA synchronous = NORMAL")
                    # Wait for the disk every 16 MiB (4000 pages) instead of every 4 MiB.
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
        gone = self._gone_error() if isinstance(error, (CampaignError, OSError)) else None
        with suppress(CampaignError):  # the error that ends the block says more
            self.close()
        if gone is not None and not isinstance(error, CampaignGoneError):
            raise gone from error

    def close(self) -> None:
        """Write the waiting rows and close the database; closing twice does no harm."""
        try:
            self.write()
        finally:
            self._forget_waiting()
            try:
                with errors_about(self._path):
                    self._connection.close()
            finally:
                self._in_use.close()
                if self._lock is not None:
                    self._lock.release()

    def __repr__(self) -> str:
        """The folder with the number of results; the folder alone of a closed store."""
        try:
            return f"<CampaignStore {self.at_a_glance()}>"
        except CampaignError:
            return f"<CampaignStore {self.folder}>"

    # Facts

    def finish(self, **facts: JSONValue) -> None:
        """Add facts about the campaign's end, such as its ``seconds``, and write the waiting rows.

        The present time is added as ``finished_at`` unless it is among the facts. An older fact of
        the same name is replaced: a campaign can be resumed and finish again.

        Raises:
            ValueError: a fact is not JSON.
            CampaignError: the database cannot be written, or was removed.
        """
        self.require_there()
        self.keep(**{"finished_at": present_moment(), **facts})

    def keep(self, **facts: JSONValue) -> None:
        """Add or replace facts, and write the waiting rows; raise the errors of `finish`."""
        self._transact({_REPLACE_FACT: [_fact_row(*fact) for fact in facts.items()]})

    def reopen(self, **facts: JSONValue) -> None:
        """Replace the facts about the campaign's end by others; raise the errors of `finish`."""
        removals = {"DELETE FROM fact WHERE name = ?": [(name,) for name in _END_FACTS]}
        self._transact({**removals, _REPLACE_FACT: [_fact_row(*fact) for fact in facts.items()]})

    # Writing

    def add_candidate(self, candidate: Candidate) -> None:
        """Add a candidate, which the next `write` stores.

        Raises:
            CampaignError: an earlier candidate has the same or a higher id.
            ValueError: a number is not finite.
        """
        self._require_writer()
        if candidate.id <= self._last_id:
            raise CampaignError(
                f"{self._path} already holds candidate {self._last_id}: the next one needs a"
                f" higher id, not {candidate.id}"
            )
        self._waiting[TESTS.insert].append(
            (*row_of(candidate, CANDIDATE_COLUMNS), self._result_count)
        )
        self._last_id = candidate.id

    def add_result(self, test: Test, packed: bytes | None = None) -> None:
        """Add the result of an outstanding candidate, which the next `write` stores.

        The values of the drive's segment are added, too, measured on the trajectory as it is
        stored. A drive on which they cannot be measured has none.

        Args:
            test: the test. With `packed`, it may have the trajectory in `packed` or none.
            packed: the encoded trajectory; None to encode the trajectory of the test.

        Raises:
            ValueError: a number is not finite.
        """
        self._require_writer()
        if packed is None and test.trajectory is not None:
            packed, trajectory = encode_and_round(test.trajectory)
            test = replace(test, trajectory=trajectory, records=len(trajectory))
        for statement, rows in TESTS.rows_of(test, packed).items():
            self._waiting[statement] += rows
        if packed is not None and test.outcome.is_driven:
            if test.trajectory is None or test.setting is None:
                test = replace(
                    test,
                    trajectory=test.trajectory or decode(packed),
                    setting=test.setting or self._known_setting,
                )
            values = test.measure()
            if values is not None:
                row = (test.id, *segment_row(values))
                self._waiting[INSERT_SEGMENT].append(row)
        self._result_count += 1

    def write(self) -> None:
        """Store all candidates and results that wait, durably.

        Raises:
            CampaignError: the database cannot be written; the rows wait for the next `write`.
        """
        if any(self._waiting.values()):
            self._transact({})

    def _transact(self, others: Mapping[str, Sequence[tuple[Any, ...]]]) -> None:
        """Execute the waiting statements, and others with their rows, in one transaction."""
        self._require_writer()
        connection, has_begun = self._connection, False
        with errors_about(self._path):
            try:
                connection.execute("BEGIN IMMEDIATE")
                has_begun = True
                for statement, rows in {**self._waiting, **others}.items():
                    connection.executemany(statement, rows)
                connection.execute("COMMIT")
                self._forget_waiting()
            except BaseException as error:
                if connection.in_transaction:  # after some errors SQLite has ended it by itself
                    connection.execute("ROLLBACK")
                elif has_begun and not isinstance(error, sqlite3.Error):
                    # Ctrl-C came after COMMIT: the rows are stored, and must not be stored again.
                    self._forget_waiting()
                raise

    def _forget_waiting(self) -> None:
        for rows in self._waiting.values():
            rows.clear()

    def _require_writer(self) -> None:
        if self._lock is None:
            raise CampaignError(f"{self._path} was opened for reading: open it with readonly=False")

    def require_there(self) -> None:
        """Check that the database is still the file that was opened.

        Raises:
            CampaignGoneError: the file was moved, deleted or replaced.
        """
        if (gone := self._gone_error()) is not None:
            raise gone

    def _gone_error(self) -> CampaignGoneError | None:
        """Return the error for a moved or removed database; None if it is in its place.

        If the folder was moved with its database, SQLite still writes to it: the results are there.
        """
        with suppress(OSError):
            if os.path.samestat(self._path.stat(), self._opened_file):
                return None
        fate = self._in_use.fate()
        if self._in_use.holds(DATABASE, self._opened_file):
            with suppress(CampaignError):  # for example because the disk is full
                self.write()
            text = f"{self.folder} {fate} while it was in use: {self._stored_results_text()} there"
            error = CampaignGoneError(f"{text}; resume it there")
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

    def _stored_results_text(self) -> str:
        """Return the number of stored results as a clause: ``its 3 results are``."""
        number = self.stored()
        return f"its {counted(number, 'result')} {'is' if number == 1 else 'are'}"

    def require_sound(self) -> None:
        """Check that the file is undamaged and no result is missing, before results are added.

        SQLite reads the whole file, which takes about a second per gigabyte.

        Raises:
            CampaignError: the file is damaged, or a result is missing.
        """
        ((verdict,),) = self._select("PRAGMA quick_check(1)")
        if verdict != "ok":
            raise self._damaged(" ".join(verdict.split()))
        ((number, last),) = self._select(
            "SELECT count(result_number), max(result_number) FROM test"
        )
        if number and number != last:
            raise self._damaged(f"it holds {number} of {last} results")


def _fact_row(name: str, value: JSONValue) -> tuple[str, str]:
    """Return the row of a fact in the database.

    Raises:
        ValueError: the value is not JSON, or too large or too deep to be read again.
    """
    try:
        text = json.dumps(value, allow_nan=False, default=plain)
    except RecursionError:
        raise ValueError(f"{name} is nested too deep") from None
    read_json(text)  # raises if the limits of our reader are exceeded
    return name, text


def _refuse_existing(path: Path) -> None:
    """Raise a `CampaignError` if there is a file at the path of a new database."""
    if os.path.lexists(path):
        raise CampaignError(
            f"{path.parent} already holds a campaign; choose another place, or "
            "resume that one: frenetic resume (in Python: resume())"
        )
