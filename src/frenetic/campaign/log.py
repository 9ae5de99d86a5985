"""A campaign's log: its events, line by line, for people and programs alike.

The log is the file `campaign.log` in the campaign's folder: UTF-8, one JSON object per line (JSON
Lines), only ever appended to. So it can be followed from another machine through a network share,
where an open database must not be read. Each line begins with the same four keys, and the fields of
its event follow:

| key | holds |
| --- | --- |
| time | when, UTC, ISO 8601 with milliseconds |
| level | debug, info, warning or error |
| event | one of `Event` |
| message | what happened, in a sentence |

``frenetic watch`` shows it in one screen; other questions are one line of a shell or of Python:
``jq 'select(.level == "error")' campaign.log``, ``pandas.read_json(path, lines=True)``.

The log stays small. Progress is written every 5 s, some 420 bytes and 85 more per worker: a night
of 8 hours takes 3 MB with one worker, 6 MB with eight and 33 MB with 64. Of any other event, the
first 1000 of its level are written and then one of 100, with a field ``count`` that says how many
there have been in this process: so 100,000 failures take 0.5 MB instead of 25.

The campaign is more important than its log: nothing here raises. Lines that cannot be written, for
example on a full disk, are lost; the next line that can be written gives their number.
"""

from __future__ import annotations

import errno
import json
import logging
import math
import os
import re
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from io import FileIO
from itertools import islice
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self, TypeAlias

from msgspec import Meta

from frenetic._support.words import present_moment

if TYPE_CHECKING:
    from frenetic.campaign.progress import Progress
    from frenetic.campaign.store import JSONValue

Level: TypeAlias = Literal["debug", "info", "warning", "error"]
WorkerStatus: TypeAlias = Literal["starting", "idle", "driving", "lost"]
# Bounds that readers check.
Count: TypeAlias = Annotated[int, Meta(ge=0, lt=1 << 53)]
Seconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e10)]  # up to three centuries

LOG: Final = "campaign.log"
"""Name of the log in a campaign's folder."""
PROGRESS_INTERVAL: Final = 5.0
"""Time between two lines of progress, in s."""
RETRY_INTERVAL: Final = 5.0
"""Time until a log that could not be written is tried again, in s."""
FIRST: Final = 1000
"""Number of lines of an event and level that are always written."""
THINNED: Final = 100
"""After that, one line of this many is written."""
MAX_TEXT: Final = 4000
"""Most characters of a text; its middle is cut."""
MAX_ITEMS: Final = 1000
"""Most entries of a list or mapping."""
MAX_DEPTH: Final = 6
"""Deepest nesting of lists and mappings."""
MAX_LINE: Final = 1 << 18
"""Most bytes of a line; the fields of a longer one are left out."""

