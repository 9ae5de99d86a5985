"""The command that checks a campaign's database: check."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic._support.words import counted
from frenetic.cli.console import Log, counted_progress, print_facts, shell
from frenetic.cli.options import CampaignFolder, json_option

if TYPE_CHECKING:
    from frenetic.campaign.check import CheckReport


@click.command()
@click.argument("campaign", type=CampaignFolder())
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
        for finding in report.findings:
            click.echo(f"{finding.severity}: {finding.subject}: {finding.message}")
        number = counted(len(report.findings), "finding")
        found = "nothing is wrong" if report.is_sound else number
        print_facts([("check", found + (", nothing judged again" if quick else ""))])
    if not report.is_sound:
        raise click.exceptions.Exit(1)


def _facts(report: CheckReport) -> list[tuple[str, str]]:
    holds = report.holdings
    counts = holds.counts
    per_test = holds.bytes_per_test
    written_by = "" if holds.writer is None else f": {holds.writer} writes it right now"
    kilobytes = "" if per_test is None else f", {per_test / 1e3:.1f} kB per result"
    return [
        ("campaign", str(report.folder)),
        ("made", holds.created_at.replace("T", " ") or "unknown"),
        ("state", f"{holds.state}{written_by}{_left_to_do(report)}"),
        ("results", counts.in_words()),
        ("waiting", f"{holds.outstanding:,} asked and not told"),
        ("drives", f"{holds.trajectories:,} trajectories"),
        ("on disk", f"{holds.size / 1e6:,.1f} MB{kilobytes}"),
        ("schema", str(holds.schema)),
        ("versions", ", ".join(f"{name} {version}" for name, version in holds.versions.items())),
    ]


def _left_to_do(report: CheckReport) -> str:
    """The command that finishes what a kill left, if it did."""
    from frenetic.campaign.check import State
    from frenetic.report.html import REPORT

    holds, folder = report.holdings, shell(report.folder)
    if holds.state is State.UNFINISHED and holds.is_spent:
        return f" though its budget is spent; what is missing: frenetic resume {folder}"
    if holds.state in (State.UNFINISHED, State.INTERRUPTED):
        return f"; go on: frenetic resume {folder}"
    if holds.state is State.FINISHED and not (report.folder / REPORT).is_file():
        return f", but there is no report: frenetic report {folder}"
    return ""


def _as_json(report: CheckReport) -> dict[str, Any]:
    holds = report.holdings
    return {
        "folder": str(report.folder),
        "is_sound": report.is_sound,
        "findings": [
            {"severity": f.severity, "subject": f.subject, "message": f.message}
            for f in report.findings
        ],
        "state": holds.state,
        "budget_spent": holds.is_spent,
        "writer": holds.writer,
        "created_at": holds.created_at,
        "asked": holds.counts.asked,
        "told": holds.told,
        **holds.counts.counts_json(),
        "by_outcome": dict(holds.counts.by_outcome),
        "trajectories": holds.trajectories,
        "bytes": holds.size,
        "schema": holds.schema,
        "versions": dict(holds.versions),
    }
