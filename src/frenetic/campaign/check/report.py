"""The result of a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from frenetic.campaign.check.findings import Finding
from frenetic.campaign.record import Counts


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
    writer: str | None
    """Its present writer, such as "process 123"; None without one."""
    created_at: str
    """Time of its creation, UTC, ISO 8601; empty if unknown."""
    counts: Counts
    trajectories: int
    size: int
    """Bytes on disk."""
    versions: Mapping[str, str]
    """Versions of Python and the packages with which it was made."""

    @property
    def outstanding(self) -> int:
        """Number of candidates asked and not told."""
        return self.counts.asked - self.counts.told

    @property
    def bytes_per_test(self) -> float | None:
        """Counts, None without any result."""
        return self.size / self.counts.told if self.counts.told else None


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
