"""Comparisons of groups of campaigns as sentences and rows of a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from frenetic._support.words import counted, in_short
from frenetic.analysis.comparison import Comparison, MeasureComparison

_FULLY_LISTED: Final = 4  # most groups of which a sentence gives all medians (our choice)


def findings(comparison: Comparison) -> str:
    """Return the findings by the headline measure, in a sentence or two."""
    headline = comparison.headline
    order = headline.order
    # The best groups and the worst.
    listed = order if len(order) <= _FULLY_LISTED else (*order[: _FULLY_LISTED - 1], order[-1])
    values = [f"{name} {headline.text(name)}" for name in listed]
    left_out = len(order) - len(listed)
    rest = f", {counted(left_out, 'group')} between" if left_out else ""
    medians = f"Median (quartiles) of {headline.measure.title}: {'; '.join(values)}{rest}."
    return f"{verdict(comparison)} {medians}"


def verdict(comparison: Comparison) -> str:
    """Return the verdict on the first group by the headline measure, in a sentence."""
    headline = comparison.headline
    title = headline.measure.title
    if len(headline.values) == 1:
        return "There is nobody to compare with."
    if not any(pair.has_enough_repeats for pair in headline.pairs):
        return f"Too few repeats to tell: {comparison.repeats_needed} campaigns a group are needed."
    if not any(pair.better for pair in headline.pairs):
        return f"No difference in {title} is shown."
    best, second = headline.order[:2]
    worse = headline.worse_than(best)
    if headline.positions[second] == 1 or not worse:
        return f"No group is shown to find the most {title}."
    not_worse = [name for name in headline.values if name != best and name not in worse]
    if not_worse:
        return (
            f"{best} comes first in {title}, shown to find more than {in_short(worse)},"
            f" not than {in_short(not_worse)}."
        )
    evidence = ", which is shown for each of them"
    if len(headline.pairs) == 1:
        (pair,) = headline.pairs
        best_a12 = max(pair.a12, 1.0 - pair.a12)
        evidence = f" (A12 {best_a12:.2f}, {pair.magnitude}; p {p_text(pair.p_corrected)})"
    return f"{best} finds more {title} than {in_short(worse)}{evidence}."


def pair_rows(measures: Iterable[MeasureComparison]) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield a row per measure and pair of groups: measure, verdict, A12, effect, corrected p.

    Only the first row of a measure names the measure. A12 is for the group that the verdict names
    first.
    """
    for comparison in measures:
        for i, pair in enumerate(comparison.pairs):
            effect, p = (
                (pair.magnitude, p_text(pair.p_corrected))
                if pair.has_enough_repeats
                else ("–", "–")
            )
            a12 = 1.0 - pair.a12 if pair.better == pair.second else pair.a12
            title = "" if i else comparison.measure.title
            yield title, comparison.pair_text(pair), f"{a12:.2f}", effect, p


def p_text(value: float) -> str:
    """Return a p value as text, with two digits at most."""
    if value < 0.001:
        return "< 0.001"
    return f"{value:.2g}" if value < 0.1 else f"{value:.2f}"
