"""The view of ``frenetic show --follow``: the progress of a campaign until it ends."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Final

import click

from frenetic._support.words import format_duration
from frenetic.campaign.status import CampaignState, News, Status, read_state
from frenetic.cli import echo
from frenetic.cli.console import ResultsConsole, live_line, print_facts, progress_text

LOOK_INTERVAL: Final = 1.0
"""Least pause before the campaign is read again, in s (our choice).

The pause is longer if reading is slow, see `MAX_LOOKING_SHARE`.
"""
MAX_LOOKING_SHARE: Final = 0.1
"""Largest ratio of the time for reading to the pause after it (our choice).

Reading a large campaign for 0.5 s makes the next pause 5 s long.
"""


def print_state(folder: Path) -> None:
    """Print the present state of a campaign as one JSON object.

    Raises:
        CampaignError: the folder holds no campaign, or its database is damaged.
    """
    echo(json.dumps({"folder": str(folder)} | read_state(folder).as_json()))


def follow(folder: Path) -> None:
    """Show a campaign until it ends.

    Raises:
        click.exceptions.Exit: the campaign ended in another way than by finishing (exit code 1).
        CampaignError: the folder holds no campaign, or its database is damaged.
    """
    state = read_state(folder)
    first_status = state.status
    print_facts([*_fixed_facts(state, folder), *_changing_facts(state)])
    state = _show_until_end(folder, state)
    if state.status is not first_status:
        print_facts(_changing_facts(state))
    if state.status is not Status.FINISHED:
        raise click.exceptions.Exit(1)


def _show_until_end(folder: Path, state: CampaignState) -> CampaignState:
    """Show news and progress of a campaign until it ends; return its last state.

    Args:
        folder: folder of the campaign.
        state: the campaign's state now.
    """
    console = ResultsConsole()
    pause = LOOK_INTERVAL
    printed: tuple[News, ...] = ()
    with live_line(console) as show_line:
        while True:
            # A state holds the last `MOST_NEWS` (10) lines of news. If more are written within one
            # pause, the earliest of them are not shown.
            _print_news(console, (line for line in state.news if line not in printed))
            printed = state.news
            if state.status.has_ended:
                return state
            # The text is made only if the line is drawn, which is rare without a terminal.
            show_line(state.summary.budget_spent, partial(progress_text, state.summary))
            time.sleep(pause)
            start = time.perf_counter()
            state = read_state(folder)
            look_seconds = time.perf_counter() - start
            pause = max(LOOK_INTERVAL, look_seconds / MAX_LOOKING_SHARE)


def _print_news(console: ResultsConsole, news: Iterable[News]) -> None:
    """Print each line of news with its time, and with its level if that is not ``info``."""
    for line in news:
        level = "" if line.level == "info" else f"{line.level}: "
        text = f"{_time_text(line.time)} {level}{line.message}"
        console.print(text, markup=False, soft_wrap=True)


def _fixed_facts(state: CampaignState, folder: Path) -> list[tuple[str, str]]:
    """Return folder and search of a campaign, which stay the same, as labels and texts."""
    seed = "" if state.seed is None else f", seed {state.seed}"
    return [("campaign", str(folder)), ("search", f"{', '.join(state.parts)}{seed}")]


def _changing_facts(state: CampaignState) -> list[tuple[str, str]]:
    """Return status, spent budget and results of a campaign as labels and texts."""
    summary, status = state.summary, str(state.status)
    if state.status is Status.UNKNOWN:
        status += f": it may still be running on {state.writer}"
    elif state.resume_command:
        status += f"; go on: {state.resume_command}"
    elif state.status is Status.RUNNING:
        status += f" in {state.writer}"
    times = format_duration(summary.seconds)
    if state.seconds_left is not None:
        times += f", {format_duration(state.seconds_left)} left"
    return [
        ("status", status),
        ("budget", f"{summary.budget_spent:.1%} spent, {times}"),
        ("results", summary.as_text()),
    ]


def _time_text(stamp: str) -> str:
    """Return the time of a log line: "14:03:59" if it is today, else "11-27 14:03".

    Args:
        stamp: date and time in ISO 8601; if it cannot be read, the result is "-".
    """
    try:
        moment = datetime.fromisoformat(stamp).astimezone()
    except ValueError:
        return "-"
    is_today = moment.date() == datetime.now().astimezone().date()
    return f"{moment:%H:%M:%S}" if is_today else f"{moment:%m-%d %H:%M}"
