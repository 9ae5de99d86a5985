"""The state of a campaign, read from its log.

Only new lines of the log are read, so a campaign can be watched from another machine, through a
network share, at any rate. Input is validated: an unreadable line is counted and skipped, and texts
lose characters that a terminal takes for a command.

No two clocks are compared. Rates and durations are measured in the campaign's own seconds, which
each line of progress gives. A campaign counts as alive if its log grows, by the watcher's clock.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta, Struct, ValidationError, convert
from msgspec.json import decode

from frenetic._support.arrays import FloatArray
from frenetic.campaign.log import ENDINGS, LOG, Count, Event, Level, Seconds, WorkerState
from frenetic.campaign.progress import Progress
from frenetic.campaign.store import DATABASE
from frenetic.errors import CampaignError
from frenetic.spec import Budget

SILENT_AFTER: Final = 180.0
"""Time without a new line after which a campaign may have died, in s."""
RATE_WINDOW: Final = 60.0
"""Campaign time over which its rate now is taken, in s."""
KEPT_MESSAGES: Final = 20
"""Most remembered warnings and errors."""
MAX_POINTS: Final = 1000
"""Most points of the failures over time."""
MAX_LINE: Final = 1 << 20
"""Most bytes of a line; a longer one is skipped."""
MAX_WORKERS: Final = 1000
"""Most remembered workers of a line."""

_HEAD: Final = 256  # bytes by which a file is recognised: they hold the time of its first line
_MAX_TEXT: Final = 500  # characters
_MAX_NAME: Final = 60  # characters
_Whole = Annotated[int, Meta(ge=0, le=(1 << 63) - 1)]


class Status(StrEnum):
    """State of a campaign, as far as its log tells."""

    WAITING = "waiting"
    """The log tells nothing yet."""
    RUNNING = "running"
    SILENT = "silent"
    """It should be running, but the log has not grown for `SILENT_AFTER`."""
    FINISHED = "finished"
    """Its budget is spent."""
    INTERRUPTED = "interrupted"
    """It was stopped before."""
    GAVE_UP = "gave_up"
    """It could not go on."""

    @property
    def is_end(self) -> bool:
        """Whether the campaign's process has ended normally."""
        return self in (Status.FINISHED, Status.INTERRUPTED, Status.GAVE_UP)


@dataclass(frozen=True)
class Setup:
    """First line of a campaign's process; None where it lacks a field."""

    strategy: str | None = None
    driver: str | None = None
    simulator: str | None = None
    seed: int | None = None
    budget: Budget | None = None
    host: str | None = None
    process_id: int | None = None


@dataclass(frozen=True)
class Message:
    """A line of the log for people."""

    time: str
    """Time by the campaign's clock, as in the log."""
    level: Level
    event: str
    text: str


@dataclass(frozen=True, eq=False)
class CampaignState:
    """State of a campaign, read from its log."""

    status: Status
    setup: Setup
    progress: Progress
    """The latest state in the log."""
    rate: float | None
    """Road tests per s over the last minute; None if it does not run or has just begun."""
    failures_over_time: FloatArray
    """(n, 2): s of the campaign's time, FAIL outcomes until then; 1000 points at most."""
    running: int
    """Number of running road tests."""
    workers: tuple[WorkerState, ...]
    messages: tuple[Message, ...]
    """The last warnings and errors, the newest last."""
    message_count: int
    """Warnings and errors in the log."""
    last_failure: Message | None
    last_time: str
    """Time of the newest line by the campaign's clock; empty before the first."""
    quiet_seconds: float
    """Time since the log has grown, or since watching began, by the watcher's clock, in s."""
    has_grown: bool
    """Whether it has grown since watching began, which proves that the campaign runs."""
    unreadable: int
    """Number of skipped lines."""
    trouble: str
    """Reason why the log could not be read this time; empty if it could."""

    def failures_per_interval(self, intervals: int) -> FloatArray:
        """(intervals,) FAIL outcomes in equal parts of the time from the start until now."""
        if len(self.failures_over_time) == 0:
            return np.zeros(intervals)
        seconds, failed = np.vstack(([0.0, 0.0], self.failures_over_time)).T
        edges = np.linspace(0.0, seconds[-1], intervals + 1)
        return np.diff(np.interp(edges, seconds, failed))

    def as_json(self) -> dict[str, Any]:
        """The state as one JSON object, with the names of the log."""
        progress = self.progress
        left = None if self.status.is_end else progress.seconds_left
        return {
            "status": self.status,
            **asdict(self.setup),
            **progress.counts_json(),
            "seconds": progress.seconds,
            "budget_spent": progress.budget_spent,
            "seconds_left": left,
            "tests_per_second": progress.tests_per_second,
            "tests_per_second_now": self.rate,
            "running": self.running,
            "workers": [asdict(worker) for worker in self.workers],
            "failures_over_time": {
                "seconds": self.failures_over_time[:, 0].tolist(),
                "failed": self.failures_over_time[:, 1].astype(int).tolist(),
            },
            "last_failure": asdict(self.last_failure) if self.last_failure else None,
            "messages": [asdict(message) for message in self.messages],
            "message_count": self.message_count,
            "last_time": self.last_time or None,
            "quiet_seconds": self.quiet_seconds,
            "has_grown": self.has_grown,
            "unreadable": self.unreadable,
            "trouble": self.trouble or None,
        }


