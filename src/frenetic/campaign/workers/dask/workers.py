"""Workers of a Dask cluster, also on other computers.

The user starts ``dask scheduler``, and on each computer ``dask worker ADDRESS --nthreads 1
--resources simulator=1``. The resource is the number of tests that a worker may drive at once: its
seats. A campaign opens each seat once, for as long as it runs, and hands it one candidate after the
other, so it knows the worker of each drive.

`seats` holds the seats, `link` the connection to Dask; this module decides.
"""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import Final, Self

from frenetic.campaign.log import CampaignLog, Event, WorkerState
from frenetic.campaign.record import Attempt
from frenetic.campaign.store import JSONValue
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.local import CLOSING_LIMIT, START_LIMIT, STARTS
from frenetic.campaign.workers.workers import Slot, Workers, states_of
from frenetic.errors import CampaignError
from frenetic.search.records import Candidate

try:
    from frenetic.campaign.workers.dask.link import (
        RESOURCE,
        Call,
        Checked,
        DaskLink,
        Disconnected,
        Done,
        Gone,
        Host,
        Message,
        Seen,
    )
    from frenetic.campaign.workers.dask.seats import Driven, Seat, open_seat, pack
except ModuleNotFoundError as error:
    if error.name not in ("cloudpickle", "dask", "distributed"):
        raise
    raise CampaignError(
        'a cluster needs Dask, which is not installed: pip install "frenetic-roads[cluster]"'
    ) from error

NO_SEATS_LIMIT: Final = 60.0
"""Time that a campaign waits for a usable worker of the cluster, in s."""
NO_SEATS_TOLD_AFTER: Final = 5.0
"""Wait after which the log says so, in s; a nanny restarts a worker faster."""
TAKEN_INTERVAL: Final = 5.0
"""Time between two tries of a seat that another campaign uses, in s."""

logger = logging.getLogger(__name__)


def require_scheduler(address: str) -> None:
    """Asks whether a scheduler is there, before a campaign makes its folder.

    Raises:
        CampaignError: there is none, or it cannot be used.
    """
    DaskLink(address, SimpleQueue()).close()


