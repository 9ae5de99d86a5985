"""The strategy that minimises a failing road: it proposes smaller roads that may fail as well."""

from __future__ import annotations

import math
from enum import StrEnum
from itertools import zip_longest
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.clusters import THRESHOLD
from frenetic.conditions.condition import condition_names, without
from frenetic.criteria.criterion import LANE
from frenetic.errors import Fault
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding
from frenetic.rerun.shrinker import Shape, Shrinker, TrialResult, Trials
from frenetic.road import profile
from frenetic.search.archive import critical_places
from frenetic.search.conditions import moved_along
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy
from frenetic.simulators.conditions import Conditions

GUARD: Final = 0.02
"""Relative change of the curvatures in a road's neighbours, which must fail as well; our choice."""
OPERATOR: Final = "minimise"
"""Operator in the origin of the tried roads."""
_MAX_BISECTIONS: Final = 6
"""Largest number of trials per condition; our choice."""
_FAR_VIEW: Final = 200.0
"""Largest view that is tried in place of an infinite usual one, in m; our choice."""
_BEGINNING_SAMPLES: Final = 3
"""Number of first samples by which two roads begin alike; our choice."""
_MINIMAL: Final = "nothing smaller was found to fail"


class FailureReason(StrEnum):
    """Reason of a failed drive."""

    LEFT_LANE_LEFT = "left the lane to the left"
    LEFT_LANE_RIGHT = "left the lane to the right"
    STOOD_STILL = "stood still"
    RAN_OUT_OF_TIME = "ran out of time"
    EXCEEDED_A_LIMIT = "exceeded a limit"
    DRIVER_BROKE = "the driver broke"

    @classmethod
    def of(
        cls,
        finding: Finding | None,
        duration: float | None,
        timeout: float,
        fault: Fault | None = None,
    ) -> FailureReason:
        """Return the reason of a failed drive.

        Args:
            finding: gravest breach of a criterion; None if none was breached.
            duration: simulated time, in s.
            timeout: longest allowed time of a drive on the road, in s.
            fault: fault of the driver that ended the drive; None if the driver did not break.
        """
        if fault is not None:
            return cls.DRIVER_BROKE
        if finding is not None and finding.criterion != LANE:
            return cls.EXCEEDED_A_LIMIT
        if finding is not None:
            return cls.LEFT_LANE_LEFT if finding.side == "left" else cls.LEFT_LANE_RIGHT
        return cls.RAN_OUT_OF_TIME if (duration or 0.0) > timeout else cls.STOOD_STILL


