"""The numbers of a campaign's tests, counted in one way wherever they are shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import counted, rounded_seconds
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.road import profile
from frenetic.search.records import Candidate

_OUTCOME_NAMES: Final[Mapping[Outcome, str]] = {
    Outcome.PASS: "passed",
    Outcome.FAIL: "failed",
    Outcome.INVALID: "invalid",
    Outcome.ERROR: "errors",
    Outcome.DROPPED: "dropped",
}
"""Outcome -> name of the number of tests with this outcome, in `Counts` and in JSON."""
_SUMMED_NAMES: Final = (
    *_OUTCOME_NAMES.values(),
    "roads",
    "repeats",
    "failing_repeats",
    "invalid_repeats",
    "driven_metres",
    "simulated_seconds",
)
"""Names of the numbers that add up over several campaigns."""


@dataclass
class Counts:
    """Numbers of tests by outcome and of different roads, lowest MOOBD, length and time driven."""

    invalid: int = 0
    """Number of tests whose road was refused, so that nothing was driven."""
    passed: int = 0
    """Number of tests that passed."""
    failed: int = 0
    """Number of tests that failed."""
    errors: int = 0
    """Number of tests in which the simulator broke."""
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
    driven_metres: float = 0.0
    """Length of road that was driven, in m: the sum of `Result.distance`."""
    simulated_seconds: float = 0.0
    """Simulated time of all drives, in s: the sum of `Result.duration`."""

    def __post_init__(self) -> None:
        self.forget_roads()

    def forget_roads(self) -> None:
        """Forget which roads are counted, and which tests came first."""
        self._road_keys: set[int] = set()  # of the tests that were added
        self._first_tests = FirstTests()

    @classmethod
    def of(cls, by_outcome: Mapping[Outcome, int], min_moobd: float | None = None) -> Self:
        """Return counts with a number of tests per outcome, and the lowest MOOBD in m."""
        numbers = {name: by_outcome[outcome] for outcome, name in _OUTCOME_NAMES.items()}
        return cls(**numbers, min_moobd=min_moobd)

    def add(self, candidate: Candidate, result: Result) -> None:
        """Count the result of a candidate.

        Raises:
            RuntimeError: the counts are a copy, or were read, and do not know their roads.
        """
        if self.roads != len(self._road_keys):
            raise RuntimeError(
                "these counts are a copy, or were read, and do not know which roads are counted:"
                " add to the original"
            )
        outcome, moobd = result.outcome, result.moobd
        name = _OUTCOME_NAMES[outcome]
        setattr(self, name, getattr(self, name) + 1)
        if outcome.is_test:
            road = key_of(candidate)
            self._road_keys.add(road)
            self.roads = len(self._road_keys)
            if not self._first_tests.add(candidate, outcome, road):
                self.add_repeat(outcome)
        if moobd is not None:
            self.min_moobd = moobd if self.min_moobd is None else min(self.min_moobd, moobd)
        self.add_drive(result.distance, result.duration)

    def add_drive(self, distance: float | None, duration: float | None) -> None:
        """Add the length in m and the simulated time in s of a drive; None adds nothing."""
        # In the order of results, so that stored counts are equal to the last bit.
        self.driven_metres += distance or 0.0
        self.simulated_seconds += duration or 0.0

    def add_repeat(self, outcome: Outcome) -> None:
        """Note that a test with this outcome, which is counted already, repeats an earlier test."""
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
        """Number of road tests, with refused roads and without dropped candidates."""
        return self.simulations + self.invalid

    @property
    def result_count(self) -> int:
        """Number of results that the strategy knows: tests and dropped candidates."""
        return self.tests + self.dropped

    @property
    def by_outcome(self) -> Mapping[Outcome, int]:
        """Number of tests per outcome; every outcome is present."""
        numbers = {outcome: getattr(self, name) for outcome, name in _OUTCOME_NAMES.items()}
        return MappingProxyType(numbers)

    @property
    def broken_text(self) -> str:
        """Number of drives in which the simulator broke, in words; empty if in no drive."""
        if not self.errors:
            return ""
        return f"the simulator broke in {self.errors} of {counted(self.simulations, 'drive')}"

    @classmethod
    def total(cls, campaigns: Iterable[Counts]) -> Counts:
        """Return the sum of several campaigns' counts; a road counts once in each campaign."""
        several = list(campaigns)
        moobds = [counts.min_moobd for counts in several if counts.min_moobd is not None]
        return Counts(
            **{name: sum(getattr(counts, name) for counts in several) for name in _SUMMED_NAMES},
            min_moobd=min(moobds, default=None),
        )

    def numbers(self) -> dict[str, Any]:
        """Return the fields of `Counts` by their names, without those that a subclass adds."""
        return {item.name: getattr(self, item.name) for item in fields(Counts)}

    def counts_json(self) -> dict[str, Any]:
        """Return the counts as one JSON object."""
        return {
            "tests": self.tests,
            "roads": self.roads,
            "repeats": self.repeats,
            "failures": self.failures,
            "simulations": self.simulations,
            **{name: getattr(self, name) for name in _OUTCOME_NAMES.values()},
            "min_moobd": self.min_moobd,
            "kilometres": round(self.driven_metres / 1000.0, 6),
            "simulated_seconds": rounded_seconds(self.simulated_seconds),
        }

    def amounts(self, seconds: float) -> dict[str, float]:
        """Return how much of each limit of a `Budget` the tests have spent, by the limit's name.

        Args:
            seconds: wall time of the tests, in s.
        """
        return {
            "simulations": self.simulations,
            "time": seconds,
            "failures": self.failed,
            "kilometres": self.driven_metres / 1000.0,
            "simulated_time": self.simulated_seconds,
        }

    def as_text(self) -> str:
        """Return the counts in a line: ``90 tests of 88 different roads: 70 passed, 20 failed``.

        Failed tests that repeat earlier tests are named: ``20 failed (2 repeats)``.
        """
        tests, roads = counted(self.tests, "test"), counted(self.roads, "different road")
        texts = [f"{tests} of {roads}: {self.passed} passed", f"{self.failed} failed"]
        if self.failing_repeats:
            texts[-1] += f" ({counted(self.failing_repeats, 'repeat')})"
        if self.invalid:
            texts.append(f"{self.invalid} invalid")
        if self.errors:
            texts.append(counted(self.errors, "error"))
        if self.dropped:
            texts.append(f"{self.dropped} dropped")
        return ", ".join(texts)


