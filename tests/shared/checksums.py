"""Databases changed behind the store's back, with checksums that match or do not."""

from __future__ import annotations

import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from frenetic.campaign.database import DATABASE, checksum
from frenetic.campaign.record import FINDING, FINISHED

TEST = ", ".join(column.name for column in FINISHED)
OF_FINDING = ", ".join(f'"{column.name}"' for column in FINDING)


def renew_checksums(connection: sqlite3.Connection) -> None:
    """Gives every row of a campaign the checksum of its values."""
    with suppress(sqlite3.OperationalError):  # a table or column that was removed
        for fact in connection.execute("SELECT name, value FROM fact").fetchall():
            change = "UPDATE fact SET checksum = ? WHERE name = ?"
            connection.execute(change, (checksum(fact), fact[0]))
        for test in connection.execute(f"SELECT {TEST}, asked_after FROM test").fetchall():
            select = f"SELECT number, {OF_FINDING} FROM finding WHERE test = ? ORDER BY number"
            findings = connection.execute(select, test[:1])
            total = checksum([*test, *(value for finding in findings for value in finding)])
            connection.execute("UPDATE test SET checksum = ? WHERE id = ?", (total, test[0]))


def execute(folder: Path, statement: str, *values: object, renew: bool = True) -> int:
    """Changes a campaign's database; returns how many rows."""
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        changed = connection.execute(statement, values).rowcount
        if renew:
            renew_checksums(connection)
        connection.commit()
    return changed
