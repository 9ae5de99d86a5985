"""Tests, campaigns and comparisons as notebooks show them: a picture and the figures."""

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
from frenetic.export.tables import open_store
from frenetic.report.judged_drive import judge_drive
from frenetic.report.picture import Fact, facts_of_drive, facts_of_road
from frenetic.report.plots import draw_curves
from frenetic.report.sheet import draw_sheet, sheet_row
from frenetic.report.style import STYLE, Paper, encode_figure
from frenetic.road import Road

FAILURES: Final = 6
"""Most failures of a campaign that are drawn."""
COMPARED: Final = 500
"""Most failures of a campaign that are compared, the most severe first: this is fast."""

_DPI: Final = 144.0  # for screens with many pixels
_PNG_COLOURS: Final = 64  # a notebook keeps all its pictures


@singledispatch
def html_of(thing: object) -> str:
    """Return a thing as HTML for a notebook."""
    raise TypeError(f"{type(thing).__name__} has no picture")


@html_of.register
def _test(test: Test) -> str:
    origin, moobd = test.candidate.origin, test.moobd
    parents = f" of {', '.join(map(str, origin.parents))}" if origin.parents else ""
    facts = [("Origin", f"{origin.operator}{parents}", f"generation {origin.generation}")]
    title, picture = f"Test {test.id}: {test.outcome}", ""
    try:
        road, drive = test.road, test.drive
    except CampaignError:  # the campaign does not record its terms
        pass
    else:
        if drive is not None:
            facts = [*facts_of_drive(road, judge_drive(road, test)), *facts]
        else:
            words = oob_words(moobd, road.lane_width)
            read = [] if moobd is None else [("MOOBD", words, "read without drive")]
            facts = [*read, *facts_of_road(road), *facts]
        picture = _sheet([("", road, test)], 4.6, title)
    return _card(title, test.reason, picture, facts)


@html_of.register
def _campaign(campaign: Campaign | CampaignStore) -> str:
    if not campaign.folder.exists():
        return f"<p>{html.escape(repr(campaign))}</p>"
    with open_store(campaign) as store:
        title, items = _failures_to_show(store)
        picture = _sheet(items, 2.0 * min(len(items), 3), title) if items else ""
        counts, time = store.counts(), format_duration(store.elapsed())
        moobd = oob_words(counts.min_moobd, store.lane_width)
    facts = [
        ("simulations", str(counts.simulations), ""),
        ("failures", str(counts.failures), ""),
        ("lowest MOOBD", moobd, ""),
        ("wall time", time, ""),
    ]
    return _card(title, "", picture, facts)


def _failures_to_show(store: CampaignStore) -> tuple[str, list[tuple[str, Road, Test]]]:
    """Return a title and the most severe distinct failures with captions, else the near misses."""
    counts = store.counts()
    clusters = distinct_failures(store, COMPARED)
    among = counted(counts.failures, "failure")
    if clusters.failures < counts.failures:
        among = f"the {clusters.failures} most severe of {among}"
    title = f"{counted(len(clusters), 'distinct failure')} among {among}"
    if not counts.failed:
        clusters = nearest_misses(store, FAILURES)
        title = capitalised(counts.broken) or "No failure"
        title += "; the nearest misses" if clusters else ""
    items = []
    for cluster in clusters.clusters[:FAILURES]:
        test = store.test(cluster.most_severe)
        if test.drive is not None:
            more = f", {len(cluster) - 1} more like it" if len(cluster) > 1 else ""
            items.append((f"Test {test.id}{more}", test.road, test))
    return title, items


@html_of.register
def _comparison(comparison: Comparison) -> str:
    with mpl.rc_context(STYLE):
        page = Paper.new(6.5, 3.2, _DPI)
        axes = page.axes(0.6, 0.1, 5.8, 2.6, bare=False)
        draw_curves(axes, comparison)
        picture = _image(page, "Distinct failures found over simulations")
    shown, groups = comparison.measures, comparison.groups
    rows = [
        (group, str(len(groups[group])), *(by.text(group) for by in shown))
        for group in comparison.headline.order
    ]
    titles = ("group", "campaigns", *(by.measure.heading for by in shown))
    by = comparison.headline
    said = "".join(f"<li>{html.escape(by.pair_text(pair))}</li>" for pair in by.pairs)
    notes = "".join(f"<p>Note: {html.escape(note)}</p>" for note in comparison.notes)
    head, *body = (_row(cells, tag) for cells, tag in [(titles, "th"), *((r, "td") for r in rows)])
    table = f"<table><thead>{head}</thead><tbody>{''.join(body)}</tbody></table>"
    return f"{picture}{table}<ul>{said}</ul>{notes}"


def _sheet(items: Sequence[tuple[str, Road, Test]], width: float, text: str) -> str:
    """Return drives from above as an image, as in the report's contact sheet."""
    columns = min(len(items), 3)
    with mpl.rc_context(STYLE):
        rows = math.ceil(len(items) / columns)
        page = Paper.new(width, sheet_row(width, columns) * rows, _DPI)
        draw_sheet(page, items, columns, left=0.0, top=0.0, width=width)
        return _image(page, text)


def _image(page: Paper, text: str) -> str:
    """Return a figure as an image of its size on paper."""
    width = round(96.0 * page.width)
    data = base64.b64encode(encode_figure(page.figure, "png", colours=_PNG_COLOURS)).decode()
    return (
        f'<img alt="{html.escape(text)}" width="{width}" style="border-radius: 6px"'
        f' src="data:image/png;base64,{data}">'
    )


def _card(title: str, text: str, picture: str, facts: Iterable[Fact]) -> str:
    cells = "".join(
        f'<td style="text-align: left; vertical-align: top; padding: 0.2em 1.2em 0.2em 0">'
        f"<small>{html.escape(f'{name}, {detail}' if detail else name)}</small><br>"
        f"<b>{html.escape(value)}</b></td>"
        for name, value, detail in facts
    )
    said = f"<br>{html.escape(text)}" if text else ""
    return f"<p><b>{html.escape(title)}</b>{said}</p>{picture}<table><tr>{cells}</tr></table>"


def _row(cells: Iterable[str], tag: str) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"
