"""The link of a campaign to Dask: calls on seats, and events of the cluster.

Dask's client has its own thread. It puts events into a queue as messages, which the campaign's
thread takes out; so the campaign waits for one thing only, and is woken at once.

Dask's ``as_completed`` would wait for finished tasks only. A campaign also has to hear that a
worker joined, leaves, died or cannot run its code, and that the scheduler is gone, while no task
finishes. Workers that hang are restarted by their nannies, as Dask does it.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import platform
import threading
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from queue import SimpleQueue
from typing import Any, Final, TypeAlias

from distributed import Client, Future

from frenetic.campaign.workers.dask.seats import SeatTakenError
from frenetic.errors import CampaignError, describe_error, reason_of

RESOURCE: Final = "simulator"
"""Resource of a worker, as many as it has seats."""
CONNECT_LIMIT: Final = 10.0
"""Limit for reaching the scheduler, in s."""
LOOK_INTERVAL: Final = 1.0
"""Time between two listings of the cluster's workers, beside their joining and leaving, in s."""
RESTART_LIMIT: Final = 30.0
"""Time that a nanny has to end a hanging worker, in s."""

_DISTRIBUTION: Final = "frenetic-roads"

_logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Host:
    """A worker of the cluster, as its scheduler describes it."""

    address: str
    name: str
    """Its given name, else host and port."""
    nanny: str | None
    """Address of its nanny, which starts it again when it dies."""
    seats: int
    """Number of tests that it can drive at once."""
    is_running: bool
    """Whether it takes tasks; otherwise it is short of memory or leaves."""
    is_leaving: bool
    """Whether it takes no more tasks."""


class Call:
    """A task for a seat; compared by identity."""

    def __init__(self, link: DaskLink) -> None:
        self._link = link
        self.future: Future | None = None
        """Used by the link's thread only."""

    def release(self) -> None:
        """Releases its result, on the cluster, too; a task that has not begun never will."""
        self._link.release(self)


@dataclass(frozen=True)
class Seen:
    """The present workers."""

    hosts: dict[str, Host]
    """Workers by address."""


@dataclass(frozen=True)
class Gone:
    """A worker has left."""

    address: str


@dataclass(frozen=True)
class Checked:
    """Trouble with the software of a worker; empty if there is none."""

    address: str
    trouble: str


@dataclass(frozen=True)
class Done:
    """A call has ended."""

    call: Call
    value: Any = None
    trouble: str = ""
    """Reason of its failure; empty if it succeeded."""
    seat_is_taken: bool = False
    """Whether it failed only because another campaign uses the worker."""


@dataclass(frozen=True)
class Disconnected:
    """The connection to the scheduler is lost."""

    reason: str = ""
    """Reason, if known."""


Message: TypeAlias = Seen | Gone | Checked | Done | Disconnected


