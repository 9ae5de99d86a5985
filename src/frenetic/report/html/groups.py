"""A comparison's groups side by side: tables, curves, spreads, and pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import evenly
from frenetic._support.words import capitalised
from frenetic.analysis.comparison import Comparison, MeasureComparison, PairComparison, p_text
from frenetic.analysis.metrics import Curve, Measure, curves
from frenetic.analysis.statistics import LEAST_REPEATS
from frenetic.report.html.blocks import Chart, Part, Scale, Series

POINTS: Final = 400
"""Most points of a curve."""
_COLOURS: Final = 8
_SHADES: Final = 5
_CURVES: Final[tuple[tuple[Curve, str], ...]] = (
    ("distinct_after", "distinct failures"),
    ("failures_after", "failures"),
)


@dataclass(frozen=True)
class Group:
    """A compared group, with its own colour."""

    name: str
    colour: int
    """Number of the colour from 0."""

    @property
    def role(self) -> str:
        """Name of its colour."""
        return f"group-{self.colour % _COLOURS}"

    @property
    def is_again(self) -> bool:
        """Whether its colour is used once more: then lines are dashed, and marks hollow."""
        return self.colour >= _COLOURS

    @property
    def style(self) -> str:
        """Its class in the style sheet."""
        return f"{self.role} again" if self.is_again else self.role


# Made of a comparison


def groups_of(comparison: Comparison) -> tuple[Group, ...]:
    """The groups in the order of the headline measure."""
    colours = {name: i for i, name in enumerate(comparison.groups)}
    return tuple(Group(name, colours[name]) for name in comparison.headline.order)


def group_tables(comparison: Comparison, groups: tuple[Group, ...]) -> Iterator[Part]:
    """Medians and ranks."""
    varying, constant = _varying(comparison)
    alike = ", ".join(f"{one.measure.title} {one.measure.text(value)}" for one, value in constant)
    yield _table(
        "Medians",
        [_column(by.measure) for by in varying],
        [
            (
                group,
                [
                    (
                        by.measure.text(by.quartiles(group.name).median),
                        _quartiles(by, group.name),
                        0,
                    )
                    for by in varying
                ],
            )
            for group in groups
        ],
        "Median, and under it the quartiles."
        + (f" The same in all campaigns: {alike}." if alike else ""),
    )
    if len(groups) > 1:
        yield _ranks(comparison, groups, varying)


def _table(
    title: str,
    columns: Sequence[dict[str, str]],
    rows: Sequence[tuple[Group, Sequence[tuple[str, str, int]]]],
    caption: str,
) -> Part:
    """A row per group: value, a small text under it, and a shade from 0 in each column."""
    return Part(
        "groupTable",
        {"title": title, "columns": columns, "rows": rows, "caption": caption},
    )


def _ranks(
    comparison: Comparison, groups: tuple[Group, ...], varying: Sequence[MeasureComparison]
) -> Part:
    number = len(groups)
    return _table(
        "Ranks",
        [_column(by.measure) for by in varying],
        [
            (
                group,
                [
                    (
                        f"{by.places[group.name]}.",
                        f"{by.mean_ranks[group.name]:.1f}",
                        round(_SHADES * (number - by.places[group.name]) / (number - 1)),
                    )
                    for by in varying
                ],
            )
            for group in groups
        ],
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
    for by in comparison.measures:
        values = {value for group in by.values.values() for value in group}
        if len(values) == 1:
            constant.append((by, values.pop()))
        else:
            varying.append(by)
    return varying, constant


def _column(measure: Measure) -> dict[str, str]:
    unit = f" ({measure.unit})" if measure.unit else ""
    return {
        "title": f"{measure.short}{unit}",
        "better": measure.better,
        "text": f"{capitalised(measure.title)}: {measure.definition}",
    }


def _quartiles(by: MeasureComparison, group: str) -> str:
    """The quartiles of a group, in short; empty if they equal the median."""
    between = by.between(group)
    low, _, high = between.partition(" to ")
    if low == high:
        return ""
    return between if "-" in between else f"{low}–{high}"  # a dash before a minus is unreadable


def group_curves(comparison: Comparison, groups: tuple[Group, ...]) -> Iterator[Chart]:
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
    caption = (
        f"Median of each group; {band}. A curve reaches as far as all campaigns of its group. A"
        " distinct failure counts from the first of those alike."
    )
    for i, (what, title) in enumerate(_CURVES):
        lines = tuple(_curve(comparison, group, what) for group in groups)
        last = i == len(_CURVES) - 1
        yield Chart(lines, "simulations", title, caption if last else "", counts=True)


def _curve(comparison: Comparison, group: Group, what: Curve) -> Series:
    found = curves(comparison.groups[group.name], what)
    shown = evenly(found.shape[1], POINTS).tolist()
    low, median, high = (
        tuple(np.round(line[shown], 2).tolist())
        for line in np.quantile(found, (0.25, 0.5, 0.75), axis=0)
    )
    has_band = len(found) >= LEAST_REPEATS
    shows_each = not has_band and len(found) > 1
    return Series(
        group.name,
        tuple(shown),
        median,
        low if has_band else (),
        high if has_band else (),
        role=group.role,
        dashed=group.is_again,
        singles=tuple(tuple(line[shown].tolist()) for line in found) if shows_each else (),
    )


def group_spreads(comparison: Comparison, groups: tuple[Group, ...]) -> Part:
    """Each campaign's value, by each measure."""
    return Part(
        "spreads",
        {
            "panels": [_spread_panel(by, groups) for by in comparison.measures],
            "caption": "A point is a campaign, the line in the box the median, the box reaches"
            " from the first to the third quartile.",
        },
    )


