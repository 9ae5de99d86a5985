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
"""Least pause between two looks at the campaign, in s (our choice)."""
MAX_LOOKING_SHARE: Final = 0.1
"""Largest share of the time that looks at a large campaign take, from 0 to 1 (our choice)."""


def follow(folder: Path, *, as_json: bool) -> None:
    """Show a campaign until it ends; or print its present state as JSON and return.

    Raises:
        click.exceptions.Exit: the campaign ended in another way than by finishing (exit code 1);
            never with ``as_json``.
        CampaignError: the folder holds no campaign, or its database is damaged.
    """
    state = read_state(folder)
    if as_json:
        echo(json.dumps({"folder": str(folder)} | state.as_json()))
        return
    first_status = state.status
    print_facts(_facts(state, folder))
    state = _show_until_end(folder, state)
    if state.status is not first_status:
        _campaign, *facts_that_change = _facts(state, folder)
        print_facts(facts_that_change)
    if state.status is not Status.FINISHED:
        raise click.exceptions.Exit(1)


def _show_until_end(folder: Path, state: CampaignState) -> CampaignState:
    """Show news and progress of a campaign until it ends; return its last state."""
    console = ResultsConsole()
    printed: tuple[News, ...] = ()
    with live_line(console) as show_line:
        while True:
            # A state holds only the last news, so more of them within one pause are not shown.
            _print_news(console, (line for line in state.news if line not in printed))
            printed = state.news
            if state.status.has_ended:
                return state
            # The text is made only if the line is drawn, which is rare without a terminal.
            show_line(state.summary.budget_spent, partial(progress_text, state.summary))
            start = time.perf_counter()
            state = read_state(folder)
            look_seconds = time.perf_counter() - start
            time.sleep(max(LOOK_INTERVAL, look_seconds / MAX_LOOKING_SHARE))


def _print_news(console: ResultsConsole, news: Iterable[News]) -> None:
    """Print each line of news with its time, and with its level if that is not ``info``."""
    for line in news:
        level = "" if line.level == "info" else f"{line.level}: "
        text = f"{_time_text(line.time)} {level}{line.message}"
        console.print(text, markup=False, soft_wrap=True)


def _facts(state: CampaignState, folder: Path) -> list[tuple[str, str]]:
    """Return the state as labels and texts, the campaign's folder first."""
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
    seed = "" if state.seed is None else f", seed {state.seed}"
    return [
        ("campaign", str(folder)),
        ("search", f"{', '.join(state.parts)}{seed}"),
        ("status", status),
        ("budget", f"{summary.budget_spent:.1%} spent, {times}"),
        ("results", summary.as_text()),
    ]


def _time_text(stamp: str) -> str:
    """Return the time of a log line: the hour if it is today, else date and hour; or "-".

    Args:
        stamp: date and time in ISO 8601; "-" stands for one that cannot be read.
    """
    try:
        moment = datetime.fromisoformat(stamp).astimezone()
    except ValueError:
        return "-"
    is_today = moment.date() == datetime.now().astimezone().date()
    return f"{moment:%H:%M:%S}" if is_today else f"{moment:%m-%d %H:%M}"
