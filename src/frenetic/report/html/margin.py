"""Section of a page: how far a driver is from failing, a bar for each quantity."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from frenetic._support.words import capitalised, counted
from frenetic.analysis.statistics import ValueWithInterval
from frenetic.parts.records import differences
from frenetic.report.html.configuration import shell_path
from frenetic.report.html.page import Block, DataBlock, Paragraph, Section, Table, proper
from frenetic.rerun.margin_results import ConditionMargin, Margins
from frenetic.spec.part_text import part_text

_TICKS: Final = ((0.0, "usual"), (25.0, "25\u00a0%"), (50.0, "50\u00a0%"), (75.0, "75\u00a0%"))
"""Place on the axis in percent -> text; the end of the axis is the end of each range."""


def margin_section(studies: Sequence[Margins], config: Mapping[str, Any], folder: Path) -> Section:
    """Return the section with the margins of a driver, with a figure and a table for each study.

    Args:
        studies: one or more studies, the latest first.
        config: configuration of the campaign of the page.
        folder: folder of the campaign of the page.
    """
    blocks = tuple(
        block
        for margins in studies
        for block in _blocks(margins, config, has_drives=margins.folder == folder)
    )
    lead = "The amounts from which on the driver fails. One amount changes at a time."
    return Section("margin", "Margin", blocks, lead)


def _blocks(margins: Margins, config: Mapping[str, Any], *, has_drives: bool) -> Iterator[Block]:
    """Yield the blocks of a study: a sentence, the figure, the table and the drives.

    Args:
        margins: the study.
        config: configuration of the campaign of the page.
        has_drives: whether the page shows the drives of the study, to which rows then link.
    """
    yield Paragraph(proper(f"{margins.headline}{_parts_text(margins, config)}."))
    data = {
        "rows": [_row(margin) for margin in margins.margins],
        "ticks": [*_TICKS, (100.0, "end")],
        "caption": _caption(margins),
    }
    yield DataBlock("margins", data)
    rows = tuple(tuple(proper(text or "–") for text in row) for row in margins.rows)
    links: tuple[str | None, ...] = ()
    if has_drives:
        examples = [margin.example for margin in margins.margins]
        links = tuple(None if each is None else f"#test-{each.drive}" for each in examples)
    yield Table(margins.columns, rows, _drives_text(margins), links)
    for note in margins.notes:
        yield Paragraph(proper(f"{capitalised(note)}."))


def _parts_text(margins: Margins, config: Mapping[str, Any]) -> str:
    """Return which parts drove, if they are not the campaign's; empty if they are."""
    texts = [
        f" {word} {part_text(record, config.get(kind))}"
        for kind, record, word in (
            ("driver", margins.driver, "with"),
            ("simulator", margins.simulator, "in"),
        )
        if differences(kind, record, config.get(kind))
    ]
    return f", driven{''.join(texts)}" if texts else ""


def _row(margin: ConditionMargin) -> dict[str, Any]:
    """Return the bar of a margin, with its marks, for the template; places are in percent."""
    quantity, shares, least = margin.quantity, margin.shares, margin.least
    usual, end = (quantity.text(amount) for amount in (quantity.usual, quantity.end))
    is_marked = least is not None and math.isfinite(least.share)
    return {
        "name": capitalised(quantity.words),
        "range": proper(f"{usual} to {end}"),
        "amount": proper("never" if margin.amount is None else margin.amount_text()),
        "bar": 100.0 * min(shares.value, 1.0),
        "is_beyond": math.isinf(shares.value),
        "interval": _interval(shares),
        "demanding": 100.0 * least.share if is_marked and least is not None else None,
        "title": proper(margin.as_text()),
    }


def _interval(shares: ValueWithInterval) -> tuple[float, float, bool] | None:
    """Return both ends of an interval in percent, and whether it goes on beyond the range.

    Without an end within the range there is none.
    """
    if math.isinf(shares.low):
        return None
    return 100.0 * shares.low, 100.0 * min(shares.high, 1.0), math.isinf(shares.high)


def _caption(margins: Margins) -> str:
    """Return what bars, lines and diamonds mean."""
    text = (
        "Bar: from the usual amount to the amount at which the driver begins to fail, as a share of"
        " the measured range; pale: it does not fail within the range. Line: 95 % interval."
    )
    if margins.demanding:
        text += f" Diamond: first failure on {_demanding_text(margins)}."
    return text


def _demanding_text(margins: Margins) -> str:
    """Return which roads of the campaign are demanding."""
    roads = counted(margins.demanding, "road")
    return f"the {roads} that the campaign passed with the lowest MOOBD"


def _drives_text(margins: Margins) -> str:
    """Return which roads were driven, how often, and where the drives are."""
    roads = f"{counted(margins.roads, 'random road')} of {margins.domain}, seed {margins.seed}"
    if margins.demanding:
        roads += f", and {_demanding_text(margins)}, which a search chose and which do not count"
    return (
        "Drive: on the road that begins to fail nearest to this amount; 'frenetic show"
        f" {shell_path(margins.folder)} DRIVE' shows it. Roads: {roads}."
        f" {counted(margins.drives, 'drive')} in all."
    )
