"""The shortest and plainest road on which a driver still has the same failure.

The roads that are tried are a campaign of their own, so minimising goes on where it was
interrupted. `Minimising` is its strategy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, ClassVar, Final, NamedTuple, Unpack

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import require_count
from frenetic.analysis.causes import kind_number
from frenetic.analysis.failures import THRESHOLD, CauseGroup, Failure
from frenetic.campaign.database import DATABASE
from frenetic.campaign.guarded_strategy import replay
from frenetic.campaign.objective import Objective
from frenetic.campaign.record import Test
from frenetic.campaign.second_drive import Match
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import in_words, named, quantity, without
from frenetic.criteria.criterion import LANE
from frenetic.errors import (
    BREAKS_PROTOCOL,
    ENDS_ITS_PROCESS,
    HANGS,
    IS_KILLED,
    CampaignError,
    CampaignGoneError,
    Fault,
    FreneticError,
)
from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding
from frenetic.rerun.campaigns import How, campaign_again, complete
from frenetic.rerun.shrinker import Answer, Shape, Shrinker, Trials
from frenetic.road import Road, profile
from frenetic.search.archive import places_of
from frenetic.search.conditions import moved_along
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy
from frenetic.simulators.conditions import Conditions, usual_conditions
from frenetic.spec import Budget

MAX_DRIVES: Final = 500
"""Default for the most drives per road."""
GUARD: Final = 0.02
"""Share by which the curvatures of a road's neighbours differ, which must fail as well."""
OPERATOR: Final = "minimise"
"""Operator in the origin of the tried roads."""
LEAST_EACH: Final = 50
"""Drives with which most roads come near their final length."""
MOST_EACH: Final = 120
"""Drives after which hardly any gets shorter."""
CAUSE: Final = f"{kind_number.__module__}:{kind_number.__name__}"
"""Objective of the campaigns that drive."""
_BISECTIONS: Final = 6
_FAR: Final = 200.0
"""Amount in m that stands for the usual one of a view without end."""
_MINIMAL: Final = "nothing smaller was found to fail"


class FailureReason(StrEnum):
    """Reason of a failed drive. Two drives failed for the same reason if these are equal."""

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
        """The reason of a failed drive.

        Args:
            finding: gravest breach of a criterion; None if there is none.
            duration: simulated time in s.
            timeout: s that the road's drive may take.
            fault: the driver's, if it ended the drive.
        """
        if fault is not None:
            return cls.DRIVER_BROKE
        if finding is not None and finding.criterion != LANE:
            return cls.EXCEEDED_A_LIMIT
        if finding is not None:
            return cls.LEFT_LANE_LEFT if finding.side == "left" else cls.LEFT_LANE_RIGHT
        return cls.RAN_OUT_OF_TIME if (duration or 0.0) > timeout else cls.STOOD_STILL


class Ending(StrEnum):
    """Reason for the end of minimising."""

    MINIMAL = "minimal"
    """No pass finds anything smaller."""
    SPENT = "spent"
    """The allowed drives or time are spent."""
    STOPPED = "stopped"
    """It was interrupted, or gave up: the same call goes on."""


