"""Minimise failing roads: find the shortest and plainest road with the same failure.

`frenetic.rerun.minimising_strategy` proposes roads. The drives on them are a campaign, so an
interrupted call continues when it is repeated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Final, Unpack

import numpy as np

from frenetic._support.bounds import require_count
from frenetic.analysis.clusters import CauseGroup
from frenetic.analysis.failures import Failure
from frenetic.campaign.database import DATABASE
from frenetic.campaign.objective import Objective
from frenetic.campaign.record import Test
from frenetic.campaign.replay import replay
from frenetic.campaign.second_drive import Match
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import as_text, condition_named
from frenetic.errors import (
    BREAKS_PROTOCOL,
    ENDS_ITS_PROCESS,
    HANGS,
    IS_KILLED,
    CampaignError,
    CampaignGoneError,
    FreneticError,
)
from frenetic.rerun.campaigns import DrivingOptions, DrivingPlan, drive_missing, driving_campaign
from frenetic.rerun.minimising_strategy import OPERATOR, FailureReason, Minimising, shape_of
from frenetic.rerun.shrinker import Shape
from frenetic.road import Road, profile
from frenetic.road.classes import RoadClass
from frenetic.search.records import Candidate, Origin
from frenetic.segments.causes import kind_number
from frenetic.simulators.conditions import Conditions, usual_conditions
from frenetic.spec import Budget

MAX_DRIVES: Final = 500
"""Default of the most drives per road; our choice."""
MIN_DRIVES_PER_CAUSE: Final = 50
"""Fewest drives for the road of a cause: with them most roads come near their final length; our
choice."""
MAX_DRIVES_PER_CAUSE: Final = 120
"""Largest number of drives for the road of a cause; more hardly shorten it; our choice."""
CAUSE: Final = f"{kind_number.__module__}:{kind_number.__name__}"
"""Name of the objective, the kind of the failure's cause, of campaigns that minimise."""
_SLOW_FAULTS: Final = (HANGS, ENDS_ITS_PROCESS, IS_KILLED, BREAKS_PROTOCOL)
"""Kinds of faults of a driver that make each drive take long."""


class StopReason(StrEnum):
    """Reason for the end of minimising."""

    MINIMAL = "minimal"
    """No pass finds a smaller road."""
    SPENT = "spent"
    """The allowed drives or the allowed time are spent."""
    STOPPED = "stopped"
    """Minimising was interrupted or gave up: the same call continues it."""


@dataclass(frozen=True, eq=False)
class Minimised:
    """Result of minimising a failing road."""

    original: Test
    """Drive on the failing road."""
    passes: Conditions
    """Condition -> amount nearer to the usual amount with which the smallest road passes."""
    smallest: Test
    """Drive on the smallest road with the same failure; possibly the original."""
    reason: FailureReason
    """Reason for which the drives on both roads failed."""
    drives: int
    """Number of all drives, earlier calls included."""
    new_drives: int
    """Number of drives of this call."""
    folder: str
    """Name of the folder of the campaign that drove, in the folder ``rerun`` of the road's
    campaign."""
    stop_reason: StopReason
    """Reason why minimising ended."""
    error: str | None
    """Error by which minimising gave up, as when the simulator broke repeatedly; None otherwise."""
    is_guarded: bool
    """Whether the smallest road also fails with all curvatures smaller or larger by `GUARD`."""
    match: Match | None = None
    """Match of the original road's failure in this call with the failure that its campaign
    recorded; None if the road is of no campaign."""

    @property
    def difference(self) -> float:
        """Difference of the failures on both roads, in m, see `Failure.difference`.

        It is 0 for a fault of the driver: an error of the same line is the same failure, wherever
        on the road the line raises it.
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

    def conditions_text(self) -> str:
        """Return the conditions in words, with the amounts with which the smallest road passes."""
        text = as_text(self.conditions)
        passing = [condition_named(name).text(amount) for name, amount in self.passes.items()]
        return f"{text}; not with {' or '.join(passing)}" if passing else text

    @property
    def road(self) -> Road:
        """Smallest road."""
        return self.smallest.road

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Shapes of the original and the smallest road."""
        return shape_of(self.original.candidate), shape_of(self.smallest.candidate)


