"""What a campaign's database holds, for comparisons."""

from __future__ import annotations

import sqlite3
from pathlib import Path

OF_THE_RUN = ("seconds", "finished_at", "elapsed", "worker", "checksum")
"""Columns of a test that say when and by whom it was driven, or hold a sum over these."""


def contents(folder: Path, *, without: tuple[str, ...] = ()) -> dict[str, list[tuple[object, ...]]]:
    """Every row of a campaign's database, but for times and workers, and columns `without`."""
    connection = sqlite3.connect(folder / "campaign.sqlite")
    try:
        columns = [
            row[1]
            for row in connection.execute("PRAGMA table_info(test)")
            if row[1] not in (*OF_THE_RUN, *without)
        ]
        queries = {
            "candidate": "SELECT * FROM candidate ORDER BY id",
            "test": f"SELECT {', '.join(columns)} FROM test ORDER BY told",
            "trajectory": "SELECT * FROM trajectory ORDER BY candidate_id",
        }
        return {name: connection.execute(query).fetchall() for name, query in queries.items()}
    finally:
        connection.close()
