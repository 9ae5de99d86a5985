"""The result of a check: findings, and the contents of the database, as far as they are usable."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final

from frenetic.campaign.counts import StoredCounts
from frenetic.campaign.record import Setting
from frenetic.spec import Budget

SHOWN: Final = 10
"""Most findings of a subject in detail; the rest are only counted."""


class Severity(StrEnum):
    """Severity of a finding."""

    ERROR = "error"
    """Something is lost or wrong."""
    WARNING = "warning"
    """Everything is there, but something cannot be used, or this version judges otherwise."""


class Subject(StrEnum):
    """Subject of a finding."""

    DATABASE = "database"
    """The file, as SQLite sees it."""
    SCHEMA = "schema"
    """Its tables and columns."""
    CONFIGURATION = "configuration"
    """Its facts about the campaign."""
    CANDIDATE = "candidate"
    """A road that was asked for."""
    ORDER = "order"
    """The order of asking and telling."""
    BUDGET = "budget"
    """The spent share of the budget."""
    TEST = "test"
    """A result."""
    TRAJECTORY = "trajectory"
    """A trajectory."""
    REDRIVE = "redrive"
    """A drive of a road that was driven again, or the run of several."""
    EARLIER = "earlier"
    """A test of an earlier campaign that this one started from."""
    VERDICT = "verdict"
    """A drive or a road whose verdict differs now."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    subject: Subject
    severity: Severity
    message: str
    """One line."""


class FindingCollector:
    """Collects findings; of a subject with many, it keeps the first and counts the others."""

    def __init__(self) -> None:
        self._kept: list[Finding] = []
        self._counts: Counter[tuple[Subject, Severity]] = Counter()

    def add(self, subject: Subject, message: str, severity: Severity = Severity.ERROR) -> None:
        """Adds a finding."""
        self._counts[subject, severity] += 1
        if self._counts[subject, severity] <= SHOWN:
            self._kept.append(Finding(subject, severity, " ".join(message.split())))

    def all(self) -> tuple[Finding, ...]:
        """The findings in order; at the end the number of further ones."""
        return (
            *self._kept,
            *(
                Finding(subject, severity, f"{number - SHOWN:,} more about a {subject}")
                for (subject, severity), number in self._counts.items()
                if number > SHOWN
            ),
        )

    @contextmanager
    def reading(self, what: str) -> Iterator[None]:
        """Turns SQLite's errors while reading into findings."""
        try:
            yield
        except sqlite3.Error as error:
            self.add(Subject.DATABASE, f"{what} cannot be read to the end: {error}")


@dataclass(frozen=True)
class Tables:
    """The complete tables of a database, each with its columns."""

    columns: Mapping[str, frozenset[str]]

    def has(self, *names: str) -> bool:
        """Whether these are among them."""
        return all(name in self.columns for name in names)


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


class State(StrEnum):
    """State of a campaign."""

    RUNNING = "running"
    """A process writes it."""
    FINISHED = "finished"
    """Its budget is spent."""
    INTERRUPTED = "interrupted"
    """It was stopped."""
    UNFINISHED = "unfinished"
    """Its process was killed, or gave up."""


@dataclass(frozen=True)
class Holdings:
    """Contents of a campaign's database."""

    schema: int
    """Version of its tables."""
    state: State
    is_spent: bool
    """Whether its last budget is spent, so that an unfinished one lacks only its end."""
    writer: str | None
    """Its present writer, such as "process 123"; None without one."""
    created_at: str
    """Time of its creation, UTC, ISO 8601; empty if unknown."""
    counts: StoredCounts
    told: int
    """Results, also those whose outcome is damaged."""
    trajectories: int
    size: int
    """Bytes on disk."""
    versions: Mapping[str, str]
    """Versions of Python and the packages with which it was made."""

    @property
    def outstanding(self) -> int:
        """Number of candidates asked and not told."""
        return self.counts.asked - self.told

    @property
    def bytes_per_test(self) -> float | None:
        """Bytes per result; None without any."""
        return self.size / self.told if self.told else None


@dataclass(frozen=True)
class CheckReport:
    """Contents of a campaign's database, and the findings about it."""

    folder: Path
    holdings: Holdings
    findings: tuple[Finding, ...]
    """Findings in the order of checking; of a subject with many, the first, and their number."""

    @property
    def is_sound(self) -> bool:
        """Whether there are no findings."""
        return not self.findings
