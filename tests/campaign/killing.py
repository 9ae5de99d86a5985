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
    """After its beginning, in a transaction, in its end, or after a result."""
    number: int = 1
    """Of the instruction of SQLite within transactions, of the transaction, or of the result."""
    delay: float = 0.0
    """s after that."""


def exit_code_of(target: Callable[..., object], *arguments: object) -> int | None:
    """Of a process of its own; it is made as workers are, since the server is the same."""
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
    """Runs or resumes a campaign until it ends or the blow comes; each result leaves a byte."""
    if sys.platform == "linux":
        # Forked from this process, which has loaded everything: a server would take a second.
        object_process.process_context = lambda _: multiprocessing.get_context("fork")  # type: ignore
    killer = _Killer(blow)
    sqlite3.connect = killer.connect  # type: ignore[assignment]
    simulator = FaultySimulator(marks)
    one = campaign(
        folder, simulations, simulator=simulator, workers=workers, max_in_flight=max_in_flight
    )
    reported = os.open(marks / "reported", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def report(progress: Summary) -> None:
        os.write(reported, b".")
        killer.count("result")

    killer.count("start")
    (one.resume if (folder / DATABASE).exists() else one.run)(on_event=on_result(report))


def run_until(place: str, folder: Path, arguments: Sequence[str]) -> None:
    """Runs a command line in a folder until it calls what is at a place, where it is killed."""
    from frenetic.cli import main  # which takes a while, and the other campaigns here need none

    os.chdir(folder)
    with patch(place, lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)):
        main(list(arguments))


def write_refusals(folder: Path, answers: Path) -> None:
    """Tries to run and to resume a campaign, and writes down a line for each refusal."""
    one = campaign(folder)
    refusals = []
    for go_on in (one.run, one.resume):
        try:
            go_on()
        except CampaignError as error:
            refusals.append(f"{error}\n")
    answers.write_text("".join(refusals), encoding="utf-8")


class _Killer:
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
        # Awake, since these are microseconds.
        until = time.perf_counter() + self.blow.delay
        while time.perf_counter() < until:
            pass
        os.kill(os.getpid(), signal.SIGKILL)

    def count(self, kind: str) -> None:
        if self.blow is not None and self.blow.kind == kind:
            self.left -= 1
            if self.left == 0:
                if kind == "write":
                    os.kill(os.getpid(), signal.SIGKILL)  # right here
                self.now.set()

    def connect(self, *arguments: Any, **options: Any) -> sqlite3.Connection:
        connection = self.open(*arguments, **options, factory=_Hasty)
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


class _Hasty(sqlite3.Connection):
    """Brings what was written into the database itself often, so that a blow may hit that, too."""

    def execute(self, sql: str, *parameters: Any) -> sqlite3.Cursor:
        if "wal_autocheckpoint" in sql:
            sql = "PRAGMA wal_autocheckpoint = 5"
        return super().execute(sql, *parameters)
