"""The whole check, and that of the file, its tables, and its facts about the campaign."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

from frenetic.campaign.changes import CHANGES, read_changes
from frenetic.campaign.check.report import (
    CheckReport,
    Facts,
    FindingCollector,
    Holdings,
    Severity,
    State,
    Subject,
    Tables,
)
from frenetic.campaign.check.rows import (
    check_budget,
    check_candidates,
    check_earlier,
    check_objectives,
    check_redrives,
    check_results,
)
from frenetic.campaign.counts import StoredCounts, road_key
from frenetic.campaign.lock import holder
from frenetic.campaign.record import CHECKSUM, Setting, checksum_fault, is_moment
from frenetic.campaign.store import (
    DATABASE,
    LOCK,
    MIGRATIONS,
    SELECT_TESTED_ROADS,
    check_identity,
    connect_to_read,
    find_database,
    translated,
)
from frenetic.outcome import Outcome
from frenetic.spec import Decoded, decode_budget, decode_config, is_number, shown


def check_campaign(
    folder: Path | str,
    *,
    quick: bool = False,
    on_test: Callable[[int, int], None] | None = None,
) -> CheckReport:
    """Checks the campaign in a folder, without changing it.

    Args:
        folder: of the campaign.
        quick: do not judge the stored drives and refused roads again.
        on_test: called after each test with the number of checked tests, and of all.

    Raises:
        CampaignError: there is no campaign, the file is another program's or a newer version's, or
            SQLite cannot read it at all.
    """
    folder = Path(folder)
    path = find_database(folder)
    with translated(path):
        connection = connect_to_read(path)
    with closing(connection):
        with translated(path):
            version = check_identity(connection, path)
        connection.text_factory = _text
        return _check(folder, connection, version, quick, on_test)


def _text(data: bytes) -> str | bytes:
    """Bytes as text, or unchanged if they are none, which is found where a text is needed."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data


def _check(
    folder: Path,
    connection: sqlite3.Connection,
    version: int,
    quick: bool,
    on_test: Callable[[int, int], None] | None,
) -> CheckReport:
    findings = FindingCollector()
    tables, facts = Tables(MappingProxyType({})), Facts()
    with findings.reading("the file"):
        check_file(connection, findings)
    with findings.reading("the schema"):
        tables = check_schema(connection, version, findings)
    if tables.has("campaign"):
        with findings.reading("the configuration"):
            facts = check_facts(connection, tables.columns["campaign"], findings)
    asked, told = _last_numbers(connection, tables, findings)
    holdings = _holdings(folder, connection, version, tables, facts, findings)
    if tables.has("candidate"):
        with findings.reading("the candidates"):
            check_candidates(connection, tables, asked, told, findings)
    if tables.has("candidate", "test", "trajectory"):

        def done(number: int) -> None:
            if on_test is not None:
                on_test(number, told)

        with findings.reading("the results"):
            series = check_results(
                connection, tables, told, facts, findings, quick=quick, on_test=done
            )
            if len(series.ids) == told and None not in series.outcomes:
                ended = holdings.state in (State.FINISHED, State.INTERRUPTED)
                check_budget(series, facts, ended, findings)
    with findings.reading("what was driven again"):
        check_redrives(connection, tables, findings)
    with findings.reading("what it started from"):
        check_earlier(connection, tables, findings)
    with findings.reading("the objective"):
        check_objectives(connection, tables, findings)
    return CheckReport(folder, holdings, findings.all())


def _last_numbers(
    connection: sqlite3.Connection, tables: Tables, findings: FindingCollector
) -> tuple[int, int]:
    """The last candidate's id and the last result's number, at the same moment."""
    last = {"candidate": 0, "test": 0}
    with findings.reading("the numbers of the last candidate and result"):
        connection.execute("BEGIN")
        for table, column in (("candidate", "id"), ("test", "told")):
            if tables.has(table):
                select = f"SELECT max({column}) FROM {table}"  # noqa: S608
                (number,) = connection.execute(select).fetchone()
                last[table] = number if isinstance(number, int) else 0
    if connection.in_transaction:
        connection.execute("ROLLBACK")
    return last["candidate"], last["test"]


