"""Workers in processes of their own on this machine."""

from __future__ import annotations

import logging
import math
import multiprocessing
import pickle
import platform
import signal
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Final, Self

from frenetic.campaign.log import CampaignLog, Event, WorkerState, WorkerStatus
from frenetic.campaign.store import JSONValue
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.serving import (
    Finished,
    Hopeless,
    Logged,
    Message,
    Ready,
    kill_group,
    serve,
)
from frenetic.campaign.workers.workers import Attempt
from frenetic.errors import CampaignError, describe_error
from frenetic.registry import user_files
from frenetic.search.records import Candidate

STARTS: Final = 3
"""How often in a row a worker may fail to start before it is given up."""
START_LIMIT: Final = 600.0
"""s that a worker may take to start its simulator."""
CLOSING_LIMIT: Final = 30.0
"""s that workers have to finish what they are at and to end their simulators."""
PREFETCH_BELOW: Final = 0.02
"""s: a worker whose tests take less gets the next candidate before it has finished one, since to
fall asleep and wake up costs it more time than the test of a road that is a little better chosen."""
MOST_ON_WINDOWS: Final = 60
"""Workers: its kernel waits for so many objects at once."""

_PRELOADED: Final = "frenetic.campaign.workers.preloading"


class LocalWorkers:
    """Processes on this machine, each with a simulator and a driver of its own.

    A worker that dies or that is at one drive for longer than the limit is replaced; so is one
    whose simulator does not start again after it broke.

    Args:
        tester: copied into each process, so driver and simulator have to be picklable.
        count: of processes.
        drive_limit: s of wall time after which a worker that tests one candidate is taken to hang,
            and killed.
        log: is told what happens to the workers.

    Raises:
        CampaignError: driver or simulator cannot be copied into another process.
    """

    def __init__(
        self, tester: RoadTester, count: int, *, drive_limit: float, log: CampaignLog
    ) -> None:
        try:
            self._tester = pickle.dumps(tester)
        except Exception as error:
            raise CampaignError(
                "the driver or simulator cannot be copied to another process"
                f" ({describe_error(error)}): use one worker, or define it in a module of its own"
            ) from error
        if sys.platform == "win32" and count > MOST_ON_WINDOWS:
            raise CampaignError(f"{count} workers are too many: Windows allows {MOST_ON_WINDOWS}")
        self._user_files = user_files()
        self._drive_limit = drive_limit
        self._log = log
        self._context = _context()
        self._workers = [_Worker(f"worker {number}") for number in range(1, count + 1)]
        self._backlog: deque[Candidate] = deque()  # of workers that were lost before they began

    @property
    def free(self) -> int:
        """How many candidates can be submitted now."""
        return max(0, sum(worker.room for worker in self._workers) - len(self._backlog))

    def states(self) -> Mapping[str, WorkerState]:
        """What each worker does at the moment, by its name."""
        now = time.monotonic()
        return {
            worker.name: WorkerState(worker.name, worker.state, worker.tests, now - worker.since)
            for worker in self._workers
        }

    def submit(self, candidate: Candidate) -> None:
        """Hands a candidate to a free worker."""
        worker = min(
            (worker for worker in self._workers if worker.room), key=lambda one: len(one.queue)
        )
        worker.queue.append(candidate)
        if worker.state == "idle":
            worker.turn("driving", self._drive_limit)
        with suppress(OSError):  # it has died: `wait` will find out
            worker.connection.send(candidate)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns what has come back.

        Raises:
            CampaignError: there are no workers left and none can be started.
        """
        while self._backlog and any(worker.room for worker in self._workers):
            self.submit(self._backlog.popleft())
        watched: dict[object, _Worker] = {}
        deadline = time.monotonic() + timeout
        for worker in self._workers:
            if worker.state == "lost":
                continue
            deadline = min(deadline, worker.limit)
            watched[worker.connection] = worker
            if sys.platform != "win32":  # where few can be watched; a lost connection says it, too
                watched[worker.process.sentinel] = worker
        if not watched:
            reasons = "; ".join(sorted({worker.loss for worker in self._workers}))
            raise CampaignError(f"no worker could be started: {reasons}")
        objects: list[Any] = list(watched)
        heard = wait(objects, max(0.0, deadline - time.monotonic()))
        attempts: list[Attempt] = []
        for worker in dict.fromkeys(watched[one] for one in heard):
            attempts += self._heard(worker)
        now = time.monotonic()
        for worker in self._workers:
            if worker.state != "lost" and worker.limit <= now:
                what = "drive" if worker.state == "driving" else "start"
                attempts += self._lost(
                    worker, f"its {what} took more than {now - worker.since:.3g} s"
                )
        return attempts

    def __enter__(self) -> Self:
        """Begins to start the workers."""
        self._context.set_forkserver_preload([_PRELOADED])
        for worker in self._workers:
            self._start(worker)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends all workers: at once if an error is under way, else when they are done."""
        there = [worker for worker in self._workers if worker.state != "lost"]
        deadline = time.monotonic()
        if error is None:
            deadline += CLOSING_LIMIT
            for worker in there:
                with suppress(OSError):
                    worker.connection.send(None)
        try:
            for worker in there:
                worker.process.join(max(0.0, deadline - time.monotonic()))
        finally:  # also if Ctrl-C is pressed meanwhile
            for worker in there:
                worker.end()

    def _start(self, worker: _Worker) -> None:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(
            target=serve, args=(theirs, self._user_files, self._tester), name=worker.name
        )
        process.start()
        theirs.close()
        worker.begin(process, ours)

    def _heard(self, worker: _Worker) -> list[Attempt]:
        """Reads what a worker has sent, and sees whether it has ended."""
        attempts: list[Attempt] = []
        try:
            while worker.state != "lost" and worker.connection.poll():
                attempts += self._received(worker, worker.connection.recv())
        except (EOFError, OSError):
            worker.process.join(1.0)
            return attempts + self._lost(worker, _ending(worker.process.exitcode))
        if worker.state != "lost" and not worker.process.is_alive():
            attempts += self._lost(worker, _ending(worker.process.exitcode))
        return attempts

    def _received(self, worker: _Worker, message: Message) -> list[Attempt]:
        match message:
            case Ready():
                worker.failed_starts = 0
                self._turn_to_next(worker)
                self._log.write(Event.WORKER_STARTED, f"{worker.name} started", worker=worker.name)
            case Finished(candidate_id, seconds, tested):
                worker.finish(seconds)
                if tested.simulator_broke:
                    worker.turn("starting", START_LIMIT)
                else:
                    self._turn_to_next(worker)
                return [Attempt(candidate_id, worker.name, seconds, tested)]
            case Logged(level, name, text):
                logging.getLogger(name).log(level, "%s: %s", worker.name, text)
            case Hopeless(reason):
                if worker.tests == 0:
                    worker.failed_starts = STARTS  # that would not change
                return self._lost(worker, reason)
        return []

    def _turn_to_next(self, worker: _Worker) -> None:
        if worker.queue:
            worker.turn("driving", self._drive_limit)
        else:
            worker.turn("idle")

    def _lost(self, worker: _Worker, reason: str) -> list[Attempt]:
        """Ends a worker and starts another in its place; returns the attempt that is lost."""
        attempts = []
        fields: dict[str, JSONValue] = {"worker": worker.name, "reason": reason}
        loss = f"{worker.name} was lost: {reason}"
        if worker.state == "driving":
            seconds = time.monotonic() - worker.since
            candidate_id = worker.queue.popleft().id
            attempts.append(Attempt(candidate_id, worker.name, seconds, None, loss))
            fields["test"] = candidate_id
            worker.failed_starts = 0
        else:
            worker.failed_starts += 1
        self._log.write(Event.WORKER_LOST, loss, level="warning", **fields)
        worker.end()
        worker.loss = reason
        self._backlog.extend(worker.queue)
        worker.queue.clear()
        if worker.failed_starts < STARTS:
            self._start(worker)
        else:
            worker.turn("lost")
        return attempts


