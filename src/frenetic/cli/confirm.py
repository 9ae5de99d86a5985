"""The command that drives a campaign's failures in another simulator: confirm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted
from frenetic.cli.console import Log, print_table, two_digits
from frenetic.cli.options import CampaignFolder, GroupedCommand, count_option
from frenetic.cli.parts import PROFILE
from frenetic.cli.redrive import (
    chosen_tests,
    interrupted,
    recorded_spec,
    redriving_options,
    say_where,
    shown_driving,
)

if TYPE_CHECKING:
    from frenetic.redrive.confirm import Confirmation


@click.command(cls=GroupedCommand)
@click.argument("campaign", type=CampaignFolder())
@click.argument("test_ids", type=int, nargs=-1, metavar="[ID]...")
@count_option("--top", "The N most telling failures. [default: 10]")
@redriving_options
def confirm(
    campaign: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    workers: int,
    drive_limit: float | None,
    out: Path | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Drive failures of a CAMPAIGN in another simulator and say which it confirms.

    Each road is driven where it lay on the map, with the campaign's options unless others are
    given. A failure is confirmed if the driver has the same failure in the other simulator: on the
    same side within 30 m along the road, and with the same mechanism, which means that road,
    offsets and speeds before it differ by at most 2 m, as within one distinct failure. The same
    command goes on with an interrupted one, and shows a complete one. Pictures of both paths are in
    confirmed/.
    """
    from frenetic.analysis.failures import LISTED
    from frenetic.campaign import CampaignStore
    from frenetic.redrive.confirm import confirm as confirm_failures
    from frenetic.redrive.confirm import confirmation_document
    from frenetic.spec import describe
    from frenetic.versions import differences

    if not any(given.get(name) for name in ("simulator", "simulator_options", PROFILE)):
        raise click.UsageError(
            "say in which simulator, with --simulator, --simulator-option or --profile; 'frenetic"
            " regression' drives again in the same"
        )
    with CampaignStore.open(campaign) as store:
        chosen = chosen_tests(store, test_ids, top if test_ids else top or LISTED)
        spec = recorded_spec(store, given)
        recorded = store.config
    if not chosen:
        click.echo("[]" if as_json else f"{campaign} holds no failure")
        return
    driver, simulator = spec.make_parts(isolate=workers == 1, drive_limit=drive_limit)
    log = Log()
    ours = {"simulator": describe(simulator), "driver": describe(driver)}
    if not any(differences(kind, recorded.get(kind), one) for kind, one in ours.items()):
        log.print("These are the campaign's own simulator and driver: what fails is to fail again.")
    with shown_driving(log, "Driving") as hooks:
        confirmation = confirm_failures(
            campaign,
            simulator,
            driver,
            test_ids=chosen,
            workers=workers,
            drive_limit=drive_limit,
            out=out,
            **hooks,
        )
    if as_json:
        click.echo(json.dumps(confirmation_document(confirmation)))
    else:
        _print(confirmation)
        if confirmation.tests:
            say_where(campaign, confirmation.folder, out)
    gallery = _draw(log, campaign, out or campaign, confirmation)
    if gallery is not None and not as_json:
        click.echo(f"At a glance: {gallery}")
    if confirmation.missing:
        left = counted(confirmation.missing, "road")
        raise interrupted(log, f"{left} to go; the same command goes on")
    if not any(test.other.outcome.is_driven for test in confirmation.tests):
        raise click.exceptions.Exit(1)


def _draw(log: Log, campaign: Path, out: Path, confirmation: Confirmation) -> Path | None:
    from frenetic.campaign import CampaignStore
    from frenetic.report.confirmation import write_confirmation  # matplotlib imports slowly

    with log.status("Drawing both paths"), CampaignStore.open(campaign) as store:
        return write_confirmation(store, confirmation, out)


def _print(confirmation: Confirmation) -> None:
    if confirmation.tests:
        print_table(
            (">test", ">MOOBD (m)", ">there (m)", "it is", "how", "what happened there"),
            [
                (
                    test.test_id,
                    two_digits(test.recorded.moobd),
                    two_digits(test.other.moobd),
                    test.agreement,
                    test.match,
                    test.reason,
                )
                for test in confirmation.tests
            ],
        )
    click.echo(f"{counted(len(confirmation.tests), 'failure')}: {confirmation}")
    correlation = confirmation.correlation
    if correlation is None:
        click.echo("rank correlation of MOOBD: too few roads to say")
    else:
        click.echo(
            f"rank correlation of MOOBD: {correlation.spearman:.2f} (Spearman,"
            f" p = {correlation.p:.2g}, {correlation.pairs} roads)"
        )
