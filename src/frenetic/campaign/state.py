"""The state of a campaign that runs or has run, read from its database, lock and log."""

from __future__ import annotations

import os
import platform
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from msgspec import Struct
from msgspec.json import decode

from frenetic._support.words import printable
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import LOCK, find_database
from frenetic.campaign.lock import holder
from frenetic.campaign.log import LOG, LogEvent, WorkerState
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Summary
from frenetic.errors import CampaignError
from frenetic.registry import part_name
from frenetic.spec import Budget, decode_budget

RATE_WINDOW: Final = 60.0
"""Campaign time over which the present rate is taken, in s."""
KEPT: Final = 20
"""Most remembered failures, and most remembered warnings and errors."""


class Status(StrEnum):
    """What a campaign does, or how it ended."""

    RUNNING = "running"
    FINISHED = "finished"
    """Its budget is spent, or its strategy has ended."""
    INTERRUPTED = "interrupted"
    """It was stopped before."""
    GAVE_UP = "gave up"
    """It could not go on."""
    KILLED = "killed"
    """Nobody writes it, and it has no end."""
    UNKNOWN = "unknown"
    """It has no end, and another machine, whose locks cannot be seen, may write it."""

    @property
    def has_ended(self) -> bool:
        """Whether nothing more comes unless it is resumed."""
        return self not in (Status.RUNNING, Status.UNKNOWN)


class Line(Struct):
    """A line of the log, as far as a reader needs it."""

    event: str
    time: str = ""
    level: str = "info"
    message: str = ""
    # Of a first line
    strategy: Any = None
    driver: Any = None
    simulator: Any = None
    seed: Any = None
    budget: Any = None
    host: str | None = None
    process_id: int | None = None

    def __post_init__(self) -> None:
        """Makes its message one line that a terminal can show."""
        self.message = " ".join(printable(self.message).split())

    def as_json(self) -> dict[str, Any]:
        """What it says, as one JSON object."""
        return {
            "time": self.time,
            "level": self.level,
            "event": self.event,
            "message": self.message,
        }


class _Present(Struct):
    """Fields of a line of progress beside the counts."""

    running: int
    workers: tuple[WorkerState, ...]
    seconds: float = 0.0
    budget_spent: float = 0.0
    objective: str = ""
    best: float | None = None


@dataclass(frozen=True, eq=False)
class CampaignState:
    """State of a campaign at one moment."""

    status: Status
    summary: Summary
    rate: float | None
    """Road tests per s over the last minute; None if it does not run or has just begun."""
    start: Line
    """First line of its last process."""
    last_time: str
    """Time of the last line of its log; empty without one."""
    running: int
    """Number of running road tests."""
    workers: tuple[WorkerState, ...]
    failures: tuple[Line, ...]
    """Its last failures, the newest last."""
    messages: tuple[Line, ...]
    """Its last warnings and errors, the newest last."""

    @property
    def seconds_left(self) -> float | None:
        """Estimated time left, in s; None when it has ended, or while nothing is known."""
        return None if self.status.has_ended else self.summary.seconds_left

    def as_json(self) -> dict[str, Any]:
        """The state as one JSON object."""
        return {
            "status": self.status,
            "strategy": name_of(self.start.strategy),
            "driver": name_of(self.start.driver),
            "simulator": name_of(self.start.simulator),
            "seed": self.start.seed,
            "budget": self.start.budget,
            "host": self.start.host,
            "process_id": self.start.process_id,
            **self.summary.counts_json(),
            **self.summary.objective_json,
            "seconds": self.summary.seconds,
            "budget_spent": self.summary.budget_spent,
            "seconds_left": self.seconds_left,
            "tests_per_second": self.summary.tests_per_second,
            "tests_per_second_now": self.rate,
            "running": self.running,
            "workers": [asdict(worker) for worker in self.workers],
            "failures": [line.as_json() for line in self.failures],
            "messages": [line.as_json() for line in self.messages],
            "last_time": self.last_time or None,
        }


