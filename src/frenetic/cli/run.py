"""The command that searches: run."""

from __future__ import annotations

import secrets
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import click

from frenetic.cli.options import (
    Duration,
    as_usage_error,
    folder_option,
    json_option,
    objective_option,
)
from frenetic.cli.parts import (
    AS,
    asked_spec,
    driver_options,
    given_options,
    odd_option,
    part_choice,
    roads_option,
    was_given,
    with_given,
)
from frenetic.cli.search import fail_on_failure_option, make_campaign, search, workers_option
from frenetic.spec import Budget, EarlierCampaign, Spec

DEFAULT_SIMULATIONS: Final = 1000


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False, metavar="[FILE.toml]")
@click.option("--simulations", type=int, metavar="N", help="Stop after N drives. [default: 1000]")
@click.option("--time", type=Duration(), help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N failures.")
@part_choice("strategy", "How to search ('frenetic list strategies').", "frenetic")
@roads_option
@odd_option
@driver_options
@workers_option
@objective_option
@click.option(
    "--from",
    "start_from",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="CAMPAIGN",
    help="Start from an earlier campaign: what failed there is driven first; may be repeated.",
)
@click.option(
    "--from-roads",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Start from real roads, .xodr or .json, and keep to the class that they show.",
)
@click.option("--seed", type=click.IntRange(0), help="Repeats a search. [default: a new one]")
@folder_option("Folder for the results. [default: a new one under campaigns/]")
@fail_on_failure_option
@json_option
@click.pass_context
def run(
    context: click.Context,
    /,
    file: Path | None,
    workers: int | str | None,
    out: Path | None,
    fail_on_failure: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Search for roads on which a driver leaves its lane.

    With no option, 1000 drives of the built-in planner go into a new folder under campaigns/. The
    first of --simulations, --time and --failures ends the search; so does Ctrl-C. FILE.toml says
    what the options say, as every campaign's campaign.toml does; options beside it win.
    """
    from frenetic.campaign import new_folder

    from_roads = context.params["from_roads"]
    if from_roads is not None and context.params["road_class"] is None:
        from frenetic.road.stretches import shown_class  # too slow for help

        context.params["road_class"] = shown_class(from_roads)
    if (domain := context.params["domain"]) is not None and context.params["road_class"] is None:
        context.params["road_class"] = domain.road_class
    if file is None:
        spec = asked_spec(context)
        spec = replace(spec, objective=_objective(context, spec, None))
    else:
        spec, of_file = _of_file(context, file)
        workers = of_file if workers is None else workers
    spec = _with_search(context, spec)
    campaign = make_campaign(spec, new_folder() if out is None else out, workers)
    text = (
        f"Searching with {spec.strategy.name} for roads on which {spec.driver.name} fails,"
        f" seed {spec.seed}"
    )
    search(campaign, campaign.run, text, as_json, spec.seed, fail_on_failure=fail_on_failure)


def _of_file(context: click.Context, path: Path) -> tuple[Spec, int | str | None]:
    """The spec of a file under the given options; its workers, None if not there.

    Raises:
        FreneticError: the file is wrong, or names code that is not loaded unasked.
    """
    from frenetic.run_file import read_run_file

    spec, entries = read_run_file(path)
    given = given_options(context)
    given["domain"] = context.params["domain"]
    if context.params["from_roads"] is not None or given["domain"] is not None:
        given["road_class"] = context.params["road_class"]
    for name in ("strategy", "strategy_options"):
        if was_given(context, name):
            given[name] = context.params[name]
    named: list[str] = [kind for kind in ("strategy", "driver", "simulator") if kind in given]
    if was_given(context, "objective"):
        named.append("objective")
    if AS in given:
        named += ["driver", "simulator"]
    spec.require_trusted(path, named)
    spec = with_given(spec, given, has_roads=False)
    spec = replace(spec, objective=_objective(context, spec, entries.objective))
    return spec, entries.workers


def _objective(context: click.Context, spec: Spec, of_file: str | None) -> str:
    """The objective: as given, as the file says, or the usual one."""
    if was_given(context, "objective"):
        return str(context.params["objective"])
    return of_file or ("criteria" if spec.rules.criteria else Spec.objective)


def _with_search(context: click.Context, spec: Spec) -> Spec:
    """The spec with budget, seed, look-ahead and earlier campaigns."""
    from frenetic.campaign import LOOKAHEAD
    from frenetic.registry import STRATEGIES  # with what it loads, too slow for help

    limits = {} if spec.budget is None else asdict(spec.budget)
    for name in ("simulations", "time", "failures"):
        if was_given(context, name):
            limits[name] = context.params[name]
    with as_usage_error():
        budget = Budget(**(limits or {"simulations": DEFAULT_SIMULATIONS}))
    seed = context.params["seed"] if was_given(context, "seed") else spec.seed
    assert spec.strategy.name is not None
    usual = getattr(STRATEGIES.load(spec.strategy.name), "usual_lookahead", None)
    from_roads = context.params["from_roads"]
    earlier = tuple(EarlierCampaign(str(folder)) for folder in context.params["start_from"])
    return replace(
        spec,
        budget=budget,
        seed=secrets.randbelow(2**31) if seed is None else seed,
        lookahead=spec.lookahead or usual or LOOKAHEAD,
        start_from=earlier or spec.start_from,
        from_roads=str(from_roads) if from_roads is not None else spec.from_roads,
    )