def minimise(
    road: Road,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    seconds: float | None = None,
    folder: Path | str | None = None,
    conditions: Conditions = MappingProxyType({}),
    **options: Unpack[DrivingOptions],
) -> Minimised:
    """Find the smallest road with the same failure, in the plainest conditions.

    A road is smaller if it is shorter, or as long and plainer, see `Shape.rank` of
    `frenetic.rerun.shrinker`. Each road that is kept is valid and failed when it was driven. So did
    its two neighbours, which have all curvatures smaller or larger by `GUARD`: a slight change does
    not cure the failure. If a neighbour of the original road passes, neighbours may pass until a
    road is found whose neighbours both fail. No road is driven twice, and the same call gives the
    same result.

    Args:
        road: failing road.
        tester: drives roads on the terms of the failure.
        max_drives: most drives to spend; refused roads cost none.
        seconds: most wall time to spend, in s; None for no limit.
        conditions: conditions in which the road fails. Conditions that the failure does not need
            are left out; the amounts of the others move towards the usual ones as far as the road
            still fails.
        folder: folder of the road's campaign, which keeps the drives; by default they are thrown
            away.
        options: see `DrivingOptions`.

    Raises:
        FreneticError: the road does not fail.
        CampaignError: see `frenetic.rerun.campaigns.driving_campaign`.
        ValueError: a number is out of range, or the lanes of road and tester differ in width.
    """
    max_drives = require_count("max_drives", max_drives)
    terms = tester.terms
    _require_equal_lanes(road, terms.lane_width)
    usual = usual_conditions(conditions, tester.simulator) | {
        name: amount for name, amount in terms.conditions.items() if name in conditions
    }
    new_strategy = partial(
        Minimising,
        _start_shape(road, terms.road_class),
        tester.simulator.rules,
        conditions,
        usual,
        road.speed_limits if len(road.speed_limits) else None,
    )
    strategy, error_text = new_strategy(), None
    plan = DrivingPlan(
        strategy,
        Budget(simulations=max_drives, time=seconds),
        identity=strategy.options,
        purpose={"minimised": True},
        objective=CAUSE,
    )
    with TemporaryDirectory() as temporary:
        driving_folder = temporary if folder is None else folder
        campaign = driving_campaign(driving_folder, plan, tester, options)
        before = _simulations(campaign.folder)
        try:
            drive_missing(campaign, options.get("on_event"))
        except CampaignGoneError:
            raise
        except CampaignError as error:
            if strategy.shrinker is None:
                raise
            error_text = str(error)
        with CampaignStore.open(campaign.folder) as store:
            if strategy.shrinker is None:  # the campaign was complete: tell the strategy its drives
                strategy = new_strategy()
                replay(store, strategy, plan.budget, Objective.load(CAUSE))
            return _minimised(store, strategy, max_drives, error_text, before)


def _require_equal_lanes(road: Road, lane_width: float) -> None:
    """Refuse a road whose lanes do not have the width of the tester's lanes, in m.

    Raises:
        ValueError: the widths differ.
    """
    if road.lane_width != lane_width:
        raise ValueError(
            f"the road's lanes are {road.lane_width:g} m wide, the tester's"
            f" {lane_width:g} m: they have to agree"
        )


def _start_shape(road: Road, road_class: RoadClass | None) -> Shape:
    """Return a road's shape, without the profiles that the road class gives the road by itself.

    The tester gives every road of the class such profiles, also shorter ones.
    """
    profiles = {name: getattr(road, name) for name in profile.NAMES}
    if road_class is not None:
        for name, values in road_class.profiles(road.curvatures, road.step).items():
            if np.array_equal(profiles[name], values):
                profiles[name] = None
    return shape_of(Candidate(1, road.curvatures, road.step, Origin(OPERATOR), **profiles))


def _simulations(folder: Path) -> int:
    """Return the number of drives that a campaign holds; 0 without one."""
    if not (folder / DATABASE).is_file():
        return 0
    with CampaignStore.open(folder) as store:
        return store.counts().simulations


