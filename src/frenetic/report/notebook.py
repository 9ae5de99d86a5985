"""Tests, campaigns and comparisons as HTML for notebooks: a picture with facts."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Sequence
from functools import singledispatch
from typing import Final

import matplotlib as mpl

from frenetic._support.words import capitalised, counted, format_duration, oob_words
from frenetic.analysis.clusters import distinct_failures, nearest_misses
from frenetic.analysis.comparison import Comparison
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
from frenetic.export.table_rows import open_store
from frenetic.report.judged_drive import judge_drive
from frenetic.report.picture import Fact, facts_of_drive, facts_of_road
from frenetic.report.plots import draw_curves
from frenetic.report.sheet import SheetItem, draw_sheet, sheet_row
from frenetic.report.style import STYLE, Paper, encode_figure

FAILURES: Final = 6
"""Largest number of failures of a campaign that are drawn; our choice."""
COMPARED: Final = 500
"""Largest number of a campaign's failures that are compared, the most severe first; our choice."""

_DPI: Final = 144.0  # [dots/inch] for screens with many pixels; our choice
_PNG_COLOURS: Final = 64  # few, since a notebook stores all its pictures; our choice
_PIXELS_PER_INCH: Final = 96.0  # of CSS
_SHEET_COLUMNS: Final = 3  # most drives beside each other; our choice


@singledispatch
def html_of(thing: object) -> str:
    """Return a test, a campaign or a comparison as HTML for a notebook."""
    raise TypeError(f"{type(thing).__name__} has no picture")


@html_of.register
def _test(test: Test) -> str:
    """Return a picture of a test with its facts; only the facts if its road is unknown."""
    origin, moobd = test.candidate.origin, test.moobd
    parents = f" of {', '.join(map(str, origin.parents))}" if origin.parents else ""
    origin_fact = ("Origin", f"{origin.operator}{parents}", f"generation {origin.generation}")
    facts = [origin_fact]
    title, picture = f"Test {test.id}: {test.outcome}", ""
    try:
        road, drive = test.road, test.drive
    except CampaignError:  # the campaign does not record its terms
        pass
    else:
        if drive is not None:
            facts = [*facts_of_drive(road, judge_drive(road, test)), origin_fact]
        else:
            facts = [*facts_of_road(road), origin_fact]
            if moobd is not None:
                words = oob_words(moobd, road.lane_width)
                facts.insert(0, ("MOOBD", words, "read without drive"))
        picture = _sheet([("", road, test)], width=4.6, text=title)
    return _card(title, test.reason, picture, facts)


@html_of.register
def _campaign(campaign: Campaign | CampaignStore) -> str:
    """Return pictures of a campaign's failures with its counts."""
    if not campaign.folder.exists():
        return f"<p>{html.escape(repr(campaign))}</p>"
    with open_store(campaign) as store:
        title, items = _failures_to_show(store)
        width = 2.0 * min(len(items), _SHEET_COLUMNS)
        picture = _sheet(items, width=width, text=title) if items else ""
        counts, time = store.counts(), format_duration(store.elapsed())
        moobd = oob_words(counts.min_moobd, store.lane_width)
    facts = [
        ("simulations", str(counts.simulations), ""),
        ("failures", str(counts.failures), ""),
        ("lowest MOOBD", moobd, ""),
        ("wall time", time, ""),
    ]
    return _card(title, "", picture, facts)


def _failures_to_show(store: CampaignStore) -> tuple[str, list[SheetItem]]:
    """Return a title and the most severe distinct failures, or the nearest misses, to draw."""
    counts = store.counts()
    clusters = distinct_failures(store, COMPARED)
    failures = counted(counts.failures, "failure")
    if clusters.failures < counts.failures:
        failures = f"the {clusters.failures} most severe of {failures}"
    title = f"{counted(len(clusters), 'distinct failure')} among {failures}"
    if not counts.failed:
        clusters = nearest_misses(store, FAILURES)
        title = capitalised(counts.broken_text) or "No failure"
        title += "; the nearest misses" if clusters else ""
    items: list[SheetItem] = []
    for cluster in clusters.clusters[:FAILURES]:
        test = store.test(cluster.most_severe)
        if test.drive is not None:
            more = f", {len(cluster) - 1} more like it" if len(cluster) > 1 else ""
            items.append((f"Test {test.id}{more}", test.road, test))
    return title, items


@html_of.register
def _comparison(comparison: Comparison) -> str:
    """Return the curves of a comparison with a table of its groups and what can be said."""
    with mpl.rc_context(STYLE):
        page = Paper.new(6.5, 3.2, _DPI)
        axes = page.axes(0.6, 0.1, 5.8, 2.6, bare=False)
        draw_curves(axes, comparison)
        picture = _image(page, "Distinct failures found over simulations")
    measures, groups, headline = comparison.main_measures, comparison.groups, comparison.headline
    rows = [
        (group, str(len(groups[group])), *(by.text(group) for by in measures))
        for group in headline.order
    ]
    titles = ("group", "campaigns", *(by.measure.heading for by in measures))
    sentences = map(headline.pair_text, headline.pairs)
    conclusions = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in sentences)
    notes = "".join(f"<p>Note: {html.escape(note)}</p>" for note in comparison.notes)
    body = "".join(_row(cells, "td") for cells in rows)
    table = f"<table><thead>{_row(titles, 'th')}</thead><tbody>{body}</tbody></table>"
    return f"{picture}{table}<ul>{conclusions}</ul>{notes}"


def _sheet(items: Sequence[SheetItem], *, width: float, text: str) -> str:
    """Return drives from above as an image.

    Args:
        items: caption, road and test of each drive.
        width: width of the image, in inches.
        text: text for readers who do not see the image.
    """
    columns = min(len(items), _SHEET_COLUMNS)
    with mpl.rc_context(STYLE):
        rows = math.ceil(len(items) / columns)
        page = Paper.new(width, sheet_row(width, columns) * rows, _DPI)
        draw_sheet(page, items, columns, left=0.0, top=0.0, width=width)
        return _image(page, text)


def _image(page: Paper, text: str) -> str:
    """Return a figure as an image of its size on paper; ``text`` is read where it is not seen."""
    width = round(_PIXELS_PER_INCH * page.width)
    data = base64.b64encode(encode_figure(page.figure, "png", colours=_PNG_COLOURS)).decode()
    return (
        f'<img alt="{html.escape(text)}" width="{width}" style="border-radius: 6px"'
        f' src="data:image/png;base64,{data}">'
    )


def _card(title: str, text: str, picture: str, facts: Iterable[Fact]) -> str:
    """Return title, text, picture and facts below each other."""
    cells = "".join(
        f'<td style="text-align: left; vertical-align: top; padding: 0.2em 1.2em 0.2em 0">'
        f"<small>{html.escape(f'{name}, {detail}' if detail else name)}</small><br>"
        f"<b>{html.escape(value)}</b></td>"
        for name, value, detail in facts
    )
    subtitle = f"<br>{html.escape(text)}" if text else ""
    return f"<p><b>{html.escape(title)}</b>{subtitle}</p>{picture}<table><tr>{cells}</tr></table>"


def _row(cells: Iterable[str], tag: str) -> str:
    """Return a row of a table whose cells have the tag ``tag``."""
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"
