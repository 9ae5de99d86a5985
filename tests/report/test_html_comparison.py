"""The page of a comparison: what it says, and how a browser shows it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from html_browser import background, low_contrast
from html_campaigns import HOSTILE
from playwright.sync_api import Page, expect

from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.analysis.metrics import CampaignMeasures
from frenetic.campaign.counts import Counts
from frenetic.errors import FreneticError
from frenetic.report.html.comparison import POINTS, comparison_report, write_comparison_page

pytest_plugins = ["browsing"]


def campaign(folder: Path, distinct: int, simulations: int = 60) -> CampaignMeasures:
    """With its failures one after the other; every second is a distinct one."""
    curve = np.clip(np.arange(simulations + 1) - 3, 0, 2 * distinct)
    return CampaignMeasures(
        folder=folder,
        seed=distinct,
        counts=Counts(invalid=distinct, min_moobd=-0.1 * distinct),
        failures_after=curve,
        distinct_after=(curve + 1) // 2,
        is_finished=True,
        cells=7,
        unlike_roads=distinct // 2,
        competition_sparseness=25.0 + distinct if distinct > 1 else -math.inf,
    )


def made(folder: Path, **groups: list[int]) -> Comparison:
    measured = {
        name: tuple(campaign(folder / f"{name}-{i}", n) for i, n in enumerate(numbers))
        for name, numbers in groups.items()
    }
    return compare_measured(measured, shared={"driver": "Planner"})


LOW, HIGH = [1, 2, 3, 4, 5], [11, 12, 13, 14, 15]


@pytest.fixture
def three(tmp_path: Path) -> Comparison:
    for name in ("high-0", "low-1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.html").write_text("<!doctype html><title>x</title>")
    return made(tmp_path, low=LOW, high=HIGH, never=[0] * 5)


def blocks_of(comparison: Comparison, folder: Path) -> dict[str, list[Any]]:
    report = comparison_report(comparison, folder)
    return {section.id: list(section.blocks) for section in report.sections}


# What it says


def test_groups_stand_in_the_order_of_the_headline_in_colours_of_their_own(
    three: Comparison, tmp_path: Path
) -> None:
    groups = [group for group, _ in blocks_of(three, tmp_path)["results"][0].data["rows"]]
    assert [group["name"] for group in groups] == ["high", "low", "never"]
    assert [group["role"] for group in groups] == ["group-1", "group-0", "group-2"]


def test_table_has_medians_and_quartiles_and_what_does_not_vary_once(
    three: Comparison, tmp_path: Path
) -> None:
    medians = blocks_of(three, tmp_path)["results"][0].data
    titles = [measure.short for measure in medians["columns"]]
    first, _, never = (dict(zip(titles, cells, strict=True)) for _, cells in medians["rows"])
    assert first["distinct"] == ("13", "12 to 14")
    assert never["sparseness"] == ("none", "")
    assert medians["caption"].endswith("The same in all campaigns: cells of the feature map 7.")


def test_curves_are_thinned_and_have_bands_where_there_are_enough(tmp_path: Path) -> None:
    long = tuple(campaign(tmp_path / str(i), 9 + i, simulations=3000) for i in range(5))
    few = (campaign(tmp_path / "x", 4), campaign(tmp_path / "y", 6))
    comparison = compare_measured({"long": long, "few": few})
    chart, *_ = blocks_of(comparison, tmp_path)["curves"]
    distinct = {curve.name: curve for curve in chart.series}
    curve = distinct["long"]
    assert len(curve.x) == len(curve.y) == len(curve.low) == POINTS
    assert (curve.x[0], curve.x[-1]) == (0, 3000)
    assert (curve.low[-1], curve.y[-1], curve.high[-1]) == (10.0, 11.0, 12.0)
    assert curve.singles == ()
    assert (distinct["few"].low, len(distinct["few"].singles)) == ((), 2)


def test_pairs_say_what_is_shown_and_claim_nothing_of_few(
    three: Comparison, tmp_path: Path
) -> None:
    (table,) = blocks_of(three, tmp_path)["pairs"]
    assert table.rows[:2] == (
        ("distinct failures", "high has more than low", "1.00", "large", "0.024"),
        ("", "low has more than never", "1.00", "large", "0.024"),
    )
    blocks = blocks_of(made(tmp_path, a=[1, 2], b=[8, 9]), tmp_path)
    (row, *_) = blocks["pairs"][0].rows
    said = "a and b: too few repeats to tell"
    assert row == ("distinct failures", said, "0.00", "–", "–")
    assert [row["box"] for row in blocks["spreads"][0].data["panels"][0]["spreads"]] == [None] * 2


def test_only_reports_that_are_there_are_linked(three: Comparison, tmp_path: Path) -> None:
    (table,) = blocks_of(three, tmp_path / "pages")["campaigns"]
    links = dict(zip((row[0] for row in table.rows), table.links, strict=True))
    assert links["../high-0"] == "../high-0/report.html"
    assert links["../high-1"] is None
    assert sum(link is not None for link in links.values()) == 2
    folder = tmp_path / "javascript:alert(1)#?"
    folder.mkdir()
    (folder / "report.html").write_text("x")
    comparison = compare_measured({"a": (campaign(folder, 1),), "b": (campaign(tmp_path, 2),)})
    (table,) = blocks_of(comparison, tmp_path)["campaigns"]
    assert table.links == ("javascript%3Aalert%281%29%23%3F/report.html", None)


def test_the_page_is_the_same_each_time_and_replaces_what_is_there(
    three: Comparison, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    written = []
    for _ in range(2):
        assert write_comparison_page(three, path, title="Bench", command="frenetic bench") == path
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert "<title>Bench</title>" in written[0].decode()
    with pytest.raises(FreneticError, match="cannot be written"):
        write_comparison_page(three, tmp_path / "nowhere" / "page.html")


# How a browser shows it


@pytest.fixture
def page(show: Callable[..., Page], three: Comparison, tmp_path: Path) -> Page:
    return show(write_comparison_page(three, tmp_path / "page.html", facts={"seeds": "5"}))


def test_points_and_boxes(page: Page) -> None:
    expect(page.locator("h1")).to_have_text("low, high and never compared")
    assert page.locator("#curves canvas").count() == 2
    expect(page.locator("#campaigns a").first).to_have_attribute("href", "low-1/report.html")
    expect(page.locator("#configuration")).to_contain_text("seeds")
    panel = page.locator(".spread-panel").first
    expect(panel.locator("h3")).to_have_text("distinct failures")
    expect(panel.locator(".dot")).to_have_count(15)
    expect(panel.locator(".box")).to_have_count(3)
    places = panel.locator(".spread").first.locator(".dot")
    lefts = places.evaluate_all("els => els.map(el => parseFloat(el.getAttribute('cx')))")
    assert lefts == sorted(lefts)
    assert lefts[-1] == 100.0
    # What never happened has an end of its own.
    ends = {"simulations to first failure": "100.0%", "competition's sparseness": "0.0%"}
    for measure, place in ends.items():
        panel = page.locator(".spread-panel", has_text=measure)
        expect(panel.locator(".ticks text", has_text="none")).to_have_attribute("x", place)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_all_text_can_be_read(
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
    path = write_comparison_page(made(tmp_path, **groups), tmp_path / "page.html")
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
    comparison = compare_measured(measured, notes=[HOSTILE], shared={HOSTILE: HOSTILE})
    path = write_comparison_page(
        comparison,
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
    comparison = made(tmp_path, one=values, other=values)
    page = show(write_comparison_page(comparison, tmp_path / "page.html"))
    assert (page.locator(".box").count() == 0) is (len(values) == 1)
    panels = page.locator(".spread-panel")
    failures = panels.filter(has=page.get_by_role("heading", name="failures", exact=True))
    assert failures.locator(".ticks text").all_text_contents()[0] == "0"
    for panel in panels.all():
        ticks = panel.locator(".ticks text").all_text_contents()
        assert not any(text.startswith("\u2212") for text in ticks)
