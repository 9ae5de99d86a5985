"""The state of a campaign that runs or has ended, read from its database, lock and log."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from msgspec import Struct, to_builtins

from frenetic._support.files import open_file
from frenetic._support.outside_text import read_json
from frenetic._support.printable import printable
from frenetic.campaign.advice import how_to_resume
from frenetic.campaign.lock import holder, last_host
from frenetic.campaign.log import LOG, LogEvent
from frenetic.campaign.store import LOCK, CampaignStore
from frenetic.campaign.stored_spec import stored_budget
from frenetic.campaign.summary import Summary
from frenetic.spec.part_text import recorded_part
from frenetic.spec.parts import PARTS

LOG_TAIL: Final = 1 << 16
"""Number of bytes at the end of a log in which news are looked for (our choice)."""
MOST_NEWS: Final = 10
"""Largest number of lines of news in a state (our choice)."""
_PHASE_EVENTS: Final = (
    LogEvent.STARTED,
    LogEvent.RESUMED,
    LogEvent.FINISHED,
    LogEvent.INTERRUPTED,
    LogEvent.GAVE_UP,
)
"""Events with which a process of a campaign starts and ends."""


class Status(StrEnum):
    """Whether a campaign runs, or how it ended."""

    RUNNING = "running"
    FINISHED = "finished"
    """The budget is spent, or the strategy has ended."""
    INTERRUPTED = "interrupted"
    """The campaign was stopped before its budget was spent."""
    GAVE_UP = "gave up"
    """An error ended the campaign."""
    KILLED = "killed"
    """No process writes the campaign, and none has stored an end."""
    UNKNOWN = "unknown"
    """No end is stored, and the campaign was started on another machine, whose locks cannot be seen
    from here, so it may still run there."""

    @property
    def has_ended(self) -> bool:
        """Whether no further result comes unless the campaign is resumed."""
        return self not in (Status.RUNNING, Status.UNKNOWN)


class News(Struct, frozen=True):
    """A line of the log about a failure, a warning or an error."""

    event: str
    time: str = ""
    level: str = "info"
    message: str = ""

    @property
    def is_warning(self) -> bool:
        """Whether the line is a warning or an error."""
        return self.level not in ("debug", "info")


@dataclass(frozen=True, eq=False)
class CampaignState:
    """State of a campaign at one moment."""

    status: Status
    writer: str
    """The process that writes the campaign, ``process 123``, or else the machine that wrote it
    last; empty if unknown."""
    parts: tuple[str, ...]
    """Strategy, driver and simulator with their options."""
    seed: Any
    """Seed of the strategy; None if it has none."""
    summary: Summary
    """Counts, time and spent budget."""
    news: tuple[News, ...]
    """The last failures, warnings and errors, at most `MOST_NEWS`, the newest last."""
    resume_command: str
    """The command that resumes the campaign; empty while it runs, or if it has finished."""

    @property
    def seconds_left(self) -> float | None:
        """Estimate of the time left, in s; None after the end, and while no budget is spent."""
        return None if self.status.has_ended else self.summary.seconds_left

    def as_json(self) -> dict[str, Any]:
        """Return the state as one JSON object."""
        strategy, driver, simulator = self.parts
        return {
            "status": self.status,
            "writer": self.writer,
            "strategy": strategy,
            "driver": driver,
            "simulator": simulator,
            "seed": self.seed,
            **self.summary.counts_json(),
            "seconds": self.summary.seconds,
            "budget_spent": self.summary.budget_spent,
            "seconds_left": self.seconds_left,
            "tests_per_second": self.summary.tests_per_second,
            "news": to_builtins(self.news),
        }


def read_state(folder: Path) -> CampaignState:
    """Return the present state of the campaign in a folder.

    Raises:
        CampaignError: the folder holds no campaign, or its database is damaged.
    """
    # The lock is read first: a process stores the end while it holds the lock, so a campaign
    # without a writer has its end in the database that is read afterwards.
    writer = holder(folder / LOCK)
    lines = tuple(_last_log_lines(folder / LOG))
    with CampaignStore.open(folder) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        seconds, command = store.elapsed(), how_to_resume(store)
        summary = Summary.from_counts(
            counts,
            folder=folder,
            lane_width=store.lane_width,
            seconds=seconds,
            budget_spent=stored_budget(store).spent(counts.amounts(seconds)),
        )
    host = last_host(folder / LOCK)
    status = _status(facts, lines, is_written=writer is not None, host=host)
    news = [line for line in lines if line.event == LogEvent.TEST_FAILED or line.is_warning]
    return CampaignState(
        status=status,
        writer=writer or host or "",
        parts=tuple(printable(recorded_part(config, kind)) for kind in PARTS),
        seed=config.get("seed"),
        summary=summary,
        news=tuple(news[-MOST_NEWS:]),
        resume_command=command if status.has_ended and status is not Status.FINISHED else "",
    )


def read_status(store: CampaignStore) -> Status:
    """Return whether an open campaign runs, or how it ended."""
    writer = holder(store.folder / LOCK)
    lines = tuple(_last_log_lines(store.folder / LOG))
    host = last_host(store.folder / LOCK)
    return _status(store.facts, lines, is_written=writer is not None, host=host)


def _status(
    facts: Mapping[str, Any], lines: Sequence[News], *, is_written: bool, host: str | None
) -> Status:
    """Return the status of a campaign.

    Args:
        facts: facts of its database.
        lines: last lines of its log.
        is_written: whether a process of this machine writes it.
        host: machine that locked its folder last; None if that is not known.
    """
    if is_written:
        return Status.RUNNING
    if "finished_at" in facts:
        return Status.INTERRUPTED if facts.get("interrupted") else Status.FINISHED
    phase = next((line.event for line in reversed(lines) if line.event in _PHASE_EVENTS), None)
    if phase == LogEvent.GAVE_UP:
        return Status.GAVE_UP
    return Status.KILLED if host in (None, platform.node()) else Status.UNKNOWN


def _last_log_lines(path: Path) -> Iterator[News]:
    """Yield the lines in the last `LOG_TAIL` bytes of a log, without lines that are not ours.

    The first line is mostly cut, and left out with them.
    """
    with suppress(OSError), open_file(path) as file:
        file.seek(-min(LOG_TAIL, os.fstat(file.fileno()).st_size), os.SEEK_END)
        for text in file.read().splitlines():
            with suppress(ValueError):
                line = read_json(text, News)
                message = " ".join(printable(line.message).split())
                yield News(line.event, line.time, line.level, message)
