"""The HTML report as a browser shows it, see ``browsing``."""

from __future__ import annotations

import io
import json
import math
import re
import shlex
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from html_browser import background, low_contrast
from html_campaigns import HOSTILE, make_empty, make_hostile, make_searched
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect

from frenetic.again.rerun import rerun
from frenetic.analysis.failures import Clusters, distinct_failures
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.cli import cli
from frenetic.drivers import Planner
from frenetic.drivers.loading import load_driver
from frenetic.outcome import Outcome
from frenetic.report import animate
from frenetic.report.failures import road_document
from frenetic.report.html import (
    Bars,
    Chart,
    Column,
    Command,
    Fact,
    Facts,
    Paragraph,
    Section,
    Series,
    Table,
    write_report,
)
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator

pytest_plugins = ["browsing"]


@pytest.fixture(scope="session")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_searched(tmp_path_factory.mktemp("html") / "searched")
    write_report(folder)
    return folder


@pytest.fixture
def page(show: Callable[..., Page], searched: Path) -> Page:
    return show(searched / "report.html")


def clusters_of(folder: Path) -> Clusters:
    with CampaignStore.open(folder) as store:
        return distinct_failures(store)


def seconds(page: Page) -> float:
    return float(page.locator("#scrub").input_value())


def cursor(page: Page) -> float:
    """Where the cursor of the profiles is, as a share of their width."""
    area, line = page.locator("#profiles").bounding_box(), page.locator("#cursor").bounding_box()
    assert area is not None
    assert line is not None
    return (line["x"] - area["x"]) / area["width"]


def car(page: Page) -> tuple[float, float]:
    """Where the car is, in m on the turned map."""
    moved = page.locator("#car").get_attribute("transform") or ""
    x, y = re.findall(r"-?[\d.]+", moved)[:2]
    return float(x), float(y)


def test_page_has_all_parts(page: Page) -> None:
    expect(page.locator("h1")).to_contain_text("in 150 simulations")
    titles = page.locator("main h2").all_text_contents()
    assert titles == [
        "Failures over time",
        "Failures",
        "Feature map",
        "Operators",
        "All tests",
        "Configuration",
    ]
    expect(page.locator(".block-switch canvas")).to_have_count(1)
    expect(page.locator(".block-switch .legend button")).to_have_count(4)
    assert page.locator(".block-bars .bar-fill").count() > 5
    assert page.locator(".gallery .card svg .path").count() > 5


def test_time_can_be_counted_in_three_ways(page: Page) -> None:
    drawing = page.locator(".block-switch .chart-drawing")
    for name, title in (("tests", "tests, roads that"), ("wall time", "wall time (s)")):
        page.get_by_role("button", name=name, exact=True).click()
        label = re.compile(re.escape(f"found so far over {title}"))
        expect(drawing).to_have_attribute("aria-label", label)
    expect(drawing).to_have_count(1)


def test_cell_of_the_map_shows_its_roads(page: Page) -> None:
    cell = page.locator(".cell[class*=severity]").first
    number = cell.text_content()
    cell.click()
    expect(cell).to_have_attribute("aria-selected", "true")
    panel = page.locator(".map-panel")
    expect(panel.locator("h3")).to_have_text(re.compile(rf"^{number} failures? of \d+ tests?$"))
    panel.locator(".card").first.click()
    expect(page.get_by_role("dialog")).to_be_visible()


def test_map_changes_with_its_features(page: Page) -> None:
    counts = "els => els.map(el => Number(el.textContent)).reduce((a, b) => a + b, 0)"
    cells = page.locator(".cell")
    failures = cells.evaluate_all(counts)
    assert failures > 0
    before = cells.all_text_contents()
    page.select_option("#map-across", "std_steering")
    assert cells.all_text_contents() != before
    page.select_option("#map-scope", "whole")
    page.select_option("#map-shade", "count")
    assert cells.evaluate_all(counts) == failures
    assert page.locator(".cell[class*=count-]").count() > 0


def test_replay_moves_the_car_and_the_cursor(page: Page) -> None:
    page.locator(".gallery .card").first.click()
    assert seconds(page) == 0.0
    start = car(page)
    page.select_option("select[aria-label='Speed of the replay']", "8")
    page.get_by_role("button", name="Play").click()
    expect(page.locator(".clock")).to_have_text(re.compile(r"^([3-9]|\d\d)\."))
    page.get_by_role("button", name="Pause").click()
    assert math.dist(car(page), start) > 5.0
    assert cursor(page) > 0.03
    now = seconds(page)
    page.wait_for_timeout(100)
    assert seconds(page) == now
    page.locator("#scrub").focus()
    page.keyboard.press("End")
    page.get_by_role("button", name="Play").click()  # from the start again
    expect(page.locator("#play")).to_have_text("Play", timeout=20_000)
    assert seconds(page) == pytest.approx(float(page.locator("#scrub").get_attribute("max") or 0))