# Characters that JSON keeps but that disturb a terminal or another reader: C1 controls, line
# separators, marks of writing direction, half characters.
_UNSAFE: Final = re.compile(
    "[\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


class Event(StrEnum):
    """Event of a line of the log, with its fields.

    The last line of a campaign's process is one of FINISHED, INTERRUPTED and GAVE_UP; without one,
    the process still runs or was killed.
    """

    STARTED = "started"
    """A campaign begins: strategy, driver, simulator, seed, budget, workers, process_id, host."""
    RESUMED = "resumed"
    """It is resumed in another process; fields as for STARTED."""
    WORKER_STARTED = "worker_started"
    """worker."""
    WORKER_LOST = "worker_lost"
    """worker, reason, and test if it was driving one."""
    TEST_RETRIED = "test_retried"
    """test, reason, and traceback if known."""
    TEST_ERROR = "test_error"
    """An ERROR: test, reason, and traceback if known."""
    TEST_FAILED = "test_failed"
    """A FAIL: test, moobd (m)."""
    NOTICE = "notice"
    """The search is not what its user expects; the message says why."""
    INTERRUPTED = "interrupted"
    """It was stopped before its budget was spent; the summary's fields."""
    GAVE_UP = "gave_up"
    """It cannot go on: traceback of its cause, if there is one."""
    FINISHED = "finished"
    """Its budget is spent; the summary's fields."""
    PROGRESS = "progress"
    """Its progress, see `CampaignLog.progress`."""
    LOG = "log"
    """A record of Python's logging, or a remark about this log itself: logger, traceback."""


ENDINGS: Final = frozenset({Event.FINISHED, Event.INTERRUPTED, Event.GAVE_UP})
"""Events of the last line of a campaign's process."""


@dataclass(frozen=True)
class WorkerState:
    """Present activity of a worker."""

    name: str
    state: WorkerStatus
    tests: Count
    """Number of its road tests."""
    seconds_in_state: Seconds
    """Time since this state began, in s."""


class CampaignLog:
    """The log in a campaign's folder, open for appending; a context manager that closes it.

    May be used from several threads. In a forked process it does nothing. After half a line of a
    killed process, the next line begins on its own.

    Args:
        folder: of the campaign. Nothing is written until it exists.
        clock: s, monotonic, for intervals.
    """

    def __init__(self, folder: Path, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._path = Path(folder) / LOG
        self._clock = clock
        self._process = os.getpid()
        # Reentrant: a handler of Ctrl-C may write while its thread is writing.
        self._lock = threading.RLock()
        self._file: FileIO | None = None
        self._is_torn = False  # whether its last line has no end
        self._is_closed = False
        self._look_at = -math.inf  # when to look whether it is there and can be opened
        self._progress_at = -math.inf
        self._written: Counter[tuple[str, str]] = Counter()
        self._lost = 0  # since the log could be written last
        self._trouble = ""
        self.lost_lines = 0
        """Number of lines lost since it was opened."""
        self._is_there(urgent=True)

    def write(
        self, event: str, message: str, *, level: Level = "info", **fields: JSONValue
    ) -> None:
        """Writes a line, if it can be written and is not one of too many of its kind.

        Args:
            event: one of `Event`.
            message: the event in a sentence.
            level: its severity.
            fields: of the event. Numbers that are not finite become null; other values that are no
                JSON become text.
        """
        if os.getpid() != self._process:
            return
        with self._lock:
            self._written[event, level] += 1
            count = self._written[event, level]
            if count > FIRST and event != Event.PROGRESS:
                if count % THINNED:
                    return
                fields["count"] = count
            self._append(event, message, level, fields)
            if count == FIRST and event != Event.PROGRESS:
                note = f"from now on one of {THINNED} lines of {event} at this level is written"
                self._append(Event.LOG, note, "info", {"logger": __name__})

    def progress(
        self,
        progress: Progress,
        *,
        workers: Mapping[str, WorkerState] | None = None,
        running: int = 0,
        force: bool = False,
    ) -> None:
        """Writes the campaign's progress, if `PROGRESS_INTERVAL` has passed since the last time.

        Args:
            progress: of the campaign.
            workers: their activities, by name.
            running: number of running tests.
            force: writes it at once.
        """
        now = self._clock()
        if not force and now - self._progress_at < PROGRESS_INTERVAL:
            return
        self._progress_at = now
        best = "" if progress.min_moobd is None else f", best MOOBD {progress.min_moobd:.2f} m"
        self.write(
            Event.PROGRESS,
            f"{progress.in_words()}{best}{progress.best_in_words},"
            f" {progress.budget_spent:.1%} of the budget spent",
            **progress.counts_json(),
            **progress.objective_json,
            seconds=round(progress.seconds, 3),
            budget_spent=round(progress.budget_spent, 6),
            tests_per_second=round(progress.tests_per_second, 3),
            running=running,
            workers=[
                asdict(worker) | {"seconds_in_state": round(worker.seconds_in_state, 1)}
                for worker in (workers or {}).values()
            ],
        )

    def handler(self, level: int = logging.INFO) -> logging.Handler:
        """A handler for the ``frenetic`` logger that writes its records as lines.

        Args:
            level: least level of its records. An unconfigured logger sends only warnings and
            errors.
        """
        return _LogHandler(self, level)

    def close(self) -> None:
        """Closes the log; does nothing when it is closed already."""
        if os.getpid() != self._process:
            return
        with self._lock:
            self._is_closed = True
            self._drop_file()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _append(
        self, event: str, message: str, level: Level, fields: Mapping[str, JSONValue]
    ) -> None:
        """Writes a line, after a remark about lost ones."""
        if self._is_there(urgent=event in ENDINGS):
            if self._lost:
                note = f"{self._lost} lines are missing here, they could not be written"
                missing = {"logger": __name__, "reason": self._trouble}
                if self._put(_line(Event.LOG, note, "warning", missing)):
                    self._lost = 0
            if self._put(_line(event, message, level, fields)):
                return
        self._lost += 1
        self.lost_lines += 1

    def _put(self, line: bytes) -> bool:
        """Writes a line with one call, so that lines never mix; returns whether it succeeded."""
        file = self._file
        if file is None:
            return False
        data = b"\n" + line if self._is_torn else line
        try:
            written = file.write(data)
        except OSError as error:
            self._give_way(error)
            return False
        except ValueError:  # closed meanwhile, by a handler of Ctrl-C that could not write either
            return False
        if written != len(data):
            self._give_way(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
            return False
        self._is_torn = False
        return True

    def _is_there(self, *, urgent: bool = False) -> bool:
        """Whether the file is open; opens it again if it is time for that or urgent.

        A removed or replaced file is opened again: nobody would read the old one.
        """
        now = self._clock()
        if self._is_closed:
            return False
        if now < self._look_at and not urgent:
            return self._file is not None
        self._look_at = now + RETRY_INTERVAL
        try:
            if self._file is None or not self._is_at_its_path(self._file):
                self._drop_file()
                self._file, self._is_torn = _open(self._path)
        except OSError as error:
            self._give_way(error)
        return self._file is not None

    def _is_at_its_path(self, file: FileIO) -> bool:
        try:
            return os.path.samestat(self._path.stat(), os.fstat(file.fileno()))
        except FileNotFoundError:
            return False

    def _give_way(self, error: OSError) -> None:
        """Leaves the file alone for a while."""
        self._trouble = error.strerror or str(error)
        self._look_at = self._clock() + RETRY_INTERVAL
        self._drop_file()

    def _drop_file(self) -> None:
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None


def told_in_log(folder: Path) -> int:
    """The most results of which a campaign's log tells; 0 if it tells of none."""
    most = 0
    with suppress(OSError), (folder / LOG).open("rb") as file:
        for line in file:
            with suppress(ValueError, LookupError, TypeError):
                record = json.loads(line)
                most = max(most, record["tests"] + record["dropped"])
    return most


class _LogHandler(logging.Handler):
    """Writes records of Python's logging to a campaign's log."""

    def __init__(self, log: CampaignLog, level: int) -> None:
        super().__init__(level)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        """Writes a record, with its traceback if it has one."""
        try:
            text = record.getMessage()
        except Exception:  # arguments that do not fit the message
            text = str(record.msg)
        fields: dict[str, JSONValue] = {"logger": record.name}
        if record.exc_info and record.exc_info[0] is not None:
            fields["traceback"] = "".join(traceback.format_exception(*record.exc_info))
        self._log.write(Event.LOG, text, level=_level(record.levelno), **fields)


def _level(number: int) -> Level:
    """The log's word for a level of Python's logging."""
    if number >= logging.ERROR:
        return "error"
    if number >= logging.WARNING:
        return "warning"
    return "info" if number >= logging.INFO else "debug"


def _open(path: Path) -> tuple[FileIO, bool]:
    """The file, open for appending, and whether its last line has no end."""
    file = FileIO(path, "a+")
    try:
        if file.seek(0, os.SEEK_END) == 0:
            return file, False
        file.seek(-1, os.SEEK_END)
        return file, file.read(1) != b"\n"
    except OSError:
        file.close()
        raise


def _line(event: str, message: str, level: Level, fields: Mapping[str, JSONValue]) -> bytes:
    """A line as it is written, its end included."""
    record: dict[str, JSONValue] = {
        "time": present_moment(),
        "level": level,
        "event": _cut(event),
        "message": _cut(" ".join(message.split())),
    }
    # A field's name cannot replace one of the first keys.
    plain = {f"{k}_" if k in record else _cut(k): _plain(v, 0) for k, v in fields.items()}
    line = _encode(record | plain)
    if len(line) > MAX_LINE:
        line = _encode(record | {"left_out": sorted(plain)[:MAX_ITEMS]})
    return line


def _encode(record: Mapping[str, JSONValue]) -> bytes:
    text = json.dumps(record, ensure_ascii=False, allow_nan=False)
    return _UNSAFE.sub(_escaped, text).encode() + b"\n"


def _escaped(match: re.Match[str]) -> str:
    """An unsafe character as JSON escapes it; half a character becomes the mark for that."""
    code = ord(match[0])
    return "\\ufffd" if 0xD800 <= code < 0xE000 else f"\\u{code:04x}"


def _plain(value: object, depth: int) -> JSONValue:
    """A value as JSON with finite numbers, or else what it looks like."""
    try:
        match value:
            case None | bool():
                return value
            case str():
                return _cut(value)
            case Integral():
                # Readers hold whole numbers in 64 bits.
                number = int(value)
                return number if number.bit_length() < 64 else _cut(hex(number))
            case Real():
                return float(value) if math.isfinite(value) else None
            case Mapping() if depth < MAX_DEPTH:
                entries = islice(value.items(), MAX_ITEMS)
                return {_cut(str(key)): _plain(item, depth + 1) for key, item in entries}
            case list() | tuple() if depth < MAX_DEPTH:
                return [_plain(item, depth + 1) for item in islice(value, MAX_ITEMS)]
            case Path():
                return _cut(str(value))
        return _cut(repr(value))
    except Exception:  # a foreign class may raise anything
        return f"<{type(value).__name__}>"


def _cut(text: str) -> str:
    """A text of a length that a line can hold, its beginning and end."""
    half = MAX_TEXT // 2
    return text if len(text) <= MAX_TEXT else f"{text[:half]} ... {text[-half:]}"
