"""A comparison of groups of campaigns as one HTML file: `write_comparison_page`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from matplotlib.ticker import MaxNLocator

from frenetic._support.arrays import FloatArray, IntArray, evenly
from frenetic._support.words import capitalised, in_short
from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.comparison import Comparison, MeasureComparison
from frenetic.analysis.comparison_text import findings, pair_rows
from frenetic.analysis.curves import CURVES, Curve
from frenetic.analysis.measures import SHARED_TEXT
from frenetic.analysis.statistics import LEAST_REPEATS, SIGNIFICANT
from frenetic.report.html.campaign import REPORT
from frenetic.report.html.page import (
    Block,
    Chart,
    DataBlock,
    Facts,
    Report,
    Section,
    Series,
    Table,
    Tile,
    command,
    proper,
    write_page,
)

MOST_TILES: Final = 8
"""Largest number of groups in the headline; our choice."""
POINTS: Final = 400
"""Largest number of points of a curve; our choice."""
COLOURS: Final = 8
"""Number of colours of groups; further groups repeat them with dashed lines and hollow marks."""
_END_WIDTH: Final = 14.0
"""Width of the end of a track for campaigns without a value, in percent of the track."""
_UNLIKE_TEXT: Final = (
    "Clusters of failures, joined by average linkage up to a radius: a root mean square difference"
    " in a space that no search uses. At radius 0 each different failure counts."
)
_STATISTICS: Final = {
    "median, quartiles": "Half of a group's campaigns lie between the quartiles.",
    "A12": "Vargha and Delaney's: the chance that a campaign of the first group does better than"
    " a campaign of the second. 0.5 is no difference; from 0.56 on (or 0.44 down) it is small, 0.64"
    " (0.36) medium, 0.71 (0.29) large.",
    "p": "Mann-Whitney, two-sided: how often chance alone would separate two groups as far,"
    " corrected by Holm for all pairs of groups and all measures of this page that are not equal"
    f" in all campaigns. A group counts as better below {SIGNIFICANT:g}. The measure that orders"
    " the groups was chosen beforehand.",
}


def write_comparison_page(
    comparison: Comparison,
    path: Path | str,
    *,
    title: str = "",
    lead: str = "",
    facts: Mapping[str, str] | None = None,
    command: str | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Write a comparison as one self-contained HTML file.

    The page links the ``report.html`` of each campaign that has one, relative to the page.

    Args:
        comparison: comparison of one or more groups.
        path: path of the file, which is replaced.
        title: title of the page; by default the names of the groups.
        lead: a sentence or two before the findings.
        facts: more facts about the campaigns for the reader.
        command: command line that writes the page again.
        sections: more sections, after the results.

    Returns:
        The file.

    Raises:
        FreneticError: the file cannot be written.
    """
    page = comparison_report(
        comparison,
        Path(path).parent,
        title=title,
        lead=lead,
        facts=facts,
        command_line=command,
        sections=sections,
    )
    return write_page(page, path)


def comparison_report(
    comparison: Comparison,
    folder: Path,
    *,
    title: str = "",
    lead: str = "",
    facts: Mapping[str, str] | None = None,
    command_line: str | None = None,
    sections: Sequence[Section] = (),
) -> Report:
    """Return the page of a comparison.

    Args:
        comparison: comparison of one or more groups.
        folder: folder of the page, from which it links reports.
        title: title of the page; by default the names of the groups.
        lead: a sentence or two before the findings.
        facts: more facts about the campaigns for the reader.
        command_line: command line that writes the page again.
        sections: more sections, after the results.
    """
    title = title or f"{in_short(list(comparison.groups))} compared"
    definitions = {
        by.measure.title: f"{by.measure.definition} {capitalised(by.measure.better)} is better."
        for by in comparison.measures
    }
    configuration: list[Block] = []
    if command_line is not None:
        configuration.append(command(command_line, "Makes this again:"))
    if facts:
        configuration.append(Facts(facts))
    if comparison.shared:
        configuration.append(Facts(comparison.shared, "The same in all campaigns"))
    explanations = Facts(definitions, "Measures"), Facts(_STATISTICS, "Statistics")
    charts = group_charts(comparison)
    return Report(
        title=title,
        sections=(
            Section("summary", title, (_headline(comparison, lead),)),
            Section("results", "Results", tuple(_results(comparison)), SHARED_TEXT),
            *sections,
            Section(
                "curves",
                "Over the budget",
                tuple(chart for curve, chart in charts.items() if not curve.is_over_radius),
                _curves_text(comparison),
            ),
            Section(
                "unlike",
                "Failures unlike each other",
                tuple(chart for curve, chart in charts.items() if curve.is_over_radius),
                _UNLIKE_TEXT,
            ),
            Section("spreads", "Campaign by campaign", (group_spreads(comparison),)),
            *_pairs(comparison),
            Section("measures", "What is measured", explanations),
            Section("campaigns", "Campaigns", (_campaigns(comparison, folder),)),
            Section("configuration", "Configuration", tuple(configuration)),
        ),
    )


