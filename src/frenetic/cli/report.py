"""The command `report`, which writes a campaign's report."""

from __future__ import annotations

import json
from pathlib import Path

import click

from frenetic.cli import echo
from frenetic.cli.options import campaign_argument, file_option, json_option


@click.command()
@campaign_argument
@file_option("--out", "File for the report. [default: report.html in the campaign's folder]")
@json_option
def report(campaign: Path, out: Path | None, as_json: bool) -> None:
    """Write the report of a CAMPAIGN: its failures, with pictures and replays.

    The report is one file that you can keep, send, and open without a network. 'frenetic run' and
    'frenetic resume' write it at their end, too.
    """
    from frenetic.report.html import write_report

    path = write_report(campaign, out)
    echo(json.dumps({"report": str(path)}) if as_json else f"Report:      {path}")
