"""Workers of a Dask cluster, also on other computers.

The user starts ``dask scheduler``, and on each computer ``dask worker ADDRESS --nthreads 1
--resources simulator=1``. A test is a task that takes one of the resource. It drives in a process
of its own (`frenetic.processes.object_process`), which its worker keeps as long as the campaign
holds its `_Seats`. So Dask itself repeats the tests of a worker that dies, and ends the seats of a
campaign that is gone.
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
from dataclasses import replace
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
"""Resource of a worker, as many as it drives roads at once."""
CONNECT_LIMIT: Final = 10.0
"""Limit for reaching the scheduler, in s."""
NO_SEATS_LIMIT: Final = 60.0
"""Time that a campaign waits for a worker of the cluster, in s."""
LOOK_INTERVAL: Final = 1.0
"""Time between two listings of the cluster's workers, in s."""
_POLL: Final = 0.002  # s


class ClusterWorkers(Workers):
    """The workers of a Dask cluster that offer the resource ``simulator``; they may come and go.

    Args:
        tester: copied to each worker, with the code of the user's own modules.
        address: of the cluster's scheduler, such as ``tcp://10.0.0.1:8786``.
        drive_limit: s of wall time after which a process that tests one candidate counts as
            hanging and is killed.
        log: gets the events of the workers.

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
        self._running: dict[Future, tuple[int, str, float]] = {}  # candidate's id, where, since
        self._seats_at: dict[str, int] = {}  # address of a worker -> its number of seats
        self._next_look = 0.0
        self._last_seen = 0.0  # seats

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return sum(max(0, number) for number in self._free_at.values())

    @property
    def _free_at(self) -> dict[str, int]:
        taken = Counter(address for _, address, _ in self._running.values())
        return {address: number - taken[address] for address, number in self._seats_at.items()}

    def submit(self, candidate: Candidate) -> None:
        """Hand a candidate to the cluster."""
        free = self._free_at
        address = max(free, key=free.__getitem__)  # Dask itself lets tasks wait at some of them
        where: Any = {"workers": [address], "allow_other_workers": True}
        test = self._client.submit(
            _test, self._seats, candidate, resources={RESOURCE: 1}, pure=False, **where
        )
        self._running[test] = candidate.id, address, time.monotonic()

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Wait until something happens, for at most so many s; returns finished attempts.

        Raises:
            CampaignError: the scheduler is lost, no worker is there for some time, or a simulator
                does not start.
        """
        end, had = time.monotonic() + timeout, self.free
        while True:
            self._look()
            done = [test for test in self._running if test.done()]
            if done or self.free > had or time.monotonic() >= end:
                return [self._attempt(test) for test in done]
            time.sleep(_POLL)

    def _require_connection(self) -> None:
        if self._client.status != "running":
            raise CampaignError(
                f"the connection to the Dask scheduler {self._address} is lost: start the cluster"
                " again, then 'frenetic resume'; nothing that was stored is lost"
            )

    def _look(self) -> None:
        """Counts the seats that are there."""
        self._require_connection()
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + LOOK_INTERVAL
        with suppress(OSError):  # it takes too long
            identity = self._client.scheduler.identity
            hosts = self._client.sync(identity, callback_timeout=CONNECT_LIMIT)["workers"]
            self._seats_at = {
                address: min(int(host["resources"].get(RESOURCE, 0)), host["nthreads"])
                for address, host in hosts.items()
                if host["status"] == "running"
            }
        if any(self._seats_at.values()):
            self._last_seen = now
        elif now > self._last_seen + NO_SEATS_LIMIT:
            raise CampaignError(
                f"no worker of the Dask scheduler {self._address} offers a {RESOURCE}: start some"
                f" with 'dask worker {self._address} --nthreads 1 --resources {RESOURCE}=1'"
            )

    def _attempt(self, test: Future) -> Attempt:
        number, _, since = self._running.pop(test)
        try:
            attempt: Attempt = test.result()
        except _NoStartError as error:
            raise CampaignError(f"no worker could be started: {error}") from None
        except Exception as error:  # Dask's, whose workers have died too often
            self._require_connection()
            seconds = time.monotonic() - since
            loss = f"its worker was lost: {reason_of(error)}"
            attempt = Attempt.lost(number, "the cluster", seconds, Trouble(loss))
        if attempt.worker_lost:
            fields: dict[str, Any] = {
                "worker": attempt.worker,
                "reason": attempt.result.reason,
                "test": number,
            }
            self._log.write(LogEvent.WORKER_LOST, attempt.result.reason, level="warning", **fields)
        return attempt

    def __enter__(self) -> Self:
        """Connect to the scheduler.

        Raises:
            CampaignError: there is none.
        """
        # It complains of a lost scheduler, which the campaign says itself.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._client = _connect(self._address)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a network makes a large task
            self._seats = self._client.submit(
                _Seats, self._parcel, self._drive_limit, self._blame, pure=False
            )
        self._last_seen = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        """Let the cluster forget the seats, which ends them."""
        self._running.clear()
        with suppress(OSError, RuntimeError):  # Dask's own, where its scheduler is lost
            self._client.close(timeout=CONNECT_LIMIT)

    @staticmethod
    def require_scheduler(address: str) -> None:
        """Connect to a scheduler, before a campaign makes its folder.

        Raises:
            CampaignError: no scheduler answers at the address.
        """
        _connect(address).close()


