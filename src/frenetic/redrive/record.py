"""Records of roads that were driven again, and of the runs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from frenetic._support.scalars import take_numpy_scalars
from frenetic.analysis.failures import THRESHOLD
from frenetic.analysis.segments import REACH
from frenetic.campaign.record import Test
from frenetic.campaign.store import JSONValue
from frenetic.drive import CarBody, Rules
from frenetic.oracle import Finding
from frenetic.outcome import Outcome
from frenetic.redrive.conditions import Variation
from frenetic.simulators.worlds import Conditions, read_conditions


class Purpose(StrEnum):
    """Purpose of driving roads again."""

    ROBUSTNESS = "robustness"
    """Whether failures repeat."""
    CONFIRMATION = "confirmation"
    """Whether failures are confirmed in another simulator."""
    REGRESSION = "regression"
    """Whether they are fixed."""
    BACK_TO_BACK = "back-to-back"
    """Whether a new version of the driver is better."""


class Match(StrEnum):
    """How a drive fails, beside the recorded failure of its road."""

    SAME = "same failure"
    """The same place, side and mechanism."""
    OTHER_MECHANISM = "other mechanism"
    """The same place and side, but road, offsets and speeds before it differ by more than
    `frenetic.analysis.failures.THRESHOLD`, or only one of both left its lane."""
    OTHER_SIDE = "other side"
    """The same place, but on the other side of the lane."""
    ELSEWHERE = "elsewhere"
    """More than `frenetic.analysis.segments.REACH` away along the road."""
    SAME_PLACE = "same place"
    """The same place and side; the mechanism is unknown, as a trajectory is missing."""


class Agreement(StrEnum):
    """Verdict of another simulator on a failure."""

    CONFIRMED = "confirmed"
    """The driver has the same failure there."""
    FAILING_OTHERWISE = "failing otherwise"
    """The driver fails there, too, but this is another failure, see `Match`."""
    NOT_CONFIRMED = "not confirmed"
    """The driver passes there."""
    NOT_JUDGED = "not judged"
    """The road is INVALID there, or the simulator or driver broke."""


class Change(StrEnum):
    """Change of a test."""

    FIXED = "fixed"
    """It failed and passes now."""
    STILL_FAILING = "still failing"
    NEWLY_FAILING = "newly failing"
    """It did not fail."""
    STILL_PASSING = "still passing"
    """It did not fail, nor does it now."""
    NOT_JUDGED = "not judged"
    """The road is INVALID now, or the simulator or driver broke."""

    @classmethod
    def of(cls, failed: bool, fails: bool) -> Change:
        """The change of a judged test.

        Args:
            failed: whether it failed before.
            fails: whether it fails now.
        """
        if fails:
            return cls.STILL_FAILING if failed else cls.NEWLY_FAILING
        return cls.FIXED if failed else cls.STILL_PASSING


@dataclass(frozen=True)
class Redrive:
    """A campaign's test, and its road driven again."""

    recorded: Test = field(compare=False)
    """The campaign's own test."""
    test: Test
    """The test of the campaign that drove it again; the campaign's own for its own drive."""
    difference: float | None = None
    """Difference from the recorded failure in m, as of `frenetic.analysis.failures`; None unless
    both failed."""

    @cached_property
    def conditions(self) -> Conditions:
        """The conditions of the drive."""
        return read_conditions(self.test.candidate.conditions)

    @property
    def outcome(self) -> Outcome:
        """Its outcome."""
        return self.test.outcome

    @property
    def moobd(self) -> float | None:
        """Minimum oob distance in m; None unless PASS or FAIL."""
        return self.test.moobd

    @property
    def reason(self) -> str:
        """Reason of the outcome, for people."""
        return self.test.reason

    @property
    def duration(self) -> float | None:
        """Simulated time, in s."""
        return self.test.result.duration

    @property
    def departure(self) -> Finding | None:
        """Place where the car left its lane; None if it did not."""
        return self.test.departure

    @property
    def test_id(self) -> int:
        """The test's id."""
        return self.recorded.id

    @property
    def trouble(self) -> str | None:
        """Reason why it could not be judged; None if it was."""
        return None if self.outcome.is_driven else self.reason

    @property
    def margin(self) -> float:
        """Distance to failing, in m: the MOOBD of a drive that passed; all failures are equal.

        The distance of a failing car from its lane depends more on its speed than on the road.
        """
        return -math.inf if self.outcome is Outcome.FAIL or self.moobd is None else self.moobd

    @property
    def match(self) -> Match | None:
        """How it fails, beside the campaign's own drive; None unless both fail."""
        before = self.recorded
        if not self.outcome is before.outcome is Outcome.FAIL:
            return None
        here, there = self.departure, before.departure
        if (here is None) != (there is None):
            return Match.OTHER_MECHANISM
        if here is not None and there is not None:
            if abs(here.distance - there.distance) > REACH:
                return Match.ELSEWHERE
            if here.side != there.side:
                return Match.OTHER_SIDE
        if self.difference is None:
            return Match.SAME_PLACE
        return Match.SAME if self.difference <= THRESHOLD else Match.OTHER_MECHANISM

    @property
    def is_alike(self) -> bool:
        """Whether it is the campaign's own failure, as far as that is known."""
        return self.match in (Match.SAME, Match.SAME_PLACE)

    @property
    def is_same(self) -> bool:
        """Whether outcome and MOOBD are exactly as before."""
        before = self.recorded
        return self.outcome is before.outcome and self.moobd == before.moobd

    @property
    def agreement(self) -> Agreement:
        """Verdict of this drive on a failure."""
        if not self.outcome.is_driven:
            return Agreement.NOT_JUDGED
        if self.outcome is not Outcome.FAIL:
            return Agreement.NOT_CONFIRMED
        return Agreement.CONFIRMED if self.is_alike else Agreement.FAILING_OTHERWISE

    @property
    def verdict(self) -> str:
        """The same in words, with how it fails otherwise."""
        text = str(self.agreement)
        is_otherwise = self.agreement is Agreement.FAILING_OTHERWISE
        return f"{text}, {self.match}" if is_otherwise else text

    @property
    def change(self) -> Change:
        """Change of the test."""
        if not self.outcome.is_driven:
            return Change.NOT_JUDGED
        return Change.of(self.recorded.outcome is Outcome.FAIL, self.outcome is Outcome.FAIL)

    # The same under the names of confirmations and replays

    @property
    def other(self) -> Redrive:
        """This drive, beside `recorded`."""
        return self

    @property
    def before(self) -> Outcome:
        """The recorded outcome."""
        return self.recorded.outcome

    @property
    def moobd_before(self) -> float | None:
        """The recorded MOOBD in m."""
        return self.recorded.moobd

    @property
    def after(self) -> Outcome:
        """The outcome now."""
        return self.outcome

    @property
    def moobd_after(self) -> float | None:
        """The MOOBD now, in m."""
        return self.moobd

    @property
    def length(self) -> float:
        """Length of the road in m."""
        candidate = self.recorded.candidate
        return (len(candidate.curvatures) - 1) * candidate.step


