"""The commands that search: run, resume."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli.console import (
    Log,
    announced_compilation,
    live_progress,
    print_failures,
    shell,
)
from frenetic.cli.options import (
    Duration,
    Folder,
    Setting,
    as_usage_error,
    driver_options,
    json_option,
)
from frenetic.cli.parts import make_campaign
from frenetic.durations import format_duration
from frenetic.errors import CampaignError, FreneticError

if TYPE_CHECKING:
    from frenetic.campaign import Campaign, Summary

DEFAULT_SIMULATIONS = 1000


@click.command(short_help="Search for roads on which a driver fails.")
@click.option("--simulations", type=int, metavar="N", help="Stop after N drives. [default: 1000]")
@click.option("--time", "seconds", type=Duration(), help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N failures.")
@click.option(
    "--strategy",
    default="frenetic",
    show_default=True,
    metavar="S",
    help="How to search (see 'frenetic strategies').",
)
@click.option(
    "--strategy-option",
    "strategy_options",
    type=Setting(),
    multiple=True,
    help="An option of the strategy, such as threshold=-0.2; may be repeated.",
)
@driver_options
@click.option("--seed", type=click.IntRange(0), help="Repeats a search. [default: a new one]")
@click.option(
    "--out",
    type=Folder(),
    metavar="DIR",
    help="Folder for the results. [default: a new one under campaigns/]",
)
@json_option
def run(
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    strategy: str,
    strategy_options: tuple[tuple[str, Any], ...],
    driver: str,
    driver_options: tuple[tuple[str, Any], ...],
    noise: float | None,
    delay: float | None,
    view: float | None,
    simulator: str,
    simulator_options: tuple[tuple[str, Any], ...],
    speed_limit: float,
    oob_tolerance: float,
    map_size: float,
    wall_limit: float,
    seed: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Search for roads on which a driver leaves its lane.

    With no option at all, 1000 drives of the built-in planner go into a new folder under
    campaigns/. The first of --simulations, --time and --failures that is reached ends the search;
    so does Ctrl-C, and nothing found is lost.
    """
    from frenetic.campaign import Budget, new_folder

    if simulations is None and seconds is None and failures is None:
        simulations = DEFAULT_SIMULATIONS
    seed = secrets.randbelow(2**31) if seed is None else seed
    with as_usage_error():
        budget = Budget(simulations=simulations, time=seconds, failures=failures)
    command = {
        "strategy": strategy,
        "strategy_options": dict(strategy_options),
        "driver": driver,
        "driver_options": dict(driver_options),
        "noise": noise,
        "delay": delay,
        "view": view,
        "simulator": simulator,
        "simulator_options": dict(simulator_options),
        "speed_limit": speed_limit,
        "oob_tolerance": oob_tolerance,
        "wall_limit": wall_limit,
    }
    folder = new_folder() if out is None else out
    campaign = make_campaign(command, seed, map_size, budget, folder)
    text = f"Searching with {strategy} for roads on which {driver} fails, seed {seed}"
    _search(campaign, campaign.run, text, as_json, seed)


@click.command(short_help="Go on with a campaign that was interrupted or is to be extended.")
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--simulations", type=int, metavar="N", help="N more drives.")
@click.option("--time", "seconds", type=Duration(), help="This much more time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="N more failures.")
@json_option
def resume(
    campaign: Path,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    as_json: bool,
) -> None:
    """Go on with the CAMPAIGN in a folder, whatever ended it: Ctrl-C, a crash, its budget.

    Its log is replayed to a fresh strategy, so that an interrupted campaign ends as it would have
    without the interruption. With options, its budget becomes what is spent and so much more.
    """
    from frenetic.campaign import Budget, CampaignStore
    from frenetic.outcome import Outcome

    with CampaignStore.open(campaign) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        spent = sum(record.seconds for record in store.tests())
    command = config.get("command")
    if not isinstance(command, Mapping):
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    number = counts.by_outcome
    given = {"simulations": simulations, "time": seconds, "failures": failures}
    done: dict[str, Any] = {
        "simulations": counts.told - number[Outcome.INVALID],
        "time": spent,
        "failures": number[Outcome.FAIL],
    }
    with as_usage_error():
        for name, more in given.items():
            if more is not None and more <= 0:
                raise ValueError(f"{name} is {more}: more than 0 is needed")
        last = facts.get("budget", config.get("budget"))
        limits: dict[str, Any] = dict(last) if isinstance(last, Mapping) else {}
        if any(more is not None for more in given.values()):
            limits = {k: None if v is None else done[k] + v for k, v in given.items()}
        budget = Budget(**limits)
        if budget.spent(done["simulations"], spent, done["failures"]) >= 1.0:
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    map_size: Any = config.get("map_size")
    the_campaign = make_campaign(command, config.get("seed"), map_size, budget, campaign)
    text = f"Going on after {counts.told} tests with {command['strategy']}"
    _search(the_campaign, the_campaign.resume, text, as_json, config.get("seed"))


def _search(
    campaign: Campaign,
    search: Callable[..., Summary],
    announcement: str,
    as_json: bool,
    seed: object,
) -> None:
    """Runs or resumes a campaign, shows how it goes and what it found."""
    from frenetic.campaign import CampaignStore
    from frenetic.report.failures import FAILURES, GALLERY, telling_failures, write_failures

    folder = campaign.folder
    log = Log()
    trouble: FreneticError | None = None
    summary: Summary | None = None
    with announced_compilation(log) as compiled, live_progress(log) as show:

        def started() -> None:
            compiled()
            log.print(f"{announcement}, results in {folder}", markup=False)

        def stopping() -> None:
            log.print("Stopping after this test; press Ctrl-C again to leave at once.")

        try:
            summary = search(show, on_start=started, on_interrupt=stopping)
        except CampaignError as error:
            # What was stored until then is still worth a look.
            if not campaign.started:
                raise
            trouble = error
    with CampaignStore.open(folder) as store:
        listed = telling_failures(store)
        if summary is not None and as_json:
            click.echo(json.dumps(summary.as_json() | {"seed": seed}))
        elif summary is not None:
            _print_summary(summary)
        if listed and not as_json:
            print_failures(listed)
        if summary is not None and not as_json:
            click.echo(f"Results:     {folder}")
        if listed:
            with log.status("Drawing the most telling failures"):
                complete = write_failures(store, listed)
            if not as_json:
                click.echo(f"At a glance: {folder / FAILURES / (GALLERY if complete else '')}")
                click.echo(f"Look closer: frenetic show {shell(folder)} {listed[0].candidate.id}")
    if trouble is not None:
        raise trouble
    if summary is not None and summary.interrupted:
        raise click.exceptions.Exit(130)


def _print_summary(summary: Summary) -> None:
    least = "" if summary.min_moobd is None else f", best MOOBD {summary.min_moobd:.2f} m"
    stopped = "Interrupted: " if summary.interrupted else ""
    click.echo(
        f"{stopped}{summary.simulations} simulations in {format_duration(summary.seconds)}"
        f" ({summary.tests_per_second:.0f} tests/s): {summary.failed} failures,"
        f" {summary.passed} passed, {summary.invalid} invalid, {summary.errors} errors{least}"
    )