def _connect(address: str) -> Client:
    try:
        return Client(address, timeout=CONNECT_LIMIT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise CampaignError(
            f"there is no Dask scheduler at {address!r} ({describe_error(error)}): start one with"
            " 'dask scheduler', and name it as tcp://HOST:PORT"
        ) from None


# In a worker


class _NoStartError(Exception):
    """A seat does not start."""


class _Seats:
    """The seats of a Dask worker for one campaign: processes that end when this is forgotten."""

    def __init__(self, parcel: bytes, drive_limit: float, blame: Blame) -> None:
        self.parcel = parcel
        self.drive_limit = drive_limit
        self.blame = blame
        self.idle: list[ObjectProcess] = []
        finalize(self, lambda idle: threading.Thread(target=_end, args=(idle,)).start(), self.idle)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[bytes, float, Blame]]:
        """Give each Dask worker seats of its own."""
        return _Seats, (self.parcel, self.drive_limit, self.blame)


def _end(seats: list[ObjectProcess]) -> None:
    for seat in seats:
        with suppress(LostProcessError):  # what was driven stands
            seat.close()


def _test(seats: _Seats, candidate: Candidate) -> Attempt:
    """Tests a candidate in an idle seat, or in a new one.

    Raises:
        _NoStartError: that does not start.
    """
    # A nanny's worker may have no processes, since it could be killed without their knowing; ours
    # end with it.
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
    try:
        seat.start()
        seat.answer()
    except (LostProcessError, OSError, EOFError) as error:
        seat.kill()
        raise _NoStartError(f"{seat.name}: {error}") from None
    return seat


# Driver and simulator in one parcel, for computers without the user's files


def pack(tester: RoadTester) -> bytes:
    """A seat as a parcel with the code of the user's own modules in it.

    These are the modules in the current folder, in the folders of files that the user named, and
    these files themselves. All other imports must be installed where it is unpacked.

    Raises:
        CampaignError: driver or simulator cannot be packed.
    """
    try:
        return _parcel(TesterHost(replace(tester, spec=None)))  # as objects, with their code
    except FreneticError:
        raise
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be sent to the workers of a cluster"
            f" ({describe_error(error)}): use local workers, or make it picklable"
        ) from error


def _parcel(part: object) -> bytes:
    with _by_value(own_modules()):
        parcel: bytes = cloudpickle.dumps(part)
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
    """Return the folder in which a module lies, or a package's folder; None if it lies in none."""
    places = list(getattr(module, "__path__", ())) or [getattr(module, "__file__", None)]
    return Path(places[0]).resolve().parent if isinstance(places[0], str) else None


@contextmanager
def _by_value(modules: list[ModuleType]) -> Iterator[None]:
    """Make cloudpickle send the code of modules instead of their names."""
    known = cloudpickle.list_registry_pickle_by_value()
    fresh = [module for module in modules if module.__name__ not in known]
    for module in fresh:
        cloudpickle.register_pickle_by_value(module)
    try:
        yield
    finally:
        for module in fresh:
            cloudpickle.unregister_pickle_by_value(module)
