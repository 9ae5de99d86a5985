"""Workers on a Dask cluster, whose computers may be many.

The user starts ``dask scheduler``, and on each computer ``dask worker ADDRESS --nthreads 1
--resources simulator=1``. A test of a road is a task of Dask that takes one unit of the resource
``simulator``.

A *seat* is a process that drives roads for one campaign (`frenetic.processes.object_process`). A
Dask worker keeps its seats between tasks in a `_Seats`, the result of another task. Dask frees that
result when the campaign is gone, and its seats end with it. Dask itself repeats the tests of a
worker that dies.
"""

from __future__ import annotations

import logging
import multiprocessing
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Self
from weakref import finalize

from frenetic._support.words import pip_install
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.local import TesterHost, lost_attempt
from frenetic.campaign.workers.workers import Workers
from frenetic.errors import CampaignError, FreneticError, Trouble, describe_error, reason_of
from frenetic.parts.user_modules import USER_MODULE, user_files
from frenetic.processes.object_process import LostProcessError, ObjectProcess
from frenetic.search.records import Candidate
from frenetic.simulators.blame import Blame

try:
    import cloudpickle
    from distributed import Client, Future, get_worker
except ModuleNotFoundError as error:
    raise CampaignError(
        f"a cluster needs Dask, which is not installed: {pip_install('cluster')}"
    ) from error

RESOURCE: Final = "simulator"
"""Name of a Dask worker's resource; it has as many units as it drives roads at once."""
CONNECT_LIMIT: Final = 10.0
"""Longest time to reach the scheduler, in s; our choice."""
NO_SEATS_LIMIT: Final = 60.0
"""Longest time that a campaign waits for a worker with the resource, in s; our choice."""
LISTING_INTERVAL: Final = 1.0
"""Time between two listings of the cluster's workers, in s; our choice."""
_POLL_INTERVAL: Final = 0.002  # [s] between two checks for finished tests


