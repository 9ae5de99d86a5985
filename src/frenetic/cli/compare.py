"""The command that compares campaigns: compare."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from rich.markup import escape

from frenetic.cli import echo
from frenetic.cli.compare_versions import compare_versions
from frenetic.cli.console import Log, print_table
from frenetic.cli.entries import Given, as_option, entry_option, trust_option, was_given
from frenetic.cli.options import (
    NewFile,
    count_option,
    file_option,
    json_option,
    workers_option,
)
from frenetic.errors import FreneticError

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison, MeasureComparison

_WILD: Final = "*?["
_SUFFIXES: Final = (".html", ".png", ".svg", ".pdf")
_MOST_COLUMNS: Final = 3
"""Most groups side by side; more are listed one below the other."""
_MOST_MEASURES: Final = 4
"""Most measures side by side."""


@click.command()
@click.argument("places", nargs=-1, required=True, metavar="[NAME=]FOLDER...")
@file_option(
    "--out",
    "Write a page (.html) or a picture (.png, .svg, .pdf) into this file; may be repeated.",
    type=NewFile(),
    multiple=True,
)
@entry_option("driver", "A new version of the driver of the one campaign named.")
@as_option
@trust_option
@count_option("--fresh", "Fresh random roads on which both versions drive.", default=200)
@workers_option
@json_option
@click.pass_context
def compare(
    context: click.Context,
    /,
    places: tuple[str, ...],
    out: tuple[Path, ...],
    as_json: bool,
    fresh: int,
    workers: int,
    **_: Any,
) -> None:
    """Compare what the searches of groups of campaigns found, or two versions of a driver.

    A FOLDER is that of a campaign, or holds the folders of several. Campaigns that differ only in
    the seed repeat each other and form a group. NAME=FOLDER[,FOLDER...] forms a group of your own,
    in which * and ? stand for parts of a name.

    Prints medians and quartiles of each group; for each pair the chance that a campaign of the one
    does better than one of the other (A12), and p of the Mann-Whitney test; and the order of the
    groups by distinct failures.

    With --driver or --as it says instead whether that driver is better than the one of the campaign
    named. Both drive on fresh random roads, of its domain if it has one, on which the answer rests,
    and on those on which the campaign failed. The same command goes on after Ctrl-C. The exit code
    is 0 if the new version is better, 1 if it is worse, 3 if neither is shown.
    """
    from frenetic.analysis.comparison import compare as compare_groups

    if new_driver := Given.of(context):
        if out or len(places) > 1:
            what = "leave out --out" if out else "name only that"
            raise click.UsageError(
                f"--driver and --as compare another driver with that of one campaign: {what}"
            )
        how: Any = {"fresh": fresh, "workers": workers, "as_json": as_json}
        compare_versions(Path(places[0]), new_driver, **how)
    for name, option in {"fresh": "fresh", "workers": "workers", "is_trusted": "trust"}.items():
        if was_given(context, name):
            raise click.UsageError(f"--{option} is for a new version of a driver: add --driver")
    for path in out:
        if path.suffix.lower() not in _SUFFIXES:
            raise click.UsageError(f"{path} must end with one of {', '.join(_SUFFIXES)}")
    log = Log()
    with log.status("Reading the campaigns"):
        comparison = compare_groups(grouped(places))
    for note in comparison.notes:
        log.print(f"Note: {note}", markup=False)
    for path in out:
        _write(comparison, path, places)
    if as_json:
        echo(json.dumps(comparison_document(comparison)))
        return
    print_comparison(comparison)
    for path in out:
        echo(path)


def _write(comparison: Comparison, path: Path, places: Sequence[str]) -> None:
    """Writes a page or a picture, as the file's suffix says."""
    if path.suffix.lower() == ".html":
        from frenetic.report.html.comparison import write_comparison_page

        words = ["frenetic", "compare", *places, "--out", str(path)]
        write_comparison_page(comparison, path, command=shlex.join(words))
    else:
        from frenetic.report.plots import draw_comparison

        draw_comparison(comparison, path)