class Minimising(Strategy):
    """Strategy that proposes a failing road, then smaller roads that may fail alike.

    It proposes one road at a time and waits for the result. Two failures are alike if their reasons
    and their kinds of cause are equal, and road, offsets and speeds before them differ at most by
    `THRESHOLD`, as the failures that count as one distinct failure do.

    Args:
        start: shape of the failing road.
        rules: rules by which drives fail.
        conditions: conditions in which the road fails.
        usual: usual amounts of these conditions, as far as they are known.
        speed_limits: speed limits of the failing road, (k, 2) in m and km/h, which may begin
            between samples; the limits of smaller roads begin at samples. None without limits.
    """

    BEHAVIOUR: Final = 2
    expects_failures: ClassVar[bool] = True

    def __init__(
        self,
        start: Shape,
        rules: Rules,
        conditions: Conditions,
        usual: Conditions,
        speed_limits: FloatArray | None = None,
    ) -> None:
        self.options = {"curvatures": list(start.values), "step": start.step}
        self._start, self._start_limits = start, speed_limits
        if start.slopes:
            self.options["slopes"] = [list(sample) for sample in start.slopes]
        if conditions:
            self.options |= {"conditions": dict(conditions), "usual": dict(usual)}
        self.smallest: Candidate | None = None
        """Smallest road so far, in the plainest conditions; None until the first road failed."""
        self.passes: dict[str, float] = {}
        """Condition -> amount nearer to the usual amount with which the smallest road passes."""
        self._usual = usual
        self._conditions = dict(conditions)
        # Conditions that are tried on the smallest road; None while other roads are tried
        self._tried_conditions: Conditions | None = None
        self._last_candidates: dict[Shape, Candidate] = {}
        self.shrinker: Shrinker | None = None
        """Shrinker of the first road; None until that road has failed."""
        self.is_minimal = False
        """Whether everything was tried and nothing smaller fails."""
        self._rules = rules
        self._next_shape: Shape | None = start  # to be proposed; None while a result is awaited
        self._trials: Trials[None] | None = None
        self.failure: _DriveFailure | None = None
        """Failure of the first road."""
        self._ledger = Ledger()

    def ask(self) -> Candidate | None:
        """Return the next road; None while a result is awaited."""
        if self._next_shape is None:
            if len(self._ledger):
                return None
            raise SearchEnded(_MINIMAL if self.is_minimal else "the road does not fail")
        shape, self._next_shape = self._next_shape, None
        notes: dict[str, Any] = {}
        if self.shrinker is not None:
            best = self.shrinker.best
            notes = {"pass": self.shrinker.pass_name, "length": best.length, "curves": best.curves}
        candidate = self._ledger.issue(
            np.array(shape.values),
            shape.step,
            Origin(OPERATOR),
            notes=notes,
            conditions=self._conditions_on(shape),
            **self._profiles_of(shape),
        )
        self._last_candidates[shape] = candidate
        return candidate

    def _profiles_of(self, shape: Shape) -> dict[str, Any]:
        """Return name -> profile of a road's slopes, widening and speed limits."""
        stations = np.arange(len(shape)) * shape.step
        profiles: dict[str, FloatArray] = {
            name: profile.plainer(name, np.column_stack([stations, column]))
            for name, column in zip(profile.NAMES, zip(*shape.slopes, strict=True), strict=False)
            if any(column)
        }
        if shape == self._start and self._start_limits is not None:
            profiles[profile.LIMITS] = self._start_limits
        return profiles

    @property
    def conditions(self) -> Conditions:
        """Conditions in which the smallest road fails."""
        return self._conditions if self.smallest is None else self.smallest.conditions

    def _conditions_on(self, shape: Shape) -> Conditions:
        """Return the conditions for a road, with obstacles where they are on the smallest road.

        An obstacle keeps its distance from the road's start if the two roads begin alike, otherwise
        its distance from the road's end.
        """
        if self._tried_conditions is not None:
            return self._tried_conditions
        if self.shrinker is None:
            return self.conditions
        best = self.shrinker.best
        count = min(len(best), len(shape), _BEGINNING_SAMPLES)
        begins_alike = shape.step == best.step and np.allclose(
            shape.values[:count], best.values[:count], rtol=2.0 * GUARD, atol=1e-12
        )
        distance = 0.0 if begins_alike else shape.length - best.length
        return moved_along(self.conditions, distance)

    def _run_trials(self) -> Trials[None]:
        """Leave conditions out, then shrink the road, then move conditions to usual amounts."""
        assert self.shrinker is not None
        for name in condition_names(self.conditions):
            yield from self._try_conditions(without(self.conditions, name))
        yield from self.shrinker.run()
        for name in condition_names(self.conditions):
            yield from self._move_to_usual(name)

    def _try_conditions(self, conditions: Conditions) -> Trials[bool]:
        """Try the smallest road in other conditions, and keep them if it fails there.

        Returns:
            Whether the road fails there.
        """
        assert self.shrinker is not None
        self._tried_conditions = conditions
        result = yield self.shrinker.best
        self._tried_conditions = None
        if result is TrialResult.YES:
            self.smallest = self._last_candidates[self.shrinker.best]
        return result is TrialResult.YES

    def _move_to_usual(self, name: str) -> Trials[None]:
        """Move an amount towards the usual one as far as the road still fails, by bisection."""
        if (yield from self._try_conditions(without(self.conditions, name))):
            return  # now that it is shorter, the road fails without the condition
        fails, usual = self.conditions[name], self._usual.get(name)
        if usual is None:
            return
        passes = usual if math.isfinite(usual) else max(2.0 * fails, _FAR_VIEW)
        for _ in range(_MAX_BISECTIONS):
            middle = float(f"{0.5 * (fails + passes):.2g}")
            if not min(fails, passes) < middle < max(fails, passes):
                break  # no number with two digits is between them
            if (yield from self._try_conditions({**self.conditions, name: middle})):
                fails = middle
            else:
                passes = middle
        self.passes[name] = passes

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result of the road that was proposed last.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        candidate = self._ledger.settle(evaluation)
        failure = self._failure_of(evaluation, candidate)
        if self._trials is None:
            if failure is not None:
                self.failure = failure
                self.shrinker = Shrinker(
                    shape_of(candidate),
                    lambda shape: (shape.scaled(1.0 - GUARD), shape.scaled(1.0 + GUARD)),
                    None if evaluation.finding is None else evaluation.finding.distance,
                )
                self.smallest = candidate
                self._trials = self._run_trials()
                self._advance(None)
            return
        if evaluation.outcome is Outcome.INVALID:
            self._advance(TrialResult.REFUSED)
        else:
            self._advance(TrialResult.YES if self._is_like_first(failure) else TrialResult.NO)

    def _advance(self, result: TrialResult | None) -> None:
        """Give the trials the last result, None at their start; take over the next shape."""
        assert self._trials is not None
        assert self.shrinker is not None
        best = self.shrinker.best
        try:
            # A generator is started with None.
            self._next_shape = self._trials.send(result)  # type: ignore[arg-type]
        except StopIteration:
            self.is_minimal = True
        if self.shrinker.best != best:
            self.smallest = self._last_candidates[self.shrinker.best]

    def _failure_of(self, evaluation: Evaluation, candidate: Candidate) -> _DriveFailure | None:
        """Return the failure of a drive; None unless it failed."""
        if evaluation.outcome is not Outcome.FAIL:
            return None
        timeout = self._rules.timeout(candidate.length)
        fault = evaluation.fault
        reason = FailureReason.of(evaluation.finding, evaluation.duration, timeout, fault)
        approach = critical_places(evaluation, candidate, 0.0)[0].vector
        return _DriveFailure(reason, approach, evaluation.objective, fault)

    def _is_like_first(self, failure: _DriveFailure | None) -> bool:
        """Return whether a failure is like the first road's; a drive that passed (None) is not."""
        first = self.failure
        if failure is None or first is None or failure.reason is not first.reason:
            return False
        if failure.fault is not None:
            return failure.fault.is_like(first.fault)
        if failure.cause != first.cause:
            return False
        return float(np.linalg.norm(failure.approach - first.approach)) <= THRESHOLD


class _DriveFailure(NamedTuple):
    """Values of a failure by which it is compared with another one."""

    reason: FailureReason
    """Reason of the failure."""
    approach: FloatArray
    """Road, offsets and speeds before the failure, (64,) in m, see `frenetic.search.approach`."""
    cause: float | None
    """Number of the kind of cause, see `frenetic.segments.causes.kind_number`."""
    fault: Fault | None
    """Fault of the driver that ended the drive; None if the driver did not break."""


def shape_of(road: Candidate) -> Shape:
    """Return the shape of a candidate's road."""
    stations = np.arange(len(road.curvatures)) * road.step
    columns = [
        () if values is None else profile.values_of(name, values, stations).tolist()
        for name, values in ((name, getattr(road, name)) for name in profile.NAMES)
    ]
    slopes = tuple(zip_longest(*columns, fillvalue=0.0))
    return Shape(tuple(road.curvatures), road.step, slopes)
