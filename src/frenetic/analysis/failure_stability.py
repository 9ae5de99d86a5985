"""Stability of failures: how many fail again with hardly other grip, and keep their cause.

`frenetic.rerun.stability_study` drives failures again: as they were stored, with `GRIP_CHANGE` less
friction and with `GRIP_CHANGE` more. A failure that passes with so little more grip lies at the
very limit. A cause that changes with so little grip says little about the driver.

Causes are compared without the side of their bends, as the table of causes shows them. A campaign
keeps the counts of its largest study as its fact `STABILITY`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, TypeAlias

from msgspec import ValidationError, convert

from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted
from frenetic.analysis.failures import Failure
from frenetic.analysis.statistics import Share
from frenetic.campaign.record import Test
from frenetic.errors import CampaignError, Fault
from frenetic.oracle.outcome import Outcome
from frenetic.segments.causes import Cause, as_text

STABILITY: Final = "stability"
"""Name of the fact with the counts of a campaign's largest study, a `FailureStability`."""
GRIP_CHANGE: Final = 0.02
"""Change of the friction, as a share of a test's own (our choice)."""

CauseOrFault: TypeAlias = Cause | Fault
"""Cause of a failure without the side of the bends, or the fault that ended the drive."""


class Grip(StrEnum):
    """Grip of a further drive of a failing road."""

    AGAIN = "driven again"
    """The friction is the test's own, as it was stored."""
    LESS = f"with {100.0 * GRIP_CHANGE:g} % less grip"
    MORE = f"with {100.0 * GRIP_CHANGE:g} % more grip"

    @property
    def factor(self) -> float:
        """Factor of the test's friction."""
        return {Grip.AGAIN: 1.0, Grip.LESS: 1.0 - GRIP_CHANGE, Grip.MORE: 1.0 + GRIP_CHANGE}[self]


def cause_without_side(test: Test) -> CauseOrFault | None:
    """Return the cause of a failed test; None if the test did not fail or the cause is unknown.

    The test was read with the values of its segment or with its trajectory.
    """
    failure = Failure.of_test(test)
    if failure is None or failure.cause is None:
        return None if failure is None else failure.fault
    return failure.cause._replace(bend_side=None)


@dataclass(frozen=True)
class FurtherDrive:
    """Further drive of a failing road, in one grip."""

    outcome: Outcome
    cause: CauseOrFault | None
    """Cause of the failure; None if the drive did not fail."""


@dataclass(frozen=True)
class StudiedFailure:
    """Failure of a campaign with its further drives."""

    id: int
    """Id of the test."""
    cause: CauseOrFault | None
    """Recorded cause; None if it is unknown, for example without a trajectory."""
    drives: Mapping[Grip, FurtherDrive]
    """Further drive in each grip; an interrupted study may lack some."""

    def passes(self, grip: Grip) -> bool:
        """Return whether the road passes in a grip."""
        return grip in self.drives and self.drives[grip].outcome is Outcome.PASS

    def keeps_cause(self, grips: Iterable[Grip] = tuple(Grip)) -> bool | None:
        """Return whether each drive that fails has the recorded cause.

        Args:
            grips: grips whose drives count.

        Returns:
            None if no drive fails, or the recorded cause is unknown.
        """
        drives = [self.drives[grip] for grip in grips if grip in self.drives]
        failing = [drive for drive in drives if drive.outcome is Outcome.FAIL]
        if not failing or self.cause is None:
            return None
        return all(drive.cause == self.cause for drive in failing)


@dataclass(frozen=True)
class GripCounts:
    """Counts of the further drives in one grip."""

    judged: int
    """Number of drives that passed or failed."""
    failed: int
    """Number of drives that failed."""
    compared: int
    """Number of drives that failed, and whose recorded cause is known."""
    same_cause: int
    """Number of drives with the recorded cause."""

    @classmethod
    def of(cls, failures: Sequence[StudiedFailure], grip: Grip) -> GripCounts:
        """Return the counts of the drives in a grip."""
        outcomes = [failure.drives[grip].outcome for failure in failures if grip in failure.drives]
        keeping = [failure.keeps_cause([grip]) for failure in failures]
        return cls(
            judged=sum(outcome.is_driven for outcome in outcomes),
            failed=sum(outcome is Outcome.FAIL for outcome in outcomes),
            compared=sum(keeps is not None for keeps in keeping),
            same_cause=sum(keeps is True for keeps in keeping),
        )

    @property
    def fails(self) -> Share:
        """Share of the judged drives that failed."""
        return Share(self.failed, self.judged)

    @property
    def keeps_cause(self) -> Share:
        """Share of the failing drives with the recorded cause."""
        return Share(self.same_cause, self.compared)

    def as_json(self) -> dict[str, JSONValue]:
        """Return both shares as a JSON object."""
        return {"fails": self.fails.as_json(), "keeps_cause": self.keeps_cause.as_json()}