class Minimising(Strategy):
    """Proposes a failing road, and then ever smaller ones that may have the same failure.

    It waits for each result. A road has the same failure if reason and kind of cause are the same,
    and road, offsets and speeds before it differ by no more than within one distinct failure.

    Args:
        start: the failing road.
        rules: by which drives fail.
        conditions: in which it fails.
        usual: what is usual of these, as far as it is known.
        speed_limits: speed limits of the failing road, (k, 2) in m and km/h. On smaller roads a
            limit begins at a sample.
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
        self._start, self._limits = start, speed_limits
        if start.slopes:
            self.options["slopes"] = [list(pair) for pair in start.slopes]
        if conditions:
            self.options |= {"conditions": dict(conditions), "usual": dict(usual)}
        self.smallest: Candidate | None = None
        """The smallest road so far, in its plainest conditions."""
        self.passes: dict[str, float] = {}
        """Quantity -> amount nearer to the usual one with which the smallest road does not fail."""
        self._usual = usual
        self._conditions = dict(conditions)
        self._trying: Conditions | None = None  # in place of those of the smallest
        self._tried: dict[Shape, Candidate] = {}  # the last of each
        self.shrinker: Shrinker | None = None
        """The smallest road so far; None until the first one has failed."""
        self.is_minimal = False
        """Whether no pass finds anything smaller."""
        self._rules = rules
        self._next: Shape | None = start
        self._run: Trials[None] | None = None
        self.failure: _Found | None = None
        """That of the first road."""
        self._ledger = Ledger()

    def ask(self) -> Candidate | None:
        """The next road; None while it is tried."""
        if self._next is None:
            if len(self._ledger):
                return None
            raise SearchEnded(_MINIMAL if self.is_minimal else "the road does not fail")
        shape, self._next = self._next, None
        notes: dict[str, Any] = {}
        if self.shrinker is not None:
            best = self.shrinker.best
            notes = {"pass": self.shrinker.work, "length": best.length, "curves": best.curves}
        values = np.array(shape.values)
        stations = np.arange(len(values)) * shape.step
        profiles: dict[str, FloatArray] = {
            name: profile.plainer(name, np.column_stack([stations, column]))
            for name, column in zip(profile.NAMES, zip(*shape.slopes, strict=True), strict=False)
            if any(column)
        }
        if shape == self._start and self._limits is not None:
            profiles[profile.LIMITS] = self._limits
        origin = Origin(OPERATOR)
        own: dict[str, Any] = {"conditions": self._conditions_on(shape), **profiles}
        candidate = self._ledger.issue(values, shape.step, origin, notes=notes, **own)
        self._tried[shape] = candidate
        return candidate

    @property
    def conditions(self) -> Conditions:
        """Conditions in which the smallest road fails."""
        return self._conditions if self.smallest is None else self.smallest.conditions

    def _conditions_on(self, shape: Shape) -> Conditions:
        """Conditions for a road: what lies on it stays where it was on the smallest one.

        That is at its distance from the end if the roads begin differently.
        """
        if self._trying is not None:
            return self._trying
        if self.shrinker is None:
            return self.conditions
        best = self.shrinker.best
        count = min(len(best), len(shape), 3)
        begins_alike = shape.step == best.step and np.allclose(
            shape.values[:count], best.values[:count], rtol=2.0 * GUARD, atol=1e-12
        )
        return moved_along(self.conditions, 0.0 if begins_alike else shape.length - best.length)

    def _work(self) -> Trials[None]:
        """Leaves conditions out, then shrinks the road, then moves conditions towards the usual."""
        assert self.shrinker is not None
        for name in named(self.conditions):
            yield from self._in_conditions(without(self.conditions, name))
        yield from self.shrinker.run()
        for name in named(self.conditions):
            yield from self._towards_usual(name)

    def _in_conditions(self, conditions: Conditions) -> Trials[bool]:
        """Tries the smallest road in other conditions, and keeps them if it fails there."""
        assert self.shrinker is not None
        self._trying = conditions
        answer = yield self.shrinker.best
        self._trying = None
        if answer is Answer.YES:
            self.smallest = self._tried[self.shrinker.best]
        return answer is Answer.YES

    def _towards_usual(self, name: str) -> Trials[None]:
        """Moves an amount towards the usual one as far as the failure lasts, by bisection."""
        if (yield from self._in_conditions(without(self.conditions, name))):
            return  # the shorter road does not need it
        fails, usual = self.conditions[name], self._usual.get(name)
        if usual is None:
            return
        passes = usual if math.isfinite(usual) else max(2.0 * fails, _FAR)
        for _ in range(_BISECTIONS):
            middle = float(f"{0.5 * (fails + passes):.2g}")
            if not min(fails, passes) < middle < max(fails, passes):
                break
            if (yield from self._in_conditions({**self.conditions, name: middle})):
                fails = middle
            else:
                passes = middle
        self.passes[name] = passes

    def tell(self, evaluation: Evaluation) -> None:
        """Takes the result of the road that was proposed last.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        candidate = self._ledger.settle(evaluation)
        found = self._failure_of(evaluation, candidate)
        if self._run is None:
            if found is not None:
                self.failure = found
                self.shrinker = Shrinker(
                    _shape_of(candidate),
                    lambda shape: (shape.scaled(1.0 - GUARD), shape.scaled(1.0 + GUARD)),
                    place=None if evaluation.finding is None else evaluation.finding.distance,
                )
                self.smallest = candidate
                self._run = self._work()
                self._advance(None)
            return
        if evaluation.outcome is Outcome.INVALID:
            self._advance(Answer.REFUSED)
        else:
            self._advance(Answer.YES if self._is_like(found) else Answer.NO)

    def _advance(self, answer: Answer | None) -> None:
        assert self._run is not None
        assert self.shrinker is not None
        best = self.shrinker.best
        try:
            # A generator is started with None.
            self._next = self._run.send(answer)  # type: ignore[arg-type]
        except StopIteration:
            self.is_minimal = True
        if self.shrinker.best != best:
            self.smallest = self._tried[self.shrinker.best]

    def _failure_of(self, evaluation: Evaluation, candidate: Candidate) -> _Found | None:
        if evaluation.outcome is not Outcome.FAIL:
            return None
        timeout = self._rules.timeout(candidate.length)
        fault = evaluation.fault
        reason = FailureReason.of(evaluation.finding, evaluation.duration, timeout, fault)
        approach = places_of(evaluation, candidate, 0.0)[0].vector
        return _Found(reason, approach, evaluation.objective, fault)

    def _is_like(self, found: _Found | None) -> bool:
        first = self.failure
        if found is None or first is None or found.reason is not first.reason:
            return False
        if found.fault is not None:
            return found.fault.is_like(first.fault)
        if found.cause != first.cause:
            return False
        return float(np.linalg.norm(found.approach - first.approach)) <= THRESHOLD


