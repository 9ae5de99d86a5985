"""Differences between two versions of a driver as a sentence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from frenetic._support.words import counted
from frenetic.analysis.quality import QUALITY, QualityMeasure
from frenetic.analysis.quality_differences import PairedQuality, QualityDifference

NO_DIFFERENCE: Final = "no difference shown"
"""Verdict without a difference that is shown and better for anybody."""
_LARGEST_PERCENTAGE: Final = 300.0  # a larger one is told in the measure's unit; our choice
_MAIN: Final = ("rms_offset", "edge_distance", "rms_steering_rate")
"""Measures of which a sentence says how much could differ unseen."""


def shown_text(differences: Sequence[QualityDifference]) -> str:
    """Return differences as a sentence about the new version; an empty text without differences."""
    if not differences:
        return ""
    conditions = {difference.conditions for difference in differences}
    common = conditions.pop() if len(conditions) == 1 else None
    phrases = [_phrase(difference, names_conditions=common is None) for difference in differences]
    *others, last = phrases
    joined = f"{', '.join(others)}, and {last}" if len(others) > 1 else " and ".join(phrases)
    return f"with {common}, new {joined}" if common else f"new {joined}"


def _phrase(difference: QualityDifference, *, names_conditions: bool) -> str:
    """Return a difference in words, such as ``keeps 0.12 m closer to the middle (0.10 to 0.14)``.

    Args:
        difference: a difference other than 0.
        names_conditions: whether the words say in which conditions both drove.
    """
    measure, shift = difference.measure, difference.difference
    is_more = shift.value > 0.0
    where = f" with {difference.conditions}" if names_conditions and difference.conditions else ""
    if measure.is_share:
        shares = f"{difference.new:.0f} % of the roads{where} (old {difference.old:.0f} %)"
        return measure.phrases[is_more].format(shares)
    ends = (shift.low, shift.high) if is_more else (-shift.high, -shift.low)
    factor, unit, decimals = _scale(difference)
    amount = f"{factor * abs(shift.value):.{decimals}f} {unit}"
    interval = " to ".join(f"{factor * end:.{decimals}f}" for end in ends)
    return f"{measure.phrases[is_more].format(amount)}{where} ({interval})"


def _scale(difference: QualityDifference) -> tuple[float, str, int]:
    """Return factor, unit and decimals in which a sentence gives a difference."""
    measure, old = difference.measure, abs(difference.old)
    if measure.in_percent and 100.0 * abs(difference.difference.value) < _LARGEST_PERCENTAGE * old:
        return 100.0 / old, "%", 0
    return 1.0, measure.unit, measure.decimals


def no_difference_text(differences: Sequence[QualityDifference], classes: str = "") -> str:
    """Return that no difference is shown, and how large one could be unseen.

    Args:
        differences: differences in all kinds of conditions, none of which is shown.
        classes: road classes on which none is shown, in words; empty for a single class.
    """
    verdict = f"{NO_DIFFERENCE} on {classes}" if classes else NO_DIFFERENCE
    roads = max((difference.roads for difference in differences), default=0)
    if not roads:
        return f"{verdict}: there is no road that both pass"
    limits = [text for name in _MAIN if (text := _limit_text(QUALITY[name], differences))]
    if not limits:
        return f"{verdict}: the roads that both pass are too few, {roads}"
    return f"{verdict}: alike within {', '.join(limits)}"


def _limit_text(measure: QualityMeasure, differences: Sequence[QualityDifference]) -> str:
    """Return the largest difference by a measure that the intervals allow, in words.

    The text is empty if an interval is infinite.
    """
    intervals = [
        difference.difference for difference in differences if difference.measure is measure
    ]
    most = max((max(-shift.low, shift.high) for shift in intervals), default=math.inf)
    if not math.isfinite(most):
        return ""
    step = 10.0**-measure.decimals
    rounded = max(math.ceil(most / step - 1e-9), 1) * step
    return f"{rounded:.{measure.decimals}f} {measure.unit} ({measure.title})"


def drives_title(drives: PairedQuality) -> str:
    """Return the title of the drives in one kind of conditions."""
    conditions = (
        f"With {drives.conditions}" if drives.conditions else "In the campaign's conditions"
    )
    return f"{conditions}, on {counted(len(drives.pairs), 'road')} that both pass"


def difference_rows(
    differences: Iterable[QualityDifference], conditions: str
) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield a row for each measure: title with unit, old, new, difference with interval, verdict.

    Args:
        differences: differences in all kinds of conditions.
        conditions: conditions of the rows, in words.
    """
    for difference in differences:
        if difference.conditions == conditions:
            yield difference_row(difference)


def difference_row(difference: QualityDifference) -> tuple[str, str, str, str, str]:
    """Return title with unit, old, new, difference with interval, and what is shown."""
    measure, shift = difference.measure, difference.difference
    ends = (_signed(end, measure) for end in (shift.low, shift.high))
    verdict = ""
    if difference.is_shown:
        verdict = {1: "new is better", -1: "old is better", 0: "differs"}[difference.better]
    return (
        f"{measure.title} [{measure.unit}]",
        measure.text(difference.old),
        measure.text(difference.new),
        f"{_signed(shift.value, measure)} ({' to '.join(ends)})",
        verdict,
    )


def _signed(value: float, measure: QualityMeasure) -> str:
    """Return a difference in the measure's decimals, with a sign unless it is 0."""
    text = f"{value:+.{measure.decimals}f}"
    return text[1:] if math.isfinite(value) and float(text) == 0.0 else text
