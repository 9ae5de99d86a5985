"""Workers of a Dask cluster, also on other computers.

The user starts ``dask scheduler``, and on each computer ``dask worker ADDRESS --nthreads 1
--resources simulator=1``. The resource is the number of a worker's seats, each with a driver and a
simulator of its own, which is up as long as the campaign needs it. A seat is the result of a task
that stays on its worker, and a test is a task there, too. So Dask itself ends the seats of a
campaign that is gone.
"""

from __future__ import annotations

import io
import logging
import pickle
import platform
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Literal, NoReturn, Self
from weakref import WeakSet, finalize

from frenetic._support.words import pip_install
from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.local import Seat
from frenetic.campaign.workers.workers import Workers
from frenetic.errors import CampaignError, FreneticError, describe_error, reason_of, traceback_of
from frenetic.recipe import Guest, Named
from frenetic.registry import USER_MODULE, user_files
from frenetic.search.records import Candidate
from frenetic.worker import CLOSING_LIMIT, START_LIMIT, LostWorkerError

try:
    import cloudpickle
    from distributed import Client, Future, get_worker
except ModuleNotFoundError as error:
    raise CampaignError(
        f"a cluster needs Dask, which is not installed: {pip_install('cluster')}"
    ) from error

RESOURCE: Final = "simulator"
"""Resource of a worker, as many as it has seats."""
CONNECT_LIMIT: Final = 10.0
"""Limit for reaching the scheduler, in s."""
NO_SEATS_LIMIT: Final = 60.0
"""Time that a campaign waits for a usable worker of the cluster, in s."""
LOOK_INTERVAL: Final = 1.0
"""Time between two listings of the cluster's workers, in s."""
TAKEN_INTERVAL: Final = 5.0
"""Time between two tries to get a seat that another campaign has, in s."""
RESTART_LIMIT: Final = 30.0
"""Time that a nanny has to end a hanging worker, in s."""
STAYING: Final = ("init", "running", "paused")
"""States of a worker that does not leave."""
_POLL: Final = 0.002  # s

logger = logging.getLogger(__name__)


class TakenError(Exception):
    """All seats of a worker serve other campaigns."""


@dataclass(eq=False)
class _Held:
    """A seat, as the campaign knows it."""

    address: str
    """Of its worker."""
    name: str
    opening: Future
    """Its `_Opened`, which stays on the worker."""
    since: float
    """Beginning of what it does, on the monotonic clock."""
    state: Literal["starting", "idle", "driving"] = "starting"
    candidate: int = 0
    """Id of the one that it drives."""
    call: Future | None = None
    """Its test."""


