"""Progress and summary of a campaign."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from frenetic.campaign.store import JSONValue
from frenetic.outcome import Outcome


@dataclass(frozen=True)
class Progress:
    """Progress of a campaign."""

    invalid: int = 0
    passed: int = 0
    failed: int = 0
    errors: int = 0
    dropped: int = 0
    """Number of candidates that the strategy no longer wanted before they were driven."""
    min_moobd: float | None = None
    """Lowest MOOBD of all drives so far, in m."""
    seconds: float = 0.0
    """Wall time since the start, in s."""
    budget_spent: float = 0.0
    """0..1."""

    @property
    def simulations(self) -> int:
        """Number of drives, including broken ones."""
        return self.passed + self.failed + self.errors

    @property
    def tests(self) -> int:
        """Number of road tests, with refused ones, without dropped ones."""
        return self.simulations + self.invalid

    @property
    def tests_per_second(self) -> float:
        """Road tests per second of wall time."""
        return self.tests / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Estimate from the spent share of the budget, in s; None while nothing is spent."""
        if self.budget_spent <= 0.0:
            return None
        return self.seconds * (1.0 - self.budget_spent) / self.budget_spent


@dataclass(frozen=True)
class Summary(Progress):
    """Summary of a finished campaign."""

    seed: int | None = None
    folder: Path = field(default_factory=Path)
    interrupted: bool = False
    """Whether it was stopped before its budget was spent."""
    ended: str = ""
    """Reason why the strategy ended before the budget was spent; empty if it did not."""

    def as_json(self) -> dict[str, JSONValue]:
        """The summary as one JSON object."""
        return {
            "simulations": self.simulations,
            "invalid": self.invalid,
            "passed": self.passed,
            "failed": self.failed,
            "errors": self.errors,
            "dropped": self.dropped,
            "min_moobd": self.min_moobd,
            "seconds": round(self.seconds, 3),
            "tests_per_second": round(self.tests_per_second, 1),
            "seed": self.seed,
            "interrupted": self.interrupted,
            "ended": self.ended,
            "folder": str(self.folder),
        }


class Tally:
    """Counts the results of a campaign as they come."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(Outcome, 0)
        self.told = 0
        """Number of told results, including dropped candidates."""
        self.min_moobd: float | None = None
        self.seconds = 0.0
        """Time spent before this process, in s."""
        self.budget_spent = 0.0
        self.strategy_seconds = 0.0
        """Time that the strategy took to propose and to learn, in s."""
        self.ended = ""
        """Reason why the strategy proposes nothing more; empty while it does."""

    @property
    def simulations(self) -> int:
        """Number of drives, including broken ones."""
        return self.told - self.counts[Outcome.INVALID] - self.counts[Outcome.DROPPED]

    @property
    def failures(self) -> int:
        """FAIL outcomes."""
        return self.counts[Outcome.FAIL]

    def count(self, outcome: Outcome, moobd: float | None) -> None:
        """Counts one more result."""
        self.counts[outcome] += 1
        self.told += 1
        if moobd is not None:
            self.min_moobd = moobd if self.min_moobd is None else min(self.min_moobd, moobd)

    def progress(self, seconds: float) -> Progress:
        """The progress ``seconds`` after the start."""
        return Progress(
            invalid=self.counts[Outcome.INVALID],
            passed=self.counts[Outcome.PASS],
            failed=self.counts[Outcome.FAIL],
            errors=self.counts[Outcome.ERROR],
            dropped=self.counts[Outcome.DROPPED],
            min_moobd=self.min_moobd,
            seconds=seconds,
            budget_spent=self.budget_spent,
        )
