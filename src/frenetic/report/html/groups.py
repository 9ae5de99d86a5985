"""A comparison's groups side by side: tables, curves, spreads, and pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import evenly
from frenetic._support.words import capitalised
from frenetic.analysis.comparison import Comparison, MeasureComparison, PairComparison, p_text
from frenetic.analysis.metrics import Curve, Measure, curves
from frenetic.analysis.statistics import LEAST_REPEATS
from frenetic.report.html.blocks import Chart, Part, Series, round_numbers, tick_text

POINTS: Final = 400
"""Most points of a curve."""
COLOURS: Final = 8
"""Colours of groups; when all are taken they come again, with dashed lines and hollow marks."""
_SHADES: Final = 5
_CURVES: Final[tuple[tuple[Curve, str], ...]] = (
    ("distinct_after", "distinct failures"),
    ("failures_after", "failures"),
)


def groups_of(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """Name -> group, in the order of the headline measure, each with its own colour.

    ``role`` names the colour, ``style`` is its class in the style sheet.
    """
    colours = {name: i for i, name in enumerate(comparison.groups)}
    groups = {}
    for name in comparison.headline.order:
        again, colour = divmod(colours[name], COLOURS)
        role = f"group-{colour}"
        style = f"{role} again" if again else role
        groups[name] = {"name": name, "role": role, "style": style, "is_again": bool(again)}
    return groups


def group_tables(comparison: Comparison) -> Iterator[Part]:
    """Medians and ranks."""
    varying: list[MeasureComparison] = []
    alike: list[str] = []
    for by in comparison.measures:
        values = {value for group in by.values.values() for value in group}
        if len(values) > 1:
            varying.append(by)
        else:
            alike.append(f"{by.measure.title} {by.measure.text(values.pop())}")
    groups, number = groups_of(comparison), len(comparison.groups)

    def table(title: str, cell: Any, caption: str) -> Part:
        """A row per group: value, a small text under it, and a shade from 0 in each column."""
        rows = [(group, [cell(by, name) for by in varying]) for name, group in groups.items()]
        columns = [_column(by.measure) for by in varying]
        data = {"title": title, "columns": columns, "rows": rows, "caption": caption}
        return Part("groupTable", data)

    def median(by: MeasureComparison, name: str) -> tuple[str, str, int]:
        return by.measure.text(by.quartiles(name).median), _quartiles(by, name), 0

    def rank(by: MeasureComparison, name: str) -> tuple[str, str, int]:
        place = by.places[name]
        shade = round(_SHADES * (number - place) / (number - 1))
        return f"{place}.", f"{by.mean_ranks[name]:.1f}", shade

    same = f" The same in all campaigns: {', '.join(alike)}." if alike else ""
    yield table("Medians", median, f"Median, and under it the quartiles.{same}")
    if number > 1:
        yield table(
            "Ranks",
            rank,
            "Place by median; equal medians by the mean rank of the group's campaigns among all"
            f" {sum(map(len, comparison.groups.values()))} campaigns, which stands beneath; 1 is"
            " the best. A place says nothing of whether a difference is more than chance: see the"
            " pairs.",
        )


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


def group_curves(comparison: Comparison) -> Iterator[Chart]:
    """Findings over the simulations: a median, and a band or each campaign, for each group."""
    band = "the band lies between the quartiles"
    if min(map(len, comparison.groups.values())) < LEAST_REPEATS:
        band = (
            f"the band between the quartiles needs {LEAST_REPEATS} campaigns, below that each"
            " campaign is a thin line"
        )
    caption = (
        f"Median of each group; {band}. A curve reaches as far as all campaigns of its group. A"
        " distinct failure counts from the first of those alike."
    )
    groups = groups_of(comparison).values()
    for what, title in _CURVES:
        lines = tuple(_curve(comparison, group, what) for group in groups)
        is_last = what == _CURVES[-1][0]
        yield Chart(lines, "simulations", title, caption if is_last else "", counts=True)


def _curve(comparison: Comparison, group: dict[str, Any], what: Curve) -> Series:
    found = curves(comparison.groups[group["name"]], what)
    shown = evenly(found.shape[1], POINTS).tolist()
    low, median, high = (
        tuple(np.round(line[shown], 2).tolist())
        for line in np.quantile(found, (0.25, 0.5, 0.75), axis=0)
    )
    has_band = len(found) >= LEAST_REPEATS
    shows_each = not has_band and len(found) > 1
    return Series(
        group["name"],
        tuple(shown),
        median,
        low if has_band else (),
        high if has_band else (),
        role=group["role"],
        dashed=group["is_again"],
        singles=tuple(tuple(line[shown].tolist()) for line in found) if shows_each else (),
    )


def group_spreads(comparison: Comparison) -> Part:
    """Each campaign's value, by each measure."""
    groups = groups_of(comparison)
    return Part(
        "spreads",
        {
            "panels": [spread_panel(by, groups) for by in comparison.measures],
            "caption": "A point is a campaign, the line in the box the median, the box reaches"
            " from the first to the third quartile.",
        },
    )