def test_player_shows_how_the_driver_drove_in_units(page: Page, searched: Path) -> None:
    page.locator(".gallery .card").first.click()
    number = int(re.findall(r"\d+", page.locator("#player-title").text_content() or "")[0])
    with CampaignStore.open(searched) as store:
        test = store.test(number)
    assert test.drive is not None
    path = test.drive.trajectory
    page.keyboard.press("End")
    shown = {
        row.locator("> span").first.text_content(): row.locator(".now").text_content()
        for row in page.locator(".plot-name").all()
    }
    assert list(shown) == [
        "oob distance",
        "speed",
        "lateral acceleration",
        "steering",
        "throttle, brake",
        "curvature",
    ]
    value, unit = (shown["lateral acceleration"] or "").split(" ")
    assert unit == "m/s²"
    wanted = float(path.lateral_acceleration[-1])
    assert float(value.replace("−", "-")) == pytest.approx(wanted, abs=0.06)
    pedals = f"{100 * path.throttle[-1]:.0f}, {100 * path.brake[-1]:.0f} %"
    assert shown["throttle, brake"] == pedals
    assert (shown["speed"] or "").endswith(" km/h")
    assert (shown["steering"] or "").endswith("°")
    expect(page.locator(".plot .line-brake")).to_have_count(1)


def test_pointing_at_a_profile_moves_the_car(page: Page) -> None:
    page.locator(".gallery .card").first.click()
    box = page.locator("#profiles").bounding_box()
    assert box is not None
    before = car(page)
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 20)
    assert cursor(page) == pytest.approx(0.3, abs=0.01)
    assert math.dist(car(page), before) > 5.0


def test_replay_is_drawn_where_the_simulator_drove(page: Page, searched: Path) -> None:
    page.locator(".gallery .card").first.click()
    number = int(re.findall(r"\d+", page.locator("#player-title").text_content() or "")[0])
    with CampaignStore.open(searched) as store:
        test = store.test(number)
    assert test.drive is not None
    path = test.drive.trajectory
    start = car(page)
    page.keyboard.press("End")
    driven = math.dist((path.x[0], path.y[0]), (path.x[-1], path.y[-1]))
    assert math.dist(car(page), start) == pytest.approx(driven, abs=0.1)
    # The page has made the road out of its curvatures.
    centre = page.locator("dialog .scene .centre").first.get_attribute("d") or ""
    points = [tuple(map(float, p.split())) for p in centre.strip("M").split("L")]
    ends = test.road.points[[0, -1]]
    assert math.dist(points[0], points[-1]) == pytest.approx(math.dist(*ends), abs=0.1)
    length = sum(math.dist(a, b) for a, b in pairwise(points))
    assert length == pytest.approx(test.road.length, abs=0.5)
    box = page.locator("#car .body")
    assert float(box.get_attribute("width") or 0) == pytest.approx(test.drive.car.length, abs=1e-3)
    assert float(box.get_attribute("height") or 0) == pytest.approx(test.drive.car.width, abs=1e-3)


def test_keyboard_alone_is_enough(page: Page) -> None:
    cards = page.locator(".gallery .card")
    cards.first.focus()
    page.keyboard.press("ArrowRight")
    expect(cards.nth(1)).to_be_focused()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowUp")
    expect(cards.nth(1)).to_be_focused()
    outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_be_visible()
    first = page.locator("#player-title").text_content()
    page.keyboard.press("ArrowRight")
    assert seconds(page) == pytest.approx(0.1)
    page.keyboard.press("Shift+ArrowRight")
    assert seconds(page) == pytest.approx(1.1)
    page.keyboard.press("ArrowLeft")
    assert seconds(page) == pytest.approx(1.0)
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Pause")
    page.keyboard.press("Space")
    expect(page.locator("#play")).to_have_text("Play")
    page.keyboard.press("n")
    assert page.locator("#player-title").text_content() != first
    page.keyboard.press("p")
    assert page.locator("#player-title").text_content() == first
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    expect(cards.nth(1)).to_be_focused()


def test_map_is_walked_with_arrow_keys(page: Page) -> None:
    page.locator(".cell[tabindex='0']").focus()
    before = page.evaluate("document.activeElement.title")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.title") != before
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.title") == before
    page.keyboard.press("Enter")
    expect(page.locator(".map-panel h3")).to_contain_text("failure")


def test_alike_failures_open_beneath_theirs(page: Page) -> None:
    more = page.locator("button.alike").first
    number = int(re.findall(r"\d+", more.text_content() or "")[0])
    members = page.locator(".cluster.is-open .members .card")
    assert members.count() == 0
    more.click()
    expect(more).to_have_attribute("aria-expanded", "true")
    assert members.count() == min(number, 60)
    more.click()
    expect(members.first).to_be_hidden()


def test_gallery_is_sorted_and_filtered(page: Page) -> None:
    everything = len(heads(page))
    page.select_option("#gallery-side", "left")
    texts = page.locator(".gallery .card-text").all_text_contents()
    assert 0 < len(texts) < everything
    assert all("leaves to the left" in text for text in texts)
    page.select_option("#gallery-side", "")
    page.select_option("#gallery-sort", "first")
    assert len(heads(page)) == everything