@dataclass(frozen=True)
class Run:
    """A run of driving roads again, with the same parts."""

    purpose: Purpose
    driver: Mapping[str, JSONValue]
    """The driver as a campaign describes it, like the simulator."""
    simulator: Mapping[str, JSONValue]
    rules: Rules | None = None
    """Rules, None if unknown, like the car."""
    car: CarBody | None = None
    planned: int = 0
    """Number of planned drives; Ctrl-C leaves fewer."""
    seed: int | None = None
    """Ranges of the drawn conditions, if any."""
    variations: tuple[Variation, ...] = ()
    drives: tuple[Redrive, ...] = ()
    """Drives in the planned order."""
    folder: Path | None = None
    """Folder of the campaign that drove them; None if there was nothing to drive."""

    def __post_init__(self) -> None:
        take_numpy_scalars(self)


def count_matches(drives: Iterable[Redrive]) -> dict[Match, int]:
    """Match -> number of drives that fail so, without those that are 0."""
    counts = Counter(drive.match for drive in drives)
    return {match: counts[match] for match in Match if counts[match]}


def matches_text(drives: Iterable[Redrive]) -> str:
    """Kinds of failing drives with their numbers: ``2 same failure, 8 elsewhere``."""
    return ", ".join(f"{number} {match}" for match, number in count_matches(drives).items())


def matches_document(drives: Iterable[Redrive]) -> dict[str, JSONValue]:
    """The same as a JSON object, with all kinds."""
    counts = count_matches(drives)
    return {str(match): counts.get(match, 0) for match in Match}


def verdict_document(drive: Redrive | Test) -> dict[str, JSONValue]:
    """The end of a drive as a JSON object."""
    place = drive.departure
    return {
        "outcome": str(drive.outcome),
        "moobd": drive.moobd,
        "departure_distance": None if place is None else place.distance,
        "departure_side": None if place is None else place.side,
    }


def redrive_document(drive: Redrive) -> dict[str, JSONValue]:
    """The same of a drive made again, with how it fails."""
    return {**verdict_document(drive), "match": drive.match, "difference": drive.difference}
