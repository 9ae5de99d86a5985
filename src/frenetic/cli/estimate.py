"""The command that estimates how often a driver fails in a domain: estimate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from frenetic._support.files import check_writable, write_file
from frenetic._support.words import counted
from frenetic.cli import echo
from frenetic.cli.console import Log, announced_compilation, live_line
from frenetic.cli.options import as_usage_error, count_option, json_option
from frenetic.cli.parts import (
    check_drawn,
    criteria_option,
    given_options,
    odd_option,
    part_options,
    with_given,
)
from frenetic.spec import Spec


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path), required=False)
@odd_option
@part_options
@criteria_option
@count_option("--drives", "Drive N times.", least=100, default=10_000)
@json_option
@click.pass_context
def estimate(
    context: click.Context,
    /,
    campaign: Path | None,
    drives: int,
    as_json: bool,
    **_: Any,
) -> None:
    """Say how often a driver leaves its lane in a domain, per 1,000 km.

    The domain is --odd FILE, or that of a CAMPAIGN, whose driver it is then and whose report says
    it, too. Common failures are counted in plain drives; for rare ones, conditions in which the
    driver fails are drawn more often and weighed. A search's failures take no part.
    """
    from frenetic.again.rerun import campaign_tester
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.tester import RoadTester
    from frenetic.cli.again import recorded_spec
    from frenetic.estimate import FILE
    from frenetic.estimate import estimate as estimated

    given, domain = given_options(context), context.params["domain"]
    if campaign is None and domain is None:
        raise click.UsageError("--odd FILE or the folder of a CAMPAIGN with a domain is needed")
    if campaign is not None and given:
        raise click.UsageError(
            f"{campaign} is estimated as it was driven: options are for --odd FILE without it"
        )
    if campaign is None:
        given["road_class"] = domain.road_class
        spec = with_given(Spec(), given, has_roads=False)
        check_drawn(spec, given)
        driver, simulator = spec.make_parts(isolate=True)
        with as_usage_error():
            tester = RoadTester.on(spec, simulator, driver)
    else:
        with CampaignStore.open(campaign) as store:
            domain = store.setting.domain
            if domain is None:
                raise click.UsageError(f"{campaign} searched no domain: one with --odd did")
            check_writable(campaign / FILE, remedy="let it be written")
            spec = recorded_spec(store, {})
            driver, simulator = spec.make_parts(isolate=True)
            tester = campaign_tester(store, simulator, driver)
    log = Log()
    with announced_compilation(log) as compiled, tester.simulator, live_line(log) as show:
        compiled()

        def on_drive(driven: int, failures: int) -> None:
            text = f"{driven} of {counted(drives, 'drive')}, {counted(failures, 'failure')}"
            show(driven / drives, lambda: text)

        with as_usage_error():
            result = estimated(domain, tester, drives=drives, on_drive=on_drive)
    document = json.dumps(result.as_json())
    if campaign is not None:
        write_file(campaign / FILE, document + "\n", remedy="make room, or let it be written")
    if as_json:
        echo(document)
        return
    echo(result.in_words())
    echo(
        f"{result.plain} plain drives over {result.kilometres:.0f} km had"
        f" {counted(result.failures, 'failure')}"
    )
    if other_drives := result.drives - result.plain:
        echo(
            f"{counted(other_drives, 'drive')} in conditions drawn more often than they occur had"
            f" {counted(result.other_failures, 'failure')}, which weigh less"
        )
