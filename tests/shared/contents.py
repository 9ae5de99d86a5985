"""What a campaign's database holds, for comparisons."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frenetic.campaign import CampaignStore

OF_THE_RUN = ("seconds", "finished_at", "elapsed", "worker")
"""Columns of a test that say when and by whom it was driven."""


def contents(folder: Path, *, without: tuple[str, ...] = ()) -> dict[str, list[tuple[object, ...]]]:
    """Every candidate, result and finding, but for times and workers, and columns `without`."""
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as connection:
        columns = ", ".join(
            row[1]
            for row in connection.execute("PRAGMA table_info(test)")
            if row[1] not in (*OF_THE_RUN, *without)
        )
        queries = {
            "test": f"SELECT {columns} FROM test ORDER BY id",
            "finding": "SELECT * FROM finding ORDER BY test, number",
        }
        return {name: connection.execute(query).fetchall() for name, query in queries.items()}


def execute(folder: Path, statement: str, *values: object) -> int:
    """Changes a campaign's database behind the store's back; returns how many rows."""
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as connection:
        changed = connection.execute(statement, values).rowcount
        connection.commit()
    return changed


def everything(folder: Path) -> list[object]:
    """All that can be read of a campaign, see `plain`."""
    with CampaignStore.open(folder) as store:
        return [
            plain(value)
            for value in (
                store.config,
                store.facts,
                store.earlier(),
                list(store.tests(with_trajectory=True)),
                list(store.candidates()),
                store.counts(),
                store.elapsed(),
            )
        ]


def plain(value: Any) -> Any:
    """A value in Python's own types, for comparisons; arrays are bytes, text has whole characters.

    The places of a record's values are kept by name, so that a new one is compared, too.
    """
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if is_dataclass(value):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    return value
