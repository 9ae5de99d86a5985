"""The command that shows campaigns: show."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from frenetic.cli.console import facts_of_drive, print_facts, print_failures, shell
from frenetic.cli.options import json_option
from frenetic.errors import FreneticError
from frenetic.fingerprint import short_version

if TYPE_CHECKING:
    from frenetic.campaign import CampaignStore


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.argument("test_id", type=int, required=False, metavar="[ID]")
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Where to draw the test. [default: in the campaign's folder]",
)
@json_option
def show(campaign: Path, test_id: int | None, plot: Path | None, as_json: bool) -> None:
    """Say what a CAMPAIGN folder holds, or show one test in full, with its picture."""
    from frenetic.campaign import CampaignStore

    with CampaignStore.open(campaign) as store:
        if test_id is None:
            if plot is not None:
                raise click.UsageError("--plot needs the ID of a test, too")
            _show_campaign(store, as_json)
        else:
            _show_test(store, test_id, plot, as_json)


def _show_campaign(store: CampaignStore, as_json: bool) -> None:
    from frenetic.analysis.failures import LISTED, distinct_failures

    counts = store.counts()
    config, facts = store.config, store.facts
    clusters = distinct_failures(store)
    if as_json:
        document = {
            "folder": str(store.folder),
            **counts.counts_json(),
            "distinct_failures": [
                {
                    "most_severe": cluster.most_severe,
                    "moobd": cluster.moobd,
                    "description": cluster.description,
                    "tests": list(cluster.ids),
                }
                for cluster in clusters
            ],
            "facts": dict(facts),
            "config": dict(config),
        }
        click.echo(json.dumps(document))
        return
    rules = config.get("rules")
    limits = rules if isinstance(rules, Mapping) else {}
    budget = facts.get("budget", config.get("budget"))
    limited = budget if isinstance(budget, Mapping) else {}
    spent = ", ".join(f"{value} {name}" for name, value in limited.items() if value is not None)
    if facts.get("interrupted"):
        spent += ", interrupted"
    elif "finished_at" not in facts:
        spent += ", not finished"
    print_facts(
        [
            ("campaign", str(store.folder)),
            ("made", str(facts.get("created_at", "unknown")).replace("T", " ")),
            ("strategy", _part(config.get("strategy"))),
            ("driver", _part(config.get("driver"))),
            ("simulator", _part(config.get("simulator"))),
            (
                "rules",
                f"{limits.get('speed_limit')} km/h, {limits.get('oob_tolerance')} of the car may"
                f" be out, map of {config.get('map_size')} m",
            ),
            ("budget", spent),
            ("results", counts.in_words()),
            *(("changed", str(change)) for change in store.changes if change.what),
        ]
    )
    if len(clusters):
        print_failures(clusters, counts.failed, min(LISTED, len(clusters)))
        click.echo(f"One in full: frenetic show {shell(store.folder)} {clusters[0].most_severe}")


def _part(described: object) -> str:
    """A part of a campaign's configuration in one line: class, options, what it lies over."""
    if not isinstance(described, Mapping):
        return "unknown"
    options = described.get("options")
    shown = ", ".join(
        f"{name}={value}"
        for name, value in (options.items() if isinstance(options, Mapping) else ())
        if not isinstance(value, Mapping)
    )
    text = str(described.get("class", "unknown")).rpartition(":")[2] + (
        f"({shown})" if shown else ""
    )
    version = short_version(described)
    text += f" [{version}]" if version else ""
    inner = described.get("driver")
    return text if inner is None else f"{text} over {_part(inner)}"


def _show_test(store: CampaignStore, test_id: int, plot: Path | None, as_json: bool) -> None:
    from frenetic.outcome import Outcome
    from frenetic.report.failures import (
        FAILURES,
        PICTURES,
        file_stem,
        road_document,
    )
    from frenetic.report.picture import draw_drive, draw_road

    record = store.test(test_id)
    test = record
    kind = FAILURES if record.outcome is Outcome.FAIL else PICTURES
    picture = plot if plot is not None else store.folder / kind / f"{file_stem(test_id)}.png"
    title = f"Test {test_id}: {record.outcome}"
    try:
        if plot is None:
            picture.parent.mkdir(exist_ok=True)
        if test.drive is not None:
            draw_drive(test.road, test.drive, picture, title=title)
        else:
            draw_road(test.road, picture, title=title, reason=record.reason)
        drawn = str(picture)
    except (OSError, FreneticError) as error:
        if plot is not None:
            raise
        drawn = f"not drawn, {error}; choose a place with --plot"
    if as_json:
        document = road_document(test, store.config) | {"picture": drawn, "told": record.told}
        click.echo(json.dumps(document))
        return
    origin = record.candidate.origin
    parents = f" of {', '.join(map(str, origin.parents))}" if origin.parents else ""
    facts = [
        ("test", f"{test_id}, told as number {record.told}"),
        ("outcome", f"{record.outcome}  {record.reason}"),
        ("origin", f"{origin.operator}{parents}, generation {origin.generation}"),
        ("road", f"{test.road.length:.1f} m, {len(test.road.curvatures)} curvatures"),
    ]
    facts += facts_of_drive(record, record.duration)
    facts += [
        ("curvatures", " ".join(f"{value:.4f}" for value in test.road.curvatures)),
        ("picture", drawn),
    ]
    print_facts(facts)
