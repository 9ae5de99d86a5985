"""The page of a comparison of two versions in a browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from html_browser import low_contrast
from made_up_quality import drives
from playwright.sync_api import Page, expect

from frenetic.analysis import QualityComparison
from frenetic.report.html.quality import CHARTED, write_quality_page
from frenetic.rerun.back_to_back import BackToBack
from frenetic.rerun.paired_roads import PairedRoads
from frenetic.rerun.versions_by_class import VersionsByClass

pytest_plugins = ["browsing"]
pytestmark = pytest.mark.heavy

QUALITY = QualityComparison.of([drives(), drives("noise 0.1 m", rms_offset=0.2, crossing=100.0)])
NO_ROADS = PairedRoads(Path("roads"), ())


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_has_its_tables_and_charts(
    show: Callable[..., Page], tmp_path: Path, theme: str
) -> None:
    parts = {"class": "a:Old"}, {"class": "a:<b>New</b>"}, {"class": "s:S"}
    result = BackToBack(*parts, 0, NO_ROADS, NO_ROADS, quality=QUALITY)
    page = show(write_quality_page(result, tmp_path / "page.html"))
    page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
    expect(page.locator("h1")).to_contain_text("<b>New</b> compared")
    expect(page.locator(".lead").first).to_contain_text("crosses the edge of its lane on 100 %")
    expect(page.locator("#differences tbody tr")).to_have_count(15)
    assert page.locator("#over-radius canvas").count() == len(CHARTED)
    expect(page.locator(".tile-fail").first).to_contain_text("roads with the lane's edge crossed")
    assert low_contrast(page) == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_page_of_several_classes_has_a_part_for_each(
    show: Callable[..., Page], tmp_path: Path, theme: str
) -> None:
    parts = {"class": "a:Old"}, {"class": "a:New"}, {"class": "s:S"}
    alike = QualityComparison.of([drives()])
    results = {
        name: BackToBack(*parts, 0, NO_ROADS, NO_ROADS, quality=quality)
        for name, quality in {"<b>town</b>": QUALITY, "country": alike}.items()
    }
    page = show(write_quality_page(VersionsByClass.of(results), tmp_path / "page.html"))
    page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
    expect(page.locator("#class-1 h2")).to_have_text("<b>town</b>")
    expect(page.locator("#class-1 tbody tr")).to_have_count(15)
    expect(page.locator("#class-1 canvas")).to_have_count(1)
    expect(page.locator("#class-2 canvas")).to_have_count(0)
    expect(page.locator("#class-2 .lead")).to_contain_text("No difference shown: alike within")
    assert low_contrast(page) == []
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_function("document.documentElement.scrollWidth <= 390")  # once charts are redrawn
