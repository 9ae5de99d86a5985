"""Progress and summary of a campaign."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from frenetic.campaign.counts import Counts, key_of
from frenetic.campaign.store import JSONValue
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate


@dataclass(frozen=True)
class Progress(Counts):
    """Progress of a campaign."""

    seconds: float = 0.0
    """Wall time since the start, in s."""
    budget_spent: float = 0.0
    """0..1."""

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
    notice: str = ""
    """Why the search was not what its user expects, as the strategy says; empty if it was."""

    def as_json(self) -> dict[str, JSONValue]:
        """The summary as one JSON object."""
        return {
            **self.counts_json(),
            "seconds": round(self.seconds, 3),
            "tests_per_second": round(self.tests_per_second, 1),
            "seed": self.seed,
            "interrupted": self.interrupted,
            "ended": self.ended,
            "notice": self.notice,
            "folder": str(self.folder),
        }


class Tally:
    """Counts the results of a campaign as they come."""

    def __init__(self) -> None:
        self._by_outcome = dict.fromkeys(Outcome, 0)
        self._roads: set[int] = set()
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
        self.notice = ""
        """What the strategy has to say about its search."""

    @property
    def simulations(self) -> int:
        """Number of drives, including broken ones."""
        return self.told - self._by_outcome[Outcome.INVALID] - self._by_outcome[Outcome.DROPPED]

    @property
    def failures(self) -> int:
        """FAIL outcomes."""
        return self._by_outcome[Outcome.FAIL]

    def count(self, candidate: Candidate, outcome: Outcome, moobd: float | None) -> None:
        """Counts one more result."""
        self._by_outcome[outcome] += 1
        self.told += 1
        if outcome.is_test:
            self._roads.add(key_of(candidate))
        if moobd is not None:
            self.min_moobd = moobd if self.min_moobd is None else min(self.min_moobd, moobd)

    def counts(self) -> Counts:
        """The counts so far."""
        return Counts.of(self._by_outcome, self.min_moobd, len(self._roads))

    def progress(self, seconds: float) -> Progress:
        """The progress ``seconds`` after the start."""
        return Progress.of(
            self._by_outcome,
            self.min_moobd,
            len(self._roads),
            seconds=seconds,
            budget_spent=self.budget_spent,
        )
