"""The command that estimates how often a driver fails in a domain: estimate."""

from __future__ import annotations

import json
from collections import deque
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted
from frenetic.cli import Invocation, echo
from frenetic.cli.console import Log, shell, this_command
from frenetic.cli.entries import CommandOptions, entry_option, part_options, trust_option
from frenetic.cli.options import (
    as_usage_error,
    count_option,
    folder_option,
    json_option,
    workers_option,
)
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign import Event, Summary


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path), required=False)
@entry_option("odd")
@part_options
@entry_option("criteria")
@trust_option
@count_option("--drives", "Drive N times.", least=100, default=10_000)
@workers_option
@folder_option(
    "Campaign that drives. [default: a folder in rerun/ of the CAMPAIGN, or a new one under"
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

    The domain is --odd FILE, or that of a CAMPAIGN, whose driver it is then and whose report says
    it, too. Common failures are counted in plain drives; for rare ones, conditions in which the
    driver fails are drawn more often and weighed. A search's failures take no part. The same
    command goes on with an interrupted one, and shows a complete one; without a CAMPAIGN it needs
    --out DIR for that.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.tester import RoadTester
    from frenetic.cli.rerun_options import campaign_spec, interrupted, shown_driving
    from frenetic.rerun.estimate import estimate as estimated
    from frenetic.rerun.rerun import campaign_tester

    options = CommandOptions.of(context)
    if campaign is None and not options.says("odd"):
        raise click.UsageError("--odd FILE or the folder of a CAMPAIGN with a domain is needed")
    if campaign is not None and options:
        raise click.UsageError(
            f"{campaign} is estimated as it was driven: options are for --odd FILE without it"
        )
    if campaign is None:
        spec, place = options.trusted(options.over(Spec(), has_roads=False))
        options.check_drawn(spec)
        with as_usage_error(), chdir(place):
            tester = RoadTester.of(spec)
    else:
        with CampaignStore.open(campaign) as store:
            if store.setting.domain is None:
                raise click.UsageError(f"{campaign} searched no domain: one with --odd did")
            spec, place = campaign_spec(store, options)
            with chdir(place):
                tester = campaign_tester(store, spec)
    log = Log()
    latest: deque[Summary] = deque(maxlen=1)
    try:
        with shown_driving(log, "Driving") as show:

            def on_event(event: Event) -> None:
                latest.append(event.summary)
                show(event)

            result = estimated(
                tester,
                drives=drives,
                campaign=campaign,
                workers=workers,
                isolate=True,
                out=out,
                on_event=on_event,
            )
    except KeyboardInterrupt:
        if not latest:  # nothing is kept
            raise
        left = counted(drives - latest[-1].passed - latest[-1].failed, "drive")
        command = None
        if campaign is None and out is None:
            words = (*this_command().words, "--out", str(latest[-1].folder))
            command = Invocation(words)
        raise interrupted(log, f"{left} to go", command) from None
    folder = latest[-1].folder
    kept = f"Kept in {folder}; to see it: frenetic report {shell(campaign or folder)}"
    if as_json:
        echo(json.dumps(result.as_json()))
        log.print(kept, markup=False)
        return
    echo(result.as_text())
    echo(
        f"{result.plain} plain drives over {result.kilometres:.0f} km had"
        f" {counted(result.failures, 'failure')}"
    )
    if other_drives := result.drives - result.plain:
        echo(
            f"{counted(other_drives, 'drive')} in conditions drawn more often than they occur had"
            f" {counted(result.other_failures, 'failure')}, which weigh less"
        )
    echo(kept)