class DaskLink:
    """A connection to the scheduler of a Dask cluster.

    Args:
        address: of the scheduler.
        messages: queue for the events.

    Raises:
        CampaignError: the scheduler cannot be reached, or has another version of Frenetic.
    """

    def __init__(self, address: str, messages: SimpleQueue[Message]) -> None:
        self.address = address
        self._messages = messages
        self._client: Client
        self._loop = asyncio.new_event_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._closing = asyncio.Event()
        self._look_now = asyncio.Event()
        self._last_seen: dict[str, Host] | None = None
        connected: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._thread = threading.Thread(
            target=self._live, args=(connected,), name="frenetic-dask", daemon=True
        )
        self._thread.start()
        try:
            connected.result()
        except BaseException:  # Ctrl-C: the thread ends when it has connected, or has failed to
            self._soon(self._closing.set)
            raise

    def call(
        self, address: str, function: Callable[..., Any], *arguments: Any, keep: bool = False
    ) -> Call:
        """Calls a function in a seat of a worker; its end comes as a `Done`.

        Args:
            address: of the worker.
            function: sent by name, so the worker must have its module.
            arguments: a `Call` stands for its result.
            keep: leaves the result on the worker.
        """
        call = Call(self)
        self._soon(self._submit, call, address, function, arguments, keep)
        return call

    def release(self, call: Call) -> None:
        """Releases a call's result, on the cluster, too; a task that has not begun never will."""
        self._soon(self._release, call)

    def check(self, address: str) -> None:
        """Compares the software of a worker with ours; the result comes as a `Checked`."""
        self._soon(self._begin, self._check, address)

    def restart(self, address: str) -> None:
        """Lets a worker's nanny kill and restart it."""
        self._soon(self._begin, self._restart, address)

    def close(self) -> None:
        """Closes the connection; the workers finish running tasks and drop their results."""
        self._soon(self._closing.set)
        self._thread.join(CONNECT_LIMIT)

    def _soon(self, function: Callable[..., object], *arguments: Any) -> None:
        """Calls a function in the link's thread, in the order of these calls."""
        with suppress(RuntimeError):  # the connection is closed already
            self._loop.call_soon_threadsafe(function, *arguments)

    def _live(self, connected: concurrent.futures.Future[None]) -> None:
        """The work of the link's thread."""
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._stay(connected))
        except Exception as error:
            if not connected.done():
                connected.set_exception(error)
            else:
                _logger.debug("the connection was not closed well", exc_info=True)

    async def _stay(self, connected: concurrent.futures.Future[None]) -> None:
        """Connects, and stays connected until the link is closed."""
        self._client = Client(
            self.address, asynchronous=True, timeout=CONNECT_LIMIT, set_as_default=False
        )
        try:
            await self._connect()
            self._client.subscribe_topic("all", self._hear)
            self._begin(self._watch)
            connected.set_result(None)
            await self._closing.wait()
            self._client.unsubscribe_topic("all")
        finally:
            with _silenced():
                await self._client.close(timeout=CONNECT_LIMIT)

    async def _connect(self) -> None:
        try:
            await self._client
        except Exception as error:
            raise CampaignError(
                f"the Dask scheduler {self.address!r} cannot be reached ({describe_error(error)}):"
                " start one with 'dask scheduler' and give the address that it prints, such as"
                " tcp://10.0.0.1:8786"
            ) from error
        await self._check_scheduler()

    async def _check_scheduler(self) -> None:
        """Raises a `CampaignError` if the scheduler, which reads our tasks, does not know them."""
        try:
            found: object = await self._client.run_on_scheduler(version, _DISTRIBUTION)
        except Exception as error:
            found = error
        trouble = software_trouble(found, platform.python_version())
        if trouble:
            raise CampaignError(f"the Dask scheduler {self.address} cannot be used: {trouble}")

    def _begin(self, coroutine: Callable[..., Coroutine[Any, Any, None]], *arguments: Any) -> None:
        task = asyncio.create_task(coroutine(*arguments))
        self._tasks.add(task)  # which the loop does not keep
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._messages.put(Disconnected(describe_error(error)))

    def _submit(
        self,
        call: Call,
        address: str,
        function: Callable[..., Any],
        arguments: Iterable[Any],
        keep: bool,
    ) -> None:
        try:
            call.future = self._client.submit(
                function,
                *(one.future if isinstance(one, Call) else one for one in arguments),
                workers=[address],
                allow_other_workers=False,
                resources={RESOURCE: 1},
                pure=False,
                retries=0,
            )
        except Exception as error:  # the connection is being lost
            self._messages.put(Done(call, None, reason_of(error)))
        else:
            self._begin(self._await, call, call.future, keep)

    def _release(self, call: Call) -> None:
        if call.future is not None:
            call.future.release()

    async def _watch(self) -> None:
        """Lists the workers periodically."""
        while True:
            if self._client.status != "running":
                self._messages.put(Disconnected())
                return
            self._look_now.clear()
            with suppress(OSError):  # also if it takes too long; the status tells when it is lost
                scheduler = self._client.scheduler
                identity = await asyncio.wait_for(scheduler.identity(), CONNECT_LIMIT)
                hosts = {
                    address: _host(address, one) for address, one in identity["workers"].items()
                }
                if hosts != self._last_seen:
                    self._last_seen = hosts
                    self._messages.put(Seen(hosts))
            with suppress(TimeoutError):
                await asyncio.wait_for(self._look_now.wait(), LOOK_INTERVAL)

    def _hear(self, event: tuple[float, Any]) -> None:
        """Handles an event that the scheduler sends to all listeners."""
        match event[1]:
            case {"action": "remove-worker", "worker": str(address)}:
                self._last_seen = None  # another worker may come to the same address
                self._messages.put(Gone(address))
                self._look_now.set()
            case {"action": "add-worker"}:
                self._look_now.set()

    async def _await(self, call: Call, future: Future, keep: bool) -> None:
        """Waits until a call has ended."""
        try:
            error = await future.exception()
            if error is not None:
                done = Done(call, None, reason_of(error), isinstance(error, SeatTakenError))
            elif future.status != "finished":
                done = Done(call, None, f"its task was {future.status}")
            else:
                done = Done(call, None if keep else await future.result())
        except (Exception, asyncio.CancelledError) as error:  # of the call, or of this task
            done = Done(call, None, reason_of(error))
        # Everything is cancelled when the connection is lost.
        self._messages.put(done if self._client.status == "running" else Disconnected())

    async def _check(self, address: str) -> None:
        only: dict[str, Any] = {"workers": [address], "on_error": "return"}
        try:
            found = await self._client.run(version, _DISTRIBUTION, **only)
            python = await self._client.run(platform.python_version, **only)
            trouble = software_trouble(found[address], python[address])
        except Exception as error:
            trouble = f"it does not answer ({describe_error(error)})"
        self._messages.put(Checked(address, trouble))

    async def _restart(self, address: str) -> None:
        try:
            await self._client.restart_workers([address], timeout=RESTART_LIMIT)
        except Exception as error:
            _logger.warning("worker %s could not be restarted: %s", address, describe_error(error))


@contextmanager
def _silenced() -> Iterator[None]:
    """Hides Dask's complaints about a lost scheduler while its client is closed."""
    logger = logging.getLogger("distributed.client")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def software_trouble(found: object, python: object) -> str:
    """Reason why a computer cannot run our tasks; empty if there is none.

    Args:
        found: its version of Frenetic, or the error of asking for it.
        python: its version of Python, likewise.
    """
    try:
        ours = version(_DISTRIBUTION)
    except PackageNotFoundError:  # it is not installed, but somewhere on the path
        return ""
    our_python = platform.python_version()
    if isinstance(found, PackageNotFoundError):
        return f"it has no Frenetic: install frenetic-roads[cluster]=={ours} there"
    if isinstance(found, Exception):
        return f"it cannot be asked for its version of Frenetic ({describe_error(found)})"
    if found != ours:
        return f"it has Frenetic {found}, this campaign {ours}: install the same version on both"
    if str(python).split(".")[:2] != our_python.split(".")[:2]:
        return (
            f"it runs Python {python}, this campaign {our_python}: install the same version on both"
        )
    return ""


def _host(address: str, info: Mapping[str, Any]) -> Host:
    name = str(info["name"])
    return Host(
        address=address,
        name=address.partition("://")[2] if name == address else name,
        nanny=info["nanny"],
        seats=min(int(info["resources"].get(RESOURCE, 0)), info["nthreads"]),
        is_running=info["status"] == "running",
        is_leaving=info["status"] not in ("init", "running", "paused"),
    )
