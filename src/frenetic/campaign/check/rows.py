"""Unchecked rows of a database, read a batch at a time."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from frenetic.campaign.check.database import Tables

_BATCH: Final = 500  # read at once, so that no reader blocks the emptying of a writer's log


class CandidateRow(NamedTuple):
    """A candidate with its unchecked values."""

    id: Any
    operator: Any
    parents: Any
    generation: Any
    step: Any
    curvatures: Any
    asked_after: Any
    points: Any
    """Points, None unless the road was proposed as points."""


class ResultRow(NamedTuple):
    """A result with its road and its trajectory, all values unchecked."""

    candidate_id: Any
    told: Any
    outcome: Any
    reason: Any
    budget_spent: Any
    x: Any
    y: Any
    heading: Any
    moobd: Any
    max_oob_share: Any
    duration: Any
    moobd_distance: Any
    departure_time: Any
    departure_distance: Any
    departure_x: Any
    departure_y: Any
    departure_side: Any
    seconds: Any
    finished_at: Any
    attempts: Any
    worker: Any
    elapsed: Any
    asked_after: Any
    """None if there is no such candidate, as for the next three."""
    step: Any
    curvatures: Any
    points: Any
    trajectory: Any
    """None if there is none."""


_OLD: Final[Mapping[str, str]] = {
    "attempts": "1 AS attempts",
    "worker": "NULL AS worker",
    "elapsed": "NULL AS elapsed",
    "points": "NULL AS points",
}
"""Substitutes for columns that databases of old versions lack."""


def candidate_rows(
    connection: sqlite3.Connection, tables: Tables, last: int
) -> Iterator[CandidateRow]:
    """The candidates with ids up to ``last``, in the order of their ids."""
    select = f"""
        SELECT {", ".join(_here(tables, "candidate", CandidateRow._fields))} FROM candidate
        WHERE id > ? AND id <= ? ORDER BY id LIMIT {_BATCH}
    """  # noqa: S608  # names of columns
    done = 0
    while rows := connection.execute(select, (done, last)).fetchall():
        yield from map(CandidateRow._make, rows)
        done = rows[-1][0]


def result_rows(connection: sqlite3.Connection, tables: Tables, last: int) -> Iterator[ResultRow]:
    """The results told as numbers up to ``last``, in the order of telling."""
    names = ResultRow._fields
    of_candidate, trajectory = names.index("asked_after"), names.index("trajectory")
    columns = [
        *_here(tables, "test", names[:of_candidate]),
        *_here(tables, "candidate", names[of_candidate:trajectory]),
    ]
    columns[0] = "test.candidate_id"
    select = f"""
        SELECT {", ".join(columns)}, data
        FROM test
            LEFT JOIN candidate ON candidate.id = test.candidate_id
            LEFT JOIN trajectory ON trajectory.candidate_id = test.candidate_id
        WHERE told > ? AND told <= ? ORDER BY told LIMIT {_BATCH}
    """  # noqa: S608  # names of columns
    done = 0
    while rows := connection.execute(select, (done, last)).fetchall():
        yield from map(ResultRow._make, rows)
        done = rows[-1][1]


def _here(tables: Tables, table: str, names: Sequence[str]) -> list[str]:
    """Columns of a table as they can be selected from any version."""
    here = tables.columns[table]
    return [name if name in here else _OLD[name] for name in names]
