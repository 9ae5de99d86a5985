"""A command that counts the tests of a campaign."""

from pathlib import Path

import click

from frenetic import CampaignStore


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
def count(campaign: Path) -> None:
    """lane-lab counts the tests of a CAMPAIGN."""
    with CampaignStore.open(campaign) as store:
        click.echo(f"{store.counts().tests} tests")
