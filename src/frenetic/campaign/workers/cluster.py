"""Workers of a Dask cluster, also on other computers.

The user starts ``dask scheduler``, and on each computer ``dask worker ADDRESS --nthreads 1
--resources simulator=1``. The resource is the number of tests that a worker may drive at once. Each
test is a task that holds one of them, in a worker that keeps driver and simulator for the next.
"""

from __future__ import annotations

import logging
import pickle
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Self

from frenetic.campaign.log import CampaignLog, Event, WorkerState
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.local import Seat
from frenetic.campaign.workers.workers import Workers
from frenetic.errors import CampaignError, describe_error, reason_of, traceback_of
from frenetic.registry import USER_MODULE, user_files
from frenetic.search.records import Candidate

try:
    import cloudpickle
    from distributed import Client, Future, get_worker
except ModuleNotFoundError as error:
    raise CampaignError(
        'a cluster needs Dask, which is not installed: pip install "frenetic-roads[cluster]"'
    ) from error

RESOURCE: Final = "simulator"
"""Resource of a worker, as many as it drives at once."""
CONNECT_LIMIT: Final = 10.0
"""Limit for reaching the scheduler, in s."""
NO_SEATS_LIMIT: Final = 60.0
"""Time that a campaign waits for a usable worker of the cluster, in s."""
LOOK_INTERVAL: Final = 1.0
"""Time between two listings of the cluster's workers, in s."""
_POLL: Final = 0.002  # s

logger = logging.getLogger(__name__)


def require_scheduler(address: str) -> None:
    """Asks whether a scheduler is there, before a campaign makes its folder.

    Raises:
        CampaignError: there is none.
    """
    _connect(address).close()


def _connect(address: str) -> Client:
    try:
        return Client(address, timeout=CONNECT_LIMIT, set_as_default=False, name="frenetic")
    except (OSError, ValueError, TypeError) as error:
        raise CampaignError(
            f"there is no Dask scheduler at {address} ({describe_error(error)}): start one with"
            " 'dask scheduler', and name it as tcp://HOST:PORT"
        ) from None


