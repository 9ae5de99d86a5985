"""Workers in processes on this machine, and the choice of a campaign's workers."""

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
from frenetic.campaign.workers.threads import ThreadWorkers
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
from frenetic.simulators.blame import Blame, trouble_of_lost_process
from frenetic.simulators.capabilities import capabilities

MAX_STARTS: Final = 3
"""Number of consecutive failed starts after which a worker is given up (our choice)."""
MAX_QUEUED: Final = 4
"""Largest number of candidates that a worker with quick tests has (our choice).

The candidate that it drives counts, too. Waiting for a candidate costs more than a fresher proposal
gains.
"""
QUICK_TEST_TIME: Final = 0.1
"""Longest time of a quick test, in s (our choice); a worker with slower tests has one candidate at
a time. On a busy machine it waits some 10 ms for the next one, which then matters little."""
_START_PAUSE: Final = 0.2
"""Time between two attempts to start a process, in s (our choice)."""

logger = logging.getLogger(__name__)


class TesterHost:
    """The object in a worker's process: a tester whose simulator is restarted after it broke.

    Args:
        tester: tester whose simulator is not started yet.
        keep_exact: whether attempts have exact trajectories, too, not only packed ones.
    """

    def __init__(self, tester: RoadTester, *, keep_exact: bool = False) -> None:
        self._tester = tester
        self._keep_exact = keep_exact
        self._is_started = False

    def start(self) -> None:
        """Start the simulator."""
        self._tester.simulator.__enter__()
        self._is_started = True

    def test(self, candidate: Candidate) -> Attempt:
        """Test a candidate."""
        if not self._is_started:
            self.start()
        attempt = self._tester.attempt(candidate, keep_exact=self._keep_exact)
        if attempt.simulator_broke:
            self.close()
        return attempt

    def close(self) -> None:
        """End the simulator."""
        if self._is_started:
            self._is_started = False
            self._tester.simulator.__exit__(None, None, None)


