"""The commands that search: run, resume."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import click

from frenetic._support.durations import format_duration
from frenetic._support.words import counted
from frenetic.cli.beamng import moved, place_options
from frenetic.cli.console import (
    Log,
    announced_compilation,
    live_progress,
    print_failures,
    shell,
)
from frenetic.cli.grouping import GroupedCommand
from frenetic.cli.options import (
    Duration,
    Folder,
    Setting,
    as_usage_error,
    drive_limit_option,
    driver_options,
    json_option,
)
from frenetic.errors import CampaignError, FreneticError
from frenetic.spec import Budget, Spec

if TYPE_CHECKING:
    from frenetic.analysis import Clusters
    from frenetic.campaign import Campaign, CampaignStore, Summary

DEFAULT_SIMULATIONS = 1000


P = ParamSpec("P")
R = TypeVar("R")


def _worker_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose the workers."""
    options = [
        click.option(
            "--workers",
            type=click.IntRange(1),
            metavar="N",
            help="Drive on N roads at once, in processes of their own. [default: the cores]",
        ),
        click.option(
            "--cluster",
            metavar="ADDRESS",
            help="Drive on the workers of a running Dask cluster, such as tcp://10.0.0.1:8786.",
        ),
        drive_limit_option,
    ]
    for option in reversed(options):
        command = option(command)
    return command


@click.command(cls=GroupedCommand, short_help="Search for roads on which a driver fails.")
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
@_worker_options
@click.option(
    "--ordered/--unordered",
    default=None,
    help="Whether the results are used in the order of the proposals, so that a seed gives the same"
    " campaign whatever the number of workers. [default: ordered if a seed is given]",
)
@click.option(
    "--lookahead",
    type=click.IntRange(1),
    metavar="N",
    help="Propose N roads ahead in an ordered campaign; more workers are of no use then."
    " [default: 16]",
)
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
    workers: int | None,
    cluster: str | None,
    drive_limit: float | None,
    ordered: bool | None,
    lookahead: int | None,
    seed: int | None,
    out: Path | None,
    as_json: bool,
    **how: Any,
) -> None:
    """Search for roads on which a driver leaves its lane.

    With no option at all, 1000 drives of the built-in planner go into a new folder under
    campaigns/. The first of --simulations, --time and --failures that is reached ends the search;
    so does Ctrl-C, and nothing found is lost.
    """
    from frenetic.campaign import LOOKAHEAD, new_folder

    if simulations is None and seconds is None and failures is None:
        simulations = DEFAULT_SIMULATIONS
    ordered = seed is not None if ordered is None else ordered
    if lookahead is not None and not ordered:
        raise click.UsageError("--lookahead is for an ordered campaign: add --ordered")
    seed = secrets.randbelow(2**31) if seed is None else seed
    with as_usage_error():
        budget = Budget(simulations=simulations, time=seconds, failures=failures)
    spec = Spec.from_options(
        how,
        seed=seed,
        budget=budget,
        lookahead=(lookahead or LOOKAHEAD) if ordered else None,
    )
    campaign = _campaign(spec, new_folder() if out is None else out, workers, cluster, drive_limit)
    text = (
        f"Searching with {spec.strategy.name} for roads on which {spec.driver.name} fails,"
        f" seed {seed}"
    )
    _search(campaign, campaign.run, text, as_json, seed)