def spread_panel(by: MeasureComparison, groups: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """A measure's values, a row per group; all places are in percent of a track.

    What is worse than any number stands at an end of its own.
    """
    every = [value for name in groups for value in by.values[name]]
    known = [value for value in every if isfinite(value)]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    if low == high:  # then it is shown how far they are from zero
        low, high = (0.0, 1.0) if low == 0.0 else (min(low, 0.0), max(high, 0.0))
    more = by.measure.more_is_better
    nowhere = 0.0 if more else 100.0
    first, last = 0.0, 100.0
    if has_none := len(known) < len(every):
        first, last = (14.0, 100.0) if more else (0.0, 86.0)

    def at(value: float) -> float:
        if not isfinite(value):
            return nowhere
        return round(first + (last - first) * (value - low) / (high - low), 2)

    ticks = [(at(one), tick_text(one)) for one in round_numbers(low, high) if low <= one <= high]
    if has_none:
        ticks = [tick for tick in ticks if abs(tick[0] - nowhere) > 20.0] + [(nowhere, "none")]
    rows = []
    for name, group in groups.items():
        values, quartiles = sorted(by.values[name]), by.quartiles(name)
        box = [at(value) for value in (quartiles.low, quartiles.median, quartiles.high)]
        rows.append(
            {
                "group": group,
                "places": [at(value) for value in values],
                "texts": ", ".join(map(by.measure.text, values)),
                "median": by.measure.text(quartiles.median),
                "box": box if quartiles.n >= LEAST_REPEATS else None,
            }
        )
    return {"title": by.measure.heading, "note": _note(by), "spreads": rows, "ticks": ticks}


def _note(by: MeasureComparison) -> str:
    """What is better, and what can be said of all groups."""
    better = f"{by.measure.better} is better"
    if min(len(values) for values in by.values.values()) < LEAST_REPEATS:
        return f"{better}; too few repeats to tell"
    if len(by.pairs) == 1:
        (pair,) = by.pairs
        return f"{better}; A12 {pair.a12:.2f} ({pair.magnitude}), p {p_text(pair.p)}"
    shown = sum(pair.better is not None for pair in by.pairs)
    return f"{better}; {shown} of {len(by.pairs)} pairs differ" if by.pairs else better


def group_pairs(comparison: Comparison) -> Part:
    """Each two groups, by each measure, in the order of the groups in the page."""
    groups = groups_of(comparison)
    place = {name: i for i, name in enumerate(groups)}

    def row(by: MeasureComparison, pair: PairComparison) -> dict[str, Any]:
        better = 0 if pair.better is None else 1 if pair.better == pair.first else 2
        enough = min(pair.repeats) >= LEAST_REPEATS
        return {
            "first": groups[pair.first],
            "second": groups[pair.second],
            "a12": pair.a12,
            "effect": str(pair.magnitude) if enough else "–",
            "p": p_text(pair.p) if enough else "–",
            "p_corrected": p_text(pair.p_corrected) if enough else "–",
            "verdict": f"the {('first', 'second')[better - 1]} has {by.measure.better}"
            if better
            else str(pair.verdict),
            "better": better,
        }

    def rows(by: MeasureComparison) -> Sequence[dict[str, Any]]:
        turned = [p if place[p.first] < place[p.second] else p.turned for p in by.pairs]
        turned.sort(key=lambda pair: (place[pair.first], place[pair.second]))
        return [row(by, pair) for pair in turned]

    caption = (
        "A12: the chance that a campaign of the first group does better than one of the second."
    )
    if len(groups) > 2:
        caption += " p is corrected by Holm for the number of pairs."
    measures = [
        {"title": by.measure.heading, "note": _note(by), "pairs": rows(by)}
        for by in comparison.measures
    ]
    return Part("pairs", {"measures": measures, "caption": caption})