def _holdings(
    folder: Path,
    connection: sqlite3.Connection,
    version: int,
    tables: Tables,
    facts: Facts,
    findings: FindingCollector,
) -> Holdings:
    by_outcome = dict.fromkeys(Outcome, 0)
    told = asked = trajectories = 0
    roads: set[int] = set()
    lowest: float | None = None
    elapsed: object = None
    with findings.reading("the number of tests"):
        if tables.has("test"):
            select = "SELECT outcome, count(*), min(moobd) FROM test GROUP BY outcome"
            for outcome, number, moobd in connection.execute(select):
                told += number
                if outcome in by_outcome:
                    by_outcome[Outcome(outcome)] += number
                if is_number(moobd):
                    lowest = moobd if lowest is None else min(lowest, moobd)
        if tables.has("candidate"):
            (asked,) = connection.execute("SELECT count(*) FROM candidate").fetchone()
        if tables.has("candidate", "test"):
            roads = {road_key(*row) for row in connection.execute(_select_roads(tables))}
        if tables.has("trajectory"):
            (trajectories,) = connection.execute("SELECT count(*) FROM trajectory").fetchone()
        if "elapsed" in tables.columns.get("test", ()):
            (elapsed,) = connection.execute("SELECT max(elapsed) FROM test").fetchone()
    writer = holder(folder / LOCK)
    files = (folder / f"{DATABASE}{suffix}" for suffix in ("", "-wal"))
    counts = StoredCounts.of(by_outcome, lowest, len(roads), asked=asked)
    return Holdings(
        schema=version,
        state=_state(facts, writer, elapsed),
        is_spent=_is_spent(facts, counts, elapsed),
        writer=writer,
        created_at=facts.created_at,
        counts=counts,
        told=told,
        trajectories=trajectories,
        size=sum(file.stat().st_size for file in files if file.is_file()),
        versions=facts.versions,
    )


def _select_roads(tables: Tables) -> str:
    """A SELECT of the roads of all tests, also of a database that lacks a column."""
    if {"step", "curvatures", "points"} <= set(tables.columns["candidate"]):
        return SELECT_TESTED_ROADS
    return SELECT_TESTED_ROADS.replace("points", "NULL", 1)


def _is_spent(facts: Facts, counts: StoredCounts, elapsed: object) -> bool:
    budget = facts.last_budget or facts.first_budget
    if budget is None:
        return False
    seconds = elapsed if isinstance(elapsed, float) else 0.0
    return budget.spent(counts.simulations, seconds, counts.failed) >= 1.0


def _state(facts: Facts, writer: str | None, elapsed: object) -> State:
    """State of the campaign, given its writer and the time of its last result in s."""
    if writer is not None:
        return State.RUNNING
    went_on = (
        facts.seconds is not None
        and isinstance(elapsed, float)
        and elapsed > facts.seconds + 1e-3  # to which the seconds are rounded
    )
    if not facts.finished_at or went_on:
        return State.UNFINISHED
    return State.INTERRUPTED if facts.interrupted else State.FINISHED


# The file, its tables, and its facts about the campaign


def check_file(connection: sqlite3.Connection, findings: FindingCollector) -> None:
    """Lets SQLite check its pages, indexes and constraints."""
    for (text,) in connection.execute("PRAGMA integrity_check"):
        for line in str(text).splitlines():
            if line != "ok":
                findings.add(Subject.DATABASE, f"SQLite says: {line}")
    for table, row, parent, _ in connection.execute("PRAGMA foreign_key_check"):
        findings.add(Subject.DATABASE, f"row {row} of {table} belongs to no row of {parent}")