def _headline(comparison: Comparison, lead: str) -> DataBlock:
    """Return the block with the findings and the order of the groups at a glance."""
    by = comparison.headline
    campaigns = [campaign for group in comparison.groups.values() for campaign in group]
    simulations = sorted({campaign.simulations for campaign in campaigns})
    numbers = " to ".join(map(str, dict.fromkeys([simulations[0], simulations[-1]])))
    facts = {
        "shown above": f"{by.measure.title}: place, median and quartiles",
        "campaigns": ", ".join(
            f"{len(group)} of {name}" for name, group in comparison.groups.items()
        ),
        "simulations": f"{numbers} each",
    }
    parts = ("driver", "simulator", "conditions", "domain")
    facts |= {part: comparison.shared[part] for part in parts if part in comparison.shared}
    return DataBlock(
        "headline",
        {
            "lead": " ".join(text for text in (lead, findings(comparison)) if text),
            "warning": " ".join(f"{capitalised(note)}." for note in comparison.notes),
            "tiles": [
                Tile(f"{by.positions[name]}. {name}", by.median(name), by.quartile_range(name))
                for name in by.order[:MOST_TILES]
            ],
            "facts": facts,
        },
    )


def groups_of(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """Return name -> data of a group for the script, in the order of the headline measure.

    The data have the group's name; ``role``, the name of its colour; ``style``, its class in the
    style sheet; and ``is_again``, whether another group has the same colour.
    """
    colours = {name: i for i, name in enumerate(comparison.groups)}
    groups = {}
    for name in comparison.headline.order:
        round_number, colour = divmod(colours[name], COLOURS)
        role, is_again = f"group-{colour}", round_number > 0
        style = f"{role} again" if is_again else role
        groups[name] = {"name": name, "role": role, "style": style, "is_again": is_again}
    return groups


def _results(comparison: Comparison) -> Iterator[DataBlock]:
    """Yield the table of the main measures, and the table of the other measures."""
    main = comparison.main_measures
    yield group_table(comparison, main)
    if others := [by for by in comparison.measures if by not in main]:
        yield group_table(comparison, others)


def group_table(comparison: Comparison, measures: Sequence[MeasureComparison]) -> DataBlock:
    """Return a table with a row per group: the median and the quartiles of some measures.

    A measure with the same value in all campaigns is in the caption.
    """
    varying = [by for by in measures if by.is_tested]
    alike = [f"{by.measure.title} {_common_value(by)}" for by in measures if not by.is_tested]
    alike_text = f" The same in all campaigns: {', '.join(alike)}." if alike else ""
    return DataBlock(
        "groupTable",
        {
            "columns": [by.measure for by in varying],
            "rows": [
                (group, [(by.median(name), by.quartile_range(name)) for by in varying])
                for name, group in groups_of(comparison).items()
            ],
            "caption": f"Median, and under it the quartiles.{alike_text}",
        },
    )


def _common_value(by: MeasureComparison) -> str:
    """Return the value that all campaigns have by a measure, as text."""
    return by.measure.text(next(iter(by.values.values()))[0])


def group_charts(comparison: Comparison) -> dict[Curve, Chart]:
    """Return a chart of each curve that all campaigns have.

    A chart has the median of each group with a band between the quartiles; a group of few campaigns
    has a thin line for each campaign in place of the band.
    """
    charts: dict[Curve, Chart] = {}
    for curve in CURVES.values():
        points = {name: curve.of_group(group) for name, group in comparison.groups.items()}
        lines = tuple(
            _line(group, *points_of_group)
            for group in groups_of(comparison).values()
            if (points_of_group := points[group["name"]]) is not None
        )
        if len(lines) == len(points):
            charts[curve] = Chart(lines, curve.x_title, curve.title, curve.caption, counts=True)
    return charts


def _curves_text(comparison: Comparison) -> str:
    """Return a text about what the curves show."""
    band = "the band lies between the quartiles"
    if min(map(len, comparison.groups.values())) < LEAST_REPEATS:
        band = (
            f"the band between the quartiles needs {LEAST_REPEATS} campaigns; with fewer, each"
            " campaign is a thin line"
        )
    return (
        f"Median of each group; {band}. A curve ends where the shortest campaign of its group ends."
        " A distinct failure counts from its first test on."
    )


def _line(group: dict[str, Any], positions: FloatArray, counts: IntArray) -> Series:
    """Return a group's line in a chart.

    Args:
        group: data of the group, see `groups_of`.
        positions: positions of the counts, (n,).
        counts: counts of each campaign, (campaigns, n).
    """
    shown = evenly(len(positions), POINTS)
    low, median, high = (
        tuple(np.round(line[shown], 2).tolist())
        for line in np.quantile(counts, (0.25, 0.5, 0.75), axis=0)
    )
    has_band = len(counts) >= LEAST_REPEATS
    shows_each = not has_band and len(counts) > 1
    return Series(
        name=group["name"],
        x=tuple(np.round(positions[shown], 4).tolist()),
        y=median,
        low=low if has_band else (),
        high=high if has_band else (),
        role=group["role"],
        dashed=group["is_again"],
        singles=tuple(tuple(line[shown].tolist()) for line in counts) if shows_each else (),
    )


def group_spreads(comparison: Comparison) -> DataBlock:
    """Return the block with each campaign's value, measure by measure."""
    groups = groups_of(comparison)
    return DataBlock(
        "spreads",
        {
            "panels": [_spread_panel(by, groups) for by in comparison.measures],
            "caption": "A point is a campaign, the line in the box the median, the box reaches"
            " from the first to the third quartile.",
        },
    )


def _spread_panel(by: MeasureComparison, groups: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return a measure's values for the script, with a row per group.

    All positions are in percent of a track. Campaigns without a value are at the worse end of the
    track, apart from the others.
    """
    every = [value for name in groups for value in by.values[name]]
    known = [value for value in every if isfinite(value)]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    if low == high:  # all values are alike: the track shows their distance to 0
        low, high = (0.0, 1.0) if low == 0.0 else (min(low, 0.0), max(high, 0.0))
    first, last, without_value = 0.0, 100.0, 0.0 if by.measure.more_is_better else 100.0
    has_missing = len(known) < len(every)
    if has_missing and by.measure.more_is_better:
        first = _END_WIDTH
    elif has_missing:
        last = 100.0 - _END_WIDTH

    def position(value: float) -> float:
        if not isfinite(value):
            return without_value
        return round(first + (last - first) * (value - low) / (high - low), 2)

    numbers = MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(low, high)
    ticks = [
        (position(number), proper(f"{number:.6g}")) for number in numbers if low <= number <= high
    ]
    if has_missing:  # its label needs room among the numbers
        ticks = [tick for tick in ticks if abs(tick[0] - without_value) > 20.0]
        ticks.append((without_value, "none"))
    rows = []
    for name, group in groups.items():
        values, quartiles = sorted(by.values[name]), by.quartiles(name)
        box = [position(value) for value in (quartiles.low, quartiles.median, quartiles.high)]
        rows.append(
            {
                "group": group,
                "places": [position(value) for value in values],
                "texts": ", ".join(map(by.measure.text, values)),
                "median": by.median(name),
                "box": box if quartiles.n >= LEAST_REPEATS else None,
            }
        )
    note = f"{by.measure.better} is better"
    return {"title": by.measure.heading, "note": note, "spreads": rows, "ticks": ticks}


def _pairs(comparison: Comparison) -> Iterator[Section]:
    """Yield the section that compares each two groups by each measure; nothing for one group."""
    if len(comparison.groups) > 1:
        columns = ("by", "what can be said", ">A12", "effect", ">p")
        rows = tuple(pair_rows(comparison.measures))
        caption = (
            "A12: the chance that a campaign of the first group does better than one of the second."
        )
        yield Section("pairs", "Pair by pair", (Table(columns, rows, caption),))


def _campaigns(comparison: Comparison, folder: Path) -> Table:
    """Return the table of all campaigns, with links to their reports from a page in a folder."""
    campaigns = [
        (group, campaign) for group, members in comparison.groups.items() for campaign in members
    ]
    numbers = (">seed", ">simulations", ">failures", ">distinct", ">invalid", ">errors")
    return Table(
        ("campaign", "group", *numbers, "finished"),
        tuple(
            (
                _relative(campaign.folder, folder) or str(campaign.folder),
                group,
                "–" if campaign.seed is None else str(campaign.seed),
                str(campaign.simulations),
                str(campaign.failures),
                str(campaign.distinct_failures),
                str(campaign.counts.invalid),
                str(campaign.counts.errors),
                "yes" if campaign.is_finished else "no",
            )
            for group, campaign in campaigns
        ),
        links=tuple(_link(campaign, folder) for _, campaign in campaigns),
    )


def _relative(path: Path, folder: Path) -> str | None:
    """Return a path relative to a folder; None if they lie on different drives."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except (OSError, ValueError):  # another drive
        return None


def _link(campaign: CampaignMeasures, folder: Path) -> str | None:
    """Return the address of a campaign's report from a page in a folder; None without a report."""
    report = campaign.folder / REPORT
    try:
        address = _relative(report, folder) if report.is_file() else None
    except OSError:
        return None
    return None if address is None else quote(address)
