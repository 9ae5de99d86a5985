"""Shared parts of the commands that search: run, resume."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from frenetic._support.words import counted, format_duration, rate_words
from frenetic.cli import echo
from frenetic.cli.console import (
    Log,
    announced_compilation,
    causes_json,
    clusters_json,
    first_error,
    live_progress,
    print_causes,
    print_failures,
    shell,
    this_command,
)
from frenetic.cli.options import Read, as_usage_error, read_workers
from frenetic.errors import BrokenDriverError, CampaignError, CampaignGoneError, FreneticError

if TYPE_CHECKING:
    from frenetic.analysis import Clusters
    from frenetic.campaign import Campaign, CampaignStore, Event, Summary
    from frenetic.report.html.campaign import Reading
    from frenetic.spec import Spec

SLOW: Final = 0.5
"""Wall time of a drive in s above which `run` shortens no failing roads."""
SHARE: Final = 3
"""Drives of a search for each one that shortens failing roads afterwards, and s of wall time."""
LEAST_TIME: Final = 30.0
"""Wall time in s that shortening may take, however short the search was."""

workers_option = click.option(
    "--workers",
    type=Read("n|address", read_workers),
    help="Drive on N roads at once, or on a Dask cluster, tcp://10.0.0.1:8786."
    " [default: the cores, or 1]",
)
fail_on_failure_option = click.option(
    "--fail-on-failure",
    is_flag=True,
    help="End with exit code 1 if a test failed or the simulator broke, for CI.",
)


def make_campaign(spec: Spec, folder: Path, workers: int | str | None) -> Campaign:
    """The campaign of a command line.

    Raises:
        click.UsageError: the options are out of range.
    """
    from frenetic.campaign import Campaign

    with announced_compilation(Log()), as_usage_error():
        return Campaign.of(
            spec,
            folder=folder,
            workers=None if isinstance(workers, str) else workers,
            cluster=workers if isinstance(workers, str) else None,
            isolate=True,
        )


def is_finished(folder: Path, facts: Mapping[str, object]) -> bool:
    """Whether a campaign with these facts has ended and has its report."""
    from frenetic.report.html import REPORT

    return "finished_at" in facts and (folder / REPORT).is_file()


def _resume_words(folder: Path) -> str:
    """The command line that goes on with what the present one began."""
    workers = click.get_current_context().params["workers"]
    given = "" if workers is None else f" --workers {shell(str(workers))}"
    return f"frenetic resume {shell(folder)}{given}"


def search(
    campaign: Campaign,
    how: Callable[..., Summary],
    announcement: str,
    as_json: bool,
    seed: object,
    *,
    fail_on_failure: bool = False,
) -> None:
    """Runs a campaign, and shows its progress and failures.

    Args:
        campaign: the campaign.
        how: its `run` or `resume`.
        announcement: the first line.
        as_json: whether to print the result as JSON.
        seed: of the strategy.
        fail_on_failure: whether the exit code is 1 if a test failed or the simulator broke.
    """
    try:
        _search(campaign, how, announcement, as_json, seed, fail_on_failure)
    except KeyboardInterrupt:  # beside the search, which ends in order
        if not campaign.started:
            raise
        echo(f"frenetic: interrupted; go on: {_resume_words(campaign.folder)}", err=True)
        raise click.exceptions.Exit(130) from None


def _search(
    campaign: Campaign,
    how: Callable[..., Summary],
    announcement: str,
    as_json: bool,
    seed: object,
    fail_on_failure: bool,
) -> None:
    """Run a campaign as `search` does; Ctrl-C beside the search is raised."""
    from frenetic.analysis.failures import caution, representative_failures
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.earlier import still_failing
    from frenetic.campaign.objective import worst_criterion
    from frenetic.report.failures import FAILURES, GALLERY, write_failures
    from frenetic.report.html.campaign import Reading
    from frenetic.report.minimised import minimised_drives, minimised_road

    folder = campaign.folder
    log, command = Log(), this_command()
    started: tuple[float, float] | None = None  # time to start, and that of earlier commands
    trouble: FreneticError | None = None
    summary: Summary | None = None
    with announced_compilation(log) as compiled, live_progress(log) as show:
        told = ""

        def on_event(event: Event) -> None:
            nonlocal told, started
            if event.summary.not_repeatable != told:
                told = event.summary.not_repeatable
                log.print(f"Note: {told}", markup=False)
            if event.kind == "interrupted":
                log.stopping()
            elif event.kind == "result":
                show(event.summary)
            else:
                compiled()
                started = command.seconds, event.summary.seconds
                log.print(f"{announcement}, results in {folder}", markup=False)
                for note in campaign.notes:
                    log.print(f"Note: {note}", markup=False)

        try:
            with redirect_stdout(sys.stderr):  # a strategy's prints, say
                summary = how(on_event=on_event)
        except CampaignError as error:
            # Show what was stored until then.
            if not campaign.started:
                raise
            trouble = error
    times = _search_times(command.seconds, started)
    with _after(trouble, campaign), CampaignStore.open(folder) as store:
        reading = Reading.of(store)
        clusters, misses, counts = reading.clusters, reading.misses, reading.counts
        found = clusters if misses is None else misses
        listed = representative_failures(store, clusters=found)
        notes, is_shortened = list(filter(None, [caution(store)])), False
        before = command.seconds
        if summary is not None and len(clusters):
            is_shortened, more_notes = _minimise(campaign, clusters, summary, log)
            notes += more_notes
        shortening = format_duration(command.seconds - before)
        shortened = minimised_drives(store, [test.id for test in listed])
        if summary is not None and as_json:
            more = {
                "distinct_failures": len(clusters),
                "causes": causes_json(clusters, shortened),
                "near_misses": [] if counts.failed else clusters_json(found),
                "notes": notes,
                "seed": seed,
            }
            echo(json.dumps(summary.as_json() | more))
        elif summary is not None:
            worst = worst_criterion(store)
            _print_summary(summary, times, worst, first_error(store), still_failing(store))
        if not as_json:
            if misses is None:
                print_causes(clusters, counts, shortened)
            else:
                print_failures(misses, counts, len(listed), store.lane_width)
            for note in notes:
                echo(f"Note: {note}")
        go_on = (
            None if summary is None else _next_command(folder, summary, is_clean=misses is not None)
        )
        if summary is not None and go_on and (summary.interrupted or not as_json):
            echo(f"Go on:       {go_on}", err=as_json)
        if summary is not None and not as_json:
            echo(f"Results:     {folder}")
            if is_shortened:
                roads = counted(len(shortened), "failing road")
                echo(f"Shortened:   {roads} (in {shortening})")
        if listed:
            failures = [test for test, _ in reading.failures.values()]
            before = command.seconds
            with log.status("Drawing them"):
                write_failures(store, failures, listed, shortened)
            drawing = format_duration(command.seconds - before)
            if not as_json:
                echo(f"At a glance: {folder / FAILURES / GALLERY} (in {drawing})")
                echo(f"Look closer: frenetic show {shell(folder)} {listed[0].candidate.id}")
            if not as_json and listed[0].id in shortened:
                road = minimised_road(folder, listed[0].id)
                echo(f"Drive it:    frenetic drive {shell(road)}")
        before = command.seconds
        report = _write_report(log, store, reading) if counts.tests else None
        writing = format_duration(command.seconds - before)
        if report is not None and not as_json:
            echo(f"Report:      {report} (in {writing})")
        if summary is not None and not as_json:
            echo(f"In all:      {format_duration(command.seconds)}")
    if summary is not None and summary.interrupted:
        raise click.exceptions.Exit(130)
    if summary is not None and fail_on_failure and (summary.failed or summary.errors):
        raise click.exceptions.Exit(1)
    if summary is not None and not summary.passed + summary.failed:
        raise click.exceptions.Exit(1)


def _search_times(seconds: float, started: tuple[float, float] | None) -> str:
    """The time of a search as its user waited for it, and the part before the first drive.

    Args:
        seconds: since the command began, in s.
        started: s that the command took to start, and s that earlier commands searched; None if it
            did not start.
    """
    if started is None:
        return format_duration(seconds)
    start, earlier = started
    return f"{format_duration(seconds + earlier)}, {format_duration(start)} of it to start"


def _next_command(folder: Path, summary: Summary, *, is_clean: bool) -> str:
    """The command that goes on with a search; empty if it has ended with failures."""
    if summary.interrupted:
        return _resume_words(folder)
    if is_clean and summary.tests and not summary.ended:
        return f"frenetic resume {shell(folder)} --simulations {9 * summary.simulations}"
    return ""


def _minimise(
    campaign: Campaign, clusters: Clusters, summary: Summary, log: Log
) -> tuple[bool, list[str]]:
    """Minimise a failure of each cause; return whether, and what the user should know of it."""
    if summary.interrupted or summary.not_repeatable:
        return False, []
    if (
        campaign.cluster is not None
        or summary.seconds * campaign.workers > SLOW * summary.simulations
    ):
        command = f"frenetic minimise {shell(campaign.folder)} --top 3"
        return False, [f"shorter roads for the same failures: {command}"]
    return True, list(_minimised(campaign, clusters, summary, log))


def _minimised(campaign: Campaign, clusters: Clusters, summary: Summary, log: Log) -> Iterator[str]:
    """Minimises a failure of each cause; gives what the user should know of it."""
    from frenetic.again.minimise import minimise_causes
    from frenetic.report.minimised import (
        MinimisedFiles,
        minimised_document,
        minimised_road,
        write_minimised,
    )

    folder, tester = campaign.folder, campaign.tester
    drives, seconds = summary.simulations // SHARE, max(LEAST_TIME, summary.seconds / SHARE)
    text = f"Shortening a failing road of each cause, for {seconds:.0f} s at most"
    with log.status(text):
        for test_id, found in minimise_causes(folder, clusters, tester, drives, seconds):
            if isinstance(found, FreneticError):
                yield f"test {test_id} was not shortened: {found}"
                continue
            try:
                files = MinimisedFiles.beside(minimised_road(folder, test_id))
                files.prepare()
                document = minimised_document(found, tester, campaign.spec(), test_id)
                write_minimised(found, files, document, name=f"Test {test_id}", is_compared=False)
            except FreneticError as error:
                yield str(error)
                return
            if found.ending == "stopped" and found.trouble is None:
                command = f"frenetic minimise {shell(folder)} --top 3"
                yield f"shortening was interrupted; go on: {command}"


@contextmanager
def _after(trouble: FreneticError | None, campaign: Campaign) -> Iterator[None]:
    """Shows what there is after a trouble; then raises that, with the command that goes on.

    What cannot be shown for the same reason, such as a full disk, is left out.
    """
    if trouble is None:
        yield
        return
    with suppress(FreneticError, OSError):
        yield
    if isinstance(trouble, CampaignGoneError):
        if trouble.place is None:
            raise trouble
        raise CampaignError(f"{trouble}: {_resume_words(trouble.place)}") from trouble
    words = f"go on: {_resume_words(campaign.folder)}"
    if isinstance(trouble, BrokenDriverError):
        words = f"mend it, then {campaign.next_campaign()}"
    raise CampaignError(f"{trouble}; {words}") from trouble


def _write_report(log: Log, store: CampaignStore, reading: Reading) -> Path | None:
    """Writes the report; None if that failed, which loses nothing else."""
    from frenetic.report.html import write_report

    try:
        with log.status("Writing the report"):
            return write_report(store, reading=reading)
    except FreneticError as error:
        log.print(f"There is no report: {error}", markup=False)
        return None


def _print_summary(summary: Summary, times: str, worst: str, error: str, known: str) -> None:
    from frenetic.campaign.summary import facts_in_words

    stopped = "Interrupted: " if summary.interrupted else ""
    echo(
        f"{stopped}{counted(summary.simulations, 'simulation')} in"
        f" {times}, {rate_words(summary.tests_per_second)}"
        f"{summary.worst_in_words}{worst}"
    )
    echo(summary.in_words())
    if summary.slow_driver:
        echo(summary.slow_driver)
    if known:
        echo(known)
    if told := facts_in_words(summary.facts):
        echo(f"Search:      {told}")
    if error:
        echo(f"The first error: {error}")
    if summary.ended:
        echo(f"The strategy ended the search: {summary.ended}")
    if summary.not_repeatable:
        echo(f"Note:        {summary.not_repeatable}")
    if summary.notice:
        echo(f"Note:        {summary.notice}")
