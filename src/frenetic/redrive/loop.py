"""The loop for driving roads again, by one process or several, each road in its conditions.

Robustness, confirmation and regression drive a campaign's roads as one batch and store each drive
before they report it. Minimising drives batch after batch, since each result decides on the next
road.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final, TypeAlias, TypedDict, Unpack

from frenetic._support.interrupt import catch_interrupt
from frenetic.analysis.failures import Failure
from frenetic.campaign.campaign import prepare
from frenetic.campaign.changes import version_notes
from frenetic.campaign.loop import MAX_ATTEMPTS
from frenetic.campaign.record import Attempt, TestRecord
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import Placement, RoadTester
from frenetic.campaign.workers import InProcessWorker, LocalWorkers, Workers
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.record import Purpose, Redrive, Run
from frenetic.redrive.table import RunWriter
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.drive import Drive, Trajectory
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import USUAL, Conditions
from frenetic.spec import describe, require_count

logger = logging.getLogger(__name__)

OPERATOR: Final = "redrive"
"""Operator in the origin of roads that are driven again."""
_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed


@dataclass(frozen=True)
class Task:
    """A road to be driven."""

    candidate: Candidate
    placement: Placement | None = None
    """Its place and conditions; None to fit it into the map like any candidate."""

    @classmethod
    def of(cls, number: int, record: TestRecord, conditions: Conditions = USUAL) -> Task:
        """A stored test as drive ``number`` of many.

        Raises:
            CampaignError: the test's road was refused, so that it lies nowhere.
        """
        candidate = record.candidate
        if record.pose is None or not record.outcome.is_test or record.outcome is Outcome.INVALID:
            raise CampaignError(
                f"test {candidate.id} is {record.outcome}: only a road that was driven can be"
                " driven again"
            )
        origin = Origin(OPERATOR, (candidate.id,), candidate.origin.generation)
        return cls(
            Candidate(number, candidate.curvatures, candidate.step, origin),
            Placement(Pose(*record.pose), conditions),
        )


class RedriveOptions(TypedDict, total=False):
    """Options of all that drives roads again."""

    workers: int
    """Number of roads driven at once, as for `Campaign`; 1 by default."""
    drive_limit: float | None
    """Wall time in s, likewise."""
    on_start: Callable[[], None] | None
    """Called when the simulator has started."""
    on_interrupt: Callable[[], None] | None
    """Called at the first Ctrl-C, which ends it after the running drives."""


DriveTasks: TypeAlias = Callable[[Iterable[Task]], Iterator[Attempt]]
"""Drives a batch of tasks with different numbers; gives the last attempt at each as it comes."""


@dataclass(frozen=True)
class RedriveProgress:
    """Progress of driving a campaign's roads again."""

    test_id: int
    """Test of the last drive."""
    drives: int
    total: int
    failed: int

    @property
    def tests(self) -> int:
        """Number of drives, where each test is driven once."""
        return self.drives


def campaign_tester(store: CampaignStore, simulator: Simulator, driver: Driver) -> RoadTester:
    """Drives a campaign's roads, possibly with other parts; warns of other versions of its own.

    Raises:
        CampaignError: the campaign's configuration is damaged.
    """
    setting = store.setting
    warn_of_versions(store, simulator, driver)
    return RoadTester(simulator, driver, setting.map_size, setting.margin, setting.lane_width)


def warn_of_versions(store: CampaignStore, simulator: Simulator, driver: Driver) -> None:
    """Logs a warning for each part that is another version of the campaign's.

    Of a campaign that was resumed with changed parts the warning says of which results.
    """
    firsts = [1, *(change.first for change in store.changes if change.what)]
    for first, following in zip_longest(firsts, firsts[1:]):
        if first == following:
            continue  # changed again before any result
        end = "on" if following is None else f"to {following - 1}"
        which = "" if len(firsts) == 1 else f"from result {first} {end}: "
        for note in version_notes(store.parts_of(first), simulator=simulator, driver=driver):
            logger.warning("%s%s", which, note)


def new_run(purpose: Purpose, tester: RoadTester, planned: int, **drawn: Any) -> Run:
    """A run without drives yet.

    Args:
        purpose: of the run.
        tester: drives; its simulator knows its car.
        planned: number of drives.
        drawn: ``seed`` and ``variations`` of drawn conditions.
    """
    simulator, driver = tester.simulator, tester.driver
    parts = describe(driver), describe(simulator), simulator.rules, simulator.car
    return Run(purpose, *parts, planned, **drawn)


