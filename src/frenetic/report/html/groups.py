"""Blocks that show a comparison's groups side by side: a table, curves, spreads, and pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from frenetic._support.arrays import evenly
from frenetic._support.words import capitalised
from frenetic.analysis.comparison import Comparison, MeasureComparison, PairComparison
from frenetic.analysis.conclusions import p_text
from frenetic.analysis.metrics import Curve, Measure, Topic, curves
from frenetic.analysis.statistics import LEAST_REPEATS
from frenetic.report.html.blocks import percent

POINTS: Final = 400
"""Most points of a curve."""
_CURVES: Final[tuple[tuple[Curve, str], ...]] = (
    ("distinct_after", "distinct failures"),
    ("failures_after", "failures"),
    ("cells_after", "cells of the feature map"),
)


@dataclass(frozen=True)
class Group:
    """A compared group, with its own colour."""

    name: str
    colour: int
    """Number of the colour from 0; the page repeats its colours, lighter or dashed, if needed."""


@dataclass(frozen=True)
class GroupColumn:
    """A measure of all groups."""

    title: str
    better: str
    """``more``, ``less`` or ``neither``."""
    topic: str = ""
    """A title over neighbouring columns that share it."""
    text: str = ""
    """Explanation, shown on demand."""


@dataclass(frozen=True)
class GroupCell:
    """Value of a measure for a group."""

    value: str
    note: str = ""
    """Small text under the value."""
    strength: float = 0.0
    """Emphasis in its column, 0..1."""


@dataclass(frozen=True)
class GroupTable:
    """A row per group, a column per measure."""

    kind: ClassVar[str] = "groupTable"
    title: str
    groups: tuple[Group, ...]
    columns: tuple[GroupColumn, ...]
    rows: tuple[tuple[GroupCell, ...], ...]
    """One per group, with a cell per column."""
    caption: str = ""


@dataclass(frozen=True)
class GroupCurve:
    """Results of a group's campaigns over the spent budget."""

    group: Group
    x: tuple[float, ...]
    median: tuple[float, ...]
    low: tuple[float, ...] = ()
    """First quartile, as many as points, or none."""
    high: tuple[float, ...] = ()
    """Third quartile, likewise."""
    singles: tuple[tuple[float, ...], ...] = ()
    """Each campaign, if they are too few for quartiles."""


@dataclass(frozen=True)
class CurvePanel:
    """A chart with a curve per group."""

    title: str
    curves: tuple[GroupCurve, ...]


@dataclass(frozen=True)
class Curves:
    """Charts with a common legend; the first is the largest."""

    kind: ClassVar[str] = "curves"
    x_title: str
    panels: tuple[CurvePanel, ...]
    caption: str = ""


@dataclass(frozen=True)
class Spread:
    """The values of a group."""

    group: Group
    values: tuple[float, ...]
    """One value per campaign, ascending; infinite for one that is worse than any number."""
    texts: tuple[str, ...]
    """The same, for people."""
    median: str
    """The median, for people."""
    quartiles: tuple[float, float, float] | None
    """First, median and third; None if there are too few values."""


@dataclass(frozen=True)
class SpreadPanel:
    """Distribution of a measure in each group."""

    title: str
    note: str
    none_is_low: bool
    """Whether a value worse than any number stands on the left."""
    spreads: tuple[Spread, ...]


@dataclass(frozen=True)
class Spreads:
    """A point per campaign over a box from quartile to quartile, panel by panel."""

    kind: ClassVar[str] = "spreads"
    panels: tuple[SpreadPanel, ...]
    caption: str = ""


@dataclass(frozen=True)
class Pair:
    """Two groups, compared."""

    first: Group
    second: Group
    a12: float
    effect: str
    p: str
    p_corrected: str
    verdict: str
    better: int
    """1 if the first is better, 2 if the second is, 0 if no difference is shown."""


@dataclass(frozen=True)
class PairsBy:
    """All pairs, compared by a measure."""

    title: str
    note: str
    pairs: tuple[Pair, ...]


