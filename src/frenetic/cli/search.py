"""Shared parts of the commands that search: run, resume."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import ExitStack, chdir, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

import click

from frenetic._support.words import counted, format_duration, rate_words
from frenetic.cli import echo
from frenetic.cli.console import Log, announced_compilation, live_progress, shell, this_command
from frenetic.cli.failure_tables import (
    causes_json,
    clusters_json,
    first_error,
    print_causes,
    print_failures,
)
from frenetic.cli.options import as_usage_error
from frenetic.errors import BrokenDriverError, CampaignError, CampaignGoneError

if TYPE_CHECKING:
    from frenetic.campaign import Campaign, Event, Summary
    from frenetic.report.results import Results, Step
    from frenetic.spec import Spec

fail_on_failure_option = click.option(
    "--fail-on-failure",
    is_flag=True,
    help="End with exit code 1 if a test failed or the simulator broke, for CI.",
)


def make_campaign(spec: Spec, folder: Path, place: Path) -> Campaign:
    """Return the campaign of a command line.

    Args:
        spec: of the campaign.
        folder: for its results.
        place: folder from which its parts are loaded.

    Raises:
        click.UsageError: the options are out of range.
    """
    from frenetic.campaign import Campaign

    with announced_compilation(Log()), as_usage_error(), chdir(place):
        return Campaign.of(spec, folder=folder, isolate=True)


def _resume_words(folder: Path) -> str:
    """Return the command line that goes on with the campaign of the present one."""
    workers: Spec | None = click.get_current_context().params["workers"]
    option = "" if workers is None else f" --workers {shell(str(workers.workers))}"
    return f"frenetic resume {shell(folder)}{option}"


def search(
    campaign: Campaign,
    run_search: Callable[..., Results],
    announcement: str,
    as_json: bool,
    seed: object,
    *,
    fail_on_failure: bool = False,
) -> None:
    """Run a campaign, and show its progress and results.

    Args:
        campaign: the campaign.
        run_search: `frenetic.report.results.run` or `resume`.
        announcement: the first line.
        as_json: whether to print the result as JSON.
        seed: of the strategy.
        fail_on_failure: whether the exit code is 1 if a test failed or the simulator broke.
    """
    printer = _Printer(campaign, announcement, as_json, seed)
    try:
        with printer:
            summary = run_search(campaign, on_event=printer.on_event).summary
        assert summary is not None
    except CampaignError as error:
        if not campaign.started:
            raise
        if isinstance(error, CampaignGoneError):
            if error.place is None:
                raise
            raise CampaignError(f"{error}: {_resume_words(error.place)}") from error
        words = f"go on: {_resume_words(campaign.folder)}"
        if isinstance(error, BrokenDriverError):
            words = f"mend it, then {campaign.next_campaign()}"
        raise CampaignError(f"{error}; {words}") from error
    except KeyboardInterrupt:  # before or after the search, which itself ends in order
        if not campaign.started:
            raise
        echo(f"frenetic: interrupted; go on: {_resume_words(campaign.folder)}", err=True)
        raise click.exceptions.Exit(130) from None
    printer.end()
    if summary.interrupted:
        raise click.exceptions.Exit(130)
    if fail_on_failure and (summary.failed or summary.errors):
        raise click.exceptions.Exit(1)
    if not summary.passed + summary.failed:
        raise click.exceptions.Exit(1)


class _Printer:
    """Prints the events of a search, and each result as soon as it exists.

    Args:
        campaign: the campaign.
        announcement: the first line.
        as_json: whether to print the result as JSON.
        seed: of the strategy.
    """

    def __init__(self, campaign: Campaign, announcement: str, as_json: bool, seed: object) -> None:
        self._campaign, self._announcement = campaign, announcement
        self._as_json, self._seed = as_json, seed
        self._log, self._command = Log(), this_command()
        self._searching, self._working = ExitStack(), ExitStack()
        self._not_repeatable = ""
        self._started: tuple[float, float] | None = None  # s to start, s of earlier commands
        self._search_times = self._shortening = ""
        self._began = 0.0  # when the present step began, in s of the command

    def __enter__(self) -> None:
        self._compiled = self._searching.enter_context(announced_compilation(self._log))
        self._show = self._searching.enter_context(live_progress(self._log))
        self._searching.enter_context(redirect_stdout(sys.stderr))  # a strategy's prints, say

    def __exit__(self, *error: object) -> None:
        self._working.close()
        self._searching.close()

    def on_event(self, event: Event | Step) -> None:
        """Show an event of the search, or a step after it."""
        from frenetic.report.results import Step  # too slow for help

        if isinstance(event, Step):
            self._on_step(event)
            return
        if event.summary.not_repeatable != self._not_repeatable:
            self._not_repeatable = event.summary.not_repeatable
            self._log.print(f"Note: {self._not_repeatable}", markup=False)
        if event.kind == "interrupted":
            self._log.stopping()
        elif event.kind == "result":
            self._show(event.summary)
        else:
            self._compiled()
            self._started = self._command.seconds, event.summary.seconds
            self._log.print(
                f"{self._announcement}, results in {self._campaign.folder}", markup=False
            )
            for note in self._campaign.notes:
                self._log.print(f"Note: {note}", markup=False)

    def _on_step(self, step: Step) -> None:
        self._working.close()
        self._working = ExitStack()
        if self._search_times == "":
            self._searching.close()
            self._search_times = _search_times(self._command.seconds, self._started)
        results = step.results
        match step.kind:
            case "shortening":
                limit = f"{step.seconds:.0f} s at most"
                self._begin(f"Shortening a failing road of each cause, for {limit}")
                self._shortening = "began"
            case "found":
                self._shortening = self._taken() if self._shortening else ""
                self._print_found(results)
            case "drawing":
                self._begin("Drawing them")
            case "drawn":
                self._print_drawn(results, self._taken())
            case "reporting":
                self._begin("Writing the report")
            case "reported" if results.report is None:
                self._log.print(results.notes[-1], markup=False)
            case "reported":
                self._say(f"Report:      {results.report} (in {self._taken()})")

    def end(self) -> None:
        """Print the last line."""
        self._say(f"In all:      {format_duration(self._command.seconds)}")

    def _begin(self, text: str) -> None:
        self._began = self._command.seconds
        self._working.enter_context(self._log.status(text))

    def _taken(self) -> str:
        """Return the time that the present step took."""
        return format_duration(self._command.seconds - self._began)

    def _say(self, text: str) -> None:
        """Print a line of the result, unless the result is printed as JSON."""
        if not self._as_json:
            echo(text)

    def _print_found(self, results: Results) -> None:
        """Print counts, causes or near misses, notes and the next command."""
        from frenetic.campaign import CampaignStore
        from frenetic.campaign.objective_values import worst_criterion_text
        from frenetic.campaign.warm_start import still_failing

        summary, findings, folder = results.summary, results.findings, results.folder
        misses, counts = findings.misses, findings.counts
        if summary is not None and self._as_json:
            more = {
                "distinct_failures": len(findings.clusters),
                "causes": causes_json(findings.clusters, results.shortened),
                "near_misses": [] if misses is None else clusters_json(misses),
                "notes": list(results.notes),
                "seed": self._seed,
            }
            echo(json.dumps(summary.as_json() | more))
        elif not self._as_json:
            with CampaignStore.open(folder) as store:
                if summary is not None:
                    worst, failing = worst_criterion_text(store), still_failing(store)
                    error = first_error(store)
                    _print_summary(summary, self._search_times, worst, error, failing)
                if misses is None:
                    print_causes(findings.clusters, counts, results.shortened)
                else:
                    print_failures(misses, counts, len(findings.listed), store.lane_width)
            for note in results.notes:
                echo(f"Note: {note}")
        if summary is None:
            return
        go_on = _next_command(folder, summary, is_clean=misses is not None)
        if go_on and (summary.interrupted or not self._as_json):
            echo(f"Go on:       {go_on}", err=self._as_json)
        self._say(f"Results:     {folder}")
        if self._shortening:
            roads = counted(len(results.shortened), "failing road")
            self._say(f"Shortened:   {roads} (in {self._shortening})")

    def _print_drawn(self, results: Results, taken: str) -> None:
        """Print where the pictures are, and how to look closer."""
        from frenetic.report.minimised import minimised_road

        folder, first = results.folder, results.findings.listed[0].id
        self._say(f"At a glance: {results.gallery} (in {taken})")
        self._say(f"Look closer: frenetic show {shell(folder)} {first}")
        if first in results.shortened:
            self._say(f"Drive it:    frenetic drive {shell(minimised_road(folder, first))}")


def _search_times(seconds: float, started: tuple[float, float] | None) -> str:
    """Return the time that the user waited for a search, and the part before the first drive.

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
    """Return the command that goes on with a search; empty if it ended with failures."""
    if summary.interrupted:
        return _resume_words(folder)
    if is_clean and summary.tests and not summary.ended:
        return f"frenetic resume {shell(folder)} --simulations {9 * summary.simulations}"
    return ""


def _print_summary(summary: Summary, times: str, worst: str, error: str, failing: str) -> None:
    from frenetic.campaign.summary import facts_text

    stopped = "Interrupted: " if summary.interrupted else ""
    echo(
        f"{stopped}{counted(summary.simulations, 'simulation')} in"
        f" {times}, {rate_words(summary.tests_per_second)}"
        f"{summary.worst_as_text}{worst}"
    )
    echo(summary.as_text())
    if summary.slow_driver_text:
        echo(summary.slow_driver_text)
    if failing:
        echo(failing)
    if metrics := facts_text(summary.facts):
        echo(f"Search:      {metrics}")
    if error:
        echo(f"The first error: {error}")
    if summary.ended:
        echo(f"The strategy ended the search: {summary.ended}")
    if summary.not_repeatable:
        echo(f"Note:        {summary.not_repeatable}")
    if summary.notice:
        echo(f"Note:        {summary.notice}")
