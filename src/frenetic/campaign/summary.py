"""The summary of a campaign, and the events that carry it to callers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, Self, TypeAlias

from frenetic._support.json_value import JSONValue
from frenetic._support.words import lane_words
from frenetic.campaign.counts import Counts, FirstTests
from frenetic.campaign.objective import Objective, worst_value
from frenetic.campaign.record import Test
from frenetic.road import LANE_WIDTH
from frenetic.search.records import Evaluation
from frenetic.spec import Budget

EventKind: TypeAlias = Literal["started", "result", "interrupted", "complete"]
SLOW: Final = 0.8
"""Least share of the tests' time in the driver's own code that is worth a line (ours)."""


@dataclass
class Summary(Counts):
    """Summary of a campaign, so far or as it ended."""

    seconds: float = 0.0
    """Wall time since the start, in s."""
    budget_spent: float = 0.0
    """Spent share of the budget, 0..1."""
    reported_share: float | None = None
    """Spent share as a client reported it last; None without such a report."""
    lane_width: float = LANE_WIDTH
    """Width of each lane, in m."""
    objective: str = ""
    """Name of the objective; empty for the MOOBD, or before the first drive."""
    worst: float | None = None
    """The objective's worst value for the driver so far."""
    strategy_seconds: float = 0.0
    """Time that the strategy took to propose and to learn, in s."""
    drive_seconds: float = 0.0
    """Time of all tests, in s; parallel tests add up."""
    driver_seconds: float = 0.0
    """Time of the tests in the driver's own code, in s."""
    seed: int | None = None
    folder: Path = field(default_factory=Path)
    interrupted: bool = False
    """Whether it was stopped before its budget was spent."""
    ended: str = ""
    """Reason why the strategy ended before the budget was spent; empty if it did not."""
    notice: str = ""
    """The strategy's notice that the search is not as its user expects; empty without one."""
    not_repeatable: str = ""
    """Why verdicts hold for single drives only, see `frenetic.campaign.second_drive`."""
    facts: Mapping[str, JSONValue] = field(default_factory=dict)
    """Facts of the strategy about its search, see `frenetic.Strategy.facts`."""

    @classmethod
    def over(cls, counts: Counts, **more: Any) -> Self:
        """Return the summary with these counts."""
        return cls(**asdict(counts), **more)

    def now(self, seconds: float) -> Self:
        """Return a copy for callers, `seconds` s after the start."""
        copied = copy(self)
        copied.seconds, copied._keys, copied._first = seconds, set(), FirstTests()
        return copied

    def spend(self, budget: Budget, seconds: float, share: float | None = None) -> None:
        """Set the spent share of the budget.

        Args:
            budget: of the campaign.
            seconds: time of the campaign so far.
            share: share that a client reports; None for its last report, or else our count.
        """
        self.reported_share = self.reported_share if share is None else share
        counted = budget.spent(self.simulations, seconds, self.failed)
        self.budget_spent = counted if self.reported_share is None else self.reported_share

    def measure(self, objective: Objective, evaluation: Evaluation) -> None:
        """Note the objective's value of a further result, if it has a value."""
        value = objective.value_of(evaluation)
        if value is not None:
            self.objective = objective.name
            self.worst = value if self.worst is None else objective.worse(value, self.worst)

    @property
    def worst_as_text(self) -> str:
        """The car's least distance to its lane's edge, and an objective's worst value, in words."""
        texts, least = [], self.min_moobd
        if least is not None:
            most = "at most" if least < 0.0 else "at least"
            texts.append(f"{most} {lane_words(least, self.lane_width)}")
        if self.worst is not None:
            texts.append(worst_value(self.objective, self.worst))
        return "".join(f", {text}" for text in texts)

    @property
    def slow_driver(self) -> str:
        """Sentence about a driver that takes most of the time; empty for others."""
        share = self.driver_seconds / self.drive_seconds if self.drive_seconds else 0.0
        return f"Your driver takes {100.0 * share:.0f} % of the time" if share >= SLOW else ""

    @property
    def objective_json(self) -> dict[str, Any]:
        """The objective and its worst value for JSON; empty for the MOOBD."""
        return {} if self.worst is None else {"objective": self.objective, "worst": self.worst}

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

    def as_json(self) -> dict[str, JSONValue]:
        """Return the summary as one JSON object."""
        return {
            **self.counts_json(),
            "seconds": round(self.seconds, 3),
            "tests_per_second": float(f"{self.tests_per_second:.3g}"),
            "seed": self.seed,
            "interrupted": self.interrupted,
            "ended": self.ended,
            "notice": self.notice,
            "not_repeatable": self.not_repeatable,
            "facts": dict(self.facts),
            "folder": str(self.folder),
            **self.objective_json,
        }


@dataclass
class Progress(Counts):
    """The part of a `Summary` that a campaign's process reports."""

    budget_spent: float = 0.0
    folder: str = ""

    @classmethod
    def of_summary(cls, summary: Summary) -> Self:
        """Return the progress in a summary."""
        counts = {item.name: getattr(summary, item.name) for item in fields(Counts)}
        return cls(**counts, budget_spent=summary.budget_spent, folder=str(summary.folder))

    def summary(self) -> Summary:
        """Return the summary with these counts."""
        return Summary(**asdict(self) | {"folder": Path(self.folder)})


def facts_text(facts: object) -> str:
    """Return a strategy's facts in a line; empty without facts."""
    items = facts.items() if isinstance(facts, Mapping) else ()
    texts = (
        f"{name} {value:.2f}" if isinstance(value, float) else f"{name} {value}"
        for name, value in items
    )
    return "; ".join(texts)


@dataclass(frozen=True)
class Event:
    """An event of a campaign while it runs."""

    kind: EventKind
    """``started``: the folder is made and the simulator has started, the budget's time begins;
    ``result``: a result was stored, in the order of results; ``interrupted``: Ctrl-C was
    pressed for the first time; ``complete``: no drive was missing, which only reruns, minimising,
    comparisons of versions and estimates say."""
    summary: Summary
    """The campaign so far."""
    read_test: Callable[[], Test] | None = field(default=None, repr=False, compare=False)
    """Source of `test`, which can be read until the call ends."""

    @cached_property
    def test(self) -> Test | None:
        """The test with this result, read on first use; None for other events."""
        return None if self.read_test is None else self.read_test()


EventListener: TypeAlias = Callable[[Event], object]
"""Function that a campaign calls with each `Event`."""
