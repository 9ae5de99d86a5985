"""A comparison of groups of campaigns as one HTML file: `write_comparison_page`."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Final
from urllib.parse import quote

import numpy as np

from frenetic._support.thinning import evenly
from frenetic.analysis.comparison import Comparison, MeasureComparison, PairComparison
from frenetic.analysis.findings import findings, in_short, p_text
from frenetic.analysis.metrics import CampaignMeasures, Curve, Measure, Topic, curves
from frenetic.analysis.statistics import LEAST_REPEATS, SIGNIFICANT
from frenetic.report.html.blocks import (
    Block,
    Column,
    Command,
    Fact,
    Facts,
    Section,
    Table,
    percent,
)
from frenetic.report.html.groups import (
    CurvePanel,
    Curves,
    Group,
    GroupCell,
    GroupColumn,
    GroupCurve,
    GroupTable,
    Pair,
    Pairs,
    PairsBy,
    Spread,
    SpreadPanel,
    Spreads,
)
from frenetic.report.html.headline import Headline, Tile
from frenetic.report.html.page import Report
from frenetic.report.html.writing import REPORT, made_by, write_page

POINTS: Final = 400
"""Points of a curve that are kept at most."""
MOST_TILES: Final = 8
"""Groups that the headline names at most."""

_CURVES: Final[tuple[tuple[Curve, str], ...]] = (
    ("distinct_after", "distinct failures"),
    ("failures_after", "failures"),
    ("cells_after", "cells of the feature map"),
)
_STATISTICS: Final = (
    Fact("median, quartiles", "Half of a group's campaigns lie between the quartiles."),
    Fact(
        "mean rank",
        "All campaigns of all groups are put in one order: the best has rank 1, equal ones share"
        " the mean of their ranks. Then the mean over a group's campaigns: these are the ranks of"
        " which the Kruskal-Wallis test is made. Groups of equal mean rank share a place.",
    ),
    Fact(
        "A12",
        "Vargha and Delaney's: the chance that a campaign of the first group does better than one"
        " of the second. 0.5 is no difference; from 0.56 on it is small, 0.64 medium, 0.71 large,"
        " likewise below.",
    ),
    Fact(
        "p",
        "Mann-Whitney, two-sided, exact up to 80 campaigns: how often chance alone would part two"
        " groups as far. With several groups it is corrected by Holm for the number of pairs,"
        f" measure by measure. Better is said below {SIGNIFICANT:g}.",
    ),
    Fact(
        "limits",
        f"Below {LEAST_REPEATS} campaigns in a group nothing is claimed. Measures are tested one"
        " by one, and of many some differ by chance: the one that puts groups in order was chosen"
        " beforehand.",
    ),
)


def write_comparison_page(
    comparison: Comparison,
    path: Path | str,
    *,
    title: str = "",
    lead: str = "",
    facts: Sequence[Fact] = (),
    command: str | None = None,
) -> Path:
    """Writes a comparison as one HTML file that needs nothing else.

    Campaigns whose folder holds a ``report.html`` are linked to it, relative to the page.

    Args:
        comparison: of one or more groups.
        path: where to. What is there is replaced.
        title: of the page; by default the names of the groups.
        lead: a sentence or two before what was found.
        facts: what else a reader should know of how the campaigns were made.
        command: the command line that makes the page again.

    Returns:
        The file.

    Raises:
        FreneticError: the file cannot be written.
    """
    page = comparison_report(
        comparison, Path(path).parent, title=title, lead=lead, facts=facts, command=command
    )
    return write_page(page, path)


def comparison_report(
    comparison: Comparison,
    folder: Path,
    *,
    title: str = "",
    lead: str = "",
    facts: Sequence[Fact] = (),
    command: str | None = None,
) -> Report:
    """What the page of a comparison says that is to lie in ``folder``.

    The other arguments are those of `write_comparison_page`.
    """
    title = title or _title(list(comparison.groups))
    groups = _groups(comparison)
    pairs = (
        [Section("pairs", "Pair by pair", (_pairs(comparison, groups),))] if len(groups) > 1 else []
    )
    return Report(
        title=title,
        sections=(
            Section("summary", title, (_headline(comparison, lead),)),
            Section("results", "Results", tuple(_tables(comparison, groups))),
            Section("curves", "Over the budget", (_curves(comparison, groups),)),
            Section("spreads", "Campaign by campaign", (_spreads(comparison, groups),)),
            *pairs,
            Section("measures", "What is measured", tuple(_definitions(comparison))),
            Section("campaigns", "Campaigns", (_campaigns(comparison, folder),)),
            _configuration(comparison, facts, command),
        ),
        made_by=made_by(),
    )


def _title(names: Sequence[str]) -> str:
    return f"{in_short(names)} compared"


def _groups(comparison: Comparison) -> tuple[Group, ...]:
    """In the order of the headline measure."""
    colours = {name: i for i, name in enumerate(comparison.groups)}
    return tuple(Group(name, colours[name]) for name in comparison.headline.order)


def _headline(comparison: Comparison, lead: str) -> Headline:
    by = comparison.headline
    shown = by.order[:MOST_TILES]
    tiles = [
        Tile(
            f"{_place(by.places[name])} {name}",
            by.measure.text(by.quartiles(name).median),
            by.between(name),
        )
        for name in shown
    ]
    left_out = len(by.order) - len(shown)
    campaigns = [one for group in comparison.groups.values() for one in group]
    return Headline(
        title="",
        lead=" ".join(text for text in (lead, findings(comparison)) if text),
        warning=" ".join(f"{_sentence(note)}." for note in comparison.notes),
        tiles=tuple(tiles),
        facts=(
            Fact(
                "shown above",
                f"{by.measure.title}: place, median and quartiles"
                + (f"; {left_out} more groups below" if left_out else ""),
            ),
            Fact("campaigns", _sizes(comparison)),
            Fact("simulations", _range([one.simulations for one in campaigns]) + " each"),
            *(
                Fact(part, comparison.shared[part])
                for part in ("driver", "simulator")
                if part in comparison.shared
            ),
        ),
    )


def _sizes(comparison: Comparison) -> str:
    sizes = {len(group) for group in comparison.groups.values()}
    total = sum(len(group) for group in comparison.groups.values())
    number = len(comparison.groups)
    if len(sizes) == 1:
        return f"{total}: {sizes.pop()} of each of {number} groups"
    return f"{total}: " + ", ".join(f"{len(g)} of {n}" for n, g in comparison.groups.items())


def _range(numbers: Sequence[int]) -> str:
    return (
        str(min(numbers)) if min(numbers) == max(numbers) else f"{min(numbers)} to {max(numbers)}"
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _place(number: int) -> str:
    return f"{number}."


# Tables


def _tables(comparison: Comparison, groups: tuple[Group, ...]) -> Iterator[Block]:
    varying, constant = _varying(comparison)
    alike = ", ".join(f"{one.measure.title} {one.measure.text(value)}" for one, value in constant)
    yield GroupTable(
        "Medians",
        groups,
        tuple(_column(one.measure) for one in varying),
        tuple(
            tuple(
                GroupCell(
                    one.measure.text(one.quartiles(group.name).median),
                    _quartiles(one, group.name),
                )
                for one in varying
            )
            for group in groups
        ),
        "Median, and under it the quartiles."
        + (f" The same in all campaigns: {alike}." if alike else ""),
    )
    if len(groups) > 1:
        yield _ranks(comparison, groups, varying)
    yield _maps(comparison, groups)


def _ranks(
    comparison: Comparison, groups: tuple[Group, ...], varying: Sequence[MeasureComparison]
) -> GroupTable:
    ranked = [one for one in varying if one.measure.more_is_better is not None]
    number = len(groups)
    return GroupTable(
        "Ranks",
        groups,
        tuple(_column(one.measure) for one in ranked),
        tuple(
            tuple(
                GroupCell(
                    _place(one.places[group.name]),
                    f"{one.mean_ranks[group.name]:.1f}",
                    (number - one.places[group.name]) / (number - 1),
                )
                for one in ranked
            )
            for group in groups
        ),
        "Place by mean rank, and under it the mean rank of the group's campaigns among all"
        f" {sum(map(len, comparison.groups.values()))} campaigns; 1 is the best. A place says"
        " nothing of whether a difference is more than chance: see the pairs.",
    )


def _varying(
    comparison: Comparison,
) -> tuple[list[MeasureComparison], list[tuple[MeasureComparison, float]]]:
    """The measures that differ between campaigns, and those that do not with their value."""
    varying: list[MeasureComparison] = []
    constant: list[tuple[MeasureComparison, float]] = []
    shown = [one for one in comparison.measures if one.measure.name != "failures_per_100"]
    for one in comparison.measures if comparison.simulations is None else shown:
        values = {value for group in one.values.values() for value in group}
        if len(values) == 1:
            constant.append((one, values.pop()))
        else:
            varying.append(one)
    return varying, constant


def _column(measure: Measure) -> GroupColumn:
    unit = f" ({measure.unit})" if measure.unit else ""
    return GroupColumn(
        f"{measure.short}{unit}",
        measure.better,
        str(measure.topic),
        f"{_sentence(measure.title)}: {measure.definition}",
    )


def _quartiles(by: MeasureComparison, group: str) -> str:
    """The quartiles of a group, in short; empty where they say no more than the median."""
    low, _, high = by.between(group).partition(" to ")
    return "" if low == high else f"{low}–{high}"


def _maps(comparison: Comparison, groups: tuple[Group, ...]) -> GroupTable:
    maps = (
        ("feature map", comparison.map_coverage()),
        (str(Topic.COMPETITION), comparison.map_coverage(as_competition=True)),
    )
    titles = (
        ("cells together", "Cells that the group's campaigns filled together"),
        ("mean share", "Of the cells that any campaign of any group filled"),
    )
    return GroupTable(
        "Feature maps",
        groups,
        tuple(
            GroupColumn(title, "more", topic, text) for topic, _ in maps for title, text in titles
        ),
        tuple(
            tuple(
                GroupCell(text)
                for _, found in maps
                for text in (str(found[group.name].cells), percent(found[group.name].share))
            )
            for group in groups
        ),
        "Mean share: of the cells that any campaign of any group filled with a failure, what one of"
        " the group's campaigns filled, mean; the competition's relative map coverage. It depends"
        " on who takes part.",
    )


# Curves, spreads, pairs


def _curves(comparison: Comparison, groups: tuple[Group, ...]) -> Curves:
    few = min(map(len, comparison.groups.values())) < LEAST_REPEATS
    band = (
        "the band lies between the quartiles"
        if not few
        else (
            f"the band between the quartiles needs {LEAST_REPEATS} campaigns, below that each"
            " campaign is a thin line"
        )
    )
    return Curves(
        "simulations",
        tuple(
            CurvePanel(title, tuple(_curve(comparison, group, what) for group in groups))
            for what, title in _CURVES
        ),
        f"Median of each group; {band}. A curve reaches as far as all campaigns of its group. A"
        " distinct failure counts from the first of those alike, a cell from its first failure.",
    )


def _curve(comparison: Comparison, group: Group, what: Curve) -> GroupCurve:
    found = curves(comparison.groups[group.name], what)
    shown = evenly(found.shape[1], POINTS).tolist()
    low, median, high = (
        tuple(np.round(line[shown], 2).tolist())
        for line in np.quantile(found, (0.25, 0.5, 0.75), axis=0)
    )
    x = tuple(shown)
    if len(found) >= LEAST_REPEATS:
        return GroupCurve(group, x, median, low, high)
    singles = tuple(tuple(line[shown].tolist()) for line in found)
    return GroupCurve(group, x, median, singles=singles if len(found) > 1 else ())


def _spreads(comparison: Comparison, groups: tuple[Group, ...]) -> Spreads:
    return Spreads(
        tuple(
            SpreadPanel(
                one.measure.heading,
                f"{one.measure.better} is better{_overall(one)}",
                bool(one.measure.more_is_better),
                tuple(_one_spread(one, group) for group in groups),
            )
            for one in comparison.telling
        ),
        "A point is a campaign, the line in the box the median, the box reaches from the first to"
        " the third quartile.",
    )


def _overall(by: MeasureComparison) -> str:
    fewest = min(len(values) for values in by.values.values())
    if by.p_overall is None or fewest < LEAST_REPEATS:
        return ""
    return f"; Kruskal-Wallis p {p_text(by.p_overall)}"


def _one_spread(by: MeasureComparison, group: Group) -> Spread:
    values = sorted(by.values[group.name])
    found = by.quartiles(group.name)
    enough = found.n >= LEAST_REPEATS
    return Spread(
        group,
        tuple(_finite(value) for value in values),
        tuple(by.measure.text(value) for value in values),
        by.measure.text(found.median),
        (_finite(found.low), _finite(found.median), _finite(found.high)) if enough else None,
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _pairs(comparison: Comparison, groups: tuple[Group, ...]) -> Pairs:
    known = {group.name: group for group in groups}
    several = len(groups) > 2
    return Pairs(
        tuple(
            PairsBy(
                one.measure.heading,
                f"{one.measure.better} is better{_overall(one)}",
                tuple(_pair(pair, known) for pair in _in_order(one, groups)),
            )
            for one in comparison.telling
        ),
        "A12: the chance that a campaign of the first group does better than one of the second."
        + (" p is corrected by Holm for the number of pairs." if several else ""),
    )


def _in_order(by: MeasureComparison, groups: tuple[Group, ...]) -> list[PairComparison]:
    """All pairs, those of the groups that come first in the page first."""
    place = {group.name: i for i, group in enumerate(groups)}

    def key(pair: PairComparison) -> list[int]:
        return sorted((place[pair.first], place[pair.second]))

    return [
        pair if place[pair.first] < place[pair.second] else pair.turned
        for pair in sorted(by.pairs, key=key)
    ]


def _pair(pair: PairComparison, known: dict[str, Group]) -> Pair:
    enough = min(pair.repeats) >= LEAST_REPEATS
    return Pair(
        known[pair.first],
        known[pair.second],
        pair.a12,
        str(pair.magnitude) if enough else "–",
        p_text(pair.p) if enough else "–",
        p_text(pair.p_corrected) if enough else "–",
        str(pair.verdict),
        0 if pair.better is None else 1 if pair.better == pair.first else 2,
    )


# What it means, and where it comes from


def _definitions(comparison: Comparison) -> Iterator[Block]:
    for topic, measures in groupby(comparison.measures, lambda one: one.measure.topic):
        yield Facts(tuple(_definition(one.measure) for one in measures), _sentence(topic))
    yield Facts(_STATISTICS, "Statistics")


def _definition(measure: Measure) -> Fact:
    better = "" if measure.more_is_better is None else f"{_sentence(measure.better)} is better; "
    bounds = f"{better}{measure.bounds}"
    unit = f" {measure.unit}" if measure.unit else ""
    return Fact(measure.title, f"{measure.definition} {_sentence(bounds)}{unit}.")


def _campaigns(comparison: Comparison, folder: Path) -> Table:
    campaigns = [
        (group, campaign) for group, found in comparison.groups.items() for campaign in found
    ]
    columns = (
        Column("campaign"),
        Column("group"),
        Column("seed", is_number=True),
        Column("simulations", is_number=True),
        Column("failures", is_number=True),
        Column("distinct", is_number=True),
        Column("invalid", is_number=True),
        Column("errors", is_number=True),
        Column("finished"),
    )
    return Table(
        columns,
        tuple(
            (
                _relative(campaign.folder, folder),
                group,
                "–" if campaign.seed is None else str(campaign.seed),
                str(campaign.simulations),
                str(campaign.failures),
                str(campaign.distinct_failures),
                str(campaign.invalid),
                str(campaign.errors),
                "yes" if campaign.is_finished else "no",
            )
            for group, campaign in campaigns
        ),
        links=tuple(_link(campaign, folder) for _, campaign in campaigns),
        tall=len(campaigns) > 15,
    )


def _relative(place: Path, folder: Path) -> str:
    """A place as seen from a folder, or as it is where there is no way."""
    try:
        return Path(os.path.relpath(place.resolve(), folder.resolve())).as_posix()
    except (OSError, ValueError):  # another drive
        return str(place)


def _link(campaign: CampaignMeasures, folder: Path) -> str | None:
    """The address of a campaign's report, from a page in a folder; None if there is none."""
    report = campaign.folder / REPORT
    try:
        found = report.is_file()
        return (
            quote(Path(os.path.relpath(report.resolve(), folder.resolve())).as_posix())
            if found
            else None
        )
    except (OSError, ValueError):
        return None


def _configuration(comparison: Comparison, facts: Sequence[Fact], command: str | None) -> Section:
    blocks: list[Block] = []
    if command:
        blocks.append(Command(command, "Makes this again:"))
    if facts:
        blocks.append(Facts(tuple(facts)))
    if comparison.shared:
        shared = tuple(Fact(part, value) for part, value in comparison.shared.items())
        blocks.append(Facts(shared, "The same in all campaigns"))
    return Section("configuration", "Configuration", tuple(blocks))
