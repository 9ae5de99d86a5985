"""Findings of a comparison, in words."""

from __future__ import annotations

from collections.abc import Sequence

from frenetic._support.words import counted
from frenetic.analysis.comparison import Comparison, MeasureComparison
from frenetic.analysis.statistics import LEAST_REPEATS, SIGNIFICANT


def findings(comparison: Comparison) -> str:
    """Findings of a comparison by its headline measure, in a sentence or two."""
    by = comparison.headline
    order = by.order
    values = [f"{name} {by.text(name)}" for name in _few(order)]
    left = len(order) - len(values)
    rest = f", {counted(left, 'group')} between" if left else ""
    told = f"Median (quartiles) of {by.measure.title}: {'; '.join(values)}{rest}."
    return f"{verdict(comparison)} {told}"


def verdict(comparison: Comparison) -> str:
    """Verdict on the first group by the headline measure, in a sentence."""
    by = comparison.headline
    if len(by.values) == 1:
        return "There is nobody to compare with."
    first = [name for name in by.order if by.places[name] == 1]
    if min(len(values) for values in by.values.values()) < LEAST_REPEATS:
        return f"Too few repeats to tell: at least {LEAST_REPEATS} campaigns a group are needed."
    if not any(pair.better for pair in by.pairs):
        if by.p_overall is not None and by.p_overall < SIGNIFICANT:
            return (
                f"No two groups are shown to differ in {by.measure.title}, though not all are alike"
                f" (Kruskal-Wallis p {p_text(by.p_overall)})."
            )
        return f"No difference in {by.measure.title} is shown."
    best = first[0]
    worse = by.worse_than(best)
    level = [name for name in by.values if name != best and name not in worse]
    if len(first) > 1 or not worse:
        return f"No group is shown to find the most {by.measure.title}."
    if not level:
        return f"{best} finds more {by.measure.title} than {in_short(worse)}{_evidence(by)}."
    return (
        f"{best} comes first in {by.measure.title}, shown to find more than {in_short(worse)},"
        f" not than {in_short(level)}."
    )


def _evidence(by: MeasureComparison) -> str:
    """Effect and p of a single pair."""
    if len(by.pairs) > 1:
        return ", which is shown for each of them"
    (pair,) = by.pairs
    odds = max(pair.a12, 1.0 - pair.a12)
    return f" (A12 {odds:.2f}, {pair.magnitude}; p {p_text(pair.p)})"


def _few(order: Sequence[str]) -> list[str]:
    return list(order) if len(order) <= 4 else [*order[:3], order[-1]]


def in_short(names: Sequence[str], most: int = 3) -> str:
    """Names in a row; of many, the first and the number of others."""
    named = (
        list(names)
        if len(names) <= most
        else [*names[: most - 1], f"{len(names) - most + 1} others"]
    )
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"


def p_text(value: float) -> str:
    """A p value with its meaningful digits."""
    if value < 0.001:
        return "< 0.001"
    return f"{value:.2g}" if value < 0.1 else f"{value:.2f}"
