"""A comparison of groups of campaigns as one HTML file: `write_comparison_page`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import quote

from frenetic._support.words import capitalised
from frenetic.analysis.comparison import Comparison, findings, in_short
from frenetic.analysis.metrics import CampaignMeasures, Measure
from frenetic.analysis.statistics import LEAST_REPEATS, SIGNIFICANT
from frenetic.report.html.blocks import (
    Block,
    Column,
    Fact,
    Facts,
    Headline,
    Section,
    Table,
    Tile,
)
from frenetic.report.html.blocks import command as command_block
from frenetic.report.html.campaign import REPORT
from frenetic.report.html.groups import group_curves, group_pairs, group_spreads, group_tables
from frenetic.report.html.page import Report, write_page

MOST_TILES: Final = 8
"""Most groups in the headline."""

_STATISTICS: Final = (
    Fact("median, quartiles", "Half of a group's campaigns lie between the quartiles."),
    Fact(
        "order",
        "All tables and charts list the groups by the median of the main measure. Of equal medians"
        " the better mean rank comes first.",
    ),
    Fact(
        "mean rank",
        "All campaigns of all groups are put in one order: the best has rank 1, equal ones share"
        " the mean of their ranks. Then the mean over a group's campaigns.",
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
    sections: Sequence[Section] = (),
) -> Path:
    """Writes a comparison as one HTML file that needs nothing else.

    Campaigns whose folder holds a ``report.html`` are linked to it, relative to the page.

    Args:
        comparison: of one or more groups.
        path: of the file, which is replaced.
        title: of the page; by default the names of the groups.
        lead: a sentence or two before the findings.
        facts: other facts about the campaigns for the reader.
        command: the command line that repeats the page.
        sections: others, after the results.

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
        command=command,
        sections=sections,
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
    sections: Sequence[Section] = (),
) -> Report:
    """The page of a comparison, to lie in ``folder``.

    The other arguments are those of `write_comparison_page`.
    """
    title = title or f"{in_short(list(comparison.groups))} compared"
    pairs = Section("pairs", "Pair by pair", (group_pairs(comparison),))
    return Report(
        title=title,
        sections=(
            Section("summary", title, (_headline(comparison, lead),)),
            Section("results", "Results", tuple(group_tables(comparison))),
            *sections,
            Section("curves", "Over the budget", tuple(group_curves(comparison))),
            Section("spreads", "Campaign by campaign", (group_spreads(comparison),)),
            *([pairs] if len(comparison.groups) > 1 else []),
            Section("measures", "What is measured", tuple(_definitions(comparison))),
            Section("campaigns", "Campaigns", (_campaigns(comparison, folder),)),
            _configuration(comparison, facts, command),
        ),
    )


def _headline(comparison: Comparison, lead: str) -> Headline:
    by = comparison.headline
    shown = by.order[:MOST_TILES]
    tiles = [
        Tile(
            f"{by.places[name]}. {name}",
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
        warning=" ".join(f"{capitalised(note)}." for note in comparison.notes),
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
                for part in ("driver", "simulator", "domain")
                if part in comparison.shared
            ),
        ),
    )


def _sizes(comparison: Comparison) -> str:
    sizes = {name: len(group) for name, group in comparison.groups.items()}
    if len(set(sizes.values())) == 1:
        each = f"{next(iter(sizes.values()))} of each of {len(sizes)} groups"
    else:
        each = ", ".join(f"{size} of {name}" for name, size in sizes.items())
    return f"{sum(sizes.values())}: {each}"


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low} to {high}"


# Definitions and sources


def _definitions(comparison: Comparison) -> Iterator[Block]:
    measured = tuple(_definition(one.measure) for one in comparison.measures)
    yield Facts(measured, "Measures")
    yield Facts(_STATISTICS, "Statistics")


def _definition(measure: Measure) -> Fact:
    unit = f" {measure.unit}" if measure.unit else ""
    better = f"{capitalised(measure.better)} is better"
    return Fact(measure.title, f"{measure.definition} {better}; {measure.bounds}{unit}.")


def _campaigns(comparison: Comparison, folder: Path) -> Table:
    campaigns = [
        (group, campaign) for group, found in comparison.groups.items() for campaign in found
    ]
    numbers = ("seed", "simulations", "failures", "distinct", "invalid", "errors")
    columns = (
        Column("campaign"),
        Column("group"),
        *(Column(name, is_number=True) for name in numbers),
        Column("finished"),
    )
    return Table(
        columns,
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
        tall=len(campaigns) > 15,
    )


def _relative(place: Path, folder: Path) -> str | None:
    """A place as seen from a folder; None where there is no way."""
    try:
        return Path(os.path.relpath(place.resolve(), folder.resolve())).as_posix()
    except (OSError, ValueError):  # another drive
        return None


def _link(campaign: CampaignMeasures, folder: Path) -> str | None:
    """The address of a campaign's report, from a page in a folder; None if there is none."""
    report = campaign.folder / REPORT
    try:
        address = _relative(report, folder) if report.is_file() else None
    except OSError:
        return None
    return None if address is None else quote(address)


def _configuration(comparison: Comparison, facts: Sequence[Fact], command: str | None) -> Section:
    blocks: list[Block] = []
    if command:
        blocks.append(command_block(command, "Makes this again:"))
    if facts:
        blocks.append(Facts(tuple(facts)))
    if comparison.shared:
        shared = tuple(Fact(part, value) for part, value in comparison.shared.items())
        blocks.append(Facts(shared, "The same in all campaigns"))
    return Section("configuration", "Configuration", tuple(blocks))
