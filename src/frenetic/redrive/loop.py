"""Driving roads again where they lie, by this process or several, each in a world of its own."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from frenetic._support.arrays import FloatArray
from frenetic._support.interrupt import catch_interrupt
from frenetic.campaign.configuration import configuration_faults
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.loop import MAX_ATTEMPTS
from frenetic.campaign.store import DATABASE, CampaignStore, TestRecord
from frenetic.campaign.tester import RoadTester, Tested, untested
from frenetic.campaign.workers import Attempt, LocalWorkers, ThisProcess, Workers
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import World, in_world

OPERATOR: Final = "redrive"
"""What the origin of the roads that are driven again says."""
_POLL: Final = 0.2  # s between two looks whether Ctrl-C was pressed


@dataclass(frozen=True, eq=False, kw_only=True)
class Redrive(Candidate):
    """A road to be driven where it lies, in a world that may differ from the simulator's."""

    pose: Pose
    world: World

    def __reduce__(self) -> tuple[Any, ...]:
        # Made anew, so that the values are read-only again.
        values = (self.id, self.curvatures, self.step, self.origin, self.pose, self.world)
        return _redrive, values

    @classmethod
    def of(cls, number: int, record: TestRecord, world: World) -> Redrive:
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
        curvatures, pose = candidate.curvatures, Pose(*record.pose)
        return _redrive(number, curvatures, candidate.step, origin, pose, world)


def _redrive(
    number: int, curvatures: FloatArray, step: float, origin: Origin, pose: Pose, world: World
) -> Redrive:
    return Redrive(number, curvatures, step, origin, pose=pose, world=world)


@dataclass(frozen=True)
class Redriver(RoadTester):
    """Drives roads where they lie, instead of fitting them into the map."""

    @classmethod
    def of(cls, store: CampaignStore, simulator: Simulator, driver: Driver) -> Redriver:
        """Drives the roads of a campaign.

        Raises:
            CampaignError: the campaign's configuration is damaged.
        """
        config: Mapping[str, Any] = store.config
        if faults := configuration_faults(config):
            raise CampaignError(
                f"{store.folder / DATABASE} is damaged: {'; '.join(faults)}; restore it from a copy"
            )
        return cls(simulator, driver, config["map_size"], config["margin"], config["lane_width"])

    def test(self, candidate: Candidate) -> Tested:
        """Drives the road of a `Redrive` in its world, if it is still valid."""
        assert isinstance(candidate, Redrive)
        road = Road(
            candidate.curvatures, candidate.step, candidate.pose, lane_width=self.lane_width
        )
        with in_world(candidate.world, self.simulator, self.driver) as driver:
            return RoadTester(
                self.simulator, driver, self.map_size, self.margin, self.lane_width
            ).test_placed(road)


def drive_again(
    redrives: Sequence[Redrive],
    redriver: Redriver,
    *,
    workers: int = 1,
    drive_limit: float | None = None,
    on_result: Callable[[Redrive, Tested, float], None],
    on_start: Callable[[], None] | None = None,
    on_interrupt: Callable[[], None] | None = None,
) -> bool:
    """Drives roads again and hands on the results as they come.

    A drive that is lost with its worker, or on which the simulator breaks, is tried once more. At
    the first Ctrl-C nothing is begun any more and what runs is finished.

    Args:
        redrives: numbered from 1, each number once.
        redriver: drives them; copied into each worker if there are several.
        workers: how many roads are driven at once, as for `Campaign`.
        drive_limit: s of wall time, likewise.
        on_result: called with every drive, what became of it and the s of wall time it took.
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
    waiting = deque(redrives)
    running: dict[int, Redrive] = {}
    tries: Counter[int] = Counter()

    def take(attempt: Attempt) -> None:
        redrive = running.pop(attempt.candidate_id)
        if attempt.failure is not None and tries[redrive.id] < MAX_ATTEMPTS:
            waiting.appendleft(redrive)
            return
        tested = attempt.tested or untested(Outcome.ERROR, attempt.loss)
        on_result(redrive, tested, attempt.seconds)

    with ExitStack() as stack:
        interrupt = stack.enter_context(catch_interrupt(on_interrupt))
        crew = _crew(redriver, min(workers, max(len(redrives), 1)), drive_limit, stack)
        while not crew.free and not interrupt.requested:
            crew.wait(_POLL)
        if on_start is not None:
            on_start()
        while running or (waiting and not interrupt.requested):
            while waiting and crew.free and not interrupt.requested:
                redrive = waiting.popleft()
                running[redrive.id] = redrive
                tries[redrive.id] += 1
                crew.submit(redrive)
            for attempt in crew.wait(_POLL):
                take(attempt)
    return not waiting


def readable(reason: str) -> str:
    """A broken driver's message with what is no text, half characters, shown as Python does."""
    return reason.encode("utf-8", "backslashreplace").decode("utf-8")


def _crew(redriver: Redriver, workers: int, drive_limit: float | None, stack: ExitStack) -> Workers:
    if workers == 1:
        return stack.enter_context(ThisProcess(redriver))
    if drive_limit is None:
        drive_limit = 1.5 * getattr(redriver.simulator, "wall_limit", 60.0) + 10.0
    # What happens to the workers is no part of the campaign's log.
    nowhere = Path(stack.enter_context(TemporaryDirectory()))
    log = stack.enter_context(CampaignLog(nowhere))
    compile_kernels()
    return stack.enter_context(LocalWorkers(redriver, workers, drive_limit=drive_limit, log=log))