class ClusterWorkers(Workers):
    """The seats of a Dask cluster's workers that offer the resource ``simulator``.

    Workers may come and go. One that dies costs each candidate that it drives an attempt. One that
    exceeds the limit in a drive is restarted if it has a nanny, as it has by default.

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
        self._silence = ExitStack()
        self._hosts: dict[str, Any] = {}  # as the scheduler describes them, by address
        self._seats: list[_Held] = []
        self._refused: dict[str, tuple[str, float]] = {}  # why, until when, by address
        self._next_look = 0.0
        self._since: float  # without any seats
        self._has_started = False

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return sum(self._is_free(seat) for seat in self._seats)

    def _is_free(self, seat: _Held) -> bool:
        return seat.state == "idle" and _is_running(self._hosts.get(seat.address))

    def submit(self, candidate: Candidate) -> None:
        """Hands a candidate to a free seat."""
        seat = next(seat for seat in self._seats if self._is_free(seat))
        seat.call = self._task(seat.address, _test, seat.opening, candidate)
        seat.state, seat.candidate, seat.since = "driving", candidate.id, time.monotonic()

    def _task(self, address: str, function: Any, *arguments: Any) -> Future:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a network makes a large task
            return self._client.submit(function, *arguments, workers=[address], pure=False)

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns finished attempts.

        Raises:
            CampaignError: the scheduler is lost, or no worker can be used for some time.
        """
        end = time.monotonic() + timeout
        had = self.free
        while True:
            if time.monotonic() >= self._next_look:
                self._look()
            attempts = [one for seat in self._seats.copy() if (one := self._heard(seat))]
            if attempts or self.free > had or time.monotonic() >= end:
                return attempts
            time.sleep(_POLL)

    # Which seats there are

    def _look(self) -> None:
        """Asks for the workers that are there, and opens their seats."""
        now = time.monotonic()
        self._next_look = now + LOOK_INTERVAL
        with suppress(OSError):  # it takes too long
            self._hosts = self._identity()["workers"]
        self._require_connection()
        if any(seat.state != "starting" for seat in self._seats):
            self._since = now
        elif not self._seats:
            self._require_seats(now)
        names = [seat.name for seat in self._seats]
        for address, host in self._hosts.items():
            if _is_running(host) and now >= self._refused.get(address, ("", 0.0))[1]:
                for name in set(_names(address, host)).difference(names):
                    opening = self._task(address, _open, self._parcel, _software())
                    self._seats.append(_Held(address, name, opening, now))

    def _identity(self) -> Any:
        """What the scheduler tells of itself."""
        return self._client.sync(self._client.scheduler.identity, callback_timeout=CONNECT_LIMIT)

    def _require_connection(self) -> None:
        if self._client.status != "running":
            raise CampaignError(
                f"the connection to the Dask scheduler {self._address} is lost: start the cluster"
                " again, then 'frenetic resume'; nothing that was stored is lost"
            )

    def _require_seats(self, now: float) -> None:
        """Ends the wait for a seat: after a while, or at once where none has ever started."""
        troubles, waits = [], False
        for address, host in self._hosts.items():
            if names := _names(address, host):
                reason, until = self._refused.get(address, (f"it is {host['status']}", now))
                troubles.append(f"{names[0]}: {reason}")
                waits = waits or until < float("inf")
        limit = max(NO_SEATS_LIMIT, self._drive_limit if waits else 0.0)
        if troubles and not waits and not self._has_started:
            limit = 0.0
        if now < self._since + limit:
            return
        if troubles:
            raise CampaignError(
                f"no worker of the Dask scheduler {self._address} can be used:"
                f" {'; '.join(troubles)}"
            )
        raise CampaignError(
            f"no worker of the Dask scheduler {self._address} offers a {RESOURCE}: start some"
            f" with 'dask worker {self._address} --nthreads 1 --resources {RESOURCE}=1'"
        )

    # What becomes of a seat

    def _heard(self, seat: _Held) -> Attempt | None:
        """Attends to a seat; returns its finished attempt."""
        seconds = time.monotonic() - seat.since
        if seat.address not in self._hosts:
            return self._lose(seat, "it died or left the cluster")
        if seat.state == "starting":
            if seat.opening.done():
                self._opened(seat)
            elif seconds > START_LIMIT:
                self._lose(seat, f"its start took more than {START_LIMIT:g} s", float("inf"))
        elif seat.call is not None:
            if seat.call.done():
                return self._answered(seat, seat.call, seconds)
            if seconds > self._drive_limit:
                return self._restart(seat)
        elif self._hosts[seat.address]["status"] not in STAYING:
            self._seats.remove(seat)
            seat.opening.release()
        return None

    def _opened(self, seat: _Held) -> None:
        try:
            error = seat.opening.exception()
        except Exception as cancelled:  # with its worker, say
            error = cancelled
        if error is None:
            seat.state, seat.since = "idle", time.monotonic()
            self._has_started = True
            self._log.write(
                LogEvent.WORKER_STARTED, f"worker {seat.name} started", worker=seat.name
            )
        elif isinstance(error, TakenError):
            self._seats.remove(seat)
            again = time.monotonic() + TAKEN_INTERVAL
            self._refused[seat.address] = "it drives for another campaign", again
        else:
            self._lose(seat, _told(error), float("inf"))

    def _answered(self, seat: _Held, call: Future, seconds: float) -> Attempt | None:
        attempt: Attempt
        try:
            attempt, lines = call.result()
        except Exception as error:  # Dask's, since `_test` raises nothing
            return self._lose(seat, _told(error))
        for level, name, text in lines:
            logging.getLogger(name).log(level, "%s: %s", seat.name, text)
        if attempt.worker_lost:
            return self._lose(seat, attempt.result.reason, traceback=attempt.traceback)
        seat.call, seat.state, seat.since = None, "idle", time.monotonic()
        return replace(attempt, worker=seat.name, seconds=seconds)

    def _restart(self, seat: _Held) -> Attempt | None:
        """Lets its nanny end a hanging worker; one without a nanny is left alone."""
        until = float("inf")
        if self._hosts[seat.address].get("nanny"):
            with suppress(Exception):  # it takes too long
                self._client.restart_workers([seat.address], timeout=RESTART_LIMIT)
            until = time.monotonic() + RESTART_LIMIT  # it is usually another one then
        return self._lose(seat, f"its drive took more than {self._drive_limit:.3g} s", until)

    def _lose(
        self, seat: _Held, reason: str, until: float = 0.0, traceback: str = ""
    ) -> Attempt | None:
        """Gives a seat up, and its worker until then; returns the attempt that it drives."""
        self._require_connection()
        self._seats.remove(seat)
        self._refused[seat.address] = reason, until
        self._next_look = 0.0
        seat.opening.release()
        loss = f"worker {seat.name} was lost: {reason}"
        fields: dict[str, Any] = {"worker": seat.name, "reason": reason}
        if seat.call is not None:
            seat.call.release()
            fields["test"] = seat.candidate
        self._log.write(LogEvent.WORKER_LOST, loss, level="warning", **fields)
        if seat.call is None:
            return None
        seconds = time.monotonic() - seat.since
        return Attempt.lost(seat.candidate, seat.name, seconds, loss, traceback)

    def __enter__(self) -> Self:
        """Connects to the scheduler.

        Raises:
            CampaignError: there is none.
        """
        self._client = _connect(self._address)
        self._silence.enter_context(_silenced())
        self._since = time.monotonic()
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """Ends the simulators: at once during an error, else when what runs is done."""
        with self._silence:
            if error is None:
                with suppress(Exception):  # the scheduler is lost, or it takes too long
                    closings = [
                        self._task(seat.address, _close, seat.opening) for seat in self._seats
                    ]
                    for closing in closings:
                        closing.result(timeout=CLOSING_LIMIT)
            self._client.close(timeout=CONNECT_LIMIT)


