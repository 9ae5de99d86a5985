"""The command `margin`: how far a driver is from failing."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted
from frenetic.cli import Invocation, echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, print_table, this_command
from frenetic.cli.entries import entry_options, part_options, trust_option
from frenetic.cli.option_types import NewFile, amount_type
from frenetic.cli.options import (
    SEED_LIMIT,
    as_usage_error,
    count_option,
    file_option,
    folder_option,
    json_option,
    workers_option,
)

if TYPE_CHECKING:
    from frenetic.campaign import Event, RoadTester, Summary
    from frenetic.rerun.campaigns import DrivingOptions
    from frenetic.rerun.margin_quantities import MarginQuantity, RequiredAmount
    from frenetic.rerun.margin_results import Margins


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path), required=False)
@entry_options("roads", "odd")
@part_options
@entry_options("criteria", "map_size")
@trust_option
@click.option(
    "--of",
    "quantities",
    type=amount_type("delay=0.5", allows_name=True),
    metavar="NAME[=AMOUNT]",
    multiple=True,
    help="A condition to measure, as in --of delay, or up to an amount. May be repeated. [default:"
    " twelve that simulator and driver can have, and the radius of a class's bends]",
)
@click.option(
    "--at-least",
    type=amount_type("delay=0.2"),
    metavar="NAME=AMOUNT",
    multiple=True,
    help="Exit code 1 if the driver begins to fail before this amount. May be repeated.",
)
@count_option("--random-roads", "Measure on N random roads.", default=80)
@click.option(
    "--seed",
    type=click.IntRange(0, SEED_LIMIT - 1),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the random roads.",
)
@workers_option
@folder_option(
    "Folder for the drives. [default: a folder in rerun/ of the CAMPAIGN, or a new one under"
    " campaigns/]"
)
@file_option(
    "--plot", "Draw the margins into this PNG, SVG or PDF file.", type=NewFile(is_picture=True)
)
@file_option("--junit", "Write the results as JUnit XML, one test case per margin.", type=NewFile())
@json_option
@click.pass_context
def margin(
    context: click.Context,
    /,
    campaign: Path | None,
    quantities: tuple[tuple[str, float | None], ...],
    at_least: tuple[RequiredAmount, ...],
    random_roads: int,
    seed: int,
    workers: int,
    out: Path | None,
    plot: Path | None,
    junit: Path | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Say how far a driver is from failing: from which delay, noise and so on.

    The margin is the amount of a condition from which on the driver fails on 5 % of random roads of
    a road class or domain. On each road, amounts over the whole range are driven, then the least
    failing one is found by bisection. With a CAMPAIGN, its own driver drives, also on the roads
    where it came nearest to failing; without one --out DIR is needed. The same command continues
    after Ctrl-C, and prints margins that are measured.
    """
    from frenetic.cli.rerun_options import kept_text
    from frenetic.rerun.margin_quantities import measured_quantities

    options = CommandOptions.of(context)
    if campaign is not None and options:
        raise click.UsageError(
            f"{campaign} is driven as before: leave out the options that change how roads are"
            " driven, or leave out the campaign"
        )
    tester = _tester(campaign, options)
    driving: DrivingOptions = {"workers": workers, "isolate": True, "out": out}
    log = Log()
    with as_usage_error():
        measured = measured_quantities(tester, _ends(quantities), at_least)
        margins = _measure(
            log, tester, measured, driving, roads=random_roads, seed=seed, campaign=campaign
        )
    _write_files(margins, at_least, plot, junit)
    shortfalls = margins.shortfalls(at_least)
    # A campaign's report shows only studies in the campaign's own folder.
    reported = campaign if campaign is not None and out is None else margins.folder
    where_to_see = kept_text(margins.folder, reported, is_reported=True)
    if as_json:
        echo(json.dumps({**margins.as_json(), "shortfalls": shortfalls}))
        log.print(where_to_see, markup=False)
    else:
        _print(margins)
        for text in shortfalls.values():
            echo(f"Too small a margin: {text}")
        for path in (plot, junit):
            if path is not None:
                echo(path)
        echo(where_to_see)
    if shortfalls:
        raise click.exceptions.Exit(1)


def _ends(quantities: tuple[tuple[str, float | None], ...]) -> dict[str, float | None] | None:
    """Return the ends of the ranges of ``--of``; None without the option.

    Raises:
        click.UsageError: a condition is there twice.
    """
    ends = dict(quantities)
    for name in ends:
        if sum(name == other for other, _ in quantities) > 1:
            raise click.UsageError(f"--of {name} is there twice: name it once")
    return ends or None


def _tester(campaign: Path | None, options: CommandOptions) -> RoadTester:
    """Return the tester that drives as the options say, or as a campaign drove."""
    from frenetic.campaign import CampaignStore
    from frenetic.cli.rerun_options import tester_of_campaign, tester_of_options

    if campaign is None:
        return tester_of_options(options)
    with CampaignStore.open(campaign) as store:
        return tester_of_campaign(store, options)


def _measure(
    log: Log,
    tester: RoadTester,
    quantities: Sequence[MarginQuantity],
    driving: DrivingOptions,
    *,
    roads: int,
    seed: int,
    campaign: Path | None,
) -> Margins:
    """Measure margins, and show the progress.

    Raises:
        click.exceptions.Exit: Ctrl-C came before the last drive.
    """
    from frenetic.cli.rerun_options import interrupted, shown_driving
    from frenetic.rerun.margin import measure_margins

    # The summary of the last event; where all drives are made, one event is sent, too.
    latest: deque[Summary] = deque(maxlen=1)
    try:
        with shown_driving(log, "Driving, at most") as show:

            def on_event(event: Event) -> None:
                latest.append(event.summary)
                show(event)

            driving = {**driving, "on_event": on_event}
            return measure_margins(
                tester, quantities, roads=roads, seed=seed, campaign=campaign, **driving
            )
    except KeyboardInterrupt:
        if not latest:  # no event came, so there is no folder to name
            raise
    next_command = None  # the same command again
    if campaign is None and driving.get("out") is None:
        next_command = Invocation((*this_command().words, "--out", str(latest[-1].folder)))
    done = counted(latest[-1].simulations, "drive")
    raise interrupted(log, f"{done} made", next_command)


def _write_files(
    margins: Margins, at_least: Sequence[RequiredAmount], plot: Path | None, junit: Path | None
) -> None:
    """Write the picture and the JUnit file that the command line names."""
    if plot is not None:
        from frenetic.report.margins import draw_margins  # imports matplotlib

        draw_margins(margins, plot)
    if junit is not None:
        from frenetic.rerun.margin_junit import write_margin_junit

        write_margin_junit(margins, at_least, junit)


def _print(margins: Margins) -> None:
    """Print a row for each quantity, and notes."""
    echo(margins.headline)
    print_table(margins.columns, [tuple(text or None for text in row) for row in margins.rows])
    for note in margins.notes:
        echo(f"Note: {note}")
