"""Seats of a worker of a Dask cluster; each tests one candidate at a time.

A task of a campaign opens a seat. The seat stays on the worker as that task's result, for as long
as the campaign holds Dask's future of it. When the campaign releases it, ends or is killed, Dask
drops the result, and the simulator is ended, at the latest with the worker.
"""

from __future__ import annotations

import atexit
import logging
import pickle
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from types import ModuleType
from typing import Any, Final, NamedTuple, NoReturn, TypeVar

import cloudpickle
from distributed import get_worker

from frenetic._support.child_processes import Logged, LogSender
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError, FreneticError, describe_error, reason_of
from frenetic.registry import USER_MODULE, user_files
from frenetic.search.records import Candidate
from frenetic.simulators.embedded import compile_kernels

R = TypeVar("R")

EXIT_LIMIT: Final = 10.0
"""Time that simulators have to end with their worker, in s."""

logger = logging.getLogger(__name__)


class SeatError(FreneticError):
    """An error in a seat, as a text: its class may exist only there."""


class SeatTakenError(SeatError):
    """All seats of a worker are in use, by another campaign or one that just ended."""


class Driven(NamedTuple):
    """A candidate was tested."""

    attempt: Attempt
    logged: list[Logged]
    """Log records of the seat since the last result."""


class Seat:
    """A simulator and a driver, which only one thread ever touches.

    Args:
        worker: address of the worker.
        limit: number of the worker's seats.
        parcel: a `RoadTester`, see `pack`.

    Raises:
        SeatTakenError: there are so many already.
        SeatError: driver or simulator cannot be unpacked or started.
    """

    def __init__(self, worker: str, limit: int, parcel: bytes) -> None:
        thread = _SeatThread(worker, parcel)
        _take_seat(thread, limit)
        thread.begin()
        self._thread_of_seat = thread
        self._end = weakref.finalize(self, thread.end)
        self._end.atexit = False  # `_end_all` does that, and waits for it
        self._ask(thread.start)

    def test(self, candidate: Candidate) -> Driven:
        """Tests a candidate, as by `RoadTester.test`.

        Raises:
            SeatError: the test itself failed, not the drive; the seat is closed.
        """
        thread = self._thread_of_seat
        return self._ask(lambda: thread.test(candidate))

    def restart(self) -> None:
        """Ends the simulator and starts it again.

        Raises:
            SeatError: that failed; the seat is closed.
        """
        self._ask(self._thread_of_seat.restart)

    def close(self) -> None:
        """Ends the simulator.

        Raises:
            SeatError: it did not end well.
        """
        try:
            self._ask(self._thread_of_seat.stop)
        finally:
            self._end()
            self._thread_of_seat.join()

    def _ask(self, job: Callable[[], R]) -> R:
        try:
            return self._thread_of_seat.ask(job)
        except BaseException:
            self._end()  # now: the error's traceback may keep this object for long
            raise

    def __reduce__(self) -> NoReturn:
        raise TypeError("a seat cannot leave its worker")


def open_seat(limit: int, parcel: bytes) -> Seat:
    """A new seat on the worker that runs this task; arguments and errors as for `Seat`."""
    return Seat(get_worker().address, limit, parcel)


