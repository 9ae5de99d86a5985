"""Workers on this machine."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Self

from frenetic._support.json_value import JSONValue
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.workers import InProcessWorker, Workers, cluster_workers
from frenetic.errors import CampaignError, Fault, Trouble, describe_error
from frenetic.processes.object_process import (
    MOST_WORKERS,
    LostProcessError,
    ObjectProcess,
    pack,
    ready,
)
from frenetic.search.records import Candidate
from frenetic.simulators.blame import Blame, lost_process
from frenetic.simulators.capabilities import capabilities

STARTS: Final = 3
"""Consecutive failed starts after which a worker is given up (ours)."""
AHEAD: Final = 4
"""Most candidates of a worker with quick tests, with the candidate that it drives (ours): waking an
idle worker costs more than a fresher proposal gains."""
QUICK: Final = 0.01
"""Longest time of a quick test, in s (ours); a worker with slower tests has one candidate at a
time."""
_PAUSE: Final = 0.2  # [s] between two tries to get a process, ours

logger = logging.getLogger(__name__)


class TesterHost:
    """The object in a worker's process: a tester whose simulator starts again after it broke.

    Args:
        tester: its simulator is not started yet.
        keep_exact: whether attempts have exact trajectories, too, not only packed ones.
    """

    def __init__(self, tester: RoadTester, *, keep_exact: bool = False) -> None:
        self._tester = tester
        self._keep_exact = keep_exact
        self._is_up = False

    def start(self) -> None:
        """Start the simulator."""
        self._tester.simulator.__enter__()
        self._is_up = True

    def test(self, candidate: Candidate) -> Attempt:
        """Test a candidate."""
        if not self._is_up:
            self.start()
        attempt = self._tester.attempt(candidate, keep_exact=self._keep_exact)
        if attempt.simulator_broke:
            self.close()
        return attempt

    def close(self) -> None:
        """End the simulator."""
        if self._is_up:
            self._is_up = False
            self._tester.simulator.__exit__(None, None, None)


def is_isolable(tester: RoadTester) -> bool:
    """Return whether a process of its own protects this process from a tester's driver.

    Compiled code of ours needs no such process. Where a driver cannot be copied, a warning says so.
    """
    if tester.drives_compiled:
        return False
    try:
        pack(tester)
    except CampaignError as error:
        logger.warning("nothing protects this process from the driver: %s", error)
        return False
    return True


def lost_attempt(
    number: int, worker: str, error: LostProcessError, fault: Fault | None, seconds: float
) -> Attempt:
    """Return the attempt at a candidate whose worker was lost.

    Args:
        number: id of the candidate.
        worker: name of the worker.
        error: how it was lost.
        fault: fault of the driver, if the driver lost the worker.
        seconds: wall time until the loss, in s.
    """
    trouble = lost_process(error, fault)
    if fault is None:
        trouble = Trouble(f"{worker} was lost: {error}", error.trouble.traceback)
    return Attempt.lost(number, worker, seconds, trouble)


class LocalWorkers:
    """Processes on this machine, each with a simulator and a driver of its own.

    A worker is replaced if it dies, if a drive exceeds the limit, or if its simulator broke.

    Args:
        tester: copied into each process, so driver and simulator must be picklable.
        count: number of processes.
        drive_limit: wall time in s after which a worker that tests one candidate counts as hanging
            and is killed.
        log: gets the events of the workers.
        ahead: whether a worker with quick tests may have several candidates at once.
        keep_exact: whether attempts have exact trajectories, too, not only packed ones.

    Raises:
        CampaignError: driver or simulator cannot be copied into another process.
    """

    def __init__(
        self,
        tester: RoadTester,
        count: int,
        *,
        drive_limit: float,
        log: CampaignLog,
        ahead: bool = True,
        keep_exact: bool = False,
    ) -> None:
        able = capabilities(tester.simulator)
        most = able.workers_at_most
        if most is not None and count > most:
            raise CampaignError(
                f"{count} workers are too many: the simulator that they are to share serves {most}"
            )
        if count > MOST_WORKERS:
            raise CampaignError(f"{count} workers are too many: Windows allows {MOST_WORKERS}")
        self._blame = Blame.of(tester.simulator, tester.driver)
        packed = pack(TesterHost(tester, keep_exact=keep_exact))
        self._seats = [
            _Seat(ObjectProcess(f"worker {number}", packed, able.preloads))
            for number in range(1, count + 1)
        ]
        self._drive_limit = drive_limit
        self._log = log
        self._ahead = AHEAD if ahead else 1
        self._backlog: deque[Candidate] = deque()  # of workers that were lost before they began

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return max(0, sum(map(self._room, self._seats)) - len(self._backlog))

    def _room(self, seat: _Seat) -> int:
        """Return how many more candidates a worker can take."""
        if not seat.is_ready:
            return 0
        capacity = self._ahead if seat.pace <= QUICK else 1
        return max(0, capacity - len(seat.candidates))

    def submit(self, candidate: Candidate) -> None:
        """Hand a candidate to a free worker."""
        free = [seat for seat in self._seats if self._room(seat)]
        seat = min(free, key=lambda seat: len(seat.candidates))
        seat.candidates.append(candidate)
        seat.worker.send("test", candidate, limit=self._drive_limit, answer=Attempt)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Wait for a message, for at most `timeout` s; return the finished attempts.

        Raises:
            CampaignError: no worker is left and no other can be started.
        """
        while self._backlog and any(self._room(seat) for seat in self._seats):
            self.submit(self._backlog.popleft())
        remaining = [seat for seat in self._seats if not seat.is_lost]
        if not remaining:
            reasons = "; ".join(sorted({seat.loss for seat in self._seats}))
            raise CampaignError(f"no worker could be started: {reasons}")
        heard = ready([seat.worker for seat in remaining], timeout)
        attempts: list[Attempt] = []
        for seat in remaining:
            if seat.worker not in heard:
                continue
            try:
                for attempt in filter(None, seat.worker.receive()):
                    attempts.append(self._answered(seat, attempt))
                    if attempt.simulator_broke:  # so may have its process, in which others wait
                        self._replace(seat)
                        break
            except LostProcessError as error:
                attempts += self._lost(seat, error)
            else:
                if not seat.is_ready and not len(seat.worker):
                    self._ready(seat)
        return attempts

    def _ready(self, seat: _Seat) -> None:
        seat.is_ready = seat.has_started = True
        seat.failed_starts = 0
        name = seat.worker.name
        self._log.write(LogEvent.WORKER_STARTED, f"{name} started", worker=name)

    def _answered(self, seat: _Seat, attempt: Attempt) -> Attempt:
        if (trouble := attempt.trouble) is not None and trouble.traceback:
            logger.debug("%s: %s\n%s", seat.worker.name, trouble.reason, trouble.traceback)
        seat.candidates.popleft()
        seat.pace = attempt.seconds
        return replace(attempt, worker=seat.worker.name)

    def __enter__(self) -> Self:
        """Start the workers without waiting."""
        try:
            for seat in self._seats:
                self._start(seat)
        except BaseException as error:  # Ctrl-C
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """End all workers: at once during an error, else when they are done."""
        try:
            for seat in self._seats:
                if error is None and seat.is_ready:
                    seat.worker.close()
        except LostProcessError as loss:  # what was driven stands
            logger.warning("a simulator did not end well: %s", loss)
        finally:  # also if Ctrl-C is pressed meanwhile
            for seat in self._seats:
                seat.worker.kill()

    def _start(self, seat: _Seat) -> None:
        """Start a worker without waiting, unless its starts have failed too often."""
        seat.is_ready, seat.is_lost = False, True
        while seat.failed_starts < STARTS:
            try:
                seat.worker.start()
            except (OSError, EOFError) as error:  # too many processes, or their server was killed
                seat.failed_starts += 1
                self._note_loss(seat, f"there was no process for it ({describe_error(error)})")
                time.sleep(_PAUSE)
            else:
                seat.is_lost = False
                return

    def _lost(self, seat: _Seat, error: LostProcessError) -> list[Attempt]:
        """Replace a worker; return the lost attempt."""
        if trace := error.trouble.traceback:
            logger.debug("%s: %s\n%s", seat.worker.name, error, trace)
            if not seat.has_started:
                seat.failed_starts = STARTS  # another start would fail alike
        attempts = []
        if seat.is_ready and seat.candidates:
            lost = seat.candidates.popleft().id
            self._note_loss(seat, str(error), test=lost)
            seconds = time.monotonic() - seat.worker.since
            fault = self._blame.fault(error)
            attempts.append(lost_attempt(lost, seat.worker.name, error, fault, seconds))
        else:
            self._note_loss(seat, str(error))
            seat.failed_starts += 1
        self._replace(seat)
        return attempts

    def _replace(self, seat: _Seat) -> None:
        """Start another process for a worker; candidates that waited there wait for any worker."""
        seat.worker.kill()
        self._backlog.extend(seat.candidates)
        seat.candidates.clear()
        self._start(seat)

    def _note_loss(self, seat: _Seat, reason: str, **fields: JSONValue) -> None:
        """Note and log the reason of a worker's loss."""
        seat.loss, name = reason, seat.worker.name
        loss = f"{name} was lost: {reason}"
        fields |= {"worker": name, "reason": reason}
        self._log.write(LogEvent.WORKER_LOST, loss, level="warning", **fields)


