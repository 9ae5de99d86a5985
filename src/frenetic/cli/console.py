"""Printing: results on stdout, progress and mistakes on stderr."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from frenetic._support.words import (
    capitalised,
    counted,
    format_duration,
    lane_words,
    oob_unit,
    printable,
    rate_words,
)
from frenetic.cli import Invocation, echo, silence
from frenetic.conditions.condition import SPEED
from frenetic.criteria.criterion import DRIVER, LANE, signal_named

if TYPE_CHECKING:
    from frenetic.analysis import Clusters
    from frenetic.campaign import CampaignStore, Summary, Test
    from frenetic.campaign.counts import Counts
    from frenetic.criteria.criterion import CriteriaSet
    from frenetic.oracle.verdict import Result
    from frenetic.road import Road
    from frenetic.spec.terms import DriveSetting

ANNOUNCE_AFTER = 1.5  # s of compiling after which it is mentioned
LOOK_EVERY = 0.1  # s between two looks whether something is compiled
PLAIN_INTERVAL = 5.0  # s between two lines of progress where there is no terminal


class _ShowingConsole(Console):
    """A console that shows control characters in texts, as `frenetic.cli.echo` does."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return the text for the terminal; all printed texts pass here, also cells of tables."""
        return super().render_str(printable(text), **options)


class ResultsConsole(_ShowingConsole):
    """The console for results: as wide as needed where they go into a file or a pipe."""

    def __init__(self) -> None:
        super().__init__(highlight=False, width=None if sys.stdout.isatty() else 120)

    def on_broken_pipe(self) -> None:
        """Raise the error, which `main` handles."""
        raise BrokenPipeError


class Log(_ShowingConsole):
    """The console for progress; a campaign goes on when nobody reads it."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, soft_wrap=True)

    def stopping(self) -> None:
        """Say that Ctrl-C was noticed."""
        self.print("Finishing what runs; press Ctrl-C again to leave at once.")

    def on_broken_pipe(self) -> None:
        """Print no more."""
        self.quiet = True
        silence(sys.stderr)


@contextmanager
def announced_compilation(log: Console) -> Iterator[Callable[[], None]]:
    """Say that the simulator is compiled, if that takes a while; the yielded function ends it.

    Where the compiled simulator is found on disk, nothing is said.
    """
    over = threading.Event()

    def look() -> None:
        spent = 0.0
        while not over.wait(LOOK_EVERY):
            # Not imported here: numba takes its time, and whoever compiles has imported it.
            compiled = sys.modules.get("frenetic._support.compiled")
            if compiled is None or not compiled.is_compiling():
                continue
            spent += LOOK_EVERY
            if spent >= ANNOUNCE_AFTER:
                log.print("The simulator is compiled: about 15 s this time, then it is cached.")
                return

    threading.Thread(target=look, daemon=True).start()
    try:
        yield over.set
    finally:
        over.set()


def progress_text(progress: Summary) -> str:
    """Return the progress of a search in one line."""
    left = progress.seconds_left
    return (
        f"{progress.as_text()}{progress.worst_as_text},"
        f" {rate_words(progress.tests_per_second)},"
        f" {'?' if left is None else format_duration(left)} left"
    )


@contextmanager
def live_progress(log: Console) -> Iterator[Callable[[Summary], None]]:
    """Yield a function that shows the progress of a search."""
    with live_line(log) as show:
        yield lambda progress: show(progress.budget_spent, lambda: progress_text(progress))


@contextmanager
def live_line(log: Console) -> Iterator[Callable[[float, Callable[[], str]], None]]:
    """Yield a function that shows a share 0..1 and a text: a bar on a terminal, else lines."""
    if log.is_terminal:
        from rich.live import Live
        from rich.progress_bar import ProgressBar

        bar = ProgressBar(total=1.0, width=40)
        with Live(console=log, refresh_per_second=8, transient=True) as live:

            def update(share: float, text: Callable[[], str]) -> None:
                bar.update(share)
                lines = Table.grid()
                lines.add_row(bar)
                lines.add_row(text())
                live.update(lines)

            yield update
        return
    last: float | None = None

    def line(_: float, text: Callable[[], str]) -> None:
        nonlocal last
        now = time.monotonic()
        if last is None:
            last = now  # the first test: nothing to tell yet
        elif now - last >= PLAIN_INTERVAL:
            last = now
            log.print(text())

    yield line


class TimeLeft:
    """Estimates when a work ends, from the part that was done since the first look."""

    def __init__(self) -> None:
        self._first: tuple[float, float] | None = None  # moment in s, and work done until then

    def words(self, done: float, total: float) -> str:
        """Return ``, 0:12 left``; empty as long as nothing was done since the first look."""
        now = time.monotonic()
        self._first = self._first or (now, done)
        start, before = self._first
        if done <= before:
            return ""
        return f", {format_duration((now - start) * (total - done) / (done - before))} left"


@contextmanager
def counted_progress(log: Console, work: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function that shows the number of steps done and the number of all steps.

    Args:
        log: the console for it.
        work: the work, such as "Checking".
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
        columns: headings; a heading that begins with > stands over numbers, flush right.
        rows: cells, of which None is shown as a dash.
        title: above the table, on the left.
    """
    table = Table(box=None, pad_edge=False, title=title, title_justify="left")
    for heading in columns:
        text = heading.removeprefix(">")
        table.add_column(text, justify="left" if text == heading else "right", overflow="fold")
    for row in rows:
        table.add_row(*("-" if cell is None else escape(str(cell)) for cell in row))
    ResultsConsole().print(table)