class ClusterWorkers(Workers):
    """The workers of a Dask cluster that offer the resource ``simulator``; they may come and go.

    Args:
        tester: tester that is copied to each worker, with the code of the user's own modules.
        address: address of the cluster's scheduler, such as ``tcp://10.0.0.1:8786``.
        drive_limit: wall time after which a seat that tests one candidate counts as hanging and is
            killed, in s.
        log: log of the campaign, into which lost workers are written.

    Raises:
        CampaignError: driver or simulator cannot be copied.
    """

    def __init__(
        self, tester: RoadTester, address: str, *, drive_limit: float, log: CampaignLog
    ) -> None:
        self._parcel = pack(tester)
        self._blame = Blame.of(tester.simulator, tester.driver)
        self._address = address
        self._drive_limit = drive_limit
        self._log = log
        self._client: Client
        self._seats: Future
        self._running: dict[Future, _RunningTest] = {}
        self._seats_of: dict[str, int] = {}  # address of a Dask worker -> its number of seats
        # On the monotonic clock, in s:
        self._next_listing = 0.0
        self._seats_seen_at = 0.0  # latest listing that held a seat

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return sum(max(0, count) for count in self._free_seats.values())

    @property
    def _free_seats(self) -> dict[str, int]:
        """Address of a Dask worker -> its number of free seats; negative where tests wait."""
        taken = Counter(test.address for test in self._running.values())
        return {address: count - taken[address] for address, count in self._seats_of.items()}

    def submit(self, candidate: Candidate) -> None:
        """Hand a candidate to the cluster."""
        # Dask by itself would let tasks wait at one worker while another is free.
        free = self._free_seats
        address = max(free, key=free.__getitem__)
        placement: Any = {"workers": [address], "allow_other_workers": True}
        test = self._client.submit(
            _test, self._seats, candidate, resources={RESOURCE: 1}, pure=False, **placement
        )
        self._running[test] = _RunningTest(candidate.id, address, time.monotonic())

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Wait until a test is done or a seat becomes free, for at most ``timeout`` s.

        Returns:
            finished attempts, none if only a seat became free.

        Raises:
            CampaignError: the scheduler is lost, no worker is there for `NO_SEATS_LIMIT`, or a
                simulator does not start.
        """
        deadline, free_before = time.monotonic() + timeout, self.free
        while True:
            self._count_seats()
            done = [test for test in self._running if test.done()]
            if done or self.free > free_before or time.monotonic() >= deadline:
                return [self._attempt(test) for test in done]
            time.sleep(_POLL_INTERVAL)

    def _require_connection(self) -> None:
        """Check that the scheduler is there.

        Raises:
            CampaignError: the connection is lost.
        """
        if self._client.status != "running":
            raise CampaignError(
                f"the connection to the Dask scheduler {self._address} is lost: start the cluster"
                " again, then 'frenetic resume'; nothing that was stored is lost"
            )

    def _count_seats(self) -> None:
        """Count the seats of the cluster's workers, once in `LISTING_INTERVAL`.

        Raises:
            CampaignError: the scheduler is lost, or no worker is there for `NO_SEATS_LIMIT`.
        """
        self._require_connection()
        now = time.monotonic()
        if now < self._next_listing:
            return
        self._next_listing = now + LISTING_INTERVAL
        with suppress(OSError):  # too slow an answer: the last numbers stay
            identity = self._client.scheduler.identity
            dask_workers = self._client.sync(identity, callback_timeout=CONNECT_LIMIT)["workers"]
            self._seats_of = {
                address: min(int(worker["resources"].get(RESOURCE, 0)), worker["nthreads"])
                for address, worker in dask_workers.items()
                if worker["status"] == "running"
            }
        if any(self._seats_of.values()):
            self._seats_seen_at = now
        elif now > self._seats_seen_at + NO_SEATS_LIMIT:
            raise CampaignError(
                f"no worker of the Dask scheduler {self._address} offers a {RESOURCE}: start some"
                f" with 'dask worker {self._address} --nthreads 1 --resources {RESOURCE}=1'"
            )

    def _attempt(self, test: Future) -> Attempt:
        """Return the attempt of a test that is done; write into the log if its worker was lost.

        Raises:
            CampaignError: the seat did not start, or the scheduler is lost.
        """
        running = self._running.pop(test)
        try:
            attempt: Attempt = test.result()
        except _NoStartError as error:
            raise CampaignError(f"no worker could be started: {error}") from None
        except Exception as error:  # Dask gives a task up whose workers have died too often
            self._require_connection()
            seconds = time.monotonic() - running.submitted_at
            loss = f"its worker was lost: {reason_of(error)}"
            attempt = Attempt.lost(running.candidate_id, "the cluster", seconds, Trouble(loss))
        if attempt.worker_lost:
            fields: dict[str, Any] = {
                "worker": attempt.worker,
                "reason": attempt.result.reason,
                "test": running.candidate_id,
            }
            self._log.write(LogEvent.WORKER_LOST, attempt.result.reason, level="warning", **fields)
        return attempt

    def __enter__(self) -> Self:
        """Connect to the scheduler.

        Raises:
            CampaignError: no scheduler answers at the address.
        """
        # The campaign itself says that the scheduler is lost, so Dask's log stays silent.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._client = _connect(self._address)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a large task: a driver's network
            self._seats = self._client.submit(
                _Seats, self._parcel, self._drive_limit, self._blame, pure=False
            )
        self._seats_seen_at = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection; then Dask frees the seats, which ends them."""
        self._running.clear()
        with suppress(OSError, RuntimeError):  # raised by Dask if its scheduler is lost
            self._client.close(timeout=CONNECT_LIMIT)

    @staticmethod
    def require_scheduler(address: str) -> None:
        """Check that a scheduler answers, before a campaign makes its folder.

        Raises:
            CampaignError: no scheduler answers at the address.
        """
        _connect(address).close()


@dataclass(frozen=True)
class _RunningTest:
    """A test that was submitted to the cluster."""

    candidate_id: int
    address: str
    """Address of the Dask worker that was to take the test; another one may take it."""
    submitted_at: float
    """Time of the submission on the monotonic clock, in s."""


