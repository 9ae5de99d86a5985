"""The command `compare`, which compares groups of campaigns, or two versions of a driver."""

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
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.compare_versions import (
    VersionsOptions,
    compare_versions,
    disturb_option,
    own_roads_option,
)
from frenetic.cli.console import Log, print_table
from frenetic.cli.entries import as_option, entry_option, trust_option, was_given
from frenetic.cli.option_types import NewFile
from frenetic.cli.options import count_option, file_option, json_option, workers_option
from frenetic.errors import FreneticError

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison, MeasureComparison

_WILDCARDS: Final = "*?["
"""Signs that stand for parts of a folder's name."""
_PAGE: Final = (".html",)
"""Suffixes of files that a comparison of two versions can write."""
_SUFFIXES: Final = (*_PAGE, ".png", ".svg", ".pdf")
"""Suffixes of files that a comparison of groups can write."""
_NEW_DRIVER_OPTIONS: Final = {
    "fresh": "fresh",
    "disturb": "disturb",
    "on_own_roads": "own-roads",
    "workers": "workers",
    "is_trusted": "trust",
}
"""Parameter -> name of its option, which is for a new version of a driver only."""
_MAX_GROUPS_ACROSS: Final = 3
"""Largest number of groups that are columns of a table; more groups are rows (our choice)."""
_MAX_MEASURES_ACROSS: Final = 4
"""Largest number of measures that are columns of a table (our choice)."""


@click.command()
@click.argument("places", nargs=-1, required=True, metavar="[NAME=]FOLDER...")
@file_option(
    "--out",
    "Write a page (.html) or a picture (.png, .svg, .pdf) into this file; may be repeated.",
    type=NewFile(),
    multiple=True,
)
@entry_option("driver", "A new version of the campaign's driver.")
@as_option
@trust_option
@count_option("--fresh", "Fresh random roads on which both versions drive.", default=200)
@disturb_option
@own_roads_option
@workers_option
@json_option
@click.pass_context
def compare(
    context: click.Context,
    /,
    places: tuple[str, ...],
    out: tuple[Path, ...],
    as_json: bool,
    **_: Any,
) -> None:
    """Compare what the searches of groups of campaigns found, or two versions of a driver.

    A FOLDER is the folder of a campaign, or holds the folders of several. Campaigns that differ
    only in the seed repeat each other and form a group. NAME=FOLDER[,FOLDER...] names a group
    of your choice; * and ? stand for parts of a folder's name.

    The command prints medians and quartiles of each group; for each pair the chance that a campaign
    of the first group does better than one of the second (A12), and p of the Mann-Whitney test; and
    the order of the groups by distinct failures.

    With --driver or --as it says instead whether that driver beats the campaign's driver. Both
    drive on fresh random roads (of the campaign's domain, if it has one), which decide the answer,
    and on the roads on which the campaign failed. Where both pass, it says which keeps its lane
    better, steers less and is more comfortable, also with noise and gusts. Several campaigns of one
    driver, on roads of different classes, show on which class it is better. After Ctrl-C the same
    command continues. The exit code is 0 if the new driver is better, 1 if it is worse, 3 if the
    drives show neither.
    """
    from frenetic.analysis.comparison import compare as compare_groups

    if new_driver := CommandOptions.of(context):
        check_suffixes(out, _PAGE)
        folders = list(dict.fromkeys(folder for place in places for folder in _campaigns_in(place)))
        compare_versions(folders, new_driver, VersionsOptions.of(context))
    for parameter, option in _NEW_DRIVER_OPTIONS.items():
        if was_given(context, parameter):
            raise click.UsageError(f"--{option} is for a new version of a driver: add --driver")
    check_suffixes(out, _SUFFIXES)
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


def check_suffixes(paths: Sequence[Path], suffixes: Sequence[str]) -> None:
    """Check that the names of files say in which format they are written.

    Raises:
        click.UsageError: a name ends in none of the suffixes.
    """
    for path in paths:
        if path.suffix.lower() not in suffixes:
            one_of = "" if len(suffixes) == 1 else "one of "
            raise click.UsageError(f"{path} must end with {one_of}{', '.join(suffixes)}")


def _write(comparison: Comparison, path: Path, places: Sequence[str]) -> None:
    """Write a page or a picture, as the file's suffix says."""
    if path.suffix.lower() == ".html":
        from frenetic.report.html.comparison import write_comparison_page

        command = shlex.join(["frenetic", "compare", *places, "--out", str(path)])
        write_comparison_page(comparison, path, command=command)
    else:
        from frenetic.report.plots import draw_comparison

        draw_comparison(comparison, path)


def grouped(places: tuple[str, ...]) -> dict[str, list[Path]]:
    """Return the groups of campaigns that a command line names: name -> folders.

    Named groups come first, in the order of the command line.

    Args:
        places: arguments FOLDER or NAME=FOLDER[,FOLDER...].

    Raises:
        FreneticError: a place holds no campaign.
        click.UsageError: an argument has another form, or two groups have one name.
    """
    from frenetic.analysis.groups import group_campaigns

    named_groups: dict[str, list[Path]] = {}
    ungrouped: list[Path] = []
    for place in places:
        name, equals, folders = place.partition("=")
        if not equals or Path(place).exists():  # the name of a folder may hold "="
            ungrouped += _campaigns_in(place)
            continue
        if not name or not folders:
            raise click.UsageError(f"{place!r} is not NAME=FOLDER, nor is it a folder")
        group = named_groups.setdefault(name, [])
        for folder in [folders] if Path(folders).exists() else folders.split(","):
            group += _campaigns_in(folder)
    other_groups = group_campaigns(ungrouped)
    if repeated := named_groups.keys() & other_groups.keys():
        raise click.UsageError(f"two groups are called {', '.join(repeated)}: choose other names")
    return {**named_groups, **other_groups}


