"""The command that writes a campaign for other tools: export."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import click

from frenetic.cli.console import Log, counted_progress
from frenetic.cli.options import CampaignFolder, folder_option, json_option
from frenetic.outcome import Outcome

# `Format`, `Which` and `Sides` of `frenetic.export`, which take longer to import than help may.
FORMATS: Final = ("parquet", "csv", "json", "competition")
TRAJECTORIES: Final = ("all", "failures", "none")
SIDES: Final = ("geometry", "competition")


@click.command()
@click.argument("campaign", type=CampaignFolder())
@click.option(
    "--format",
    "name",
    type=click.Choice(FORMATS),
    required=True,
    help="What to write; all but competition need the extra 'tables'.",
)
@folder_option(
    "Folder to write, empty or not there yet. [default: exports/FORMAT in the campaign's]"
)
@click.option(
    "--outcome",
    "outcomes",
    type=click.Choice([str(outcome) for outcome in Outcome], case_sensitive=False),
    multiple=True,
    help="Only tests with this outcome; may be repeated. [default: all]",
)
@click.option(
    "--trajectories",
    type=click.Choice(TRAJECTORIES),
    default="all",
    show_default=True,
    help="Of which tests to write what was driven.",
)
@click.option(
    "--sides",
    type=click.Choice(SIDES),
    default="geometry",
    show_default=True,
    help="How the competition's oob_stats.csv tells left from right: by where the car was, or by"
    " the official script's rule.",
)
@json_option
def export(
    campaign: Path,
    name: Any,
    out: Path | None,
    outcomes: tuple[str, ...],
    trajectories: Any,
    sides: Any,
    as_json: bool,
) -> None:
    """Write the tests of a CAMPAIGN and their trajectories, for pandas, DuckDB and others.

    Prints the folder with the files, which is written completely or not at all.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.export import export_campaign

    log = Log()
    with CampaignStore.open(campaign) as store, counted_progress(log, "Exporting") as show:
        counts = store.counts()
        folder = export_campaign(
            store,
            name,
            out,
            outcomes=outcomes,
            trajectories=trajectories,
            sides=sides,
            on_progress=show,
        )
    if as_json:
        document = {"folder": str(folder), "format": name, "outcomes": list(outcomes)}
        click.echo(json.dumps({**document, "campaign": counts.counts_json()}))
        return
    log.print(f"The campaign holds {counts.in_words()}", markup=False)
    click.echo(folder)
