"""A generator of the official pipeline as a search strategy of a campaign."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.guarded_strategy import ObservingStrategy
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester, road_through
from frenetic.errors import RoadError
from frenetic.export.official_format import simulation_records
from frenetic.oracle.drive import Drive
from frenetic.plugins.bench.generator import GeneratorLostError, GeneratorProcess
from frenetic.road import check_validity
from frenetic.road.validity import overlaps_itself
from frenetic.search import Candidate, Evaluation, Origin, SearchEnded
from frenetic.search.strategy import Ledger

OPERATOR: Final = "generator"
"""Operator in the origin of a generator's roads."""
MAX_CLOSING_TIME: Final = 60.0
"""Longest wall time in which a generator may end after its budget is spent, in s; our choice."""
WRONG_TYPE: Final = "Wrong type"
"""The pipeline's message about an object that is no road test, or has no points."""

_MAX_DETAIL_LENGTH: Final = 450  # letters of a generator's reason; our choice


class End(StrEnum):
    """End of a generator."""

    OVER = "over"
    """The budget was spent."""
    RETURNED = "returned"
    """The generator's ``start`` returned before the budget was spent."""
    EXIT = "exit"
    """The generator ended its process by itself."""
    CRASHED = "crashed"
    """The generator raised, or its process died."""
    HUNG = "hung"
    """The generator asked for no test for too long and was ended."""
    GAVE_UP = "gave up"
    """The bench ended the generator since its roads or drives were bad for too long."""


@dataclass(frozen=True)
class RunEnding:
    """End of a generator, and its reason."""

    end: End
    detail: str = ""
    """Reason in one line; empty if the end says all."""

    def __str__(self) -> str:
        return f"{self.end}: {self.detail}" if self.detail else str(self.end)


