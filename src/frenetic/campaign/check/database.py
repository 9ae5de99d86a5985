"""The checks of the file, its tables, and its facts about the campaign."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Collection, Mapping
from contextlib import closing
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

from frenetic.campaign.changes import CHANGES, read_changes
from frenetic.campaign.check.report import FindingCollector, Severity, Subject
from frenetic.campaign.record import CHECKSUM, Setting, checksum_fault, is_moment
from frenetic.campaign.store import MIGRATIONS
from frenetic.spec import Budget, Decoded, decode_budget, decode_config, is_number, shown


def check_file(connection: sqlite3.Connection, findings: FindingCollector) -> None:
    """Lets SQLite check its pages, indexes and constraints."""
    for (text,) in connection.execute("PRAGMA integrity_check"):
        for line in str(text).splitlines():
            if line != "ok":
                findings.add(Subject.DATABASE, f"SQLite says: {line}")
    for table, row, parent, _ in connection.execute("PRAGMA foreign_key_check"):
        findings.add(Subject.DATABASE, f"row {row} of {table} belongs to no row of {parent}")


@dataclass(frozen=True)
class Tables:
    """The complete tables of a database, each with its columns."""

    columns: Mapping[str, frozenset[str]]

    def has(self, *names: str) -> bool:
        """Whether these are among them."""
        return all(name in self.columns for name in names)


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


@dataclass(frozen=True)
class Facts:
    """Usable facts of a database about its campaign."""

    created_at: str = ""
    finished_at: str = ""
    """Reason of its end, empty if it has not ended by itself."""
    interrupted: bool = False
    seconds: float | None = None
    """Campaign time when it ended, in s."""
    first_budget: Budget | None = None
    last_budget: Budget | None = None
    """The last budget."""
    setting: Setting | None = None
    versions: Mapping[str, str] = field(default_factory=dict)


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
