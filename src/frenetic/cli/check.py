"""The command that checks a campaign's database: check."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli.console import Log, counted_progress, print_facts
from frenetic.cli.options import campaign_argument, json_option

if TYPE_CHECKING:
    from frenetic.campaign.check import CheckReport

SHOWN: Final = 20
"""Most findings that are printed."""


@click.command()
@campaign_argument
@click.option("--quick", is_flag=True, help="Do not judge every drive again.")
@json_option
def check(campaign: Path, quick: bool, as_json: bool) -> None:
    """Check the database of a CAMPAIGN, and say what it holds.

    Reads everything, compares it, judges it again, and changes nothing. The campaign may be
    running. Prints a line per finding; the exit code is 1 if there is any, otherwise 0.
    """
    from frenetic.campaign.check import check_campaign

    with counted_progress(Log(), "Checking") as show:
        report = check_campaign(campaign, quick=quick, on_test=show)
    if as_json:
        click.echo(json.dumps(_as_json(report)))
    else:
        print_facts(_facts(report))
        for finding in report.findings[:SHOWN]:
            click.echo(finding)
        if len(report.findings) > SHOWN:
            click.echo(f"{len(report.findings) - SHOWN:,} more")
        number = counted(len(report.findings), "finding")
        found = "nothing is wrong" if report.is_sound else number
        print_facts([("check", found + (", nothing judged again" if quick else ""))])
    if not report.is_sound:
        raise click.exceptions.Exit(1)


def _facts(report: CheckReport) -> list[tuple[str, str]]:
    counts = report.counts
    per_test = f", {report.size / 1e3 / counts.told:.1f} kB per result" if counts.told else ""
    return [
        ("campaign", str(report.folder)),
        ("made", report.created_at.replace("T", " ") or "unknown"),
        ("results", counts.in_words()),
        ("waiting", f"{report.outstanding:,} asked and not told"),
        ("drives", f"{report.trajectories:,} trajectories"),
        ("on disk", f"{report.size / 1e6:,.1f} MB{per_test}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in report.versions.items())),
    ]


def _as_json(report: CheckReport) -> dict[str, Any]:
    return {
        "folder": str(report.folder),
        "is_sound": report.is_sound,
        "findings": list(report.findings),
        "created_at": report.created_at,
        "asked": report.asked,
        "told": report.counts.told,
        **report.counts.counts_json(),
        "by_outcome": dict(report.counts.by_outcome),
        "trajectories": report.trajectories,
        "bytes": report.size,
        "versions": dict(report.versions),
    }
