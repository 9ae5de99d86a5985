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

CLOSING_LIMIT: Final = 60.0
"""Time that a generator has to end after its budget is spent, in s."""
WRONG_TYPE: Final = "Wrong type"
"""The pipeline's message about what is no road test, or has no points."""


class End(StrEnum):
    """End of a generator."""

    OVER = "over"
    """The budget was spent."""
    RETURNED = "returned"
    """Its ``start`` returned before that."""
    EXIT = "exit"
    """It ended its process by itself."""
    CRASHED = "crashed"
    """It raised, or its process died."""
    HUNG = "hung"
    """It asked for no test for too long and was ended."""
    GAVE_UP = "gave up"
    """The bench ended it because its roads or drives were bad for too long."""


@dataclass(frozen=True)
class RunEnding:
    """End of a generator, and its reason."""

    end: End
    detail: str = ""
    """One line."""

    def __str__(self) -> str:
        return f"{self.end}: {self.detail}" if self.detail else str(self.end)


class GeneratorStrategy(ObservingStrategy):
    """Passes on a generator's roads, and their results to the generator.

    The generator uses the pipeline's interface and cannot be asked twice, so it serves one worker,
    and its campaign cannot be resumed.

    Args:
        process: runs the generator; entered already.
        tester: tests its roads.
        simulations: budget in executed tests.
        seconds_per_test: virtual s that each of them costs.
        patience: s of wall time that the generator may take between two tests.
        seed: of the generator, for the campaign's record.
    """

    def __init__(
        self,
        process: GeneratorProcess,
        tester: RoadTester,
        *,
        simulations: int,
        seconds_per_test: float,
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
        self._left = simulations
        self._simulations = simulations
        self._seconds_per_test = seconds_per_test
        self._patience = patience
        self._ledger = Ledger()
        self._attempt: Attempt | None = None  # that is to be told

    def start(self) -> None:
        """Wait until the generator is built or has failed to be."""
        self._receive()

    def ask(self) -> Candidate:
        """Return the road of the next test that the generator wants executed.

        Raises:
            SearchEnded: it has ended.
        """
        if self.ending is None:
            message = self._receive()
            if message is not None:
                return self._candidate(pairs_of(message.get("road_points")))
        assert self.ending is not None
        raise SearchEnded(f"the generator ended ({self.ending})")

    def observe(self, attempt: Attempt) -> None:
        """Keep the attempt for the answer."""
        self._attempt = attempt

    def tell(self, evaluation: Evaluation) -> None:
        """Answer the test."""
        self._ledger.settle(evaluation)
        attempt, self._attempt = self._attempt, None
        self._left -= evaluation.outcome.is_simulated
        answer = {
            "outcome": str(evaluation.outcome),
            "description": WRONG_TYPE if evaluation.candidate.points is None else _reason(attempt),
            "records": self._records(evaluation, attempt),
            "spent": (self._simulations - self._left) * self._seconds_per_test,
        }
        self._send(answer)

    def dismiss(self) -> RunEnding:
        """Reports that the budget is spent, and waits until the generator has ended."""
        deadline = time.monotonic() + min(self._patience, CLOSING_LIMIT)
        while self.ending is None:
            self._send({"over": True})
            # A test that no longer counts, or its end.
            self._receive(deadline - time.monotonic(), "it went on when the budget was spent")
        return self.ending

    def _send(self, message: Mapping[str, Any]) -> None:
        with suppress(GeneratorLostError):  # its last words may still wait to be received
            self._process.send(message)

    def _receive(self, patience: float | None = None, hung: str = "") -> dict[str, Any] | None:
        """Return the generator's next message, None if it has ended; its reported time counts.

        Its questions about roads are answered meanwhile.

        Args:
            patience: wall time in s; by default the bench's patience.
            hung: why it is ended after that.
        """
        limit = self._patience if patience is None else patience
        deadline = time.monotonic() + limit
        try:
            while message := self._process.receive(max(0.0, deadline - time.monotonic())):
                if message.get("kind") not in ("valid", "overlaps"):
                    break
                self._send(self._judged(message))
        except GeneratorLostError as error:
            self.ending = RunEnding(End.CRASHED, str(error))
            return None
        if message is None:
            left = self._left * self._seconds_per_test
            asked = f"it asked for no test for {limit:.3g} s, with {left:.3g} s of its budget left"
            self.ending = RunEnding(End.HUNG, hung or asked)
            return None
        self.computing += float(message.get("seconds", 0.0))
        if message.get("kind") == "end":
            self.ending = self._ending_of(message)
            return None
        return message

    def _judged(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a question about a road."""
        if question["kind"] == "overlaps":
            left, right = np.array(question["left"]), np.array(question["right"])
            stands = (np.diff(0.5 * (left + right), axis=0) == 0.0).all(axis=1).any()
            return {"overlaps": bool(stands or overlaps_itself(left, right))}
        points = pairs_of(question["road_points"])
        if points is None:
            return {"valid": False, "description": WRONG_TYPE}
        verdict = check_validity(points, self._tester.terms.map_size)
        return {"valid": verdict.valid, "description": verdict.message}

    def _ending_of(self, message: Mapping[str, Any]) -> RunEnding:
        """Return the end that the generator reports."""
        end, detail = End(message["end"]), " ".join(message["detail"].split())[:450]
        if self._left <= 0 and (end is End.RETURNED or detail == "exit code 0"):
            end, detail = End.OVER, ""
        return RunEnding(end, detail)

    def _candidate(self, points: FloatArray | None) -> Candidate:
        curvatures, step = np.empty(0), 1.0
        if points is not None:
            try:
                road = road_through(points, self._tester.terms.lane_width)
            except RoadError:
                pass  # the tester says why
            else:
                curvatures, step = road.curvatures, road.step
        return self._ledger.issue(curvatures, step, Origin(OPERATOR), points)

    def _records(self, evaluation: Evaluation, attempt: Attempt | None) -> list[Any]:
        """Return the simulator's record as the pipeline's records."""
        candidate = evaluation.candidate
        if attempt is None or attempt.trajectory is None or attempt.pose is None:
            return []
        setting = self._tester.setting
        road = candidate.road(setting.lane_width, attempt.pose)
        drive = Drive(attempt.trajectory, setting.car, setting.rules_in({}))
        return simulation_records(road, drive)


def _reason(attempt: Attempt | None) -> str:
    if attempt is None or attempt.worker_lost:
        return "The simulator broke"
    return attempt.result.reason


def pairs_of(points: Any) -> FloatArray | None:
    """Road points as (N, 2) m; None if they are no pairs of finite numbers."""
    try:
        array = np.array(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    if array.shape == (0,):
        return np.empty((0, 2))
    if array.ndim != 2 or array.shape[1] != 2 or not np.isfinite(array).all():
        return None
    return array
