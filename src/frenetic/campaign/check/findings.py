"""What is not as it should be."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

SHOWN: Final = 10
"""Findings of a kind that are told one by one; of more, only their number is."""


class Severity(StrEnum):
    """How bad a finding is."""

    ERROR = "error"
    """Something is lost or wrong."""
    WARNING = "warning"
    """All is there, but something cannot be done with it, or this version sees it otherwise."""


class Subject(StrEnum):
    """What a finding is about."""

    DATABASE = "database"
    """The file, as SQLite sees it."""
    SCHEMA = "schema"
    """Its tables and columns."""
    CONFIGURATION = "configuration"
    """What it says about the campaign."""
    CANDIDATE = "candidate"
    """A road that was asked for."""
    ORDER = "order"
    """What was asked and told, in which order."""
    BUDGET = "budget"
    """The share of the budget that was spent."""
    TEST = "test"
    """A result."""
    TRAJECTORY = "trajectory"
    """What was driven."""
    VERDICT = "verdict"
    """A drive or a road that is judged otherwise now."""


@dataclass(frozen=True)
class Finding:
    """Something that is not as it should be."""

    subject: Subject
    severity: Severity
    message: str
    """One line."""


class Findings:
    """Collects findings; of a subject that has many, the first are kept and the others counted."""

    def __init__(self) -> None:
        self._kept: list[Finding] = []
        self._counts: Counter[tuple[Subject, Severity]] = Counter()

    def add(self, subject: Subject, message: str, severity: Severity = Severity.ERROR) -> None:
        """Takes note of a finding."""
        self._counts[subject, severity] += 1
        if self._counts[subject, severity] <= SHOWN:
            self._kept.append(Finding(subject, severity, " ".join(message.split())))

    def all(self) -> tuple[Finding, ...]:
        """What was found, in that order; at the end how many more there are."""
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
        """Makes a finding of what SQLite complains about while something is read."""
        try:
            yield
        except sqlite3.Error as error:
            self.add(Subject.DATABASE, f"{what} cannot be read to the end: {error}")
