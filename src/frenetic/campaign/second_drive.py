"""The second drive of a failing road, which shows whether its failure can be repeated."""

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
"""Name of the fact about the second drive of a campaign's first failure: ``test`` is the id of the
test, and ``note`` says why the drive is not repeatable; it is empty if the drive is."""
MAX_MOOBD_DIFFERENCE: Final = 1e-6
"""Largest difference of the MOOBDs of two drives in an exact simulator, in m (our choice): machines
round differently."""
_MOTION_COLUMNS: Final = slice(0, 8)
"""Columns of a trajectory that the simulator sets; the other columns are the driver's controls."""


class Match(StrEnum):
    """How the failure in a further drive of a road compares with the recorded failure."""

    SAME = "same failure"
    """The failure has the same place, side and mechanism."""
    OTHER_MECHANISM = "other mechanism"
    """The place and the side are the same, but road, offsets and speeds before the failure differ
    by more than `frenetic.search.approach.ALIKE`, or the drives exceeded different criteria."""
    OTHER_SIDE = "other side"
    """The place is the same, but the side of the lane is the other."""
    ELSEWHERE = "elsewhere"
    """The failure is more than `frenetic.search.approach.BEHIND` away along the road."""
    SAME_PLACE = "same place"
    """The place and the side are the same; without a trajectory the mechanism is unknown."""

    @classmethod
    def of(cls, recorded: Test, repeated: Test, difference: float | None) -> Match | None:
        """Return how two failures of a road compare; None unless both drives fail.

        Args:
            recorded: the recorded test.
            repeated: the test of the further drive.
            difference: difference of the failures in m, see `frenetic.analysis.failures`; None if
                it is unknown.
        """
        if not repeated.outcome is recorded.outcome is Outcome.FAIL:
            return None
        fault = recorded.result.fault
        if fault is not None or repeated.result.fault is not None:
            is_like = fault is not None and fault.is_like(repeated.result.fault)
            return cls.SAME if is_like else cls.OTHER_MECHANISM
        finding, recorded_finding = repeated.result.finding, recorded.result.finding
        criterion = finding and finding.criterion
        if criterion != (recorded_finding and recorded_finding.criterion):
            return cls.OTHER_MECHANISM
        if finding is not None and recorded_finding is not None:
            if abs(finding.distance - recorded_finding.distance) > BEHIND:
                return cls.ELSEWHERE
            if finding.side != recorded_finding.side:
                return cls.OTHER_SIDE
        if difference is None:
            return cls.SAME_PLACE
        return cls.SAME if difference <= ALIKE else cls.OTHER_MECHANISM

    @property
    def is_alike(self) -> bool:
        """Whether the failures are the same, as far as that is known."""
        return self in (Match.SAME, Match.SAME_PLACE)


def outcome_difference(first: Test, second: Test) -> str:
    """Return how outcome or failure of a second drive differ, in words; empty if they do not."""
    if second.outcome is not first.outcome:
        return f"{second.outcome}, not {first.outcome}"
    match = Match.of(first, second, _failure_difference(first, second))
    return "" if match is None or match.is_alike else f"another failure, {match}"


def moobd_difference(first: Test, second: Test, simulator: Simulator) -> str:
    """Return how the MOOBD of a second drive differs, in words; empty if it does not.

    It is empty, too, if the simulator is not exact, or if a fault cut the first drive short.
    """
    is_cut = first.result.fault is not None  # for example where the driver hung
    if not is_exact(simulator) or is_cut or first.moobd is None or second.moobd is None:
        return ""
    difference = second.moobd - first.moobd
    if abs(difference) <= MAX_MOOBD_DIFFERENCE:
        return ""
    return f"a MOOBD {abs(difference):.2g} m {'lower' if difference < 0.0 else 'higher'}"


def is_exact(simulator: Simulator) -> bool:
    """Return whether the same controls give the same drive, to the last bit."""
    return type(simulator).__name__ == EmbeddedSimulator.__name__


def _failure_difference(first: Test, second: Test) -> float | None:
    """Return the difference of two failures in m; None if a trajectory is missing or empty."""
    if not first.trajectory or not second.trajectory:
        return None
    return float(np.linalg.norm(_approach(first) - _approach(second)))


def _approach(test: Test) -> FloatArray:
    """Return road, offsets and speeds before a failure, see `frenetic.search.approach`."""
    evaluation = evaluation_of(test, lambda: test.trajectory, Objective.load(MOOBD))
    return critical_places(evaluation, test.candidate, 0.0)[0].vector


def _suspect(first: Test, second: Test, simulator: Simulator) -> str:
    """Return which part probably differs in the second drive, and from when on, in words."""
    path, second_path = first.trajectory, second.trajectory
    if path is not None and second_path is not None:
        n = min(len(path), len(second_path))
        is_different = path.to_rows()[:n] != second_path.to_rows()[:n]
        if is_different.any():
            record = int(is_different.any(axis=1).argmax())
            since = f"from {path.time[record]:.1f} s on"
            # The first value that differs is the driver's unless the car moved differently before.
            if is_exact(simulator) or not is_different[record, _MOTION_COLUMNS].any():
                return f"probably the driver, whose controls differ {since}"
            return f"probably the simulator, which moves the car otherwise {since}"
    fault = second.result.fault or first.result.fault
    if fault is not None or is_exact(simulator):
        return f"probably the {'driver' if fault is None else fault.part}"
    return "by the driver or the simulator"


class SecondDrive:
    """The second drive of a campaign's first failure, in the same conditions.

    It takes no budget, and the search does not learn its result.

    Args:
        store: the campaign, to which the result is added as a fact.
        simulator: simulator of the campaign.
    """

    def __init__(self, store: CampaignStore, simulator: Simulator) -> None:
        self._store = store
        self._simulator = simulator
        self._is_done = SECOND_DRIVE in store.facts
        self.candidate: Candidate | None = None
        """The candidate to drive a second time; None before the first failure, and afterwards."""
        self.note = not_repeatable(store.facts)
        """Why a verdict holds only for the drive that it judges; empty if drives repeat, as far as
        known."""
        for test in store.tests(Outcome.FAIL, limit=1):
            self.note_test(test)

    def note_test(self, test: Test) -> None:
        """Note a result: the candidate of the first failure will be driven a second time."""
        if test.outcome is Outcome.FAIL and not self._is_done and self.candidate is None:
            self.candidate = test.candidate

    def compare(self, attempt: Attempt) -> None:
        """Compare the second drive with the first drive, and store the difference in `note`."""
        first = self._store.test(attempt.candidate_id)
        path = attempt.stored_trajectory()
        second = replace(first, result=attempt.result, pose=attempt.pose, trajectory=path)
        difference = outcome_difference(first, second)
        property_lost = "repeatable"
        consequence = "every verdict holds for single drives only"
        if not difference:
            difference = moobd_difference(first, second, self._simulator)
            property_lost = "exactly repeatable"
            consequence = "the same seed may find other roads"
        if difference:
            suspect = _suspect(first, second, self._simulator)
            self.note = (
                f"test {first.id} is not {property_lost}: driven a second time, it gave"
                f" {difference} ({suspect}), so {consequence}"
            )
        fact: dict[str, JSONValue] = {"test": first.id, "note": self.note}
        self._store.keep(**{SECOND_DRIVE: fact})
        self.candidate, self._is_done = None, True


def not_repeatable(facts: Mapping[str, JSONValue]) -> str:
    """Return why a verdict holds only for the drive that it judges; empty if drives repeat."""
    second = facts.get(SECOND_DRIVE)
    return str(second.get("note", "")) if isinstance(second, Mapping) else ""
