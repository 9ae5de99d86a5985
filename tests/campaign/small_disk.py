"""Campaigns on a disk that is full or read-only; run as a script, in a place of its own.

    python small_disk.py FOLDER full|readonly mounted|plain

With ``mounted`` the folder is a small file system of its own; with ``plain``, where none could be
mounted, SQLite is told to hold no more pages, and permissions forbid to write. Prints what it saw
as one JSON object.
"""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

from contents import contents
from events import on_result
from faulty import FaultySimulator

from frenetic.campaign import Budget, Campaign, CampaignStore, Summary
from frenetic.errors import CampaignError
from frenetic.search import Frenetic2021
from frenetic.testing import DummyDriver

ROOM = 500_000
"""Bytes that are left on the full disk."""


def campaign(folder: Path, workers: int) -> Campaign:
    marks = Path(__file__).parent / "nowhere"
    return Campaign(
        strategy=Frenetic2021(
            seed=4, random_budget=0.1, cross_freq=10, cross_num=6, max_redraws=10
        ),
        simulator=Quiet(marks),
        driver=DummyDriver(),
        budget=Budget(simulations=200),
        folder=folder,
        workers=workers,
        ordered=True,
    )


class Quiet(FaultySimulator):
    """Leaves no marks."""

    def __enter__(self):  # type: ignore[no-untyped-def]
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Bounded(sqlite3.Connection):
    """A database that cannot grow beyond some pages."""

    pages: int | None = None

    def execute(self, sql: str, *parameters: Any) -> sqlite3.Cursor:
        if sql.startswith("BEGIN"):
            super().execute(f"PRAGMA max_page_count = {self.pages or 1_000_000}").fetchone()
        return super().execute(sql, *parameters)


def attempt(search: Any, seen: list[int] | None = None) -> str:
    """The message of the error with which a campaign ends, or how many simulations it has."""

    def report(progress: Summary) -> None:
        if seen is not None:
            seen.append(progress.tests + progress.dropped)

    try:
        return str(search(on_event=on_result(report)).simulations)
    except CampaignError as error:
        return str(error)


def full(folder: Path, mounted: bool) -> dict[str, object]:
    seen: dict[str, object] = {}
    connect = sqlite3.connect
    for workers in (1, 2):
        whole, short = (folder / f"{name}-{workers}" for name in ("whole", "short"))
        campaign(whole, 1).run()
        expected = contents(whole)
        for left_over in whole.iterdir():
            left_over.unlink()
        ballast = folder / "ballast"
        if mounted:
            disk = os.statvfs(folder)
            ballast.write_bytes(bytes(disk.f_bavail * disk.f_frsize - ROOM))
        else:
            Bounded.pages = 40
            sqlite3.connect = lambda *a, **k: connect(*a, **k, factory=Bounded)  # type: ignore
        reported: list[int] = []
        messages = [attempt(campaign(short, workers).run, reported)]
        with CampaignStore.open(short) as store:
            stored = store.counts().told
        messages.append(attempt(campaign(short, workers).resume))
        if mounted:
            ballast.unlink()
        else:
            Bounded.pages = None
        ended = attempt(campaign(short, workers).resume)
        seen[str(workers)] = {
            "messages": messages,
            "reported": reported[-1],
            "stored": stored,
            "ended": ended,
            "same": contents(short) == expected,
        }
        sqlite3.connect = connect
    return seen


def readonly(folder: Path, mounted: bool) -> dict[str, object]:
    old, new = folder / "old", folder / "new"
    campaign(old, 1).run()
    before = {path.name: path.read_bytes() for path in old.iterdir()}
    if mounted:
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
    else:
        for path in (*old.iterdir(), old, folder):
            path.chmod(0o555 if path.is_dir() else 0o444)
        if os.geteuid() == 0:
            os.seteuid(65534)  # whom permissions bind
    try:
        messages = [attempt(campaign(new, 1).run), attempt(campaign(old, 2).resume)]
        with CampaignStore.open(old) as store:  # reading is possible
            stored = store.counts().simulations
        after = {path.name: path.read_bytes() for path in old.iterdir()}
        return {"messages": messages, "stored": stored, "same": before == after}
    finally:
        if not mounted:
            if os.getuid() == 0:
                os.seteuid(0)
            for path in (folder, old, *old.iterdir()):
                path.chmod(0o755 if path.is_dir() else 0o644)


if __name__ == "__main__":
    where, what, how = sys.argv[1:]
    check = {"full": full, "readonly": readonly}[what]
    print(json.dumps(check(Path(where), how == "mounted")))  # noqa: T201
