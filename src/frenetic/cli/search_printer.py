"""Printing of a search: its progress, its results, and the command that continues it."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Final

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

if TYPE_CHECKING:
    from frenetic.campaign import Campaign, Event, Summary
    from frenetic.report.results import Results, Step
    from frenetic.spec import Spec

_MORE_DRIVES_FACTOR: Final = 9
"""Advised number of further drives after a search without failures, as a multiple of its drives:
ten times as many in all (our choice)."""


def resume_command(folder: Path) -> str:
    """Return the command line that resumes the campaign of the present command."""
    workers: Spec | None = click.get_current_context().params["workers"]
    option = "" if workers is None else f" --workers {shell(str(workers.workers))}"
    return f"frenetic resume {shell(folder)}{option}"


class SearchPrinter:
    """A printer of a search's events, and of its results as soon as they exist.

    Args:
        campaign: the campaign.
        announcement: the first line that is printed.
        seed: seed of the strategy, for the JSON.
        as_json: whether to print the result as JSON.
    """

    def __init__(
        self, campaign: Campaign, announcement: str, seed: object, *, as_json: bool
    ) -> None:
        self._campaign, self._announcement = campaign, announcement
        self._as_json, self._seed = as_json, seed
        self._log, self._command = Log(), this_command()
        self._search_display, self._step_display = ExitStack(), ExitStack()
        self._not_repeatable = ""
        """Note why the search does not repeat, once it was printed."""
        self._start_seconds: tuple[float, float] | None = None
        """Seconds until the first drive, and seconds of earlier commands' searches; None before."""
        self._search_times = ""
        """Text about the time of the search; empty until it has ended."""
        self._shortening_time = ""
        """Time in which failing roads were shortened; empty without this step."""
        self._is_shortening = False
        self._step_began = 0.0
        """Time at which the present step began, in s since the command began."""

    def __enter__(self) -> None:
        display = self._search_display
        self._end_announcement = display.enter_context(announced_compilation(self._log))
        self._show_progress = display.enter_context(live_progress(self._log))
        display.enter_context(redirect_stdout(sys.stderr))  # for what a strategy prints

    def __exit__(self, *error: object) -> None:
        self._step_display.close()
        self._search_display.close()

    def on_event(self, event: Event | Step) -> None:
        """Show an event of the search, or a step after it."""
        from frenetic.report.results import Step  # imports too slowly for --help

        if isinstance(event, Step):
            self._on_step(event)
            return
        if event.summary.not_repeatable != self._not_repeatable:
            self._not_repeatable = event.summary.not_repeatable
            self._log.print(f"Note: {self._not_repeatable}", markup=False)
        if event.kind == "interrupted":
            self._log.stopping()
        elif event.kind == "result":
            self._show_progress(event.summary)
        else:
            self._end_announcement()
            self._start_seconds = self._command.seconds, event.summary.seconds
            self._log.print(
                f"{self._announcement}, results in {self._campaign.folder}", markup=False
            )
            for note in self._campaign.notes:
                self._log.print(f"Note: {note}", markup=False)

    def _on_step(self, step: Step) -> None:
        """Show a step after the search: it begins, or its results exist."""
        self._step_display.close()
        self._step_display = ExitStack()
        if not self._search_times:  # the first step after the search
            self._search_display.close()
            self._search_times = _search_times(self._command.seconds, self._start_seconds)
        results = step.results
        match step.kind:
            case "trying":
                self._begin_step("Trying the causes")
            case "shortening":
                limit = f"{step.seconds:.0f} s at most"
                self._begin_step(f"Shortening a failing road of each cause, for {limit}")
                self._is_shortening = True
            case "found":
                self._shortening_time = self._step_time() if self._is_shortening else ""
                self._print_findings(results)
            case "drawing":
                self._begin_step("Drawing them")
            case "drawn":
                self._print_pictures(results)
            case "reporting":
                self._begin_step("Writing the report")
            case "reported" if results.report is None:
                self._log.print(results.notes[-1], markup=False)
            case "reported":
                self._print_text(f"Report:      {results.report} (in {self._step_time()})")

    def print_total_time(self) -> None:
        """Print the last line: the time that the command took."""
        self._print_text(f"In all:      {format_duration(self._command.seconds)}")

    def _begin_step(self, text: str) -> None:
        """Show a text on the terminal until the next step."""
        self._step_began = self._command.seconds
        self._step_display.enter_context(self._log.status(text))

    def _step_time(self) -> str:
        """Return the time since the present step began."""
        return format_duration(self._command.seconds - self._step_began)

    def _print_text(self, text: str) -> None:
        """Print a line of the result, unless the result is printed as JSON."""
        if not self._as_json:
            echo(text)

    def _print_findings(self, results: Results) -> None:
        """Print counts, causes or near misses, notes and the next command."""
        from frenetic.campaign import CampaignStore
        from frenetic.campaign.objective_values import worst_criterion_text
        from frenetic.campaign.warm_start import still_failing

        summary, findings, folder = results.summary, results.findings, results.folder
        misses, counts = findings.misses, findings.counts
        if summary is not None and self._as_json:
            findings_json = {
                "distinct_failures": len(findings.clusters),
                "causes": causes_json(results.causes, results.shortened),
                "near_misses": [] if misses is None else clusters_json(misses),
                "notes": list(results.notes),
                "seed": self._seed,
            }
            echo(json.dumps(summary.as_json() | findings_json))
        elif not self._as_json:
            with CampaignStore.open(folder) as store:
                if summary is not None:
                    _print_summary(
                        summary,
                        self._search_times,
                        worst=worst_criterion_text(store),
                        first_error=first_error(store),
                        still_failing=still_failing(store),
                    )
                if misses is None:
                    print_causes(results.causes, findings.clusters, counts, results.shortened)
                else:
                    print_failures(misses, counts, len(findings.listed), store.lane_width)
            for note in results.notes:
                echo(f"Note: {note}")
        if summary is None:
            return
        next_command = _next_command(folder, summary, has_failures=misses is None)
        if next_command and (summary.interrupted or not self._as_json):
            echo(f"Go on:       {next_command}", err=self._as_json)
        self._print_text(f"Results:     {folder}")
        if self._shortening_time:
            roads = counted(len(results.shortened), "failing road")
            self._print_text(f"Shortened:   {roads} (in {self._shortening_time})")

    def _print_pictures(self, results: Results) -> None:
        """Print where the pictures are, and how to look closer."""
        from frenetic.rerun.minimised_roads import minimised_road

        folder, test_id = results.folder, results.findings.listed[0].id
        self._print_text(f"At a glance: {results.gallery} (in {self._step_time()})")
        self._print_text(f"Look closer: frenetic show {shell(folder)} {test_id}")
        if test_id in results.shortened:
            road = minimised_road(folder, test_id)
            self._print_text(f"Drive it:    frenetic drive {shell(road)}")


