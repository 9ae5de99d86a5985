"""The command that follows a running campaign: watch."""

from __future__ import annotations

import io
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from rich.console import Console, Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from frenetic._support.words import format_duration
from frenetic.cli.console import Results, print_facts
from frenetic.cli.options import CampaignFolder, Duration, json_option
from frenetic.errors import CampaignError
from frenetic.report.state_text import (
    census,
    clock_time,
    doubt,
    message_line,
    progress_line,
    rates,
    status_name,
    times,
)

if TYPE_CHECKING:
    from frenetic.campaign.log import WorkerState
    from frenetic.campaign.watch import CampaignState, CampaignWatcher, Message, Setup

WIDTH: Final = 100
"""Most columns of the live view."""
LONGEST_INTERVAL: Final = 86_400.0
"""Time between two readings of the log, in s."""
WORKERS_SHOWN: Final = 12
MESSAGES_SHOWN: Final = 4
BAR: Final = 5.0
"""Campaign time that a bar of the failures over time covers at least, in s."""

_BARS: Final = " ▁▂▃▄▅▆▇█"
_ASCII_BARS: Final = " .:-=+*#%@"
_STYLES: Final = {
    "waiting": "yellow",
    "running": "green",
    "silent": "bold red",
    "finished": "bold green",
    "interrupted": "bold yellow",
    "gave_up": "bold red",
    "warning": "yellow",
    "error": "red",
    "starting": "yellow",
    "idle": "dim",
    "lost": "bold red",
}


@click.command()
@click.argument("campaign", type=CampaignFolder())
@click.option("--once", is_flag=True, help="Print how it goes now, and leave.")
@click.option(
    "--interval",
    type=Duration(),
    default="1s",
    show_default=True,
    help="How often to look: 1s, 10s, 1m.",
)
@click.option(
    "--serve",
    is_flag=True,
    help="Show the report as a page of this computer that grows while the campaign runs.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="With --serve: the page's port. [default: any that is free, as with 0]",
)
@json_option
def watch(
    campaign: Path, once: bool, interval: float, serve: bool, port: int | None, as_json: bool
) -> None:
    """Follow the CAMPAIGN in a folder until it ends. Ctrl-C leaves; the campaign goes on.

    Only its log is read, so the folder may be on another machine, seen through a network share.
    --json prints the present state as one JSON object. The exit code is 0 when the campaign has
    finished, 1 when it was interrupted or gave up.

    --serve prints the address of a page with the campaign's report, which grows while it runs and
    stays until Ctrl-C; then the exit code is 0. The page listens on 127.0.0.1, so that only this
    computer reaches it. The campaign may begin later, or have ended.
    """
    from frenetic.campaign.watch import CampaignWatcher, Status, require_log

    if interval > LONGEST_INTERVAL:
        raise click.UsageError("--interval is too long: at most a day is allowed")
    if port is not None and not serve:
        raise click.UsageError("--port is that of the page: add --serve")
    if serve and (once or as_json):
        raise click.UsageError("--serve stays until Ctrl-C: leave out --once and --json")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # the log may hold what it cannot encode
    if serve:
        _serve(campaign, port or 0, interval)
        return
    require_log(campaign)
    watcher = CampaignWatcher(campaign)
    state = watcher.look()
    if state.trouble:
        raise CampaignError(f"cannot read the log in {campaign}: {state.trouble}")
    if as_json:
        click.echo(json.dumps({"folder": str(campaign)} | state.as_json()))
        return
    console = Results()
    # Asked of the stream itself: colours may be forced where nothing can be drawn over.
    has_screen = sys.stdout.isatty() and not console.is_dumb_terminal
    if once and has_screen:
        console.print(live_view(state, campaign, console, datetime.now(UTC)))
    elif once:
        _print_plainly(state, campaign, console)
    else:
        follow = _follow_live if has_screen else _follow_in_lines
        if follow(watcher, state, campaign, interval, console).status is not Status.FINISHED:
            raise click.exceptions.Exit(1)


def _serve(folder: Path, port: int, interval: float) -> None:
    """Shows the report as a growing page until Ctrl-C."""
    from frenetic.report.html import LiveReport

    with LiveReport(folder, port=port, interval=interval) as live:
        click.echo(f"Live report: {live.address}")
        click.echo("Only this computer reaches it. Ctrl-C closes it; the campaign goes on.")
        shown = ""
        try:
            while True:
                state = live.state()
                if state.status != shown:
                    shown = state.status
                    click.echo(f"{folder}: " + ", ".join(filter(None, (shown, state.note))))
                    sys.stdout.flush()
                time.sleep(interval)
        except KeyboardInterrupt:
            click.echo("The page is closed.")


