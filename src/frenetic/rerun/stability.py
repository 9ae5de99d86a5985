"""Verdicts on reruns: whether a recorded failure changed, and whether it is stable.

All verdicts follow from pairs of tests on the same road: the recorded test of a campaign, and a
later drive, possibly with another driver, in another simulator or in other conditions.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Final

from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted, rounded_seconds
from frenetic.analysis.statistics import SIGNIFICANT, holm, proportion_interval, spearman
from frenetic.campaign.record import Test
from frenetic.campaign.second_drive import Match
from frenetic.conditions.condition import condition_named, without
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.variations import Variation
from frenetic.simulators.conditions import Conditions

ROBUST_SHARE: Final = 0.5
"""Share of drives with the same failure from which on the failure is robust; our choice."""
MIN_INFLUENCE_DRIVES: Final = 8
"""Fewest judged drives for a verdict on which conditions matter; our choice."""


class Change(StrEnum):
    """Change of a test's outcome from the recorded drive to the rerun."""

    FAILS_AGAIN = "fails again"
    PASSES_NOW = "passes now"
    """The recorded drive failed."""
    FAILS_NOW = "fails now"
    """The recorded drive passed."""
    PASSES_AGAIN = "passes again"
    NOT_JUDGED = "not judged"
    """The road is INVALID now, or the simulator broke."""

    def counted(self, number: int) -> str:
        """Return the change of several tests in words: ``1 fails again``, ``3 fail again``."""
        text = str(self) if number == 1 else self.replace("fails", "fail").replace("passes", "pass")
        return f"{number} {text}"

    @classmethod
    def of(cls, failed: bool, fails: bool) -> Change:
        """Return the change of a judged test.

        Args:
            failed: whether the recorded drive failed.
            fails: whether the rerun fails.
        """
        if fails:
            return cls.FAILS_AGAIN if failed else cls.FAILS_NOW
        return cls.PASSES_NOW if failed else cls.PASSES_AGAIN


class Stability(StrEnum):
    """Stability of a failure, by the share of other drives with the same failure.

    With the same parts in the same conditions, all drives should have the failure. In varied
    conditions or with other parts, the 95 % interval of the share is compared with `ROBUST_SHARE`.
    """

    REPEATABLE = "repeatable"
    """All drives with the same parts in the same conditions have the failure."""
    NOT_REPEATABLE = "not repeatable"
    """Some of these drives lack the failure, because driver or simulator is not repeatable."""
    ROBUST = "robust"
    """The interval is above `ROBUST_SHARE`."""
    UNCLEAR = "unclear"
    """The interval includes `ROBUST_SHARE`; more drives would decide."""
    FRAGILE = "fragile"
    """The interval is below `ROBUST_SHARE`."""


@dataclass(frozen=True)
class Repeat:
    """Another drive on the road of a campaign's test, compared with the recorded drive."""

    recorded: Test = field(compare=False)
    """Recorded test of the campaign."""
    test: Test
    """Test of the campaign that drove the road again; the recorded test for its own drive."""
    difference: float | None = None
    """Difference between the two failures in m, see `frenetic.analysis.failures`; None unless both
    drives failed."""

    @property
    def conditions(self) -> Conditions:
        """Conditions of the drive."""
        return self.test.candidate.conditions

    @property
    def outcome(self) -> Outcome:
        """Outcome of the drive."""
        return self.test.outcome

    @property
    def moobd(self) -> float | None:
        """Minimum oob distance in m; None unless the outcome is PASS or FAIL."""
        return self.test.moobd

    @property
    def reason(self) -> str:
        """Reason of the outcome, for people."""
        return self.test.reason

    @property
    def duration(self) -> float | None:
        """Simulated time of the drive, in s; None if it was not driven."""
        return self.test.result.duration

    @property
    def margin(self) -> float:
        """Distance to failing in m, for ranking drives: the MOOBD if it passed, else -inf.

        All failures are equal, because the distance of a failing car from its lane depends more on
        its speed than on the road.
        """
        return -math.inf if self.outcome is Outcome.FAIL or self.moobd is None else self.moobd

    @property
    def match(self) -> Match | None:
        """Match of the drive's failure with the recorded one; None unless both fail."""
        return Match.of(self.recorded, self.test, self.difference)

    @property
    def is_alike(self) -> bool:
        """Whether the drive is known to have the recorded failure."""
        return self.match is not None and self.match.is_alike

    @property
    def is_same(self) -> bool:
        """Whether outcome and MOOBD are exactly the recorded ones."""
        return self.outcome is self.recorded.outcome and self.moobd == self.recorded.moobd


@dataclass(frozen=True)
class Influence:
    """Influence of a varied condition on the drives."""

    condition: str
    """Name of the condition."""
    spearman: float
    """Rank correlation of the amount with `Repeat.margin`, -1..1: negative if more is worse."""
    p: float
    """p-value of the correlation, corrected by Holm's method for the number of conditions."""

    @property
    def matters(self) -> bool:
        """Whether the correlation is more than chance."""
        return self.p < SIGNIFICANT

    def __str__(self) -> str:
        condition = condition_named(self.condition)
        worse = condition.less if self.spearman > 0.0 else condition.more
        return f"{worse} is worse (Spearman {self.spearman:.2f})"


