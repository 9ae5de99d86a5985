"""The command `resume`, which continues a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec import structs

from frenetic._support.words import counted
from frenetic.cli.command_options import CommandOptions, PartsSource
from frenetic.cli.console import shell
from frenetic.cli.entries import entry_option, trust_option
from frenetic.cli.option_types import DURATION_TYPE
from frenetic.cli.options import as_usage_error, campaign_argument, json_option
from frenetic.cli.rerun_options import campaign_source
from frenetic.cli.search import fail_on_failure_option, make_campaign, search
from frenetic.cli.simulator_place import moved, place_option
from frenetic.errors import CampaignError
from frenetic.parts.registry import SIMULATORS
from frenetic.parts.trust import is_here
from frenetic.spec import Budget, Spec

# Modules that would slow down --help are imported inside functions.
if TYPE_CHECKING:
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.counts import Counts


@click.command()
@campaign_argument
@click.option("--simulations", type=int, metavar="N", help="Stop after N more drives.")
@click.option("--time", type=DURATION_TYPE, help="Stop after this much more time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N more failures.")
@click.option("--kilometres", type=float, metavar="KM", help="Stop after KM more kilometres.")
@click.option(
    "--simulated-time", type=DURATION_TYPE, help="Stop after this much more simulated time: 30m."
)
@entry_option("workers", parameter="workers_entry")
@place_option
@trust_option
@fail_on_failure_option
@json_option
def resume(
    campaign: Path,
    workers_entry: Spec | None,
    place_options: Spec | None,
    is_trusted: bool,
    fail_on_failure: bool,
    as_json: bool,
    **added: float | None,
) -> None:
    """Resume the CAMPAIGN in a folder after Ctrl-C, a crash, or the end of its budget.

    A fresh strategy gets the stored results. So an interrupted campaign ends as if it had never
    been interrupted; with a budget of time, it may end a few tests earlier or later.

    --simulations, --time, --failures, --kilometres and --simulated-time set a new budget beyond
    what is spent, and replace all limits of the last budget. Without these options the last budget
    holds.

    --workers and --simulator hold for this command only. If BeamNG.tech has moved, give its new
    place with --simulator.

    The command refuses parts that were edited since the campaign began: a driver's source, a module
    that it imports, a file that is its argument.

    If the campaign was killed between its last result and its report, the command writes the
    report, and replaces the report of an earlier end.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.report import results

    with CampaignStore.open(campaign) as store:
        source, earlier = _require_search(store), _EarlierWork.of(store)
    spec = _with_budget(source.spec, added, earlier)
    spec, parts_folder = _checked_and_moved(
        spec, place_options, source, is_trusted=is_trusted, has_drives=earlier.has_drives
    )
    is_spent = earlier.share_of(spec.budget) >= 1.0
    if is_spent and earlier.is_reported:
        raise click.UsageError(
            f"the budget of {campaign} is spent: say how much more, with --simulations, --time,"
            " --failures, --kilometres or --simulated-time"
        )
    # The workers of the last command are not taken over: they may belong to another machine.
    workers = None if workers_entry is None else workers_entry.workers
    spec = structs.replace(spec, workers=workers)
    search(
        make_campaign(spec, campaign, parts_folder),
        results.resume,
        announcement=_announcement(spec, earlier.counts.tests, is_spent=is_spent),
        seed=spec.seed,
        as_json=as_json,
        fail_on_failure=fail_on_failure,
    )


@dataclass(frozen=True)
class _EarlierWork:
    """What a campaign has done and spent before this command."""

    counts: Counts
    seconds: float
    """Wall time spent on the search, in s."""
    budget: object
    """Budget of the last command, as the campaign records it; None without a record."""
    has_drives: bool
    """Whether the campaign holds a judged drive that no fault of its driver ended."""
    is_reported: bool
    """Whether the campaign has ended, and its report shows all results."""

    @classmethod
    def of(cls, store: CampaignStore) -> _EarlierWork:
        """Return the earlier work of a stored campaign."""
        from frenetic.campaign.advice import has_drive_without_fault
        from frenetic.report.html.campaign import has_report

        return cls(
            store.counts(),
            store.elapsed(),
            store.facts.get("budget"),
            has_drives=has_drive_without_fault(store),
            is_reported=has_report(store),
        )

    @property
    def amounts(self) -> dict[str, float]:
        """Name of a limit -> amount that is spent."""
        return self.counts.amounts(self.seconds)

    def share_of(self, budget: Budget | None) -> float:
        """Return the spent share of a budget, from 0 to 1."""
        assert budget is not None, "a search by a command has a budget"
        return budget.spent(self.amounts)


def _announcement(spec: Spec, tests: int, *, is_spent: bool) -> str:
    """Return the first line that the command prints, after a number of earlier tests."""
    if is_spent:
        return f"Finishing after {counted(tests, 'test')}, which spent the budget"
    return f"Continuing after {counted(tests, 'test')} with {spec.part('strategy')}"


