"""Numbers of a campaign's tests, counted alike wherever they are shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import counted
from frenetic.oracle.outcome import Outcome
from frenetic.road import profile
from frenetic.search.records import Candidate

_NAMES: Final[Mapping[Outcome, str]] = {
    Outcome.PASS: "passed",
    Outcome.FAIL: "failed",
    Outcome.INVALID: "invalid",
    Outcome.ERROR: "errors",
    Outcome.DROPPED: "dropped",
}
"""Outcome -> name of its number, here and in JSON."""
_SUMMED: Final = (*_NAMES.values(), "roads", "repeats", "failing_repeats", "invalid_repeats")
"""Names of the numbers that add up over several campaigns."""


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
    repeats: int = 0
    """Number of tests that repeat an earlier one, see `FirstTests`."""
    failing_repeats: int = 0
    """Number of repeats that failed."""
    invalid_repeats: int = 0
    """Number of repeats whose road was refused."""

    def __post_init__(self) -> None:
        self._keys: set[int] = set()  # of the roads that were added
        self._first = FirstTests()

    @classmethod
    def of(cls, by_outcome: Mapping[Outcome, int], min_moobd: float | None = None) -> Self:
        """Return counts with a number per outcome."""
        numbers = {name: by_outcome[outcome] for outcome, name in _NAMES.items()}
        return cls(**numbers, min_moobd=min_moobd)

    def add(self, candidate: Candidate, outcome: Outcome, moobd: float | None) -> None:
        """Count one more result."""
        name = _NAMES[outcome]
        setattr(self, name, getattr(self, name) + 1)
        if outcome.is_test:
            self._keys.add(key_of(candidate))
            self.roads = len(self._keys)
            if not self._first.add(candidate, outcome):
                self.add_repeat(outcome)
        if moobd is not None:
            self.min_moobd = moobd if self.min_moobd is None else min(self.min_moobd, moobd)

    def add_repeat(self, outcome: Outcome) -> None:
        """Note that a counted test with this outcome repeats an earlier test."""
        self.repeats += 1
        self.failing_repeats += outcome is Outcome.FAIL
        self.invalid_repeats += outcome is Outcome.INVALID

    @property
    def failures(self) -> int:
        """Number of failures; a repeated road counts once."""
        return self.failed - self.failing_repeats

    @property
    def simulations(self) -> int:
        """Number of drives, including those in which the simulator broke."""
        return self.passed + self.failed + self.errors

    @property
    def tests(self) -> int:
        """Number of road tests, with refused ones, without dropped ones."""
        return self.simulations + self.invalid

    @property
    def result_count(self) -> int:
        """Number of results that the strategy knows: tests and dropped candidates."""
        return self.tests + self.dropped

    @property
    def by_outcome(self) -> Mapping[Outcome, int]:
        """Number per outcome; every outcome is present."""
        return MappingProxyType({outcome: getattr(self, name) for outcome, name in _NAMES.items()})

    @property
    def broken(self) -> str:
        """Number of drives in which the simulator broke, in words; empty if in no drive."""
        if not self.errors:
            return ""
        return f"the simulator broke in {self.errors} of {counted(self.simulations, 'drive')}"

    @classmethod
    def total(cls, campaigns: Iterable[Counts]) -> Counts:
        """Return the counts of several campaigns together; a road counts once in each."""
        several = list(campaigns)
        moobds = [counts.min_moobd for counts in several if counts.min_moobd is not None]
        return Counts(
            **{name: sum(getattr(counts, name) for counts in several) for name in _SUMMED},
            min_moobd=min(moobds, default=None),
        )

    def counts_json(self) -> dict[str, Any]:
        """Return the counts as one JSON object."""
        return {
            "tests": self.tests,
            "roads": self.roads,
            "repeats": self.repeats,
            "failures": self.failures,
            "simulations": self.simulations,
            **{name: getattr(self, name) for name in _NAMES.values()},
            "min_moobd": self.min_moobd,
        }

    def as_text(self) -> str:
        """Return the counts in a line: ``90 tests of 88 different roads: 70 passed, 20 failed``.

        Of failed tests that repeat earlier ones it says how many: ``20 failed (2 repeats)``.
        """
        others = {
            f"{self.invalid} invalid": self.invalid,
            counted(self.errors, "error"): self.errors,
            f"{self.dropped} dropped": self.dropped,
        }
        repeats = counted(self.failing_repeats, "repeat")
        return ", ".join(
            [
                f"{counted(self.tests, 'test')} of {counted(self.roads, 'different road')}:"
                f" {self.passed} passed",
                f"{self.failed} failed{f' ({repeats})' if self.failing_repeats else ''}",
                *(text for text, number in others.items() if number),
            ]
        )


class FirstTests:
    """The first tests of roads, told from repeats, which no measure counts.

    A test repeats an earlier one with the same road, conditions and outcome. A failure of
    a road that passed before is no repeat: there the same drive may end in another way.
    """

    def __init__(self) -> None:
        self._keys: set[int] = set()

    def add(self, candidate: Candidate, outcome: Outcome) -> bool:
        """Add a test; return whether it is the first, as each dropped candidate is."""
        profiles = [_bytes_of(getattr(candidate, name)) for name in profile.NAMES]
        return self.add_key(outcome, key_of(candidate), candidate.conditions, profiles)

    def add_key(
        self,
        outcome: Outcome,
        road: int,
        conditions: Mapping[str, float],
        profiles: Sequence[bytes | None],
    ) -> bool:
        """Add a test by its stored values; return whether it is the first.

        Args:
            outcome: of the test.
            road: its `road_key`.
            conditions: of the drive.
            profiles: the road's `profile.NAMES`, float64 as bytes.
        """
        if not outcome.is_test:
            return True
        before = len(self._keys)
        self._keys.add(hash((outcome, road, *sorted(conditions.items()), *profiles)))
        return len(self._keys) > before


def road_key(step: object, curvatures: bytes, points: object) -> int:
    """Return a number that is the same for the same road, within this process.

    Args:
        step: m between curvatures.
        curvatures: float64 as bytes; 0 and -0 are the same.
        points: float64 as bytes, None if the road was not proposed as points.
    """
    values = np.frombuffer(curvatures, "<f8") + 0.0
    return hash((step, values.tobytes(), points))


def key_of(candidate: Candidate) -> int:
    """Return the `road_key` of a candidate."""
    curvatures = candidate.curvatures.astype("<f8", copy=False).tobytes()
    return road_key(float(candidate.step), curvatures, _bytes_of(candidate.points))


def _bytes_of(values: FloatArray | None) -> bytes | None:
    return None if values is None else values.astype("<f8", copy=False).tobytes()