def require_log(folder: Path) -> None:
    """Raises a `CampaignError` if there is no log in the folder, with what to do."""
    path = folder / LOG
    try:
        if path.is_file():
            return
        if not folder.is_dir():
            what = "is not a folder" if os.path.lexists(folder) else "does not exist"
        elif (folder / DATABASE).is_file():
            raise CampaignError(
                f"{folder} has no {LOG}, because it was made before campaigns had one or because it"
                " was removed: 'frenetic show' says what it holds"
            )
        else:
            what = "holds no campaign"
    except OSError as error:
        raise CampaignError(f"cannot read {path}: {error.strerror or error}") from error
    raise CampaignError(f"{folder} {what}: the folder of a campaign is needed, one with {LOG}")


class CampaignWatcher:
    """Follows the log in a campaign's folder.

    Args:
        folder: of the campaign. The log may come later, vanish, be cut or replaced.
        clock: s, monotonic, for a campaign's silence.
    """

    def __init__(self, folder: Path, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = Path(folder) / LOG
        self._clock = clock
        self._reader = _LogReader()
        self._summary = _LogSummary()
        self._quiet_since = clock()
        self._has_looked = self._has_grown = False

    def look(self) -> CampaignState:
        """Reads new lines of the log; returns the campaign's state."""
        trouble = ""
        try:
            # Opened anew each time, since a network share shows new lines only then.
            if not self._path.is_file():
                raise FileNotFoundError(f"{self._path} is not there, or no file")
            with self._path.open("rb") as file:
                is_new = self._read(file)
        except OSError as error:
            is_new, trouble = False, error.strerror or str(error)
        now = self._clock()
        if is_new:
            self._quiet_since = now
            self._has_grown = self._has_looked
        self._has_looked = True
        return self._summary.state(
            quiet_seconds=now - self._quiet_since,
            has_grown=self._has_grown,
            too_long=self._reader.too_long,
            trouble=trouble,
        )

    def _read(self, file: BufferedReader) -> bool:
        """Reads new lines of the file; returns whether there are any."""
        if not self._reader.belongs_to(file):
            self._reader, self._summary = _LogReader(), _LogSummary()
            self._reader.belongs_to(file)
        is_new = self._reader.has_news
        for line in self._reader.lines(file):
            self._summary.add(line)
        return is_new


class _ProgressLine(Struct):
    """The fields of a line of progress; it counts for nothing if one is out of bounds."""

    invalid: Count
    passed: Count
    failed: Count
    errors: Count
    dropped: Count
    seconds: Seconds
    budget_spent: Annotated[float, Meta(ge=0.0, le=1.0)]
    running: Count
    min_moobd: Annotated[float, Meta(ge=-1e6, le=1e6)] | None = None
    roads: Count = 0
    objective: object = ""
    best: Annotated[float, Meta(ge=-1e300, le=1e300)] | None = None
    workers: object = None


class _LogReader:
    """Reads the new whole lines of a growing file."""

    def __init__(self) -> None:
        self._head = b""
        self._size = 0
        self._offset = 0  # of the first line that was not read
        self._is_skipping = False  # the rest of a line that is too long
        self.has_news = False
        """Whether the file has changed since it was looked at last."""
        self.too_long = 0
        """Number of skipped lines."""

    def belongs_to(self, file: BufferedReader) -> bool:
        """Checks whether the file is still the same, only longer."""
        file.seek(0)
        head = file.read(_HEAD)
        size = file.seek(0, os.SEEK_END)
        if size < self._size or not head.startswith(self._head):
            return False
        self.has_news = size > self._size
        self._head, self._size = head, size
        return True

    def lines(self, file: BufferedReader) -> Iterator[bytes]:
        """The new lines, without their ends; half a line is left for the next time."""
        while self._offset < self._size:
            file.seek(self._offset)
            data = file.read(min(MAX_LINE, self._size - self._offset))
            length = data.rfind(b"\n") + 1
            if length:
                lines = data[:length].split(b"\n")[:-1]
                self._offset += length
                yield from lines[1:] if self._is_skipping else lines
                self._is_skipping = False
            elif len(data) == MAX_LINE:
                self._offset += len(data)
                self.too_long += not self._is_skipping
                self._is_skipping = True
            else:
                return


class _LogSummary:
    """State from the lines of a log so far."""

    def __init__(self) -> None:
        self._status = Status.WAITING
        self._setup = Setup()
        self._unreadable = 0
        self._messages: deque[Message] = deque(maxlen=KEPT_MESSAGES)
        self._message_count = 0
        self._last_failure: Message | None = None
        self._last_time = ""
        self._forget_progress()

    def _forget_progress(self) -> None:
        self._progress = Progress()
        self._recent: deque[tuple[float, int]] = deque()  # s, tests
        self._points: list[tuple[float, int]] = []  # s, failures
        self._running = 0
        self._workers: object = ()

    def add(self, line: bytes) -> None:
        """Takes a whole line into account, or counts it as unreadable."""
        if not line.strip():
            return
        try:
            record = decode(line.decode("utf-8", "replace"), type=dict[str, Any])
            event = convert(record.get("event"), str)
            if event == Event.PROGRESS:
                self._add_progress(convert(record, _ProgressLine))
        except (ValueError, RecursionError):
            self._unreadable += 1
            return
        message = _message(event, record)
        if event in (Event.STARTED, Event.RESUMED):
            if event == Event.STARTED:
                self._forget_progress()
            self._recent.clear()  # the time in between belongs to nobody
            self._workers = ()
            self._setup = _setup(record)
            self._status = Status.RUNNING
        elif event in ENDINGS:
            self._status = Status(event)
        elif event == Event.TEST_FAILED:
            self._last_failure = message
        if self._status is Status.WAITING:
            self._status = Status.RUNNING
        self._last_time = message.time
        if message.level in ("warning", "error"):
            self._messages.append(message)
            self._message_count += 1

    def _add_progress(self, line: _ProgressLine) -> None:
        line.objective = _text(line.objective, _MAX_NAME)
        progress = convert(line, Progress, from_attributes=True)
        self._progress, self._running = progress, line.running
        self._workers = line.workers
        self._status = Status.RUNNING
        seconds = progress.seconds
        if self._recent and (seconds, progress.tests) < self._recent[-1]:
            self._recent.clear()
        self._recent.append((seconds, progress.tests))
        while len(self._recent) > 2 and self._recent[1][0] <= seconds - RATE_WINDOW:
            self._recent.popleft()
        # A campaign that was killed goes on from its last result, which may be a bit earlier.
        while self._points and self._points[-1][0] >= seconds:
            self._points.pop()
        self._points.append((seconds, progress.failed))
        if len(self._points) > MAX_POINTS:
            self._points = self._points[::-2][::-1]  # the last one stays

    def state(
        self, *, quiet_seconds: float, has_grown: bool, too_long: int, trouble: str
    ) -> CampaignState:
        status = self._status
        if status is Status.RUNNING and quiet_seconds > SILENT_AFTER:
            status = Status.SILENT
        return CampaignState(
            status=status,
            setup=self._setup,
            progress=self._progress,
            rate=self._rate() if status is Status.RUNNING else None,
            failures_over_time=np.array(self._points, dtype=float).reshape(-1, 2),
            running=self._running,
            workers=tuple(_workers(self._workers)),
            messages=tuple(self._messages),
            message_count=self._message_count,
            last_failure=self._last_failure,
            last_time=self._last_time,
            quiet_seconds=quiet_seconds,
            has_grown=has_grown,
            unreadable=self._unreadable + too_long,
            trouble=trouble,
        )

    def _rate(self) -> float | None:
        """Tests per second over the last minute of the campaign's time."""
        if not self._recent:
            return None
        (before, tests_before), (now, tests) = self._recent[0], self._recent[-1]
        return (tests - tests_before) / (now - before) if now - before >= 1.0 else None


def _message(event: str, record: Mapping[str, object]) -> Message:
    event = _text(event, _MAX_NAME)
    return Message(
        time=_text(record.get("time"), _MAX_NAME),
        level=_valid(record.get("level"), Level) or "info",
        event=event,
        text=_text(record.get("message"), _MAX_TEXT) or event,
    )


def _setup(record: Mapping[str, object]) -> Setup:
    """The readable fields of a first line."""
    return Setup(
        strategy=_part(record.get("strategy")),
        driver=_part(record.get("driver")),
        simulator=_part(record.get("simulator")),
        seed=_valid(record.get("seed"), _Whole),
        budget=_valid(record.get("budget"), Budget),
        host=_text(record.get("host"), _MAX_NAME) or None,
        process_id=_valid(record.get("process_id"), _Whole),
    )


def _part(described: object) -> str | None:
    """The name of a part of a campaign, and the part under it."""
    names: list[str] = []
    while isinstance(described, dict) and len(names) < 5:
        names.append(_text(described.get("class"), 300).rpartition(":")[2][:_MAX_NAME] or "?")
        described = described.get("driver")
    if isinstance(described, str):
        names.append(_text(described, _MAX_NAME))
    return " over ".join(names) or None


def _workers(listed: object) -> Iterator[WorkerState]:
    """The readable workers of a line of progress."""
    for value in listed[:MAX_WORKERS] if isinstance(listed, list) else ():
        worker = _valid(value, WorkerState)
        if worker is not None and (name := _text(worker.name, _MAX_NAME)):
            yield replace(worker, name=name)


def _valid(value: object, kind: Any) -> Any:
    """A value as a ``kind``, None if it is none."""
    try:
        return convert(value, kind)
    except ValidationError:
        return None


def _text(value: object, most: int) -> str:
    """A text in one line of at most so many visible characters."""
    if not isinstance(value, str):
        return ""
    seen = "".join(character if character.isprintable() else " " for character in value[:most])
    return " ".join(seen.split())
