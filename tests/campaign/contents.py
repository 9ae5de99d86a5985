"""What a campaign's database holds, for comparisons."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from frenetic.campaign.store import DATABASE

OF_THE_RUN = ("seconds", "finished_at", "elapsed", "worker", "checksum")
"""Columns of a test that say when and by whom it was driven, or hold a sum over these."""


def contents(folder: Path, *, without: tuple[str, ...] = ()) -> dict[str, list[tuple[object, ...]]]:
    """Tests and findings of a campaign, but for times and workers, and columns `without`."""
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(test)")]
        columns = ", ".join(name for name in names if name not in (*OF_THE_RUN, *without))
        queries = {
            "test": f"SELECT {columns} FROM test ORDER BY id",
            "finding": "SELECT * FROM finding ORDER BY test, number",
        }
        return {name: connection.execute(query).fetchall() for name, query in queries.items()}