class _Found(NamedTuple):
    """A failure of a drive."""

    reason: FailureReason
    approach: FloatArray
    """Approach to its place, (64,) in m."""
    cause: float | None
    """See `kind_number`."""
    fault: Fault | None


@dataclass(frozen=True, eq=False)
class Minimised:
    """The result of minimising a failing road."""

    original: Test
    """The drive on the road."""
    passes: Conditions
    """Quantity of its conditions -> amount nearer to the usual one with which it does not fail."""
    smallest: Test
    """The drive on the smallest road with the same failure; possibly the original."""
    reason: FailureReason
    """Why the drives on both roads failed."""
    drives: int
    """Number of all drives on the road and smaller ones, also of earlier calls."""
    new_drives: int
    """Number of the drives that this call made."""
    folder: str
    """Name of their campaign's folder in ``again`` of the campaign whose road it is."""
    ending: Ending
    trouble: str | None
    """Reason for giving up, if any: the simulator or driver broke repeatedly."""
    is_guarded: bool
    """Whether it fails, too, with all curvatures smaller or larger by `GUARD`."""
    match: Match | None = None
    """How the original fails now, beside the failure that its campaign recorded; None without a
    campaign."""

    @property
    def difference(self) -> float:
        """Difference of the failures on both roads in m, at most that within a cluster.

        Faults of the driver at the same line are the same failure, wherever they happen.
        """
        if self.smallest.result.fault is not None:
            return 0.0
        before, after = Failure.of_test(self.original), Failure.of_test(self.smallest)
        assert before is not None
        assert after is not None
        return after.difference(before)

    @property
    def conditions(self) -> Conditions:
        """Conditions in which the smallest road fails."""
        return self.smallest.candidate.conditions

    def conditions_in_words(self) -> str:
        """These, and the nearest usual amounts with which it does not; empty without any."""
        texts = in_words(self.conditions)
        bounds = [f"{quantity(name).text(value)}" for name, value in self.passes.items()]
        return f"{texts}; not with {' or '.join(bounds)}" if bounds else texts

    @property
    def road(self) -> Road:
        """The smallest road."""
        return self.smallest.road

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """The original road and the smallest without their places."""
        return _shape_of(self.original.candidate), _shape_of(self.smallest.candidate)