def heads(page: Page) -> list[int]:
    more = page.locator("#failures button.more")
    if more.is_visible():
        more.click()
    cards = page.locator(".gallery > .cluster > .card")
    found: list[str] = cards.evaluate_all("els => els.map(el => el.dataset.test)")
    return sorted(map(int, found))


def test_failures_are_found_by_words_and_by_number(page: Page, searched: Path) -> None:
    clusters = clusters_of(searched)
    search = page.locator("#gallery-search")
    word = "entering"
    search.fill(f" {word.upper()} left")
    wanted = [one for one in clusters if word in one.description and "left" in one.description]
    assert 0 < len(wanted) < len(clusters)
    assert set(heads(page)) >= {one.most_severe for one in wanted}
    assert len(heads(page)) == len(wanted)
    expect(page.locator("#failures .found")).to_have_text(f"{len(wanted)} of {len(clusters)}")
    member = next(i for one in clusters if len(one) > 1 for i in one.ids if i != one.most_severe)
    search.fill(f"#{member}")
    assert heads(page) == [member]
    expect(page.locator(".gallery .card-text").first).to_contain_text("Like test ")
    with CampaignStore.open(searched) as store:
        by = {test.id: test.candidate.origin.operator for test in store.tests(Outcome.FAIL)}
    operator = next(name for name in sorted(set(by.values())) if name != "random")
    search.fill(operator)
    assert heads(page)
    assert all(by[i] == operator for i in heads(page))
    search.fill("no such words")
    expect(page.locator(".gallery")).to_have_text("None of these.")
    page.get_by_role("button", name="Clear").click()
    assert search.input_value() == ""
    assert len(heads(page)) == len(clusters)


def test_failures_are_chosen_by_radius_and_speed(page: Page, searched: Path) -> None:
    radii: dict[int, float] = {}
    speeds: dict[int, float] = {}
    clusters = clusters_of(searched)
    with CampaignStore.open(searched) as store:
        for test in store.tests(Outcome.FAIL, with_trajectory=True):
            assert test.departure is not None
            assert test.drive is not None
            place = test.departure.distance
            before = np.append(np.arange(max(0.0, place - 30.0), place, 1.0), place)
            radii[test.id] = float(1.0 / np.abs(test.road.curvature_at(before)).max())
            path = test.drive.trajectory
            speeds[test.id] = float(3.6 * np.interp(test.departure.time, path.time, path.speed))

    def chosen(values: dict[int, float], low: float, high: float) -> list[int]:
        inside = ([i for i in one.ids if low <= values[i] <= high] for one in clusters)
        return [len(ids) for ids in inside if ids]

    def between(values: list[float], share: float) -> float:
        """A bound with such a share below it, where no value is so near that rounding decides."""
        middle = int(share * len(values))
        i = max(range(middle - 4, middle + 4), key=lambda i: values[i + 1] - values[i])
        return round(0.5 * (values[i] + values[i + 1]), 3)

    for name, values in (("radius", radii), ("speed", speeds)):
        low, high = (between(sorted(values.values()), share) for share in (0.3, 0.6))
        page.fill(f"#gallery-{name}-low", str(low))
        page.fill(f"#gallery-{name}-high", str(high))
        shown = heads(page)
        assert len(shown) == len(chosen(values, low, high)) < len(clusters)
        assert all(low <= values[i] <= high for i in shown)
        page.get_by_role("button", name="Clear").click()


