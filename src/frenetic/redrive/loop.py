"""The loop for driving roads again in place, by one process or several, each in its conditions.

Robustness, confirmation and regression share it. It stores each drive before it reports it.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from frenetic._support.interrupt import catch_interrupt
from frenetic.campaign.loop import MAX_ATTEMPTS
from frenetic.campaign.record import Attempt, TestRecord
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import Placement, RoadTester
from frenetic.campaign.trajectory_codec import decode
from frenetic.campaign.workers import InProcessWorker, LocalWorkers, Workers
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.record import Purpose, Redrive, Run
from frenetic.redrive.table import RunWriter
from frenetic.road import Pose
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import USUAL, Conditions

OPERATOR: Final = "redrive"
"""Operator in the origin of roads that are driven again."""
_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed


@dataclass(frozen=True)
class Task:
    """A road to be driven in place."""

    candidate: Candidate
    placement: Placement

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


def campaign_tester(store: CampaignStore, simulator: Simulator, driver: Driver) -> RoadTester:
    """Drives a campaign's roads, possibly with other parts.

    Raises:
        CampaignError: the campaign's configuration is damaged.
    """
    setting = store.setting
    return RoadTester(simulator, driver, setting.map_size, setting.margin, setting.lane_width)


def drive_again(
    folder: Path,
    describe: Callable[[], Run],
    drives: Sequence[tuple[TestRecord, Conditions]],
    tester: RoadTester,
    *,
    purpose: Purpose,
    optional: bool = False,
    workers: int = 1,
    drive_limit: float | None = None,
    on_drive: Callable[[Redrive], None],
    on_start: Callable[[], None] | None = None,
    on_interrupt: Callable[[], None] | None = None,
) -> tuple[Redrive, ...]:
    """Drives roads of a campaign again; stores each drive, then reports it.

    Args:
        folder: of the campaign.
        describe: describes the run; called with the first drive.
        drives: tests, with the conditions of each drive.
        tester: as for `drive_all`.
        purpose: of the run.
        optional: whether to go on if nothing can be stored.
        workers: as for `drive_all`.
        drive_limit: likewise.
        on_drive: called with every stored drive.
        on_start: as for `drive_all`.
        on_interrupt: likewise.

    Returns:
        The drives, in the given order.

    Raises:
        CampaignError: they cannot be stored, a test was not driven, or as for `drive_all`.
        ValueError: an option is out of range.
    """
    tasks = [Task.of(i, record, wanted) for i, (record, wanted) in enumerate(drives, start=1)]
    done: dict[int, Redrive] = {}
    with RunWriter(folder, purpose, describe, optional=optional) as writer:

        def note(attempt: Attempt) -> None:
            number = attempt.candidate_id
            record, conditions = drives[number - 1]
            packed = attempt.packed if purpose is Purpose.CONFIRMATION else None
            drive = Redrive.of(
                record,
                attempt.result,
                conditions,
                seconds=attempt.seconds,
                trajectory=None if packed is None else decode(packed),
            )
            writer.add(number, drive)
            done[number] = drive
            on_drive(drive)

        drive_all(
            tasks,
            tester,
            workers=workers,
            drive_limit=drive_limit,
            on_attempt=note,
            on_start=on_start,
            on_interrupt=on_interrupt,
        )
    return tuple(done[number] for number in sorted(done))


def drive_all(
    tasks: Sequence[Task],
    tester: RoadTester,
    *,
    workers: int = 1,
    drive_limit: float | None = None,
    on_attempt: Callable[[Attempt], None],
    on_start: Callable[[], None] | None = None,
    on_interrupt: Callable[[], None] | None = None,
) -> bool:
    """Drives roads again and passes on the results as they come.

    A drive that is lost with its worker, or on which the simulator breaks, is tried once more.
    After the first Ctrl-C no drive begins and running ones are finished.

    Args:
        tasks: their candidates numbered from 1, each number once.
        tester: drives them; copied into each worker if there are several.
        workers: number of roads driven at once, as for `Campaign`.
        drive_limit: s of wall time, likewise.
        on_attempt: called with the last attempt at each task.
        on_start: called when the simulator has started.
        on_interrupt: called at the first Ctrl-C.

    Returns:
        Whether all were driven.

    Raises:
        CampaignError: no worker can be started.
        ValueError: an option is out of range.
    """
    if isinstance(workers, bool) or workers != int(workers) or workers < 1:
        raise ValueError(f"workers is {workers}: a whole number of at least 1 is needed")
    waiting = deque(tasks)
    running: dict[int, Task] = {}
    tries: Counter[int] = Counter()
    with ExitStack() as stack:
        interrupt = stack.enter_context(catch_interrupt(on_interrupt))
        crew = stack.enter_context(_crew(tester, min(workers, max(len(tasks), 1)), drive_limit))
        while not crew.free and not interrupt.requested:
            crew.wait(_POLL)
        if on_start is not None:
            on_start()
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
                    on_attempt(attempt)
    return not waiting


def _crew(tester: RoadTester, workers: int, drive_limit: float | None) -> Workers:
    if workers == 1:
        return InProcessWorker(tester)
    if drive_limit is None:
        drive_limit = capabilities(tester.simulator).drive_limit
    compile_kernels()
    # The workers' events are no part of the campaign's log.
    return LocalWorkers(tester, workers, drive_limit=drive_limit)
