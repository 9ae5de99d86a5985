"""The section of a report with a driver's margins in a browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from html_browser import contrast
from made_up_margins import margins
from playwright.sync_api import Page, expect

from frenetic.report.html import Report, Section, write_page
from frenetic.report.html.margin import margin_section

pytest_plugins = ["browsing"]
pytestmark = pytest.mark.heavy
Show = Callable[..., Page]


@pytest.fixture
def margins_page(show: Show, tmp_path: Path) -> Page:
    """A page with margins only."""
    sections = (Section("summary", "Margins", ()), margin_section([margins()], {}, Path("c")))
    return show(write_page(Report("Margins", sections), tmp_path / "page.html"))


def test_bars_are_as_long_as_their_shares_of_the_range(margins_page: Page) -> None:
    tracks = margins_page.locator(".margin svg.track")
    expect(tracks).to_have_count(3)
    widths = [
        track.locator("rect").bounding_box()["width"] / track.bounding_box()["width"]  # type: ignore[index]
        for track in tracks.all()[:2]
    ]
    assert widths == pytest.approx([0.3, 1.0], abs=0.01)
    track, diamond = tracks.first.bounding_box(), margins_page.locator(".demanding").first
    middle = diamond.bounding_box()
    assert track is not None
    assert middle is not None
    x = middle["x"] + 0.5 * middle["width"]
    assert x == pytest.approx(track["x"] + 0.2 * track["width"], abs=1.0)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_line_of_an_interval_is_seen_on_its_bar(margins_page: Page, theme: str) -> None:
    margins_page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
    line, bar = (
        margins_page.evaluate(
            "([selector, property]) => {"
            " const style = getComputedStyle(document.querySelector(selector));"
            " const canvas = document.createElement('canvas').getContext('2d');"
            " canvas.fillStyle = style[property]; canvas.fillRect(0, 0, 1, 1);"
            " return `rgb(${[...canvas.getImageData(0, 0, 1, 1).data].slice(0, 3).join()})`; }",
            [selector, name],
        )
        for selector, name in ((".margin .interval", "stroke"), (".margin .bar", "fill"))
    )
    assert contrast(line, bar) > 3.0


def test_nothing_is_wider_than_a_phone(margins_page: Page) -> None:
    margins_page.set_viewport_size({"width": 390, "height": 844})
    assert margins_page.evaluate("document.documentElement.scrollWidth") <= 390
    for track in margins_page.locator(".margin svg.track").all():
        box = track.bounding_box()
        assert box is not None
        assert box["width"] > 250
