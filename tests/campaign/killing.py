"""A campaign in a process that kills itself, also in the middle of a write."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

from campaigns import campaign
from events import on_result
from faulty import FaultySimulator
from pids import LIMIT

from frenetic.campaign import Summary
from frenetic.campaign.database import DATABASE
from frenetic.errors import CampaignError
from frenetic.processes import object_process
from frenetic.processes.children import process_context


@dataclass(frozen=True)
class Blow:
    """When the process is killed."""

    kind: Literal["start", "write", "commit", "result"]
    """At the start, at an instruction within a transaction, at a commit, or after a result."""
    number: int = 1
    """Which of these moments, counted from 1."""
    delay: float = 0.0
    """Time from that moment to the kill, in s."""


def exit_code_of(target: Callable[..., object], *arguments: object) -> int | None:
    """Exit code of a new process that calls a function; it comes from the server of the workers."""
    context: Any = process_context()
    process = context.Process(target=target, args=arguments, name="campaign")
    process.start()
    try:
        process.join(LIMIT)
        code: int | None = process.exitcode
        return code
    finally:
        process.kill()
        process.join()


def go_on(
    folder: Path, marks: Path, simulations: int, workers: int, max_in_flight: int, blow: Blow | None
) -> None:
    """Run or resume a campaign until it ends or the blow comes; each result appends a byte."""
    if sys.platform == "linux":
        # Forked from this process, which has loaded everything: a server would take a second.
        object_process.process_context = lambda _: multiprocessing.get_context("fork")  # type: ignore
    killer = _Killer(blow)
    sqlite3.connect = killer.connect  # type: ignore[assignment]
    simulator = FaultySimulator(marks)
    search = campaign(
        folder, simulations, simulator=simulator, workers=workers, max_in_flight=max_in_flight
    )
    reported = os.open(marks / "reported", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def report(progress: Summary) -> None:
        os.write(reported, b".")
        killer.count("result")

    killer.count("start")
    (search.resume if (folder / DATABASE).exists() else search.run)(on_event=on_result(report))


def run_until(target: str, folder: Path, arguments: Sequence[str]) -> None:
    """Run a command line in a folder until it calls the named function, which kills the process."""
    from frenetic.cli import main  # slow, and used only here

    os.chdir(folder)
    with patch(target, lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)):
        main(list(arguments))


def write_refusals(folder: Path, file: Path) -> None:
    """Try to run and to resume a campaign, and write a line for each refusal."""
    search = campaign(folder)
    refusals = []
    for start in (search.run, search.resume):
        try:
            start()
        except CampaignError as error:
            refusals.append(f"{error}\n")
    file.write_text("".join(refusals), encoding="utf-8")


class _Killer:
    """Counts moments of a campaign, and kills this process at the moment of the blow."""

    def __init__(self, blow: Blow | None) -> None:
        self.blow = blow
        self.left = blow.number if blow else 0
        self.connection: sqlite3.Connection | None = None
        self.now = threading.Event()
        self.open = sqlite3.connect
        threading.Thread(target=self.strike, daemon=True).start()

    def strike(self) -> None:
        self.now.wait()
        assert self.blow is not None
        # Busy, since a sleep is too coarse for microseconds.
        until = time.perf_counter() + self.blow.delay
        while time.perf_counter() < until:
            pass
        os.kill(os.getpid(), signal.SIGKILL)

    def count(self, kind: str) -> None:
        if self.blow is not None and self.blow.kind == kind:
            self.left -= 1
            if self.left == 0:
                if kind == "write":
                    os.kill(os.getpid(), signal.SIGKILL)  # within the transaction
                self.now.set()

    def connect(self, *arguments: Any, **options: Any) -> sqlite3.Connection:
        connection = self.open(*arguments, **options, factory=_OftenCheckpointed)
        if self.blow is not None and self.blow.kind == "write":

            def instruction() -> int:
                if connection.in_transaction:
                    self.count("write")
                return 0

            connection.set_progress_handler(instruction, 1)

        def statement(sql: str) -> None:
            if sql.startswith("COMMIT"):
                self.count("commit")

        connection.set_trace_callback(statement)
        return connection


class _OftenCheckpointed(sqlite3.Connection):
    """Checkpoints every five pages, so that a blow may also hit the database file itself."""

    def execute(self, sql: str, *parameters: Any) -> sqlite3.Cursor:
        if "wal_autocheckpoint" in sql:
            sql = "PRAGMA wal_autocheckpoint = 5"
        return super().execute(sql, *parameters)
