"""The command `run`, which searches for failing roads."""

from __future__ import annotations

import secrets
from contextlib import chdir
from pathlib import Path
from typing import Any

import click

from frenetic.cli.command_options import CommandOptions, PartsSource
from frenetic.cli.drive_facts import limit_of_search
from frenetic.cli.entries import entry_options, part_options, trust_option
from frenetic.cli.options import DEFAULT_SIMULATIONS, SEED_LIMIT, folder_option, json_option
from frenetic.cli.search import fail_on_failure_option, make_campaign, search
from frenetic.conditions.condition import as_text
from frenetic.parts.trust import is_here
from frenetic.spec import Spec
from frenetic.spec.budget import LIMITS
from frenetic.spec.parts import PARTS


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False, metavar="[FILE.toml]")
@entry_options(*LIMITS, "strategy", "roads", "odd")
@part_options
@entry_options(
    *("criteria", "map_size", "workers", "objective", "start_from", "from_roads", "seed"),
)
@trust_option
@folder_option("Folder for the results. [default: a new one under campaigns/]")
@fail_on_failure_option
@json_option
@click.pass_context
def run(
    context: click.Context,
    /,
    file: Path | None,
    out: Path | None,
    fail_on_failure: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Search for roads on which a driver leaves its lane.

    Without options, 1000 drives of the built-in planner go into a new folder under campaigns/. The
    first "Stop after" that is reached ends the search; so does Ctrl-C. FILE.toml, such as a
    campaign's campaign.toml, sets what options set; options win.
    """
    from frenetic.campaign import new_folder
    from frenetic.report import results

    options = CommandOptions.of(context)
    file_spec = Spec() if file is None else Spec.read(file)
    source = None if file is None else PartsSource(file, file_spec)
    spec, code_folder = options.trusted(
        options.over(file_spec, roads_are_given=False), source, left_out=()
    )
    options.check_drawn(spec)
    if not is_here(code_folder):
        spec = spec.with_roads_from(Path.cwd())
    with chdir(code_folder):
        spec = _with_defaults(spec)
    campaign = make_campaign(spec, new_folder() if out is None else out, code_folder)
    strategy, driver, simulator = map(spec.part, PARTS)
    conditions = f" with {as_text(spec.conditions)}" if spec.conditions else ""
    strategy_options = getattr(campaign.strategy, "options", {})
    announcement = (
        f"Searching with {strategy} for roads on which {driver} fails in {simulator}{conditions},"
        f" seed {spec.seed}; speed limit"
        f" {limit_of_search(campaign.tester.setting, spec.from_roads, strategy_options)}"
    )
    search(
        campaign,
        results.run,
        announcement=announcement,
        seed=spec.seed,
        as_json=as_json,
        fail_on_failure=fail_on_failure,
    )


def _with_defaults(spec: Spec) -> Spec:
    """Return the spec with a budget, a seed and `max_in_flight`, which the campaign records."""
    from frenetic.campaign import MAX_IN_FLIGHT
    from frenetic.parts.registry import STRATEGIES

    defaults: dict[str, Any] = {}
    if spec.budget is None:
        defaults["simulations"] = DEFAULT_SIMULATIONS
    if spec.seed is None:
        defaults["seed"] = secrets.randbelow(SEED_LIMIT)
    if spec.max_in_flight is None:
        strategy = STRATEGIES.load(spec.part("strategy").name)
        max_in_flight = getattr(strategy, "default_max_in_flight", None) or MAX_IN_FLIGHT
        defaults["max_in_flight"] = max_in_flight
    return Spec.of(spec, defaults)
