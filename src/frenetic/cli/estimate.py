"""The command `estimate`: how often a driver fails in a domain."""

from __future__ import annotations

import json
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted
from frenetic.cli import Invocation, echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, shell, this_command
from frenetic.cli.entries import entry_option, part_options, trust_option
from frenetic.cli.options import (
    count_option,
    folder_option,
    json_option,
    workers_option,
)

if TYPE_CHECKING:
    from frenetic.campaign import Event, RoadTester, Summary
    from frenetic.rerun.estimate import FailureRate


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path), required=False)
@entry_option("odd")
@part_options
@entry_option("criteria")
@trust_option
@count_option("--drives", "Drive N times.", least=100, default=10_000)
@workers_option
@folder_option(
    "Folder for the drives. [default: a folder in rerun/ of the CAMPAIGN, or a new one under"
    " campaigns/]"
)
@json_option
@click.pass_context
def estimate(
    context: click.Context,
    /,
    campaign: Path | None,
    drives: int,
    workers: int,
    out: Path | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Say how often a driver leaves its lane in a domain, per 1,000 km.

    The domain is --odd FILE, or a CAMPAIGN's domain. A CAMPAIGN's own driver drives, and its report
    shows the estimate, too. Common failures are counted in plain drives, in conditions as they
    occur. For rare failures, conditions in which the driver fails are drawn more often, and each
    failure in them counts less (importance sampling). A search's failures are not counted. Run the
    same command again to continue after Ctrl-C; when all drives are made, it only prints the
    estimate. Without a CAMPAIGN this needs --out DIR.
    """
    from frenetic.cli.rerun_options import shown_driving, tester_of_options
    from frenetic.rerun.estimate import estimate as estimate_failure_rate

    options = CommandOptions.of(context)
    if campaign is None and not options.says("odd"):
        raise click.UsageError("--odd FILE or the folder of a CAMPAIGN with a domain is needed")
    if campaign is not None and options:
        raise click.UsageError(
            f"{campaign} is driven as before: leave out the options that change how roads are"
            " driven, or give --odd FILE without a campaign"
        )
    tester = tester_of_options(options) if campaign is None else _tester_of(campaign, options)
    log = Log()
    # The summary of the last event; an estimate whose drives are all made sends one event, too.
    latest: deque[Summary] = deque(maxlen=1)
    try:
        with shown_driving(log, "Driving") as show:

            def on_event(event: Event) -> None:
                latest.append(event.summary)
                show(event)

            result = estimate_failure_rate(
                tester,
                drives=drives,
                campaign=campaign,
                workers=workers,
                isolate=True,
                out=out,
                on_event=on_event,
            )
    except KeyboardInterrupt:
        if not latest:  # no event came, so there is no folder to name
            raise
        is_new_folder = campaign is None and out is None
        raise _interrupted(log, latest[-1], drives, is_new_folder=is_new_folder) from None
    folder = latest[-1].folder
    where_to_see = f"Kept in {folder}; to see it: frenetic report {shell(campaign or folder)}"
    if as_json:
        echo(json.dumps(result.as_json()))
        log.print(where_to_see, markup=False)
        return
    _print(result)
    echo(where_to_see)


def _interrupted(
    log: Log, summary: Summary, drives: int, *, is_new_folder: bool
) -> click.exceptions.Exit:
    """Print what is left to do after Ctrl-C, and which command continues; return the exit.

    Args:
        log: the console for progress.
        summary: summary of the campaign that drives.
        drives: number of drives that the estimate needs.
        is_new_folder: whether this command made a new folder, which the next command has to name.
    """
    from frenetic.cli.rerun_options import interrupted

    # Drives in which the simulator broke are made again.
    remaining = counted(drives - summary.passed - summary.failed, "drive")
    next_command = None  # the same command again
    if is_new_folder:
        next_command = Invocation((*this_command().words, "--out", str(summary.folder)))
    return interrupted(log, f"{remaining} to go", next_command)


def _tester_of(campaign: Path, options: CommandOptions) -> RoadTester:
    """Return the tester that drives as a campaign drove, in the campaign's domain.

    Raises:
        click.UsageError: the campaign has no domain.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.cli.rerun_options import tester_of_campaign

    with CampaignStore.open(campaign) as store:
        if store.setting.domain is None:
            raise click.UsageError(
                f"{campaign} searched no domain: name a campaign that was run with --odd, or give"
                " --odd FILE without a campaign"
            )
        return tester_of_campaign(store, options)


def _print(result: FailureRate) -> None:
    """Print an estimate, and the drives and failures from which it comes.

    The conditions of plain drives are drawn as they occur in the domain.
    """
    echo(result.as_text())
    echo(
        f"{result.plain} plain drives over {result.kilometres:.0f} km had"
        f" {counted(result.failures, 'failure')}"
    )
    if other_drives := result.drives - result.plain:
        echo(
            f"{counted(other_drives, 'drive')} in conditions drawn more often than they occur had"
            f" {counted(result.other_failures, 'failure')}, which count less"
        )
