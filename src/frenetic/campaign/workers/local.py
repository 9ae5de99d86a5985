"""Workers in their own processes on this machine."""

from __future__ import annotations

import logging
import math
import pickle
import selectors
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, NamedTuple, Self, TypeAlias

from frenetic._support.child_processes import (
    Failed,
    Line,
    Logged,
    ending_of,
    kill_process,
    process_context,
    serving,
    start_process,
)
from frenetic.campaign.log import CampaignLog, Event, WorkerState
from frenetic.campaign.record import Attempt
from frenetic.campaign.store import JSONValue
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.workers import Slot, states_of
from frenetic.errors import CampaignError, describe_error
from frenetic.registry import load_user_file, user_files
from frenetic.search.records import Candidate
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.isolated import pack, unpack

STARTS: Final = 3
"""Consecutive failed starts after which a worker is given up."""
START_LIMIT: Final = 600.0
"""Time that a worker may take to start its simulator, in s."""
CLOSING_LIMIT: Final = 30.0
"""Time that workers have to finish their tests and end their simulators, in s."""
PREFETCH: Final = 8
"""Most candidates of a worker with quick tests, including the one that it drives: waking an idle
worker costs more than a fresher proposal gains."""
PREFETCHED_TIME: Final = 0.02
"""Time that the candidates waiting in a worker may take, in s; none waits if one takes longer."""
NEEDED: Final = 3
"""Candidates that keep such a worker busy until the campaign learns that one is done."""
MOST_ON_WINDOWS: Final = 60
"""Most workers on Windows, whose kernel waits for this many objects at once."""

logger = logging.getLogger(__name__)

_LEAVING_LIMIT: Final = 1.0  # s that a process has to leave when its simulator has ended
_PAUSE: Final = 0.2  # s between two tries to get a process


class Task(NamedTuple):
    """Task of a worker."""

    number: int
    """Number that no other task has, by which its answer is known."""
    candidate: Candidate


