"""The file of a campaign's database: its tables, its identity, how it is made, opened and read.

`frenetic.campaign.record` declares the columns.
"""

from __future__ import annotations

import json
import os
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from frenetic._support.files import flush
from frenetic._support.json_value import JSONValue, plain
from frenetic.campaign.record import FINDING, FINISHED
from frenetic.errors import CampaignError

DATABASE: Final = "campaign.sqlite"
"""Name of the database in a campaign's folder."""
FORMAT: Final = 3
"""Format of the database (`PRAGMA user_version`); another one is refused."""
APPLICATION_ID: Final = int.from_bytes(b"FrnC")
"""Mark of our campaigns among SQLite files (`PRAGMA application_id`)."""
LOCK: Final = "campaign.lock"
"""Name of the lock file in a campaign's folder."""

_BUSY_TIMEOUT: Final = 10.0  # s that a reader waits for the writer
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
REPLACE_FACT: Final = "INSERT OR REPLACE INTO fact VALUES (?, ?, ?)"
"""For a `fact_row`."""


def checksum(row: Iterable[object]) -> int:
    """CRC-32 of the values of a row, see `SCHEMA`.

    It is that of a JSON list in ASCII, as Python writes it, with the CRC-32 of a blob in its place.
    """
    values = [zlib.crc32(value) if type(value) is bytes else value for value in row]
    return zlib.crc32(json.dumps(values).encode())


def fact_row(name: str, value: JSONValue) -> tuple[object, ...]:
    """The row of a fact.

    Raises:
        ValueError: the value is not JSON.
    """
    row = name, json.dumps(value, allow_nan=False, default=plain)
    return (*row, checksum(row))


def refuse_existing(path: Path) -> None:
    """Raises a `CampaignError` if there is something in a new database's place."""
    if os.path.lexists(path):
        raise CampaignError(
            f"{path.parent} already holds a campaign; choose another place, or "
            "go on with that one: frenetic resume (in Python: resume())"
        )


def connect(path: Path, options: str) -> sqlite3.Connection:
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
        connection = connect(path, "mode=ro")
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
                connection = connect(path, "mode=ro&immutable=1")
            check_identity(connection, path)
        except BaseException:
            connection.close()
            raise
    return connection


def check_identity(connection: sqlite3.Connection, path: Path) -> None:
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


def make_database(path: Path, facts: Iterable[tuple[object, ...]]) -> None:
    """Writes a complete campaign without tests to a new file."""
    connection = connect(path, "mode=rwc")
    try:
        # It counts when it is complete, so only its end waits for the disk.
        connection.execute("PRAGMA synchronous = OFF")
        connection.execute("PRAGMA journal_mode = MEMORY").fetchone()
        connection.executescript(SCHEMA)
        connection.executemany(REPLACE_FACT, facts)
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
            f"cannot make the folder {folder}: {reason}; choose another place"
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
