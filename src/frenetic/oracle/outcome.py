"""Outcomes of road tests."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import NoReturn


class Outcome(StrEnum):
    """Outcome of a road test."""

    PASS = "PASS"
    """The car reached the end of the road in its lane, and no criterion was breached."""
    FAIL = "FAIL"
    """The car left its lane, stood still, ran out of time or breached another criterion, or its
    driver broke."""
    INVALID = "INVALID"
    """The road was refused, so nothing was driven."""
    ERROR = "ERROR"
    """The simulator broke; nothing is known about the road."""
    DROPPED = "DROPPED"
    """The strategy no longer wanted the road before it was driven; nothing is known about it."""

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        known = ", ".join(cls)
        raise ValueError(f"outcome is {value!r}: one of {known} is needed")

    @property
    def is_driven(self) -> bool:
        """Whether a drive was judged: PASS or FAIL."""
        return self in (Outcome.PASS, Outcome.FAIL)

    @property
    def is_simulated(self) -> bool:
        """Whether the test counts as a simulation: a drive, even if the simulator broke in it."""
        return self not in (Outcome.INVALID, Outcome.DROPPED)

    @property
    def is_test(self) -> bool:
        """Whether the road counts as tested: every outcome but DROPPED."""
        return self is not Outcome.DROPPED


def chosen_outcomes(outcomes: Outcome | str | Iterable[Outcome | str]) -> tuple[Outcome, ...]:
    """Return the outcomes that a caller names: one, several, or all if the caller names none.

    Raises:
        ValueError: an outcome has an unknown name.
    """
    if isinstance(outcomes, str) or not isinstance(outcomes, Iterable):
        return (Outcome(outcomes),)
    return tuple(Outcome(outcome) for outcome in outcomes) or tuple(Outcome)