def _shape_of(road: Candidate) -> Shape:
    """A candidate's road without its place."""
    stations = np.arange(len(road.curvatures)) * road.step
    columns = [
        () if values is None else profile.values_of(name, values, stations).tolist()
        for name, values in ((name, getattr(road, name)) for name in profile.NAMES)
    ]
    slopes = tuple(zip_longest(*columns, fillvalue=0.0))
    return Shape(tuple(road.curvatures), road.step, slopes)


def minimise(
    road: Road,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    seconds: float | None = None,
    folder: Path | str | None = None,
    conditions: Conditions = MappingProxyType({}),
    **how: Unpack[How],
) -> Minimised:
    """The smallest road found with the same failure, in the plainest conditions.

    Smaller is shorter, or as long and plainer, in the order of `frenetic.rerun.shrinker.Shape`.
    Every kept road is valid, was driven and has the failure, and so did
    two neighbours of it, with all curvatures smaller and larger by `GUARD`: the failure survives a
    slight change. Where those of the original do not fail, roads are kept without such
    neighbours until one with them is found. No road is driven twice, and the result is
    deterministic.

    Args:
        road: fails.
        tester: drives roads on the terms of the failure.
        max_drives: most drives to spend; refused roads cost none.
        seconds: most wall time to spend; None for any.
        conditions: in which the road fails. Those that the failure does not need are left out; the
            others are moved towards the usual ones as far as the failure lasts.
        folder: of the campaign whose road it is, which keeps the drives; by default none are kept.
        how: see `How`.

    Raises:
        FreneticError: the road does not fail.
        CampaignError: as for `frenetic.rerun.campaigns.campaign_again`.
        ValueError: a number is out of range, or the road has other lanes than the tester.
    """
    max_drives = require_count("max_drives", max_drives)
    terms = tester.terms
    if road.lane_width != terms.lane_width:
        raise ValueError(
            f"the road's lanes are {road.lane_width:g} m wide, those of the tester"
            f" {terms.lane_width:g} m: they have to agree"
        )
    profiles = {name: getattr(road, name) for name in profile.NAMES}
    if terms.road_class is not None:
        # It says itself how a shorter road leans and widens.
        usual = terms.road_class.profiles(road.curvatures, road.step)
        for name, values in usual.items():
            if np.array_equal(profiles[name], values):
                profiles[name] = None
    start = _shape_of(
        Candidate(
            1,
            road.curvatures,
            road.step,
            Origin(OPERATOR),
            **profiles,
        )
    )
    usual = usual_conditions(conditions, tester.simulator) | {
        name: amount for name, amount in terms.conditions.items() if name in conditions
    }
    limits = road.speed_limits if len(road.speed_limits) else None
    strategy = Minimising(start, tester.simulator.rules, conditions, usual, limits)
    budget, trouble = Budget(simulations=max_drives, time=seconds), None
    with TemporaryDirectory() as temporary:
        campaign = campaign_again(
            temporary if folder is None else folder,
            strategy,
            tester,
            budget,
            what=strategy.options,
            objective=CAUSE,
            terms={"minimised": True},
            how=how,
        )
        before = _simulations(campaign.folder)
        try:
            complete(campaign, how)
        except CampaignGoneError:
            raise
        except CampaignError as error:
            if strategy.shrinker is None:
                raise
            trouble = str(error)
        with CampaignStore.open(campaign.folder) as store:
            if strategy.shrinker is None:  # nothing was left to be driven
                strategy = Minimising(start, tester.simulator.rules, conditions, usual, limits)
                replay(store, strategy, budget, Objective.load(CAUSE))
            return _minimised(store, strategy, max_drives, trouble, before)


