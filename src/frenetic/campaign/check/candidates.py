"""The check of the candidates."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator

import numpy as np

from frenetic.campaign.check.database import Tables
from frenetic.campaign.check.findings import Findings, Subject
from frenetic.campaign.check.rows import CandidateRow, candidate_rows
from frenetic.spec import is_number, shown


def check_candidates(
    connection: sqlite3.Connection, tables: Tables, last: int, told: int, findings: Findings
) -> None:
    """Checks each candidate on its own, and the order of asking.

    Args:
        connection: to the database.
        tables: that it has.
        last: last id to check.
        told: number of results.
        findings: collects the findings.
    """
    generations: dict[int, int] = {}
    before = asked_after = 0
    for row in candidate_rows(connection, tables, last):
        name = f"candidate {row.id}"
        if row.id != before + 1:
            findings.add(Subject.ORDER, f"{_span(before + 1, row.id - 1)} missing")
        before = row.id
        for fault in _faults(row):
            findings.add(Subject.CANDIDATE, f"{name}: {fault}")
        parents = _parents(row.parents)
        if parents is not None and is_whole(row.generation):
            if unknown := [str(parent) for parent in parents if not 1 <= parent < row.id]:
                text = f"{name} has parents that were not asked before it: {', '.join(unknown)}"
                findings.add(Subject.ORDER, text)
            wanted = max((generations.get(parent, -1) + 1 for parent in parents), default=0)
            if row.generation != wanted and all(parent in generations for parent in parents):
                text = f"{name} is of generation {row.generation}, its parents make it {wanted}"
                findings.add(Subject.CANDIDATE, text)
            generations[row.id] = row.generation
        if is_whole(row.asked_after):
            if row.asked_after < asked_after:
                text = f"{name} was asked after {row.asked_after} results, the one before it after"
                findings.add(Subject.ORDER, f"{text} {asked_after}")
            elif row.asked_after > told:
                text = f"{name} was asked after {row.asked_after} results, but there are {told}"
                findings.add(Subject.ORDER, text)
            asked_after = row.asked_after


def is_whole(value: object) -> bool:
    """Whether it is a whole number."""
    return isinstance(value, int)


def _span(first: int, last: int) -> str:
    return f"candidate {first} is" if first == last else f"candidates {first} to {last} are"


def _parents(text: object) -> list[int] | None:
    try:
        parents = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        return None
    if not isinstance(parents, list) or not all(type(parent) is int for parent in parents):
        return None
    return parents


def _faults(row: CandidateRow) -> Iterator[str]:
    """Findings about a candidate on its own."""
    if not isinstance(row.operator, str):
        yield f"the operator is {shown(row.operator)}: a text is needed"
    if _parents(row.parents) is None:
        yield f"the parents are {shown(row.parents)}: a JSON list of ids is needed"
    for column in ("generation", "asked_after"):
        value = getattr(row, column)
        if not is_whole(value) or value < 0:
            yield f"{column} is {shown(value)}: a whole number of at least 0 is needed"
    if not is_number(row.step) or row.step <= 0.0:
        yield f"the step is {shown(row.step)}: a positive number of metres is needed"
    if not isinstance(row.curvatures, bytes) or len(row.curvatures) % 8:
        yield "the curvatures are no whole number of float64"
    elif not np.isfinite(np.frombuffer(row.curvatures, dtype="<f8")).all():
        yield "the curvatures are not all finite"
    if row.points is not None:
        if not isinstance(row.points, bytes) or len(row.points) % 16:
            yield "the points are no whole pairs of float64"
        elif not np.isfinite(np.frombuffer(row.points, dtype="<f8")).all():
            yield "the points are not all finite"
