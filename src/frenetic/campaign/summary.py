"""The summary of a campaign, and the events that carry it to callers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal, Self, TypeAlias

from frenetic._support.json_value import JSONValue
from frenetic._support.words import lane_words
from frenetic.campaign.counts import Counts
from frenetic.campaign.objective import Objective
from frenetic.campaign.objective_values import worst_value_text
from frenetic.campaign.record import Test
from frenetic.road import LANE_WIDTH
from frenetic.search.records import Evaluation
from frenetic.spec import Budget

EventKind: TypeAlias = Literal["started", "result", "interrupted", "complete"]
SLOW_DRIVER_SHARE: Final = 0.8
"""Share of the tests' time in the driver's code above which the driver is slow (our choice)."""


@dataclass
class Summary(Counts):
    """What a campaign has found, so far or when it ended.

    The *MOOBD* (minimum out-of-bounds distance) of a drive is the least distance of the car's
    centre from the edge of its lane, in m. It is positive inside the lane and negative outside.
    """

    seconds: float = 0.0
    """Wall time since the start, in s."""
    budget_spent: float = 0.0
    """Spent share of the budget, from 0 to 1: the `reported_share`, or without a report the share
    that the campaign counts."""
    reported_share: float | None = None
    """Last report of a program that drives the roads itself, by ask-tell, on the spent share of the
    budget; None without a report. The program may know costs that the campaign cannot count."""
    lane_width: float = LANE_WIDTH
    """Width of each lane, in m."""
    objective: str = ""
    """Name of the objective; empty before the first drive, and if the search minimises the
    MOOBD."""
    worst: float | None = None
    """Worst value of the objective for the driver so far; None while `objective` is empty."""
    strategy_seconds: float = 0.0
    """Time that the strategy took to propose and to learn, in s."""
    drive_seconds: float = 0.0
    """Time of all tests, in s; the times of parallel tests are added."""
    driver_seconds: float = 0.0
    """Part of `drive_seconds` in the driver's code, in s."""
    seed: int | None = None
    """Seed of the strategy; None if it has none."""
    folder: Path = field(default_factory=Path)
    """The campaign's folder."""
    interrupted: bool = False
    """Whether the campaign was stopped before its budget was spent."""
    ended: str = ""
    """Reason why the strategy ended before the budget was spent; empty if it did not."""
    notice: str = ""
    """The strategy's notice that the search does not go as its user expects; empty if it does."""
    not_repeatable: str = ""
    """Why a verdict holds only for the drive that it judges, see `frenetic.campaign.second_drive`;
    empty if drives repeat, as far as known."""
    facts: Mapping[str, JSONValue] = field(default_factory=dict)
    """Facts of the strategy about its search, see `frenetic.Strategy.facts`."""

    @classmethod
    def from_counts(
        cls,
        counts: Counts,
        *,
        folder: Path,
        budget_spent: float,
        seconds: float = 0.0,
        lane_width: float = LANE_WIDTH,
    ) -> Self:
        """Return the summary of stored counts; without `seconds` its rate of tests is 0."""
        return cls(
            **counts.numbers(),
            folder=folder,
            budget_spent=budget_spent,
            seconds=seconds,
            lane_width=lane_width,
        )

    def snapshot(self, seconds: float) -> Self:
        """Return a copy for callers, which stays as it is when this summary changes.

        The copy does not know which roads are counted, so its `add` raises.

        Args:
            seconds: wall time since the start, in s.
        """
        snapshot = object.__new__(type(self))  # quicker than by the constructor
        vars(snapshot).update(vars(self))
        snapshot.forget_roads()
        snapshot.seconds = seconds
        return snapshot

    def update_budget_spent(
        self, budget: Budget, seconds: float, reported_share: float | None = None
    ) -> None:
        """Set the spent share of the budget: the last report, or else what the campaign counts.

        Args:
            budget: budget of the campaign.
            seconds: time of the campaign so far, in s.
            reported_share: share that came with a result, see the field; None without a report.
        """
        if reported_share is not None:
            self.reported_share = reported_share
        counted_share = budget.spent(self.amounts(seconds))
        self.budget_spent = counted_share if self.reported_share is None else self.reported_share

    def note_objective(self, objective: Objective, evaluation: Evaluation) -> None:
        """Note the objective's value of a result if it is the worst so far; it may have none."""
        value = objective.value_of(evaluation)
        if value is not None:
            self.objective = objective.name
            self.worst = value if self.worst is None else objective.worse(value, self.worst)

    def worst_as_text(self) -> str:
        """Return the lowest MOOBD and the objective's worst value, to be added to a sentence.

        Each value begins with a comma: ``, at most 0.52 m outside its lane``. Empty before a drive.
        """
        texts = []
        if self.min_moobd is not None:
            # The most that a car was outside its lane, or the least that each car stayed inside.
            bound = "at most" if self.min_moobd < 0.0 else "at least"
            texts.append(f"{bound} {lane_words(self.min_moobd, self.lane_width)}")
        if self.worst is not None:
            texts.append(worst_value_text(self.objective, self.worst))
        return "".join(f", {text}" for text in texts)

    def slow_driver_text(self) -> str:
        """Return a sentence about a driver that takes most of the time; empty for other drivers."""
        share = self.driver_seconds / self.drive_seconds if self.drive_seconds else 0.0
        if share < SLOW_DRIVER_SHARE:
            return ""
        return f"Your driver takes {100.0 * share:.0f} % of the time"

    def objective_json(self) -> dict[str, Any]:
        """Return objective and worst value for JSON; empty if the search minimises the MOOBD."""
        return {} if self.worst is None else {"objective": self.objective, "worst": self.worst}

    @property
    def tests_per_second(self) -> float:
        """Road tests per second of wall time."""
        return self.tests / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Time left by the spent share of the budget, in s; None while nothing is spent."""
        if self.budget_spent <= 0.0:
            return None
        return self.seconds * (1.0 - self.budget_spent) / self.budget_spent

    def as_json(self) -> dict[str, JSONValue]:
        """Return the summary as one JSON object.

        Left out are the spent budget, which serves the display of progress, and the parts of the
        time, which serve `slow_driver_text` and the campaign's records.
        """
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
            **self.objective_json(),
        }


@dataclass
class Progress(Counts):
    """The part of a `Summary` that a process which runs a campaign sends to its parent."""

    budget_spent: float = 0.0
    """Spent share of the budget, from 0 to 1."""
    folder: str = ""
    """The campaign's folder."""

    @classmethod
    def of_summary(cls, summary: Summary) -> Self:
        """Return the progress in a summary."""
        folder = str(summary.folder)
        return cls(**summary.numbers(), budget_spent=summary.budget_spent, folder=folder)

    def summary(self) -> Summary:
        """Return a summary with this progress alone."""
        return Summary(**asdict(self) | {"folder": Path(self.folder)})


def facts_text(facts: object) -> str:
    """Return a strategy's facts in a line, ``cells 40; spread 0.31``; empty without facts.

    Args:
        facts: facts from a summary or a campaign's store. A store may have none yet, or any JSON
            value in their place; such a value gives no text, so that the campaign stays readable.
    """
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
    """``started``: the folder is made, the simulator has started, and the budget's time begins.
    ``result``: a result was stored; results come in their order. ``interrupted``: Ctrl-C was
    pressed for the first time. ``complete``: an earlier run had stored every drive, so none was
    made; only reruns, minimising, comparisons of versions and estimates send it."""
    summary: Summary
    """The campaign so far."""
    read_test: Callable[[], Test] | None = field(default=None, repr=False, compare=False)
    """Function that reads `test`, during the listener's call only; None without a result."""

    @cached_property
    def test(self) -> Test | None:
        """The test with this result, read on first use; None without a result."""
        return None if self.read_test is None else self.read_test()


EventListener: TypeAlias = Callable[[Event], object]
"""Function that a campaign calls with each `Event`."""
