"""The second drive of a failing road, which shows whether driver and simulator repeat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import JSONValue
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.record import Attempt, Test
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.search.approach import ALIKE, BEHIND
from frenetic.search.archive import critical_places
from frenetic.search.records import Candidate
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.simulator import Simulator

SECOND_DRIVE: Final = "second_drive"
"""Fact about the second drive of a campaign's first failure: ``test``, and ``note``, which says why
the drive is not repeatable and is empty if it is."""
MOST: Final = 1e-6
"""Largest difference of the MOOBDs of exact drives, in m (ours): machines round differently."""
_MOTION: Final = slice(0, 8)  # columns of a trajectory, before the controls chosen there


class Match(StrEnum):
    """Likeness of a drive's failure to the recorded failure of its road."""

    SAME = "same failure"
    """The same place, side and mechanism."""
    OTHER_MECHANISM = "other mechanism"
    """The same place and side, but road, offsets and speeds before it differ by more than
    `frenetic.search.approach.ALIKE`, or the drives exceeded other criteria."""
    OTHER_SIDE = "other side"
    """The same place, but on the other side of the lane."""
    ELSEWHERE = "elsewhere"
    """More than `frenetic.search.approach.BEHIND` away along the road."""
    SAME_PLACE = "same place"
    """The same place and side; the mechanism is unknown, as a trajectory is missing."""

    @classmethod
    def of(cls, recorded: Test, again: Test, difference: float | None) -> Match | None:
        """Return how like two failures of a road are; None unless both drives fail.

        Args:
            recorded: the recorded test.
            again: the test to compare.
            difference: of the failures in m, see `frenetic.analysis.failures`; None if unknown.
        """
        if not again.outcome is recorded.outcome is Outcome.FAIL:
            return None
        fault = recorded.result.fault
        if fault is not None or again.result.fault is not None:
            is_like = fault is not None and fault.is_like(again.result.fault)
            return cls.SAME if is_like else cls.OTHER_MECHANISM
        here, there = again.result.finding, recorded.result.finding
        if (here and here.criterion) != (there and there.criterion):
            return cls.OTHER_MECHANISM
        if here is not None and there is not None:
            if abs(here.distance - there.distance) > BEHIND:
                return cls.ELSEWHERE
            if here.side != there.side:
                return cls.OTHER_SIDE
        if difference is None:
            return cls.SAME_PLACE
        return cls.SAME if difference <= ALIKE else cls.OTHER_MECHANISM

    @property
    def is_alike(self) -> bool:
        """Whether the failures are the same, as far as that is known."""
        return self in (Match.SAME, Match.SAME_PLACE)


def other_ending(first: Test, again: Test) -> str:
    """Return another outcome or failure of a second drive, in words; empty if it is the same."""
    if again.outcome is not first.outcome:
        return f"{again.outcome}, not {first.outcome}"
    match = Match.of(first, again, _difference(first, again))
    return "" if match is None or match.is_alike else f"another failure, {match}"


def other_moobd(first: Test, again: Test, simulator: Simulator) -> str:
    """Return another MOOBD of a second drive, in words; empty if the simulator is not exact."""
    before, now = first.moobd, again.moobd
    is_cut = first.result.fault is not None  # where the driver hung, say
    if not is_exact(simulator) or is_cut or before is None or now is None:
        return ""
    if abs(now - before) <= MOST:
        return ""
    return f"a MOOBD {abs(now - before):.2g} m {'lower' if now < before else 'higher'}"


def is_exact(simulator: Simulator) -> bool:
    """Return whether the same controls give the same drive, to the last bit."""
    return type(simulator).__name__ == EmbeddedSimulator.__name__


def _difference(first: Test, again: Test) -> float | None:
    """Return the difference of two drives of a road in m, see `frenetic.search.approach`."""
    if not first.trajectory or not again.trajectory:  # also where it has no record
        return None
    return float(np.linalg.norm(_approach(first) - _approach(again)))


def _approach(test: Test) -> FloatArray:
    evaluation = evaluation_of(test, lambda: test.trajectory, Objective.load(MOOBD))
    return critical_places(evaluation, test.candidate, 0.0)[0].vector


def _suspect(first: Test, again: Test, simulator: Simulator) -> str:
    """Return which part probably differs in the second drive, and from when on, in words."""
    a, b = first.trajectory, again.trajectory
    if a is not None and b is not None:
        n = min(len(a), len(b))
        others = a.to_rows()[:n] != b.to_rows()[:n]
        if others.any():
            record = int(others.any(axis=1).argmax())
            since = f"from {a.time[record]:.1f} s on"
            if is_exact(simulator) or not others[record, _MOTION].any():
                return f"probably the driver, whose controls differ {since}"
            return f"probably the simulator, which moves the car otherwise {since}"
    fault = again.result.fault or first.result.fault
    if fault is not None or is_exact(simulator):
        return f"probably the {'driver' if fault is None else fault.part}"
    return "by the driver or the simulator"


class SecondDrive:
    """The second drive of a campaign's first failure, in the same conditions.

    It costs no budget, and the search does not learn of it.

    Args:
        store: of the campaign, which keeps the result.
        simulator: of the campaign.
    """

    def __init__(self, store: CampaignStore, simulator: Simulator) -> None:
        self._store = store
        self._simulator = simulator
        self._is_done = SECOND_DRIVE in store.facts
        self.candidate: Candidate | None = None
        """Failing road, until it was driven a second time; None before and after."""
        self.note = not_repeatable(store.facts)
        """Why verdicts hold for single drives only; empty if drives repeat, as far as known."""
        for test in store.tests(Outcome.FAIL, limit=1):
            self.see(test)

    def see(self, test: Test) -> None:
        """Look at a result: the first failure will be driven again."""
        if test.outcome is Outcome.FAIL and not self._is_done and self.candidate is None:
            self.candidate = test.candidate

    def take(self, attempt: Attempt) -> None:
        """Compare the second drive with the first, and store the result."""
        first = self._store.test(attempt.candidate_id)
        path = attempt.stored_trajectory()
        again = replace(first, result=attempt.result, pose=attempt.pose, trajectory=path)
        other = other_ending(first, again)
        word, follows = "repeatable", "every verdict holds for single drives only"
        if not other:
            other = other_moobd(first, again, self._simulator)
            word, follows = "exactly repeatable", "the same seed may find other roads"
        if other:
            who = _suspect(first, again, self._simulator)
            self.note = (
                f"test {first.id} is not {word}: driven a second time, it gave {other} ({who}), so"
                f" {follows}"
            )
        fact: dict[str, JSONValue] = {"test": first.id, "note": self.note}
        self._store.keep(**{SECOND_DRIVE: fact})
        self.candidate, self._is_done = None, True


def not_repeatable(facts: Mapping[str, JSONValue]) -> str:
    """Return why a campaign's verdicts hold for single drives only; empty without a reason."""
    second = facts.get(SECOND_DRIVE)
    return str(second.get("note", "")) if isinstance(second, Mapping) else ""