class LocalWorkers:
    """Processes on this machine, each with a simulator and a driver of its own.

    A worker is replaced if it dies, if a drive exceeds the limit, or if its simulator broke and
    does not start again.

    Args:
        tester: copied into each process, so driver and simulator must be picklable.
        count: of processes.
        drive_limit: s of wall time after which a worker that tests one candidate counts as hanging
            and is killed.
        log: gets the events of the workers, if given.

    Raises:
        CampaignError: driver or simulator cannot be copied into another process.
    """

    def __init__(
        self, tester: RoadTester, count: int, *, drive_limit: float, log: CampaignLog | None = None
    ) -> None:
        self._tester = pack(tester)
        most = capabilities(tester.simulator).workers_at_most
        if most is not None and count > most:
            raise CampaignError(
                f"{count} workers are too many: the simulator that they are to share serves {most}"
            )
        if sys.platform == "win32" and count > MOST_ON_WINDOWS:
            raise CampaignError(f"{count} workers are too many: Windows allows {MOST_ON_WINDOWS}")
        self._user_files = user_files()
        self._drive_limit = drive_limit
        self._log = log
        self._context = process_context(capabilities(tester.simulator).preloads)
        self._tasks = 0  # given out
        self._selector = _selector()
        self._workers = [_Worker(f"worker {number}") for number in range(1, count + 1)]
        self._backlog: deque[Task] = deque()  # of workers that were lost before they began

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return max(0, sum(worker.room for worker in self._workers) - len(self._backlog))

    @property
    def needed(self) -> int:
        """Number of these that keeps all workers busy: others only wait in them."""
        short = sum(min(one.room, max(0, NEEDED - len(one.queue))) for one in self._workers)
        return max(0, short - len(self._backlog))

    def states(self) -> Mapping[str, WorkerState]:
        """Activity of each worker, by its name."""
        return states_of(self._workers)

    def submit(self, candidate: Candidate) -> None:
        """Hands a candidate to a free worker."""
        worker = min(
            (worker for worker in self._workers if worker.room), key=lambda one: len(one.queue)
        )
        self._tasks += 1
        task = Task(self._tasks, candidate)
        worker.queue.append(task)
        if worker.state == "idle":
            worker.turn("driving", self._drive_limit)
        with suppress(OSError):  # it has died: `wait` will find out
            worker.connection.send_bytes(pickle.dumps(task))

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns finished attempts.

        Raises:
            CampaignError: there are no workers left and none can be started.
        """
        while self._backlog and any(worker.room for worker in self._workers):
            task = self._backlog.popleft()
            self.submit(task.candidate)
        there = [worker for worker in self._workers if worker.state != "lost"]
        if not there:
            reasons = "; ".join(sorted({worker.loss for worker in self._workers}))
            raise CampaignError(f"no worker could be started: {reasons}")
        deadline = min([time.monotonic() + timeout, *(worker.limit for worker in there)])
        timeout = max(0.0, deadline - time.monotonic())
        attempts: list[Attempt] = []
        while heard := self._hear(timeout):
            for worker, has_sent in heard.items():
                attempts += self._read(worker) if has_sent else self._departed(worker)
            timeout = 0.0
        now = time.monotonic()
        for worker in self._workers:
            if worker.state != "lost" and worker.limit <= now:
                what = "drive" if worker.state == "driving" else "start"
                attempts += self._lost(
                    worker, f"its {what} took more than {now - worker.since:.3g} s"
                )
        return attempts

    def __enter__(self) -> Self:
        """Starts the workers without waiting."""
        try:
            for worker in self._workers:
                self._start(worker)
        except BaseException as error:  # Ctrl-C
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """Ends all workers: at once during an error, else when they are done."""
        there = [worker for worker in self._workers if worker.state != "lost"]
        try:
            if error is None:
                # What still starts has nothing to finish.
                started = [worker for worker in there if worker.state != "starting"]
                deadline = time.monotonic() + CLOSING_LIMIT
                for worker in started:
                    worker.dismiss()
                for worker in started:
                    worker.await_end(deadline)
        finally:  # also if Ctrl-C is pressed meanwhile
            if self._selector is not None:
                self._selector.close()
            for worker in there:
                worker.kill()
            for worker in there:
                worker.end()

    def _start(self, worker: _Worker) -> None:
        """Starts a worker without waiting, unless that has failed too often."""
        while worker.failed_starts < STARTS:
            try:
                self._start_process(worker)
            except (OSError, EOFError) as error:  # too many processes, or their server was killed
                worker.failed_starts += 1
                self._note_loss(worker, f"there was no process for it ({describe_error(error)})")
                time.sleep(_PAUSE)
            else:
                return

    def _start_process(self, worker: _Worker) -> None:
        process, ours = start_process(
            self._context, serve, self._user_files, self._tester, name=worker.name
        )
        worker.begin(process, ours)
        if self._selector is not None:
            self._selector.register(ours, selectors.EVENT_READ, worker)
            self._selector.register(process.sentinel, selectors.EVENT_READ, worker)

    def _hear(self, timeout: float) -> Mapping[_Worker, bool]:
        """Waits for workers that have sent something (True) or only ended (False)."""
        if self._selector is None:
            senders: dict[Any, _Worker] = {
                one.connection: one for one in self._workers if one.state != "lost"
            }
            return {senders[connection]: True for connection in wait(list(senders), timeout)}
        heard: dict[_Worker, bool] = {}
        for key, _ in self._selector.select(timeout):
            worker: _Worker = key.data
            heard[worker] = heard.get(worker, False) or key.fileobj is worker.connection
        return heard

    def _read(self, worker: _Worker) -> list[Attempt]:
        """Reads a worker's message, or the end of its connection."""
        try:
            # It comes from our own process.
            message = pickle.loads(worker.connection.recv_bytes())  # noqa: S301
        except Exception:  # its end, or nonsense that a driver has written there
            worker.process.join(1.0)
            return self._lost(worker, ending_of(worker.process.exitcode))
        return self._received(worker, message)

    def _departed(self, worker: _Worker) -> list[Attempt]:
        """Reads the last messages of an ended worker, while another may hold its connection."""
        attempts: list[Attempt] = []
        while worker.state != "lost" and worker.connection.poll():
            attempts += self._read(worker)
        if worker.state != "lost" and not worker.process.is_alive():
            attempts += self._lost(worker, ending_of(worker.process.exitcode))
        return attempts

    def _received(self, worker: _Worker, message: Message) -> list[Attempt]:
        match message:
            case Ready() if worker.state != "starting":
                self._refuse(worker, "it started a second time")
            case Ready():
                worker.failed_starts = 0
                worker.has_started = True
                self._turn_to_next(worker)
                if self._log is not None:
                    text = f"{worker.name} started"
                    self._log.write(Event.WORKER_STARTED, text, worker=worker.name)
            case Answer(task) if worker.state != "driving" or worker.queue[0].number != task:
                self._refuse(worker, f"it answered task {task}, which it does not have")
            case Answer(_, attempt):
                if attempt.traceback:
                    logger.debug(
                        "%s: %s\n%s", worker.name, attempt.result.reason, attempt.traceback
                    )
                worker.finish(attempt.seconds)
                if attempt.simulator_broke:
                    worker.turn("starting", START_LIMIT)
                else:
                    self._turn_to_next(worker)
                return [replace(attempt, worker=worker.name)]
            case Logged(level, name, text):
                logging.getLogger(name).log(level, "%s: %s", worker.name, text)
            case Failed(reason, traceback):
                if not worker.has_started:
                    worker.failed_starts = STARTS  # that would not change
                return self._lost(worker, reason, traceback)
        return []

    def _refuse(self, worker: _Worker, what: str) -> None:
        """Drops a message of a worker, and says so."""
        logger.warning(
            "%s sent what is not counted: %s; does the driver fork, or write to connections that"
            " are not its own?",
            worker.name,
            what,
        )

    def _turn_to_next(self, worker: _Worker) -> None:
        if worker.queue:
            worker.turn("driving", self._drive_limit)
        else:
            worker.turn("idle")

    def _lost(self, worker: _Worker, reason: str, traceback: str = "") -> list[Attempt]:
        """Replaces a worker; returns the lost attempt."""
        if traceback:
            logger.debug("%s: %s\n%s", worker.name, reason, traceback)
        attempts = []
        if worker.state == "driving":
            seconds = time.monotonic() - worker.since
            candidate_id = worker.queue.popleft().candidate.id
            loss = self._note_loss(worker, reason, test=candidate_id)
            attempts.append(Attempt.lost(candidate_id, worker.name, seconds, loss, traceback))
            worker.failed_starts = 0
        else:
            self._note_loss(worker, reason)
            worker.failed_starts += 1
        if self._selector is not None:
            self._selector.unregister(worker.connection)
            self._selector.unregister(worker.process.sentinel)
        worker.end()
        self._backlog.extend(worker.queue)
        worker.queue.clear()
        self._start(worker)
        return attempts

    def _note_loss(self, worker: _Worker, reason: str, **fields: JSONValue) -> str:
        """Remembers and logs the reason of a worker's loss; returns it in a sentence."""
        worker.loss = reason
        loss = f"{worker.name} was lost: {reason}"
        if self._log is not None:
            fields |= {"worker": worker.name, "reason": reason}
            self._log.write(Event.WORKER_LOST, loss, level="warning", **fields)
        return loss


