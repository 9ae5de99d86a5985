"""The command that resumes a campaign: resume."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import chdir
from pathlib import Path
from typing import Any

import click
from msgspec import structs

from frenetic._support.words import counted
from frenetic.cli.console import shell
from frenetic.cli.entries import (
    CommandOptions,
    PartsSource,
    entry_option,
    moved,
    place_option,
    trust_option,
)
from frenetic.cli.options import (
    DURATION,
    as_usage_error,
    campaign_argument,
    json_option,
)
from frenetic.cli.rerun_options import campaign_source
from frenetic.cli.search import fail_on_failure_option, make_campaign, search
from frenetic.errors import CampaignError
from frenetic.parts.registry import SIMULATORS
from frenetic.parts.trust import is_here
from frenetic.spec import Budget, Spec


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

    The campaign's log is replayed to a fresh strategy. So an interrupted campaign ends as if it had
    never been interrupted, exactly so if its budget counts simulations or failures. The command
    refuses parts that were edited since: a driver's source, a module that it imports, a file that
    is its argument. A campaign that was killed between its last result and its report gets what is
    missing, also where a report of an earlier end is left. --simulations, --time and --failures add
    to what is spent. If BeamNG.tech has moved, give its new place with --simulator, which holds for
    this command only.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.advice import has_judged_drive
    from frenetic.campaign.configuration import SPEC
    from frenetic.report import results
    from frenetic.report.html.campaign import has_report

    with CampaignStore.open(campaign) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        seconds_spent, has_drives = store.elapsed(), has_judged_drive(store)
        source = None if config.get(SPEC) is None else campaign_source(store)
        is_reported = has_report(store)
    source = _require_search(campaign, config, source)
    more = {"simulations": simulations, "time": seconds, "failures": failures}
    spent = {
        "simulations": counts.simulations,
        "time": seconds_spent,
        "failures": counts.failed,
    }
    with as_usage_error():
        spec = _with_more_budget(source.spec, more, spent, facts)
        spec, folder = _trusted(spec, simulator, source, is_trusted=is_trusted)
        place = Path.cwd()
        with chdir(folder):
            names_parts = is_here(place)
            _refuse_edited_parts(
                spec, source, campaign, has_drives=has_drives, names_parts=names_parts
            )
            if SIMULATORS.is_own(spec.part("simulator").name):
                spec = moved(spec, simulator)
        assert spec.budget is not None
        is_spent = spec.budget.spent(counts.simulations, seconds_spent, counts.failed) >= 1.0
        if is_spent and is_reported:
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    spec = structs.replace(spec, workers=workers and workers.workers)
    the_campaign = make_campaign(spec, campaign, folder)
    text = _beginning(spec, counts.tests, is_spent=is_spent)
    search(the_campaign, results.resume, text, as_json, spec.seed, fail_on_failure=fail_on_failure)


def _beginning(spec: Spec, tests: int, *, is_spent: bool) -> str:
    """Return the line with which the command begins, after a number of tests."""
    if is_spent:
        return f"Finishing after {counted(tests, 'test')}, which spent the budget"
    return f"Going on after {counted(tests, 'test')} with {spec.part('strategy')}"


def _require_search(
    campaign: Path, config: Mapping[str, object], source: PartsSource | None
) -> PartsSource:
    """Return the source of a campaign's parts, if ``frenetic resume`` can go on with the campaign.

    Raises:
        click.UsageError: another command or program goes on with the campaign.
    """
    from frenetic.campaign.configuration import owner_of
    from frenetic.campaign.stored_spec import is_client_driven

    if owner := owner_of(config):
        raise click.UsageError(f"{campaign} {owner.summary}: {owner.advice}")
    if is_client_driven(config):
        raise click.UsageError(
            f"{campaign} gets its results from another program: 'frenetic ask-tell --out"
            f" {shell(campaign)}' goes on with it"
        )
    if source is None:
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    return source


def _with_more_budget(
    spec: Spec,
    more: Mapping[str, float | None],
    spent: Mapping[str, float],
    facts: Mapping[str, Any],
) -> Spec:
    """Return a campaign's spec with its present budget, to which options add.

    Args:
        spec: the campaign's spec.
        more: name of a limit -> amount that an option adds; None without the option.
        spent: name of a limit -> amount that is spent.
        facts: the campaign's facts.

    Raises:
        ValueError: an added amount is not positive.
    """
    from frenetic.campaign.configuration import decode_budget

    for name, amount in more.items():
        if amount is not None and amount <= 0:
            raise ValueError(f"{name} is {amount}: more than 0 is needed")
    if any(amount is not None for amount in more.values()):
        limits: dict[str, Any] = {
            name: None if amount is None else spent[name] + amount for name, amount in more.items()
        }
        return spec.with_budget(Budget(**limits))
    if "budget" in facts:
        return spec.with_budget(decode_budget(facts["budget"]))
    return spec


def _refuse_edited_parts(
    spec: Spec, source: PartsSource, campaign: Path, *, has_drives: bool, names_parts: bool
) -> None:
    """Refuse a campaign whose parts were edited after it began; call it in the parts' folder.

    Args:
        spec: the campaign's spec.
        source: the campaign as a source of parts.
        campaign: folder of the campaign.
        has_drives: whether the campaign has judged drives.
        names_parts: whether the advice names the parts, see `next_campaign`.

    Raises:
        CampaignError: a file of a part was edited.
    """
    from frenetic.campaign.advice import next_campaign
    from frenetic.parts.versions import edited_files
    from frenetic.spec.part_record import PARTS

    names = [*(spec.part(kind).name for kind in PARTS), spec.named_objective]
    if edited := " and ".join(edited_files(names, source.sources)):
        new = next_campaign(spec, campaign, has_drives=has_drives, names_parts=names_parts)
        raise CampaignError(
            f"{edited} was edited, and {campaign} tests it as it was: restore it, or {new}"
        )


def _trusted(
    spec: Spec, simulator: Spec | None, source: PartsSource, *, is_trusted: bool
) -> tuple[Spec, Path]:
    """Return the spec with its simulator where that is now, and the folder of the parts.

    See `CommandOptions.trusted`.

    Args:
        spec: the campaign's spec.
        simulator: place of the simulator now, from ``--simulator``.
        source: the campaign as a source of parts.
        is_trusted: whether the command says ``--trust``.
    """
    name = spec.part("simulator").name
    named = Spec() if simulator is None else Spec.of({"simulator": name}, simulator)
    options = CommandOptions(named, is_trusted=is_trusted, kinds=("simulator",))
    # Only the class of a user's own simulator says where it can be, and it is loaded afterwards.
    placed = spec if SIMULATORS.is_own(name) else moved(spec, simulator)
    return options.trusted(placed, source, left_out=("workers",))