@dataclass(frozen=True)
class Pairs:
    """Pairs of groups, compared by a measure that the reader chooses."""

    kind: ClassVar[str] = "pairs"
    measures: tuple[PairsBy, ...]
    caption: str = ""


# Made of a comparison


def groups_of(comparison: Comparison) -> tuple[Group, ...]:
    """The groups in the order of the headline measure."""
    colours = {name: i for i, name in enumerate(comparison.groups)}
    return tuple(Group(name, colours[name]) for name in comparison.headline.order)


def group_tables(comparison: Comparison, groups: tuple[Group, ...]) -> Iterator[GroupTable]:
    """Medians, ranks, and filled cells of the feature maps."""
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
                    f"{one.places[group.name]}.",
                    f"{one.mean_ranks[group.name]:.1f}",
                    (number - one.places[group.name]) / (number - 1),
                )
                for one in ranked
            )
            for group in groups
        ),
        "Place by median; equal medians by the mean rank of the group's campaigns among all"
        f" {sum(map(len, comparison.groups.values()))} campaigns, which stands beneath; 1 is the"
        " best. A place says nothing of whether a difference is more than chance: see the pairs.",
    )


def _varying(
    comparison: Comparison,
) -> tuple[list[MeasureComparison], list[tuple[MeasureComparison, float]]]:
    """The measures that differ between campaigns, and the constant ones with their value."""
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
        f"{capitalised(measure.title)}: {measure.definition}",
    )


def _quartiles(by: MeasureComparison, group: str) -> str:
    """The quartiles of a group, in short; empty if they equal the median."""
    between = by.between(group)
    low, _, high = between.partition(" to ")
    if low == high:
        return ""
    return between if "-" in between else f"{low}–{high}"  # a dash before a minus is unreadable


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


def group_curves(comparison: Comparison, groups: tuple[Group, ...]) -> Curves:
    """Findings over the simulations."""
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


def group_spreads(comparison: Comparison, groups: tuple[Group, ...]) -> Spreads:
    """Each campaign's value, by each measure."""
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
        tuple(values),
        tuple(by.measure.text(value) for value in values),
        by.measure.text(found.median),
        (found.low, found.median, found.high) if enough else None,
    )


def group_pairs(comparison: Comparison, groups: tuple[Group, ...]) -> Pairs:
    """Each two groups, by each measure."""
    known = {group.name: group for group in groups}
    several = len(groups) > 2
    return Pairs(
        tuple(
            PairsBy(
                one.measure.heading,
                f"{one.measure.better} is better{_overall(one)}",
                tuple(_pair(one, pair, known) for pair in _in_order(one, groups)),
            )
            for one in comparison.telling
        ),
        "A12: the chance that a campaign of the first group does better than one of the second."
        + (" p is corrected by Holm for the number of pairs." if several else ""),
    )


def _in_order(by: MeasureComparison, groups: tuple[Group, ...]) -> list[PairComparison]:
    """All pairs, in the order of the groups in the page."""
    place = {group.name: i for i, group in enumerate(groups)}

    def key(pair: PairComparison) -> list[int]:
        return sorted((place[pair.first], place[pair.second]))

    return [
        pair if place[pair.first] < place[pair.second] else pair.turned
        for pair in sorted(by.pairs, key=key)
    ]


def _pair(by: MeasureComparison, pair: PairComparison, known: dict[str, Group]) -> Pair:
    said = str(pair.verdict)
    if pair.better is not None:
        which = "first" if pair.better == pair.first else "second"
        said = f"the {which} {by.measure.comparative}"
    enough = min(pair.repeats) >= LEAST_REPEATS
    return Pair(
        known[pair.first],
        known[pair.second],
        pair.a12,
        str(pair.magnitude) if enough else "–",
        p_text(pair.p) if enough else "–",
        p_text(pair.p_corrected) if enough else "–",
        said,
        0 if pair.better is None else 1 if pair.better == pair.first else 2,
    )