@click.command(
    cls=GroupedCommand,
    short_help="Go on with a campaign that was interrupted or is to be extended.",
)
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--simulations", type=int, metavar="N", help="N more drives.")
@click.option("--time", "seconds", type=Duration(), help="This much more time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="N more failures.")
@_worker_options
@place_options
@json_option
def resume(
    campaign: Path,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    workers: int | None,
    cluster: str | None,
    drive_limit: float | None,
    as_json: bool,
) -> None:
    """Resume the CAMPAIGN in a folder after Ctrl-C, a crash, or the end of its budget.

    Its log is replayed to a fresh strategy, so an interrupted campaign ends as if it had never been
    interrupted: exactly so if it has one worker or is ordered and its budget counts simulations or
    failures. A given budget is added to what is spent. If BeamNG.tech has moved, give its new
    place, which holds for this time.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.store import DATABASE
    from frenetic.outcome import Outcome

    with CampaignStore.open(campaign) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        spent = store.elapsed()
    if "entrant" in config:
        raise click.UsageError(
            f"{campaign} is a run of a bench, which keeps its budget: what a bench lacks is run by"
            " 'frenetic bench --resume --out BENCH'"
        )
    if config.get("command") is None:
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    given = {"simulations": simulations, "time": seconds, "failures": failures}
    done: dict[str, Any] = {
        "simulations": counts.simulations,
        "time": spent,
        "failures": counts.by_outcome[Outcome.FAIL],
    }
    with as_usage_error():
        for name, more in given.items():
            if more is not None and more <= 0:
                raise ValueError(f"{name} is {more}: more than 0 is needed")
        if any(more is not None for more in given.values()):
            limits = {k: None if v is None else done[k] + v for k, v in given.items()}
            recorded: dict[str, Any] = {"budget": asdict(Budget(**limits))}
        else:
            recorded = {k: v for k, v in facts.items() if k == "budget"}
        spec = Spec.from_json({**config, **recorded}, source=campaign / DATABASE)
        assert spec.budget is not None
        budget = spec.budget
        if budget.spent(done["simulations"], spent, done["failures"]) >= 1.0:
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    simulator = spec.simulator
    simulator = replace(simulator, options=moved(simulator.name, simulator.options))
    the_campaign = _campaign(
        replace(spec, simulator=simulator), campaign, workers, cluster, drive_limit
    )
    text = f"Going on after {counts.tests} tests with {spec.strategy.name}"
    _search(the_campaign, the_campaign.resume, text, as_json, spec.seed)


def _campaign(
    spec: Spec,
    folder: Path,
    workers: int | None,
    cluster: str | None,
    drive_limit: float | None,
) -> Campaign:
    from frenetic.campaign import Campaign

    if cluster is not None and workers is not None:
        raise click.UsageError(
            "--workers and --cluster exclude each other: the cluster has its own"
        )
    with as_usage_error():
        return Campaign.of(
            spec, folder=folder, workers=workers, cluster=cluster, drive_limit=drive_limit
        )


def _search(
    campaign: Campaign,
    search: Callable[..., Summary],
    announcement: str,
    as_json: bool,
    seed: object,
) -> None:
    """Runs or resumes a campaign, and shows its progress and failures."""
    from frenetic.analysis.failures import distinct_failures, representative_failures
    from frenetic.campaign import CampaignStore
    from frenetic.outcome import Outcome
    from frenetic.report.failures import FAILURES, GALLERY, write_failures

    folder = campaign.folder
    log = Log()
    trouble: FreneticError | None = None
    summary: Summary | None = None
    with announced_compilation(log) as compiled, live_progress(log) as show:

        def started() -> None:
            compiled()
            log.print(f"{announcement}, results in {folder}", markup=False)

        try:
            summary = search(show, on_start=started, on_interrupt=log.stopping)
        except CampaignError as error:
            # Show what was stored until then.
            if not campaign.started:
                raise
            trouble = error
    with CampaignStore.open(folder) as store:
        clusters = distinct_failures(store)
        listed = representative_failures(store, clusters=clusters)
        counts = store.counts()
        if summary is not None and as_json:
            more = {"distinct_failures": len(clusters), "seed": seed}
            click.echo(json.dumps(summary.as_json() | more))
        elif summary is not None:
            _print_summary(summary, _first_error(store))
        if listed and not as_json:
            print_failures(clusters, counts.by_outcome[Outcome.FAIL], len(listed))
        if summary is not None and not as_json:
            click.echo(f"Results:     {folder}")
        if listed:
            with log.status("Drawing the most severe of them"):
                complete = write_failures(store, listed)
            if not as_json:
                click.echo(f"At a glance: {folder / FAILURES / (GALLERY if complete else '')}")
                click.echo(f"Look closer: frenetic show {shell(folder)} {listed[0].candidate.id}")
        report = _write_report(log, store, clusters) if counts.tests else None
        if report is not None and not as_json:
            click.echo(f"Report:      {report}")
    if trouble is not None:
        raise trouble
    if summary is not None and summary.interrupted:
        raise click.exceptions.Exit(130)
    if summary is not None and summary.errors and not summary.passed + summary.failed:
        raise click.exceptions.Exit(1)


def _write_report(log: Log, store: CampaignStore, clusters: Clusters) -> Path | None:
    """Writes the report; None if that failed, which loses nothing else."""
    from frenetic.report.html import write_report

    try:
        with log.status("Writing the report"):
            return write_report(store, clusters=clusters)
    except FreneticError as error:
        log.print(f"There is no report: {error}", markup=False)
        return None


def _first_error(store: CampaignStore) -> str:
    """Prints why a drive broke first, if one did."""
    from frenetic.outcome import Outcome

    return "".join(test.reason for test in store.tests(Outcome.ERROR, limit=1))


def _print_summary(summary: Summary, first_error: str) -> None:
    least = "" if summary.min_moobd is None else f", best MOOBD {summary.min_moobd:.2f} m"
    stopped = "Interrupted: " if summary.interrupted else ""
    click.echo(
        f"{stopped}{counted(summary.simulations, 'simulation')} in"
        f" {format_duration(summary.seconds)} ({summary.tests_per_second:.0f} tests/s):"
        f" {counted(summary.failed, 'failure')}, {summary.passed} passed,"
        f" {summary.invalid} invalid, {counted(summary.errors, 'error')}{least}"
    )
    if first_error:
        click.echo(f"The first error: {first_error}")
    if summary.ended:
        click.echo(f"The strategy ended the search: {summary.ended}")
