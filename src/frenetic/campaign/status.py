"""The state of a campaign that runs or has run, read from its database, lock and log."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

from msgspec import Struct, structs, to_builtins

from frenetic._support.files import open_file
from frenetic._support.outside_text import read_json
from frenetic._support.words import printable
from frenetic.campaign.configuration import (
    SPEC,
    decode_budget,
    driving_spec,
    owner_of,
    recorded_spec,
)
from frenetic.campaign.database import DATABASE
from frenetic.campaign.lock import holder, last_host
from frenetic.campaign.log import LOG, LogEvent
from frenetic.campaign.reader import SIGNATURE, SOURCES, STARTED_IN
from frenetic.campaign.store import LOCK, CampaignStore
from frenetic.campaign.summary import Summary
from frenetic.errors import CampaignError
from frenetic.oracle.verdict import is_drivers
from frenetic.parts.trust import REGISTRIES, is_signed, named_code
from frenetic.spec import FILE, Budget, Signed, Spec
from frenetic.spec.part_record import PARTS, recorded_part

TAIL: Final = 1 << 16
"""Bytes at the end of a log that are read for the news (ours)."""
MOST_NEWS: Final = 10
"""Most news (ours)."""
_PHASES: Final = (
    LogEvent.STARTED,
    LogEvent.RESUMED,
    LogEvent.FINISHED,
    LogEvent.INTERRUPTED,
    LogEvent.GAVE_UP,
)


class Status(StrEnum):
    """State of a campaign that runs, or kind of its end."""

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


class News(Struct, frozen=True):
    """A line of the log about a failure, or that warns."""

    event: str
    time: str = ""
    level: str = "info"
    message: str = ""


@dataclass(frozen=True, eq=False)
class CampaignState:
    """State of a campaign at one moment."""

    status: Status
    writer: str
    """Who writes it, or wrote it last: ``process 123``, or a machine; empty if unknown."""
    parts: tuple[str, ...]
    """Its strategy, driver and simulator with their options."""
    seed: Any
    summary: Summary
    news: tuple[News, ...]
    """Its last failures, warnings and errors, the newest last."""
    going_on: str
    """The command that goes on with it; empty while it runs, or if it has finished."""

    @property
    def seconds_left(self) -> float | None:
        """Estimated time left, in s; None when it has ended, or while nothing is known."""
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


def look(folder: Path) -> CampaignState:
    """Return the present state of the campaign in a folder.

    Raises:
        CampaignError: the folder holds no campaign, or its database is damaged.
    """
    writer = holder(folder / LOCK)  # first: an end is stored under the lock
    lines = tuple(_lines(folder / LOG))
    with CampaignStore.open(folder) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        seconds, command = store.elapsed(), going_on(store)
        summary = Summary.over(
            counts,
            lane_width=store.lane_width,
            seconds=seconds,
            budget_spent=stored_budget(store).spent(counts.simulations, seconds, counts.failed),
        )
    host = last_host(folder / LOCK)
    phase = next((line.event for line in reversed(lines) if line.event in _PHASES), None)
    if writer is not None:
        status = Status.RUNNING
    elif "finished_at" in facts:
        status = Status.INTERRUPTED if facts.get("interrupted") else Status.FINISHED
    elif phase == LogEvent.GAVE_UP:
        status = Status.GAVE_UP
    else:
        status = Status.KILLED if host in (None, platform.node()) else Status.UNKNOWN
    news = [
        line
        for line in lines
        if line.event == LogEvent.TEST_FAILED or line.level not in ("debug", "info")
    ]
    return CampaignState(
        status=status,
        writer=writer or host or "",
        parts=tuple(printable(recorded_part(config, kind)) for kind in PARTS),
        seed=config.get("seed"),
        summary=summary,
        news=tuple(news[-MOST_NEWS:]),
        going_on=command if status.has_ended and status is not Status.FINISHED else "",
    )


def has_judged(store: CampaignStore) -> bool:
    """Return whether a campaign holds a drive that did not end by a fault of its driver."""
    tests = (test for test in store.tests() if test.outcome.is_driven)
    return any(not is_drivers(test.result.fault) for test in tests)


def going_on(store: CampaignStore) -> str:
    """Return the command that goes on with an unfinished campaign; words where there is none.

    Its budget is stored, so the command says none.
    """
    config, folder = store.config, store.folder
    if owner := owner_of(config):
        return owner.command(folder)
    if is_client_driven(config):
        return shlex.join(["frenetic", "ask-tell", "--out", str(folder)])
    if config.get(SPEC) is None:
        return "from Python, where it was started: Campaign.resume()"
    return shlex.join(["frenetic", "resume", str(folder)])


def signed_spec(store: CampaignStore) -> Spec:
    """Return the spec of a campaign, with the signature among its facts.

    Raises:
        CampaignError: the configuration is damaged.
    """
    spec = recorded_spec(store.config, source=store.folder / DATABASE)
    facts = (store.fact(name) for name in (STARTED_IN, SIGNATURE))
    signed = Signed(*(fact if isinstance(fact, str) else "" for fact in facts))
    return structs.replace(spec, signed=signed)


def signed_driving(store: CampaignStore) -> Spec | None:
    """Return the spec of a campaign's drives, signed if this user has signed the campaign.

    The result is None for a campaign from Python without names.

    Raises:
        CampaignError: the configuration is damaged.
    """
    driving = driving_spec(store.config, source=store.folder / DATABASE)
    if driving is None:
        return None
    spec, sources = signed_spec(store), store.fact(SOURCES)
    signed = spec.signed or Signed("", "")
    is_own = is_signed(signed.signature, named_code(spec.parts), signed.folder, sources)
    return driving.signed_in(signed.folder) if is_own else driving


def is_client_driven(config: Mapping[str, Any]) -> bool:
    """Return whether a client drives the campaign's roads, see `frenetic.campaign.ask_tell`."""
    simulator = config.get("simulator")
    return isinstance(simulator, Mapping) and str(simulator.get("class")).startswith(
        "frenetic.campaign.ask_tell:"
    )