def _simulations(folder: Path) -> int:
    """Return the number of drives that a campaign holds; 0 without one."""
    if not (folder / DATABASE).is_file():
        return 0
    with CampaignStore.open(folder) as store:
        return store.counts().simulations


def _minimised(
    store: CampaignStore, strategy: Minimising, max_drives: int, trouble: str | None, before: int
) -> Minimised:
    tested = next(store.tests(), None)
    if tested is None:
        raise KeyboardInterrupt  # before anything was driven
    if strategy.shrinker is None or strategy.smallest is None or strategy.failure is None:
        raise FreneticError(
            f"only a road that fails can be minimised; this one is {tested.outcome}:"
            f" {tested.reason}"
        )
    drives = store.counts().simulations
    is_stopped = trouble is not None or bool(store.facts.get("interrupted"))
    ending = Ending.STOPPED if is_stopped and drives < max_drives else Ending.SPENT
    return Minimised(
        original=store.test(1),
        passes=dict(strategy.passes),
        smallest=store.test(strategy.smallest.id),
        reason=strategy.failure.reason,
        drives=drives,
        new_drives=drives - before,
        folder=store.folder.name,
        ending=Ending.MINIMAL if strategy.is_minimal else ending,
        trouble=trouble,
        is_guarded=strategy.shrinker.is_guarded,
    )


def minimise_causes(
    folder: Path | str,
    causes: Sequence[CauseGroup],
    tester: RoadTester,
    drives: int,
    seconds: float | None = None,
    **how: Unpack[How],
) -> Iterator[tuple[int, Minimised | FreneticError]]:
    """Minimises a failure of each cause, of the first ones first.

    Each gets the same share of the drives, at most `MOST_EACH`; causes for which less than
    `LEAST_EACH` were left get none, nor do drivers that hang or end their process, which takes
    long. An interruption ends it.

    Args:
        folder: of the campaign.
        causes: of its failures, the most frequent ones first.
        tester: drives as the campaign did.
        drives: most drives for all of them.
        seconds: most wall time for all of them; less may shorten them less. None for any.
        how: see `How`.

    Yields:
        Id of a test, and the minimised road or why there is none: it does not fail again, say.
    """
    lasting = HANGS, ENDS_ITS_PROCESS, IS_KILLED, BREAKS_PROTOCOL
    quick = [cause for cause in causes if not (cause.fault and cause.fault.kind in lasting)]
    chosen = quick[: max(1, drives // LEAST_EACH)]
    if not chosen:
        return
    with CampaignStore.open(folder) as store:
        tests = [store.test(cause.example) for cause in chosen]
    most = max(LEAST_EACH, min(MOST_EACH, drives // len(tests)))
    share = None if seconds is None else seconds / len(tests)
    for test in tests:
        try:
            found = minimise_test(folder, test, tester, max_drives=most, seconds=share, **how)
        except CampaignGoneError:
            raise
        except FreneticError as error:
            yield test.id, error
            continue
        yield test.id, found
        if found.ending is Ending.STOPPED:
            return


def minimise_test(
    folder: Path | str,
    test: Test,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    seconds: float | None = None,
    kept: Path | str | None = None,
    **how: Unpack[How],
) -> Minimised:
    """Minimises a campaign's failing road, and says whether it still fails as recorded.

    Args:
        folder: of the campaign.
        test: the test.
        tester: as for `minimise`, like the other arguments.
        max_drives: see there.
        seconds: see there.
        kept: folder for the drives; by default the campaign's.
        how: see there.

    Raises:
        FreneticError: as for `minimise`.
        ValueError: likewise.
    """
    place = folder if kept is None else kept
    minimised = minimise(
        test.road,
        tester,
        conditions=test.candidate.conditions,
        max_drives=max_drives,
        seconds=seconds,
        folder=place,
        **how,
    )
    with CampaignStore.open(folder) as store:
        recorded = Failure.of_test(store.test(test.id))
    now = Failure.of_test(minimised.original)
    difference = None if recorded is None or now is None else recorded.difference(now)
    return replace(minimised, match=Match.of(test, minimised.original, difference))
