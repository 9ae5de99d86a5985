"""Databases that break off or cannot grow, and a campaign on a full disk.

Run as a script on a small file system, it prints what happened as one JSON object:
``python small_disk.py FOLDER``.
"""

from __future__ import annotations

import json
import os
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from campaigns import campaign
from contents import contents
from events import on_result

from frenetic.campaign import CampaignStore, Event
from frenetic.errors import CampaignError

FREE_BYTES = 500_000
"""Bytes left free on the full disk."""


class Breaking(sqlite3.Connection):
    """A connection that raises an error once, before or after one of the next statements."""

    left = 0
    """Statements of transactions until the error; 0 for no error."""
    is_after = True
    error: BaseException = KeyboardInterrupt()

    def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
        return self._count(super().execute, sql, *values)

    def executemany(self, sql: str, *values: Any) -> sqlite3.Cursor:
        return self._count(super().executemany, sql, *values)

    def _count(self, run: Callable[..., sqlite3.Cursor], sql: str, *values: Any) -> sqlite3.Cursor:
        kind, breaks = type(self), False
        if kind.left and sql.startswith(("BEGIN", "INSERT", "UPDATE", "COMMIT")):
            kind.left -= 1
            breaks = kind.left == 0
        if breaks and not self.is_after:
            raise self.error
        cursor = run(sql, *values)
        if breaks:
            raise self.error
        return cursor


class Bounded(sqlite3.Connection):
    """A connection to a database that cannot grow beyond some pages."""

    pages: int | None = None

    def execute(self, sql: str, *parameters: Any) -> sqlite3.Cursor:
        if sql.startswith("BEGIN"):
            super().execute(f"PRAGMA max_page_count = {self.pages or 1_000_000}").fetchone()
        return super().execute(sql, *parameters)


def search_on_full_disk(folder: Path) -> dict[str, object]:
    """Search and resume on a full disk, then with space; compare with an undisturbed search."""
    whole, short = folder / "whole", folder / "short"
    campaign(whole, 200, max_in_flight=16).run()
    expected = contents(whole)
    for left_over in whole.iterdir():
        left_over.unlink()
    disk = os.statvfs(folder)
    ballast = folder / "ballast"
    ballast.write_bytes(bytes(disk.f_bavail * disk.f_frsize - FREE_BYTES))
    reported: list[int] = []

    def search() -> Any:
        return campaign(short, 200, workers=2)

    messages = [
        ending(search().run, on_result(lambda summary: reported.append(summary.result_count)))
    ]
    with CampaignStore.open(short) as store:
        stored = store.counts().result_count
    messages.append(ending(search().resume))
    ballast.unlink()
    ended = ending(search().resume)
    same = contents(short) == expected
    return {
        "messages": messages,
        "reported": reported[-1],
        "stored": stored,
        "ended": ended,
        "same": same,
    }


def ending(go_on: Any, on_event: Callable[[Event], object] | None = None) -> str:
    """Return the error with which a campaign ends, or else its number of simulations."""
    try:
        return str(go_on(on_event=on_event).simulations)
    except CampaignError as error:
        return str(error)


if __name__ == "__main__":
    print(json.dumps(search_on_full_disk(Path(sys.argv[1]))))  # noqa: T201
