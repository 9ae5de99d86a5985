"""The command that holds campaigns against each other: compare."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from rich.table import Table

from frenetic.cli.console import Log, Results
from frenetic.cli.options import json_option
from frenetic.errors import FreneticError

if TYPE_CHECKING:
    from frenetic.analysis.comparing import Comparison, MeasureComparison, PairComparison

_WILD: Final = "*?["


@click.command(short_help="Hold campaigns against each other, with their repeats.")
@click.argument("places", nargs=-1, required=True, metavar="[NAME=]FOLDER...")
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Draw failures over simulations, and all measures, into this PNG, SVG or PDF file.",
)
@json_option
def compare(places: tuple[str, ...], plot: Path | None, as_json: bool) -> None:
    """Hold groups of campaigns against each other.

    A FOLDER is that of a campaign, or one that holds the folders of several. Campaigns that differ
    in nothing but the seed are repeats of each other and make a group. With a NAME a group is what
    you say: NAME=FOLDER[,FOLDER...], in which * and ? stand for parts of a name.

    Said are medians and quartiles of each group; for each pair the chance that a campaign of the
    one does better than one of the other (A12), and p of the Mann-Whitney test.
    """
    from frenetic.analysis.comparing import compare as compare_groups

    log = Log()
    with log.status("Reading the campaigns"):
        comparison = compare_groups(grouped(places))
    for note in comparison.notes:
        log.print(f"Note: {note}", markup=False)
    if plot is not None:
        from frenetic.report.comparison import draw_comparison

        draw_comparison(comparison, plot)
    if as_json:
        click.echo(json.dumps(_document(comparison)))
        return
    _print(comparison)
    if plot is not None:
        click.echo(f"Picture: {plot}")


def grouped(places: tuple[str, ...]) -> dict[str, list[Path]]:
    """The groups of campaigns that a command line names, in its order.

    Raises:
        FreneticError: a place holds no campaign, or two groups have one name.
    """
    from frenetic.analysis.comparing import find_campaigns, group_campaigns

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
    """The paths that a place with * or ? stands for: no shell has seen those after NAME=."""
    path = Path(place)
    if path.exists() or not any(sign in place for sign in _WILD):
        return [path]
    root = Path(path.anchor)
    pattern = str(path.relative_to(root)) if path.anchor else place
    found = sorted(found for found in root.glob(pattern) if found.is_dir())
    if not found:
        raise FreneticError(f"{place} stands for no folder: is it spelt right?")
    return found


def _document(comparison: Comparison) -> dict[str, Any]:
    """The comparison as a JSON object; what never happened is null."""

    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    def pair_document(pair: PairComparison) -> dict[str, Any]:
        return {
            **asdict(pair),
            "magnitude": str(pair.magnitude),
            "verdict": str(pair.verdict),
        }

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
            "kruskal_wallis_p": measured.p_overall,
            "pairs": [pair_document(pair) for pair in measured.pairs],
        }

    return {
        "groups": {
            name: [
                {
                    "folder": str(campaign.folder),
                    "seed": campaign.seed,
                    "simulations": campaign.simulations,
                    "is_finished": campaign.is_finished,
                }
                for campaign in campaigns
            ]
            for name, campaigns in comparison.groups.items()
        },
        "measures": [measure_document(measured) for measured in comparison.measures],
        "notes": list(comparison.notes),
    }


def _print(comparison: Comparison) -> None:
    from frenetic.analysis.statistics import LEAST_REPEATS

    sizes = ", ".join(f"{len(campaigns)} of {n}" for n, campaigns in comparison.groups.items())
    click.echo(f"Campaigns: {sizes}")
    table = Table(box=None, pad_edge=False, title="Median (quartiles)", title_justify="left")
    table.add_column("")
    for name in comparison.groups:
        table.add_column(name, justify="right", overflow="fold")
    several = len(comparison.groups) > 2
    enough = min(map(len, comparison.groups.values())) >= LEAST_REPEATS
    if several and enough:
        table.add_column("Kruskal-Wallis p", justify="right")
    for measured in comparison.telling:
        unit = f" ({measured.measure.unit})" if measured.measure.unit else ""
        cells = [_spread(measured, name) for name in comparison.groups]
        if measured.p_overall is not None and enough:
            cells.append(f"{measured.p_overall:.2g}")
        table.add_row(f"{measured.measure.title}{unit}", *cells)
    Results().print(table)
    _print_pairs(comparison)


def _spread(measured: MeasureComparison, name: str) -> str:
    found = measured.quartiles(name)
    low, median, high = (measured.measure.text(v) for v in (found.low, found.median, found.high))
    return median if found.n == 1 else f"{median} ({low} to {high})"


def _print_pairs(comparison: Comparison) -> None:
    from frenetic.analysis.comparing import Verdict

    several = len(comparison.groups) > 2
    table = Table(box=None, pad_edge=False, title="Differences", title_justify="left")
    for column in ("", "what can be said"):
        table.add_column(column, overflow="fold")
    for column in ("A12", "effect", "p (Holm)" if several else "p"):
        table.add_column(column, justify="right")
    for measured in comparison.telling:
        for i, pair in enumerate(measured.pairs):
            is_told = pair.verdict is not Verdict.TOO_FEW
            table.add_row(
                "" if i else measured.measure.title,
                str(pair),
                f"{pair.a12:.2f}",
                str(pair.magnitude) if is_told else "-",
                f"{pair.p_corrected:.2g}" if is_told else "-",
            )
    Results().print(table)
    click.echo("A12: chance that a campaign of the first named does better than one of the second")