def _follow_live(
    watcher: CampaignWatcher, state: CampaignState, folder: Path, interval: float, console: Console
) -> CampaignState:
    """Shows the campaign on a terminal, in place, until it ends."""
    from rich.live import Live

    with Live(console=console, auto_refresh=False) as live:
        while True:
            live.update(live_view(state, folder, console, datetime.now(UTC)), refresh=True)
            if state.status.is_end:
                return state
            time.sleep(interval)
            state = watcher.look()


def _follow_in_lines(
    watcher: CampaignWatcher, state: CampaignState, folder: Path, interval: float, console: Console
) -> CampaignState:
    """Prints the progress, and a line for each event, until the campaign ends."""
    _print_plainly(state, folder, console)
    while not state.status.is_end:
        sys.stdout.flush()
        time.sleep(interval)
        before, state = state, watcher.look()
        now = datetime.now(UTC)
        for message in _new_messages(before, state):
            click.echo(message_line(message, now))
        if state.status.is_end:
            _print_plainly(state, folder, console)
        elif state.status is not before.status:
            click.echo(doubt(state, now) or status_name(state))
        elif state.progress != before.progress:
            click.echo(progress_line(state))
    return state


def _new_messages(before: CampaignState, state: CampaignState) -> Sequence[Message]:
    """Warnings and errors that were not there before, as far as they are remembered."""
    count = state.message_count - before.message_count
    return state.messages[-count:] if count > 0 else ()


# One screen


def live_view(
    state: CampaignState, folder: Path, console: Console, now: datetime
) -> RenderableType:
    """State of a campaign in a frame of at most `WIDTH` columns.

    Args:
        state: of the campaign.
        folder: of the campaign.
        console: the console for it.
        now: by this machine's clock.
    """
    width = min(console.width, WIDTH)
    inner = width - 4
    parts: list[RenderableType] = []
    if described := _describe(state.setup):
        parts.append(Text(described, style="dim"))
    if question := doubt(state, now):
        parts.append(Text(question, style=_STYLES["silent"]))
    parts += [_budget_bar(state, inner), Text(), _counts(state)]
    if state.progress.failed and state.progress.seconds >= 2.0 * BAR:
        parts += [Text(), *_failures_over_time(state, inner, console.options.ascii_only)]
    if state.workers and not state.status.is_end:
        parts += [Text(), _workers(state.workers)]
    if state.messages:
        parts += [Text(), _messages(state.messages[-MESSAGES_SHOWN:], now)]
    style = _STYLES[state.status]
    place = folder if len(str(folder)) < inner - 16 else f"...{str(folder)[-(inner - 20) :]}"
    return Panel(
        Group(*parts),
        width=width,
        title=Text.assemble((status_name(state), style), "  ", (str(place), "default")),
        title_align="left",
        subtitle=Text(_whereabouts(state, now), style="dim"),
        subtitle_align="right",
        border_style="bright_black",
    )


def _budget_bar(state: CampaignState, width: int) -> RenderableType:
    progress = state.progress
    text = f"{progress.budget_spent:.1%}  {times(state)}"
    row = Table.grid(padding=(0, 2))
    bar = ProgressBar(
        total=1.0,
        completed=progress.budget_spent,
        width=max(width - len(text) - 2, 10),
        complete_style="green",
        finished_style="bold green",
    )
    row.add_row(bar, text)
    return row


def _counts(state: CampaignState) -> RenderableType:
    """All counts in the words of every command, and below them the rates and the best MOOBD."""
    progress = state.progress
    counts = Text(progress.in_words(), style="bold")
    counts.highlight_regex(r"[1-9]\d* failed", "red")
    counts.highlight_regex(r"[1-9]\d* errors?", "yellow")
    best = "-" if progress.min_moobd is None else f"{progress.min_moobd:.2f} m"
    return Group(counts, Text(f"best MOOBD {best}{progress.best_in_words}, {rates(state)}"))


