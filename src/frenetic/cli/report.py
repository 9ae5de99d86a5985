"""The command that writes a campaign's report: report."""

from __future__ import annotations

import json
import webbrowser
from pathlib import Path

import click

from frenetic.cli.options import campaign_argument, file_option, json_option


@click.command()
@campaign_argument
@file_option("--out", "Where to. [default: report.html in the campaign's folder]")
@click.option("--open", "shown", is_flag=True, help="Show it in the browser.")
@json_option
def report(campaign: Path, out: Path | None, shown: bool, as_json: bool) -> None:
    """Write the report of a CAMPAIGN: its failures, with pictures and replays.

    It is one file that you can keep, send, and open without a network. 'frenetic run' and 'frenetic
    resume' write it at their end, too.
    """
    from frenetic.report.html import write_report

    path = write_report(campaign, out)
    click.echo(json.dumps({"report": str(path)}) if as_json else f"Report:      {path}")
    if shown and not _show(path):
        click.echo("There is no browser here: open the file in one.", err=True)


def _show(path: Path) -> bool:
    """Opens a file in the browser; returns whether there is one."""
    try:
        return webbrowser.open(path.resolve().as_uri())
    except webbrowser.Error:
        return False
