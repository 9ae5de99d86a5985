"""Databases that break off, and campaigns on a disk that is full or read-only.

Run as a script on a small file system of its own, it prints what it saw as one JSON object:
``python small_disk.py FOLDER full|readonly``.
"""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from campaigns import campaign
from contents import contents
from events import on_result

from frenetic.campaign import Campaign, CampaignStore, Summary
from frenetic.errors import CampaignError

ROOM = 500_000
"""Bytes that are left on the full disk."""


class Breaking(sqlite3.Connection):
    """Raises an error once, before or after one of the next statements of a transaction."""

    left = 0
    """Until that statement."""
    is_after = True
    error: BaseException = KeyboardInterrupt()

    def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
        return self._count(super().execute, sql, *values)

    def executemany(self, sql: str, *values: Any) -> sqlite3.Cursor:
        return self._count(super().executemany, sql, *values)

    def _count(self, run: Callable[..., sqlite3.Cursor], sql: str, *values: Any) -> sqlite3.Cursor:
        kind, breaks = type(self), False
        if kind.left and sql.startswith(("BEGIN", "INSERT", "COMMIT")):
            kind.left -= 1
            breaks = kind.left == 0
        if breaks and not self.is_after:
            raise self.error
        cursor = run(sql, *values)
        if breaks:
            raise self.error
        return cursor


def search(folder: Path, workers: int) -> Campaign:
    return campaign(folder, 200, workers=workers, ordered=True)


class Bounded(sqlite3.Connection):
    """A database that cannot grow beyond some pages."""

    pages: int | None = None

    def execute(self, sql: str, *parameters: Any) -> sqlite3.Cursor:
        if sql.startswith("BEGIN"):
            super().execute(f"PRAGMA max_page_count = {self.pages or 1_000_000}").fetchone()
        return super().execute(sql, *parameters)


def attempt(go_on: Any, seen: list[int] | None = None) -> str:
    """The message of the error with which a campaign ends, or how many simulations it has."""

    def report(progress: Summary) -> None:
        if seen is not None:
            seen.append(progress.tests + progress.dropped)

    try:
        return str(go_on(on_event=on_result(report)).simulations)
    except CampaignError as error:
        return str(error)


def full(folder: Path) -> dict[str, object]:
    seen: dict[str, object] = {}
    for workers in (1, 2):
        whole, short = (folder / f"{name}-{workers}" for name in ("whole", "short"))
        search(whole, 1).run()
        expected = contents(whole)
        for left_over in whole.iterdir():
            left_over.unlink()
        disk = os.statvfs(folder)
        ballast = folder / "ballast"
        ballast.write_bytes(bytes(disk.f_bavail * disk.f_frsize - ROOM))
        reported: list[int] = []
        messages = [attempt(search(short, workers).run, reported)]
        with CampaignStore.open(short) as store:
            stored = store.counts().told
        messages.append(attempt(search(short, workers).resume))
        ballast.unlink()
        ended = attempt(search(short, workers).resume)
        seen[str(workers)] = {
            "messages": messages,
            "reported": reported[-1],
            "stored": stored,
            "ended": ended,
            "same": contents(short) == expected,
        }
    return seen


def readonly(folder: Path) -> dict[str, object]:
    old, new = folder / "old", folder / "new"
    search(old, 1).run()
    before = {path.name: path.read_bytes() for path in old.iterdir()}
    subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
    messages = [attempt(search(new, 1).run), attempt(search(old, 2).resume)]
    with CampaignStore.open(old) as store:  # reading is possible
        stored = store.counts().simulations
    after = {path.name: path.read_bytes() for path in old.iterdir()}
    return {"messages": messages, "stored": stored, "same": before == after}


if __name__ == "__main__":
    check = {"full": full, "readonly": readonly}[sys.argv[2]]
    print(json.dumps(check(Path(sys.argv[1]))))  # noqa: T201
