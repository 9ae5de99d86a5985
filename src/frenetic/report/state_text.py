"""A campaign's state in words, for a terminal and for a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Final

from frenetic._support.words import format_duration, rate_words

if TYPE_CHECKING:
    from frenetic.campaign.log import WorkerState
    from frenetic.campaign.watch import CampaignState, Message

OLD: Final = 180.0
"""Time by this machine's clock after which a log that does not grow may be old, in s."""


def status_name(state: CampaignState) -> str:
    """Activity of a campaign, in a word or two."""
    return str(state.status).replace("_", " ")


def doubt(state: CampaignState, now: datetime) -> str:
    """Reason why the shown state may be outdated; empty if there is none.

    Args:
        state: of the campaign.
        now: by this machine's clock, which is compared with the campaign's only if nothing better
            is known.
    """
    if state.trouble:
        return f"the log cannot be read: {state.trouble}"
    if state.status == "waiting":
        return "the log does not say anything yet"
    if state.status == "silent":
        quiet = format_duration(state.quiet_seconds)
        return f"no sign of life for {quiet}: is it still running?"
    written = _moment(state.last_time)
    if state.status == "running" and not state.has_grown and written is not None:
        age = (now - written).total_seconds()
        if age > OLD:
            return (
                f"the last line is {format_duration(age)} old, if both clocks agree:"
                " is it still running?"
            )
    return ""


def progress_line(state: CampaignState) -> str:
    """State of a campaign in one line."""
    progress = state.progress
    best = "-" if progress.min_moobd is None else f"{progress.min_moobd:.2f} m"
    rate = "" if state.rate is None else f", {rate_words(state.rate)}"
    return (
        f"{progress.budget_spent:.1%} after {times(state)}: {progress.in_words()}, best MOOBD"
        f" {best}{progress.best_in_words}{rate}"
    )


def message_line(message: Message, now: datetime) -> str:
    """A warning or error in one line."""
    return f"{clock_time(message.time, now)} {message.level}: {message.text}"


def times(state: CampaignState) -> str:
    """The campaign's spent time, and what is left of it while it runs."""
    gone = format_duration(state.progress.seconds)
    left = state.progress.seconds_left
    if state.status.is_end or left is None:
        return gone
    return f"{gone}, {format_duration(left)} left"


def rates(state: CampaignState) -> str:
    """The present rate while the campaign runs, and that since its start."""
    now = "" if state.status.is_end else f"{rate_words(state.rate)} now, "
    return f"{now}{rate_words(state.progress.tests_per_second)} overall"


def census(workers: Sequence[WorkerState]) -> str:
    """Numbers of workers by activity."""
    counted = Counter(worker.state for worker in workers).most_common()
    return ", ".join(f"{count} {state}" for state, count in counted)


def clock_time(text: str, now: datetime) -> str:
    """A moment of the log for people: its time today, or its date too."""
    moment = _moment(text)
    if moment is None:
        return "-"
    here, today = moment.astimezone(), now.astimezone()
    return f"{here:%H:%M:%S}" if here.date() == today.date() else f"{here:%m-%d %H:%M}"


def _moment(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text)
        return moment if moment.tzinfo and 1970 < moment.year < 9000 else None
    except ValueError:
        return None
