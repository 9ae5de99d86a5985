"""Findings of a comparison, in words."""

from __future__ import annotations

from collections.abc import Sequence

from frenetic._support.words import counted
from frenetic.analysis.comparison import Comparison
from frenetic.analysis.statistics import LEAST_REPEATS


def findings(comparison: Comparison) -> str:
    """Findings of a comparison by its headline measure, in a sentence or two."""
    by = comparison.headline
    order = by.order
    few = order if len(order) <= 4 else (*order[:3], order[-1])
    values = [f"{name} {by.text(name)}" for name in few]
    left = len(order) - len(few)
    rest = f", {counted(left, 'group')} between" if left else ""
    told = f"Median (quartiles) of {by.measure.title}: {'; '.join(values)}{rest}."
    return f"{verdict(comparison)} {told}"


def verdict(comparison: Comparison) -> str:
    """Verdict on the first group by the headline measure, in a sentence."""
    by = comparison.headline
    if len(by.values) == 1:
        return "There is nobody to compare with."
    if min(len(values) for values in by.values.values()) < LEAST_REPEATS:
        return f"Too few repeats to tell: at least {LEAST_REPEATS} campaigns a group are needed."
    if not any(pair.better for pair in by.pairs):
        return f"No difference in {by.measure.title} is shown."
    best, second = by.order[:2]
    worse = by.worse_than(best)
    if by.places[second] == 1 or not worse:
        return f"No group is shown to find the most {by.measure.title}."
    if level := [name for name in by.values if name != best and name not in worse]:
        return (
            f"{best} comes first in {by.measure.title}, shown to find more than {in_short(worse)},"
            f" not than {in_short(level)}."
        )
    evidence = ", which is shown for each of them"
    if len(by.pairs) == 1:
        (pair,) = by.pairs
        odds = max(pair.a12, 1.0 - pair.a12)
        evidence = f" (A12 {odds:.2f}, {pair.magnitude}; p {p_text(pair.p)})"
    return f"{best} finds more {by.measure.title} than {in_short(worse)}{evidence}."


def in_short(names: Sequence[str], most: int = 3) -> str:
    """Names in a row; of many, the first and the number of others."""
    if len(names) > most:
        names = [*names[: most - 1], f"{len(names) - most + 1} others"]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def p_text(value: float) -> str:
    """A p value with its meaningful digits."""
    if value < 0.001:
        return "< 0.001"
    return f"{value:.2g}" if value < 0.1 else f"{value:.2f}"