def _minimised(
    store: CampaignStore, strategy: Minimising, max_drives: int, error: str | None, before: int
) -> Minimised:
    """Return the result of a strategy.

    Args:
        store: campaign with the strategy's drives.
        strategy: the strategy, which was told all drives.
        max_drives: most drives to spend.
        error: error by which the campaign gave up; None if it did not.
        before: number of drives of earlier calls.

    Raises:
        KeyboardInterrupt: there is no drive.
        FreneticError: the first road does not fail.
    """
    first = next(store.tests(), None)
    if first is None:
        raise KeyboardInterrupt  # Ctrl-C came before the first drive
    if strategy.shrinker is None or strategy.smallest is None or strategy.failure is None:
        raise FreneticError(
            f"only a road that fails can be minimised; this one is {first.outcome}: {first.reason}"
        )
    drives = store.counts().simulations
    is_stopped = error is not None or bool(store.facts.get("interrupted"))
    stop_reason = StopReason.STOPPED if is_stopped and drives < max_drives else StopReason.SPENT
    return Minimised(
        original=store.test(1),
        passes=dict(strategy.passes),
        smallest=store.test(strategy.smallest.id),
        reason=strategy.failure.reason,
        drives=drives,
        new_drives=drives - before,
        folder=store.folder.name,
        stop_reason=StopReason.MINIMAL if strategy.is_minimal else stop_reason,
        error=error,
        is_guarded=strategy.shrinker.is_guarded,
    )


def minimise_causes(
    folder: Path | str,
    causes: Sequence[CauseGroup],
    tester: RoadTester,
    drives: int,
    seconds: float | None = None,
    **options: Unpack[DrivingOptions],
) -> Iterator[tuple[int, Minimised | FreneticError]]:
    """Minimise one failure of each cause, in the order of the causes, until an interruption.

    Each cause gets the same share of the drives, within `MIN_DRIVES_PER_CAUSE` and
    `MAX_DRIVES_PER_CAUSE`. Of many causes, the last ones get none; the first one always gets its
    share. Causes that are a driver that hangs or loses its process are skipped, because each such
    drive takes long.

    Args:
        folder: folder of the campaign.
        causes: causes of the campaign's failures, the most frequent ones first.
        tester: drives as the campaign did.
        drives: most drives for all causes together; the first cause gets `MIN_DRIVES_PER_CAUSE`
            even if that is more.
        seconds: most wall time for all causes, in s; None for no limit. With less time, roads may
            stay longer.
        options: see `DrivingOptions`.

    Yields:
        Id of a test, and the minimised road or the error, such as a road that does not fail again.
    """
    quick = [cause for cause in causes if not (cause.fault and cause.fault.kind in _SLOW_FAULTS)]
    chosen = quick[: max(1, drives // MIN_DRIVES_PER_CAUSE)]
    if not chosen:
        return
    with CampaignStore.open(folder) as store:
        tests = [store.test(cause.example) for cause in chosen]
    max_drives = drives // len(tests)
    max_drives = max(MIN_DRIVES_PER_CAUSE, min(MAX_DRIVES_PER_CAUSE, max_drives))
    time = None if seconds is None else seconds / len(tests)
    for test in tests:
        try:
            result = minimise_test(
                folder, test, tester, max_drives=max_drives, seconds=time, **options
            )
        except CampaignGoneError:
            raise
        except FreneticError as error:
            yield test.id, error
            continue
        yield test.id, result
        if result.stop_reason is StopReason.STOPPED:
            return


def minimise_test(
    folder: Path | str,
    test: Test,
    tester: RoadTester,
    *,
    max_drives: int = MAX_DRIVES,
    seconds: float | None = None,
    drives_folder: Path | str | None = None,
    **options: Unpack[DrivingOptions],
) -> Minimised:
    """Minimise the road of a campaign's failed test, and match its failure with the recorded one.

    Args:
        folder: folder of the campaign.
        test: failed test of the campaign.
        tester: drives roads on the terms of the failure.
        max_drives: most drives to spend; refused roads cost none.
        seconds: most wall time to spend, in s; None for no limit.
        drives_folder: folder that keeps the drives; by default the campaign's folder.
        options: see `DrivingOptions`.

    Raises:
        FreneticError: the road does not fail, or for the reasons of `minimise`.
        ValueError: a number is out of range, or for the reasons of `minimise`.
    """
    minimised = minimise(
        test.road,
        tester,
        conditions=test.candidate.conditions,
        max_drives=max_drives,
        seconds=seconds,
        folder=folder if drives_folder is None else drives_folder,
        **options,
    )
    with CampaignStore.open(folder) as store:
        recorded = Failure.of_test(store.test(test.id))
    now = Failure.of_test(minimised.original)
    difference = None if recorded is None or now is None else recorded.difference(now)
    return replace(minimised, match=Match.of(test, minimised.original, difference))