class _Worker(Slot):
    """One worker and its present process."""

    process: BaseProcess
    connection: Connection

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.queue: deque[Task] = deque()
        """The candidate that it drives, and the waiting ones."""
        self.capacity = 1
        """Most candidates that it may have."""
        self.pace = math.inf
        """Time of its tests, in s: the longest recent one, forgotten slowly."""
        self.has_started = False
        """Whether its simulator ever has."""
        self.failed_starts = 0
        """Number of consecutive failed starts."""

    @property
    def room(self) -> int:
        """Number of candidates that it can take now."""
        if self.state not in ("idle", "driving"):
            return 0
        return max(0, self.capacity - len(self.queue))

    def finish(self, seconds: float) -> None:
        """Records a finished test."""
        self.queue.popleft()
        self.tests += 1
        self.pace = max(seconds, 0.9 * self.pace) if self.tests > 1 else seconds
        self.capacity = min(PREFETCH, 1 + int(PREFETCHED_TIME / max(self.pace, 1e-4)))

    def begin(self, process: BaseProcess, connection: Connection) -> None:
        self.process, self.connection = process, connection
        self.turn("starting", START_LIMIT)

    def dismiss(self) -> None:
        """Lets it end its simulator after its present test."""
        with suppress(OSError):  # it has died
            self.connection.send_bytes(pickle.dumps(None))

    def await_end(self, deadline: float) -> None:
        """Waits until its simulator has ended; messages meanwhile come too late."""
        with suppress(Exception):  # the connection's end is what is waited for
            while self.connection.poll(max(0.0, deadline - time.monotonic())):
                self.connection.recv_bytes()
        # Not for a driver's threads and processes, which may never end.
        self.process.join(max(0.0, min(_LEAVING_LIMIT, deadline - time.monotonic())))

    def kill(self) -> None:
        """Kills its process with all that it has started."""
        kill_process(self.process)

    def end(self) -> None:
        """Kills its process and waits until it is gone."""
        self.kill()
        self.process.join()
        self.turn("lost")
        self.process.close()
        self.connection.close()


def _selector() -> selectors.BaseSelector | None:
    """Selector for connections and ends of processes; None on Windows.

    Windows waits for few objects at once, and a lost connection also tells of the end.
    """
    return None if sys.platform == "win32" else selectors.DefaultSelector()


# In a worker's process


def serve(connection: Connection, user_files: Sequence[str], tester: bytes) -> None:
    """Tests candidates from the connection until it ends or a None comes.

    Args:
        connection: gives candidates, takes messages.
        user_files: the user's own modules, to load first.
        tester: a packed `RoadTester`, from the process that started this one.
    """
    with serving(connection, pickle.dumps) as line:
        for file in user_files:
            load_user_file(file)
        # Made by our own parent a moment ago and given to us alone, so it may be unpickled.
        the_tester: RoadTester = unpack(tester)
        while _serve_one_start(line, the_tester):
            pass


def _serve_one_start(line: Line, tester: RoadTester) -> bool:
    """Serves while the simulator works; returns whether to start it again."""
    with tester.simulator:
        line.send(pickle.dumps(Ready()))
        while (data := line.receive()) is not None:
            task: Task | None = pickle.loads(data)  # noqa: S301  # from our own parent
            if task is None:
                return False
            attempt = tester.attempt(task.candidate)
            line.send(pickle.dumps(Answer(task.number, attempt)))
            if attempt.simulator_broke:
                return True
    return False


# Messages


class Ready(NamedTuple):
    """The simulator has started; a candidate may be sent."""


class Answer(NamedTuple):
    """The attempt at a task."""

    task: int
    """Number of the task."""
    attempt: Attempt


Message: TypeAlias = Ready | Answer | Failed | Logged
