"""The command `resume`, which continues a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import chdir
from pathlib import Path
from typing import Any

import click
from msgspec import structs

from frenetic._support.words import counted
from frenetic.cli.command_options import CommandOptions, PartsSource
from frenetic.cli.console import shell
from frenetic.cli.entries import entry_option, trust_option
from frenetic.cli.options import (
    DURATION_TYPE,
    as_usage_error,
    campaign_argument,
    json_option,
)
from frenetic.cli.rerun_options import campaign_source
from frenetic.cli.search import fail_on_failure_option, make_campaign, search
from frenetic.cli.simulator_place import moved, place_option
from frenetic.errors import CampaignError
from frenetic.parts.registry import SIMULATORS
from frenetic.parts.trust import is_here
from frenetic.spec import Budget, Spec


@click.command()
@campaign_argument
@click.option("--simulations", type=int, metavar="N", help="Stop after N more drives.")
@click.option(
    "--time", "seconds", type=DURATION_TYPE, help="Stop after this much more time: 90s, 10m, 1h30m."
)
@click.option("--failures", type=int, metavar="N", help="Stop after N more failures.")
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
    never been interrupted: exactly if its budget counts simulations or failures, nearly if it is a
    time. The command refuses parts that were edited since: a driver's source, a module that it
    imports, a file that is its argument. If the campaign was killed between its last result and its
    report, the report is written, also over a report of an earlier end. --simulations, --time and
    --failures set a new budget beyond what is spent, without the other limits; without these
    options the last budget holds. If BeamNG.tech has moved, give its new place with --simulator,
    which holds for this command only.
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
    added = {"simulations": simulations, "time": seconds, "failures": failures}
    spent = {
        "simulations": counts.simulations,
        "time": seconds_spent,
        "failures": counts.failed,
    }
    with as_usage_error():
        spec = _with_budget(source.spec, added, spent, recorded_budget=facts.get("budget"))
        spec, parts_folder = _trusted(spec, simulator, source, is_trusted=is_trusted)
        # Elsewhere, the names of the parts in an advised command would mean other parts.
        names_parts = is_here(parts_folder)
        with chdir(parts_folder):
            _refuse_edited_parts(
                spec, source, campaign, has_drives=has_drives, names_parts=names_parts
            )
            if SIMULATORS.is_own(spec.part("simulator").name):
                spec = moved(spec, simulator)  # it is trusted by now, so its class may be loaded
        assert spec.budget is not None
        is_spent = spec.budget.spent(counts.simulations, seconds_spent, counts.failed) >= 1.0
        if is_spent and is_reported:
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    spec = structs.replace(spec, workers=None if workers is None else workers.workers)
    resumed = make_campaign(spec, campaign, parts_folder)
    text = _first_line(spec, counts.tests, is_spent=is_spent)
    search(resumed, results.resume, text, as_json, spec.seed, fail_on_failure=fail_on_failure)


def _first_line(spec: Spec, tests: int, *, is_spent: bool) -> str:
    """Return the first line that the command prints, after a number of earlier tests."""
    if is_spent:
        return f"Finishing after {counted(tests, 'test')}, which spent the budget"
    return f"Continuing after {counted(tests, 'test')} with {spec.part('strategy')}"


def _require_search(
    campaign: Path, config: Mapping[str, object], source: PartsSource | None
) -> PartsSource:
    """Return the source of a campaign's parts, if ``frenetic resume`` can continue the campaign.

    Args:
        campaign: folder of the campaign.
        config: its configuration.
        source: the campaign as a source of parts; None if its parts have no names.

    Raises:
        click.UsageError: another command or program continues the campaign.
    """
    from frenetic.campaign.configuration import owner_of
    from frenetic.campaign.stored_spec import is_client_driven

    if owner := owner_of(config):
        raise click.UsageError(f"{campaign} {owner.summary}: {owner.advice}")
    if is_client_driven(config):
        raise click.UsageError(
            f"{campaign} gets its results from another program: continue it with 'frenetic ask-tell"
            f" --out {shell(campaign)}'"
        )
    if source is None:
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    return source


def _with_budget(
    spec: Spec,
    added: Mapping[str, float | None],
    spent: Mapping[str, float],
    *,
    recorded_budget: object,
) -> Spec:
    """Return a campaign's spec with the budget of the options, or else with its last budget.

    Args:
        spec: the campaign's spec.
        added: name of a limit -> amount that an option adds to what is spent; None without the
            option. One option is enough to replace all limits of the last budget.
        spent: name of a limit -> amount that is spent.
        recorded_budget: budget of the last command, as the campaign records it; None without.

    Raises:
        ValueError: an added amount is not positive, or the recorded budget is damaged.
    """
    from frenetic.campaign.configuration import decode_budget

    for name, amount in added.items():
        if amount is not None and amount <= 0:
            raise ValueError(f"--{name} is {amount}: more than 0 is needed")
    if any(amount is not None for amount in added.values()):
        limits: dict[str, Any] = {
            name: None if amount is None else spent[name] + amount for name, amount in added.items()
        }
        return spec.with_budget(Budget(**limits))
    if recorded_budget is not None:
        return spec.with_budget(decode_budget(recorded_budget))
    return spec


def _refuse_edited_parts(
    spec: Spec, source: PartsSource, campaign: Path, *, has_drives: bool, names_parts: bool
) -> None:
    """Refuse a campaign whose parts were edited after it began.

    The current folder has to be the folder of the parts, since their files are read again.

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
    from frenetic.spec.parts import PARTS

    names = [*(spec.part(kind).name for kind in PARTS), spec.named_objective]
    if edited := list(edited_files(names, source.sources)):
        advice = next_campaign(spec, campaign, has_drives=has_drives, names_parts=names_parts)
        raise CampaignError(
            f"{' and '.join(edited)} {'was' if len(edited) == 1 else 'were'} edited after"
            f" {campaign} began: restore {'it' if len(edited) == 1 else 'them'}, or {advice}"
        )


def _trusted(
    spec: Spec, simulator: Spec | None, source: PartsSource, *, is_trusted: bool
) -> tuple[Spec, Path]:
    """Return the spec whose code the user trusts, and the folder of the parts.

    A built-in or installed simulator is where ``--simulator`` says. The class of a user's own
    simulator may be loaded only after this check, so the caller applies the option to it.

    Args:
        spec: the campaign's spec.
        simulator: place of the simulator now, from ``--simulator``.
        source: the campaign as a source of parts.
        is_trusted: whether the command line has ``--trust``.

    Raises:
        FreneticError: the campaign names code that this user has not trusted.
    """
    name = spec.part("simulator").name
    named = Spec() if simulator is None else Spec.of({"simulator": name}, simulator)
    options = CommandOptions(named, is_trusted=is_trusted, parameters=("simulator",))
    if not SIMULATORS.is_own(name):
        spec = moved(spec, simulator)
    return options.trusted(spec, source, left_out=("workers",))
