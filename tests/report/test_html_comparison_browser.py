"""The page of a comparison in a browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from html_browser import background, low_contrast
from html_campaigns import HOSTILE
from playwright.sync_api import Page, expect
from sample_comparisons import HIGH, LOW, campaign, comparison, three_groups

from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.report.html.comparison import write_comparison_page

pytest_plugins = ["browsing"]
pytestmark = pytest.mark.heavy


@pytest.fixture
def three(tmp_path: Path) -> Comparison:
    """A comparison of the groups low, high and never."""
    return three_groups(tmp_path)


@pytest.fixture
def page(show: Callable[..., Page], three: Comparison, tmp_path: Path) -> Page:
    """The page of the comparison, opened."""
    return show(write_comparison_page(three, tmp_path / "page.html", facts={"seeds": "5"}))


def test_a_panel_has_a_point_per_campaign_and_a_box_per_group(page: Page) -> None:
    expect(page.locator("h1")).to_have_text("low, high and never compared")
    assert page.locator("#curves canvas").count() == 2
    tops = page.locator("#unlike canvas").evaluate_all(
        "els => els.map(el => el.getBoundingClientRect().top)"
    )
    assert len(tops) == 3
    assert len(set(tops)) == 1, "three charts in a row"
    expect(page.locator("#unlike")).to_contain_text("lateral acceleration / 3 m/s²")
    expect(page.locator("#results .lead")).to_contain_text("The search frenetic itself uses")
    expect(page.locator("#campaigns a").first).to_have_attribute("href", "low-1/report.html")
    expect(page.locator("#configuration")).to_contain_text("seeds")
    panel = page.locator(".spread-panel").first
    expect(panel.locator("h3")).to_have_text("distinct failures")
    expect(panel.locator(".dot")).to_have_count(21)
    expect(panel.locator(".box")).to_have_count(3)
    places = panel.locator(".spread").first.locator(".dot")
    lefts = places.evaluate_all("els => els.map(el => parseFloat(el.getAttribute('cx')))")
    assert lefts == sorted(lefts)
    assert lefts[-1] == 100.0
    # A value of "none" stands at the worse end of the axis.
    ends = {"simulations to first failure": "100.0%", "competition's sparseness": "0.0%"}
    for measure, place in ends.items():
        panel = page.locator(".spread-panel", has_text=measure)
        expect(panel.locator(".ticks text", has_text="none")).to_have_attribute("x", place)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_all_text_has_enough_contrast(
    show: Callable[..., Page], three: Comparison, tmp_path: Path, theme: str
) -> None:
    page = show(write_comparison_page(three, tmp_path / "page.html"), color_scheme=theme)
    assert (background(page) < 150) is (theme == "dark")
    page.locator(".legend button").first.click()
    page.locator("#curves .chart-drawing").first.focus()
    page.keyboard.press("ArrowRight")
    page.locator(".track").first.hover()
    assert low_contrast(page) == []


@pytest.mark.parametrize("width", [320, 768])
def test_small_screens_need_no_scrolling_sideways(
    show: Callable[..., Page], tmp_path: Path, width: int
) -> None:
    name = "a_generator_with_a_very_long_name_that_nobody_can_break_anywhere"
    groups = {name: LOW, **{f"Frenetic{i}": HIGH for i in range(9)}}
    path = write_comparison_page(comparison(tmp_path, **groups), tmp_path / "page.html")
    page = show(path, viewport={"width": width, "height": 844}, has_touch=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator(".swatch.again").count() > 0, "ten groups have eight colours"
    heights = page.locator(".block-groupTable tbody th .group > span").evaluate_all(
        "els => els.map(el => el.getBoundingClientRect().height)"
    )
    assert max(heights[:9]) < 30, heights
    quartiles = page.locator(".block-groupTable td .quiet").evaluate_all(
        "els => els.map(el => el.getBoundingClientRect().height)"
    )
    assert max(quartiles) < 25, "the quartiles stand on one line"


def test_no_text_from_outside_is_run(show: Callable[..., Page], tmp_path: Path) -> None:
    measured = {HOSTILE: (campaign(tmp_path, 3),), "b": (campaign(tmp_path, 4),)}
    groups = compare_measured(measured, notes=[HOSTILE], shared={HOSTILE: HOSTILE})
    path = write_comparison_page(
        groups,
        tmp_path / "page.html",
        title=HOSTILE,
        lead=HOSTILE,
        facts={HOSTILE: HOSTILE},
        command=HOSTILE,
    )
    page = show(path)
    expect(page.locator("h1")).to_have_text(HOSTILE)
    expect(page.locator("#results tbody th").last).to_have_text(HOSTILE)
    assert page.evaluate("window.hacked === undefined && typeof hacked === 'undefined'")
    assert page.locator("main img").count() == 0


@pytest.mark.parametrize("values", [[0], [0, 0, 0, 0, 0]])
def test_a_measure_that_is_equal_everywhere_has_an_axis_from_zero(
    show: Callable[..., Page], tmp_path: Path, values: list[int]
) -> None:
    groups = comparison(tmp_path, one=values, other=values)
    page = show(write_comparison_page(groups, tmp_path / "page.html"))
    assert (page.locator(".box").count() == 0) is (len(values) == 1)
    panels = page.locator(".spread-panel")
    failures = panels.filter(has=page.get_by_role("heading", name="failures", exact=True))
    assert failures.locator(".ticks text").all_text_contents()[0] == "0"
    for panel in panels.all():
        ticks = panel.locator(".ticks text").all_text_contents()
        assert not any(text.startswith("\u2212") for text in ticks)
