"""The SQLite file of a campaign: tables, statements, connections, and errors in plain words."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from frenetic._support.files import flush
from frenetic.campaign.columns import (
    CANDIDATE_COLUMNS,
    FINDING_COLUMNS,
    RESULT_COLUMNS,
    SEGMENT_COLUMNS,
    TEST_COLUMNS,
    row_of,
)
from frenetic.campaign.record import Test
from frenetic.campaign.trajectory_codec import encode
from frenetic.errors import CampaignError

DATABASE: Final = "campaign.sqlite"
"""Name of the database in a campaign's folder."""
FORMAT: Final = 9
"""Format of the database (`PRAGMA user_version`); a database of another format is refused."""
APPLICATION_ID: Final = int.from_bytes(b"FrnC")
"""Number that marks a SQLite file as a campaign of ours (`PRAGMA application_id`)."""
_BUSY_TIMEOUT: Final = 10.0
"""Longest time that a reader waits for the writer, in s (our choice)."""


def comma_list(columns: Sequence[object]) -> str:
    """Return the text of columns, separated by commas."""
    return ", ".join(map(str, columns))


def _placeholders(count: int) -> str:
    """Return SQL's placeholders for a number of values: ``?, ?, ?``."""
    return comma_list("?" * count)


_CANDIDATE_NAMES: Final = [*(column.name for column in CANDIDATE_COLUMNS), "asked_after"]
_RESULT_NAMES: Final = [*(column.name for column in RESULT_COLUMNS), "trajectory"]


@dataclass(frozen=True)
class Tables:
    """A table of tests, a table of their findings, and the statements for both."""

    test: str
    finding: str
    label: str
    """Word for a test in messages."""

    @property
    def schema(self) -> str:
        """Statements that create the tables."""
        # asked_after: the number of results that the strategy knew when it proposed the candidate.
        return f"""
            CREATE TABLE {self.test} (
                {comma_list([f"{column.name} {column.sql_type}" for column in TEST_COLUMNS])},
                asked_after INTEGER NOT NULL, trajectory BLOB, PRIMARY KEY (id)
            ) STRICT;
            CREATE TABLE {self.finding} (
                test INTEGER NOT NULL REFERENCES {self.test} (id), number INTEGER NOT NULL,
                {comma_list([f'"{column.name}" {column.sql_type}' for column in FINDING_COLUMNS])},
                PRIMARY KEY (test, number)
            ) STRICT, WITHOUT ROWID;
        """

    @cached_property
    def insert(self) -> str:
        """Statement that adds a candidate."""
        return (
            f"INSERT INTO {self.test} ({comma_list(_CANDIDATE_NAMES)})"  # noqa: S608
            f" VALUES ({_placeholders(len(_CANDIDATE_NAMES))})"
        )

    @cached_property
    def update(self) -> str:
        """Statement that adds the result of a candidate."""
        values = comma_list([f"{name} = ?" for name in _RESULT_NAMES])
        return f"UPDATE {self.test} SET {values} WHERE id = ?"  # noqa: S608

    @cached_property
    def insert_finding(self) -> str:
        """Statement that adds a finding."""
        return f"INSERT INTO {self.finding} VALUES ({_placeholders(2 + len(FINDING_COLUMNS))})"  # noqa: S608

    def select(self, count: int) -> str:
        """Return the statement that reads `count` tests by their ids."""
        columns = comma_list([column.name for column in TEST_COLUMNS])
        return f"SELECT {columns} FROM {self.test} WHERE id IN ({_placeholders(count)})"  # noqa: S608

    def select_findings(self, count: int) -> str:
        """Return the statement that reads the findings of `count` tests."""
        columns = comma_list([f'"{column.name}"' for column in FINDING_COLUMNS])
        return (
            f"SELECT test, {columns} FROM {self.finding}"  # noqa: S608
            f" WHERE test IN ({_placeholders(count)}) ORDER BY test, number"
        )

    def rows_of(self, test: Test, packed: bytes | None = None) -> dict[str, list[tuple[Any, ...]]]:
        """Return the statements that add the result of a test, each with its rows.

        Args:
            test: the test.
            packed: the encoded trajectory; None to encode the trajectory of the test.

        Raises:
            ValueError: a number is not finite.
        """
        if packed is None and test.trajectory is not None:
            packed = encode(test.trajectory)
            test = replace(test, records=len(test.trajectory))
        findings = enumerate(
            [row_of(finding, FINDING_COLUMNS) for finding in test.result.findings], 1
        )
        return {
            self.update: [(*row_of(test, RESULT_COLUMNS), packed, test.id)],
            self.insert_finding: [(test.id, number, *row) for number, row in findings],
        }