class FirstTests:
    """The tests that repeat no earlier test; no measure counts repeats.

    A test repeats an earlier test with the same road, conditions and outcome. A failure on a road
    that passed before is no repeat: it shows that the same drive may end in another way.
    """

    def __init__(self) -> None:
        self._keys: set[int] = set()

    def add(self, candidate: Candidate, outcome: Outcome, road: int | None = None) -> bool:
        """Add a test; return whether it repeats no earlier test. A dropped candidate never does.

        Args:
            candidate: the candidate.
            outcome: outcome of its test.
            road: `key_of` the candidate, if it is known already.
        """
        road = key_of(candidate) if road is None else road
        profiles = [_bytes_of(getattr(candidate, name)) for name in profile.NAMES]
        return self.add_key(outcome, road, candidate.conditions, profiles)

    def add_key(
        self,
        outcome: Outcome,
        road: int,
        conditions: Mapping[str, float],
        profiles: Sequence[bytes | None],
    ) -> bool:
        """Add a test by its stored values; return whether it repeats no earlier test.

        Args:
            outcome: outcome of the test.
            road: `road_key` of the test's road.
            conditions: conditions of the drive, by name.
            profiles: the road's profiles in the order of `profile.NAMES`, float64 as bytes; None
                for a profile that the road lacks.
        """
        if not outcome.is_test:
            return True
        count_before = len(self._keys)
        self._keys.add(hash((outcome, road, *sorted(conditions.items()), *profiles)))
        return len(self._keys) > count_before


def road_key(step: object, curvatures: bytes, points: object) -> int:
    """Return a number that is the same for the same road, within this process.

    Args:
        step: distance between two curvatures, in m.
        curvatures: float64 as bytes; 0 and -0 are the same.
        points: float64 as bytes; None if the road was not proposed as points.
    """
    values = np.frombuffer(curvatures, "<f8") + 0.0  # which turns -0 into 0
    return hash((step, values.tobytes(), points))


def key_of(candidate: Candidate) -> int:
    """Return the `road_key` of a candidate."""
    curvatures = candidate.curvatures.astype("<f8", copy=False).tobytes()
    return road_key(float(candidate.step), curvatures, _bytes_of(candidate.points))


def _bytes_of(values: FloatArray | None) -> bytes | None:
    return None if values is None else values.astype("<f8", copy=False).tobytes()