def _campaigns_in(place: str) -> list[Path]:
    """Return the folders of campaigns in a place, in which * and ? stand for parts of a name."""
    from frenetic.analysis.groups import find_campaigns

    return [campaign for folder in _expanded(place) for campaign in find_campaigns(folder)]


def _expanded(place: str) -> list[Path]:
    """Return the folders for which a place with * or ? stands; no shell expands it after NAME=.

    Raises:
        FreneticError: the place stands for no folder.
    """
    path = Path(place)
    if path.exists() or not any(wildcard in place for wildcard in _WILDCARDS):
        return [path]
    root = Path(path.anchor)
    pattern = str(path.relative_to(root)) if path.anchor else place
    folders = sorted(path for path in root.glob(pattern) if path.is_dir())
    if not folders:
        raise FreneticError(f"{place} matches no folder: is it spelt right?")
    return folders


def comparison_document(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as a JSON object; null stands for values that are infinite or unknown."""
    from frenetic.analysis.curves import campaign_curves
    from frenetic.analysis.measures import SHARED_TEXT, campaign_values

    return {
        "groups": {
            name: [
                {
                    "folder": str(campaign.folder),
                    "seed": campaign.seed,
                    **campaign.counts.counts_json(),
                    "is_finished": campaign.is_finished,
                    "measures": {
                        name: None if value is None else _finite(value)
                        for name, value in campaign_values(campaign).items()
                    },
                    "curves": {
                        name: {"x": x.tolist(), "y": y.tolist()}
                        for name, (x, y) in campaign_curves(campaign).items()
                    },
                }
                for campaign in campaigns
            ]
            for name, campaigns in comparison.groups.items()
        },
        "measures": [_measure_document(measured) for measured in comparison.measures],
        "order": list(comparison.headline.order),
        "notes": list(comparison.notes),
        "about": SHARED_TEXT,
    }


def _measure_document(measured: MeasureComparison) -> dict[str, Any]:
    """Return the comparison by a measure as a JSON object."""
    return {
        **asdict(measured.measure),
        "groups": {
            name: {
                "values": [_finite(value) for value in values],
                **{
                    quartile: _finite(value)
                    for quartile, value in asdict(measured.quartiles(name)).items()
                },
            }
            for name, values in measured.values.items()
        },
        "pairs": [
            {**asdict(pair), "magnitude": pair.magnitude, "verdict": pair.verdict}
            for pair in measured.pairs
        ],
    }


def _finite(value: float) -> float | None:
    """Return a value for JSON, which holds finite numbers only; None for others."""
    return value if math.isfinite(value) else None


def print_comparison(comparison: Comparison) -> None:
    """Print medians with quartiles, the verdict on each pair, and the order of the groups.

    Only the main measures are printed; many groups are compared in pairs by the headline measure
    only.
    """
    from frenetic.analysis.comparison_text import verdict
    from frenetic.analysis.measures import SHARED_TEXT
    from frenetic.campaign.counts import Counts

    groups = comparison.groups
    sizes = ", ".join(f"{len(campaigns)} of {name}" for name, campaigns in groups.items())
    echo(f"Campaigns: {sizes}")
    for name, campaigns in groups.items():
        echo(f"{name}: {Counts.total(campaign.counts for campaign in campaigns).as_text()}")
    has_few_groups = len(groups) <= _MAX_GROUPS_ACROSS
    if has_few_groups:
        _print_by_measure(comparison)
    else:
        _print_by_group(comparison)
    if len(groups) < 2:
        return
    headline = comparison.headline
    _print_pairs(comparison.main_measures if has_few_groups else [headline])
    order = ", ".join(
        f"{headline.positions[name]}. {name}"
        f" ({headline.measure.text(headline.quartiles(name).median)})"
        for name in headline.order
    )
    echo(f"Order by {headline.measure.title} (median): {order}")
    echo(verdict(comparison))
    echo(SHARED_TEXT)


def _print_by_measure(comparison: Comparison) -> None:
    """Print medians in a row for each measure, with a column for each group."""
    groups = comparison.groups
    print_table(
        ("", *(f">{escape(name)}" for name in groups)),
        [
            (measured.measure.heading, *map(measured.text, groups))
            for measured in comparison.main_measures
        ],
        title="Median (quartiles)",
    )


def _print_by_group(comparison: Comparison) -> None:
    """Print medians in a row for each group, in tables of a few measures."""
    measures = comparison.main_measures
    for start in range(0, len(measures), _MAX_MEASURES_ACROSS):
        across = measures[start : start + _MAX_MEASURES_ACROSS]
        print_table(
            ("", *(f">{measured.measure.heading}" for measured in across)),
            [
                (name, *(measured.text(name) for measured in across))
                for name in comparison.headline.order
            ],
            title="Median (quartiles)" if start == 0 else None,
        )


def _print_pairs(measures: Sequence[MeasureComparison]) -> None:
    """Print effect and p of each pair of groups, by each measure."""
    from frenetic.analysis.comparison_text import pair_rows

    print_table(
        ("", "what can be said", ">A12", ">effect", ">p (Holm)"),
        list(pair_rows(measures)),
        title="Differences",
    )
    echo("A12: chance that a campaign of the first group does better than one of the second")