def is_isolable(tester: RoadTester) -> bool:
    """Return whether a tester should drive in another process, which protects this process.

    Compiled code of ours needs no other process. A driver that cannot be copied must drive here;
    then a warning is logged.
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
    candidate_id: int, worker: str, error: LostProcessError, fault: Fault | None, seconds: float
) -> Attempt:
    """Return the attempt at a candidate whose worker was lost.

    Args:
        candidate_id: id of the candidate.
        worker: name of the worker.
        error: error about the loss.
        fault: fault of the driver, if it caused the loss; None if the cause is unknown.
        seconds: wall time of the attempt until the loss, in s.
    """
    trouble = trouble_of_lost_process(error, fault)
    if fault is None:
        trouble = Trouble(f"{worker} was lost: {error}", error.trouble.traceback)
    return Attempt.lost(candidate_id, worker, seconds, trouble)


class LocalWorkers:
    """Processes on this machine, each with its own simulator and driver.

    A process is replaced if it dies, if a drive exceeds the limit, or if its simulator broke.

    Args:
        tester: tester of the candidates, which is copied into each process, so driver and simulator
            must be picklable.
        count: number of processes.
        drive_limit: wall time in s after which a worker that tests one candidate counts as hanging
            and is killed.
        log: log to which the events of the workers are written.
        may_queue: whether a worker with quick tests may have several candidates at once.
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
        may_queue: bool = True,
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
        self._most_queued = MAX_QUEUED if may_queue else 1
        # Candidates of lost workers that had not begun them; any worker takes them.
        self._backlog: deque[Candidate] = deque()

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return max(0, sum(map(self._room, self._seats)) - len(self._backlog))

    def _room(self, seat: _Seat) -> int:
        """Return the number of further candidates that a worker can take."""
        if not seat.is_ready:
            return 0
        capacity = self._most_queued if seat.last_test_time <= QUICK_TEST_TIME else 1
        return max(0, capacity - len(seat.candidates))

    def submit(self, candidate: Candidate) -> None:
        """Hand a candidate to a free worker."""
        free = [seat for seat in self._seats if self._room(seat)]
        seat = min(free, key=lambda seat: len(seat.candidates))
        seat.candidates.append(candidate)
        seat.worker.send("test", candidate, limit=self._drive_limit, answer=Attempt)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Wait for attempts for at most `timeout` s; return those that have ended.

        Raises:
            CampaignError: no worker is left and no other can be started.
        """
        while self._backlog and any(self._room(seat) for seat in self._seats):
            self.submit(self._backlog.popleft())
        remaining = [seat for seat in self._seats if not seat.is_lost]
        if not remaining:
            reasons = "; ".join(sorted({seat.loss for seat in self._seats}))
            raise CampaignError(f"no worker could be started: {reasons}")
        ready_workers = ready([seat.worker for seat in remaining], timeout)
        attempts: list[Attempt] = []
        for seat in remaining:
            if seat.worker not in ready_workers:
                continue
            try:
                for attempt in filter(None, seat.worker.receive()):  # the answer to a start is None
                    attempts.append(self._note_attempt(seat, attempt))
                    if attempt.simulator_broke:
                        # Its process may be broken, too: other workers take what waits there.
                        self._replace(seat)
                        break
            except LostProcessError as error:
                attempts += self._note_lost_worker(seat, error)
            else:
                if not seat.is_ready and not len(seat.worker):
                    self._note_start(seat)
        return attempts

    def _note_start(self, seat: _Seat) -> None:
        """Note and log that the simulator of a worker has started."""
        seat.is_ready = seat.has_started = True
        seat.failed_starts = 0
        name = seat.worker.name
        self._log.write(LogEvent.WORKER_STARTED, f"{name} started", worker=name)

    def _note_attempt(self, seat: _Seat, attempt: Attempt) -> Attempt:
        """Note that a worker has ended an attempt; return it with the worker's name."""
        if (trouble := attempt.trouble) is not None and trouble.traceback:
            logger.debug("%s: %s\n%s", seat.worker.name, trouble.reason, trouble.traceback)
        seat.candidates.popleft()
        seat.last_test_time = attempt.seconds
        return replace(attempt, worker=seat.worker.name)

    def __enter__(self) -> Self:
        """Start the workers without waiting."""
        try:
            for seat in self._seats:
                self._start(seat)
        except BaseException as error:  # including Ctrl-C
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """End all workers: at once during an error, otherwise when they have finished."""
        try:
            for seat in self._seats:
                if error is None and seat.is_ready:
                    seat.worker.close()
        except LostProcessError as loss:  # the drives remain valid
            logger.warning("a simulator did not end well: %s", loss)
        finally:  # also after a Ctrl-C
            for seat in self._seats:
                seat.worker.kill()

    def _start(self, seat: _Seat) -> None:
        """Start a worker without waiting, unless its starts have failed too often."""
        seat.is_ready, seat.is_lost = False, True
        while seat.failed_starts < MAX_STARTS:
            try:
                seat.worker.start()
            except (OSError, EOFError) as error:  # too many processes, or their server was killed
                seat.failed_starts += 1
                self._note_loss(seat, f"there was no process for it ({describe_error(error)})")
                time.sleep(_START_PAUSE)
            else:
                seat.is_lost = False
                return

    def _note_lost_worker(self, seat: _Seat, error: LostProcessError) -> list[Attempt]:
        """Replace a lost worker; return the attempt that was lost with it, if any."""
        if trace := error.trouble.traceback:
            logger.debug("%s: %s\n%s", seat.worker.name, error, trace)
            if not seat.has_started:
                seat.failed_starts = MAX_STARTS  # another start would raise the same error
        attempts = []
        if seat.is_ready and seat.candidates:
            candidate_id = seat.candidates.popleft().id
            self._note_loss(seat, str(error), test=candidate_id)
            seconds = time.monotonic() - seat.worker.since
            fault = self._blame.fault(error)
            attempts.append(lost_attempt(candidate_id, seat.worker.name, error, fault, seconds))
        else:
            self._note_loss(seat, str(error))
            seat.failed_starts += 1
        self._replace(seat)
        return attempts

    def _replace(self, seat: _Seat) -> None:
        """Start another process for a worker; any worker may take the candidates that it had."""
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
    may_queue: bool,
    keep_exact: bool,
) -> Workers:
    """Return the workers of a campaign, which are not started yet.

    Args:
        tester: tester of the candidates.
        workers: number of workers, or the address of a cluster's scheduler.
        isolate: whether a single worker, too, drives in another process, see `is_isolable`.
        drive_limit: wall time in s after which a worker that tests one candidate counts as hanging.
        log: log of the campaign.
        may_queue: whether a worker with quick tests may have several candidates at once.
        keep_exact: whether attempts have exact trajectories, too, not only packed ones.

    Raises:
        CampaignError: driver or simulator cannot be copied into another process.
    """
    if isinstance(workers, str):
        cluster: Workers = cluster_workers()(tester, workers, drive_limit=drive_limit, log=log)
        return cluster
    if tester.drives_side_by_side:
        return ThreadWorkers(tester, workers)
    if workers == 1 and not (isolate and is_isolable(tester)):
        return InProcessWorker(tester)
    return LocalWorkers(
        tester,
        workers,
        drive_limit=drive_limit,
        log=log,
        may_queue=may_queue,
        keep_exact=keep_exact,
    )


class _Seat:
    """A worker as the campaign knows it: its process, its candidates and its starts."""

    def __init__(self, worker: ObjectProcess) -> None:
        self.worker = worker
        self.candidates: deque[Candidate] = deque()
        """The candidate that the worker drives, followed by those that wait for it."""
        self.is_ready = False
        """Whether the simulator of the present process has started."""
        self.is_lost = True
        """Whether the worker has no process."""
        self.has_started = False
        """Whether a simulator of the worker has ever started."""
        self.failed_starts = 0
        """Number of consecutive failed starts."""
        self.last_test_time = float("inf")
        """Time of the worker's last test, in s; infinite before the first."""
        self.loss = ""
        """Reason of the worker's last loss."""
