"""Tests as campaigns record them, and drives of their roads, made up."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np

from frenetic.campaign.record import Test
from frenetic.campaign.store import DATABASE
from frenetic.oracle import Side
from frenetic.outcome import Outcome
from frenetic.redrive.record import Redrive, Run
from frenetic.redrive.table import RunWriter
from frenetic.search import Candidate, Origin
from frenetic.simulators.worlds import Conditions


def recorded(
    outcome: Outcome = Outcome.FAIL,
    moobd: float | None = -1.0,
    departure_distance: float | None = None,
    departure_side: Side | None = None,
    *,
    id: int = 1,  # noqa: A002
    length: float = 230.0,
) -> Test:
    """A test of a straight road."""
    return Test(
        candidate=Candidate(id, np.zeros(24), length / 23.0, Origin("random")),
        told=id,
        outcome=outcome,
        reason="Car reached",
        budget_spent=0.5,
        seconds=0.1,
        moobd=moobd,
        departure_distance=departure_distance,
        departure_side=departure_side,
    )


def redriven(
    conditions: Conditions,
    outcome: Outcome,
    moobd: float | None,
    departure_distance: float | None = None,
    departure_side: Side | None = None,
    *,
    test: Test | None = None,
) -> Redrive:
    """A drive of a test's road."""
    return Redrive(
        test or recorded(), conditions, outcome, moobd, departure_distance, departure_side
    )


def store_run(folder: Path, run: Run) -> None:
    """Puts a run that was made up into a campaign."""
    with RunWriter(folder, lambda: run) as writer:
        for number, drive in enumerate(run.drives, start=1):
            writer.add(number, drive)


def forget_redrives(folder: Path) -> None:
    """Takes all that was driven again out of a campaign."""
    with closing(sqlite3.connect(folder / DATABASE)) as connection, connection:
        connection.execute("DELETE FROM redrive")
        connection.execute("DELETE FROM redrive_run")
    for file in folder.glob("*.json*"):
        file.unlink()
