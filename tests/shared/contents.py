"""Contents of a campaign's database, for comparisons."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frenetic.campaign import CampaignStore

RUN_COLUMNS = ("seconds", "finished_at", "elapsed", "worker")
"""Columns of a test that say when and by whom it was driven."""


def contents(folder: Path, *, without: tuple[str, ...] = ()) -> dict[str, list[tuple[object, ...]]]:
    """Return all tests, findings and segments, without times, workers and the columns `without`."""
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as connection:
        columns = ", ".join(
            row[1]
            for row in connection.execute("PRAGMA table_info(test)")
            if row[1] not in (*RUN_COLUMNS, *without)
        )
        queries = {
            "test": f"SELECT {columns} FROM test ORDER BY id",
            "finding": "SELECT * FROM finding ORDER BY test, number",
            "segment": "SELECT * FROM segment ORDER BY test",
        }
        return {name: connection.execute(query).fetchall() for name, query in queries.items()}


def execute(folder: Path, statement: str, *values: object) -> int:
    """Change a campaign's database without its store; return the number of changed rows."""
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as connection:
        changed = connection.execute(statement, values).rowcount
        connection.commit()
    return changed


def stored_values(folder: Path) -> list[object]:
    """Return all that the store reads of a campaign, as `plain` values."""
    with CampaignStore.open(folder) as store:
        return [
            plain(value)
            for value in (
                store.config,
                store.facts,
                store.earlier(),
                list(store.tests(with_trajectory=True, with_segments=True)),
                list(store.candidates()),
                store.counts(),
                store.elapsed(),
            )
        ]


def plain(value: Any) -> Any:
    """Return a value in Python's own types, for comparisons.

    An array becomes shape and bytes, a record a dictionary of all its fields. Lone
    surrogates in a text are escaped.
    """
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return value