def drive_again(
    folder: Path | str,
    purpose: Purpose,
    tester: RoadTester,
    drives: Sequence[tuple[TestRecord, Conditions]],
    *,
    optional: bool = False,
    on_progress: Callable[[RedriveProgress], None] | None = None,
    drawn: Mapping[str, Any] | None = None,
    **how: Unpack[RedriveOptions],
) -> Run:
    """Drives roads of a campaign again in place; stores each drive, then reports it.

    Args:
        folder: of the campaign.
        purpose: of the run.
        tester: as for `redriving`.
        drives: tests, with the conditions of each drive.
        optional: whether to go on if nothing can be stored.
        on_progress: called with every stored drive.
        drawn: ``seed`` and ``variations`` of drawn conditions.
        how: see `RedriveOptions`.

    Returns:
        The run, with its drives in the given order.

    Raises:
        CampaignError: they cannot be stored, a test was not driven, or as for `redriving`.
        ValueError: an option is out of range.
    """
    tasks = [Task.of(i, record, wanted) for i, (record, wanted) in enumerate(drives, start=1)]
    how["workers"] = min(require_count("workers", how.get("workers", 1)), max(len(tasks), 1))
    if how["workers"] > 1:  # they measure its car, each for itself; here it would never be entered
        prepare(tester.simulator)

    @cache  # its simulator knows its car when the first drive is stored
    def run() -> Run:
        return new_run(purpose, tester, len(tasks), **(drawn or {}))

    done: dict[int, Redrive] = {}
    failed = 0
    differences = _Differences(folder, tester)
    with (
        RunWriter(folder, run, optional=optional) as writer,
        redriving(tester, **how) as drive_tasks,
    ):
        for attempt in drive_tasks(tasks):
            number = attempt.candidate_id
            record, conditions = drives[number - 1]
            failed_now = attempt.result.outcome is Outcome.FAIL
            both_fail = failed_now and record.outcome is Outcome.FAIL
            keeps = purpose is Purpose.CONFIRMATION or (
                purpose is Purpose.BACK_TO_BACK and failed_now
            )
            trajectory = attempt.pack().stored_trajectory() if both_fail or keeps else None
            drive = Redrive.of(
                record,
                attempt.result,
                conditions,
                seconds=attempt.seconds,
                trajectory=trajectory if keeps else None,
                difference=differences.of(record, attempt, trajectory) if both_fail else None,
            )
            writer.add(number, drive)
            done[number] = drive
            failed += drive.outcome is Outcome.FAIL
            if on_progress is not None:
                on_progress(RedriveProgress(record.id, len(done), len(tasks), failed))
        return replace(run(), drives=tuple(done[number] for number in sorted(done)))


class _Differences:
    """Differences of drives from the recorded failures of their roads."""

    def __init__(self, folder: Path | str, tester: RoadTester) -> None:
        self._folder = folder
        self._tester = tester
        self._recorded: dict[int, Failure | None] = {}

    def of(
        self, record: TestRecord, attempt: Attempt, trajectory: Trajectory | None
    ) -> float | None:
        """Difference of a failing drive in m; None if one of the trajectories is missing."""
        if record.id not in self._recorded:
            with CampaignStore.open(self._folder) as store:
                self._recorded[record.id] = Failure.of_test(store.test(record.id))
        recorded, simulator = self._recorded[record.id], self._tester.simulator
        if recorded is None or trajectory is None:
            return None
        drive = Drive(trajectory, simulator.car, simulator.rules)
        failure = Failure.of_drive(record.road, drive, attempt.result)
        return None if failure is None else recorded.difference(failure)


@contextmanager
def redriving(
    tester: RoadTester,
    *,
    is_entered: bool = False,
    **how: Unpack[RedriveOptions],
) -> Iterator[DriveTasks]:
    """Starts workers and gives a function that drives a batch of roads, as often as it is called.

    A drive that is lost with its worker, or on which the simulator breaks, is tried once more.
    After the first Ctrl-C no drive begins and running ones are finished.

    Args:
        tester: drives the roads; copied into each worker if there are several.
        is_entered: whether the caller has entered the simulator and will leave it; for one worker.
        how: see `RedriveOptions`.

    Raises:
        CampaignError: no worker can be started.
        ValueError: an option is out of range.
    """
    workers, on_start = require_count("workers", how.get("workers", 1)), how.get("on_start")
    with (
        catch_interrupt(how.get("on_interrupt")) as interrupt,
        _crew(tester, workers, how.get("drive_limit"), is_entered) as crew,
    ):
        while not crew.free and not interrupt.requested:
            crew.wait(_POLL)
        if on_start is not None:
            on_start()

        def drive_tasks(tasks: Iterable[Task]) -> Iterator[Attempt]:
            waiting = deque(tasks)
            running: dict[int, Task] = {}
            tries: Counter[int] = Counter()
            while running or (waiting and not interrupt.requested):
                while waiting and crew.free and not interrupt.requested:
                    task = waiting.popleft()
                    running[task.candidate.id] = task
                    tries[task.candidate.id] += 1
                    crew.submit(task.candidate, task.placement)
                for attempt in crew.wait(_POLL):
                    task = running.pop(attempt.candidate_id)
                    if attempt.failure is not None and tries[attempt.candidate_id] < MAX_ATTEMPTS:
                        waiting.appendleft(task)
                    else:
                        yield attempt

        yield drive_tasks


def _crew(tester: RoadTester, workers: int, drive_limit: float | None, is_entered: bool) -> Workers:
    if workers == 1:
        return InProcessWorker(tester, is_entered=is_entered, packs=False)
    if drive_limit is None:
        drive_limit = capabilities(tester.simulator).drive_limit
    compile_kernels()
    # The workers' events are no part of the campaign's log.
    return LocalWorkers(tester, workers, drive_limit=drive_limit)