@dataclass(frozen=True)
class StabilityCounts:
    """Counts of the further drives of some failures, such as all failures with one cause."""

    cause: str
    """Recorded cause in words; empty for failures with any cause."""
    failures: int
    """Number of failures that were driven again."""
    again: GripCounts
    """Counts of the drives in the tests' own grip."""
    less_grip: GripCounts
    """Counts of the drives with less grip."""
    more_grip: GripCounts
    """Counts of the drives with more grip."""
    compared: int
    """Number of failures with a known cause, of which at least one further drive fails."""
    same_cause: int
    """Number of failures of which each further drive that fails has the recorded cause."""

    @classmethod
    def of(cls, failures: Sequence[StudiedFailure], cause: str = "") -> StabilityCounts:
        """Return the counts of some failures, with their cause in words."""
        keeping = [failure.keeps_cause() for failure in failures]
        return cls(
            cause=cause,
            failures=len(failures),
            again=GripCounts.of(failures, Grip.AGAIN),
            less_grip=GripCounts.of(failures, Grip.LESS),
            more_grip=GripCounts.of(failures, Grip.MORE),
            compared=sum(keeps is not None for keeps in keeping),
            same_cause=sum(keeps is True for keeps in keeping),
        )

    def at(self, grip: Grip) -> GripCounts:
        """Return the counts of the drives in a grip."""
        return {Grip.AGAIN: self.again, Grip.LESS: self.less_grip, Grip.MORE: self.more_grip}[grip]

    @property
    def passes_with_more_grip(self) -> Share:
        """Share of the failures that pass with more grip."""
        counts = self.more_grip
        return Share(counts.judged - counts.failed, counts.judged)

    @property
    def keeps_cause(self) -> Share:
        """Share of the failures that keep their cause in every further drive that fails."""
        return Share(self.same_cause, self.compared)

    def as_json(self) -> dict[str, JSONValue]:
        """Return the shares as a JSON object."""
        return {
            "cause": self.cause,
            "failures": self.failures,
            "again": self.again.as_json(),
            "less_grip": self.less_grip.as_json(),
            "more_grip": self.more_grip.as_json(),
            "passes_with_more_grip": self.passes_with_more_grip.as_json(),
            "keeps_cause": self.keeps_cause.as_json(),
        }


@dataclass(frozen=True)
class FailureStability:
    """Stability of a campaign's failures."""

    total: StabilityCounts
    """Counts of all studied failures."""
    causes: tuple[StabilityCounts, ...]
    """Counts by cause, the most frequent cause first; failures without a known cause lack."""

    @classmethod
    def of(cls, failures: Sequence[StudiedFailure]) -> FailureStability:
        """Return the stability of studied failures."""
        groups: dict[CauseOrFault, list[StudiedFailure]] = {}
        for failure in failures:
            if failure.cause is not None:
                groups.setdefault(failure.cause, []).append(failure)
        by_size = sorted(groups.items(), key=lambda group: -len(group[1]))
        return cls(
            StabilityCounts.of(failures),
            tuple(StabilityCounts.of(members, _words(cause)) for cause, members in by_size),
        )

    @classmethod
    def read(cls, facts: Mapping[str, Any]) -> FailureStability | None:
        """Return the stability among a campaign's facts; None if it was not studied.

        Raises:
            CampaignError: the fact is damaged.
        """
        if (fact := facts.get(STABILITY)) is None:
            return None
        try:
            return convert(fact, cls)
        except ValidationError as error:
            raise CampaignError(
                f"the fact {STABILITY} is damaged: {error}; repeat 'frenetic rerun --stability'"
            ) from None

    def as_text(self) -> str:
        """Return the stability in a line; empty without a judged drive."""
        total, texts = self.total, []
        counts = [total.at(grip) for grip in Grip]
        judged = sum(drives.judged for drives in counts)
        if not judged:
            return ""
        if passing := total.again.judged - total.again.failed:
            texts.append(f"{_passing(passing)} when {Grip.AGAIN}")
        texts.append(f"{_passing(total.passes_with_more_grip.count)} {Grip.MORE}")
        text = f"of {counted(total.failures, 'failure')}, {', '.join(texts)}"
        if (keeping := total.keeps_cause.value) is not None:
            text += f"; {100.0 * keeping:.0f} % keep their cause"
        if unjudged := len(Grip) * total.failures - judged:
            text += f"; {counted(unjudged, 'drive')} could not be judged"
        return text

    def as_json(self) -> dict[str, JSONValue]:
        """Return the shares of all failures and by cause as a JSON object."""
        return {**self.total.as_json(), "causes": [cause.as_json() for cause in self.causes]}


def _passing(number: int) -> str:
    """Return a number of passing roads with the verb."""
    return f"{number} {'passes' if number == 1 else 'pass'}"


def _words(cause: CauseOrFault) -> str:
    """Return a cause or a fault in words."""
    return str(cause) if isinstance(cause, Fault) else as_text(*cause)
