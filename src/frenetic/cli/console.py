"""Consoles and what is printed on them: progress, tables, facts and commands for a shell."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from frenetic._support.printable import printable
from frenetic._support.words import format_duration, rate_words
from frenetic.cli import Invocation, echo, silence

if TYPE_CHECKING:
    from frenetic.campaign import Summary

ANNOUNCE_AFTER = 1.5
"""Time of compiling after which it is announced, in s (our choice)."""
LOOK_INTERVAL = 0.1
"""Time between two looks whether something is compiled, in s (our choice)."""
LINE_INTERVAL = 5.0
"""Least time between two lines of progress where there is no terminal, in s (our choice)."""
_FILE_WIDTH = 120
"""Width of results in a file or a pipe, in characters (our choice)."""
_BAR_WIDTH = 40
"""Width of the progress bar, in characters (our choice)."""
_DRAWINGS_PER_SECOND = 8
"""Rate at which a terminal's progress is drawn (our choice)."""
_LABEL_WIDTH = 10
"""Least width of the labels of facts, in characters (our choice)."""


class _EscapingConsole(Console):
    r"""A console that prints control characters as ``\x1b``, as `frenetic.cli.echo` does."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return the text for the terminal; rich calls it for all texts, also in tables."""
        return super().render_str(printable(text), **options)


class ResultsConsole(_EscapingConsole):
    """The console for results on stdout; in a file or a pipe its width is fixed."""

    def __init__(self) -> None:
        super().__init__(highlight=False, width=None if sys.stdout.isatty() else _FILE_WIDTH)

    def on_broken_pipe(self) -> None:
        """Raise an error that `frenetic.cli.main` handles; rich would end the program itself."""
        raise BrokenPipeError


class Log(_EscapingConsole):
    """The console for progress on stderr; a campaign continues when nobody reads it."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, soft_wrap=True)

    def stopping(self) -> None:
        """Print that Ctrl-C was noticed."""
        self.print("Finishing what runs; press Ctrl-C again to leave at once.")

    def on_broken_pipe(self) -> None:
        """Stop printing, since nobody reads stderr any more."""
        self.quiet = True
        silence(sys.stderr)


@contextmanager
def announced_compilation(log: Console) -> Iterator[Callable[[], None]]:
    """Print that the simulator is being compiled, if that takes `ANNOUNCE_AFTER`.

    Nothing is printed where the compiled simulator is found on disk.

    Args:
        log: the console for progress.

    Yields:
        A function that ends the announcement, for the first drive.
    """
    has_ended = threading.Event()

    def watch() -> None:
        compiling_seconds = 0.0
        while not has_ended.wait(LOOK_INTERVAL):
            # The module imports numba, which is slow; it is imported where something is compiled.
            compiled = sys.modules.get("frenetic._support.compiled")
            if compiled is None or not compiled.is_compiling():
                continue
            compiling_seconds += LOOK_INTERVAL
            if compiling_seconds >= ANNOUNCE_AFTER:
                log.print("The simulator is compiled: about 15 s this time, then it is cached.")
                return

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield has_ended.set
    finally:
        has_ended.set()


def progress_text(progress: Summary) -> str:
    """Return the progress of a search in one line."""
    left = progress.seconds_left
    return (
        f"{progress.as_text()}{progress.worst_as_text()},"
        f" {rate_words(progress.tests_per_second)},"
        f" {'?' if left is None else format_duration(left)} left"
    )


@contextmanager
def live_progress(log: Console) -> Iterator[Callable[[Summary], None]]:
    """Yield a function that shows a summary of a search as its progress."""
    with live_line(log) as show:
        yield lambda progress: show(progress.budget_spent, lambda: progress_text(progress))


@contextmanager
def live_line(log: Console) -> Iterator[Callable[[float, Callable[[], str]], None]]:
    """Yield a function that shows progress: a bar on a terminal, else a line now and then.

    The function takes the share that is done, from 0 to 1, and a function that returns the text,
    which is called only if the text is shown.
    """
    if log.is_terminal:
        from rich.live import Live
        from rich.progress_bar import ProgressBar

        bar = ProgressBar(total=1.0, width=_BAR_WIDTH)
        with Live(console=log, refresh_per_second=_DRAWINGS_PER_SECOND, transient=True) as live:

            def update(share: float, text: Callable[[], str]) -> None:
                bar.update(share)
                lines = Table.grid()
                lines.add_row(bar)
                lines.add_row(text())
                live.update(lines)

            yield update
        return
    last_line_at: float | None = None

    def print_line(_: float, text: Callable[[], str]) -> None:
        nonlocal last_line_at
        now = time.monotonic()
        if last_line_at is None:
            last_line_at = now  # the first line comes after one interval
        elif now - last_line_at >= LINE_INTERVAL:
            last_line_at = now
            log.print(text())

    yield print_line


class TimeLeft:
    """An estimate of the time that a work still takes, from what was done since the first call."""

    def __init__(self) -> None:
        self._first_call: tuple[float, float] | None = None
        """Moment of the first call in s, and the work done until then."""

    def words(self, done: float, total: float) -> str:
        """Return ``, 0:12 left``; empty as long as nothing was done since the first call."""
        now = time.monotonic()
        self._first_call = self._first_call or (now, done)
        start, done_before = self._first_call
        if done <= done_before:
            return ""
        seconds_left = (now - start) * (total - done) / (done - done_before)
        return f", {format_duration(seconds_left)} left"


@contextmanager
def counted_progress(log: Console, work: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that shows the number of steps done and the number of all steps.

    Args:
        log: the console for progress.
        work: verb for the work, such as "Checking".
    """
    time_left = TimeLeft()

    def update(done: int, total: int) -> None:
        text = f"{work}: {done:,} of {total:,}{time_left.words(done, total)}"
        show(done / max(total, 1), lambda: text)

    with live_line(log) as show:
        yield update


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], *, title: str | None = None
) -> None:
    """Print a table on stdout.

    Args:
        columns: headings; a column whose heading begins with ``>`` is aligned to the right.
        rows: cells of each row; None is printed as a dash.
        title: line above the table; None for no line.
    """
    table = Table(box=None, pad_edge=False, title=title, title_justify="left")
    for heading in columns:
        text = heading.removeprefix(">")
        table.add_column(text, justify="left" if text == heading else "right", overflow="fold")
    for row in rows:
        table.add_row(*("-" if cell is None else escape(str(cell)) for cell in row))
    ResultsConsole().print(table)


def two_digits(value: float | None) -> str | None:
    """Return a number with two decimals; None stays None."""
    return None if value is None else f"{value:.2f}"


def print_facts(facts: Sequence[tuple[str, str]]) -> None:
    """Print labels and texts, one pair a line; a label with an empty text is left out."""
    facts = [(label, text) for label, text in facts if text]
    width = max([_LABEL_WIDTH, *(len(label) for label, _ in facts)]) + 1
    for label, text in facts:
        line = text.replace("\n", "\\x0a")  # a foreign text must not look like a fact of its own
        echo(f"{label:<{width}}{line}")


def this_command() -> Invocation:
    """Return the present command line; its `str` can be pasted into a shell."""
    return click.get_current_context().find_root().ensure_object(Invocation)


def shell(path: Path | str) -> str:
    """Return a path or word quoted for a shell."""
    import shlex

    text = str(path)
    return f'"{text}"' if sys.platform == "win32" and " " in text else shlex.quote(text)
