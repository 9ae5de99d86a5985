"""The view of ``frenetic show --follow``: the progress of a campaign until it ends."""

from __future__ import annotations

import json
import time
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Final

import click

from frenetic._support.words import format_duration
from frenetic.campaign.status import CampaignState, News, Status, read_state
from frenetic.cli import echo
from frenetic.cli.console import ResultsConsole, live_line, print_facts, progress_text

INTERVAL: Final = 1.0
"""Least time between two looks at the campaign, in s."""
SHARE: Final = 0.1
"""Largest share of the time that looks at the campaign take, 0..1."""


def follow(folder: Path, *, as_json: bool) -> None:
    """Show a campaign until it ends, or print its state as JSON; exit with 1 unless it finished."""
    state = read_state(folder)
    if as_json:
        echo(json.dumps({"folder": str(folder)} | state.as_json()))
        return
    console = ResultsConsole()
    print_facts(_facts(state, folder))
    began = state.status
    known: tuple[News, ...] = ()
    with live_line(console) as show:
        while True:
            for line in state.news:
                if line not in known:
                    level = "" if line.level == "info" else f"{line.level}: "
                    text = f"{_clock(line.time)} {level}{line.message}"
                    console.print(text, markup=False, soft_wrap=True)
            if state.status.has_ended:
                break
            known = state.news
            show(state.summary.budget_spent, partial(progress_text, state.summary))
            start = time.perf_counter()
            state = read_state(folder)
            spent = time.perf_counter() - start
            time.sleep(max(INTERVAL, spent / SHARE))
    if state.status is not began:
        print_facts(_facts(state, folder)[1:])
    if state.status is not Status.FINISHED:
        raise click.exceptions.Exit(1)


def _facts(state: CampaignState, folder: Path) -> list[tuple[str, str]]:
    """Return the state as labels and texts."""
    summary, status = state.summary, str(state.status)
    if state.status is Status.UNKNOWN:
        status += f": {state.writer} may write it"
    elif state.resume_command:
        status += f"; go on: {state.resume_command}"
    elif state.status is Status.RUNNING:
        status += f" in {state.writer}"
    left = state.seconds_left
    times = format_duration(summary.seconds)
    times += "" if left is None else f", {format_duration(left)} left"
    seed = "" if state.seed is None else f", seed {state.seed}"
    return [
        ("campaign", str(folder)),
        ("search", f"{', '.join(state.parts)}{seed}"),
        ("status", status),
        ("budget", f"{summary.budget_spent:.1%} spent, {times}"),
        ("results", summary.as_text()),
    ]


def _clock(time: str) -> str:
    """Return the time of a log line for people: with the date unless it is of today."""
    try:
        moment = datetime.fromisoformat(time).astimezone()
    except ValueError:
        return "-"
    is_today = moment.date() == datetime.now().astimezone().date()
    return f"{moment:%H:%M:%S}" if is_today else f"{moment:%m-%d %H:%M}"
