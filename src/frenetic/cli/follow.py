"""The view of ``frenetic show --follow``: one screen that changes, or plain lines."""

from __future__ import annotations

import io
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Final

import click
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from frenetic._support.words import format_duration, rate_words
from frenetic.campaign.log import WorkerState
from frenetic.campaign.state import CampaignState, Follower, Line, Status, name_of
from frenetic.cli.console import PLAIN_INTERVAL, Results, print_facts, progress_text, shell

INTERVAL: Final = 1.0
"""Least time between two looks at the campaign, in s."""
SHARE: Final = 0.1
"""Largest share of the time that looking takes."""
WIDTH: Final = 100
"""Most columns of the screen."""
WORKERS_SHOWN: Final = 10
LINES_SHOWN: Final = 4

_STYLES: Final = {
    Status.RUNNING: "green",
    Status.FINISHED: "bold green",
    Status.INTERRUPTED: "bold yellow",
    Status.UNKNOWN: "bold yellow",
}
_BAD: Final = "bold red"


def follow(folder: Path, *, as_json: bool) -> None:
    """Shows a campaign until it ends, or prints its state as JSON; exits with 1 at a bad end."""
    follower = Follower(folder)
    if as_json:
        click.echo(json.dumps({"folder": str(folder)} | follower.look().as_json()))
        return
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # the log may hold what it cannot encode
    console = Results()
    # Asked of the stream itself: colours may be forced where nothing can be drawn over.
    has_screen = sys.stdout.isatty() and not console.is_dumb_terminal
    ending = _draw(follower, folder, console) if has_screen else _print(follower, folder)
    if ending is not Status.FINISHED:
        raise click.exceptions.Exit(1)


def _looks(follower: Follower) -> Iterator[CampaignState]:
    """The campaign's states, now and then, until it has ended."""
    while True:
        start = time.perf_counter()
        state = follower.look()
        yield state
        if state.status.has_ended:
            return
        time.sleep(max(INTERVAL, (time.perf_counter() - start) / SHARE))


def _draw(follower: Follower, folder: Path, console: Console) -> Status | None:
    """Shows the state in place; returns the last status."""
    status = None
    with Live(console=console, auto_refresh=False) as live:
        for state in _looks(follower):
            live.update(screen(state, folder, min(console.width, WIDTH)), refresh=True)
            status = state.status
    return status


def _print(follower: Follower, folder: Path) -> Status | None:
    """Prints facts where the status changes, and in between what is new; returns the last one."""
    known: Sequence[Line] = ()
    status, next_progress = None, 0.0
    for state in _looks(follower):
        now = time.monotonic()
        if state.status is not status:
            print_facts(_facts(state, folder))
        elif now >= next_progress:
            click.echo(progress_text(state.summary))
        if state.status is not status or now >= next_progress:
            next_progress = now + PLAIN_INTERVAL
        for line in state.messages:
            if line not in known:
                click.echo(f"{_clock(line.time)} {line.level}: {line.message}")
        known, status = state.messages, state.status
        sys.stdout.flush()
    return status


def screen(state: CampaignState, folder: Path, width: int) -> RenderableType:
    """State of a campaign in a frame of so many columns."""
    facts = dict(_facts(state, folder))
    style = _STYLES.get(state.status, _BAD)
    budget = Table.grid(padding=(0, 2))
    budget.add_row(
        ProgressBar(total=1.0, completed=state.summary.budget_spent, width=width // 3),
        facts["budget"],
    )
    parts: list[RenderableType] = [budget, facts["results"], facts["rate"]]
    if state.workers:
        parts += ["", _table_of_workers(state.workers)]
    for lines, colour in ((state.failures, "red"), (state.messages, "yellow")):
        if lines:
            parts += ["", *(_row(line, colour) for line in lines[-LINES_SHOWN:])]
    return Panel(
        Group(*(Text(part) if isinstance(part, str) else part for part in parts)),
        width=width,
        title=Text.assemble((facts["status"], style), "  ", str(folder)),
        title_align="left",
        subtitle=Text(facts.get("search", ""), style="dim"),
        subtitle_align="right",
        border_style="bright_black",
    )


def _row(line: Line, colour: str) -> Text:
    text = Text.assemble((f"{_clock(line.time)} ", "dim"), (line.message, colour))
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


def _table_of_workers(workers: Sequence[WorkerState]) -> RenderableType:
    """The workers' activities, lost ones first."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in ("worker", "does"):
        table.add_column(heading, no_wrap=True)
    for heading in ("for", "tests"):
        table.add_column(heading, justify="right", no_wrap=True)
    for worker in sorted(workers, key=lambda worker: worker.state != "lost")[:WORKERS_SHOWN]:
        spent = format_duration(worker.seconds_in_state)
        table.add_row(Text(worker.name), worker.state, spent, f"{worker.tests:,}")
    if len(workers) <= WORKERS_SHOWN:
        return table
    return Group(table, Text(f"of all {len(workers)}: {_census(workers)}", style="dim"))


def _facts(state: CampaignState, folder: Path) -> list[tuple[str, str]]:
    """The state in words."""
    progress, start = state.summary, state.start
    status = str(state.status)
    if state.status is Status.UNKNOWN:
        status += f" since {_clock(state.last_time)}: {start.host} may write it"
    elif state.status is Status.KILLED:
        status += f": frenetic resume {shell(folder)} goes on"
    left = state.seconds_left
    times = format_duration(progress.seconds)
    times += "" if left is None else f", {format_duration(left)} left"
    now = "" if state.rate is None else f"{rate_words(state.rate)} now, "
    best = "-" if progress.min_moobd is None else f"{progress.min_moobd:.2f} m"
    named = filter(None, map(name_of, (start.strategy, start.driver, start.simulator)))
    search = [*named, *([] if start.seed is None else [f"seed {start.seed}"])]
    if start.process_id is not None:
        search.append(f"process {start.process_id} on {start.host}")
    return [
        ("campaign", str(folder)),
        ("status", status),
        *([("search", ", ".join(search))] if search else []),
        ("budget", f"{progress.budget_spent:.1%} spent, {times}"),
        ("results", progress.in_words()),
        (
            "rate",
            f"{now}{rate_words(progress.tests_per_second)} overall, best MOOBD {best}"
            f"{progress.best_in_words}",
        ),
        *([("workers", _census(state.workers))] if state.workers else []),
    ]


def _census(workers: Sequence[WorkerState]) -> str:
    """Numbers of workers by activity."""
    counts = Counter(worker.state for worker in workers).most_common()
    return ", ".join(f"{count} {state}" for state, count in counts)


def _clock(time: str) -> str:
    """A moment of the log for people: its time today, or its date too."""
    try:
        moment = datetime.fromisoformat(time).astimezone()
    except ValueError:
        return "-"
    is_today = moment.date() == datetime.now().astimezone().date()
    return f"{moment:%H:%M:%S}" if is_today else f"{moment:%m-%d %H:%M}"