def _told(error: BaseException) -> str:
    return error.reason if isinstance(error, LostWorkerError) else reason_of(error)


def _is_running(host: Any) -> bool:
    """Whether a worker takes tasks; it may be gone, leaving or short of memory."""
    return host is not None and host["status"] == "running"


def _names(address: str, host: Any) -> list[str]:
    """Names of a worker's seats."""
    number = min(int(host["resources"].get(RESOURCE, 0)), host["nthreads"])
    name = str(host["name"])
    if name == address:
        name = address.partition("://")[2]
    return [name] if number == 1 else [f"{name} seat {k}" for k in range(1, number + 1)]


@contextmanager
def _silenced() -> Iterator[None]:
    """Hides Dask's complaints about a lost scheduler: the campaign says it itself."""
    dask = logging.getLogger("distributed.client")
    level = dask.level
    dask.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        dask.setLevel(level)


def require_scheduler(address: str) -> None:
    """Asks whether a scheduler is there, before a campaign makes its folder.

    Raises:
        CampaignError: there is none.
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


def _software() -> str:
    try:
        ours = version("frenetic-roads")
    except PackageNotFoundError:  # it is somewhere on the path
        ours = "of no version"
    return f"Frenetic {ours} and Python {'.'.join(platform.python_version_tuple()[:2])}"


# In a worker

_opening = threading.Lock()


class _Opened:
    """A seat that is up until nobody refers to this, or its worker ends."""

    seat: Seat
    end: finalize[..., _Opened]

    def __reduce__(self) -> NoReturn:
        """Keeps a worker that is to leave from doing so before the campaign gives this up."""
        raise TypeError("a seat cannot leave its worker")


def _open(parcel: bytes, software: str) -> _Opened:
    """A seat of this worker whose simulator has started.

    Raises:
        TakenError: it has no other.
        LostWorkerError: it does not start, or the campaign has other software.
    """
    if software != _software():
        raise LostWorkerError(
            f"it has {_software()}, this campaign {software}: install the same versions on both"
        )
    worker = get_worker()
    opened = _Opened()
    with _opening:
        if not hasattr(worker, "frenetic_seats"):
            worker.frenetic_seats = WeakSet()
        if len(worker.frenetic_seats) >= worker.state.total_resources.get(RESOURCE, 0):
            raise TakenError
        worker.frenetic_seats.add(opened)
    try:
        # A task may run anything on the worker, so unpickling is as safe as the task.
        opened.seat = pickle.loads(parcel)  # noqa: S301
        opened.end = finalize(opened, _end, opened.seat)
        opened.seat.start()
    except BaseException as error:  # also SystemExit: the worker goes on
        raise LostWorkerError(reason_of(error)) from None
    return opened


def _test(opened: _Opened, candidate: Candidate) -> tuple[Attempt, list[tuple[int, str, str]]]:
    """Tests a candidate in a seat; also what was logged."""
    with _logged() as lines:
        try:
            attempt = opened.seat.test(candidate)
        except BaseException as error:  # also SystemExit: the worker goes on
            reason, trace = reason_of(error), traceback_of(error)
            attempt = Attempt.lost(candidate.id, "", 0.0, reason, trace)
    return attempt, lines


def _close(opened: _Opened) -> None:
    """Ends the simulator of a seat."""
    opened.end()


def _end(seat: Seat) -> None:
    try:
        seat.close()
    except Exception as error:  # what was driven stands
        logger.warning("a simulator did not end well: %s", reason_of(error))


@contextmanager
def _logged() -> Iterator[list[tuple[int, str, str]]]:
    """Level, logger and text of what this thread logs, from INFO on."""
    lines: list[tuple[int, str, str]] = []
    thread = threading.get_ident()

    class Keeper(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == thread:
                lines.append((record.levelno, record.name, record.getMessage()))

    library, keeper = logging.getLogger("frenetic"), Keeper(logging.INFO)
    library.setLevel(min(library.level or logging.INFO, logging.INFO))
    library.addHandler(keeper)
    try:
        yield lines
    finally:
        library.removeHandler(keeper)


# Driver and simulator in one parcel, for computers without the user's files


def pack(tester: RoadTester) -> bytes:
    """A seat as a parcel with the code of the user's own modules in it.

    These are the modules in the current folder, in the folders of files that the user named, and
    these files themselves. All other imports must be installed where it is unpacked.

    Raises:
        CampaignError: driver or simulator cannot be packed.
    """
    try:
        parcel = _parcel(Seat(tester))
    except FreneticError:
        raise
    except Exception as error:
        raise CampaignError(
            "the driver or simulator cannot be sent to the workers of a cluster"
            f" ({describe_error(error)}): use local workers, or make it picklable"
        ) from error
    return parcel


def _parcel(part: object) -> bytes:
    with _by_value(own_modules()):
        file = io.BytesIO()
        _Pickler(file).dump(part)
    return file.getvalue()


def _parcel_of_guest(guest: Guest) -> bytes:
    return _parcel(guest.part)


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]  # it has no types
    """Lets a part that is not made here be packed where it is."""

    def reducer_override(self, part: object) -> Any:
        if isinstance(part, Named):
            return pickle.loads, (part.recipe.ask(_parcel_of_guest),)
        return super().reducer_override(part)


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