def _connect(address: str) -> Client:
    """Return a client of the scheduler at an address.

    Raises:
        CampaignError: no scheduler answers.
    """
    try:
        return Client(address, timeout=CONNECT_LIMIT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise CampaignError(
            f"there is no Dask scheduler at {address!r} ({describe_error(error)}): start one with"
            " 'dask scheduler', and name it as tcp://HOST:PORT"
        ) from None


# The functions and classes below run in a Dask worker.


class _NoStartError(Exception):
    """A seat does not start."""


class _Seats:
    """The seats of a Dask worker for one campaign: processes that end when this object is freed.

    Args:
        parcel: the tester, as `pack` returns it.
        drive_limit: wall time after which a seat that tests one candidate is killed, in s.
        blame: whose fault the loss of a seat is.
    """

    def __init__(self, parcel: bytes, drive_limit: float, blame: Blame) -> None:
        self.parcel = parcel
        self.drive_limit = drive_limit
        self.blame = blame
        self.idle: list[ObjectProcess] = []
        """Seats that wait for a candidate."""
        # In a thread of its own, since closing seats takes time.
        finalize(
            self, lambda idle: threading.Thread(target=_close_all, args=(idle,)).start(), self.idle
        )

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[bytes, float, Blame]]:
        """Give each Dask worker that gets a copy seats of its own."""
        return _Seats, (self.parcel, self.drive_limit, self.blame)


def _close_all(seats: list[ObjectProcess]) -> None:
    """Close seats; the loss of a seat no longer matters."""
    for seat in seats:
        with suppress(LostProcessError):
            seat.close()


def _test(seats: _Seats, candidate: Candidate) -> Attempt:
    """Test a candidate in an idle seat, or in a new one.

    Raises:
        _NoStartError: the new seat does not start.
    """
    # Dask's nanny makes its worker a daemon, which may start no processes, since they could outlive
    # it. A seat ends with its parent.
    multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
    name = str(get_worker().name).rpartition("://")[2]
    seat = seats.idle.pop() if seats.idle else _started(ObjectProcess(name, seats.parcel))
    start = time.monotonic()
    try:
        attempt: Attempt = seat.call("test", candidate, limit=seats.drive_limit, answer=Attempt)
    except LostProcessError as error:
        seat.kill()
        seconds = time.monotonic() - start
        return lost_attempt(candidate.id, name, error, seats.blame.fault(error), seconds)
    if attempt.simulator_broke:
        seat.kill()
    else:
        seats.idle.append(seat)
    return replace(attempt, worker=name)


def _started(seat: ObjectProcess) -> ObjectProcess:
    """Start a seat and return it.

    Raises:
        _NoStartError: the seat does not start.
    """
    try:
        seat.start()
        seat.answer()
    except (LostProcessError, OSError, EOFError) as error:
        seat.kill()
        raise _NoStartError(f"{seat.name}: {error}") from None
    return seat


# A tester as a parcel, for computers without the user's files.


def pack(tester: RoadTester) -> bytes:
    """Return a pickled tester that holds the code of the user's own modules.

    These are the modules in the current folder, in the folders of files that the user named, and
    these files themselves. All other modules must be installed where the tester is unpickled.

    Raises:
        CampaignError: driver or simulator cannot be pickled.
    """
    try:
        # Without the spec, driver and simulator travel as objects instead of names.
        return _pickled(TesterHost(replace(tester, spec=None)))
    except FreneticError:
        raise
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be sent to the workers of a cluster"
            f" ({describe_error(error)}): use local workers, or make it picklable"
        ) from error


def _pickled(host: TesterHost) -> bytes:
    """Return a pickled object with the code of the user's own modules."""
    with _by_value(own_modules()):
        pickled: bytes = cloudpickle.dumps(host)
    return pickled


def own_modules() -> list[ModuleType]:
    """Return the user's own modules that this process has imported.

    Of a package only its top is there, which stands for all modules in it.
    """
    folders = {Path.cwd().resolve(), *(Path(file).resolve().parent for file in user_files())}
    return [
        module
        for name, module in sys.modules.copy().items()  # another thread may be importing
        if name.startswith(USER_MODULE)
        or ("." not in name and name not in ("__main__", "frenetic") and _home(module) in folders)
    ]


def _home(module: ModuleType) -> Path | None:
    """Return the folder that holds a module's file or a package's folder; None for a built-in."""
    paths = list(getattr(module, "__path__", ())) or [getattr(module, "__file__", None)]
    return Path(paths[0]).resolve().parent if isinstance(paths[0], str) else None


@contextmanager
def _by_value(modules: list[ModuleType]) -> Iterator[None]:
    """Make cloudpickle send the code of modules instead of their names, until the block ends."""
    registered = cloudpickle.list_registry_pickle_by_value()
    new = [module for module in modules if module.__name__ not in registered]
    for module in new:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in new:
            cloudpickle.unregister_pickle_by_value(module)