class _Worker:
    """One worker and the process that it is at the moment."""

    process: BaseProcess
    connection: Connection

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: WorkerStatus = "lost"
        self.since = time.monotonic()
        """When this state began."""
        self.limit = math.inf
        """When this state has lasted too long, on the monotonic clock."""
        self.queue: deque[Candidate] = deque()
        """What it drives, and what it drives next."""
        self.tests = 0
        self.pace = math.inf
        """s that its tests take: the longest of late, forgotten slowly."""
        self.failed_starts = 0
        """In a row."""
        self.loss = ""
        """How its last process was lost."""

    @property
    def room(self) -> int:
        """How many candidates it can take now."""
        if self.state not in ("idle", "driving"):
            return 0
        return max(0, (2 if self.pace < PREFETCH_BELOW else 1) - len(self.queue))

    def finish(self, seconds: float) -> None:
        """Takes note that a test is done."""
        self.queue.popleft()
        self.tests += 1
        self.pace = max(seconds, 0.9 * self.pace) if self.tests > 1 else seconds

    def begin(self, process: BaseProcess, connection: Connection) -> None:
        self.process, self.connection = process, connection
        self.turn("starting", START_LIMIT)

    def turn(self, state: WorkerStatus, limit: float = math.inf) -> None:
        self.state = state
        self.since = time.monotonic()
        self.limit = self.since + limit

    def end(self) -> None:
        """Ends its process with all that it has started, however it may resist."""
        assert self.process.pid is not None
        kill_group(self.process.pid)
        self.process.kill()
        self.process.join()
        self.process.close()
        self.connection.close()


def _context() -> ForkServerContext | SpawnContext:
    """How processes are made: in milliseconds, forked from a server that has loaded everything.

    Elsewhere forking is not there (Windows) or not safe with the system's libraries (macOS).
    """
    if platform.system() == "Linux":
        return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")


def _ending(exit_code: int | None) -> str:
    if exit_code is None:
        return "its connection broke"
    if exit_code < 0:
        try:
            return f"it was killed by {signal.Signals(-exit_code).name}"
        except ValueError:
            return f"it was killed by signal {-exit_code}"
    hint = ", see its traceback; a script that starts workers needs 'if __name__ == \"__main__\":'"
    return f"it ended with exit code {exit_code}{hint if exit_code == 1 else ''}"