class ClusterWorkers(Workers):
    """The seats of a Dask cluster's workers: as many as they offer of the resource ``simulator``.

    Workers may come and go. One that dies costs its candidate an attempt. One that exceeds the
    limit in a drive is restarted if it has a nanny, as it has by default; otherwise the seat is not
    used any more.

    Args:
        tester: copied to each seat, with the code of the user's own modules.
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
        self._messages: SimpleQueue[Message] = SimpleQueue()
        self._link: DaskLink
        self._hosts: dict[str, Host] = {}  # by address
        self._seats: dict[str, list[WorkerSlot]] = {}  # by their host's address
        # By the nanny, which outlives its worker, and by the number of the seat.
        self._failed_starts: Counter[tuple[str, int]] = Counter()  # in a row
        self._started: set[tuple[str, int]] = set()  # those that ever have
        self._has_looked = False
        self._no_seats_since = math.inf
        self._no_seats_is_told = False
        self._disconnected: Disconnected | None = None

    @property
    def free(self) -> int:
        """Number of candidates that can be submitted now."""
        return 0 if self._disconnected else sum(1 for _ in self._idle_seats())

    def states(self) -> Mapping[str, WorkerState]:
        """Activity of each seat, by the name of its worker and its number."""
        return states_of(self._all_seats())

    def submit(self, candidate: Candidate) -> None:
        """Hands a candidate to a free seat."""
        seat = next(self._idle_seats())
        assert seat.handle is not None
        seat.candidate_id = candidate.id
        seat.turn("driving", self._drive_limit)
        seat.begin(self._link.call(seat.host, Seat.test, seat.handle, candidate))

    def wait(self, timeout: float) -> Sequence[Attempt]:
        """Waits until something happens, for at most so many s; returns finished attempts.

        Raises:
            CampaignError: the scheduler is lost, or no worker can be used, for some time or for
                good.
        """
        deadline = min([time.monotonic() + timeout, *(seat.limit for seat in self._all_seats())])
        attempts: list[Attempt] = []
        for message in self._received(deadline):
            attempts += self._heard(message)
        attempts += self._overdue()
        if not attempts:  # these first
            self._require_connection()
            self._require_seats()
        return attempts

    def __enter__(self) -> Self:
        """Connects to the scheduler; seats are opened within `wait`.

        Raises:
            CampaignError: there is no scheduler, or it cannot be used.
        """
        self._link = DaskLink(self._address, self._messages)
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        """Releases all seats: at once during an error, else when they are done."""
        try:
            if error is None and not self._disconnected:
                self._close_seats()
        finally:
            self._link.close()

    def _all_seats(self) -> Iterator[WorkerSlot]:
        return (seat for seats in self._seats.values() for seat in seats)

    def _idle_seats(self) -> Iterator[WorkerSlot]:
        return (
            seat
            for seat in self._all_seats()
            if seat.state == "idle" and self._hosts[seat.host].is_running
        )

    def _received(self, deadline: float) -> Iterator[Message]:
        """New messages, after waiting for one until the deadline."""
        try:
            yield self._messages.get(timeout=max(0.0, deadline - time.monotonic()))
            while True:
                yield self._messages.get_nowait()
        except Empty:
            return

    def _heard(self, message: Message) -> list[Attempt]:
        match message:
            case Seen(hosts):
                return self._look_at(hosts)
            case Gone(host):
                return self._departed(host)
            case Checked(host, trouble):
                for seat in self._seats.get(host, ()):
                    if seat.call is None and trouble:
                        self._lost(seat, trouble)
                    elif seat.call is None:
                        self._open(seat)
            case Done():
                for seat in self._all_seats():
                    if seat.call is message.call:
                        return self._done(seat, message)
                message.call.release()
            case Disconnected():
                self._disconnected = message
        return []

    def _look_at(self, hosts: Mapping[str, Host]) -> list[Attempt]:
        """Updates the known workers."""
        attempts: list[Attempt] = []
        for address in [address for address in self._seats if address not in hosts]:
            attempts += self._departed(address)
        self._hosts, self._has_looked = dict(hosts), True
        for address, host in hosts.items():
            if host.seats and host.is_running and address not in self._seats:
                self._seats[address] = [
                    WorkerSlot(host, number) for number in range(1, host.seats + 1)
                ]
                self._link.check(address)
            elif host.is_leaving:
                for seat in self._seats.get(address, ()):
                    if seat.state == "idle":
                        self._lost(seat, "it is being closed")
        return attempts

    def _departed(self, address: str) -> list[Attempt]:
        """Removes a worker that has gone."""
        attempts: list[Attempt] = []
        for seat in self._seats.pop(address, ()):
            if seat.state != "lost":
                attempts += self._lost(seat, "it died or left the cluster")
        self._hosts.pop(address, None)
        return attempts

    def _open(self, seat: WorkerSlot) -> None:
        """Opens a seat, unless that has failed too often."""
        if self._failed_starts[seat.home] < STARTS:
            seat.turn("starting", START_LIMIT)
            seat.handle = seat.call = self._link.call(
                seat.host, open_seat, seat.count, self._parcel, keep=True
            )

    def _done(self, seat: WorkerSlot, done: Done) -> list[Attempt]:
        """Continues with a seat whose call has ended."""
        if done.seat_is_taken:
            seat.release()
            seat.is_taken = True
            seat.turn("starting", TAKEN_INTERVAL)
            return []
        if done.trouble:
            is_hopeless = seat.state == "starting" and seat.home not in self._started
            attempts = self._lost(seat, done.trouble)
            if not is_hopeless:  # else that would not change
                self._open(seat)
            return attempts
        if seat.state == "starting":
            self._ready(seat)
            return []
        driven: Driven = done.value
        for level, name, text in driven.logged:
            logging.getLogger(name).log(level, "%s: %s", seat.name, text)
        seat.tests += 1
        if trace := driven.attempt.traceback:
            logger.debug("%s: %s\n%s", seat.name, driven.attempt.result.reason, trace)
        if driven.attempt.simulator_broke:
            assert seat.handle is not None
            seat.turn("starting", START_LIMIT)
            seat.begin(self._link.call(seat.host, Seat.restart, seat.handle))
        else:
            self._rest(seat)
        return [replace(driven.attempt, worker=seat.name)]

    def _ready(self, seat: WorkerSlot) -> None:
        self._failed_starts[seat.home] = 0
        self._started.add(seat.home)
        seat.is_taken = False
        self._log.write(Event.WORKER_STARTED, f"worker {seat.name} started", worker=seat.name)
        self._rest(seat)

    def _rest(self, seat: WorkerSlot) -> None:
        """Lets a seat wait for its next candidate, if any."""
        seat.turn("idle")
        if self._hosts[seat.host].is_leaving:
            self._lost(seat, "it is being closed")

    def _overdue(self) -> list[Attempt]:
        """Deals with seats whose state has lasted too long."""
        now = time.monotonic()
        attempts: list[Attempt] = []
        for seat in [seat for seat in self._all_seats() if seat.limit <= now]:
            if seat.is_taken and seat.call is None:
                self._open(seat)
            elif seat.state != "lost":  # together with one before
                attempts += self._hanging(seat, now - seat.since)
        return attempts

    def _hanging(self, seat: WorkerSlot, seconds: float) -> list[Attempt]:
        """Restarts the worker of a seat, or leaves it alone if that is impossible."""
        what = "drive" if seat.state == "driving" else "start"
        attempts = self._lost(seat, f"its {what} took more than {seconds:.3g} s")
        if self._hosts[seat.host].nanny is None:
            return attempts
        for other in self._seats[seat.host]:
            if other.state != "lost":
                attempts += self._lost(other, f"it had to be restarted because of {seat.name}")
        self._link.restart(seat.host)
        return attempts

    def _lost(self, seat: WorkerSlot, reason: str) -> list[Attempt]:
        """Records a lost seat; returns the attempt that is lost with it."""
        attempts = []
        fields: dict[str, JSONValue] = {"worker": seat.name, "reason": reason}
        loss = f"worker {seat.name} was lost: {reason}"
        if seat.state == "driving":
            seconds = time.monotonic() - seat.since
            attempts.append(Attempt.lost(seat.candidate_id, seat.name, seconds, loss))
            fields["test"] = seat.candidate_id
            self._failed_starts[seat.home] = 0
        elif seat.state == "starting" and not seat.is_taken:
            self._failed_starts[seat.home] += 1
        self._log.write(Event.WORKER_LOST, loss, level="warning", **fields)
        seat.release()
        seat.is_taken = False
        seat.loss = reason
        seat.turn("lost")
        return attempts

    def _require_connection(self) -> None:
        if self._disconnected:
            why = f" ({self._disconnected.reason})" if self._disconnected.reason else ""
            raise CampaignError(
                f"the connection to the Dask scheduler {self._address} is lost{why}: start the"
                " cluster again, then 'frenetic resume'; nothing that was stored is lost"
            )

    def _require_seats(self) -> None:
        """Raises a `CampaignError` if there have been no usable seats for too long."""
        seats = list(self._all_seats())
        if not self._has_looked or any(self._is_usable(seat) for seat in seats):
            self._no_seats_since = math.inf
            return
        now = time.monotonic()
        if self._no_seats_since == math.inf:
            self._no_seats_since = now
            self._no_seats_is_told = False
        is_taken = any(seat.is_taken for seat in seats)
        limit = max(NO_SEATS_LIMIT, self._drive_limit) if is_taken else NO_SEATS_LIMIT
        will_not_change = seats and not is_taken and not self._started
        if will_not_change or now >= self._no_seats_since + limit:
            raise CampaignError(self._why_no_seats())
        if not self._no_seats_is_told and now >= self._no_seats_since + NO_SEATS_TOLD_AFTER:
            self._no_seats_is_told = True
            logger.warning("waiting at most %.0f s: %s", limit, self._why_no_seats())

    def _is_usable(self, seat: WorkerSlot) -> bool:
        """Whether a seat may still answer."""
        if seat.state == "idle":
            return self._hosts[seat.host].is_running
        return seat.state != "lost" and not seat.is_taken

    def _why_no_seats(self) -> str:
        how = f"'dask worker {self._address} --nthreads 1 --resources {RESOURCE}=1'"
        seats = list(self._all_seats())
        if any(seat.is_taken for seat in seats):
            return (
                f"all workers of the Dask scheduler {self._address} drive for another campaign:"
                f" wait until it is done, or start more with {how}"
            )
        if seats:
            reasons = "; ".join(f"{s.name}: {s.loss or 'it is short of memory'}" for s in seats)
            return f"no worker of the Dask scheduler {self._address} can be used: {reasons}"
        if self._hosts:
            return (
                f"none of the {len(self._hosts)} workers of the Dask scheduler {self._address}"
                f" offers the resource {RESOURCE!r}: start them with {how}"
            )
        return (
            f"no worker is connected to the Dask scheduler {self._address}: start some with {how}"
        )

    def _close_seats(self) -> None:
        """Ends the simulators after their present drives."""
        hosts = {
            self._link.call(seat.host, Seat.close, seat.handle): seat.host
            for seat in self._all_seats()
            if seat.state in ("idle", "driving") and seat.handle is not None
        }
        deadline = time.monotonic() + CLOSING_LIMIT
        while hosts and time.monotonic() < deadline:
            for message in self._received(deadline):
                match message:
                    case Done(call):
                        if hosts.pop(call, None) and message.trouble:
                            logger.warning("a simulator did not end well: %s", message.trouble)
                    case Gone(host):
                        hosts = {call: its for call, its in hosts.items() if its != host}
                    case Disconnected():
                        return


class WorkerSlot(Slot):
    """A seat, as the campaign knows it."""

    def __init__(self, host: Host, number: int) -> None:
        name = host.name if host.seats == 1 else f"{host.name} seat {number}"
        super().__init__(name, "starting", START_LIMIT)
        self.host = host.address
        self.home = host.nanny or host.address, number
        """Name that outlives restarts of its worker."""
        self.count = host.seats
        """Number of seats on its worker."""
        self.is_taken = False
        """Whether another campaign used it when we last tried."""
        self.handle: Call | None = None
        """Opened it, and keeps it open until it is released."""
        self.call: Call | None = None
        """Its present activity."""
        self.candidate_id = 0
        """Its present or last candidate."""

    def begin(self, call: Call) -> None:
        """Records its present task."""
        last, self.call = self.call, call
        if last is not None and last is not self.handle:
            last.release()  # only now, since Dask delays all but the first message by 10 ms

    def release(self) -> None:
        """Releases it: Dask ends it after its drive, if any."""
        for call in (self.call, self.handle):
            if call is not None:
                call.release()
        self.call = self.handle = None
