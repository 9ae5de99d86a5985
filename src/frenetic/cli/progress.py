"""Progress of a command with a known amount of work."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console

from frenetic._support.durations import format_duration
from frenetic.cli.console import PLAIN_INTERVAL


@contextmanager
def counted_progress(log: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """Gives a function that shows the work done, and the whole work.

    It shows a bar on a terminal, elsewhere a plain line now and then, and nothing for short work.

    Args:
        log: the console for it.
        what: the work, such as "Checking".
    """
    if log.is_terminal:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(compact=True),
        )
        with Progress(*columns, console=log, transient=True) as bar:
            task = bar.add_task(what)
            yield lambda done, total: bar.update(task, completed=done, total=total)
        return
    start = shown = time.monotonic()

    def line(done: int, total: int) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < PLAIN_INTERVAL:
            return
        shown = now
        left = (now - start) * (total - done) / max(done, 1)
        log.print(f"{what}: {done:,} of {total:,}, {format_duration(left)} left")

    yield line