def _search_times(seconds: float, start_seconds: tuple[float, float] | None) -> str:
    """Return the time that the user waited for a search, and the part before the first drive.

    Args:
        seconds: time since the command began, in s.
        start_seconds: time in s until the first drive, and time in s of earlier commands' searches;
            None if the search did not start.
    """
    if start_seconds is None:
        return format_duration(seconds)
    until_first_drive, earlier = start_seconds
    total = format_duration(seconds + earlier)
    return f"{total}, {format_duration(until_first_drive)} of it to start"


def _next_command(folder: Path, summary: Summary, *, has_failures: bool) -> str:
    """Return the command that continues a search; empty if it ended with failures."""
    if summary.interrupted:
        return resume_command(folder)
    if not has_failures and summary.tests and not summary.ended:
        drives = _MORE_DRIVES_FACTOR * summary.simulations
        return f"frenetic resume {shell(folder)} --simulations {drives}"
    return ""


def _print_summary(
    summary: Summary, times: str, *, worst: str, first_error: str, still_failing: str
) -> None:
    """Print the counts of a search, and what its user has to know about it.

    Args:
        summary: summary of the search.
        times: text about its time.
        worst: text about the criterion that came nearest to its limit; empty without criteria.
        first_error: reason of the first test in which the simulator broke; empty without one.
        still_failing: text about earlier failures that were driven again; empty without.
    """
    from frenetic.campaign.summary import facts_text

    stopped = "Interrupted: " if summary.interrupted else ""
    echo(
        f"{stopped}{counted(summary.simulations, 'simulation')} in"
        f" {times}, {rate_words(summary.tests_per_second)}"
        f"{summary.worst_as_text()}{worst}"
    )
    echo(summary.as_text())
    if slow_driver_text := summary.slow_driver_text():
        echo(slow_driver_text)
    if still_failing:
        echo(still_failing)
    if metrics := facts_text(summary.facts):
        echo(f"Search:      {metrics}")
    if first_error:
        echo(f"The first error: {first_error}")
    if summary.ended:
        echo(f"The strategy ended the search: {summary.ended}")
    if summary.not_repeatable:
        echo(f"Note:        {summary.not_repeatable}")
    if summary.notice:
        echo(f"Note:        {summary.notice}")