TESTS: Final = Tables("test", "finding", "test")
EARLIER_TESTS: Final = Tables("earlier_test", "earlier_finding", "earlier test")
SEGMENT: Final = "segment"
"""Name of the table of the segments of judged drives."""
INSERT_SEGMENT: Final = f"INSERT INTO {SEGMENT} VALUES ({_placeholders(1 + len(SEGMENT_COLUMNS))})"  # noqa: S608
"""Statement that adds a segment: the id of its test, then the values of `SEGMENT_COLUMNS`."""
_SCHEMA: Final = f"""
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {FORMAT};
CREATE TABLE fact (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID;
{TESTS.schema}
{EARLIER_TESTS.schema}
CREATE TABLE {SEGMENT} (
    test INTEGER PRIMARY KEY REFERENCES {TESTS.test} (id),
    {comma_list([f"{column.name} {column.sql_type}" for column in SEGMENT_COLUMNS])}
) STRICT;
"""


def select_trajectories(count: int) -> str:
    """Return the statement that reads the packed trajectories of `count` tests."""
    return f"SELECT id, trajectory FROM {TESTS.test} WHERE id IN ({_placeholders(count)})"  # noqa: S608


def select_segments(count: int) -> str:
    """Return the statement that reads the segments of `count` tests."""
    columns = comma_list([column.name for column in SEGMENT_COLUMNS])
    return f"SELECT test, {columns} FROM {SEGMENT} WHERE test IN ({_placeholders(count)})"  # noqa: S608


def connect(path: Path, options: str) -> sqlite3.Connection:
    """Return a connection that opens no transaction by itself: the caller begins and ends each.

    Args:
        path: path of the database.
        options: query of SQLite's URI, such as ``mode=ro``.
    """
    uri = f"{path.resolve().as_uri()}?{options}"
    return sqlite3.connect(uri, uri=True, timeout=_BUSY_TIMEOUT, isolation_level=None)


def connect_to_read(path: Path) -> sqlite3.Connection:
    """Return a connection to a campaign's database that changes nothing.

    Raises:
        CampaignError: the database cannot be read.
    """
    with errors_about(path):
        connection = connect(path, "mode=ro")
        try:
            connection.execute("PRAGMA user_version").fetchone()
        except sqlite3.Error as error:
            connection.close()
            # A reader, too, creates files beside the database, which fails in a folder that it may
            # not write. `immutable` avoids them, but promises that nobody writes: this is so if
            # there is no write-ahead log.
            code = getattr(error, "sqlite_errorcode", 0) & 0xFF
            is_written = path.with_name(f"{DATABASE}-wal").exists()
            if code not in (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY) or is_written:
                raise
            connection = connect(path, "mode=ro&immutable=1")
    return connection


def check_identity(connection: sqlite3.Connection, path: Path) -> None:
    """Check that a database belongs to a campaign and has the format of this version.

    Raises:
        CampaignError: the database is another program's, or has another format.
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


def make_database(path: Path, rows: Mapping[str, Sequence[tuple[Any, ...]]]) -> None:
    """Write a complete campaign without tests to a new file.

    Args:
        path: path of the new file.
        rows: SQL statement -> the rows with whose values it is executed.
    """
    connection = connect(path, "mode=rwc")
    try:
        # Nobody reads the file before it is complete, so only `flush` waits for the disk.
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
def errors_about(path: Path) -> Iterator[None]:
    """Turn errors of SQLite and the file system into a `CampaignError` about `path`."""
    try:
        yield
    except sqlite3.Error as error:
        # An extended code has the primary code in its lowest byte; errors of Python's module have
        # no code.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        text = " ".join(str(error).split())
        raise CampaignError(f"{path} {_EXPLAINED.get(code, _UNEXPLAINED).format(text)}") from error
    except UnicodeDecodeError as error:  # raised for damaged text, which SQLite's message quotes
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