def _failures_over_time(state: CampaignState, width: int, ascii_only: bool) -> list[RenderableType]:
    # A bar covers at least the log's resolution.
    seconds = state.progress.seconds
    count = min(max(int(seconds / BAR), 1), width)
    failures = state.failures_per_interval(count)
    title = Text("failures over time", style="dim")
    note = Text(f"{format_duration(seconds / count)} a bar, {failures.max():.0f} at most", "dim")
    head = Table.grid(expand=True)
    head.add_column()
    head.add_column(justify="right")
    head.add_row(title, note)
    columns = [failures[place * count // width] for place in range(width)]
    bars = sparkline(columns, rows=2, ascii_only=ascii_only)
    return [head, *(Text(row, style="red") for row in bars)]


def sparkline(
    values: Sequence[float], *, rows: int = 1, ascii_only: bool = False
) -> tuple[str, ...]:
    """A bar of characters per value, from nothing for 0 to full rows for the greatest.

    Returns the rows from top to bottom, each with one character per value.
    """
    bars = _ASCII_BARS if ascii_only else _BARS
    full = len(bars) - 1
    scale = rows * full / (max(values, default=0.0) or 1.0)
    # Rounded up: only 0 is empty.
    heights = [math.ceil(value * scale - 1e-9) for value in values]
    return tuple(
        "".join(bars[min(max(height - row * full, 0), full)] for height in heights)
        for row in reversed(range(rows))
    )


def _workers(workers: Sequence[WorkerState]) -> RenderableType:
    """The workers' activities, in two columns if they are many; lost workers come first."""
    shown = sorted(workers, key=lambda worker: worker.state != "lost")[:WORKERS_SHOWN]
    half = len(shown) if len(shown) <= 4 else (len(shown) + 1) // 2
    side_by_side = Table.grid(padding=(0, 4))
    side_by_side.add_row(*map(_table_of_workers, filter(None, (shown[:half], shown[half:]))))
    if len(workers) == len(shown):
        return side_by_side
    more = f"and {len(workers) - len(shown)} more; of all {len(workers)}: {census(workers)}"
    return Group(side_by_side, Text(more, style="dim"))


def _table_of_workers(workers: Sequence[WorkerState]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("worker", no_wrap=True, overflow="ellipsis", max_width=14)
    table.add_column("does", no_wrap=True)
    table.add_column("for", justify="right", no_wrap=True)
    table.add_column("tests", justify="right", no_wrap=True)
    for worker in workers:
        table.add_row(
            Text(worker.name),
            Text(worker.state, style=_STYLES.get(worker.state, "")),
            format_duration(worker.seconds_in_state),
            f"{worker.tests:,}",
        )
    return table


def _messages(messages: Sequence[Message], now: datetime) -> Text:
    lines = (
        Text.assemble(
            (f"{clock_time(message.time, now)} ", "dim"),
            (message.text, _STYLES.get(message.level, "")),
        )
        for message in messages
    )
    text = Text("\n").join(lines)
    text.no_wrap, text.overflow = True, "ellipsis"
    return text


# Line by line


def _print_plainly(state: CampaignState, folder: Path, console: Console) -> None:
    now = datetime.now(UTC)
    print_facts(list(_facts(state, folder, console.options.ascii_only, now)))
    for message in state.messages[-MESSAGES_SHOWN:]:
        click.echo(message_line(message, now))


def _facts(
    state: CampaignState, folder: Path, ascii_only: bool, now: datetime
) -> Iterator[tuple[str, str]]:
    progress = state.progress
    yield "campaign", str(folder)
    yield "status", ", ".join(filter(None, (status_name(state), doubt(state, now))))
    if described := _describe(state.setup):
        yield "search", described
    yield "budget", f"{progress.budget_spent:.1%} spent, {times(state)}"
    yield "results", progress.in_words()
    yield "rate", rates(state)
    if progress.min_moobd is not None:
        yield "best MOOBD", f"{progress.min_moobd:.2f} m{progress.best_in_words}"
    intervals = min(int(progress.seconds / BAR), 60)
    if progress.failed and intervals > 1:
        (bars,) = sparkline(state.failures_per_interval(intervals).tolist(), ascii_only=ascii_only)
        yield "failures", f"{bars}  (over time)"
    if state.workers and not state.status.is_end:
        yield "workers", census(state.workers)
    if place := _whereabouts(state, now):
        yield "log", place


# Words


def _describe(setup: Setup) -> str:
    """The search, in one line."""
    parts = [name for name in (setup.strategy, setup.driver, setup.simulator) if name]
    if setup.seed is not None:
        parts.append(f"seed {setup.seed}")
    budget = setup.budget
    if budget is not None:
        limits = (
            (budget.simulations, f"{budget.simulations} simulations"),
            (budget.time, format_duration(budget.time or 0.0)),
            (budget.failures, f"{budget.failures} failures"),
        )
        parts.append("budget " + " or ".join(text for limit, text in limits if limit is not None))
    return ", ".join(parts)


def _whereabouts(state: CampaignState, now: datetime) -> str:
    """The process that writes the log, and the time of its last line."""
    parts = []
    if state.setup.process_id is not None:
        parts.append(f"process {state.setup.process_id}")
    if state.setup.host:
        parts.append(f"on {state.setup.host}")
    if state.last_time:
        parts.append(f"at {clock_time(state.last_time, now)}")
    if state.unreadable:
        parts.append(f"{state.unreadable} lines unreadable")
    return " ".join(parts)