def grouped(places: tuple[str, ...]) -> dict[str, list[Path]]:
    """The groups of campaigns that a command line names, in its order.

    Raises:
        FreneticError: a place holds no campaign, or two groups have one name.
    """
    from frenetic.analysis.groups import find_campaigns, group_campaigns

    named: dict[str, list[Path]] = {}
    nameless: list[Path] = []
    for place in places:
        name, equals, listed = place.partition("=")
        if not equals or Path(place).exists():
            nameless += [found for one in _expanded(place) for found in find_campaigns(one)]
            continue
        if not name or not listed:
            raise click.UsageError(f"{place!r} is not NAME=FOLDER, nor is it a folder")
        members = named.setdefault(name, [])
        for one in [listed] if Path(listed).exists() else listed.split(","):
            members += [found for path in _expanded(one) for found in find_campaigns(path)]
    others = group_campaigns(nameless)
    if twice := named.keys() & others.keys():
        raise click.UsageError(f"two groups are called {', '.join(twice)}: choose other names")
    return {**named, **others}


def _expanded(place: str) -> list[Path]:
    """The paths of a place with * or ?, which no shell expands after NAME=."""
    path = Path(place)
    if path.exists() or not any(sign in place for sign in _WILD):
        return [path]
    root = Path(path.anchor)
    pattern = str(path.relative_to(root)) if path.anchor else place
    found = sorted(found for found in root.glob(pattern) if found.is_dir())
    if not found:
        raise FreneticError(f"{place} stands for no folder: is it spelt right?")
    return found


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """A comparison as a JSON object; events that never happened are null."""

    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    def measure_document(measured: MeasureComparison) -> dict[str, Any]:
        return {
            **asdict(measured.measure),
            "groups": {
                name: {
                    "values": [number(value) for value in values],
                    **{k: number(v) for k, v in asdict(measured.quartiles(name)).items()},
                }
                for name, values in measured.values.items()
            },
            "pairs": [
                {**asdict(pair), "magnitude": pair.magnitude, "verdict": pair.verdict}
                for pair in measured.pairs
            ],
        }

    return {
        "groups": {
            name: [
                {
                    "folder": str(campaign.folder),
                    "seed": campaign.seed,
                    **campaign.counts.counts_json(),
                    "is_finished": campaign.is_finished,
                }
                for campaign in campaigns
            ]
            for name, campaigns in comparison.groups.items()
        },
        "measures": [measure_document(measured) for measured in comparison.measures],
        "order": list(comparison.headline.order),
        "notes": list(comparison.notes),
    }


def print_comparison(comparison: Comparison) -> None:
    """Prints medians with quartiles, the verdict on each pair, and the better group.

    Of many groups the pairs are told apart by the headline measure only.
    """
    from frenetic.analysis.comparison import verdict
    from frenetic.campaign.counts import Counts

    sizes = ", ".join(f"{len(campaigns)} of {n}" for n, campaigns in comparison.groups.items())
    echo(f"Campaigns: {sizes}")
    for name, campaigns in comparison.groups.items():
        echo(f"{name}: {Counts.total(campaign.counts for campaign in campaigns).in_words()}")
    if len(comparison.groups) <= _MOST_COLUMNS:
        _print_by_measure(comparison)
    else:
        _print_by_group(comparison)
    if len(comparison.groups) < 2:
        return
    by = comparison.headline
    few = len(comparison.groups) <= _MOST_COLUMNS
    _print_pairs(comparison.measures if few else [by], several=len(comparison.groups) > 2)
    order = ", ".join(
        f"{by.positions[n]}. {n} ({by.measure.text(by.quartiles(n).median)})" for n in by.order
    )
    echo(f"Order by {by.measure.title} (median): {order}")
    echo(verdict(comparison))


def _print_by_measure(comparison: Comparison) -> None:
    """A row per measure."""
    groups = comparison.groups
    print_table(
        ("", *(f">{escape(name)}" for name in groups)),
        [(by.measure.heading, *map(by.text, groups)) for by in comparison.measures],
        title="Median (quartiles)",
    )


def _print_by_group(comparison: Comparison) -> None:
    """A row per group, with as many measures side by side as are readable."""
    for start in range(0, len(comparison.measures), _MOST_MEASURES):
        beside = comparison.measures[start : start + _MOST_MEASURES]
        print_table(
            ("", *(f">{by.measure.heading}" for by in beside)),
            [(name, *(by.text(name) for by in beside)) for name in comparison.headline.order],
            title="Median (quartiles)" if start == 0 else None,
        )


def _print_pairs(measures: Sequence[MeasureComparison], *, several: bool) -> None:
    from frenetic.analysis.comparison import pair_rows

    print_table(
        ("", "what can be said", ">A12", ">effect", ">p (Holm)" if several else ">p"),
        list(pair_rows(measures)),
        title="Differences",
    )
    echo("A12: chance that a campaign of the first named does better than one of the second")
