"""Progress and summary of a campaign."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from frenetic.campaign.counts import Counts, key_of
from frenetic.campaign.objective import Objective
from frenetic.campaign.screening import ScreeningSummary
from frenetic.campaign.store import JSONValue
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate, Evaluation
from frenetic.spec import Budget


@dataclass(frozen=True)
class Progress(Counts):
    """Progress of a campaign."""

    seconds: float = 0.0
    """Wall time since the start, in s."""
    budget_spent: float = 0.0
    """0..1."""
    objective: str = ""
    """Name of what is minimised; empty if it is the MOOBD, or before the first drive."""
    best: float | None = None
    """Its best value so far, the worst for the driver."""

    @property
    def best_in_words(self) -> str:
        """The best value of the objective, to follow the lowest MOOBD: ``, best oob-share 0.9``."""
        return "" if self.best is None else f", best {self.objective} {self.best:.3g}"

    @property
    def objective_json(self) -> dict[str, Any]:
        """The objective and its best value for JSON; empty if it is the MOOBD."""
        return {} if self.best is None else {"objective": self.objective, "best": self.best}

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
    screening: ScreeningSummary | None = None
    """What screening came to, None without."""

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
            **({} if self.screening is None else {"screening": self.screening.as_json()}),
            "folder": str(self.folder),
            **self.objective_json,
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
        self.told_share: float | None = None
        """Spent share of the budget that whoever drives told last; None if nobody did."""
        self.strategy_seconds = 0.0
        """Time that the strategy took to propose and to learn, in s."""
        self.ended = ""
        """Reason why the strategy proposes nothing more; empty while it does."""
        self.notice = ""
        """What the strategy has to say about its search."""
        self.objective = ""
        """Name of what is minimised, if it is not the MOOBD and has a value."""
        self.best: float | None = None
        """Its best value."""

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

    def spend(self, budget: Budget, seconds: float, told: float | None = None) -> None:
        """Sets the spent share of the budget: what is told now or was last, or else its count."""
        self.told_share = self.told_share if told is None else told
        counted = budget.spent(self.simulations, seconds, self.failures)
        self.budget_spent = counted if self.told_share is None else self.told_share

    def measure(self, objective: Objective, evaluation: Evaluation) -> None:
        """Notes the objective's value of one more result, if it has one."""
        value = objective.value_of(evaluation)
        if value is not None:
            self.objective = objective.name
            self.best = value if self.best is None else objective.worse(value, self.best)

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
            objective=self.objective,
            best=self.best,
        )