def two_digits(value: float | None) -> str | None:
    """Return a number with two decimals; None for None."""
    return None if value is None else f"{value:.2f}"


def print_failures(clusters: Clusters, counts: Counts, listed: int, lane_width: float) -> None:
    """Print a table of distinct failures or, if nothing failed, of the nearest misses.

    `print_causes` says in the first case how often the simulator broke, and what was compared.

    Args:
        clusters: the distinct failures or near misses.
        counts: of the campaign; possibly with more failures than were compared.
        listed: number of clusters to print.
        lane_width: m.
    """
    failures = counts.failures
    if counts.broken and not failures:
        ResultsConsole().print(capitalised(counts.broken), style="bold", markup=False)
    if not clusters:
        return
    heading = "what happens"
    if not failures:
        title = f"The nearest {'miss' if len(clusters) == 1 else 'misses'}"
        if not counts.broken:
            title = f"Nothing failed; {title.lower()}"
        heading = "where the car came nearest to leaving its lane"
    else:
        title = counted(len(clusters), "distinct failure")
        if listed < len(clusters):
            title += f", the {listed} most severe"
    ResultsConsole().print(title, style="bold", markup=False)
    is_outside = {
        cluster.moobd < 0.0 for cluster in clusters.clusters[:listed] if cluster.fault is None
    }
    if is_outside <= {True}:
        sign, place = -1.0, "outside (m)"
    else:
        sign, place = 1.0, f"{'MOOBD' if True in is_outside else 'inside'} ({oob_unit(lane_width)})"
    print_table(
        (">test", f">{place}", ">tests", heading),
        [
            (
                cluster.most_severe,
                None if cluster.fault is not None else f"{sign * cluster.moobd:.2f}",
                len(cluster),
                f"known before: {cluster.description}"
                if cluster.was_known
                else cluster.description,
            )
            for cluster in clusters.clusters[:listed]
        ],
    )


def print_causes(clusters: Clusters, counts: Counts, shortened: Mapping[int, Test]) -> None:
    """Print a table of the causes of failures.

    Args:
        clusters: the distinct failures.
        counts: of the campaign; possibly with more failures than were compared.
        shortened: the drives on minimised roads, by their tests.
    """
    if counts.broken:
        ResultsConsole().print(capitalised(counts.broken), style="bold", markup=False)
    if not clusters:
        return
    severe = (
        f"the {clusters.failures} most severe of " if clusters.failures < counts.failures else ""
    )
    title = f"{counted(len(clusters.causes), 'cause')} of {severe}"
    title += f"{counted(counts.failures, 'failure')}, {len(clusters)} of them distinct"
    if clusters.known:
        title += f", {clusters.known} known before"
    ResultsConsole().print(title, style="bold", markup=False)
    print_table(
        (">failures", ">distinct", "what the driver does", ">example", "its road"),
        [
            (
                cause.failures,
                len(cause.clusters),
                cause.words,
                f"test {cause.example}",
                _cut(shortened.get(cause.example)),
            )
            for cause in clusters.causes
        ],
    )


def _cut(short: Test | None) -> str | None:
    """Say to how many metres a failing road was shortened; None without a shortened road."""
    return None if short is None else f"cut to {short.road.length:.0f} m"


def first_error(store: CampaignStore) -> str:
    """Return the reason of the first test in which the simulator broke; empty if there is none."""
    from frenetic.oracle.outcome import Outcome

    return "".join(test.reason for test in store.tests(Outcome.ERROR, limit=1))


def clusters_json(clusters: Clusters) -> list[dict[str, Any]]:
    """Return distinct failures, or near misses, as JSON objects."""
    return [
        {
            "most_severe": cluster.most_severe,
            "moobd": cluster.moobd,
            "description": cluster.description,
            "tests": list(cluster.ids),
            **({} if cluster.was_known is None else {"was_known": cluster.was_known}),
        }
        for cluster in clusters
    ]


