"""A campaign's log: its events, line by line, for people and programs alike.

The log is the file `campaign.log` in the campaign's folder. It has one JSON object per line, and
lines are only appended. So it can be read from another machine through a network share, where an
open database cannot be read safely. Each line begins with the same four keys, which are followed by
the fields of its event:

| key | value |
| --- | --- |
| time | date and time, UTC, ISO 8601 with milliseconds |
| level | debug, info, warning, error or critical |
| event | a value of `LogEvent` |
| message | the event in a sentence |

``frenetic show --follow`` shows the log in one screen. Other questions take one line of a shell or
of Python: ``jq 'select(.level == "error")' campaign.log``, ``pandas.read_json(path, lines=True)``.

The campaign is more important than its log: nothing here raises. Lines that cannot be written, for
example on a full disk, are lost.
"""

from __future__ import annotations

import json
import logging
import os
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from io import TextIOWrapper
from logging.handlers import WatchedFileHandler
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Self, TypeAlias

from frenetic._support.files import open_file, refuse_pipe
from frenetic._support.outside_text import read_json
from frenetic.oracle.outcome import Outcome

if TYPE_CHECKING:
    from frenetic._support.json_value import JSONValue
    from frenetic.campaign.record import Attempt, Test
    from frenetic.campaign.summary import Summary
    from frenetic.errors import Trouble

Level: TypeAlias = Literal["info", "warning", "error"]

LOG: Final = "campaign.log"
"""Name of the log in a campaign's folder."""


class LogEvent(StrEnum):
    """Event of a line of the log; each text names the fields of the line.

    The last line of a process is FINISHED, INTERRUPTED or GAVE_UP; if none of them is there, the
    process still runs or was killed.
    """

    STARTED = "started"
    """The campaign starts. Fields: strategy, driver, simulator, seed, budget, workers,
    max_in_flight, versions, process_id, host."""
    RESUMED = "resumed"
    """The campaign is resumed. Fields: as for STARTED."""
    WORKER_STARTED = "worker_started"
    """A worker has started. Field: worker."""
    WORKER_LOST = "worker_lost"
    """A worker was lost. Fields: worker, reason, and test if the worker had begun one."""
    TEST_RETRIED = "test_retried"
    """A test is tried again. Fields: test, attempt, worker, reason, and traceback if known."""
    TEST_ERROR = "test_error"
    """A test ended with ERROR. Fields: test, attempts, reason, and traceback if known."""
    TEST_FAILED = "test_failed"
    """A test ended with FAIL. Fields: test, moobd in m, and traceback if known."""
    NOTICE = "notice"
    """The search does not go as its user expects; the message says why."""
    INTERRUPTED = "interrupted"
    """The campaign was stopped before its budget was spent. Fields: the summary's."""
    GAVE_UP = "gave_up"
    """An error ended the campaign. Field: traceback of the cause, if there is one."""
    FINISHED = "finished"
    """The budget is spent, or the strategy has ended. Fields: the summary's."""
    PROGRESS = "progress"
    """The progress, every few seconds. Fields: see `CampaignLog.progress`."""
    LOG = "log"
    """A record of Python's logging. Fields: logger, and traceback if there is one."""


class CampaignLog:
    """The log in a campaign's folder, open for appending; a context manager.

    Each log has its own handler, so events of campaigns in one process never mix. In a ``with``
    block the records of the library's loggers become lines, too. In a forked process the log writes
    nothing.

    Args:
        folder: folder of the campaign.
    """

    def __init__(self, folder: Path) -> None:
        self._file = _LogFile(folder / LOG)

    def write(
        self, event: LogEvent, message: str, *, level: Level = "info", **fields: JSONValue
    ) -> None:
        """Write a line.

        Args:
            event: event of the line.
            message: the event in a sentence.
            level: severity of the event.
            fields: fields of the event.
        """
        line = {"levelname": level, "msg": message, "event": event, "fields": fields}
        self._file.handle(logging.makeLogRecord(line))

    def result(self, test: Test, trouble: Trouble | None = None) -> None:
        """Write a line about a test that failed, or in which the simulator broke."""
        if test.outcome is Outcome.FAIL:
            text = f"test {test.id} failed: {test.reason}"
            fields = {"test": test.id, "moobd": test.moobd, **_traceback_field(trouble)}
            self.write(LogEvent.TEST_FAILED, text, **fields)  # type: ignore[arg-type]
        elif test.outcome is Outcome.ERROR:
            self.write(
                LogEvent.TEST_ERROR,
                f"the simulator broke in test {test.id}: {test.reason}",
                level="error",
                test=test.id,
                attempts=test.attempts,
                reason=test.reason,
                **_traceback_field(trouble),
            )

    def retried(self, attempt: Attempt, attempt_count: int) -> None:
        """Write that a candidate is tried again after a number of attempts."""
        self.write(
            LogEvent.TEST_RETRIED,
            f"test {attempt.candidate_id} is tried again: {attempt.failure}",
            level="warning",
            test=attempt.candidate_id,
            attempt=attempt_count,
            worker=attempt.worker,
            reason=attempt.failure,
            **_traceback_field(attempt.trouble),
        )

    def progress(self, summary: Summary) -> None:
        """Write the counts, the worst value and the spent share of the budget."""
        self.write(
            LogEvent.PROGRESS,
            f"{summary.as_text()}{summary.worst_as_text()},"
            f" {summary.budget_spent:.1%} of the budget spent",
            **summary.counts_json(),
            **summary.objective_json(),
            seconds=round(summary.seconds, 3),
            budget_spent=round(summary.budget_spent, 6),
            tests_per_second=float(f"{summary.tests_per_second:.3g}"),
        )

    def __enter__(self) -> Self:
        logging.getLogger("frenetic").addHandler(self._file)
        return self

    def __exit__(self, *_: object) -> None:
        logging.getLogger("frenetic").removeHandler(self._file)
        self._file.close()


def _traceback_field(trouble: Trouble | None) -> dict[str, JSONValue]:
    """Return the field with a trouble's traceback; no field without a traceback."""
    return {"traceback": trouble.traceback} if trouble is not None and trouble.traceback else {}


def results_in_log(folder: Path) -> int:
    """Return the largest number of results that a line of a campaign's log reports."""
    most = 0
    with suppress(OSError), open_file(folder / LOG) as file:
        for line in file:
            with suppress(ValueError, LookupError, TypeError):
                record = read_json(line)
                most = max(most, record["tests"] + record["dropped"])
    return most


class _LogFile(WatchedFileHandler):
    """A file to which records are appended; after its removal a new file is opened."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, encoding="utf-8", delay=True)
        self.setLevel(logging.INFO)
        self.setFormatter(_JSONLine())
        owner = os.getpid()
        self.addFilter(lambda _: os.getpid() == owner)

    def _open(self) -> TextIOWrapper:
        with suppress(FileNotFoundError):
            refuse_pipe(Path(self.baseFilename))
        return super()._open()

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(OSError):  # the file cannot be opened
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  # logging's
        """Do nothing: a line that cannot be written is lost."""

    def close(self) -> None:
        with suppress(OSError):  # the disk has no room for buffered lines
            super().close()


class _JSONLine(logging.Formatter):
    """Formatter of a record as a JSON object in ASCII, without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "event": getattr(record, "event", LogEvent.LOG),
            "message": record.getMessage(),
        }
        line |= getattr(record, "fields", {"logger": record.name})
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)