def _lines(path: Path) -> Iterator[News]:
    """Yield the complete lines at the end of a log, without foreign lines."""
    with suppress(OSError), open_file(path) as file:
        file.seek(-min(TAIL, os.fstat(file.fileno()).st_size), os.SEEK_END)
        for text in file.read().splitlines():
            with suppress(ValueError):
                line = read_json(text, News)
                message = " ".join(printable(line.message).split())
                yield News(line.event, line.time, line.level, message)


def stored_budget(store: CampaignStore) -> Budget:
    """Return the budget to which a campaign was run or resumed last.

    Raises:
        CampaignError: the campaign holds no usable budget.
    """
    try:
        return decode_budget(store.facts.get("budget", store.config.get("budget")))
    except ValueError as error:
        raise CampaignError(f"{store.folder} has no budget to go on with: {error}") from None


def next_campaign(spec: Spec, folder: Path, *, has_drives: bool, names_parts: bool = True) -> str:
    """Return the advice to start another campaign with the parts of one as they are now.

    Args:
        spec: of the campaign.
        folder: of the campaign.
        has_drives: whether the campaign holds a drive without a fault of the driver. Then the new
            campaign starts from it, with another seed; otherwise it repeats the same search.
        names_parts: whether the command names the parts, so that it works if the campaign's file
            is no longer signed; in another folder their names would mean other parts.
    """
    words = ["frenetic", "run", str(folder / FILE)]
    words += ["--from", str(folder)] if has_drives else []
    for kind in PARTS if names_parts else ():
        part = spec.part(kind)
        if part.name is not None and (kind == "driver" or REGISTRIES[kind].is_own(part.name)):
            words += [f"--{kind}", str(part)]
    if names_parts and REGISTRIES["objective"].is_own(spec.named_objective):
        words += ["--objective", spec.named_objective]
    if not has_drives:
        return f"start it anew, with the same seed: {shlex.join(words)}"
    advice = "start a new campaign from this one"
    if spec.seed is not None:
        advice += ", with another seed so that its random roads are new"
        words += ["--seed", str(spec.seed + 1)]
    return f"{advice}: {shlex.join(words)}"
