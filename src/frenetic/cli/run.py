"""The command that searches: run."""

from __future__ import annotations

import secrets
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import click

from frenetic.cli.console import limit_of_search
from frenetic.cli.options import (
    DURATION,
    as_usage_error,
    folder_option,
    json_option,
    objective_option,
)
from frenetic.cli.parts import (
    AS,
    check_drawn,
    criteria_option,
    given_options,
    map_size_option,
    odd_option,
    part_choice,
    part_options,
    roads_option,
    was_given,
    with_given,
)
from frenetic.cli.search import fail_on_failure_option, make_campaign, search, workers_option
from frenetic.spec import Budget, EarlierCampaign, Part, Spec

DEFAULT_SIMULATIONS: Final = 1000


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False, metavar="[FILE.toml]")
@click.option("--simulations", type=int, metavar="N", help="Stop after N drives. [default: 1000]")
@click.option("--time", type=DURATION, help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N failures.")
@part_choice("strategy", "How to search ('frenetic list strategies'). [default: frenetic]")
@roads_option
@odd_option
@part_options
@criteria_option
@map_size_option
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
    from frenetic.report import results
    from frenetic.run_file import RunFile, read_run_file

    given, asked = given_options(context), context.params
    given |= {n: asked[n] for n in ("strategy", "strategy_options") if was_given(context, n)}
    if "road_class" not in given and asked["from_roads"] is not None:
        from frenetic.road.stretches import shown_class  # too slow for help

        given["road_class"] = shown_class(asked["from_roads"])
    elif "road_class" not in given and asked["domain"] is not None:
        given["road_class"] = asked["domain"].road_class
    spec, entries = Spec(strategy=Part("frenetic")), RunFile()
    if file is not None:
        spec, entries = read_run_file(file)
        named: list[str] = [kind for kind in ("strategy", "driver", "simulator") if kind in given]
        named += ["objective"] if was_given(context, "objective") else []
        named += ["driver", "simulator"] if AS in given else []
        spec.require_trusted(file, named)
    spec = with_given(spec, given, has_roads=False)
    check_drawn(spec, given)
    spec = replace(spec, objective=_objective(context, spec, entries.objective))
    workers = entries.workers if workers is None else workers
    spec = _with_search(context, spec)
    campaign = make_campaign(spec, new_folder() if out is None else out, workers)
    limit = limit_of_search(spec, spec.from_roads)
    text = (
        f"Searching with {spec.strategy.word} for roads on which {spec.driver.word} fails"
        f" in {spec.simulator.word}, seed {spec.seed}; speed limit {limit}"
    )
    search(campaign, results.run, text, as_json, spec.seed, fail_on_failure=fail_on_failure)


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