class _SeatThread:
    """The thread that uses a seat's driver and simulator, with its jobs.

    It is a daemon, so a hanging drive does not keep the worker from ending.
    """

    def __init__(self, worker: str, parcel: bytes) -> None:
        self.worker = worker
        self._parcel = parcel
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future[Any]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="frenetic-seat", daemon=True)
        self._tester: RoadTester | None = None  # with a simulator that has been started
        self._logged: list[Logged] = []

    def begin(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def ask(self, job: Callable[[], R]) -> R:
        """Runs a job in the thread.

        Raises:
            SeatError: the job's error.
        """
        answer: Future[R] = Future()
        self._jobs.put((job, answer))
        return answer.result()

    def end(self) -> None:
        """Lets the thread end the simulator, and then itself, after its jobs."""
        self._jobs.put(None)

    def join(self, timeout: float | None = None) -> None:
        """Waits for the thread's end, at most so many s."""
        self._thread.join(timeout)

    def start(self) -> None:
        """Unpacks driver and simulator and starts the simulator."""
        compile_kernels()
        # A task may run anything on the worker, so unpickling is as safe as the task.
        tester: RoadTester = pickle.loads(self._parcel)  # noqa: S301
        tester.simulator.__enter__()
        self._tester = tester

    def stop(self) -> None:
        """Ends the simulator, if it has been started."""
        tester, self._tester = self._tester, None
        if tester is not None:
            tester.simulator.__exit__(None, None, None)

    def restart(self) -> None:
        """Ends the simulator and starts it again."""
        tester = self._tester
        assert tester is not None
        self.stop()
        tester.simulator.__enter__()
        self._tester = tester

    def test(self, candidate: Candidate) -> Driven:
        """Tests a candidate."""
        assert self._tester is not None
        attempt = self._tester.attempt(candidate)
        logged, self._logged[:] = self._logged[:], []
        return Driven(attempt, logged)

    def _work(self) -> None:
        handler, own = LogSender(self._logged.append), threading.get_ident()
        handler.addFilter(lambda record: record.thread == own)
        handler.attach()
        while (entry := self._jobs.get()) is not None:
            _answer(*entry)
            del entry
        logging.getLogger("frenetic").removeHandler(handler)
        try:
            self.stop()
        except BaseException as error:
            logger.warning("a simulator did not end well: %s", reason_of(error))
        finally:
            _leave_seat(self)


def _answer(job: Callable[[], R], answer: Future[R]) -> None:
    try:
        answer.set_result(job())
    except BaseException as error:  # also SystemExit: other seats of the worker go on
        answer.set_exception(SeatError(reason_of(error)))


_seat_threads: Final[set[_SeatThread]] = set()
_lock: Final = threading.Lock()


def _take_seat(thread: _SeatThread, limit: int) -> None:
    with _lock:
        if sum(other.worker == thread.worker for other in _seat_threads) >= limit:
            raise SeatTakenError(f"all {limit} seats of the worker are taken by another campaign")
        _seat_threads.add(thread)


def _leave_seat(thread: _SeatThread) -> None:
    with _lock:
        _seat_threads.discard(thread)


@atexit.register
def _end_all() -> None:
    """Ends all simulators of this process."""
    deadline = time.monotonic() + EXIT_LIMIT
    with _lock:
        threads = list(_seat_threads)
    for thread in threads:
        thread.end()
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))


# Driver and simulator in one parcel, for computers without the user's files


def pack(tester: RoadTester) -> bytes:
    """The tester as a parcel with the code of the user's own modules in it.

    These are the modules in the current folder, in the folders of files that the user named, and
    these files themselves. All other imports must be installed where it is unpacked.

    Raises:
        CampaignError: driver or simulator cannot be packed.
    """
    try:
        with _by_value(own_modules()):
            parcel: bytes = cloudpickle.dumps(tester)
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be sent to the workers of a cluster"
            f" ({describe_error(error)}): use local workers, or make it picklable"
        ) from error
    return parcel


def own_modules() -> list[ModuleType]:
    """The user's own modules that this process has imported; packages stand for all in them."""
    folders = {Path.cwd().resolve(), *(Path(file).resolve().parent for file in user_files())}
    return [
        module
        for name, module in sys.modules.copy().items()  # another thread may be importing
        if name.startswith(USER_MODULE)
        or ("." not in name and name not in ("__main__", "frenetic") and _home(module) in folders)
    ]


def _home(module: ModuleType) -> Path | None:
    """The folder in which a module lies, or a package's folder; None if it lies in none."""
    places = list(getattr(module, "__path__", ())) or [getattr(module, "__file__", None)]
    return Path(places[0]).resolve().parent if isinstance(places[0], str) else None


@contextmanager
def _by_value(modules: list[ModuleType]) -> Iterator[None]:
    """Makes cloudpickle send the code of modules instead of their names."""
    known = cloudpickle.list_registry_pickle_by_value()
    fresh = [module for module in modules if module.__name__ not in known]
    for module in fresh:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in fresh:
            cloudpickle.unregister_pickle_by_value(module)
