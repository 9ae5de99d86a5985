"""The command that resumes a campaign: resume."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from msgspec import structs

from frenetic._support.words import counted
from frenetic.cli.console import shell
from frenetic.cli.entries import entry_option, moved, place_option
from frenetic.cli.options import (
    DURATION,
    as_usage_error,
    campaign_argument,
    json_option,
)
from frenetic.cli.search import fail_on_failure_option, is_finished, make_campaign, search
from frenetic.errors import CampaignError
from frenetic.spec import Budget, Spec


@click.command()
@campaign_argument
@click.option("--simulations", type=int, metavar="N", help="N more drives.")
@click.option("--time", "seconds", type=DURATION, help="This much more time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="N more failures.")
@entry_option("workers")
@place_option
@fail_on_failure_option
@json_option
def resume(
    campaign: Path,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    workers: Spec | None,
    simulator: Spec | None,
    fail_on_failure: bool,
    as_json: bool,
) -> None:
    """Resume the CAMPAIGN in a folder after Ctrl-C, a crash, or the end of its budget.

    Its log is replayed to a fresh strategy, so an interrupted campaign ends as if it had never been
    interrupted: exactly so if its budget counts simulations or failures. A part that was changed
    since, such as a driver's source, a module that it imports or a file that is its argument, is
    refused. A campaign that was killed between its last result and its report gets what is missing.
    A given budget is added to what is spent. If BeamNG.tech has moved, give its new place with
    --simulator, which holds for this time.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.campaign import SOURCES, STARTED_IN
    from frenetic.campaign.configuration import (
        SPEC,
        decode_budget,
        recorded_spec,
        with_budget,
    )
    from frenetic.campaign.state import has_judged, is_told, next_campaign
    from frenetic.campaign.store import DATABASE
    from frenetic.report import results
    from frenetic.versions import edited_files

    with CampaignStore.open(campaign) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        spent, sources = store.elapsed(), store.fact(SOURCES)
        started_in = str(store.fact(STARTED_IN) or "")
        has_drives = has_judged(store)
    if "entrant" in config:
        raise click.UsageError(
            f"{campaign} is a run of a bench, which keeps its budget: what a bench lacks is run by"
            " 'frenetic bench --resume --out BENCH'"
        )
    if "again" in config:
        raise click.UsageError(
            f"{campaign} does not search: the command that began it, 'frenetic rerun', 'minimise',"
            " 'compare' or 'estimate', goes on with it"
        )
    if is_told(config):
        raise click.UsageError(
            f"{campaign} is told its results: 'frenetic ask-tell --out {shell(campaign)}' goes on"
        )
    if config.get(SPEC) is None:
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    given = {"simulations": simulations, "time": seconds, "failures": failures}
    done: dict[str, Any] = {
        "simulations": counts.simulations,
        "time": spent,
        "failures": counts.failed,
    }
    with as_usage_error():
        for name, more in given.items():
            if more is not None and more <= 0:
                raise ValueError(f"{name} is {more}: more than 0 is needed")
        spec = recorded_spec(config, source=campaign / DATABASE)
        if any(more is not None for more in given.values()):
            limits = {k: None if v is None else done[k] + v for k, v in given.items()}
            spec = with_budget(spec, Budget(**limits))
        elif "budget" in facts:
            spec = with_budget(spec, decode_budget(facts["budget"]))
        if edited := " and ".join(edited_files(spec.names, sources)):
            raise CampaignError(
                f"{edited} was edited, and {campaign} tests it as it was: restore it, or"
                f" {next_campaign(spec, campaign, has_drives=has_drives)}"
            )
        new = f"start a new campaign from this one: frenetic run --from {shell(campaign)}"
        spec.require_trusted(campaign, remedy=f"if you trust it, {new}", started_in=started_in)
        assert spec.budget is not None
        budget = spec.budget
        is_spent = budget.spent(done["simulations"], spent, done["failures"]) >= 1.0
        if is_spent and is_finished(campaign, facts):
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    spec = structs.replace(moved(spec, simulator), workers=workers and workers.workers)
    the_campaign = make_campaign(spec, campaign)
    tests = counted(counts.tests, "test")
    text = f"Going on after {tests} with {spec.part('strategy')}"
    if is_spent:
        text = f"Finishing after {tests}, which spent the budget"
    search(the_campaign, results.resume, text, as_json, spec.seed, fail_on_failure=fail_on_failure)