class GeneratorStrategy(ObservingStrategy):
    """A strategy that proposes a generator's roads and answers the generator with their results.

    The generator waits for the result of each road before its next one, so its campaign has one
    worker. It cannot be asked again for the same roads, so its campaign cannot be resumed.

    Args:
        process: process of the generator, already entered.
        tester: tester of its roads.
        time_budget: virtual time that passes as the budget is spent, in s.
        patience: wall time that the generator may take between two tests, in s.
        seed: seed of the generator, for the campaign's record.
    """

    def __init__(
        self,
        process: GeneratorProcess,
        tester: RoadTester,
        *,
        time_budget: float,
        patience: float,
        seed: int,
    ) -> None:
        self.options = {"seed": seed}
        self.ending: RunEnding | None = None
        """End of the generator; None while it runs."""
        self.computing = 0.0
        """Wall time that the generator took, in s."""
        self._process = process
        self._tester = tester
        self._time_budget = time_budget
        self._budget_spent = 0.0  # share
        self._patience = patience
        self._ledger = Ledger()
        self._attempt: Attempt | None = None  # at the candidate of the next `tell`

    def start(self) -> None:
        """Wait until the generator is built, or could not be built: then it has an ``ending``."""
        self._receive(self._patience)

    def ask(self) -> Candidate:
        """Return the road of the next test that the generator wants executed.

        Raises:
            SearchEnded: the generator has ended.
        """
        if self.ending is None:
            message = self._receive(self._patience)
            if message is not None:
                return self._candidate(pairs_of(message.get("road_points")))
        assert self.ending is not None
        raise SearchEnded(f"the generator ended ({self.ending})")

    def observe(self, attempt: Attempt) -> None:
        """Keep the attempt, whose drive the answer to the generator holds."""
        self._attempt = attempt

    def tell(self, evaluation: Evaluation) -> None:
        """Answer the generator's test with its result."""
        self._ledger.settle(evaluation)
        attempt, self._attempt = self._attempt, None
        self._budget_spent = evaluation.budget_spent
        answer = {
            "outcome": str(evaluation.outcome),
            "description": WRONG_TYPE if evaluation.candidate.points is None else _reason(attempt),
            "records": self._records(evaluation, attempt),
            "spent": self._time_spent,
        }
        self._send(answer)

    @property
    def _time_spent(self) -> float:
        """Virtual time that has passed, in s, in whole microseconds until the end."""
        if self._budget_spent >= 1.0:
            return self._time_budget
        return round(self._budget_spent * self._time_budget, 6)

    def dismiss(self) -> RunEnding:
        """Announce that the budget is spent; wait until the generator has ended, return its end."""
        deadline = time.monotonic() + min(self._patience, MAX_CLOSING_TIME)
        while self.ending is None:
            self._send({"over": True})
            # Receives the end of the generator, or a test that no longer counts.
            self._receive(deadline - time.monotonic(), "it went on when the budget was spent")
        return self.ending

    def _send(self, message: Mapping[str, Any]) -> None:
        """Send a message; a process that has ended may still have messages to receive."""
        with suppress(GeneratorLostError):
            self._process.send(message)

    def _receive(self, patience: float, hung_reason: str = "") -> dict[str, Any] | None:
        """Return the generator's next message that is no question about a road.

        Questions about roads are answered meanwhile. None if the generator has ended; then
        ``ending`` is set.

        Args:
            patience: wall time after which the generator counts as hung, in s.
            hung_reason: reason for the end of a hung generator; by default that it asked for no
                test.
        """
        deadline = time.monotonic() + patience
        try:
            while message := self._process.receive(max(0.0, deadline - time.monotonic())):
                if message.get("kind") not in ("valid", "overlaps"):
                    break
                self._send(self._answer_about_road(message))
        except GeneratorLostError as error:
            self.ending = RunEnding(End.CRASHED, str(error))
            return None
        if message is None:
            seconds_left = self._time_budget - self._time_spent
            no_test = (
                f"it asked for no test for {patience:.3g} s, with {seconds_left:.3g} s of its"
                " budget left"
            )
            self.ending = RunEnding(End.HUNG, hung_reason or no_test)
            return None
        self.computing += float(message.get("seconds", 0.0))
        if message.get("kind") == "end":
            self.ending = self._ending_of(message)
            return None
        return message

    def _answer_about_road(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a question whether a road is valid, or overlaps itself."""
        if question["kind"] == "overlaps":
            left, right = np.array(question["left"]), np.array(question["right"])
            # The pipeline says so of a road whose centre line stays on a point, too.
            repeats = (np.diff(0.5 * (left + right), axis=0) == 0.0).all(axis=1).any()
            return {"overlaps": bool(repeats or overlaps_itself(left, right))}
        points = pairs_of(question["road_points"])
        if points is None:
            return {"valid": False, "description": WRONG_TYPE}
        verdict = check_validity(points, self._tester.terms.map_size)
        return {"valid": verdict.valid, "description": verdict.message}

    def _ending_of(self, message: Mapping[str, Any]) -> RunEnding:
        """Return the end that the generator's last message reports."""
        end = End(message["end"])
        detail = " ".join(message["detail"].split())[:_MAX_DETAIL_LENGTH]  # in one line
        # A generator may end in peace when it sees that its last test has been executed.
        if self._budget_spent >= 1.0 and (end is End.RETURNED or detail == "exit code 0"):
            end, detail = End.OVER, ""
        return RunEnding(end, detail)

    def _candidate(self, points: FloatArray | None) -> Candidate:
        """Return the candidate through road points; one without curvatures if there is no road."""
        curvatures, step = np.empty(0), 1.0
        if points is not None:
            try:
                road = road_through(points, self._tester.terms.lane_width)
            except RoadError:
                pass  # the tester finds the candidate invalid and says why
            else:
                curvatures, step = road.curvatures, road.step
        return self._ledger.issue(curvatures, step, Origin(OPERATOR), points)

    def _records(self, evaluation: Evaluation, attempt: Attempt | None) -> list[Any]:
        """Return a drive as the pipeline's records; none if nothing was driven."""
        candidate = evaluation.candidate
        if attempt is None or attempt.trajectory is None or attempt.pose is None:
            return []
        setting = self._tester.setting
        road = candidate.road(setting.lane_width, attempt.pose)
        drive = Drive(attempt.trajectory, setting.car, setting.rules_in({}))
        return simulation_records(road, drive)


def _reason(attempt: Attempt | None) -> str:
    """Return the reason of a test's outcome, for the generator."""
    if attempt is None or attempt.worker_lost:
        return "The simulator broke"
    return attempt.result.reason


def pairs_of(points: Any) -> FloatArray | None:
    """Return road points in m, (n, 2); None if they are no pairs of finite numbers."""
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    if array.shape == (0,):
        return np.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2 or not np.isfinite(array).all():
        return None
    return array
