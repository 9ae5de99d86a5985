"""Objects as notebooks show them: a picture and the figures, by `html_of`."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Sequence
from functools import singledispatch
from typing import Final

import matplotlib as mpl
import numpy as np

from frenetic._support.words import signed
from frenetic.analysis.comparison import Comparison
from frenetic.analysis.failures import Clusters
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.drive import Drive
from frenetic.errors import CampaignError
from frenetic.report.comparison import draw_curves
from frenetic.report.html.headline import headline
from frenetic.report.orientation import turn_of
from frenetic.report.picture import (
    Fact,
    draw_sheet,
    facts_of_drive,
    facts_of_road,
    sheet_row,
)
from frenetic.report.plots import failures_to_show, opened
from frenetic.report.scene import (
    SeenDrive,
    View,
    box_of,
    draw_scene,
    focus_of,
    look,
)
from frenetic.report.style import STYLE, Paper, encode_figure
from frenetic.road import Road

FAILURES: Final = 6
"""Most failures of a campaign that are drawn."""
COMPARED: Final = 500
"""Most failures of a campaign that are told apart, the most severe first: it takes no time."""

_DPI: Final = 144.0  # for screens with many pixels
_PNG_COLOURS: Final = 64  # a notebook keeps all its pictures
_WIDTH, _HEIGHT = 4.6, 2.6  # inches of a road from above


@singledispatch
def html_of(thing: object) -> str:
    """A thing as HTML for a notebook."""
    raise TypeError(f"{type(thing).__name__} has no picture")


@html_of.register
def _road(road: Road) -> str:
    return _card("Road", "", _from_above(road, None), facts_of_road(road))


@html_of.register
def _drive(drive: Drive) -> str:
    if drive.road is None:
        return f"<p>{html.escape(repr(drive))}</p>"
    seen = look(drive.road, drive)
    picture, result = _from_above(drive.road, seen), seen.result
    return _card(
        f"Drive: {result.outcome}", result.reason, picture, facts_of_drive(drive.road, seen)
    )


@html_of.register
def _test(test: Test) -> str:
    origin = test.candidate.origin
    parents = f" of {', '.join(map(str, origin.parents))}" if origin.parents else ""
    made = ("Origin", f"{origin.operator}{parents}", f"generation {origin.generation}")
    title = f"Test {test.id}: {test.outcome}"
    try:
        road, drive = test.road, test.drive
    except CampaignError:  # it does not say on which terms it drove
        return _card(title, test.reason, "", [made])
    if drive is None:
        facts = facts_of_road(road)
        if test.moobd is not None:
            facts.insert(0, ("MOOBD", f"{signed(test.moobd, 2)} m", "read without its drive"))
        return _card(title, test.reason, _from_above(road, None), [*facts, made])
    seen = look(road, drive)
    return _card(title, test.reason, _from_above(road, seen), [*facts_of_drive(road, seen), made])


@html_of.register
def _campaign(campaign: Campaign) -> str:
    if not campaign.folder.exists():
        return f"<p>{html.escape(repr(campaign))}</p>"
    with opened(campaign) as store:
        return _store(store)


@html_of.register
def _store(store: CampaignStore) -> str:
    title, items = failures_to_show(store, FAILURES, COMPARED)
    picture = ""
    if items:
        width, columns = 2.0 * min(len(items), 3), min(len(items), 3)
        with mpl.rc_context(STYLE):
            rows = math.ceil(len(items) / columns)
            page = Paper.new(width, sheet_row(width, columns) * rows, _DPI)
            draw_sheet(page, items, columns, left=0.0, top=0.0, width=width)
            picture = _image(page, title)
    counts = store.counts()
    top = headline(
        store.config,
        store.facts,
        counts,
        Clusters((), 0.0),
        folder=str(store.folder),
        elapsed=store.elapsed(),
    )
    facts = [
        (tile.label, tile.value, tile.note)
        for tile in top.tiles
        if tile.label != "distinct failures"
    ]
    return _card(title, top.lead, picture, facts)


@html_of.register
def _comparison(comparison: Comparison) -> str:
    with mpl.rc_context(STYLE):
        page = Paper.new(6.5, 3.2, _DPI)
        axes = page.axes(0.6, 0.1, 5.8, 2.6, bare=False)
        draw_curves(axes, comparison)
        axes.legend(loc="upper left", frameon=False, fontsize=8.5)
        picture = _image(page, "Failures found over simulations")
    shown = comparison.measures
    rows = [
        (
            html.escape(group),
            str(len(comparison.groups[group])),
            *(html.escape(by.text(group)) for by in shown),
        )
        for group in comparison.headline.order
    ]
    titles = ("group", "campaigns", *(html.escape(by.measure.heading) for by in shown))
    by = comparison.headline
    said = "".join(f"<li>{html.escape(by.said(pair))}</li>" for pair in by.pairs)
    notes = "".join(f"<p>Note: {html.escape(note)}</p>" for note in comparison.notes)
    return f"{picture}{_table(titles, rows)}<ul>{said}</ul>{notes}"


# Pictures


def _from_above(road: Road, seen: SeenDrive | None) -> str:
    """A road, and a drive along it, as in the report's contact sheet."""
    with mpl.rc_context(STYLE):
        turn = turn_of(road)
        box = box_of(road, seen, turn)
        height = float(np.clip(_WIDTH * box.height / box.width, 1.2, _HEIGHT))
        page = Paper.new(_WIDTH, height, _DPI)
        focus = None if seen is None else focus_of(seen)
        view = View.showing(page.axes(0.0, 0.0, _WIDTH, height), box, turn)
        draw_scene(view, road, seen, focus, None, labelled=False)
        return _image(page, "The road from above")


def _image(page: Paper, text: str) -> str:
    """A figure as an image of its size on paper."""
    width = round(96.0 * page.width)
    data = base64.b64encode(encode_figure(page.figure, "png", colours=_PNG_COLOURS)).decode()
    return (
        f'<img alt="{html.escape(text)}" width="{width}" style="border-radius: 6px"'
        f' src="data:image/png;base64,{data}">'
    )


# Elements


def _card(title: str, text: str, picture: str, facts: Iterable[Fact]) -> str:
    cells = "".join(
        f'<td style="text-align: left; vertical-align: top; padding: 0.2em 1.2em 0.2em 0">'
        f"<small>{html.escape(f'{name}, {detail}' if detail else name)}</small><br>"
        f"<b>{html.escape(value)}</b></td>"
        for name, value, detail in facts
    )
    said = f"<br>{html.escape(text)}" if text else ""
    return f"<p><b>{html.escape(title)}</b>{said}</p>{picture}<table><tr>{cells}</tr></table>"


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{title}</th>" for title in titles)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