class Follower:
    """Looks at a campaign again and again; only new lines of its log are read.

    Of a campaign that another machine writes only the log is read, for an open database must not be
    read through a network share.

    Args:
        folder: of the campaign.

    Raises:
        CampaignError: there is none in it.
    """

    def __init__(self, folder: Path) -> None:
        find_database(folder)
        self._folder = folder
        self._file: tuple[int, int] | None = None  # device and inode
        self._offset = 0  # of the first line that was not read
        self._start = self._last = Line("")
        self._ending = ""
        self._present = _Present(0, ())
        self._summary = Summary()
        self._recent: deque[tuple[float, int]] = deque()  # s, tests
        self._failures: deque[Line] = deque(maxlen=KEPT)
        self._messages: deque[Line] = deque(maxlen=KEPT)

    def look(self) -> CampaignState:
        """The campaign's present state.

        Raises:
            CampaignError: its database is damaged or gone.
        """
        for text in self._new_lines():
            try:
                self._add(text)
            except (ValueError, RecursionError):
                continue  # torn, or not ours
        is_held = holder(self._folder / LOCK) is not None  # first: an end is stored under the lock
        if self._start.host not in (None, platform.node()):
            without_end = Status.RUNNING if is_held else Status.UNKNOWN
            status = Status(self._ending.replace("_", " ")) if self._ending else without_end
            summary = self._summary
        else:
            with CampaignStore.open(self._folder) as store:
                status = self._status(store, is_held)
                summary = self._stored(store)
        is_running = status is Status.RUNNING
        present = self._present if is_running else _Present(0, ())
        return CampaignState(
            status=status,
            summary=summary,
            rate=self._rate() if is_running else None,
            start=self._start,
            last_time=self._last.time,
            running=present.running,
            workers=present.workers,
            failures=tuple(self._failures),
            messages=tuple(self._messages),
        )

    def _status(self, store: CampaignStore, is_held: bool) -> Status:
        if is_held:
            return Status.RUNNING
        if "finished_at" in store.facts:
            return Status.INTERRUPTED if store.facts.get("interrupted") else Status.FINISHED
        return Status.GAVE_UP if self._ending == LogEvent.GAVE_UP else Status.KILLED

    def _stored(self, store: CampaignStore) -> Summary:
        counts, seconds = store.counts(), max(store.elapsed(), self._summary.seconds)
        return Summary.over(
            counts,
            seconds=seconds,
            budget_spent=stored_budget(store).spent(counts.simulations, seconds, counts.failed),
            objective=self._summary.objective,
            best=self._summary.best,
        )

    def _new_lines(self) -> Iterator[bytes]:
        """The lines that were written since it was read last; half a line is left for later."""
        with suppress(OSError), (self._folder / LOG).open("rb") as file:
            status = os.fstat(file.fileno())
            if self._file != (status.st_dev, status.st_ino) or status.st_size < self._offset:
                self._file, self._offset = (status.st_dev, status.st_ino), 0
            file.seek(self._offset)
            for line in file:
                if not line.endswith(b"\n"):
                    return
                self._offset += len(line)
                yield line

    def _add(self, text: bytes) -> None:
        line = decode(text, type=Line)
        self._last = line
        if line.event == LogEvent.PROGRESS:
            self._present = present = decode(text, type=_Present)
            self._summary = Summary.over(
                decode(text, type=Counts),
                seconds=present.seconds,
                budget_spent=present.budget_spent,
                objective=present.objective,
                best=present.best,
            )
            self._recent.append((self._summary.seconds, self._summary.tests))
            while self._recent[-1][0] - self._recent[0][0] > RATE_WINDOW:
                self._recent.popleft()
        elif line.event in (LogEvent.STARTED, LogEvent.RESUMED):
            self._start, self._ending = line, ""
            if line.event == LogEvent.STARTED:
                self._summary = Summary()
            self._recent.clear()  # the time in between belongs to nobody
        elif line.event in (LogEvent.FINISHED, LogEvent.INTERRUPTED, LogEvent.GAVE_UP):
            self._ending = line.event
        elif line.event == LogEvent.TEST_FAILED:
            self._failures.append(line)
        if line.level not in ("debug", "info"):
            self._messages.append(line)

    def _rate(self) -> float | None:
        if not self._recent:
            return None
        (before, tests_before), (now, tests) = self._recent[0], self._recent[-1]
        return (tests - tests_before) / (now - before) if now - before >= 1.0 else None


def stored_budget(store: CampaignStore) -> Budget:
    """The budget to which a campaign was run or resumed last.

    Raises:
        CampaignError: it holds none that can be used.
    """
    try:
        return decode_budget(store.facts.get("budget", store.config.get("budget")))
    except ValueError as error:
        raise CampaignError(f"{store.folder} has no budget to go on with: {error}") from None


def name_of(part: object) -> str | None:
    """The name of a part as the log describes it, with that of the driver under it."""
    if not isinstance(part, dict):
        return None
    name = printable(part_name(part))
    inner = name_of(part.get("driver"))
    return f"{name} over {inner}" if inner else name