@dataclass(frozen=True)
class Repeats:
    """All repeats of a campaign's test in a rerun."""

    recorded: Test = field(compare=False)
    """Recorded test of the campaign."""
    drives: tuple[Repeat, ...]
    """The drives, in order; at least one."""
    variations: tuple[Variation, ...] = ()
    """Varied conditions with their ranges."""
    is_own: bool = True
    """Whether driver, simulator, rules and all but the varied conditions are the campaign's."""

    @property
    def id(self) -> int:
        """Id of the recorded test."""
        return self.recorded.id

    @property
    def conditions(self) -> Conditions:
        """Conditions that all drives share: without the varied ones."""
        varied = (variation.condition for variation in self.variations)
        return without(self.drives[0].conditions, *varied)

    @property
    def failed(self) -> int:
        """Number of drives that failed."""
        return sum(drive.outcome is Outcome.FAIL for drive in self.drives)

    @property
    def judged(self) -> int:
        """Number of drives that passed or failed."""
        return sum(drive.outcome.is_driven for drive in self.drives)

    @property
    def alike(self) -> int:
        """Number of drives that have the recorded failure, see `Repeat.is_alike`."""
        return sum(drive.is_alike for drive in self.drives)

    @property
    def share(self) -> float | None:
        """Share 0..1 of the judged drives with the recorded failure; None without judged drives."""
        return self.alike / self.judged if self.judged else None

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the share; 0..1 if no drive was judged."""
        return proportion_interval(self.alike, self.judged) if self.judged else (0.0, 1.0)

    @property
    def change(self) -> Change:
        """Change of the outcome: to FAIL if any drive fails, to PASS only if all drives pass."""
        if self.judged < len(self.drives) and not self.failed:
            return Change.NOT_JUDGED
        return Change.of(self.recorded.outcome is Outcome.FAIL, self.failed > 0)

    @property
    def verdict(self) -> str:
        """Change in words, with the matches of the failures, as ``fails again, same failure``."""
        matches = list(dict.fromkeys(drive.match for drive in self.drives if drive.match))
        return ", ".join([str(self.change), *map(str, matches)])

    @property
    def stability(self) -> Stability | None:
        """Stability of the recorded failure.

        None if the recorded drive did not fail, or fewer than two drives were judged.
        """
        if self.recorded.outcome is not Outcome.FAIL or self.judged < 2:
            return None
        if self.is_own and not self.variations:
            always_alike = self.alike == self.judged
            return Stability.REPEATABLE if always_alike else Stability.NOT_REPEATABLE
        low, high = self.interval
        if low >= ROBUST_SHARE:
            return Stability.ROBUST
        return Stability.FRAGILE if high < ROBUST_SHARE else Stability.UNCLEAR

    @property
    def variations_text(self) -> str:
        """Ranges of the varied conditions in words."""
        return ", ".join(map(str, self.variations)) or "nothing varied"

    @cached_property
    def influences(self) -> tuple[Influence, ...]:
        """Influences of the varied conditions, the strongest first.

        Empty if fewer than `MIN_INFLUENCE_DRIVES` drives were judged, or all have the same margin.
        """
        judged = [drive for drive in self.drives if drive.outcome.is_driven]
        margins = [drive.margin for drive in judged]
        names = [variation.condition for variation in self.variations if not variation.is_fixed]
        if len(judged) < MIN_INFLUENCE_DRIVES or len(set(margins)) == 1:
            return ()
        columns = [[drive.conditions.get(name, 0.0) for drive in judged] for name in names]
        correlations = [spearman(column, margins) for column in columns]
        p_values = holm([p for _, p in correlations])
        influences = [
            Influence(name, rho, p)
            for name, (rho, _), p in zip(names, correlations, p_values, strict=True)
        ]
        return tuple(sorted(influences, key=lambda influence: -abs(influence.spearman)))

    def __str__(self) -> str:
        if self.share is None:
            return f"none of {len(self.drives)} drives could be judged"
        low, high = self.interval
        text = (
            f"the same failure in {self.alike} of {counted(self.judged, 'drive')}"
            f" ({100.0 * self.share:.0f} %, 95 % interval {100.0 * low:.0f} to"
            f" {100.0 * high:.0f} %)"
        )
        if others := matches_text(drive for drive in self.drives if not drive.is_alike):
            text += f", another in {self.failed - self.alike} ({others})"
        influences = [str(influence) for influence in self.influences if influence.matters]
        return "; ".join([text, *influences])

    def as_json(self) -> dict[str, JSONValue]:
        """Return the recorded test, its drives and the figures above as a JSON object."""
        return {
            "test": self.id,
            "conditions": dict(self.conditions),
            "change": str(self.change),
            "stability": None if self.stability is None else str(self.stability),
            "failed": self.failed,
            "judged": self.judged,
            "alike": self.alike,
            "matches": matches_json(self.drives),
            "share": self.share,
            "interval": list(self.interval),
            "influences": [asdict(influence) for influence in self.influences],
            "recorded": _verdict_json(self.recorded),
            "drives": [
                {
                    "conditions": dict(drive.test.candidate.conditions),
                    **_verdict_json(drive.test),
                    "seconds": drive.test.seconds,
                    "match": drive.match,
                    "difference": drive.difference,
                    "is_same": drive.is_same,
                }
                for drive in self.drives
            ],
        }


def _verdict_json(test: Test) -> dict[str, JSONValue]:
    """Return the verdict on a drive as a JSON object."""
    departure = test.departure
    return {
        "outcome": str(test.outcome),
        "reason": test.reason,
        "moobd": test.moobd,
        "duration": rounded_seconds(test.result.duration),
        "departure_distance": None if departure is None else departure.distance,
        "departure_side": None if departure is None else departure.side,
    }


def matches_text(drives: Iterable[Repeat]) -> str:
    """Return how many failing drives have each match: ``2 same failure, 8 elsewhere``."""
    counts = Counter(drive.match for drive in drives)
    return ", ".join(f"{counts[match]} {match}" for match in Match if counts[match])


def matches_json(drives: Iterable[Repeat]) -> dict[str, JSONValue]:
    """Return match -> number of failing drives as a JSON object, with the matches of none, too."""
    counts = Counter(drive.match for drive in drives)
    return {str(match): counts[match] for match in Match}