def causes_json(clusters: Clusters, shortened: Mapping[int, Test]) -> list[dict[str, Any]]:
    """Return causes of failures as JSON objects."""
    lengths = {test_id: test.road.length for test_id, test in shortened.items()}
    return [
        {
            "cause": cause.words,
            "failures": cause.failures,
            "distinct_failures": len(cause.clusters),
            "example": cause.example,
            "minimised_length": lengths.get(cause.example),
        }
        for cause in clusters.causes
    ]


def limit_text(
    setting: DriveSetting,
    road: Road | None = None,
    conditions: Mapping[str, float] = MappingProxyType({}),
) -> str:
    """Return the speed limit on a road as a text, with its origin.

    Args:
        setting: in which the road is driven.
        road: None for the roads of a search.
        conditions: of the drive's own.
    """
    class_name = "" if setting.road_class is None else setting.road_class.name
    return setting.rules_in(conditions).limit_text(road, class_name)


def limit_of_search(setting: DriveSetting, from_roads: object) -> str:
    """Return the speed limit of a search's roads as a text, with its origin.

    Args:
        setting: of the search.
        from_roads: folder of the real roads from which it starts; None for none.
    """
    domain, rules = setting.domain, setting.rules_in({})
    if domain is not None and SPEED in domain.conditions:
        return f"drawn from {domain.name}"
    limit = limit_text(setting)
    if from_roads is None or rules.road_limits == "ignored":
        return limit
    scaling = "" if rules.road_limits == "kept" else f", scaled to {rules.speed_limit:.4g} km/h"
    return f"each real road's own{scaling}; of other roads {limit}"


def facts_of_drive(
    result: Result, duration: float | None, lane_width: float
) -> list[tuple[str, str]]:
    """Return facts about a fresh or a recorded drive as labels and texts."""
    facts = []
    if result.moobd is not None and result.moobd_distance is not None:
        facts += [
            (
                "MOOBD",
                f"{result.moobd:.3f} m, at {result.moobd_distance:.1f} m: the car's centre"
                f" {'was' if result.moobd < 0.0 else 'stayed'}"
                f" {lane_words(result.moobd, lane_width)}",
            ),
            ("oob share", f"{result.max_oob_share:.0%} at most"),
        ]
    if duration is not None:
        facts.append(("time", f"{duration:.2f} s"))
    if result.fault is not None:
        facts.append(("fault", f"the {result.fault.part} {result.fault}"))
    findings = () if result.departure is None else result.findings  # else the reason names them
    for finding in findings:
        if finding.criterion not in (LANE, DRIVER):
            measure = signal_named(finding.criterion)
            side = f" to the {finding.side}" if finding.side else ""
            text = f"{measure.words} {measure.text(finding.value)}{side}"
            where = f"at {finding.distance:.1f} m and {finding.time:.2f} s"
            facts.append(("exceeded", f"{text} {where}, the limit is {finding.limit:g}"))
    place = result.departure
    if place is not None:
        facts.append(
            (
                "left lane",
                f"to the {place.side} after {place.distance:.1f} m and {place.time:.2f} s,"
                f" at ({place.x:.1f}, {place.y:.1f})",
            )
        )
    return facts


def print_measures(rows: Sequence[Mapping[str, Any]], criteria: CriteriaSet) -> None:
    """Print the signals of a drive with the limits of its criteria."""
    if not rows:
        return
    print_table(
        ("signal", ">worst", "", "where", f">{criteria.name}", ""),
        [
            (
                row["signal"].replace("_", " "),
                f"{round(row['value'], 2) + 0.0:.2f}",
                row["unit"],
                f"{row['distance']:.0f} m{f', {side}' if (side := row['side']) else ''}",
                None if row["limit"] is None else f"{row['limit']:g}",
                {None: "", True: "kept", False: "exceeded"}[row["kept"]],
            )
            for row in rows
        ],
    )


def print_facts(facts: Sequence[tuple[str, str]]) -> None:
    """Print labels and texts, one pair a line; an empty text is left out."""
    facts = [(name, value) for name, value in facts if value]
    width = max([10, *(len(name) for name, _ in facts)]) + 1
    for name, value in facts:
        line = value.replace("\n", "\\x0a")  # a text from elsewhere stays on its line
        echo(f"{name:<{width}}{line}")


def this_command() -> Invocation:
    """Return the present command line, whose text is for pasting into a shell."""
    return click.get_current_context().find_root().ensure_object(Invocation)


def shell(path: Path | str) -> str:
    """Return a path or word for pasting into a shell."""
    import shlex

    text = str(path)
    return f'"{text}"' if sys.platform == "win32" and " " in text else shlex.quote(text)