def check_schema(
    connection: sqlite3.Connection, version: int, findings: FindingCollector
) -> Tables:
    """Compares the tables with those of a new database of the same version."""
    with closing(sqlite3.connect(":memory:")) as model:
        for statements in MIGRATIONS[:version]:
            for statement in statements:
                model.execute(statement)
        wanted = _parts(model)
    here = _parts(connection)
    whole = {}
    for (kind, name), columns in wanted.items():
        is_table = kind == "table"
        if (kind, name) not in here:
            severity = Severity.ERROR if is_table else Severity.WARNING
            findings.add(Subject.SCHEMA, f"the {kind} {name} is missing", severity)
        elif missing := columns - here[kind, name]:
            text = f"the {kind} {name} has no {', '.join(sorted(missing))}"
            findings.add(Subject.SCHEMA, text)
        elif is_table:
            whole[name] = here[kind, name]
    return Tables(MappingProxyType(whole))


def _parts(connection: sqlite3.Connection) -> dict[tuple[str, str], frozenset[str]]:
    """Kind and name of all tables, views and indexes -> a table's columns, none of the others."""
    named = connection.execute("SELECT type, name FROM sqlite_schema WHERE sql IS NOT NULL")
    return {
        (kind, name): frozenset(_columns(connection, name) if kind == "table" else ())
        for kind, name in named.fetchall()
    }


def _columns(connection: sqlite3.Connection, table: str) -> list[str]:
    rows = connection.execute("SELECT name FROM pragma_table_info(?)", (table,))
    return [name for (name,) in rows]


def check_facts(
    connection: sqlite3.Connection, columns: Collection[str], findings: FindingCollector
) -> Facts:
    """Checks the configuration and the other facts, in a table with these columns."""
    facts: dict[str, Any] = {}
    column = CHECKSUM if CHECKSUM in columns else "NULL"
    select = f"SELECT key, value, {column} FROM campaign ORDER BY key"  # noqa: S608
    for row in connection.execute(select):
        key, text, _ = row
        if fault := checksum_fault(row):
            findings.add(Subject.CONFIGURATION, f"the fact {key} {fault}")
        try:
            facts[key] = json.loads(text)
        except (TypeError, ValueError, RecursionError):
            findings.add(Subject.CONFIGURATION, f"the fact {key} is not JSON")
            facts[key] = None
    config = facts.get("config")
    if not isinstance(config, dict):
        findings.add(Subject.CONFIGURATION, "there is no configuration")
        known = Decoded()
    else:
        known = decode_config(config)
        for fault in known.faults:
            findings.add(Subject.CONFIGURATION, fault)
        for fault in known.command_faults:
            text = f"the campaign cannot be resumed: {fault}"
            findings.add(Subject.CONFIGURATION, text, Severity.WARNING)
    for name, is_fine, needed in (
        ("created_at", is_moment, "a date and time"),
        ("finished_at", is_moment, "a date and time"),
        ("interrupted", lambda value: isinstance(value, bool), "true or false"),
        ("seconds", lambda value: is_number(value) and value >= 0.0, "a number of at least 0"),
        ("budget", lambda value: _is_read_by(decode_budget, value), "a budget"),
        (CHANGES, lambda value: _is_read_by(read_changes, value), "a list of changes"),
    ):
        if name in facts and not is_fine(facts[name]):
            text = f"the fact {name} is {shown(facts[name])}: {needed} is needed"
            findings.add(Subject.CONFIGURATION, text)
            del facts[name]
    if "created_at" not in facts:
        findings.add(Subject.CONFIGURATION, "there is no created_at, the time it was made")
    names = [item.name for item in fields(Setting)]
    drive = {name: known.values[name] for name in names if name in known.values}
    return Facts(
        created_at=facts.get("created_at", ""),
        finished_at=facts.get("finished_at", ""),
        interrupted=facts.get("interrupted", False),
        seconds=facts.get("seconds"),
        first_budget=known.values.get("budget"),
        last_budget=decode_budget(facts["budget"]) if "budget" in facts else None,
        setting=Setting(**drive) if len(drive) == len(names) else None,
        versions=MappingProxyType(known.values.get("versions", {})),
    )


def _is_read_by(read: Callable[[Any], object], value: object) -> bool:
    try:
        read(value)
    except ValueError:
        return False
    return True
