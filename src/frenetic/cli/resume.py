"""The command that resumes a campaign: resume."""

from __future__ import annotations

from contextlib import chdir
from pathlib import Path
from typing import Any

import click
from msgspec import structs

from frenetic._support.words import counted
from frenetic.cli.console import shell
from frenetic.cli.entries import Given, Source, entry_option, moved, place_option, trust_option
from frenetic.cli.options import (
    DURATION,
    as_usage_error,
    campaign_argument,
    json_option,
)
from frenetic.cli.rerun_options import campaign_source
from frenetic.cli.search import fail_on_failure_option, is_finished, make_campaign, search
from frenetic.errors import CampaignError
from frenetic.parts.registry import SIMULATORS
from frenetic.parts.trust import is_here
from frenetic.spec import Budget, Spec
from frenetic.spec.part_record import PARTS


@click.command()
@campaign_argument
@click.option("--simulations", type=int, metavar="N", help="N more drives.")
@click.option("--time", "seconds", type=DURATION, help="This much more time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="N more failures.")
@entry_option("workers")
@place_option
@trust_option
@fail_on_failure_option
@json_option
def resume(
    campaign: Path,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    workers: Spec | None,
    simulator: Spec | None,
    is_trusted: bool,
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
    from frenetic.campaign.configuration import SPEC, decode_budget, owner_of
    from frenetic.campaign.status import has_judged, is_told, next_campaign
    from frenetic.parts.versions import edited_files
    from frenetic.report import results

    with CampaignStore.open(campaign) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        spent, has_drives = store.elapsed(), has_judged(store)
        source = None if config.get(SPEC) is None else campaign_source(store)
    if owner := owner_of(config):
        raise click.UsageError(f"{campaign} {owner.summary}: {owner.advice}")
    if is_told(config):
        raise click.UsageError(
            f"{campaign} is told its results: 'frenetic ask-tell --out {shell(campaign)}' goes on"
        )
    if source is None:
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
        spec = source.spec
        if any(more is not None for more in given.values()):
            limits = {k: None if v is None else done[k] + v for k, v in given.items()}
            spec = spec.with_budget(Budget(**limits))
        elif "budget" in facts:
            spec = spec.with_budget(decode_budget(facts["budget"]))
        spec, folder = _trusted(spec, simulator, source, is_trusted=is_trusted)
        place = Path.cwd()
        with chdir(folder):
            names = [*(spec.part(kind).name for kind in PARTS), spec.named_objective]
            if edited := " and ".join(edited_files(names, source.sources)):
                how = {"has_drives": has_drives, "names_parts": is_here(place)}
                new = next_campaign(spec, campaign, **how)
                raise CampaignError(
                    f"{edited} was edited, and {campaign} tests it as it was: restore it, or {new}"
                )
            if SIMULATORS.is_own(spec.part("simulator").name):
                spec = moved(spec, simulator)
        assert spec.budget is not None
        budget = spec.budget
        is_spent = budget.spent(done["simulations"], spent, done["failures"]) >= 1.0
        if is_spent and is_finished(campaign, facts):
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    spec = structs.replace(spec, workers=workers and workers.workers)
    the_campaign = make_campaign(spec, campaign, folder)
    tests = counted(counts.tests, "test")
    text = f"Going on after {tests} with {spec.part('strategy')}"
    if is_spent:
        text = f"Finishing after {tests}, which spent the budget"
    search(the_campaign, results.resume, text, as_json, spec.seed, fail_on_failure=fail_on_failure)


def _trusted(
    spec: Spec, simulator: Spec | None, source: Source, *, is_trusted: bool
) -> tuple[Spec, Path]:
    """The spec with its simulator where that is now, and its folder, see `Given.trusted`.

    Args:
        spec: of the campaign.
        simulator: says where that is now, which names it, too.
        source: the campaign.
        is_trusted: whether the command trusts it.
    """
    name = spec.part("simulator").name
    named = Spec() if simulator is None else Spec.of({"simulator": name}, simulator)
    given = Given(named, is_trusted=is_trusted, kinds=("simulator",))
    # Where a user's own simulator can be, only its class says, which is loaded afterwards.
    made = spec if SIMULATORS.is_own(name) else moved(spec, simulator)
    return given.trusted(made, source, left_out=("workers",))
