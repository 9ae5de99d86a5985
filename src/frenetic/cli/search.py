"""What run and resume share: making a campaign, and searching with it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING

import click

from frenetic.cli import INTERRUPTED, echo
from frenetic.cli.console import Log, announced_compilation
from frenetic.cli.options import as_usage_error
from frenetic.cli.search_printer import SearchPrinter, resume_command
from frenetic.errors import BrokenDriverError, CampaignError, CampaignGoneError

if TYPE_CHECKING:
    from frenetic.campaign import Campaign
    from frenetic.report.results import Results
    from frenetic.spec import Spec

fail_on_failure_option = click.option(
    "--fail-on-failure",
    is_flag=True,
    help="Exit code 1 if a test failed or the simulator broke.",
)


def make_campaign(spec: Spec, folder: Path, code_folder: Path) -> Campaign:
    """Return the campaign of a command line.

    Args:
        spec: spec of the campaign.
        folder: folder for its results.
        code_folder: folder from which its parts are loaded.

    Raises:
        click.UsageError: an option is out of range.
    """
    from frenetic.campaign import Campaign

    with announced_compilation(Log()), as_usage_error(), chdir(code_folder):
        return Campaign.of(spec, folder=folder, isolate=True)


def search(
    campaign: Campaign,
    run_search: Callable[..., Results],
    *,
    announcement: str,
    seed: object,
    as_json: bool,
    fail_on_failure: bool,
) -> None:
    """Run a campaign, and show its progress and results.

    Args:
        campaign: the campaign.
        run_search: `frenetic.report.results.run` or `resume`.
        announcement: the first line that is printed.
        seed: seed of the strategy, for the JSON.
        as_json: whether to print the result as JSON.
        fail_on_failure: whether the exit code is 1 if a test failed or the simulator broke.

    Raises:
        CampaignError: the campaign cannot start or go on; the message says how to continue.
        click.exceptions.Exit: the search was interrupted (130), no drive was judged, or
            `fail_on_failure` says so (1).
    """
    printer = SearchPrinter(campaign, announcement, seed, as_json=as_json)
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
            raise CampaignError(f"{error}: {resume_command(error.place)}") from error
        advice = f"go on: {resume_command(campaign.folder)}"
        if isinstance(error, BrokenDriverError):
            advice = f"mend it, then {campaign.next_campaign()}"
        raise CampaignError(f"{error}; {advice}") from error
    except KeyboardInterrupt:  # before or after the search, which itself ends in order
        if not campaign.started:
            raise
        echo(f"frenetic: interrupted; go on: {resume_command(campaign.folder)}", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None
    printer.print_total_time()
    if summary.interrupted:
        raise click.exceptions.Exit(INTERRUPTED)
    is_judged = summary.passed + summary.failed > 0
    if not is_judged or (fail_on_failure and (summary.failed or summary.errors)):
        raise click.exceptions.Exit(1)
