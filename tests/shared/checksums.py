"""Databases without checksums, which would find whatever a test changes in their rows."""

from __future__ import annotations

import sqlite3
from contextlib import suppress

TABLES = ("campaign", "candidate", "test", "trajectory", "redrive_run", "redrive")


def forget_checksums(connection: sqlite3.Connection) -> None:
    """Lets the rows of a campaign have no checksums."""
    for table in TABLES:
        with suppress(sqlite3.OperationalError):  # a table or column that was removed
            connection.execute(f"UPDATE {table} SET checksum = NULL")
