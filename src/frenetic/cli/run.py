"""The command that searches: run."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Any, Final

import click

from frenetic.cli.options import (
    CampaignFolder,
    Duration,
    GroupedCommand,
    as_usage_error,
    count_option,
    folder_option,
    json_option,
    objective_option,
)
from frenetic.cli.parts import asked_spec, driver_options, part_choice
from frenetic.cli.search import fail_on_failure_option, make_campaign, search, worker_options
from frenetic.spec import Budget, EarlierCampaign

DEFAULT_SIMULATIONS: Final = 1000


@click.command(cls=GroupedCommand)
@click.option("--simulations", type=int, metavar="N", help="Stop after N drives. [default: 1000]")
@click.option("--time", "seconds", type=Duration(), help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N failures.")
@part_choice("strategy", "How to search (see 'frenetic list strategies').", "frenetic")
@driver_options
@worker_options
@click.option(
    "--ordered/--unordered",
    default=None,
    help="Whether the results are used in the order of the proposals, so that a seed gives the same"
    " campaign whatever the number of workers. [default: ordered if a seed is given, and with"
    " frenetic-2021]",
)
@count_option(
    "--lookahead",
    "Propose N roads ahead in an ordered campaign; more workers are of no use then. [default: 16,"
    " with frenetic-2021 1]",
)
@objective_option
@click.option(
    "--from",
    "start_from",
    type=CampaignFolder(),
    multiple=True,
    metavar="CAMPAIGN",
    help="Start from an earlier campaign, such as one of the driver's last version: what failed"
    " there is driven again first; may be repeated.",
)
@click.option("--seed", type=click.IntRange(0), help="Repeats a search. [default: a new one]")
@folder_option("Folder for the results. [default: a new one under campaigns/]")
@fail_on_failure_option
@json_option
@click.pass_context
def run(
    context: click.Context,
    /,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    workers: int | None,
    cluster: str | None,
    drive_limit: float | None,
    ordered: bool | None,
    lookahead: int | None,
    objective: str,
    start_from: tuple[Path, ...],
    seed: int | None,
    out: Path | None,
    fail_on_failure: bool,
    as_json: bool,
    **how: Any,
) -> None:
    """Search for roads on which a driver leaves its lane.

    With no option at all, 1000 drives of the built-in planner go into a new folder under
    campaigns/. The first of --simulations, --time and --failures that is reached ends the search;
    so does Ctrl-C, and nothing found is lost.
    """
    from frenetic.campaign import LOOKAHEAD, new_folder
    from frenetic.registry import STRATEGIES  # with what it loads, too slow for help

    if simulations is None and seconds is None and failures is None:
        simulations = DEFAULT_SIMULATIONS
    usual = getattr(STRATEGIES.load(how["strategy"]), "usual_lookahead", None)
    if ordered is None:
        one_by_one = usual == 1 and workers is None and cluster is None
        ordered = seed is not None or one_by_one
    if lookahead is not None and not ordered:
        raise click.UsageError("--lookahead is for an ordered campaign: add --ordered")
    seed = secrets.randbelow(2**31) if seed is None else seed
    with as_usage_error():
        budget = Budget(simulations=simulations, time=seconds, failures=failures)
    spec = asked_spec(
        context,
        how,
        seed=seed,
        budget=budget,
        objective=objective,
        start_from=tuple(EarlierCampaign(str(folder)) for folder in start_from),
        lookahead=(lookahead or usual or LOOKAHEAD) if ordered else None,
    )
    campaign = make_campaign(
        spec, new_folder() if out is None else out, workers, cluster, drive_limit
    )
    text = (
        f"Searching with {spec.strategy.name} for roads on which {spec.driver.name} fails,"
        f" seed {seed}"
    )
    search(campaign, campaign.run, text, as_json, seed, fail_on_failure=fail_on_failure)