class ClusterWorkers(Workers):
    """The workers of a Dask cluster that offer the resource ``simulator``.

    Workers may come and go. One that dies costs its candidate an attempt. One that exceeds the
    limit in a drive is restarted if it has a nanny, as it has by default.

    Args:
        tester: copied to each worker, with the code of the user's own modules.
        address: of the cluster's scheduler, such as ``tcp://10.0.0.1:8786``.
        drive_limit: s of wall time after which a worker that tests one candidate counts as hanging.
        log: gets the events of the workers.

    Raises:
        CampaignError: driver or simulator cannot be copied.
    """

    def __init__(
        self, tester: RoadTester, address: str, *, drive_limit: float, log: CampaignLog
    ) -> None:
        self._parcel = pack(tester)
        self._address = address
        self._drive_limit = drive_limit
        self._log = log
        self._client: Client
        self._held: Any
        self._seats: dict[str, int] = {}  # by the worker's address
        self._names: dict[str, str] = {}
        self._running: dict[Future, tuple[int, str, float]] = {}  # id, address, when it began
        self._next_look = 0.0
        self._since = time.monotonic()  # without any seats

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return sum(seats - self._busy(address) for address, seats in self._seats.items())

    def _busy(self, address: str) -> int:
        return sum(one == address for _, one, _ in self._running.values())

    def states(self) -> Mapping[str, WorkerState]:
        """Activity of each worker, by its name."""
        now = time.monotonic()
        since = {address: began for _, address, began in self._running.values()}
        return {
            name: WorkerState(
                name, "driving" if address in since else "idle", 0, now - since.get(address, now)
            )
            for address, name in self._names.items()
        }

    def submit(self, candidate: Candidate) -> None:
        """Hands a candidate to a free worker."""
        address = next(a for a, seats in self._seats.items() if self._busy(a) < seats)
        future = self._client.submit(
            _test, self._held, candidate, workers=[address], resources={RESOURCE: 1}, pure=False
        )
        self._running[future] = candidate.id, address, time.monotonic()

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns finished attempts.

        Raises:
            CampaignError: the scheduler is lost, or no worker can be used for some time.
        """
        end = time.monotonic() + timeout
        while True:
            now = time.monotonic()
            if now >= self._next_look:
                had = self.free
                self._look(now)
                if self.free > had:
                    return ()
            done = [future for future in self._running if future.done()]
            late = [
                future
                for future, (_, address, since) in self._running.items()
                if not future.done()
                and (address not in self._seats or now > since + self._drive_limit)
            ]
            if done or late:
                attempts = [self._attempt(future) for future in done]
                return attempts + [self._give_up(future, now) for future in late]
            if now >= end:
                return ()
            time.sleep(_POLL)

    def _look(self, now: float) -> None:
        self._next_look = now + LOOK_INTERVAL
        try:
            info = self._client.scheduler_info(n_workers=-1)["workers"]
        except Exception:
            info = {}
        if self._client.status != "running":
            raise CampaignError(
                f"the connection to the Dask scheduler {self._address} is lost: start the cluster"
                " again, then 'frenetic resume'; nothing that was stored is lost"
            )
        seats = {
            address: int(worker["resources"].get(RESOURCE, 0))
            for address, worker in info.items()
            if worker.get("status") == "running"
        }
        self._names |= {a: str(info[a].get("name") or a) for a in seats}
        for address in seats.keys() - self._seats.keys():
            if seats[address]:
                name = self._names[address]
                self._log.write(Event.WORKER_STARTED, f"worker {name} started", worker=name)
        self._seats = {address: number for address, number in seats.items() if number}
        if self._seats or self._running:
            self._since = now
        elif now > self._since + NO_SEATS_LIMIT:
            raise CampaignError(
                f"no worker of the Dask scheduler {self._address} offers a {RESOURCE}: start some"
                f" with 'dask worker {self._address} --nthreads 1 --resources {RESOURCE}=1'"
            )

    def _attempt(self, future: Future) -> Attempt:
        number, address, since = self._running.pop(future)
        try:
            attempt: Attempt = future.result()
        except BaseException as error:
            return self._lost(number, address, since, reason_of(error))
        return replace(attempt, worker=self._names[address])

    def _give_up(self, future: Future, now: float) -> Attempt:
        number, address, since = self._running.pop(future)
        with suppress(Exception):
            future.cancel(force=True)
        if address not in self._seats:
            return self._lost(number, address, since, "it died or left the cluster")
        with suppress(Exception):  # it has no nanny
            self._client.restart_workers([address], timeout=30.0, raise_for_error=False)
        return self._lost(number, address, since, f"its drive took more than {now - since:.3g} s")

    def _lost(self, number: int, address: str, since: float, reason: str) -> Attempt:
        name = self._names[address]
        loss = f"worker {name} was lost: {reason}"
        self._log.write(
            Event.WORKER_LOST, loss, level="warning", worker=name, reason=reason, test=number
        )
        return Attempt.lost(number, name, time.monotonic() - since, loss)

    def __enter__(self) -> Self:
        """Connects to the scheduler.

        Raises:
            CampaignError: there is none.
        """
        self._client = _connect(self._address)
        self._held = self._client.scatter(self._parcel, hash=True)
        return self

    def __exit__(self, *_: object) -> None:
        """Gives up what still runs, and closes the simulators."""
        with suppress(Exception):
            self._client.cancel(list(self._running), force=True)
            if self._client.status == "running" and not self._running:
                self._client.run(_close, self._parcel)
        self._client.close()


# In a worker


def _test(parcel: bytes, candidate: Candidate) -> Attempt:
    """Tests a candidate with the driver and the simulator that this worker keeps."""
    kept = _kept()
    key = hash(parcel)
    if key not in kept:
        # A task may run anything on the worker, so unpickling is as safe as the task.
        kept[key] = pickle.loads(parcel)  # noqa: S301
        kept[key].start()
    try:
        attempt: Attempt = kept[key].test(candidate)
    except BaseException as error:  # also SystemExit: the worker goes on
        kept.pop(key, None)
        reason, trace = reason_of(error), traceback_of(error)
        return Attempt.lost(candidate.id, "", 0.0, reason, trace)
    return attempt


def _close(parcel: bytes) -> None:
    """Ends the simulator that a worker keeps."""
    seat = _kept().pop(hash(parcel), None)
    if seat is not None:
        seat.close()


def _kept() -> dict[int, Seat]:
    worker = get_worker()
    if not hasattr(worker, "frenetic_seats"):
        worker.frenetic_seats = {}
    kept: dict[int, Seat] = worker.frenetic_seats
    return kept


# Driver and simulator in one parcel, for computers without the user's files


def pack(tester: RoadTester) -> bytes:
    """A seat as a parcel with the code of the user's own modules in it.

    These are the modules in the current folder, in the folders of files that the user named, and
    these files themselves. All other imports must be installed where it is unpacked.

    Raises:
        CampaignError: driver or simulator cannot be packed.
    """
    try:
        with _by_value(own_modules()):
            parcel: bytes = cloudpickle.dumps(Seat(tester))
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