def test_failures_are_chosen_by_robustness(
    show: Callable[..., Page], searched: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(searched, tmp_path / "again")
    arguments = ["--driver", "planner", "--simulator", "embedded", "--top", "2"]
    assert (
        CliRunner().invoke(cli, ["rerun", str(folder), "--times", "20", *arguments]).exit_code == 0
    )
    page = show(write_report(folder))
    everything = heads(page)
    page.select_option("#gallery-robust", "robust")
    robust = heads(page)
    assert len(robust) == 2
    expect(page.locator(".gallery .repeats.robust")).to_have_count(2)
    page.select_option("#gallery-robust", "none")
    assert len(heads(page)) >= len(everything) - 2
    assert not set(robust) & set(heads(page))


def test_commands_are_copied_as_they_are(page: Page, searched: Path) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator(".gallery .card").first.click()
    line = page.locator("dialog .command-line").last
    text = line.locator("code").text_content() or ""
    assert re.fullmatch(rf"frenetic show {re.escape(str(searched))} \d+", text)
    line.get_by_role("button").click()
    expect(line.get_by_role("button")).to_have_text("Copied")
    assert page.evaluate("navigator.clipboard.readText()") == text


def test_commands_of_a_campaign_in_a_folder_with_blanks_can_be_pasted(
    show: Callable[..., Page], tmp_path: Path
) -> None:
    folder = tmp_path / "it's a night"
    arguments = ["run", "--failures", "2", "--seed", "1", "--workers", "1", "--out", str(folder)]
    assert CliRunner().invoke(cli, [*arguments, "--with", "noise=0.1"]).exit_code == 0
    page = show(folder / "report.html")
    page.locator(".gallery .card").first.click()
    lines = [shlex.split(text) for text in page.locator("dialog code").all_text_contents()]
    drive, shown, minimise = lines
    assert drive[:2] == ["frenetic", "drive"]
    done = CliRunner().invoke(cli, drive[1:])
    assert done.exit_code == 0
    assert done.output.startswith("FAIL")
    assert drive[drive.index("--with") + 1] == "noise=0.1"
    assert shown[:3] == ["frenetic", "show", str(folder)]
    assert minimise[:3] == ["frenetic", "minimise", str(folder)]


def test_a_test_has_an_address_of_its_own(show: Callable[..., Page], searched: Path) -> None:
    page = show(searched / "report.html")
    page.locator(".gallery .card").nth(1).click()
    address = page.evaluate("location.hash")
    title = page.locator("#player-title").text_content()
    assert re.fullmatch(r"#test-\d+", address)
    again = show(searched / "report.html", fragment=address)
    expect(again.locator("#player-title")).to_have_text(title or "")


def test_a_linked_test_has_a_previous_and_a_next_one(
    show: Callable[..., Page], searched: Path
) -> None:
    cards = show(searched / "report.html").locator(".gallery > .cluster > .card")
    ids = cards.evaluate_all("els => els.map(el => el.dataset.test)")
    page = show(searched / "report.html", fragment=f"#test-{ids[1]}")
    expect(page.locator(".player-nav")).to_contain_text(f"2 of {len(clusters_of(searched))}")
    page.get_by_role("button", name="Next test").click()
    expect(page.locator("#player-title")).to_contain_text(f"Test {ids[2]} ")
    page.get_by_role("button", name="Previous test").click()
    page.get_by_role("button", name="Previous test").click()
    expect(page.locator("#player-title")).to_contain_text(f"Test {ids[0]} ")


def test_a_robust_failure_has_no_colour_of_success(page: Page) -> None:
    colours = page.evaluate(
        """() => ["repeats robust", "repeats fragile", "number outcome-pass"].map((style) => {
          const line = document.querySelector(".card-line");
          const probe = document.createElement("span");
          probe.className = style;
          line.append(probe);
          const { color } = getComputedStyle(probe);
          probe.remove();
          return color;
        })"""
    )
    fail, success = (
        page.evaluate(
            "name => (document.body.style.color = `var(--${name})`,"
            " getComputedStyle(document.body).color)",
            name,
        )
        for name in ("fail", "pass")
    )
    assert colours[0] == fail
    assert colours[1] not in (fail, success)
    assert colours[2] not in (fail, success)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_all_text_can_be_read(
    show: Callable[..., Page], searched: Path, tmp_path: Path, theme: str
) -> None:
    folder = shutil.copytree(searched, tmp_path / "again")
    with CampaignStore.open(folder) as store:
        failures = [test.id for test in store.tests(Outcome.FAIL, order_by="moobd", limit=2)]
    rerun(folder, EmbeddedSimulator(friction=0.8), Planner(), tests=failures)
    page = show(write_report(folder), color_scheme=theme)
    # What is folded, what is hovered over, and each shade of the map with a number in it.
    page.evaluate(
        """() => {
          for (const details of document.querySelectorAll("details")) details.open = true;
          const styles = ["covered", "empty"];
          for (let i = 0; i < 7; i++) styles.push(`severity-${i}`, `count-${i}`);
          for (const style of styles) {
            const cell = document.createElement("button");
            cell.className = `cell ${style}`;
            cell.textContent = "12";
            document.querySelector(".map-panel").append(cell);
          }
          for (const style of ["robust", "unclear", "fragile"]) {
            const line = document.createElement("span");
            line.className = `repeats ${style}`;
            line.textContent = style;
            document.querySelector(".card").append(line);
          }
        }"""
    )
    assert low_contrast(page) == []
    raised = "els => els.forEach(el => { el.style.background = 'var(--raised)'; })"
    page.locator(".card, tbody tr > *").evaluate_all(raised)
    assert low_contrast(page) == []
    page.locator(".legend button").first.click()
    page.locator("button.alike").first.click()
    page.locator(".cell[class*=severity]").first.click()
    page.locator(".block-switch .chart-drawing").focus()
    page.keyboard.press("ArrowRight")
    assert low_contrast(page) == []
    page.evaluate("location.hash = '#test-99999'")
    expect(page.locator("#notice")).to_be_visible()
    assert low_contrast(page) == []
    page.locator("#elsewhere .card").first.click()
    expect(page.get_by_role("dialog")).to_be_visible()
    assert low_contrast(page) == []


def has_colour(canvas: Locator, colour: tuple[int, int, int]) -> bool:
    """Whether a chart has lines of a colour."""
    pixels = np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB"))
    return int((np.abs(pixels.astype(int) - colour).max(axis=2) < 8).sum()) > 50


def test_dark_colours_follow_the_system_and_the_switch(
    show: Callable[..., Page], searched: Path
) -> None:
    page = show(searched / "report.html", color_scheme="dark")
    canvas = page.locator(".block-switch canvas")
    expect(canvas).to_be_visible()
    assert background(page) < 150
    light, dark = (196, 31, 39), (255, 122, 112)  # of failures
    assert has_colour(canvas, dark)
    assert not has_colour(canvas, light)
    button = page.locator("#theme")
    button.click()
    expect(button).to_have_text("Light")
    assert background(page) > 600
    assert has_colour(canvas, light)
    assert not has_colour(canvas, dark)
    page.reload()
    expect(page.locator("#theme")).to_have_text("Light")
    page.locator("#theme").click()
    expect(page.locator("#theme")).to_have_text("Dark")
    assert background(page) < 150


@pytest.mark.parametrize("width", [320, 390, 768])
def test_small_screens_need_no_scrolling_sideways(
    show: Callable[..., Page], searched: Path, width: int
) -> None:
    page = show(searched / "report.html", viewport={"width": width, "height": 844}, has_touch=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.locator(".gallery .card").first.click()
    dialog = page.get_by_role("dialog")
    assert dialog.evaluate("dialog => dialog.scrollWidth <= dialog.clientWidth")
    box = dialog.bounding_box()
    assert box is not None
    assert box["width"] <= width


def test_paper_is_white_and_has_no_switches(show: Callable[..., Page], searched: Path) -> None:
    page = show(searched / "report.html", color_scheme="dark")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert background(page) == 3 * 255
    for hidden in (".bar", ".choices", ".copy", ".map-panel"):
        expect(page.locator(hidden).first).to_be_hidden()
    widths = page.locator(".chart-drawing canvas").evaluate_all(
        "els => els.map(el => el.clientWidth)"
    )
    assert 500 < max(widths) <= 660
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    page.emulate_media(media="screen")
    assert background(page) < 150
    assert len(page.pdf(format="A4")) > 20_000


def test_printing_leaves_the_open_player_out(show: Callable[..., Page], searched: Path) -> None:
    page = show(searched / "report.html")
    page.locator(".gallery .card").first.click()
    dialog = page.locator("#player")
    expect(dialog).to_be_visible()
    page.emulate_media(media="print")
    expect(dialog).to_be_hidden()
    expect(page.locator("#failures .card").first).to_be_visible()
    page.emulate_media(media="screen")
    expect(dialog).to_be_visible()


def test_paper_shows_what_is_folded(page: Page) -> None:
    details = page.locator("#configuration details")
    details.nth(1).locator("summary").click()
    folded = "els => els.map(el => el.open)"
    before = details.evaluate_all(folded)
    assert before.count(True) == 1
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert all(details.evaluate_all(folded))
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert details.evaluate_all(folded) == before


def pointed(page: Page, share: float) -> tuple[float, float]:
    """A place in the first chart, so far from its left edge."""
    over = page.locator(".block-switch .u-over")
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    assert box is not None
    return box["x"] + share * box["width"], box["y"] + 60


def said(page: Page) -> tuple[int, dict[str | None, str | None]]:
    """Where the first chart's cursor is, and the values there."""
    tip = page.locator(".block-switch .chart-tip")
    rows = {
        row.locator("span").text_content(): row.locator("b").text_content()
        for row in tip.locator("> div").all()
    }
    return int(re.findall(r"^(\d+) ", tip.locator("p").first.text_content() or "")[0]), rows


def test_chart_says_what_it_shows_where_one_points(page: Page, searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        tested = [test for test in store.tests() if test.outcome.is_test]
    page.mouse.move(*pointed(page, 0.6))
    at, rows = said(page)
    assert at == pytest.approx(90, abs=2)
    driven = [test for test in tested if test.outcome is not Outcome.INVALID][:at]
    failed = [test.id for test in driven if test.outcome is Outcome.FAIL]
    assert rows["failures"] == str(len(failed))
    assert list(rows) == page.locator(".block-switch .legend button").all_text_contents()
    tip = page.locator(".chart-tip")
    expect(tip).to_contain_text(f"Latest failure: test {failed[-1]}.")
    page.locator(".block-switch .legend button", has_text="distinct failures").first.click()
    page.mouse.move(*pointed(page, 0.6))
    assert "distinct failures" not in said(page)[1]
    page.mouse.down()
    page.mouse.up()
    expect(page.locator("#player-title")).to_contain_text(f"Test {failed[-1]} FAIL")


def test_chart_is_enlarged_by_dragging(page: Page) -> None:
    page.mouse.move(*pointed(page, 1 / 3))
    page.mouse.down()
    page.mouse.move(*pointed(page, 2 / 3), steps=3)
    page.mouse.up()
    whole = page.get_by_role("button", name="Whole range")
    expect(whole).to_be_visible()
    for share, simulations in ((0.02, 50), (0.98, 100)):
        page.mouse.move(*pointed(page, share))
        assert said(page)[0] == pytest.approx(simulations, abs=3)
    expect(page.get_by_role("dialog")).to_have_count(0)
    whole.click()
    page.mouse.move(*pointed(page, 0.98))
    assert said(page)[0] > 140
    expect(whole).to_be_hidden()


def test_chart_is_read_with_the_keyboard(page: Page) -> None:
    page.locator(".block-switch .chart-drawing").focus()
    page.keyboard.press("ArrowRight")
    first, _ = said(page)
    for _ in range(60):
        page.keyboard.press("ArrowRight")
    assert said(page)[0] > first + 50
    tip = page.locator(".block-switch .chart-tip")
    number = re.findall(r"test (\d+)", tip.text_content() or "")[0]
    page.keyboard.press("Enter")
    expect(page.locator("#player-title")).to_contain_text(f"Test {number} ")


def test_tests_are_sorted_and_found(page: Page, searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        tests = {test.id: test for test in store.tests()}
    rows, ids = page.locator("#tests tbody tr"), page.locator("#tests tbody th")
    expect(rows).to_have_count(50)
    assert ids.all_text_contents() == [str(i) for i in sorted(tests)[:50]]
    page.get_by_role("button", name="MOOBD (m)").click()
    head = page.locator("#tests thead th", has_text="MOOBD (m)")
    expect(head).to_have_attribute("aria-sort", "ascending")
    known = {i: test.moobd for i, test in tests.items() if test.moobd is not None}
    shown = [known[int(text)] for text in ids.all_text_contents()]
    assert shown == pytest.approx(sorted(known.values())[:50], abs=0.011)
    page.keyboard.press("Enter")
    expect(head).to_have_attribute("aria-sort", "descending")
    page.select_option("#tests-outcome", "FAIL")
    failures = sum(test.outcome is Outcome.FAIL for test in tests.values())
    expect(page.locator("#tests .found")).to_have_text(f"{failures} of {len(tests)}")
    expect(rows).to_have_count(failures)
    page.select_option("#tests-outcome", "")
    page.get_by_role("button", name=f"Show more of {len(tests)}").click()
    expect(rows).to_have_count(len(tests))
    child = next(test for test in tests.values() if test.candidate.origin.parents)
    parent = child.candidate.origin.parents[0]
    page.fill("#tests-search", f"#{parent}")
    assert {str(child.id), str(parent)} <= set(ids.all_text_contents())
    page.locator("#tests tbody a", has_text=re.compile(f"^{parent}$")).click()
    opened = page.locator("#player-title, #notice code")
    expect(opened.first).to_contain_text(str(parent))


def test_player_fits_on_a_phone(show: Callable[..., Page], searched: Path) -> None:
    page = show(searched / "report.html", viewport={"width": 390, "height": 844}, has_touch=True)
    page.locator(".gallery .card").first.click()
    area = page.locator("#profiles").bounding_box()
    assert area is not None
    assert area["y"] + area["height"] < 844
    # The widest value that there is.
    page.locator(".plot-name .now").evaluate_all(
        "els => els.forEach(el => { el.textContent = '\u22120.044 1/\u2060m'; })"
    )
    ends = page.locator(".plot-name > span:not(.high):not(.low)").evaluate_all(
        "els => els.map(el => { const r = document.createRange(); r.selectNodeContents(el);"
        " return r.getBoundingClientRect().right; })"
    )
    assert len(ends) == 12
    assert max(ends) <= area["x"]
    labels = page.locator(".plot-name .high, .plot-name .low")
    assert labels.count() == 12
    lefts = labels.evaluate_all("els => els.map(el => el.getBoundingClientRect().left)")
    assert min(lefts) > area["x"]


def test_roads_of_a_tapped_cell_come_into_sight(show: Callable[..., Page], searched: Path) -> None:
    page = show(searched / "report.html", viewport={"width": 390, "height": 844}, has_touch=True)
    cell = page.locator(".cell[class*=severity]").first
    cell.tap()
    expect(page.locator(".map-panel h3")).to_be_in_viewport()
    expect(page.locator(".map-panel .card").first).to_be_in_viewport()


@pytest.mark.parametrize(("width", "more"), [(390, True), (1280, False)])
def test_navigation_hints_at_more_to_the_right(
    show: Callable[..., Page], searched: Path, width: int, more: bool
) -> None:
    page = show(searched / "report.html", viewport={"width": width, "height": 844})
    goes_on = "goes => document.querySelector('nav.goes-on') ? goes : !goes"
    page.wait_for_function(goes_on, arg=more)
    page.locator("nav").evaluate("nav => nav.scrollTo({ left: 1e4, behavior: 'instant' })")
    expect(page.locator("nav.goes-on")).to_have_count(0)


def test_a_failure_in_another_simulator_is_replayed_beside_the_campaigns(
    show: Callable[..., Page], tmp_path: Path
) -> None:
    folder = make_searched(tmp_path / "searched")
    with CampaignStore.open(folder) as store:
        failures = [test.id for test in store.tests(Outcome.FAIL, order_by="moobd", limit=2)]
    there = rerun(folder, EmbeddedSimulator(friction=0.8), Planner(), tests=failures)
    page = show(write_report(folder), viewport={"width": 390, "height": 844}, color_scheme="dark")
    section = page.locator("#elsewhere")
    assert section.locator("img").count() == 0  # a picture on white paper would glare
    cards = section.locator(".card")
    expect(cards).to_have_count(2)
    box = cards.first.locator("svg").bounding_box()
    assert box is not None
    assert box["width"] > 300  # of 390
    expect(cards.first.locator("path.other")).to_have_count(1)
    expect(cards.first).to_contain_text(there.tests[0].verdict)
    cards.first.click()
    expect(page.locator("#player-title")).to_contain_text(f"Test {failures[0]} ")
    expect(page.get_by_role("dialog")).to_contain_text("embedded, friction 0.8: ")
    expect(page.locator(".stage-main path.other")).to_have_count(1)
    ghost = page.locator(".stage-main .ghost")
    before = ghost.get_attribute("transform")
    page.keyboard.press("End")
    assert ghost.get_attribute("transform") != before
    assert page.locator(".plot .line.other").count() == 6
    page.keyboard.press("Escape")
    section.locator("tbody a").last.click()
    expect(page.locator("#player-title")).to_contain_text(f"Test {failures[1]} ")


def test_a_table_hints_at_more_columns_to_the_right(
    show: Callable[..., Page], searched: Path
) -> None:
    page = show(searched / "report.html", viewport={"width": 390, "height": 844})
    table = page.locator("#operators .table")
    expect(table).to_have_class(re.compile("goes-on"))
    assert table.evaluate("box => getComputedStyle(box).maskImage").startswith("linear-gradient")
    table.evaluate("box => box.scrollTo({ left: 1e4, behavior: 'instant' })")
    expect(table).not_to_have_class(re.compile("goes-on"))
    page.set_viewport_size({"width": 1400, "height": 900})
    expect(page.locator(".goes-on")).to_have_count(0)


def test_counts_of_the_map_stand_at_the_middle_of_their_cells(page: Page) -> None:
    page.select_option("#map-across", "bends")
    labels = page.locator(".edges-x span")
    numbers = [int(text) for text in labels.all_text_contents()]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    middle = "const b = el.getBoundingClientRect(); return b.x + b.width / 2;"
    centre = f"els => els.map(el => {{ {middle} }})"
    cells = page.locator(".cell-row").first.locator(".cell")
    assert labels.evaluate_all(centre) == pytest.approx(cells.evaluate_all(centre), abs=1.5)
    title = re.compile(f"^Number of bends {numbers[-1]}, ")
    expect(cells.last).to_have_attribute("title", title)


def test_profile_ticks_stand_where_they_say(page: Page, searched: Path) -> None:
    page.locator(".gallery .card").first.click()
    number = int(re.findall(r"\d+", page.locator("#player-title").text_content() or "")[0])
    with CampaignStore.open(searched) as store:
        length = store.test(number).road.length
    area, tick = page.locator("#profiles").bounding_box(), page.locator(".plot-ticks span").last
    box = tick.bounding_box()
    assert area is not None
    assert box is not None
    place = float(tick.text_content() or "") / length
    assert box["x"] + box["width"] / 2 == pytest.approx(area["x"] + place * area["width"], abs=1.5)


def test_operators_are_explained(page: Page) -> None:
    row = page.locator("#operators tbody tr", has_text="random")
    expect(row).to_contain_text("draws a new road")
    bar = page.locator("#operators .bar-row", has=page.get_by_text("random", exact=True))
    expect(bar).to_contain_text("draws a new road")


def test_a_minimised_road_can_be_driven_again(
    show: Callable[..., Page], searched: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(searched, tmp_path / "it's small")
    with CampaignStore.open(folder) as store:
        worst = distinct_failures(store)[0].most_severe
        road = road_document(store.test(worst), store.config)
    file = folder / "minimised" / f"test-{worst:05d}.json"
    file.parent.mkdir()
    file.write_text(json.dumps(road), encoding="utf-8")
    page = show(write_report(folder))
    page.locator(".gallery .card").first.click()
    expect(page.locator(".minimised .file")).to_have_text(shlex.quote(str(file)))
    line = page.locator("dialog .command", has_text="Drive the minimised road").locator("code")
    assert shlex.split(line.text_content() or "") == ["frenetic", "drive", str(file)]


def test_a_test_that_is_not_in_the_page_is_said_to_be_elsewhere(
    show: Callable[..., Page], searched: Path
) -> None:
    page = show(searched / "report.html", fragment="#test-99999")
    notice = page.get_by_role("status").filter(has_text="The drive of test 99999 is not in this")
    expect(notice.locator("code")).to_have_text(f"frenetic show {searched} 99999")
    expect(page.get_by_role("dialog")).to_have_count(0)
    notice.get_by_role("button", name="Close").click()
    expect(notice).to_have_count(0)
    assert page.evaluate("location.hash") == ""
    page.evaluate("location.hash = '#test-88888'")
    expect(page.locator("#notice")).to_contain_text("88888")


def test_failures_like_another_that_cannot_be_opened_say_why(
    show: Callable[..., Page], searched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.report.html.campaign.DRIVES_SIZE", 20_000)
    page = show(write_report(searched, tmp_path / "r.html"))
    closed = page.locator("p.alike").first
    expect(closed).to_have_text(re.compile("(its drive is|their drives are) not in this"))


def test_no_text_from_outside_is_run(
    show: Callable[..., Page], searched: Path, tmp_path: Path
) -> None:
    page = show(write_report(make_hostile(tmp_path, searched)))
    page.locator(".gallery .card").first.click()
    expect(page.locator(".reason")).to_have_text(HOSTILE)
    assert page.evaluate("window.hacked === undefined && typeof hacked === 'undefined'")
    assert page.locator("main img, dialog img").count() == 0
    expect(page.locator("#operators tbody th")).to_have_text(HOSTILE)


def test_a_script_that_is_not_ours_is_refused(browser: Browser, searched: Path) -> None:
    page = browser.new_page()
    page.goto((searched / "report.html").as_uri())
    blocked = page.evaluate(
        """() => new Promise((resolve) => {
          const refused = (event) => resolve(event.effectiveDirective);
          document.addEventListener("securitypolicyviolation", refused);
          const script = document.createElement("script");
          script.textContent = "window.hacked = 1";
          document.body.append(script);
        })"""
    )
    assert blocked.startswith("script-src")
    assert page.evaluate("window.hacked === undefined")
    page.close()


def test_a_campaign_without_tests_has_a_page(
    show: Callable[..., Page], searched: Path, tmp_path: Path
) -> None:
    page = show(write_report(make_empty(tmp_path / "empty", searched)))
    expect(page.locator("h1")).to_have_text("No failure in 0 simulations")
    expect(page.locator(".warning")).to_contain_text("Not finished")
    expect(page.locator("#failures")).to_contain_text("No failure was found.")


def test_sections_of_ones_own_are_drawn(
    show: Callable[..., Page], searched: Path, tmp_path: Path
) -> None:
    section = Section(
        id="bench",
        title="The bench",
        lead="Two tools.",
        blocks=(
            Paragraph("A paragraph."),
            Facts((Fact("a", "b"),), "Some facts"),
            Facts((Fact("c", "d"),), "Folded facts", folded=True),
            Command("frenetic bench", "How it was made"),
            Table(
                (Column("tool"), Column("n", True)), (("ours", "1"), ("theirs", "2")), "Caption."
            ),
            Chart(
                (Series("line", (0.0, 1.0), (1.0, 2.0), (0.5, 1.5), (1.5, 2.5), dashed=True),),
                "runs",
                "failures",
            ),
            Bars(("one", "two"), (1.0, None), "share", (0.5, None), (1.5, None), role="pass"),
        ),
    )
    page = show(write_report(searched, tmp_path / "r.html", sections=[section]))
    ours = page.locator("#bench")
    ours.locator(".chart-drawing").focus()
    tip = ours.locator(".chart-tip")
    for place, value in (("0", "1"), ("1", "2"), ("1", "2")):  # there are two points
        page.keyboard.press("ArrowRight")
        expect(tip.locator("p").first).to_have_text(f"{place} runs")
        expect(tip.locator("b")).to_have_text(value)
    for text in (
        "Two tools.",
        "A paragraph.",
        "Some facts",
        "frenetic bench",
        "theirs",
        "Caption.",
    ):
        expect(ours).to_contain_text(text)
    expect(ours.locator(".stroke.dashed").first).to_be_visible()
    expect(ours.locator(".bar-fill")).to_have_count(1)
    expect(ours.locator(".bar-value")).to_have_text(["1.00", "–"])
    expect(page.locator("nav a").last).to_have_text("The bench")


# A replay within another page


def test_a_replay_plays_within_a_page_that_lets_it_do_nothing_else(
    show: Callable[..., Page], searched: Path, tmp_path: Path
) -> None:
    with CampaignStore.open(searched) as store:
        (failure,) = store.tests(Outcome.FAIL, order_by="moobd", limit=1, with_trajectory=True)
    replay = animate(failure)
    around = tmp_path / "notebook.html"
    around.write_text(f"<!doctype html><meta charset='utf-8'>{replay.html}", encoding="utf-8")
    page = show(around)
    frame = page.frame_locator("iframe")
    expect(frame.locator("#player-title")).to_contain_text(f"Test {failure.id}")
    assert page.evaluate("document.activeElement.tagName") == "BODY"  # it took no focus
    before = frame.locator("#car").get_attribute("transform")
    frame.locator("#play").click()
    expect(frame.locator("#car")).not_to_have_attribute("transform", before or "")
    expect(frame.locator("#play")).to_have_text("Pause")
    for left_out in (".bar", ".player-nav", "#foot"):
        expect(frame.locator(left_out)).to_be_hidden()
    alone = show(replay.write(tmp_path / "replay.html"))
    alone.locator("#scrub").fill("1")
    assert seconds(alone) == 1.0


def test_player_plays_what_the_camera_saw(show: Callable[..., Page], tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=3),
        simulator=EmbeddedSimulator(),
        driver=load_driver("marking-follower"),
        budget=Budget(simulations=1),
        folder=tmp_path / "seen",
    ).run()
    page = show(write_report(tmp_path / "seen"), fragment="#test-1")
    picture = page.locator("#picture")
    expect(picture).to_have_attribute("viewBox", "0 0 160 80")
    page.locator("#player").press("End")
    expect(picture).not_to_have_attribute("viewBox", "0 0 160 80")
