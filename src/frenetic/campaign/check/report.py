"""What a check tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from frenetic.campaign.check.findings import Finding
from frenetic.campaign.record import Counts


class State(StrEnum):
    """What a campaign does."""

    RUNNING = "running"
    """A process writes it."""
    FINISHED = "finished"
    """Its budget is spent."""
    INTERRUPTED = "interrupted"
    """Somebody stopped it."""
    UNFINISHED = "unfinished"
    """Its process was killed, or gave up."""


@dataclass(frozen=True)
class Holdings:
    """What a campaign's database holds."""

    schema: int
    """Version of its tables."""
    state: State
    writer: str | None
    """Who writes it right now, such as "process 123"; None if nobody does."""
    created_at: str
    """UTC, ISO 8601; empty if it does not say."""
    counts: Counts
    trajectories: int
    size: int
    """Bytes on disk."""
    versions: Mapping[str, str]
    """Of Python and the packages with which it was made."""

    @property
    def outstanding(self) -> int:
        """Candidates asked and not told."""
        return self.counts.asked - self.counts.told

    @property
    def bytes_per_test(self) -> float | None:
        """None without any result."""
        return self.size / self.counts.told if self.counts.told else None


@dataclass(frozen=True)
class CheckReport:
    """What a campaign's database holds, and what is wrong with it."""

    folder: Path
    holdings: Holdings
    findings: tuple[Finding, ...]
    """In the order of looking; of a subject that has many, only the first, and their number."""

    @property
    def is_sound(self) -> bool:
        """Whether nothing was found."""
        return not self.findings