def workers_for(
    tester: RoadTester,
    workers: int | str,
    *,
    isolate: bool,
    drive_limit: float,
    log: CampaignLog,
    ahead: bool,
    keep_exact: bool,
) -> Workers:
    """Return the workers of a campaign, which are not started yet.

    Args:
        tester: tests the candidates.
        workers: number of workers, or the address of a cluster's scheduler.
        isolate: whether a single worker, too, drives in a process of its own, see `is_isolable`.
        drive_limit: as for `LocalWorkers`, as are `log`, `ahead` and `keep_exact`.
        log: of the campaign.
        ahead: whether a worker with quick tests may have several candidates at once.
        keep_exact: whether attempts have exact trajectories, too, not only packed ones.

    Raises:
        CampaignError: driver or simulator cannot be copied into another process.
    """
    if isinstance(workers, str):
        cluster: Workers = cluster_workers()(tester, workers, drive_limit=drive_limit, log=log)
        return cluster
    if workers == 1 and not (isolate and is_isolable(tester)):
        return InProcessWorker(tester)
    return LocalWorkers(
        tester, workers, drive_limit=drive_limit, log=log, ahead=ahead, keep_exact=keep_exact
    )


class _Seat:
    """A worker as the campaign knows it: its process, its candidates and its failed starts."""

    def __init__(self, worker: ObjectProcess) -> None:
        self.worker = worker
        self.candidates: deque[Candidate] = deque()
        """The candidate that it drives, and those that wait."""
        self.is_ready = False
        """Whether its simulator has started."""
        self.is_lost = True
        """Whether it has no process."""
        self.has_started = False
        """Whether its simulator has started at least once."""
        self.failed_starts = 0
        """Number of consecutive failed starts."""
        self.pace = float("inf")
        """Time of its last test, in s."""
        self.loss = ""
        """Reason of its last loss."""
