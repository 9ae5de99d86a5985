"""Numbers of a campaign's tests, counted alike wherever they are shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Self

from frenetic._support.words import counted
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate

_NAMES: Final[Mapping[Outcome, str]] = {
    Outcome.PASS: "passed",
    Outcome.FAIL: "failed",
    Outcome.INVALID: "invalid",
    Outcome.ERROR: "errors",
    Outcome.DROPPED: "dropped",
}
"""Outcome -> name of its number, here and in JSON."""


@dataclass
class Counts:
    """Numbers of tests by outcome, of different roads among them, and the lowest MOOBD."""

    invalid: int = 0
    passed: int = 0
    failed: int = 0
    errors: int = 0
    dropped: int = 0
    """Number of candidates that the strategy no longer wanted before they were driven."""
    min_moobd: float | None = None
    """Lowest MOOBD of all drives, in m; None before the first."""
    roads: int = 0
    """Number of different roads among the tests: a repeated one counts once."""

    def __post_init__(self) -> None:
        self._keys: set[int] = set()  # of the roads that were added

    @classmethod
    def of(
        cls, by_outcome: Mapping[Outcome, int], min_moobd: float | None = None, roads: int = 0
    ) -> Self:
        """The counts of a number per outcome."""
        numbers = {name: by_outcome[outcome] for outcome, name in _NAMES.items()}
        return cls(**numbers, min_moobd=min_moobd, roads=roads)

    def add(self, candidate: Candidate, outcome: Outcome, moobd: float | None) -> None:
        """Counts one more result."""
        name = _NAMES[outcome]
        setattr(self, name, getattr(self, name) + 1)
        if outcome.is_test:
            self._keys.add(key_of(candidate))
            self.roads = len(self._keys)
        if moobd is not None:
            self.min_moobd = moobd if self.min_moobd is None else min(self.min_moobd, moobd)

    @property
    def simulations(self) -> int:
        """Number of drives, including those in which the simulator broke."""
        return self.passed + self.failed + self.errors

    @property
    def tests(self) -> int:
        """Number of road tests, with refused ones, without dropped ones."""
        return self.simulations + self.invalid

    @property
    def told(self) -> int:
        """Number of results that the strategy was told: tests and dropped candidates."""
        return self.tests + self.dropped

    @property
    def by_outcome(self) -> Mapping[Outcome, int]:
        """Number per outcome; every outcome is present."""
        return MappingProxyType({outcome: getattr(self, name) for outcome, name in _NAMES.items()})

    @property
    def broken(self) -> str:
        """In how many drives the simulator broke, in words; empty if in none."""
        if not self.errors:
            return ""
        return f"the simulator broke in {self.errors} of {counted(self.simulations, 'drive')}"

    @classmethod
    def total(cls, campaigns: Iterable[Counts]) -> Counts:
        """The counts of several campaigns together; a road counts once in each."""
        several = list(campaigns)
        moobds = [one.min_moobd for one in several if one.min_moobd is not None]
        return Counts(
            **{name: sum(getattr(one, name) for one in several) for name in _NAMES.values()},
            min_moobd=min(moobds, default=None),
            roads=sum(one.roads for one in several),
        )

    def counts_json(self) -> dict[str, Any]:
        """The counts as one JSON object."""
        return {
            "tests": self.tests,
            "roads": self.roads,
            "simulations": self.simulations,
            **{name: getattr(self, name) for name in _NAMES.values()},
            "min_moobd": self.min_moobd,
        }

    def in_words(self) -> str:
        """The counts in a line: ``90 tests of 88 different roads: 70 passed, 20 failed``."""
        rest = {
            f"{self.invalid} invalid": self.invalid,
            counted(self.errors, "error"): self.errors,
            f"{self.dropped} dropped": self.dropped,
        }
        return ", ".join(
            [
                f"{counted(self.tests, 'test')} of {counted(self.roads, 'different road')}:"
                f" {self.passed} passed",
                f"{self.failed} failed",
                *(text for text, number in rest.items() if number),
            ]
        )


def road_key(step: object, curvatures: object, points: object) -> int:
    """A number that is the same for the same road, within this process.

    Args:
        step: m between curvatures.
        curvatures: float64 as bytes.
        points: likewise, None if the road was not proposed as points.
    """
    return hash((step, curvatures, points))


def key_of(candidate: Candidate) -> int:
    """The `road_key` of a candidate."""
    points = candidate.points
    return road_key(
        float(candidate.step),
        candidate.curvatures.astype("<f8", copy=False).tobytes(),
        None if points is None else points.astype("<f8", copy=False).tobytes(),
    )