def _spread_panel(by: MeasureComparison, groups: tuple[Group, ...]) -> dict[str, Any]:
    """A panel; what is worse than any number stands at an end of its own."""
    every = [value for group in groups for value in by.values[group.name]]
    known = [value for value in every if np.isfinite(value)]
    least, most = (min(known), max(known)) if known else (0.0, 1.0)
    if least == most:  # then it is shown how far they are from zero
        least, most = (0.0, 1.0) if least == 0.0 else (min(least, 0.0), max(most, 0.0))
    scale = Scale.of((least, most), fits=False)
    nowhere = 0.0 if by.measure.more_is_better else 100.0
    if len(known) < len(every):
        first, last = (14.0, 100.0) if by.measure.more_is_better else (0.0, 86.0)
        scale = replace(scale, first=first, last=last)

    def at(value: float) -> float:
        return scale.at(value) if np.isfinite(value) else nowhere

    ticks = [(at(value), f"{value:.6g}".replace("-", "−")) for value in scale.ticks]
    if len(known) < len(every):
        ticks = [tick for tick in ticks if abs(tick[0] - nowhere) > 20.0] + [(nowhere, "none")]
    spreads = []
    for group in groups:
        values = sorted(by.values[group.name])
        quartiles = by.quartiles(group.name)
        box = quartiles.low, quartiles.median, quartiles.high
        spreads.append(
            {
                "group": group,
                "places": [at(value) for value in values],
                "texts": ", ".join(map(by.measure.text, values)),
                "median": by.measure.text(quartiles.median),
                "box": [at(value) for value in box] if quartiles.n >= LEAST_REPEATS else None,
            }
        )
    note = f"{by.measure.better} is better"
    return {"title": by.measure.heading, "note": note, "spreads": spreads, "ticks": ticks}


def group_pairs(comparison: Comparison, groups: tuple[Group, ...]) -> Part:
    """Each two groups, by each measure."""
    known = {group.name: group for group in groups}
    return Part(
        "pairs",
        {
            "measures": [
                {
                    "title": by.measure.heading,
                    "note": f"{by.measure.better} is better",
                    "pairs": [_pair(by, pair, known) for pair in _in_order(by, groups)],
                }
                for by in comparison.measures
            ],
            "caption": "A12: the chance that a campaign of the first group does better than one of"
            " the second."
            + (" p is corrected by Holm for the number of pairs." if len(groups) > 2 else ""),
        },
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


def _pair(by: MeasureComparison, pair: PairComparison, known: dict[str, Group]) -> dict[str, Any]:
    said = str(pair.verdict)
    if pair.better is not None:
        which = "first" if pair.better == pair.first else "second"
        said = f"the {which} has {by.measure.better}"
    enough = min(pair.repeats) >= LEAST_REPEATS
    return {
        "first": known[pair.first],
        "second": known[pair.second],
        "a12": pair.a12,
        "effect": str(pair.magnitude) if enough else "–",
        "p": p_text(pair.p) if enough else "–",
        "p_corrected": p_text(pair.p_corrected) if enough else "–",
        "verdict": said,
        "better": 0 if pair.better is None else 1 if pair.better == pair.first else 2,
    }
