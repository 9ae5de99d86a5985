"""The command that drives a campaign's failures again with other parts: regression."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli.console import Log, print_table, two_digits
from frenetic.cli.options import CampaignFolder, GroupedCommand, NewFile, file_option
from frenetic.cli.redrive import (
    interrupted,
    recorded_spec,
    redriving_options,
    rows_option,
    shown_driving,
)

if TYPE_CHECKING:
    from frenetic.redrive.regression import Replay

NAMED: Final = 10
"""Most tests that the summary names."""


@click.command(cls=GroupedCommand)
@click.argument("campaign", type=CampaignFolder())
@click.option(
    "--all", "everything", is_flag=True, help="All roads that were driven, not only the failures."
)
@file_option("--junit", "Write the results as JUnit XML, one test case per road.", type=NewFile())
@rows_option
@redriving_options
def regression(
    campaign: Path,
    everything: bool,
    junit: Path | None,
    with_rows: bool,
    workers: int,
    drive_limit: float | None,
    out: Path | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Drive the failing roads of a CAMPAIGN again and say which are fixed.

    Each road is driven where it lay on the map, with the campaign's options unless others are
    given: without options, the command says whether results reproduce. The exit code is 0 if no
    road fails, 1 if any fails or could not be judged, 2 if something is wrong with the command.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.redrive.regression import replay as replay_campaign
    from frenetic.redrive.regression import write_junit

    with CampaignStore.open(campaign) as store:
        spec = recorded_spec(store, given)
    driver, simulator = spec.make_parts(isolate=workers == 1, drive_limit=drive_limit)
    log = Log()
    with shown_driving(log, "Driving again") as hooks:
        show = hooks["on_progress"]
        replayed = replay_campaign(
            campaign,
            simulator,
            driver,
            everything=everything,
            workers=workers,
            drive_limit=drive_limit,
            out=out,
            **{**hooks, "on_progress": lambda now: show(now.tests, now.total)},
        )
    if junit is not None and not replayed.missing:
        write_junit(replayed, junit)
    if as_json:
        from frenetic.redrive.regression import replay_document

        click.echo(json.dumps(replay_document(replayed)))
    else:
        is_the_same_drive = all(value in (None, ()) for value in given.values())
        _print(replayed, everything, is_the_same_drive, with_rows)
    if replayed.missing:
        left = counted(replayed.missing, "road")
        raise interrupted(log, f"{left} to go; the same command goes on")
    if not replayed.passed:
        raise click.exceptions.Exit(1)


def _print(replayed: Replay, everything: bool, is_the_same_drive: bool, with_rows: bool) -> None:
    from frenetic.outcome import Outcome
    from frenetic.redrive.record import Change

    what = "road" if everything else "failure"
    total = len(replayed.tests)
    if not total:
        click.echo(f"no {what} to drive again")
        return
    click.echo(f"{counted(total, what)} driven again: {replayed}")
    if is_the_same_drive:
        click.echo(f"{replayed.same} of {total} ended exactly as before")
    listed = [test for test in replayed.tests if test.change is not Change.STILL_PASSING]
    if not with_rows:
        if bad := [str(test.test_id) for test in listed if test.after is not Outcome.PASS]:
            more = f" and {len(bad) - NAMED} more" if len(bad) > NAMED else ""
            click.echo(f"Not passing: {', '.join(bad[:NAMED])}{more}")
        click.echo("Test by test: --rows")
    elif listed:
        print_table(
            (">test", "before", "now", ">MOOBD before (m)", ">now (m)", "it is", "how", "why"),
            [
                (
                    test.test_id,
                    test.before,
                    test.after,
                    two_digits(test.moobd_before),
                    two_digits(test.moobd_after),
                    test.change,
                    test.match,
                    "" if test.after is Outcome.PASS else test.reason,
                )
                for test in listed
            ],
        )
