"""The command `check`, which looks for damage in a campaign's database."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import click

from frenetic._support.words import counted
from frenetic.cli import echo
from frenetic.cli.console import print_facts
from frenetic.cli.options import campaign_argument, json_option

MAX_FINDINGS: Final = 20
"""Largest number of findings that are printed (our choice); the JSON has all."""


@click.command()
@campaign_argument
@click.option(
    "--deep",
    "is_deep",
    is_flag=True,
    help="Measure the values of all drives' segments again, not of 500 drives only.",
)
@json_option
def check(campaign: Path, is_deep: bool, as_json: bool) -> None:
    """Check the database of a CAMPAIGN, and say what it holds.

    The command reads everything and changes nothing, also while the campaign runs. Each fault is a
    finding, which is printed in a line; the exit code is 1 if there are findings, otherwise 0.
    """
    from frenetic.campaign.check import check_campaign

    report = check_campaign(campaign, is_deep=is_deep)
    counts, findings = report.counts, report.findings
    outstanding = report.asked - counts.result_count
    if as_json:
        values = {
            "folder": str(report.folder),
            "findings": findings,
            **counts.counts_json(),
            "outstanding": outstanding,
            "trajectories": report.trajectories,
            "bytes": report.size,
        }
        echo(json.dumps(values))
    else:
        results = counts.result_count
        per_result = f", {report.size / 1e3 / results:.1f} kB per result" if results else ""
        print_facts(
            [
                ("campaign", str(report.folder)),
                ("results", counts.as_text()),
                ("waiting", f"{outstanding:,} candidates without a result"),
                ("drives", f"{report.trajectories:,} trajectories"),
                ("on disk", f"{report.size / 1e6:,.1f} MB{per_result}"),
            ]
        )
        for finding in findings[:MAX_FINDINGS]:
            echo(finding)
        if len(findings) > MAX_FINDINGS:
            echo(f"{len(findings) - MAX_FINDINGS:,} more")
        text = counted(len(findings), "finding") if findings else "nothing is wrong"
        print_facts([("check", text)])
    if findings:
        raise click.exceptions.Exit(1)