def _require_search(store: CampaignStore) -> PartsSource:
    """Return a campaign as a source of parts, if ``frenetic resume`` can continue it.

    Raises:
        click.UsageError: another command or program continues the campaign.
    """
    from frenetic.campaign.configuration import SPEC, owner_of
    from frenetic.campaign.stored_spec import is_client_driven

    campaign, config = store.folder, store.config
    if owner := owner_of(config):
        raise click.UsageError(f"{campaign} {owner.summary}: {owner.advice}")
    if is_client_driven(config):
        raise click.UsageError(
            f"{campaign} gets its results from another program: continue it with 'frenetic ask-tell"
            f" --out {shell(campaign)}'"
        )
    if config.get(SPEC) is None:
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    return campaign_source(store)


def _with_budget(spec: Spec, added: Mapping[str, float | None], earlier: _EarlierWork) -> Spec:
    """Return a campaign's spec with the budget of the options, or else with the last budget.

    Args:
        spec: the campaign's spec.
        added: name of a limit -> amount that an option adds to what is spent; None without the
            option. One option is enough to replace all limits of the last budget.
        earlier: what the campaign has spent, and its last budget.

    Raises:
        click.UsageError: an added amount is not positive, or the recorded budget is damaged.
    """
    from frenetic.campaign.configuration import decode_budget

    for name, amount in added.items():
        if amount is not None and amount <= 0:
            option = f"--{name.replace('_', '-')}"
            raise click.UsageError(f"{option} is {amount:g}: more than 0 is needed")
    with as_usage_error():
        if any(amount is not None for amount in added.values()):
            limits: dict[str, Any] = {
                name: None if amount is None else earlier.amounts[name] + amount
                for name, amount in added.items()
            }
            return spec.with_budget(Budget(**limits))
        if earlier.budget is not None:
            return spec.with_budget(decode_budget(earlier.budget))
    return spec


def _checked_and_moved(
    spec: Spec,
    place_options: Spec | None,
    source: PartsSource,
    *,
    is_trusted: bool,
    has_drives: bool,
) -> tuple[Spec, Path]:
    """Return the spec with its simulator where ``--simulator`` says, and the folder of its parts.

    The order of the steps protects the user: only the last one loads code of the user's, and by
    then the user has trusted this code, and it is as it was when the campaign began.

    1. Move a simulator of Frenetic's. Its place may be a program, and the user need not trust the
       recorded program if ``--simulator`` names another.
    2. Check that the user trusts the code that the campaign names.
    3. In the folder of the parts, refuse parts that were edited.
    4. Move a simulator of the user's or of another package. Its class is loaded, since the class
       declares which options say where it is.

    Args:
        spec: the campaign's spec.
        place_options: value of ``--simulator``; None without the option.
        source: the campaign as a source of parts.
        is_trusted: whether the command line has ``--trust``.
        has_drives: whether a drive was judged that no fault of its driver ended.

    Raises:
        FreneticError: the campaign names code that the user has not trusted, or a part was edited.
        click.UsageError: ``--simulator`` says more than a place.
    """
    name = spec.part("simulator").name
    is_outside_frenetic = SIMULATORS.is_own(name)
    with as_usage_error():
        named = Spec() if place_options is None else Spec.of({"simulator": name}, place_options)
    options = CommandOptions(named, is_trusted=is_trusted, parameters=("simulator",))
    if not is_outside_frenetic:
        spec = moved(spec, place_options)
    spec, parts_folder = options.trusted(spec, source, left_out=("workers",))
    may_name_parts = is_here(parts_folder)  # asked now, since chdir makes it true
    with chdir(parts_folder):
        _refuse_edited_parts(spec, source, has_drives=has_drives, may_name_parts=may_name_parts)
        if is_outside_frenetic:
            spec = moved(spec, place_options)
    return spec, parts_folder


def _refuse_edited_parts(
    spec: Spec, source: PartsSource, *, has_drives: bool, may_name_parts: bool
) -> None:
    """Refuse a campaign whose parts were edited after it began.

    The current folder has to be the folder of the parts, since their files are read again.

    Args:
        spec: the campaign's spec.
        source: the campaign as a source of parts.
        has_drives: whether the campaign has a judged drive that no fault of its driver ended.
        may_name_parts: whether the advised command may name the parts: only if the user is in
            their folder, since in another folder the names would mean other parts.

    Raises:
        CampaignError: a file of a part was edited.
    """
    from frenetic.campaign.advice import new_campaign_advice
    from frenetic.parts.versions import edited_files
    from frenetic.spec.parts import PARTS

    names = [*(spec.part(kind).name for kind in PARTS), spec.named_objective]
    if edited := list(edited_files(names, source.sources)):
        advice = new_campaign_advice(
            spec, source.path, starts_from_drives=has_drives, names_parts=may_name_parts
        )
        raise CampaignError(
            f"{' and '.join(edited)} {'was' if len(edited) == 1 else 'were'} edited after"
            f" {source.path} began: restore {'it' if len(edited) == 1 else 'them'}, or {advice}"
        )
